"""What is asked for next: the first poses, poses that tell most, poses once more, and when."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..data import Measurements
from ..data.columns import POSE, REASON, REPEAT
from ..errors import SherkitError
from .choice import choose, rivals
from .look import InterimAnalysis
from .region import PosesToDrive
from .rule import RuleState
from .task import Task

#: Readings over which the rest of the span is spread where nothing shows, and from which on.
_SPREAD_TO, _SPREAD_FROM = 60, 24
#: The share of readings that are poses read once more.
_ONCE_MORE = 0.125
#: Moments over the span that are driven to where rivals live in time.
_MOMENTS = 75

#: Numbers of poses and of their repeats.
Taken = Sequence[tuple[int, int]]
Rows = list[dict[str, Any]]


def next_pose(taken: Taken) -> int:
    """The first number that no pose has."""
    return max([0, *(pose for pose, _ in taken)]) + 1


@dataclass(frozen=True, eq=False)
class Batches:
    """Makes the rows of a batch."""

    task: Task

    def first(self, count: int, taken: Taken, rng: np.random.Generator) -> Rows:
        """So many rows all over the region, in any order."""
        places, first = self.task.region.spread(count, self.task.seed), next_pose(taken)
        return [self._row(places.pick([k]), "start", first + i) for i, k in enumerate(rng.permutation(count))]

    def anywhere(self, count: int, first: int, rng: np.random.Generator) -> Rows:
        """So many rows at random, whose poses are counted from ``first``."""
        places = self.task.region.anywhere(count, rng)
        return [self._row(places.pick([k]), "explore", first + k) for k in range(count)]

    def chosen(
        self, found: InterimAnalysis, state: RuleState, count: int, boundary: int, taken: Taken, data: Measurements,
        rng: np.random.Generator,
    ) -> Rows:  # fmt: skip
        """So many rows up to the look at ``boundary``, as the last one tells them."""
        rows = self._again(found, taken, boundary, count, rng)
        pace_s, waits = self._pace(found, state)
        first = next_pose(taken)
        try:
            chosen = choose(found, count - len(rows), state.alarmed, rng, pace_s)
        except SherkitError:
            # a fit to readings that are none predicts none
            return [*rows, *self.anywhere(count - len(rows), first, rng)]
        rows += [self._row(places, "time" if waits and why in ("all", "confirm") else why, first + i)
                 for i, (places, why) in enumerate(chosen)]  # fmt: skip
        if waits and data.time_s is not None:
            clock = float(data.time_s.max())
            for i, row in enumerate(rows):
                row["not_before_s"] = clock + (i + 1) * pace_s
        return rows

    def _row(self, places: PosesToDrive, reason: str, pose: int, repeat: int = 1) -> dict[str, Any]:
        row: dict[str, Any] = {POSE: pose, REPEAT: repeat}
        row |= dict(zip(self.task.layout.joints, places.joints[0].tolist(), strict=True))
        row |= dict(zip(self.task.region.targets, places.targets[0].tolist(), strict=True))
        row |= {name: 1 + pose % count for name, count in _apart(self.task.robot, self.task.layout.apart).items()}
        return row | {REASON: reason, "not_before_s": 0.0}

    def _again(self, found: InterimAnalysis, taken: Taken, boundary: int, count: int, rng: np.random.Generator) -> Rows:
        """Rows that were set aside, driven once more each, and poses that were read once, so that these are their share
        of all: what differs then is noise, and nothing else tells it from physics that is finer than the poses."""
        data = found.data
        if data.pose is None or data.repeat is None:
            return []
        poses, first, times = np.unique(data.pose, return_index=True, return_counts=True)
        told = {pose: [r for p, r in taken if p == pose] for pose in data.pose[found.aside].tolist()}
        wrong = [row for row in found.aside.tolist() if len(told[int(data.pose[row])]) == 1][: max(count // 2, 1)]
        more = min(int(_ONCE_MORE * boundary) - len(data) + len(poses), count - len(wrong))
        rows = [*wrong, *rng.permutation(np.setdiff1d(first[times == 1], found.aside))[: max(more, 0)].tolist()]
        places = [PosesToDrive(data.joints[[row]], self.task.region.reached_at(data.joints[[row]])) for row in rows]
        return [self._row(at, "again", int(data.pose[row]), 2) for row, at in zip(rows, places, strict=True)]

    def _pace(self, found: InterimAnalysis, state: RuleState) -> tuple[float, bool]:
        """Seconds between rows to come, and whether they are worth waiting for."""
        time_s, span_s = found.data.time_s, 60.0 * self.task.span_min
        if time_s is None or len(time_s) < 2:
            return 0.0, False
        driven = float(np.ptp(time_s))
        own = driven / (len(time_s) - 1)
        if state.confirmed:
            return max((span_s - driven) / self.task.batch, own), True
        if state.alarmed:
            near = rivals(found)
            effects = [keys for keys in near if not found.is_shape(keys)]
            lives = any(name in found.known.in_time for keys in effects[:3] for name, _ in keys)
            pace = max(span_s, 1800.0) / _MOMENTS
            return (pace, True) if lives and pace > own else (own, False)
        if found.readings >= _SPREAD_FROM and driven < span_s:
            pace = (span_s - driven) / max(_SPREAD_TO - self.task.batch - found.readings, self.task.batch)
            return (pace, True) if pace > own else (own, False)
        return own, False


def _apart(robot: Any, names: tuple[str, ...]) -> dict[str, int]:
    """Columns that number what is read, and how many there are, where there are several."""
    targets = len(getattr(robot, "targets_mm", (0,)))
    return {"target": targets} if "target" in names and targets > 1 else {}
