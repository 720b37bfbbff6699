"""A model that effects can be added to: what robots with a compiled chain and any other machine share."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar, Protocol, Self

import numpy as np

from ..base.figures import listed
from ..base.notebook import Saved
from ..base.types import Floats, Ints
from ..data import Measurements
from ..data.columns import Layout
from ..errors import EffectError, ShapeError
from .effect import Effect, Parameter, Setting, check_user_effect
from .rows import EffectRows
from .tolerances import Apart

#: Plausible sizes of where an instrument stands that are as good as none: ten metres, any turn.
_ANYWHERE = 1e3


@dataclass(frozen=True, eq=False)
class Derivatives:
    """Derivatives of the readings of some rows: ``parameters`` (n, m, p) by what the model identifies, ``inputs``
    (n, m, k) by the inputs, None where they are not known; where distances between places are among the rows, by the
    inputs at their first ends, then by those at the others (n, m, 2 k)."""

    parameters: Floats
    inputs: Floats | None

    def on(self, rows: slice | Ints) -> Derivatives:
        """Those of these rows."""
        return Derivatives(self.parameters[rows], None if self.inputs is None else self.inputs[rows])


@dataclass(frozen=True, eq=False)
class CandidateColumns:
    """Derivatives of the readings by effects that are not in the model.

    ``columns`` gives those of any stretch of rows (b, m, c), by the parameters of all of them at zero, those of a step
    at a searched time as they are after it; ``effects`` pairs each effect with its own among them; ``refused`` maps
    effects that could not be computed to the reason; ``reads_point`` says whether the readings are the coordinates of
    the measured point.
    """

    columns: Callable[[slice], Floats]
    effects: Sequence[tuple[Effect, slice]]
    refused: dict[str, str]
    reads_point: bool = True


def column_slices(widths: Iterable[tuple[Effect, int]]) -> list[tuple[Effect, slice]]:
    """Where the columns of effects stand, each so many, one after the other."""
    at, out = 0, []
    for effect, width in widths:
        out.append((effect, slice(at, at + width)))
        at += width
    return out


@dataclass(frozen=True, eq=False)
class Reachable:
    """Poses that a machine can be sent to: ``targets`` are the coordinates (k,) of its kinematics by name, as a plan
    takes them; ``rows`` (k) are those that would be read there, with the joints to drive to."""

    targets: Mapping[str, Floats]
    rows: Measurements


class InSockets(Protocol):
    """Rows of a run at which the measured point is known to be somewhere, though a length alone was read."""

    @property
    def rows(self) -> Ints:
        """Which rows (k,)."""
        ...

    def at(self, values: Floats) -> tuple[Floats, Floats]:
        """How far the point is from there (k, 3), mm, with derivatives (k, 3, p). Raises as ``predict``."""
        ...


class ModelWithEffects(Saved, ABC):
    """A model of a machine, and the effects in it.

    Its parameters are its own, then those of its built-in effects, then those of the user's. Subclasses are frozen
    dataclasses with the field ``effects``. ``robot`` is the nominal robot, None for a machine that is not known.
    """

    robot: Any
    effects: tuple[Effect, ...]

    #: Whether it says how readings answer to an error of an input.
    inputs_known: ClassVar[bool] = False
    #: Effects that are among the model's own parameters.
    within: ClassVar[frozenset[str]] = frozenset()
    #: Where a robot's file gives the period of its encoders; empty where it has no place for it.
    period_in_file: ClassVar[str] = ""
    #: What makes waves of joints in such a machine, where it is one thing.
    waves_are: ClassVar[str] = ""
    #: Where a robot's file declares an error of the readings that repeats of a pose share; empty as above.
    pose_sigma_in_file: ClassVar[str] = ""

    # -- what a model says -------------------------------------------------------------------------------

    @property
    @abstractmethod
    def bare(self) -> tuple[Parameter, ...]:
        """The identified parameters without those of effects."""

    @property
    @abstractmethod
    def known_effects(self) -> Mapping[str, Effect]:
        """The effects that are known of this machine, by name: diagnosis tries them without being asked."""

    @abstractmethod
    def predict(self, data: Measurements, values: Floats) -> Floats:
        """Predicted readings (n, m). Raises :class:`~sherkit.errors.FitError` for rows that cannot be computed."""

    @abstractmethod
    def derivatives(self, data: Measurements, values: Floats) -> Floats:
        """Derivatives (n, m, p) of the readings by the identified parameters. Raises as :meth:`predict`."""

    @abstractmethod
    def covariates(self, data: Measurements) -> dict[str, Floats]:
        """What the residuals may depend on besides the place, (n,) each."""

    def axes_of_readings(self, data: Measurements, values: Floats) -> Floats | None:
        """The turn (c, c) from the axes of :meth:`place` to those of the readings; None where they are the same."""
        return None

    @abstractmethod
    def place(self, data: Measurements, predicted: Floats, values: Floats | None = None) -> dict[str, Floats]:
        """Where the machine was at each row, (n,) by name; ``predicted`` (n, m) are the readings of the model with
        these ``values`` (p,), by which places are seen from the base where a sensor stands elsewhere."""

    @abstractmethod
    def axes_of(self, effect: Effect, data: Measurements) -> int:
        """How many numbers a NumPy effect gives for a row."""

    @abstractmethod
    def rows(self, data: Measurements, values: Floats) -> EffectRows:
        """The rows as a user's effect sees them."""

    @abstractmethod
    def linearised(self, data: Measurements, values: Floats) -> Derivatives:
        """Derivatives by what is identified and by the inputs."""

    @abstractmethod
    def tried(self, data: Measurements, values: Floats, effects: Sequence[Effect]) -> CandidateColumns:
        """Derivatives by effects that are not in the model: effects see all rows, so that stretches are parts of one
        whole."""

    def linearised_by_blocks(self, data: Measurements, values: Floats) -> Callable[[slice], Derivatives]:
        """:meth:`linearised` for any stretch of the rows: what gives them, without all of them at once where that is
        possible. Effects see all rows, so that stretches are parts of one whole."""
        return self.linearised(data, values).on

    @property
    @abstractmethod
    def sensitivities(self) -> tuple[Floats, str]:
        """What turns each parameter (p,) into one common unit, and that unit, so that they can be compared."""

    @property
    def fixed(self) -> tuple[Parameter, ...]:
        """Parameters that could be identified and are not: they stay at zero."""
        return ()

    @property
    def held(self) -> Mapping[str, Effect]:
        """What is held at the drawing and could be told from the rest, by name: candidates like effects."""
        return {}

    def adopting(self, effect: Effect, *, at: Setting | None = None) -> Self:
        """The model with one more effect, as a person has it; what was held and is freed is a parameter like others."""
        return self.with_effect(effect, at=at)

    def settings(self) -> Mapping[str, Setting | None]:
        """Settings of the effects that are no parameters: what :meth:`with_effect` takes besides the effect."""
        return {}

    @property
    def given_periods(self) -> Mapping[str, float]:
        """Periods of waves that the machine's file says, by the column of the joint, in its unit."""
        return {}

    def reachable(self, data: Measurements, values: Floats) -> Reachable | None:
        """Poses that could be measured next with these parameters; None where that is not known."""
        del data, values
        return None

    def ranges(self, data: Measurements) -> dict[str, tuple[float, float]]:
        """Where readings begin and end, by column, such as the first and the last pixel of a picture; mirrored, one is
        counted from its other end."""
        del data
        return {}

    def joint_ranges(self) -> dict[str, tuple[float, float]]:
        """Lowest and highest reading of each joint by column, in its unit, where the machine's file says them."""
        return {}

    def as_declared(self, data: Measurements) -> Measurements:
        """The rows with the errors of each pose that the machine's file declares, where they declare none themselves;
        as they are, unless a machine has such a file."""
        return data

    def readable(self, data: Measurements) -> tuple[Layout, ...]:
        """Runs that the model can predict: what was read, and what else could be."""
        return (data.layout,)

    # -- parameters --------------------------------------------------------------------------------------

    @cached_property
    def built_in(self) -> tuple[Effect, ...]:
        """The effects that the core computes."""
        return tuple(e for e in self.effects if e.function is None)

    @cached_property
    def own(self) -> tuple[Effect, ...]:
        """The effects that are given in NumPy."""
        return tuple(e for e in self.effects if e.function is not None)

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """The identified parameters: the model's own, those of the built-in effects, those of the user's."""
        return (*self.bare, *(p for e in (*self.built_in, *self.own) for p in e.qualified()))

    def owns(self, effect: Effect) -> slice:
        """Where the parameters of an effect stand among the identified ones."""
        names = [p.name for p in self.parameters]
        first = names.index(effect.qualified()[0].name)
        return slice(first, first + len(effect.parameters))

    def start(self, data: Measurements) -> Floats:
        """Values (p,) from which these rows are fitted where nobody says others: zero, the drawing, unless a model can
        tell by the rows themselves."""
        del data
        return np.zeros(len(self.parameters))

    def starting_at(self, values: Iterable[float] | Floats | None) -> Floats:
        """Start values for the identified parameters; zero, the drawing, by default."""
        if values is None:
            return np.zeros(len(self.parameters))
        given = np.array(values if isinstance(values, np.ndarray) else list(values))
        start = given.astype(float) if given.dtype.kind in "iuf" else np.zeros(0)
        if start.shape != (len(self.parameters),) or not np.isfinite(start).all():
            raise ShapeError(f"start: expected {len(self.parameters)} finite numbers")
        return start

    # -- effects -----------------------------------------------------------------------------------------

    def with_effect(self, effect: Effect, *, at: Setting | None = None, **settings: float) -> Self:
        """The same model with one more effect. ``at`` is the setting that is searched for besides its parameters: a
        moment, a period, or a period for each joint of those that have waves; other ``settings`` are by name. What goes
        with another effect brings that, too."""
        if effect.goes_with and effect.goes_with not in {one.name for one in self.effects}:
            return self.with_effect(self.known_effects[effect.goes_with], at=at).with_effect(effect, **settings)
        made = self if at is None else self.with_settings(effect, at)
        return replace(made, effects=(*self.effects, effect), **settings)  # type: ignore[type-var]

    def with_settings(self, effect: Effect, at: Setting) -> Self:
        """The same model with another setting for an effect that it may get."""
        return replace(self, **dict.fromkeys(self._held_as(effect), at))  # type: ignore[type-var]

    @property
    def free_of_pose(self) -> tuple[str, ...]:
        """The numbers of the sensor's pose of which nothing is known: none of them is large or small."""
        return ()

    @property
    def stands_anywhere(self) -> tuple[str, ...]:
        """Names of the parameters of the sensor's pose, where all of it is free: then any turn of the readings is where
        the sensor stands. None where a part of it is known or held."""
        return ()

    def known(self, *, drawn: bool) -> list[float]:
        """Within how many sizes each parameter (p,) is known beside what is read, 0 where it is not: what somebody has
        measured, and where what is ``drawn`` counts all others. Where the instrument stands and its targets sit, as far
        as nothing is known of that, no drawing says: there it only keeps a few rows from turning about each other."""
        anywhere = {*self.free_of_pose, *self.targets_anywhere}
        wide = [_ANYWHERE if p.name in anywhere else 1.0 for p in self.parameters]
        return [1.0 if p.known else far if drawn else 0.0 for p, far in zip(self.parameters, wide, strict=True)]

    @property
    def targets_anywhere(self) -> tuple[str, ...]:
        """Names of the parameters of where on the tool the targets sit, as far as nothing is known of it: who clamps
        one there need not know."""
        return ()

    def in_sockets(self, data: Measurements) -> InSockets | None:
        """Rows whose distance of nothing is a place; None where there are none."""
        del data
        return None

    def supposed(self, *, left: bool) -> str | None:
        """What the drawing does not say and one of its effects supposes, which others of them may make up for, or what
        has a structure where that is ``left``; None where there is nothing of that sort."""
        del left
        return None

    @property
    def relations(self) -> tuple[Apart, ...]:
        """What is known of several of its parameters at once, besides the readings."""
        return ()

    def for_run(self, data: Measurements) -> Self:
        """The same model for a run: its time counted from the begin, unless it has an origin of time, since what moves
        on from one row to the next must not hang on the year."""
        if not data.begins_s or self.settings().get("time_origin_s") != 0.0:
            return self
        last = self.__dict__.get("_last_run")
        if last is None or last.settings()["time_origin_s"] != data.begins_s:
            # it has compiled parts: one is enough for all runs of that begin
            last = self.__dict__["_last_run"] = replace(self, time_origin_s=data.begins_s)  # type: ignore[type-var]
        return last

    def setting_of(self, effect: Effect) -> Setting | None:
        """The setting that the model has for an effect, as :meth:`with_effect` takes it; None where it has none."""
        held = self._held_as(effect)
        return self.settings()[held[0]] if held else None

    def periods(self, names: Sequence[str], otherwise: float) -> Floats:
        """The periods (k,) of waves of joints, by the ``names`` of their columns; ``otherwise`` where one has none."""
        out = np.full(len(names), otherwise)
        for effect in (one for one in self.known_effects.values() if one.is_periodic):
            if own := self.setting_of(effect):
                out[effect.waving(names)] = own
        return out

    def _held_as(self, effect: Effect) -> list[str]:
        """A setting stands under its own name, or with the effect's before it: period_mm, slip_time_s."""
        known = self.settings()
        return [name for name in (effect.search or "", f"{effect.name}_{effect.search}") if name in known]

    def without_effect(self, name: str) -> Self:
        """The same model without the effect of that name, and without what goes with it."""
        return replace(self, effects=tuple(e for e in self.effects if name not in (e.name, e.goes_with)))  # type: ignore[type-var]

    def is_testable(self, effects: Sequence[Effect], data: Measurements) -> tuple[list[Effect], dict[str, str]]:
        """Effects that are not in the model and whose columns these rows have; the others with the reason, but for
        those that go with an effect which is not in it."""
        active = {e.name for e in self.effects}
        tried: list[Effect] = []
        untestable: dict[str, str] = {}
        for effect in effects:
            if effect.name in active or effect.name in self.within:
                continue
            if effect.goes_with and effect.goes_with not in active:
                continue
            missing = missing_columns(effect, data)
            if missing:
                untestable[effect.name] = _lacking(missing)
            else:
                tried.append(effect)
        return tried, untestable

    def check_effect(self, effect: Effect, data: Measurements, values: Floats) -> None:
        """Refuses a user's effect that is none on these rows. Raises :class:`~sherkit.errors.EffectError`."""
        if effect.name in self.known_effects:
            raise EffectError(f"'{effect.name}' is the name of a built-in effect; give yours another")
        if not missing_columns(effect, data):
            check_user_effect(effect, self.rows(data, values), self.axes_of(effect, data))


def asked_for(untestable: Mapping[str, str], data: Measurements) -> dict[str, str]:
    """Of effects that could not be tried, with the reason, those that somebody may miss: who reads no distances asks
    for no effect of a bar."""
    return {name: why for name, why in untestable.items() if why != _lacking((data.layout.distance or "",))}


def _lacking(columns: Sequence[str]) -> str:
    return f"it needs the column {' and '.join(columns)}"


def require_columns(effect: Effect, data: Measurements) -> None:
    """Refuses an effect that needs columns which rows do not have. Raises :class:`~sherkit.errors.EffectError`."""
    if missing := missing_columns(effect, data):
        raise EffectError(f"{data.source}: '{effect.name}' needs the column {listed(missing)}, which these rows lack")


def missing_columns(effect: Effect, data: Measurements) -> tuple[str, ...]:
    """Columns that an effect needs and a run does not have, or has empty."""
    out = []
    for need in effect.needs:
        if need == "time_s":
            known = data.time_s is not None
        elif need == "direction":
            known = bool(np.isfinite(data.direction).all())
        elif need == data.layout.distance:
            known = bool(data.is_distance.any())
        else:
            known = need in data.covariates or need in data.layout.joints
        if not known:
            out.append(need)
    return tuple(out)
