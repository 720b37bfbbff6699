"""Where a robot may be sent: a box of places or of joint readings, within limits and workspace."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import scipy

from ..base.figures import listed
from ..base.types import Bools, Floats
from ..data import Measurements
from ..data.columns import Layout, unit_in
from ..errors import ExperimentError, RobotError
from ..model.base import ModelWithEffects
from ..model.chain import ChainModel
from ..model.kinds import kind_of

#: Places of which some are chosen.
CANDIDATES = 240

#: Digits of what a robot is sent to, by unit.
_DIGITS = {"mm": 3, "rad": 5}
#: Of so many points drawn at once, one at least must be within reach.
_AT_ONCE, _ROUNDS = 64, 40
_CORNERS = 128
#: Part of a workspace that is no more than rounding.
_ROUNDING = 1e-4


@dataclass(frozen=True, eq=False)
class PosesToDrive:
    """Where to drive: joint readings (n, k) and the coordinates (n, c) that these are by the drawing."""

    joints: Floats
    targets: Floats

    def __len__(self) -> int:
        return len(self.joints)

    def pick(self, rows: Any) -> PosesToDrive:
        """Some of them."""
        return PosesToDrive(self.joints[rows], self.targets[rows])


@dataclass(frozen=True, eq=False)
class Region:
    """A box from ``low`` to ``high`` along ``names``, joints or coordinates of a robot's kinematics, and what of it can
    be reached. ``targets`` are the columns that say where joints lead."""

    model: ModelWithEffects
    layout: Layout
    targets: tuple[str, ...]
    names: tuple[str, ...]
    low: Floats
    high: Floats

    @classmethod
    def of(cls, model: ModelWithEffects, layout: Layout, box: Mapping[str, Sequence[float]] | None = None) -> Region:
        """The workspace of the model's robot, or the part of it that ``box`` leaves: column name to (low, high).

        Raises :class:`~sherkit.errors.ExperimentError` where no file says how far a robot without a box may go.
        """
        targets = (model.targets if isinstance(model, ChainModel) else ()) or layout.coordinates
        names, low, high = _whole(model, layout, targets)
        for name, ends in (box or {}).items():
            if name not in (*layout.joints, *targets):
                raise ExperimentError(f"box: '{name}' is no joint and no coordinate; there are {listed(layout.joints)} "
                                      f"and {listed(targets)}")  # fmt: skip
            if len(ends) != 2 or not np.isfinite(ends).all() or not ends[0] < ends[1]:
                raise ExperimentError(f"box: {name}: expected [low, high] with low below high, found {list(ends)}")
        given = set(box or {})
        if given and not given <= set(names):
            # told along others than the robot's own box has: then along all of these
            along = layout.joints if given <= set(layout.joints) else targets if given <= set(targets) else ()
            if set(along) != given:
                raise ExperimentError(
                    f"box: expected {listed(along or names)}, all of them, found {listed(sorted(given))}"
                )
            names, low, high = along, np.full(len(along), np.nan), np.full(len(along), np.nan)
        for name, ends in (box or {}).items():
            k = names.index(name)
            low[k] = ends[0] if np.isnan(low[k]) else max(low[k], ends[0])
            high[k] = ends[1] if np.isnan(high[k]) else min(high[k], ends[1])
        if not names or not np.isfinite([low, high]).all():
            raise ExperimentError(
                f"nothing says how far this robot may go: give its workspace or the ranges of its joints in its file, "
                f"or a box of {listed(layout.joints)} or of {listed(targets)}"
            )
        if not (low < high).all():
            k = int(np.argmin(high - low))
            raise ExperimentError(f"box: {names[k]}: what is given lies outside of the robot's own workspace")
        return cls(model, layout, targets, names, low, high)

    @cached_property
    def joint_range(self) -> tuple[Floats, Floats]:
        """Lowest and highest joint readings (k,) of the region."""
        if self.names == self.layout.joints:
            return self.low, self.high
        joints = self.spread(_CORNERS, 0).joints
        return joints.min(axis=0), joints.max(axis=0)

    @property
    def joint_half(self) -> Floats:
        """Half the range (k,) of the joints."""
        low, high = self.joint_range
        return 0.5 * (high - low)

    def scaled(self, joints: Floats) -> tuple[Floats, Floats]:
        """What the box is along (n, k), and joints (n, j), from the middle of the region over its half width."""
        low, high = self.joint_range
        own = (joints - 0.5 * (low + high)) / self.joint_half
        if self.names == self.layout.joints:
            return own, own
        there = self.model.robot.forward_batch(joints).values
        places = (
            (np.where(np.isfinite(there), there, 0.0) - 0.5 * (self.low + self.high)) / (self.high - self.low) * 2.0
        )
        return places, own

    def spread(self, count: int, seed: int) -> PosesToDrive:
        """So many places that fill the region evenly (Halton's sequence, scrambled by ``seed``)."""
        return self._drawn(count, scipy.stats.qmc.Halton(len(self.names), seed=seed).random)

    def anywhere(self, count: int, rng: np.random.Generator) -> PosesToDrive:
        """So many places at random."""
        return self._drawn(count, lambda n: rng.uniform(size=(n, len(self.names))))

    def _drawn(self, count: int, points: Any) -> PosesToDrive:
        found: list[PosesToDrive] = []
        for _ in range(_ROUNDS):
            part, robot = np.asarray(points(max(_AT_ONCE, count))), self.model.robot
            at = self.low + part * (self.high - self.low)
            if self.names == self.layout.joints and hasattr(robot, "joints_at"):
                # those that go together are drawn together, of which a box leaves a part
                at = robot.joints_at(part)
            places, within = self.reached(at)
            found.append(places.pick(within & ((at >= self.low) & (at <= self.high)).all(axis=1)))
            if sum(map(len, found)) >= count:
                break
        out = PosesToDrive(np.concatenate([p.joints for p in found]), np.concatenate([p.targets for p in found]))
        if not len(out):
            raise ExperimentError(
                f"the robot reaches nothing in the box of {listed(self.names)}: a smaller or another one is needed"
            )
        return out.pick(np.arange(count) % len(out))

    def reached_at(self, joints: Floats) -> Floats:
        """Coordinates (n, c) of these joints by the drawing."""
        return _shown(self.model, planned(joints, self.layout), self.targets)[0]

    def reached(self, at: Floats) -> tuple[PosesToDrive, Bools]:
        """Where points (n, k) of the box lead, and which of them the drawing reaches within limits and workspace."""
        robot, joints = self.model.robot, at
        within = np.ones(len(at), dtype=bool)
        if self.names != self.layout.joints:
            places = np.column_stack([np.round(c, _digits(n)) for c, n in zip(at.T, self.names, strict=True)])
            there = robot.inverse_batch(places)
            at, joints, within = places, there.values, there.reached.copy()
        joints = np.column_stack(
            [np.round(c, _digits(n) + 1) for c, n in zip(joints.T, self.layout.joints, strict=True)]
        )
        joints = np.where(np.isfinite(joints), joints, 0.0)
        if (limits := getattr(robot, "joint_limits", None)) is not None:
            within &= ((joints >= limits[0]) & (joints <= limits[1])).all(axis=1)
        if hasattr(robot, "may_stand"):
            within &= robot.may_stand(joints, _ROUNDING)
        targets = np.full((len(at), len(self.targets)), np.nan)
        if within.any():
            rows = planned(joints[within], self.layout)
            shown, seen = _shown(self.model, rows, self.targets)
            targets[within] = shown
            within[within] = seen
        if self.names == self.targets:
            targets = at
        return PosesToDrive(joints, targets), within


def planned(joints: Floats, layout: Layout, columns: Mapping[str, Floats] | None = None) -> Measurements:
    """Rows at these joints that are still to be read, every reading but a distance, with what else is known of them."""
    data = Measurements.planned(joints, layout, "plan", **(columns or {}))
    taken = np.array([name != layout.distance for name in layout.readings])
    return replace(data, taken=np.tile(taken, (len(joints), 1)))


def _shown(model: ModelWithEffects, rows: Measurements, targets: tuple[str, ...]) -> tuple[Floats, Bools]:
    """Coordinates (n, c) by the drawing, and which rows can be read there."""
    still = np.zeros(len(model.parameters))
    if isinstance(model, ChainModel) and model.targets:
        shown, seen = model.stands(rows, still)
        return shown, seen & model.allowed(shown, _ROUNDING)
    shown = model.predict(rows, still)[:, : len(targets)]
    return shown, np.asarray(np.isfinite(shown).all(axis=1))


def _whole(model: ModelWithEffects, layout: Layout, targets: tuple[str, ...]) -> tuple[tuple[str, ...], Floats, Floats]:
    """What a robot's file says of how far it may go: ranges of joints, a workspace, or nothing."""
    robot = model.robot
    nothing: tuple[tuple[str, ...], Floats, Floats] = ((), np.zeros(0), np.zeros(0))
    if robot is None:
        return nothing
    if (ranges := getattr(robot, "ranges", None)) is not None:
        low, high = (np.array(end, dtype=float) for end in ranges)
        return layout.joints, low, high
    if (box := getattr(robot, "box", None)) is not None and hasattr(robot.joints, "keys"):
        low, high = np.array(box, dtype=float).T
        return layout.joints, low.copy(), high.copy()
    if isinstance(model, ChainModel) and type(model).grid is not ChainModel.grid:
        try:
            middle = np.atleast_2d(robot.inverse(np.array(robot.middle)))
        except RobotError:
            # it stands nowhere that its file knows
            return nothing
        grid = model.grid(planned(middle, layout))
    else:
        # a kind that has no workspace has poses that fill it
        area = kind_of(robot).areas.get("whole")
        grid = None if area is None else area(robot)
    if grid is None or grid.shape[1] != len(targets):
        return nothing
    low, high = grid.min(axis=0), grid.max(axis=0)
    # where the file says nothing, the grid is where the robot stands
    known = high > low
    return targets, np.where(known, low, np.nan), np.where(known, high, np.nan)


def _digits(name: str) -> int:
    return _DIGITS.get(unit_in(name), 4)
