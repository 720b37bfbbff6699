"""A linear delta printer as a model for identification: twelve errors of its geometry, read by a probe."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

import sherkit._core as _core

from ...base.names import listed
from ...base.types import Bools, Floats
from ...data import Measurements
from ...errors import FitError
from ...model.base import Reachable
from ...model.chain import Block
from ...model.effect import Effect, Parameter
from ...model.rows import Rows
from ..delta.model import DeltaModel
from .bed import probing_zero, zeros_of
from .effects import CATALOGUE, OF_RODS
from .robot import POSITION, PROBED, PROBING, Printer

# -- The compiled chain of a delta, asked for the one number that a printer's row holds -----------------------------

#: Among the four readings of a delta.
_HEIGHT, _DISTANCE, _READINGS = 2, 3, 4


@dataclass(frozen=True, eq=False)
class Probed:
    """The methods of the core that a model asks for, with readings (n, 1)."""

    core: _core.DeltaModel

    def predict(self, values: Floats, block: Block) -> tuple[Floats, Bools]:
        """Predicted readings (n, 1), and which rows have one."""
        out, reached = self.core.predict(values, block)
        return _picked(out, block), reached

    def derivatives(self, values: Floats, block: Block, free: list[int]) -> tuple[Floats, Floats, Floats, Bools]:
        """By parameters (n, 1, p), joints (n, 1, 3) and a displacement of the measured point (n, 1, 3)."""
        *found, reached = self.core.derivatives(values, block, free)
        by_parameters, by_joints, by_body = (_picked(one, block) for one in found)
        return by_parameters, by_joints, by_body, reached

    def solve(
        self,
        solver: Any,
        values: Floats,
        free: list[int],
        block: Block,
        readings: Floats,
        weights: Floats,
        priors: bool,
    ) -> tuple[str, list[int]]:
        """As the core's."""
        read, weigh = (_spread(one, block) for one in (readings, weights))
        return self.core.solve(solver, values, free, block, read, weigh, priors)

    def accumulate(
        self, solver: Any, values: Floats, free: list[int], block: Block, readings: Floats, weights: Floats
    ) -> list[int]:
        """As the core's."""
        read, weigh = (_spread(one, block) for one in (readings, weights))
        return self.core.accumulate(solver, values, free, block, read, weigh)


def places(block: Block) -> Floats:
    """Which of a delta's readings (n,) each row holds."""
    ends = block[1]
    if ends is None:
        return np.full(len(block[0]), _HEIGHT)
    return np.where(np.isfinite(ends).all(axis=1), _DISTANCE, _HEIGHT)


def _picked(values: Floats, block: Block) -> Floats:
    """Of values (n, 4, …) those of the reading that each row holds (n, 1, …)."""
    return np.ascontiguousarray(values[np.arange(len(values)), places(block)][:, None])


def _spread(values: Floats, block: Block) -> Floats:
    """Values (n, 1) at the place of each row's reading (n, 4), nothing elsewhere."""
    out = np.zeros((len(values), _READINGS))
    out[np.arange(len(values)), places(block)] = values[:, 0]
    return out


# --------------------------------------------------------------------------------------------------------------


class Touches(Rows):
    """The rows of a printer as its effects see them: ``position`` (n, 3) of the probe's tip, mm, and which of them
    ``is_distance`` (n,)."""

    def __init__(self, data: Measurements, position: Callable[[], Floats]) -> None:
        super().__init__(data, position)
        self.is_distance = distances(data)


@dataclass(frozen=True)
class PrinterModel(DeltaModel):
    """A nominal printer with named errors and effects to identify.

    A height is read above the bed, whose middle plane is the zero: neither has a datum. By default the twelve errors of
    :class:`~sherkit.robots.delta.DeltaModel` are free, and the zero of each probing behind the first.
    """

    robot: Printer

    catalogue: ClassVar = CATALOGUE
    layouts: ClassVar = (PROBED,)
    within: ClassVar = frozenset({"datum", probing_zero.name})

    def __post_init__(self) -> None:
        several = len(self.robot.probings) > 1
        if several and probing_zero.name not in [e.name for e in self.effects]:
            object.__setattr__(self, "effects", (*self.effects, zeros_of(len(self.robot.probings))))
        super().__post_init__()

    @property
    def default(self) -> tuple[str, ...]:
        """The paper's twelve."""
        return tuple(name for name in super().default if not name.startswith("datum"))

    @property
    def known_effects(self) -> Mapping[str, Effect]:
        """What is tried of it; effects of the two rods of an arm only where their distance is known."""
        left_out = (probing_zero.name, *(() if self.robot.rod_spacing_mm else OF_RODS))
        return {name: one for name, one in self.catalogue.items() if name not in left_out}

    @cached_property
    def core_parameters(self) -> tuple[Parameter, ...]:
        """Those of the compiled delta."""
        return DeltaModel(self.robot).core_parameters

    def core_for(self, data: Measurements) -> Any:
        """The compiled chain, asked for heights and distances."""
        del data
        return Probed(self.core)

    def block(self, data: Measurements, joints: Floats | None = None, push: Floats | None = None) -> Block:
        """The rows as the core takes them."""
        block = super().block(data, joints, push)
        return (block[0], data.to_joints if distances(data).any() else None, *block[2:])

    def require_own(self, data: Measurements) -> None:
        """Raises :class:`~sherkit.errors.FitError` for a run of something else, half a distance, or a probing that
        the robot file does not name."""
        super().require_own(data)
        ends = np.isfinite(data.to_joints)
        half = np.asarray(ends.any(axis=1) & ~ends.all(axis=1))
        if half.any():
            raise FitError(f"{data.place(half)}: a distance needs all of {listed(PROBED.to_joints)}")
        several = len(self.robot.probings)
        if several > 1 and PROBING not in data.covariates:
            raise FitError(
                f"{data.source}: column '{PROBING}' is missing: the robot file names {several} probings, and each row "
                "is to say from which it is (0 for the first)"
            )

    def tips(self, data: Measurements) -> Floats:
        """Where the tip of the probe was sent (n, 3), mm; at a distance, its first end."""
        return self.robot.forward_batch(data.joints).values

    def rows(self, data: Measurements, values: Floats) -> Rows:
        """The rows, with the places to which the tip of the probe was sent: a plate is smooth, and how far the tip is
        from there does not matter."""
        del values
        return Touches(data, lambda: self.tips(data))

    def reachable(self, data: Measurements, values: Floats) -> Reachable | None:
        """None: a printer is not sent to poses that would tell more; what to measure next is said in words."""
        del data, values
        return None

    def place(self, data: Measurements, predicted: Floats) -> dict[str, Floats]:
        """Where the printer was sent: x and y of the probe's tip."""
        del predicted
        at = self.tips(data)
        return dict(zip(POSITION[:2], at[:, :2].T, strict=True))


def distances(data: Measurements) -> Bools:
    """Which rows (n,) are distances between two places."""
    return np.asarray(np.isfinite(data.to_joints).all(axis=1))
