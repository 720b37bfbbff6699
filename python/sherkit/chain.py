"""A robot whose measurement chain is compiled: what is free, predicted readings, their derivatives.

The chain itself (kinematics, effects, exact derivatives) runs in Rust; here are the names. A robot is a subclass that
says which parameters its core has and how rows are handed to it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from .effects import Effect
from .errors import EffectError, FitError, ShapeError
from .measurements import Measurements
from .measurements.columns import Layout
from .names import listed, nearest
from .parameters import Parameter
from .rows import Rows

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class ChainModel(ABC):
    """A nominal robot with named errors and effects to identify.

    ``free`` names the geometric errors and datum to identify; left out, those of :attr:`default`. All parameters of
    ``effects`` are free. Readings have the columns of the rows' layout.
    """

    robot: Any
    free: tuple[str, ...] = ()
    effects: tuple[Effect, ...] = ()

    #: The built-in effects of this kind of robot by name, in the order of the chain.
    catalogue: ClassVar[Mapping[str, Effect]]
    #: The same in the order in which the core holds their parameters.
    core_order: ClassVar[tuple[Effect, ...]]
    #: The kinds of run that show this robot.
    layouts: ClassVar[tuple[Layout, ...]]

    def __post_init__(self) -> None:
        known = [p.name for p in self.base]
        if not self.free:
            object.__setattr__(self, "free", self.default)
        for name in self.free:
            if name not in known:
                raise FitError(f"'{name}' is not a parameter of this robot{nearest(name, known)}")
        if len(set(self.free)) < len(self.free):
            raise FitError(f"a parameter is freed twice: {listed(self.free, 24)}")
        names = [e.name for e in self.effects]
        if len(set(names)) < len(names):
            raise EffectError(f"an effect is added twice: {listed(names, 24)}")

    # -- what a robot says ---------------------------------------------------------------------------------

    @property
    @abstractmethod
    def base(self) -> tuple[Parameter, ...]:
        """Geometric errors and datum: the parameters that ``free`` chooses from, in the order of the core."""

    @property
    @abstractmethod
    def default(self) -> tuple[str, ...]:
        """Names of the parameters that are free unless others are named."""

    @property
    @abstractmethod
    def core(self) -> Any:
        """The compiled chain."""

    @abstractmethod
    def block(self, data: Measurements, joints: Floats | None = None, push: Floats | None = None) -> tuple[Any, ...]:
        """The rows as the core takes them, with other ``joints`` (n, k) and a displacement ``push`` (n, 3) if given."""

    @abstractmethod
    def reason(self, data: Measurements, row: int, values: Floats) -> str:
        """Why a row cannot be reached."""

    def reachable(self, data: Measurements, values: Floats) -> tuple[Floats, Measurements] | None:
        """Coordinates (k, m) of poses that could be measured next, and their rows; None where that is not known."""
        del data, values
        return None

    @abstractmethod
    def settings(self) -> dict[str, float | None]:
        """Settings of the effects that are no parameters: what :meth:`with_effect` takes besides the effect."""

    def require_own(self, data: Measurements) -> None:
        """Raises :class:`~sherkit.errors.FitError` for a run of another kind of robot."""
        if data.layout not in self.layouts:
            ways = " or ".join(", ".join(one.coordinates) for one in self.layouts)
            raise FitError(
                f"{data.source}: is no run of a {self.robot.kind} robot: expected the columns "
                f"{', '.join(self.layouts[0].joints)} with {ways}, found {', '.join(data.layout.joints)}"
            )

    # -- parameters --------------------------------------------------------------------------------------

    @cached_property
    def core_parameters(self) -> tuple[Parameter, ...]:
        """Every parameter of the compiled chain, in its order."""
        return self.base + tuple(p for e in self.core_order for p in e.qualified())

    @cached_property
    def built_in(self) -> tuple[Effect, ...]:
        """The effects that the core computes."""
        return tuple(e for e in self.effects if e.function is None)

    @cached_property
    def own(self) -> tuple[Effect, ...]:
        """The user's effects, given in NumPy."""
        return tuple(e for e in self.effects if e.function is not None)

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """The identified parameters: ``free``, then those of the built-in effects, then those of the user's."""
        by_name = {p.name: p for p in self.base}
        effects = (*self.built_in, *self.own)
        return tuple(by_name[n] for n in self.free) + tuple(p for e in effects for p in e.qualified())

    @cached_property
    def indices(self) -> list[int]:
        """Places of the identified parameters of the core among all of its parameters."""
        names = [p.name for p in self.core_parameters]
        return [names.index(p.name) for p in self.parameters if p.name in set(names)]

    def owns(self, effect: Effect) -> slice:
        """Where the parameters of an effect stand among the identified ones."""
        names = [p.name for p in self.parameters]
        first = names.index(effect.qualified()[0].name)
        return slice(first, first + len(effect.parameters))

    def with_effect(self, effect: Effect, **settings: float) -> Self:
        """The same model with one more effect."""
        return replace(self, effects=(*self.effects, effect), **settings)  # type: ignore[arg-type]

    def without_effect(self, name: str) -> Self:
        """The same model without the effect of that name."""
        return replace(self, effects=tuple(e for e in self.effects if e.name != name))

    def full(self, values: Floats) -> Floats:
        """Values of the core's parameters, the identified ones among zeros."""
        values = np.asarray(values, dtype=float)
        if values.shape != (len(self.parameters),):
            expected = len(self.parameters)
            raise ShapeError(f"values: expected {expected} numbers, got an array of shape {values.shape}")
        out = np.zeros(len(self.core_parameters))
        out[self.indices] = values[: len(self.indices)]
        return out

    # -- the three methods -------------------------------------------------------------------------------

    def predict(self, data: Measurements, values: Floats) -> Floats:
        """Predicted readings (n, m). Raises :class:`FitError` naming rows out of reach."""
        full = self.full(values)
        block, added = self._own_block(data, full, values)
        out, reached = self.core.predict(full, block)
        self.require(data, np.flatnonzero(~reached & ~data.outlier), values)
        if added is not None:
            out[:, : data.coordinates] += added
        return out

    def derivatives(self, data: Measurements, values: Floats) -> Floats:
        """Derivatives (n, m, p) of the readings by the identified parameters. Raises as :meth:`predict`."""
        full = self.full(values)
        block, _ = self._own_block(data, full, values)
        out, by_joints, by_body, reached = self.core.derivatives(full, block, self.indices)
        self.require(data, np.flatnonzero(~reached & ~data.outlier), values)
        if not self.own:
            return out
        columns = self.own_columns(data, self.rows(data, values), values, by_joints, by_body)
        return np.concatenate([out, *columns], axis=2)

    def covariates(self, data: Measurements) -> dict[str, Floats]:
        """What the residuals may depend on besides the pose: time, directions, every numeric column."""
        out = {} if data.time_s is None else {"time_s": data.time_s}
        return out | dict(data.covariates)

    def rows(self, data: Measurements, values: Floats) -> Rows:
        """The rows as a user's effect sees them, with the position that the built-in model gives."""
        return Rows(data, self.core.predict(self.full(values), self.block(data))[0][:, : data.coordinates])

    def own_columns(
        self, data: Measurements, rows: Rows, values: Floats, by_joints: Floats, by_body: Floats
    ) -> list[Floats]:
        """Derivatives (n, m, p) by the parameters of each of the user's effects."""
        return [
            carry(
                effect,
                effect.columns(rows, np.asarray(values)[self.owns(effect)], axes_of(effect, data)),
                data,
                by_joints,
                by_body,
            )
            for effect in self.own
        ]

    def _own_block(self, data: Measurements, full: Floats, values: Floats) -> tuple[tuple[Any, ...], Floats | None]:
        """The rows with the user's effects at joints and body put in, and what those at the sensor add."""
        if not self.own:
            return self.block(data), None
        rows = self.rows(data, values)
        sums: dict[str, Any] = {
            "joints": np.zeros_like(data.joints),
            "body": np.zeros((len(data), 3)),
            "sensor": np.zeros((len(data), data.coordinates)),
        }
        for effect in self.own:
            sums[effect.link] += effect.evaluate(rows, np.asarray(values)[self.owns(effect)], axes_of(effect, data))
        added = np.where(data.is_distance[:, None], 0.0, sums["sensor"])
        return self.block(data, data.joints + sums["joints"], sums["body"]), added

    # -- errors ------------------------------------------------------------------------------------------

    def require(self, data: Measurements, missing: NDArray[np.int64], values: Floats) -> None:
        """Raises :class:`FitError` for rows that the model cannot reach, with the reason for the first."""
        if len(missing) == 0:
            return
        raise FitError(
            f"{data.place(missing)}: the model cannot reach these joint readings "
            f"({self.reason(data, int(missing[0]), values)}). "
            "Check units and joint order, correct the geometry, or mark the rows as outliers "
            "(column 'outlier' = 1)."
        )

    def starting_at(self, values: Iterable[float] | Floats | None) -> Floats:
        """Start values for the identified parameters; zero, the drawing, by default."""
        if values is None:
            return np.zeros(len(self.parameters))
        start = np.fromiter(values, dtype=float)
        if start.shape != (len(self.parameters),) or not np.isfinite(start).all():
            raise ShapeError(f"start: expected {len(self.parameters)} finite numbers")
        return start


def axes_of(effect: Effect, data: Measurements) -> int:
    """How many numbers a NumPy effect gives for a row at its link: joints, a displacement, or coordinates read."""
    if effect.link == "joints":
        return data.joints.shape[1]
    return 3 if effect.link == "body" else data.coordinates


def carry(effect: Effect, inner: Floats, data: Measurements, by_joints: Floats, by_body: Floats) -> Floats:
    """Derivatives (n, axes, p) of a NumPy effect at its link, carried on to the readings (n, m, p)."""
    if effect.link == "joints":
        return by_joints @ inner
    if effect.link == "body":
        return by_body @ inner
    out = np.zeros((len(data), data.readings.shape[1], inner.shape[2]))
    out[~data.is_distance, : data.coordinates] = inner[~data.is_distance]
    return out


def lacks(effect: Effect, data: Measurements) -> tuple[str, ...]:
    """Covariates that an effect needs and a run does not have."""
    out = []
    for need in effect.needs:
        if need == "time_s":
            known = data.time_s is not None
        elif need == "direction":
            known = bool(np.isfinite(data.direction).all())
        else:
            known = need in data.covariates
        if not known:
            out.append(need)
    return tuple(out)


def effects_by_name(
    catalogue: Mapping[str, Effect], names: Sequence[str], own: Sequence[Effect] = ()
) -> tuple[Effect, ...]:
    """Effects of a catalogue and the user's by name. Raises :class:`EffectError` with the nearest name."""
    known = {**catalogue, **{e.name: e for e in own}}
    for effect in own:
        if effect.name in catalogue:
            raise EffectError(f"'{effect.name}' is the name of a built-in effect; give yours another")
    out = []
    for name in names:
        if name == "datum":
            raise EffectError("'datum' is in the model already: it belongs to the default model")
        if name not in known:
            raise EffectError(f"'{name}' is not a known effect{nearest(name, known)}; known: {listed(known, 30)}")
        out.append(known[name])
    return tuple(out)
