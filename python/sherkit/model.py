"""Model of a robot for identification: which errors and effects are free, predicted readings, their derivatives."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from . import _core
from .effects import CATALOGUE, Effect
from .effects.catalogue import CORE_ORDER
from .errors import EffectError, FitError, ShapeError, SherkitError
from .measurements import Measurements
from .measurements.columns import TEMPERATURE
from .names import listed, nearest
from .parameters import Parameter
from .robots.delta import LIMB_PARAMETERS, Delta
from .rows import Rows

Floats = NDArray[np.float64]
Block = tuple[Floats, Floats | None, Floats | None, Floats | None]

#: Plausible sizes of errors of a machined and assembled delta, mm and rad: the order of the paper's Table II.
_SIZES = {
    "base_radius": 3.0,
    "base_angle": float(np.deg2rad(1.0)),
    "joint_offset": 2.0,
    "rod_length": 2.0,
    "platform_radius": 1.0,
    "platform_angle": float(np.deg2rad(1.0)),
}
_SUBSCRIPTS = "₁₂₃"


@dataclass(frozen=True)
class DeltaModel:
    """A nominal delta with named errors and effects to identify.

    ``free`` names the geometric errors and datum to identify: by default the paper's twelve (Eq. 9) and the datum
    of the sensors. The platform's radii and angles can be freed as well; they are exactly dependent on the base's.
    All parameters of ``effects`` are free. ``period_mm``, ``slip_time_s`` and ``time_origin_s`` are the settings of
    the effects that have one. Readings have four columns: x, y, z, distance.
    """

    robot: Delta
    free: tuple[str, ...] = ()
    effects: tuple[Effect, ...] = ()
    period_mm: float | None = None
    slip_time_s: float = 0.0
    time_origin_s: float = 0.0

    def __post_init__(self) -> None:
        known = [p.name for p in self._base]
        if not self.free:
            object.__setattr__(self, "free", tuple(n for n in known if not n.startswith("platform")))
        for name in self.free:
            if name not in known:
                raise FitError(f"'{name}' is not a parameter of this robot{nearest(name, known)}")
        if len(set(self.free)) < len(self.free):
            raise FitError(f"a parameter is freed twice: {listed(self.free, 24)}")
        names = [e.name for e in self.effects]
        if len(set(names)) < len(names):
            raise EffectError(f"an effect is added twice: {listed(names, 24)}")

    # -- parameters --------------------------------------------------------------------------------------

    @cached_property
    def _base(self) -> tuple[Parameter, ...]:
        """Geometric errors and datum: the parameters that ``free`` chooses from."""
        r = self.robot
        levers = {"base_angle": r.base_radius_mm, "platform_angle": r.platform_radius_mm}
        out = []
        for limb in range(3):
            for name, symbol in LIMB_PARAMETERS:
                angle = name.endswith("angle")
                lever = levers[name][limb] if angle else 1.0
                unit = "rad" if angle else "mm"
                out.append(
                    Parameter(f"{name}_{limb + 1}", f"{symbol}{_SUBSCRIPTS[limb]}", unit, _SIZES[name], lever or 1.0)
                )
        datum = CATALOGUE["datum"].parameters
        out += [Parameter(f"datum_{a}", f"d_{a}", "mm", p.size) for a, p in zip("xyz", datum, strict=True)]
        return tuple(out)

    @cached_property
    def core_parameters(self) -> tuple[Parameter, ...]:
        """Every parameter of the compiled chain, in its order."""
        return self._base + tuple(p for e in CORE_ORDER[1:] for p in e.qualified())

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
        by_name = {p.name: p for p in self._base}
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

    def with_effect(self, effect: Effect, **settings: float) -> DeltaModel:
        """The same model with one more effect."""
        return replace(self, effects=(*self.effects, effect), **settings)  # type: ignore[arg-type]

    def without_effect(self, name: str) -> DeltaModel:
        """The same model without the effect of that name."""
        return replace(self, effects=tuple(e for e in self.effects if e.name != name))

    # -- the core ----------------------------------------------------------------------------------------

    @cached_property
    def core(self) -> _core.DeltaModel:
        """The compiled model."""
        r = self.robot
        pitch = self.period_mm or r.pole_pitch_mm or 1.0
        settings = [r.rod_spacing_mm, pitch, *self.home_mm, self.time_origin_s, self.slip_time_s]
        offset = np.array(r.target_offset_mm)
        return _core.DeltaModel(r.geometry, offset, r.assembly_mode, np.array(settings, dtype=float))

    @cached_property
    def home_mm(self) -> tuple[float, float, float]:
        """Joint readings of the home position, where the measured point is at zero, or as near as can be."""
        try:
            q = self.robot.inverse((0.0, 0.0, 0.0))
        except SherkitError:
            # a robot whose frame lies elsewhere: the rods' rise over their widest span
            q = np.array(self.robot.rod_length_mm)
        return (float(q[0]), float(q[1]), float(q[2]))

    def block(self, data: Measurements, joints: Floats | None = None, push: Floats | None = None) -> Block:
        """The rows as the core takes them."""
        covariates = None
        if self.built_in:
            empty = np.full(len(data), np.nan)
            time = empty if data.time_s is None else data.time_s
            temperature = data.covariates.get(TEMPERATURE, empty)
            covariates = np.ascontiguousarray(np.column_stack([time, temperature, data.direction]))
        return (data.joints_mm if joints is None else joints, data.distances_or_none, covariates, push)

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
        """Predicted readings (n, 4), mm. Raises :class:`FitError` naming rows out of reach."""
        full = self.full(values)
        block, added = self._own_block(data, full, values)
        out, reached = self.core.predict(full, block)
        self.require(data, np.flatnonzero(~reached & ~data.outlier), values)
        if added is not None:
            out[:, :3] += added
        return out

    def derivatives(self, data: Measurements, values: Floats) -> Floats:
        """Derivatives (n, 4, p) of the readings by the identified parameters. Raises as :meth:`predict`."""
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
        return Rows(data, self.core.predict(self.full(values), self.block(data))[0][:, :3])

    def own_columns(
        self, data: Measurements, rows: Rows, values: Floats, by_joints: Floats, by_body: Floats
    ) -> list[Floats]:
        """Derivatives (n, 4, p) by the parameters of each of the user's effects."""
        return [
            carry(effect, effect.columns(rows, np.asarray(values)[self.owns(effect)]), data, by_joints, by_body)
            for effect in self.own
        ]

    def _own_block(self, data: Measurements, full: Floats, values: Floats) -> tuple[Block, Floats | None]:
        """The rows with the user's effects at joints and body put in, and what those at the sensor add."""
        if not self.own:
            return self.block(data), None
        rows = self.rows(data, values)
        sums = {link: np.zeros((len(data), 3)) for link in ("joints", "body", "sensor")}
        for effect in self.own:
            sums[effect.link] += effect.evaluate(rows, np.asarray(values)[self.owns(effect)])
        added = np.where(data.is_distance[:, None], 0.0, sums["sensor"])
        return self.block(data, data.joints_mm + sums["joints"], sums["body"]), added

    # -- errors ------------------------------------------------------------------------------------------

    def require(self, data: Measurements, missing: NDArray[np.int64], values: Floats) -> None:
        """Raises :class:`FitError` for rows that the model cannot reach, with the reason for the first."""
        if len(missing) == 0:
            return
        ends = [data.joints_mm[missing[0]], data.to_joints_mm[missing[0]]]
        names = self.robot.parameter_names
        errors = dict(zip(names, self.full(values)[: len(names)], strict=True))
        reason = "the geometry leaves no robot"
        try:
            kinematics = self.robot.kinematics(errors)
            for joints in ends:
                if np.isfinite(joints).all():
                    kinematics.forward(joints)
            reason = "an effect that is at work needs a column that these rows lack"
        except SherkitError as error:
            reason = str(error)
        raise FitError(
            f"{data.place(missing)}: the model cannot reach these joint readings ({reason}). "
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


def carry(effect: Effect, inner: Floats, data: Measurements, by_joints: Floats, by_body: Floats) -> Floats:
    """Derivatives (n, 3, p) of a NumPy effect at its link, carried on to the readings (n, 4, p)."""
    if effect.link == "joints":
        return by_joints @ inner
    if effect.link == "body":
        return by_body @ inner
    out = np.zeros((len(data), 4, inner.shape[2]))
    out[~data.is_distance, :3] = inner[~data.is_distance]
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


def effects_by_name(names: Sequence[str], own: Sequence[Effect] = ()) -> tuple[Effect, ...]:
    """Effects of the catalogue and the user's by name. Raises :class:`EffectError` with the nearest name."""
    known = {**CATALOGUE, **{e.name: e for e in own}}
    for effect in own:
        if effect.name in CATALOGUE:
            raise EffectError(f"'{effect.name}' is the name of a built-in effect; give yours another")
    out = []
    for name in names:
        if name == "datum":
            raise EffectError("'datum' is in the model already: it belongs to the default model")
        if name not in known:
            raise EffectError(f"'{name}' is not a known effect{nearest(name, known)}; known: {listed(known, 30)}")
        out.append(known[name])
    return tuple(out)
