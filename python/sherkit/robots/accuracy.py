"""How well a calibrated robot goes where it is sent: the radius that holds it in 95 of 100 cases, and where to ask."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from ..base.types import Bools, Floats
from ..data.columns import TEMPERATURE, TIME, unit_in
from ..fit.error import radius_95
from ..model.batch import Batch, matrix
from ..model.effect import Effect
from .deployed import BASE, SENSOR, Deployed
from .identified_model import BiasBound, IdentifiedModel, at_rest, by_effect
from .linear_fit import AccuracyQuery, Counted
from .poses_hull import MARGIN
from .predicted_accuracy import Hiding, PredictedAccuracies, PredictedAccuracy

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
            if part.off_stand is not None and where == BASE:
                # where it is not known which, the tool may be off by as much as the instrument would be
                off = self._read_by(part, part.off_stand, joints[here], at[:2]).sum(axis=2)
                out[here] += off[:, :, None] * off[:, None, :]
        return out

    def _read_by(self, part: IdentifiedModel, values: Floats, joints: Floats, now: Sequence[float]) -> Floats:
        """By how much each of ``values`` (p,) of a part's parameters moves what is read of coordinates (n, d, p)."""
        known = np.tile([*now, *(1.0 for _ in part.now[2:])], (len(joints), 1))
        columns, by_joints, _ = at_rest(part.model(self.robot), part.values, part.readings, joints, known)
        return self.carried(joints, by_joints, columns * values)

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
        inverse = self.inverse_batch(x, frame=frame, temperature_c=temperature_c, direction=direction, **load)
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
        outside[rows] = np.where(far > MARGIN, far, 0.0)
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
                off = self._read_by(part, part.values, joints, now)[:, :, model.owns(effect)]
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
        missed = one.missed(np.where(self.counted(part, frame), by_values, 0.0), moves, functions)
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
            Counted(spread, self.counted(part, frame), partial(self.moves, frame=frame))
            for spread, frame in zip(spreads, self.frames, strict=True)
        )
        return AccuracyQuery(x, joints, now, counted, self.carried)
