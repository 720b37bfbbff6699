"""Where to measure next: places that show most of what may be missing, or that tell its rivals apart.

Before an alarm every effect counts: the gain of ``log det(I + 4 S)`` of each (D_s-optimal design; Atkinson, Donev and
Tobias, *Optimum Experimental Designs, with SAS*, 2007), S what the model leaves of its columns. After it those that are
nearly as likely as the best: the squared distance of what two of them predict over the variance of both (T-optimal;
Atkinson and Fedorov, 1975). One place in five is anywhere, for what nobody thought of, and every other is the best of
some dozens at random: corners tell most by the drawing and least of what is not in it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..base import linalg
from ..base.types import Floats
from ..data import Measurements
from ..data.columns import POSE, REASON, REPEAT
from ..errors import FitError, SherkitError
from ..evidence.blocks import Block
from ..evidence.design import showing
from ..evidence.family import Family
from ..evidence.sets import EffectSet
from ..evidence.thresholds import A_FEW, ROUNDING, TIED
from ..planning.region import CANDIDATES, PosesToDrive
from .known import run_at
from .look import FEWEST, InterimAnalysis, called
from .rule import RuleState
from .task import Task

# -- Places ------------------------------------------------------------------------------------------------------------

#: Candidates for each batch, the share of places that are anywhere, and what a coefficient is expected to be, and may
#: be, squared.
_ANYWHERE, _EXPECTED, _AT_MOST = 0.2, 4.0, 36.0


#: What would explain the readings: effects, or shapes of what is in no catalogue.
Rival = tuple[Block, ...]


def rivals(found: InterimAnalysis) -> list[Rival]:
    """What is nearly as likely as the best, the best first; shapes are always among them."""
    shapes, lead = found.names.alone, found.lead
    if lead is None:
        return [shapes.shapes] if shapes.shapes else []
    best = max(lead.value, shapes.evidence)
    # the leader and something besides is no rival of it: what it leaves tells of that
    near = [one.blocks for one in found.sets if one.value > best - TIED and not set(lead.names) <= set(one.names)]
    beside = [shapes.shapes] if shapes.shapes and shapes.evidence > best - TIED else []
    return [lead.blocks, *near[: A_FEW - 1], *beside]


@dataclass(frozen=True, eq=False)
class _There:
    """Places as the model sees them a little later: ``own`` (n, m, p) by what it fits, and by what may be missing."""

    found: InterimAnalysis
    places: PosesToDrive
    family: Family
    own: Floats

    @classmethod
    def of(cls, found: InterimAnalysis, after_s: float, rng: np.random.Generator, *, shapes: bool) -> _There:
        """Some places anywhere that what was fitted can reach."""
        known, fit = found.known, found.fit
        places = known.region.anywhere(CANDIDATES, rng)
        rows = known.later(found.data, places, after_s, rng)
        reached = np.isfinite(fit.model.predict(rows, fit.values)[:, known.axes]).all(axis=1)[-len(places) :]
        if not reached.all():
            places = places.pick(reached)
            if not len(places):
                raise FitError("the robot, as it was fitted, reaches nothing")
            rows = known.later(found.data, places, after_s, rng)
        run = run_at(replace(fit, data=rows), found.run.sigma)
        own = run.view.fitted(run.view.whole)[-len(places) :]
        return cls(found, places, Family(run, known.reference, shapes=shapes), own)

    def columns(self, blocks: Sequence[Block]) -> Floats:
        """Columns (n, m, p + k) of what the model fits and of these."""
        more = self.found.raw(*blocks, at=self.family)
        more = more.reshape(len(self.family.run), self.own.shape[1], more.shape[1])
        return np.concatenate([self.own, more[-len(self.own) :]], axis=2)


def choose(
    found: InterimAnalysis, count: int, alarmed: bool, rng: np.random.Generator, pace_s: float
) -> list[tuple[PosesToDrive, str]]:
    """So many places, shuffled, and why; ``pace_s`` is how much later each of them will be read."""
    against = rivals(found) if alarmed else []
    telling = alarmed and (len(against) > 1 or found.log_evidence < TIED)
    there = _There.of(found, pace_s * count, rng, shapes=telling)
    anywhere = int(rng.binomial(count, _ANYWHERE))
    if telling:
        picked = _telling(there, against, count - anywhere)
        reason = "|".join(" & ".join(map(called, one)) for one in against[:2]) if len(against) > 1 else "confirm"
    else:
        picked = _showing(there, count - anywhere, against)
        reason = "confirm" if alarmed else "all"
    out = [(there.places.pick([k]), reason) for k in picked]
    free = [k for k in range(len(there.places)) if k not in picked][:anywhere]
    out += [(there.places.pick([k]), "explore") for k in free]
    return [out[k] for k in rng.permutation(len(out))]


def _now(found: InterimAnalysis, blocks: Sequence[Block], most: float) -> tuple[Floats, Floats]:
    """Columns (N, p + k) of what the model fits and of these in the rows read, and what they tell where coefficients
    have the variance ``most``."""
    run = found.run
    own = run.flat(run.view.fitted(run.view.whole))
    more = found.raw(*blocks)
    columns = np.concatenate([own, more], axis=1)
    info = columns.T @ columns
    diagonal, k = np.diag(info), own.shape[1]
    info = info + np.diag(ROUNDING * diagonal + 1e-300 + ROUNDING * diagonal.max(initial=0.0) * 1e-6)
    info[k:, k:] += np.eye(more.shape[1]) / most
    return columns, info


def _showing(there: _There, count: int, only: Sequence[Rival]) -> list[int]:
    """The places that show most of every effect, one after another."""
    found = there.found
    every = [block for one in only for block in one] or list(found.by_effect.values())
    known = {block.name for block in there.family.blocks}
    parts = [(_now(found, [one], _EXPECTED)[1], there.columns([one])) for one in every if one.name in known]
    return showing(there.own, _now(found, (), _EXPECTED)[1], parts, count)


def _telling(there: _There, against: Sequence[Rival], count: int) -> list[int]:
    """The places at which what the rivals predict lies farthest apart."""
    sets: list[Rival] = list(against)
    if there.found.log_evidence < TIED or len(sets) < 2:
        sets.append(())
    return [int(k) for k in np.argsort(-_apart(there, sets))[:count]]


def _apart(there: _There, sets: Sequence[Rival]) -> Floats:
    """How far apart (n,) the predictions of these sets lie at each place, over their own errors."""
    residual, predicted, variances, noise = there.found.run.residual, [], [], np.inf
    for blocks in sets:
        (columns, info), at_place = _now(there.found, blocks, _AT_MOST), there.columns(blocks)
        inverse = linalg.inv(info)
        at = inverse @ (columns.T @ residual)
        left = float(np.square(residual - columns @ at).sum()) / max(len(residual) - columns.shape[1], 1)
        noise = min(noise, left)
        predicted.append(at_place @ at)
        variances.append(1.0 + np.einsum("nmp,pq,nmq->nm", at_place, inverse, at_place))
    gained = np.zeros(len(there.own))
    # what tells the first from a rival, not rivals from each other
    for k in range(1, len(sets)):
        apart = np.square(predicted[k] - predicted[0]) / ((variances[k] + variances[0]) * max(noise, 1e-300))
        gained += np.log1p(apart.sum(axis=1))
    return gained


def are_beyond(found: InterimAnalysis, tied: Sequence[EffectSet], budget: int, late_s: float, margin: float) -> bool:
    """Whether the readings that are left, wherever and whenever they are taken, would tell none of those tied from the
    first of them, by a ``margin``."""
    if budget <= found.readings:
        return False
    rng = np.random.default_rng(found.readings)
    others = tied[1:A_FEW]
    ahead = np.array([tied[0].value - other.value for other in others])
    far = np.zeros(len(others))
    for after_s in (0.0, late_s):
        there = _There.of(found, after_s, rng, shapes=False)
        far = np.maximum(far, np.expm1([_apart(there, (tied[0].blocks, other.blocks)).max() for other in others]))
    # half of a squared distance is what a reading adds to the logarithm of their ratio
    return bool((ahead + 0.5 * far * (budget - found.readings) < margin * TIED).all())


# -- Batches -----------------------------------------------------------------------------------------------------------
# What is asked for next: the first poses, poses that tell most, poses once more, and when.

#: Readings over which the rest of the span is spread where nothing shows.
_SPREAD_TO = 60
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
        targets = len(getattr(self.task.robot, "targets_mm", (0,)))
        if "target" in self.task.layout.apart and targets > 1:
            row["target"] = 1 + pose % targets
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
            lives = any(block.name in found.known.in_time for one in rivals(found)[:3] for block in one)
            pace = max(span_s, 1800.0) / _MOMENTS
            return (pace, True) if lives and pace > own else (own, False)
        if found.readings >= FEWEST and driven < span_s:
            pace = (span_s - driven) / max(_SPREAD_TO - self.task.batch - found.readings, self.task.batch)
            return (pace, True) if pace > own else (own, False)
        return own, False
