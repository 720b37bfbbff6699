"""How well a calibrated robot goes where it is sent: the radius that holds it in 95 of 100 cases, and where to ask."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Self

import numpy as np
import polars as pl
from numpy.typing import ArrayLike

from ..base.figures import in_small_units
from ..base.types import Bools, Floats
from ..data.columns import TEMPERATURE, TIME, bare, unit_in
from ..fit.error import radius_95
from ..model.batch import Batch, matrix
from ..model.effect import Effect
from .deployed import BASE, SENSOR, Deployed
from .identified_model import BiasBound, IdentifiedModel, at_rest, by_effect
from .unobserved_effects import AccuracyQuery, Counted

# -- What is promised of a place ----------------------------------------------------------------------------------

#: Poses that would leave more than this part of what could hide are no advice.
_HELPS = 0.9
#: An addition of more than this part of the radius is worth a measurement.
_MATTERS = 0.1
#: Digits of what a person is asked to drive to, by unit.
_DIGITS = {"mm": 1, "rad": 3}


@dataclass(frozen=True)
class PredictedAccuracy:
    """How far off the mean of many visits to a place may be, in 95 of 100 cases: pose accuracy (ISO 9283).

    ``radius_mm`` holds for effects that the poses of the run can show; ``addition_mm`` is what effects of the catalogue
    at plausible size could do there besides, unseen between the poses; ``effect`` is the one that does most of it and
    ``advice`` the measurement that would narrow it, both empty where there is none. ``visit_mm`` holds 95 of 100 single
    readings there, scatter and all. NaN for a place out of reach. All holds at ``temperature_c`` and at ``time_s`` on
    the run's clock; None where nothing that is known of the robot depends on it.
    """

    radius_mm: float
    addition_mm: float
    visit_mm: float = float("nan")
    effect: str = ""
    advice: str = ""
    temperature_c: float | None = None
    time_s: float | None = None
    #: Of radius, addition and visit, where the robot's coordinates are no lengths.
    unit: str = "mm"
    #: How far outside the poses of the run its joints are there, in half of what these range over; zero among them.
    beyond: float = 0.0

    @property
    def total_mm(self) -> float:
        """Radius and addition: the pose accuracy that is promised."""
        return self.radius_mm + self.addition_mm

    @property
    def matters(self) -> bool:
        """Whether the addition is worth a measurement: more than a tenth of the radius."""
        return self.addition_mm > _MATTERS * self.radius_mm

    def __str__(self) -> str:
        if math.isnan(self.radius_mm):
            return "out of reach"
        within, shown = f"within {self._sized(self.total_mm)} in 95 of 100 cases", self._sized(self.radius_mm)
        if self.visit_mm > self.total_mm:
            within = f"the mean of many visits {within}, single readings within {self._sized(self.visit_mm)}"
        within += self._when
        if self.beyond > 0:
            within += f", extrapolated: its joints are {self.beyond:.2g} half ranges outside the poses measured"
        if not self.effect:
            return f"{within}; the poses leave no room for an effect between them"
        text = f"{within}: {shown} by what the poses show, the rest by what they could not, mostly {self.effect}"
        return f"{text}. {self.advice}" if self.matters and self.advice else text

    def _sized(self, value: float) -> str:
        unit, factor = in_small_units(self.unit)
        return f"{factor * value:{'.1f' if unit == 'µm' else '.3g'}} {unit}"

    @property
    def _when(self) -> str:
        """For which temperature and moment it holds, where that matters."""
        out = "" if self.temperature_c is None else f", at {self.temperature_c:.1f} °C"
        return out if self.time_s is None else f"{out}, {self.time_s / 60.0:.0f} min after the run's clock began"


@dataclass(frozen=True, eq=False)
class Hiding:
    """An effect that hides: its name with its period or moment, coordinates (r, d) at which readings would tell most of
    it, and the part that they would leave."""

    name: str
    places: Floats
    left: float


@dataclass(frozen=True, eq=False)
class PredictedAccuracies:
    """:class:`PredictedAccuracy` of many places: ``radius_mm``, ``addition_mm`` and ``visit_mm`` (n,), NaN where not
    ``reached`` (n,); ``worst`` says what hides most at each; all at one ``temperature_c`` and ``time_s``."""

    radius_mm: Floats
    addition_mm: Floats
    visit_mm: Floats
    worst: tuple[Hiding | None, ...]
    reached: Bools
    why: tuple[str, ...]
    coordinates: tuple[str, ...]
    temperature_c: float | None = None
    time_s: float | None = None
    #: Of radius, addition and visit, where the robot's coordinates are no lengths.
    unit: str = "mm"
    #: As of one (n,); None where nobody asked.
    beyond: Floats | None = None

    @property
    def total_mm(self) -> Floats:
        """Both together (n,): what is promised."""
        return self.radius_mm + self.addition_mm

    def __len__(self) -> int:
        return len(self.radius_mm)

    def __getitem__(self, row: int) -> PredictedAccuracy:
        one = self.worst[row]
        sizes = (float(self.radius_mm[row]), float(self.addition_mm[row]), float(self.visit_mm[row]))
        said = ("", "") if one is None else (one.name, self._advice(one))
        far = 0.0 if self.beyond is None else float(np.nan_to_num(self.beyond[row]))
        return PredictedAccuracy(*sizes, *said, self.temperature_c, self.time_s, self.unit, far)

    def _advice(self, one: Hiding) -> str:
        """Where to measure, and what it would bring; nothing where that is next to nothing."""
        if not len(one.places) or one.left > _HELPS:
            return ""
        names, unit = ", ".join(map(bare, self.coordinates)), unit_in(self.coordinates[0])
        digits = _DIGITS.get(unit, 3)
        at = "; ".join(", ".join(f"{v:.{digits}f}" for v in place) for place in one.places)
        return f"To narrow it, measure also at {names} = {at} {unit}: that would leave {100 * one.left:.0f} % of it."

    def to_frame(self) -> pl.DataFrame:
        """A polars frame: radius_mm, addition_mm, total_mm, visit_mm, effect, advice, measured; else null."""
        each = [self[k] for k in range(len(self))]
        names = ("radius_mm", "addition_mm", "total_mm", "visit_mm", "effect", "advice")
        columns = {name: [getattr(one, name) for one in each] for name in names}
        columns["measured"] = [one.beyond == 0.0 for one in each]
        return pl.DataFrame(columns).with_columns(pl.col(pl.Float64).fill_nan(None))


# -- Where it comes from ------------------------------------------------------------------------------------------

#: Places at which a calibration is asked what it could not see.
_ASKED = 80


@dataclass(frozen=True, eq=False)
class Planes:
    """Planes of the workspace to draw a quantity on: ``x`` (nx,) and ``y`` (ny,) in the units of ``labels``.

    ``grid`` (planes · ny · nx, k) are their points in coordinates, plane by plane and row by row, of which ``inside``
    (planes · ny · nx,) belong to the workspace; ``titles`` are those of the planes.
    """

    x: Floats
    y: Floats
    labels: tuple[str, str]
    titles: tuple[str, ...]
    grid: Floats
    inside: Bools

    @classmethod
    def horizontal(cls, low: Floats, high: Floats, per_side: int, digits: str) -> Self:
        """The highest, middle and lowest plane of a box (3,), mm, with their heights to these ``digits``."""
        x, y = (np.linspace(low[k], high[k], per_side) for k in range(2))
        z = np.linspace(high[2], low[2], 3) if high[2] > low[2] else np.array([low[2]])
        grid = np.ascontiguousarray(np.stack(np.meshgrid(z, y, x, indexing="ij"), axis=-1).reshape(-1, 3)[:, ::-1])
        titles = tuple(f"z = {one:{digits}} mm" for one in z)
        return cls(x, y, ("x, mm", "y, mm"), titles, grid, np.ones(len(grid), dtype=bool))


@dataclass(frozen=True, eq=False)
class Accurate(Deployed):
    """A deployed robot of which it is known how far off it may be."""

    @abstractmethod
    def by_values(self, part: IdentifiedModel, joints: Floats, now: list[float]) -> Floats:
        """Derivatives (n, d, p) by the identified values of a part of where the robot is with ``joints`` (n, j) at the
        covariates ``now`` of a loop, as :attr:`frame` sees it. In units of which one makes :attr:`reach_mm` at the
        tool.
        """

    def counted_beside(self, part: IdentifiedModel, frame: str, effect: Effect) -> Bools:
        """The same by what they took of an effect."""
        del effect
        return self.counted(part, frame)

    def counted(self, part: IdentifiedModel, frame: str) -> Bools:
        """Which identified values (p,) of a part move places in a frame: in that of the base none of the instrument's,
        where there are two."""
        model = part.model(self.robot)
        others = model.of_sensor if frame == BASE and len(self.frames) > 1 else ()
        return np.array([p.name not in others for p in model.parameters[: len(part.values)]], dtype=bool)

    def left_at(self, part: IdentifiedModel, coordinates: Floats) -> Floats:
        """Covariance (n, d, d) of what a part leaves at ``coordinates`` (n, k) of :attr:`frame`; by default the same
        everywhere."""
        return np.broadcast_to(part.residual_covariance, (len(coordinates), *part.residual_covariance.shape))

    def left_of(self, part: IdentifiedModel, coordinates: Floats) -> tuple[Floats, float]:
        """Radius (n,), mm, of what a part leaves at ``coordinates`` (n, k) of :attr:`frame` in 95 of 100 cases, and of
        what readings scatter by about it; zero where nobody knows."""
        left, scatter = radius_95(self.left_at(part, coordinates)), radius_95(part.scatter[None])
        return self.reach_mm * left, self.reach_mm * float(scatter[0]) if part.scatter.any() else 0.0

    def corrects(self, joints: Floats) -> Floats | None:
        """What is deployed beside the model of the whole (n, m) with ``joints`` (n, j), as the sensor saw it; None
        where nothing is."""
        del joints
        return None

    def spread(
        self, coordinates: Floats, joints: Floats, *, frame: str | None = None, temperature_c: float | None = None,
        **load: float,
    ) -> Floats:  # fmt: skip
        """Covariance (n, d, d) of where the robot really is when sent to ``coordinates`` (n, k) of :attr:`frame` by
        ``joints`` (n, j), as ``frame`` counts it.

        Parameter covariance carried there, that of what no reading tells with it, plus that of what the model leaves.
        In the axes of :attr:`frame`, and in units of which one makes :attr:`reach_mm` at the tool.
        """
        where, now = self.frame_of(frame), self._now(temperature_c, **load)
        out = np.empty((len(coordinates), *self.whole.residual_covariance.shape))
        for part, here in self._ruled(coordinates):
            at = self.moment_of(part, now)
            columns = np.where(self.counted(part, where), self.by_values(part, joints[here], at), 0.0)
            left = self.left_at(part, coordinates[here])
            out[here] = columns @ part.covariance @ columns.transpose(0, 2, 1) + left
        return out

    @abstractmethod
    def places(self) -> list[tuple[str, Floats]]:
        """Coordinates (k,) for which a person would ask how accurate the robot is, with their names."""

    @abstractmethod
    def planes(self, per_side: int) -> Planes:
        """Planes of the workspace, or of what was measured, with ``per_side`` points along each side."""

    @property
    def accuracy_unit(self) -> str:
        """The unit of what is promised: that of the coordinates; lengths where these are angles of a tool that is
        :attr:`reach_mm` long."""
        return unit_in(self.coordinates[0]) or "mm"

    @property
    def reach_mm(self) -> float:
        """How far one unit of the coordinates moves the tool, mm."""
        return 1.0

    def carried(self, joints: Floats, by_joints: Floats, missed: Floats) -> Floats:
        """What coordinates miss (n, d, k), as :meth:`spread` counts them, where readings miss (n, m, k).

        ``joints`` (n, j), and ``by_joints`` (n, m, j): readings by joints. By default coordinates are what is read.
        """
        del joints, by_joints
        return missed[:, : len(self.coordinates)]

    def accuracy(
        self, coordinates: ArrayLike, *, frame: str | None = None, temperature_c: float | None = None,
        direction: ArrayLike | None = None, **load: float,
    ) -> float:  # fmt: skip
        """Radius, mm, within which the mean of many visits to ``coordinates`` (k,) of a ``frame`` is predicted to lie
        in 95 of 100 cases: pose accuracy (ISO 9283). How single visits scatter about it is :meth:`repeatability`.

        The whole of :meth:`predicted_accuracy`: what the poses of the run show, and what they could not have shown.
        In the frame of the base what no reading tells of where the instrument stood is part of it, but for what defines
        that frame: numbers of the geometry that are held since others say the same (:attr:`~ChainModel.fixed`). At
        ``temperature_c``, by default the mean of the run, and at its end; under the ``load`` that an arm's
        :meth:`inverse` takes (``payload_kg``): of what that does, what the model holds. Where no pose was measured
        (:meth:`measured`) this is extrapolation. For a posture: :meth:`predicted_accuracies_with`. Raises as
        :meth:`inverse`.
        """
        now: dict[str, Any] = {"frame": frame, "temperature_c": temperature_c, "direction": direction} | load
        return self.predicted_accuracy(coordinates, **now).total_mm

    def repeatability(self, coordinates: ArrayLike) -> float:
        """Radius, mm, about the mean of many visits to ``coordinates`` (k,) that holds 95 of 100 readings there, the
        instrument's noise with them; NaN where neither repeats nor declared deviations tell it."""
        scatter = self.part_at(self._place(coordinates)).scatter
        return self.reach_mm * float(radius_95(scatter[None])[0]) if scatter.any() else float("nan")

    def accuracy_batch(
        self, coordinates: ArrayLike, *, frame: str | None = None, temperature_c: float | None = None,
        direction: ArrayLike | None = None, **load: float,
    ) -> Batch:  # fmt: skip
        """:meth:`accuracy` at every one of ``coordinates`` (n, k): values (n,), mm; those out of reach are marked."""
        now: dict[str, Any] = {"frame": frame, "temperature_c": temperature_c, "direction": direction} | load
        made = self.predicted_accuracies(coordinates, **now)
        return Batch(made.total_mm, made.reached, made.why)

    def predicted_accuracy(
        self, coordinates: ArrayLike, *, frame: str | None = None, temperature_c: float | None = None,
        direction: ArrayLike | None = None, **load: float,
    ) -> PredictedAccuracy:  # fmt: skip
        """How far off the robot may be at ``coordinates`` (k,), and why. Arguments and errors as :meth:`accuracy`."""
        x = self._place(coordinates)
        now: dict[str, Any] = {"frame": frame, "temperature_c": temperature_c, "direction": direction} | load
        made = self.predicted_accuracies(x[None, :], **now)
        if not made.reached[0]:
            self.inverse(x, **now)  # says why
        return made[0]

    def predicted_accuracies(
        self, coordinates: ArrayLike, *, frame: str | None = None, temperature_c: float | None = None,
        direction: ArrayLike | None = None, **load: float,
    ) -> PredictedAccuracies:  # fmt: skip
        """:meth:`predicted_accuracy` at every one of ``coordinates`` (n, k) of a ``frame``, all reached in one
        ``direction`` (j,) if given.

        The radius: parameter covariance carried to the place, plus the covariance of what the model leaves on poses
        held out (all of it where the noise is not known), plus half of the lost motion that is in the model where no
        direction is given; that of a Gaussian by matching two moments of its squared length (Satterthwaite). The
        addition: by how much that grows with the covariance of what one effect of the catalogue at plausible size could
        do there and did not show at the poses (:mod:`~sherkit.robots.identified_model`): of all effects, the one that
        could do most.
        """
        x, where = self._places(coordinates), self.frame_of(frame)
        inverse = self.joints_to(x, frame=frame, temperature_c=temperature_c, direction=direction, **load)
        return self._predicted(self._own(x, where), inverse, where, temperature_c, direction, **load)

    def predicted_accuracies_with(
        self, joints: ArrayLike, *, frame: str | None = None, temperature_c: float | None = None
    ) -> PredictedAccuracies:
        """:meth:`predicted_accuracies` with ``joints`` (n, j), which a place alone may leave open."""
        q, where = matrix(joints, "joint readings", self._joints), self.frame_of(frame)
        x = self.forward_batch(q, temperature_c=temperature_c)
        return self._predicted(x.values, Batch(q, x.reached, x.why), where, temperature_c, None)

    def _predicted(
        self, x: Floats, inverse: Batch, where: str, temperature_c: float | None, direction: ArrayLike | None,
        **load: float,
    ) -> PredictedAccuracies:  # fmt: skip
        """For places (n, k) of :attr:`frame` and the joints that lead there."""
        rows = np.flatnonzero(inverse.reached)
        joints = np.ascontiguousarray(inverse.values[rows])
        radius, addition, visit = (np.full(len(x), np.nan) for _ in range(3))
        worst: list[Hiding | None] = [None] * len(x)
        known = self.spread(x[rows], joints, frame=where, temperature_c=temperature_c, **load)
        ruled, given = self._ruled(x[rows]), self._now(temperature_c)[:2]
        far, whole, scatter = self.beyond_poses(x[rows], joints), np.empty_like(known), np.empty_like(known)
        for part, here in ruled:
            now = self.moment_of(part, given)
            known[here] += (self.grown(part, far[here]) - 1.0)[:, None, None] * self.left_at(part, x[rows[here]])
            if direction is None:
                known[here] += self._either_side(part, joints[here], now)
            whole[here], scatter[here] = known[here], part.scatter
            if found := self._beyond(part, x[rows[here]], joints[here], where, now):
                chosen, spreads = (list(each) for each in zip(*found.values(), strict=True))
                most = np.trace(spreads, axis1=2, axis2=3).argmax(axis=0)
                each, model = np.arange(len(most)), part.model(self.robot)
                whole[here] += np.array(spreads)[most, each]
                for k, row in enumerate(rows[here]):
                    one = chosen[most[k]][k]
                    # readings narrow what the instrument's own frame sees of it
                    advised = one.places if where == self.frame else one.places[:0]
                    worst[row] = Hiding(one.called(model), advised, one.left)
        radius[rows] = self.reach_mm * radius_95(known)
        addition[rows] = self.reach_mm * radius_95(whole) - radius[rows]
        visit[rows] = self.reach_mm * radius_95(whole + scatter)
        # asked of several parts, for the moment of the last
        now = self.moment_of(ruled[-1][0], given) if ruled else given
        when, outside = self._when([part for part, _ in ruled], now), np.full(len(x), np.nan)
        outside[rows] = far
        return PredictedAccuracies(
            radius, addition, visit, tuple(worst), inverse.reached, inverse.why, self.coordinates, *when,
            self.accuracy_unit, outside,
        )  # fmt: skip

    def _when(self, parts: Sequence[IdentifiedModel], now: Sequence[float]) -> tuple[float | None, float | None]:
        """Temperature and time that a promise is for, None where nothing that is known of the parts depends on it."""
        needs: set[str] = set()
        for part in parts:
            model = part.model(self.robot)
            hidden = (model.may_be_off[one.effect] for one in part.unobserved_effects)
            needs |= {name for effect in (*model.effects, *hidden) for name in effect.needs}
        return now[1] if TEMPERATURE in needs else None, now[0] if TIME in needs else None

    def _either_side(self, part: IdentifiedModel, joints: Floats, now: Sequence[float]) -> Floats:
        """Covariance (n, d, d) of not knowing from which side ``joints`` (n, j) are reached: of lost motion that is in
        the model half the width, joint by joint."""
        d, model = len(self.coordinates), part.model(self.robot)
        out = np.zeros((len(joints), d, d))
        for effect in model.effects:
            if "direction" in effect.needs:
                known = np.tile([*now, *(1.0 for _ in part.now[2:])], (len(joints), 1))
                own = model.owns(effect)
                columns, by_joints, _ = at_rest(model, part.values, part.readings, joints, known)
                off = self.carried(joints, by_joints, columns[:, :, own] * part.values[own])
                out += off @ off.transpose(0, 2, 1)
        return out

    def _beyond(
        self, part: IdentifiedModel, x: Floats, joints: Floats, frame: str, now: Sequence[float]
    ) -> dict[str, tuple[list[BiasBound], Floats]]:
        """By effect what the poses could not show at each place: at which setting it is worst there, and its
        covariance (n, d, d). In the frame of the base what the sensor's pose took of it is missed too."""
        out: dict[str, tuple[list[BiasBound], Floats]] = {}
        known, functions = part.model(self.robot).may_be_off, part.functions(x)
        for one in part.unobserved_effects:
            # lost motion is asked for from both sides
            sides = (1.0, -1.0) if "direction" in known[one.effect].needs else (0.0,)
            spread = np.zeros((len(x), len(self.coordinates), len(self.coordinates)))
            for side in sides:
                spread += one.beyond(self.missed(part, one, functions, joints, frame, now, side)) / len(sides)
            if one.effect not in out:
                out[one.effect] = ([one] * len(x), spread)
                continue
            which, most = out[one.effect]
            for k in np.flatnonzero(np.trace(spread - most, axis1=1, axis2=2) > 0):
                which[k], most[k] = one, spread[k]
        return out

    def missed(
        self, part: IdentifiedModel, one: BiasBound, functions: Floats, joints: Floats, frame: str,
        now: Sequence[float], side: float = 0.0,
    ) -> Floats:  # fmt: skip
        """What places (n, d, k) of a frame miss by an effect, per unit of its parameters, where ``joints`` (n, j) lead,
        all reached from one ``side``; ``functions`` (n, c) are those of a correction there."""
        model = part.model(self.robot)
        effect, known = (
            model.may_be_off[one.effect],
            np.tile([*now, *(side for _ in part.now[2:])], (len(joints), 1)),
        )
        by_values, by, by_joints = by_effect(model, part.values, effect, one.setting, part.readings, joints, known)
        moves = by if self.moves(effect, frame) else np.zeros_like(by)
        missed = one.missed(np.where(self.counted_beside(part, frame, effect), by_values, 0.0), moves, functions)
        return self.carried(joints, by_joints, missed)

    def moves(self, effect: Effect, frame: str) -> bool:
        """Whether an effect moves places in a frame: the instrument's do not in that of the base, where there are
        two."""
        return effect.link != SENSOR or frame == SENSOR or len(self.frames) == 1

    def asked(self, part: IdentifiedModel) -> AccuracyQuery:
        """Where a part is asked how far off it could be: at random over the box that was measured, within reach."""
        rng = np.random.default_rng(0)
        x = rng.uniform(part.low, part.high, (_ASKED, len(part.low)))
        inverse = self.inverse_batch(x)
        within = inverse.reached.copy()
        if self.robot.joint_limits is not None:
            low, high = self.robot.joint_limits
            within &= ((inverse.values >= low) & (inverse.values <= high)).all(axis=1)
        x, joints = x[within], np.ascontiguousarray(inverse.values[within])
        sides = rng.choice([-1.0, 1.0], joints.shape)
        now = np.column_stack([np.tile(part.now[:2], (len(x), 1)), sides])
        spreads = [self.spread(x, joints, frame=frame) + part.scatter for frame in self.frames]
        counted = tuple(
            Counted(spread, partial(self.counted_beside, part, frame), partial(self.moves, frame=frame))
            for spread, frame in zip(spreads, self.frames, strict=True)
        )
        return AccuracyQuery(x, joints, now, counted, self.carried)
