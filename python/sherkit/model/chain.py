"""A robot whose measurement chain is compiled: what is free, predicted readings, their derivatives.

The chain itself (kinematics, effects, exact derivatives) runs in Rust; here are the names. A robot is a subclass that
says which parameters its core has and how rows are handed to it.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

import sherkit._core as _core

from ..base.figures import listed, nearest
from ..base.types import Bools, Floats
from ..data import Measurements
from ..data.columns import TEMPERATURE, Layout, unit_in
from ..errors import EffectError, FitError, ShapeError
from .base import CandidateColumns, Derivatives, Reachable, column_slices, missing_columns
from .effect import WITHIN, Effect, Parameter, Setting, effects_of_row, freeing, parameters_of_core
from .own_effects import EffectColumns, InnerColumns, ModelColumns, added_to, by_ends, carry
from .rows import EffectRows
from .seen import SeenModel

#: Joints (n, k), other ends of distances, covariates (n, 3 + 2 k), displacements of the measured point (n, 3).
Block = tuple[Floats, Floats | None, Floats | None, Floats | None]

#: The setting that says by how much the stands are behind the room, s.
STAND_LAG = "thermal_shift_lag_s"
#: Digits of what a person is asked to drive to, by unit: of targets, and of joints, finer than any encoder stops at.
_TARGET_DIGITS = {"mm": 1, "rad": 3}
_JOINT_DIGITS = {"mm": 3, "rad": 5}
#: Part of its size by which a workspace may be left: a robot that is not as drawn stands a little elsewhere.
SLACK = 0.05


@dataclass(frozen=True)
class ChainModel(SeenModel):
    """A nominal robot with named errors and effects to identify.

    ``free`` names the geometric errors and numbers of the sensor's pose to identify; left out, those of
    :attr:`default`. All parameters of ``effects`` are free. Readings have the columns of the rows' layout.
    """

    robot: Any
    free: tuple[str, ...] = ()
    effects: tuple[Effect, ...] = ()

    inputs_known: ClassVar[bool] = True
    within: ClassVar = WITHIN
    #: The built-in effects of this kind of robot by name, in the order of the chain.
    catalogue: ClassVar[Mapping[str, Effect]]
    #: Whether the robot's file says at which joints a place is reached; an arm leaves open how it stands there.
    one_posture: ClassVar[bool] = True
    #: The compiled table: every row of parameters with names, units, sizes and levers, in the order of the core.
    table: ClassVar[Sequence[Mapping[str, Any]]]
    #: The kinds of run that show this robot.
    layouts: ClassVar[tuple[Layout, ...]]
    #: The coordinates of its kinematics, as columns: where it is sent.
    targets: ClassVar[tuple[str, ...]] = ()

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
        for effect in self.effects:
            if effect.goes_with and effect.goes_with not in names:
                raise EffectError(f"'{effect.name}' goes with '{effect.goes_with}', which is not in the model")
            if effect.is_periodic and self.setting_of(effect) is None:
                give = f"give {self.period_in_file} in the robot file, or " if self.period_in_file else ""
                raise EffectError(
                    f"'{effect.name}' needs the period of the encoders: {give}leave the effect to a diagnosis or a "
                    "study, which search for it"
                )
        for effect in (one for one in self.known_effects.values() if one.is_periodic):
            own, count = self.setting_of(effect), len(effect.parameters) // 2
            if isinstance(own, tuple) and len(own) != count:
                what = f"expected one number, or {count}, one for each joint; found {len(own)}"
                raise EffectError(f"{effect.search}: {what}")

    # -- what a robot says ---------------------------------------------------------------------------------

    @abstractmethod
    def lever_mm(self, name: str) -> float:
        """What one unit of a parameter of :attr:`base` moves in this robot, where the table does not say it."""

    @property
    @abstractmethod
    def default(self) -> tuple[str, ...]:
        """Names of the parameters that are free unless others are named."""

    @property
    @abstractmethod
    def core(self) -> Any:
        """The compiled chain."""

    def core_for(self, data: Measurements) -> Any:
        """The compiled chain for the readings that these rows hold."""
        del data
        return self.core

    def drawn(self, data: Measurements) -> tuple[Floats, Bools]:
        """What the chain reads as drawn (n, m), and which rows could be computed."""
        made: tuple[Floats, Bools] = self.core_for(data).predict(np.zeros(len(self.core_parameters)), self.block(data))
        return made

    def block(self, data: Measurements, joints: Floats | None = None, push: Floats | None = None) -> Block:
        """The rows as the core takes them, with other ``joints`` (n, k) and a displacement ``push`` (n, 3) if given."""
        self.require_own(data)
        covariates = None
        if any(effect.needs for effect in self.built_in):
            empty = np.full(len(data), np.nan)
            known = data.covariates
            velocities = [known.get(name, empty) for name in data.layout.velocities]
            velocities += [empty] * (data.joints.shape[1] - len(velocities))
            time = empty if data.time_s is None else data.time_s
            lag = self.settings().get(STAND_LAG)
            stand = data.later(lag if isinstance(lag, float) else 0.0)
            columns = [time, known.get(TEMPERATURE, empty), data.came_from, *velocities]
            columns.append(empty if stand is None else stand)
            covariates = np.ascontiguousarray(np.column_stack(columns))
        return (data.joints if joints is None else joints, data.distances_or_none, covariates, push)

    @abstractmethod
    def reason(self, data: Measurements, row: int, values: Floats) -> str:
        """Why a row cannot be reached."""

    # -- where it can be sent ------------------------------------------------------------------------------

    def grid(self, data: Measurements) -> Floats | None:
        """Coordinates (k, c) over the workspace, or over where the run was; None where that is not known."""
        del data
        return None

    def stands(self, rows: Measurements, values: Floats) -> tuple[Floats, Bools]:
        """Coordinates (k, c) of the identified robot at the joints of these rows, and which of them can be read.

        By default the readings, seen from the base.
        """
        found, reached = self.core_for(rows).predict(self.full(values), self.block(rows))
        return self.at_base(found[:, : rows.coordinates], values)[:, : len(self.targets)], reached

    def allowed(self, coordinates: Floats, slack: float = SLACK) -> Bools:
        """Which coordinates (k, c) lie in the workspace, give or take what a robot is off by, a part ``slack`` of its
        size; all unless it has one."""
        return np.ones(len(coordinates), dtype=bool)

    def joint_ranges(self) -> dict[str, tuple[float, float]]:
        """Limits that are the same for all joints."""
        limits = self.robot.joint_limits
        return {} if limits is None else dict.fromkeys(self.layouts[0].joints, limits)

    def reachable(self, data: Measurements, values: Floats) -> Reachable | None:
        """A grid of poses within joint limits and the workspace, by the drawing and by the identified robot.

        Targets are rounded to what a person would type, each of them once; the joints are the drawing's for them.
        """
        grid = self.grid(data)
        if grid is None or not self.targets:
            return None
        digits = _TARGET_DIGITS.get(unit_in(self.targets[0]), 3)
        targets = np.unique(np.round(grid, digits), axis=0)
        there = self.robot.inverse_batch(targets)
        joints = np.round(there.values, _JOINT_DIGITS.get(self.robot.joint_unit, 5))
        within = there.reached
        if self.robot.joint_limits is not None:
            low, high = self.robot.joint_limits
            within = within & ((joints >= low) & (joints <= high)).all(axis=1)
        targets, joints = targets[within], joints[within]
        if len(joints):
            found, reached = self.stands(data.unmeasured(joints), values)
            within = reached & self.allowed(found)
            targets, joints = targets[within], joints[within]
        if not len(joints):
            return None
        return Reachable(dict(zip(self.targets, targets.T, strict=True)), data.unmeasured(joints))

    def readable(self, data: Measurements) -> tuple[Layout, ...]:
        """Every kind of run that shows this robot, that of these rows first."""
        return (data.layout, *(one for one in self.layouts if one != data.layout))

    def require_own(self, data: Measurements) -> None:
        """Raises :class:`~sherkit.errors.FitError` for a run of another kind of robot."""
        if data.layout not in self.layouts:
            ways = " or ".join(", ".join(one.coordinates) for one in self.layouts)
            raise FitError(
                f"{data.source}: is no run of a {self.robot.kind} robot: expected the columns "
                f"{', '.join(self.layouts[0].joints)} with {ways}, found {', '.join(data.layout.joints)} with "
                f"{', '.join(data.layout.coordinates)}"
            )

    # -- parameters --------------------------------------------------------------------------------------

    @cached_property
    def base(self) -> tuple[Parameter, ...]:
        """Geometric errors, the sensor's pose and the like: what ``free`` chooses from, in the order of the core."""
        return tuple(self.as_known(p) for p in self.unstated_base())

    def unstated_base(self) -> Iterable[Parameter]:
        """As of any model."""
        return (p for row in self.table if row["base"] for p in parameters_of_core(row, self.lever_mm))

    @cached_property
    def core_parameters(self) -> tuple[Parameter, ...]:
        """Every parameter of the compiled chain, in its order."""
        base = {p.name: p for p in self.base}
        out: list[Parameter] = []
        for row in self.table:
            if row["base"]:
                out += (base[p["name"]] for p in row["parameters"])
            else:
                out += (p for effect in effects_of_row(self.catalogue, row["name"]) for p in effect.qualified())
        return tuple(out)

    @cached_property
    def of_sensor(self) -> frozenset[str]:
        """Names of those of :attr:`core_parameters` that are the instrument's: where it stands, and what it shows."""
        rows = [row for row in self.table if row["link"] == "sensor"]
        return frozenset(
            p["name"] if row["base"] else f"{row['name']}.{p['name']}" for row in rows for p in row["parameters"]
        )

    @cached_property
    def bare(self) -> tuple[Parameter, ...]:
        """Those that ``free`` names."""
        by_name = {p.name: p for p in self.base}
        return tuple(by_name[n] for n in self.free)

    @property
    def fixed(self) -> tuple[Parameter, ...]:
        """Geometric errors and numbers of the sensor's pose that ``free`` does not name."""
        freed = {p.name for p in self.parameters}
        return tuple(p for p in self.base if p.name not in freed)

    @cached_property
    def held(self) -> Mapping[str, Effect]:
        """Of what is held those that are free unless others are named: the rest says the same once more."""
        made = (freeing(p) for p in self.base if p.name in self.default and p.name not in self.free)
        return {effect.name: effect for effect in made}

    def adopting(self, effect: Effect, *, at: Setting | None = None) -> Self:
        """As of any model."""
        if effect.frees:
            return replace(self, free=(*self.free, *(p.name for p in effect.parameters)))
        return self.with_effect(effect, at=at)

    @property
    def known_effects(self) -> Mapping[str, Effect]:
        """The catalogue of this kind of robot."""
        return self.catalogue

    @property
    def may_be_off(self) -> Mapping[str, Effect]:
        """What a promise counts with that no reading has shown: the catalogue, and numbers of the file that no drawing
        has exactly."""
        return self.known_effects

    @property
    def sensitivities(self) -> tuple[Floats, str]:
        """The millimetres that each parameter moves in this robot."""
        return np.array([p.lever_mm for p in self.parameters]), "mm"

    @cached_property
    def indices(self) -> list[int]:
        """Places of the identified parameters of the core among all of its parameters."""
        names = [p.name for p in self.core_parameters]
        return [names.index(p.name) for p in self.parameters if p.name in set(names)]

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
        out, reached = self.core_for(data).predict(full, block)
        self.require(data, np.flatnonzero(~reached & ~data.outlier), values)
        if added is not None:
            out[:, : data.coordinates] += added
        return out

    def parts(self, data: Measurements, values: Floats) -> Floats:
        """Points (n, k, 3) of the mechanism's parts, mm, base frame, in the order of its core; the last is the measured
        point. Raises :class:`FitError` naming rows out of reach."""
        full = self.full(values)
        out, reached = self.core_for(data).parts(full, self._own_block(data, full, values)[0])
        self.require(data, np.flatnonzero(~reached), values)
        return np.asarray(out)

    def derivatives(self, data: Measurements, values: Floats) -> Floats:
        """Derivatives (n, m, p) of the readings by the identified parameters. Raises as :meth:`predict`."""
        full = self.full(values)
        block, _ = self._own_block(data, full, values)
        if not self.own:
            out, _, _, reached = self.core_for(data).derivatives(full, block, self.indices)
            self.require(data, np.flatnonzero(~reached & ~data.outlier), values)
            return out
        out, *by, reached = by_ends(self, data, full, block, self.indices)
        self.require(data, np.flatnonzero(~reached & ~data.outlier), values)
        inner = InnerColumns(self, data, np.asarray(values)).of_model()
        columns = [carry(e, one, data.coordinates, *by) for e, one in inner]
        return np.concatenate([out, *columns], axis=2)

    def covariates(self, data: Measurements) -> dict[str, Floats]:
        """What the residuals may depend on besides the pose: time, directions, every numeric column."""
        out = {} if data.time_s is None else {"time_s": data.time_s}
        return out | dict(data.covariates)

    def place(self, data: Measurements, predicted: Floats, values: Floats | None = None) -> dict[str, Floats]:
        """The coordinates that the model gives, seen from the base; where a distance was read, those that the drawing
        does."""
        places, far = predicted[:, : data.coordinates], data.is_distance
        if values is not None and self.reads_places(data):
            places = self.at_base(places, values)
        if far.any():
            joints, _, covariates, push = self.block(data.select(far))
            core = self.core_for(data)
            drawn, _ = core.predict(np.zeros(len(self.core_parameters)), (joints, None, covariates, push))
            places = places.copy()
            places[far] = drawn[:, : data.coordinates]
        return {name: places[:, k] for k, name in enumerate(data.layout.coordinates)}

    def axes_of(self, effect: Effect, data: Measurements) -> int:
        """What a NumPy effect gives at its link: joints, a displacement, or coordinates read."""
        if effect.link == "joints":
            return data.joints.shape[1]
        return 3 if effect.link == "body" else data.coordinates

    def rows(self, data: Measurements, values: Floats) -> EffectRows:
        """The rows, with the position that the built-in model gives, as the instrument sees it or from the base. It
        raises as :meth:`predict`; of outliers out of reach it is NaN."""

        def position() -> Floats:
            full = self.full(values)
            joints, _, *known = self.plain_block(data)
            out, reached = self.core_for(data).predict(full, (joints, None, *known))
            self.require(data, np.flatnonzero(~reached & ~data.outlier), values)
            return out[:, : data.coordinates]

        return EffectRows(data, position, partial(self.at_base, values=values) if self.reads_places(data) else None)

    def linearised(self, data: Measurements, values: Floats) -> Derivatives:
        """All at once by the core; the user's effects carried from their link to the readings."""
        return self.linearised_by_blocks(data, values)(slice(0, len(data)))

    def linearised_by_blocks(self, data: Measurements, values: Floats) -> Callable[[slice], Derivatives]:
        """The core computes each stretch; the user's effects are computed once, at their link."""
        values = np.asarray(values)
        return ModelColumns(self, data, values, InnerColumns(self, data, values).of_model())

    def tried(self, data: Measurements, values: Floats, effects: Sequence[Effect]) -> CandidateColumns:
        """Likewise; of the core only what is tried is asked."""
        everything = self
        for effect in (built_in := [e for e in effects if e.function is None]):
            time = data.time_s if effect.search == "time_s" else None
            everything = everything.with_effect(effect, at=None if time is None else float(time.min()))
        known = dict(zip((p.name for p in self.parameters), values.tolist(), strict=True))
        start = np.array([known.get(p.name, 0.0) for p in everything.parameters])
        inner, tried, refused = InnerColumns(everything, data, start), [], {}
        for effect in effects:
            if effect.function is None:
                continue
            try:
                tried.append((effect, inner.at_zero(effect)))
            except EffectError as error:
                refused[effect.name] = str(error)
        widths = [(e, len(e.parameters)) for e in (*built_in, *(effect for effect, _ in tried))]
        reads_point = int(data.taken[:, : data.coordinates].any(axis=0).sum()) == 3
        columns = EffectColumns(everything, data, start, built_in, tried)
        return CandidateColumns(columns, column_slices(widths), refused, reads_point)

    def plain_block(self, data: Measurements) -> tuple[Any, ...]:
        """The rows as they are, as the core takes them; those asked for last are remembered."""
        last = self.__dict__.get("_last_block")
        if last is None or last[0] is not data:
            last = self.__dict__["_last_block"] = (data, self.block(data))
        return last[1]

    def _own_block(self, data: Measurements, full: Floats, values: Floats) -> tuple[tuple[Any, ...], Floats | None]:
        """The rows with the user's effects at joints and body put in, and what those at the sensor add."""
        if not self.own:
            return self.plain_block(data), None
        moved, push, read = added_to(self, data, values)
        block = self.block(data, data.joints + moved, push)
        added = np.where(data.is_distance[:, None], 0.0, read)
        far = data.between_places[:, None]
        if not far.any():
            return block, added
        there, other, _ = added_to(self, data.from_other_end, values)
        return (block[0], data.to_joints + there, block[2], push - np.where(far, other, 0.0)), added

    # -- the fast path -------------------------------------------------------------------------------------

    def solve(self, solver: _core.Solver, data: Measurements, weights: Floats) -> str:
        """Runs the solver to its end in the core, without effects given in NumPy: ``converged`` or ``exhausted``.

        Raises :class:`FitError` for rows out of reach at the start.
        """
        start = solver.trial
        ended, missing = self.core_for(data).solve(
            solver, np.zeros(len(self.core_parameters)), self.indices, self.plain_block(data), data.readings, weights,
        )  # fmt: skip
        self.require(data, np.array(missing, dtype=np.int64), start)
        return str(ended)

    def accumulate(self, solver: _core.Solver, data: Measurements, weights: Floats) -> None:
        """Gives the solver these rows at its trial, without effects given in NumPy. Raises as :meth:`predict`."""
        missing = self.core_for(data).accumulate(
            solver, np.zeros(len(self.core_parameters)), self.indices, self.block(data), data.readings, weights
        )
        self.require(data, np.array(missing, dtype=np.int64), solver.trial)

    # -- errors ------------------------------------------------------------------------------------------

    def require(self, data: Measurements, missing: NDArray[np.int64], values: Floats) -> None:
        """Raises :class:`FitError` for rows that the model cannot reach, with the reason for the first."""
        if len(missing) == 0:
            return
        needed = {e.name: absent for e in self.effects if (absent := missing_columns(e, data))}
        if needed:
            columns = dict.fromkeys(column for absent in needed.values() for column in absent)
            order = ", or time_s, whose order tells it" if "direction" in columns else ""
            raise FitError(
                f"{data.source}: {listed(needed)}, in the model, cannot be computed without the column "
                f"{listed(columns)}{order}: give it, or leave out the effect"
            )
        raise FitError(
            f"{data.place(missing)}: the model cannot reach these joint readings "
            f"({self.reason(data, int(missing[0]), values)}). "
            "Check units and joint order, correct the geometry, or mark the rows as outliers "
            "(column 'outlier' = 1)."
        )
