"""The measurement chain of a machine given by a function: joints, the function, readings, with the effects of each.

What a robot has compiled stands here in NumPy; a fit, a diagnosis and a calibration ask it the same questions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...base.types import Bools, Floats
from ...fit.numpy_chain import NumpyChain
from ...model.chain import Block
from ...model.sensor_pose import POSE, SensorPose, by_pose, seen_from, turn_of
from .function import UserFunction
from .generic_effects import Generic, RowCovariates

_TINY = 1e-30


@dataclass(frozen=True, eq=False)
class MachineCore(NumpyChain):
    """The chain of one machine at the settings of its effects: ``wave``, one turn over the period of each joint,
    ``home``, from where scales and couplings count, and four moments, s. Its readings are places that a sensor sees
    from its ``pose``, where it has one."""

    function: UserFunction
    effects: tuple[Generic, ...]
    pose: SensorPose | None
    wave: tuple[float, ...]
    home: tuple[float, ...]
    time_origin_s: float
    slip_time_s: float
    joint_slip_time_s: float
    sensor_slip_time_s: float

    @cached_property
    def places(self) -> list[slice]:
        """Where the parameters of each effect stand among all."""
        ends = np.cumsum([len(self.function.parameters), *(len(one.parameters) for one in self.effects)])
        return [slice(a, b) for a, b in pairwise(ends.tolist())]

    def _known(self, block: Block) -> tuple[Floats, RowCovariates, Floats]:
        joints, _, columns, push = block
        k = joints.shape[1]
        columns = np.full((len(joints), 3 + 2 * k), np.nan) if columns is None else columns
        moved = columns[:, 2 : 2 + k], columns[:, 2 + k : 2 + 2 * k]
        known = RowCovariates(columns[:, 0], columns[:, 1], columns[:, -1], *moved, self)
        return joints, known, np.zeros((len(joints), 3)) if push is None else push

    def _link(self, link: str, x: NDArray[Any], values: Floats, known: RowCovariates) -> NDArray[Any]:
        """A link: what comes in (n, axes), and what its effects add."""
        out = x
        for one, place in zip(self.effects, self.places, strict=True):
            # an effect at zero does not ask for its covariate
            if one.at == link and values[place].any():
                out = out + one.formula(x, known) @ values[place]
        return out

    def _by_input(self, link: str, x: Floats, values: Floats, known: RowCovariates) -> Floats:
        """How a link carries on a change of what comes in (n, axes, axes): its formulas are ours, and complex."""
        n, axes = x.shape
        own = [o for o, p in zip(self.effects, self.places, strict=True) if o.at == link and values[p].any()]
        if not own:
            return np.broadcast_to(np.eye(axes), (n, axes, axes))
        columns = []
        for k in range(axes):
            moved = x.astype(complex)
            moved[:, k] += 1j * _TINY
            columns.append(self._link(link, moved, values, known).imag / _TINY)
        return np.stack(columns, axis=2)

    def _stands(self, values: Floats, known: RowCovariates) -> Floats:
        """By how much the pose of the sensor is off (n, 6), row by row."""
        return self._link("pose", np.zeros((len(known.time_s), len(POSE))), values, known)

    def predict(self, values: Floats, block: Block) -> tuple[Floats, Bools]:
        """Readings (n, m), and which rows could be computed."""
        joints, known, push = self._known(block)
        point = self.function(self._link("joints", joints, values, known), values[: len(self.function.parameters)])
        shown = self._pushed(self._link("body", point, values, known), push)
        if self.pose is not None:
            shown = seen_from(self.pose, self._stands(values, known), shown)
        out = self._link("sensor", shown, values, known)
        return out, np.isfinite(out).all(axis=1)

    def _pushed(self, point: Floats, push: Floats) -> Floats:
        return point + push if point.shape[1] == push.shape[1] else point

    def derivatives(self, values: Floats, block: Block, free: Sequence[int]) -> tuple[Floats, Floats, Floats, Bools]:
        """By the parameters ``free``, the joints and a displacement of the point (n, m, ·), and which rows could be
        computed."""
        joints, known, push = self._known(block)
        count = len(self.function.parameters)
        own = values[:count]
        stood = self._link("joints", joints, values, known)
        point = self.function(stood, own)
        moved = seen = self._pushed(self._link("body", point, values, known), push)
        # what each link adds to: at which input, and how a change of that comes to the readings
        links: dict[str, tuple[Floats, Floats]] = {}
        if self.pose is not None:
            off = self._stands(values, known)
            seen = seen_from(self.pose, off, moved)
            by_seen = self._by_input("sensor", seen, values, known)
            by_moved = by_seen @ turn_of(self.pose, off)
            links["pose"] = np.zeros_like(off), by_seen @ by_pose(self.pose, off, moved)
        else:
            by_moved = self._by_input("sensor", seen, values, known)
        by_point = by_moved @ self._by_input("body", point, values, known)
        wanted = [k for k in free if k < count]
        by_stood, by_own = self.function.derivatives(stood, own, wanted)
        by_stood, by_own = by_point @ by_stood, by_point @ by_own
        links |= {"joints": (joints, by_stood), "body": (point, by_moved), "sensor": (seen, np.eye(seen.shape[1]))}
        columns = dict(zip(wanted, np.moveaxis(by_own, 2, 0), strict=True))
        for one, place in zip(self.effects, self.places, strict=True):
            asked = [k for k in free if place.start <= k < place.stop]
            if not asked:
                continue
            at, carry = links[one.at]
            carried = carry @ one.formula(at, known)
            columns |= {k: carried[:, :, k - place.start] for k in asked}
        out = np.stack([columns[k] for k in free], axis=2) if len(free) else np.zeros((*point.shape, 0))
        by_joints = by_stood @ self._by_input("joints", joints, values, known)
        by_push = by_moved if moved.shape[1] == 3 else np.zeros((*moved.shape, 3))
        reached = np.isfinite(self._link("sensor", seen, values, known)).all(axis=1)
        return out, by_joints, by_push, reached
