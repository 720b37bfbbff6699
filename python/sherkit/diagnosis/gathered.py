"""Whether rows that stand apart are accidents, each for itself, or lie together: in time, in a joint, in a place.

What is wrong by accident is so anywhere. A dent in a rail, dirt on a scale, a target that was knocked are wrong in one
stretch: a structure, which no row that is left out may hide. The stretch that holds most of them for its length is
looked for by the scan statistic (Kulldorff, "A spatial scan statistic", *Commun. Statist. Theory Meth.* 26, 1997,
Bernoulli's model), in every joint and coordinate and in the order of time; how often chance gathers as many anywhere
is counted over permutations, so that the level holds over all stretches and variables together.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from ..base.figures import number, spans
from ..base.types import Bools, Floats, Ints
from ..data import Measurements
from ..data.columns import bare, unit_in
from ..evidence.fitted_run import FittedRun
from .result import FEW, SINGLY, Check

#: Part of the rows that may be listed as wrong before the rest is no run any more.
WRONG = 0.2
#: Chance that accidents are taken for a structure, over all variables of a run.
LEVEL = 0.005
#: A row still stands apart from this many deviations of the others on.
_APART = 4.0
_DRAWS, _BATCHES, _OFTEN = 999, 27, 8
#: So many wrong poses, or visits, lie together at least; more poses than this are looked at in part.
_FEWEST, _MOST = 3, 4000
#: A stretch is no longer than this part of all, and at most so many sizes of it are tried.
_LONGEST, _SIZES = 0.5, 24


@dataclass(frozen=True)
class Gathered:
    """Where rows that stand apart lie together: the ``name`` of a joint or coordinate, from ``low`` to ``high``, or
    empty for the order of time; ``rows`` (k,) are those of the data that lie there, ``inside`` of how many poses that
    are ``there``, of visits where it is time."""

    name: str
    low: float
    high: float
    rows: Ints
    inside: int
    there: int
    p: float

    def where(self, data: Measurements) -> str:
        """Its rows and where they lie, in words."""
        rows = f"{data.counted}s {spans(data.line[self.rows])}"
        if not self.name:
            return f"{rows} were read one after another"
        unit = unit_in(self.name)
        stretch = f"{bare(self.name)} between {number(self.low)} and {number(self.high)}{f' {unit}' if unit else ''}"
        return f"{rows}, with {stretch} ({self.inside} of {self.there} poses there),"


def gathered(
    data: Measurements, outliers: Ints, places: Mapping[str, Floats], *, level: float = LEVEL, seed: int = 0
) -> Gathered | None:
    """The stretch in which rows that stand apart (k,) lie together; None where they lie as accidents do.

    ``places`` name to values (n,) where the machine was: joints and coordinates, the latter as a model has them, since
    what was read there is what is wrong. Rows that are marked otherwise count for nothing.
    """
    wrong = np.zeros(len(data), dtype=bool)
    wrong[outliers] = True
    every = np.flatnonzero(wrong | ~data.outlier)
    if not wrong.any():
        return None
    pose = np.unique(data.standing[every], return_inverse=True)[1].ravel()
    off = wrong[every]
    found = [_in_place(every, pose, off, places, seed), _in_time(data, every, pose, off, seed)]
    # two questions, each at half of the level
    # where both are as rare, the one that holds fewer of the others
    best = min(
        (one for one in found if one is not None), key=lambda one: (one.p, -one.inside / one.there), default=None
    )
    return best if best is not None and 2.0 * best.p <= level else None


# -- in joints and places: poses are as many witnesses ------------------------------------------------------------


def _in_place(every: Ints, pose: Ints, off: Bools, places: Mapping[str, Floats], seed: int) -> Gathered | None:
    count = np.bincount(pose)
    bad = np.bincount(pose, off) > 0
    kept = _part(len(count))
    names, ranks = [], []
    for name, values in places.items():
        mean = (np.bincount(pose, values[every]) / count)[kept]
        if np.isfinite(mean).all() and np.ptp(mean) > 0:
            names.append(name)
            ranks.append(_Ranked.of(mean))
    wrong = np.flatnonzero(bad[kept])
    if len(wrong) < _FEWEST or not names:
        return None
    scores = [one.best(wrong[None])[0] for one in ranks]
    first = int(np.argmax(scores))
    if not scores[first] > 0:
        return None
    rng = np.random.default_rng([seed, 1])

    def by_chance(draws: int) -> Floats:
        drawn = rng.random((draws, len(kept))).argpartition(len(wrong) - 1, axis=1)[:, : len(wrong)]
        return np.asarray(np.max([one.best(drawn) for one in ranks], axis=0))

    low, high = ranks[first].stretch(wrong)
    # of poses, by the means that were ranked: visits of one differ in their last digits
    mean = np.bincount(pose, places[names[first]][every]) / count
    inside = ((mean >= low) & (mean <= high))[pose]
    here, there = np.flatnonzero(off & inside), pose[inside]
    return Gathered(
        names[first], low, high, every[here], len(np.unique(pose[here])), len(np.unique(there)),
        _chance(by_chance, float(scores[first])),
    )  # fmt: skip


# -- in time: visits, and poses that are wrong in all their readings are wrong as one --------------------------------


def _in_time(data: Measurements, every: Ints, pose: Ints, off: Bools, seed: int) -> Gathered | None:
    order = np.argsort(data.order[every], kind="stable")
    at = pose[order]
    visit = np.empty(len(order), dtype=np.int64)
    visit[order] = np.concatenate([[0], np.cumsum(at[1:] != at[:-1])])
    of_visit = np.zeros(visit.max() + 1, dtype=np.int64)
    of_visit[visit] = pose
    bad = np.bincount(visit, off) > 0
    kept = _part(len(bad))
    bad, of_visit = bad[kept], np.unique(of_visit[kept], return_inverse=True)[1].ravel()
    wrong = np.flatnonzero(bad)
    if len(wrong) < _FEWEST:
        return None
    ranked = _Ranked.of(np.arange(len(bad), dtype=float))
    score = ranked.best(wrong[None])[0]
    if not score > 0:
        return None
    visits, wrong_visits = np.bincount(of_visit), np.bincount(of_visit, bad)
    whole = (wrong_visits == visits) & (visits > 1)
    singles = int(wrong_visits[~whole].sum())
    rng = np.random.default_rng([seed, 2])

    def by_chance(draws: int) -> Floats:
        drawn = (_as_many(rng, of_visit, int(whole.sum()), singles) for _ in range(draws))
        return np.array([ranked.best(one[None])[0] for one in drawn])

    low, high = ranked.stretch(wrong)
    between = (visit >= kept[int(low)]) & (visit <= kept[int(high)])
    here = np.flatnonzero(off & between)
    return Gathered(
        "",
        low,
        high,
        every[here],
        len(np.unique(visit[here])),
        len(np.unique(visit[between])),
        _chance(by_chance, float(score)),
    )


def _as_many(rng: np.random.Generator, of_visit: Ints, whole: int, singles: int) -> Ints:
    """Visits (k,) at random: all those of ``whole`` poses, and ``singles`` of others."""
    poses = np.zeros(of_visit.max() + 1, dtype=bool)
    poses[rng.permutation(len(poses))[:whole]] = True
    all_of = poses[of_visit]
    others = np.flatnonzero(~all_of)
    return np.union1d(np.flatnonzero(all_of), rng.permutation(others)[:singles])


# -- the scan -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Ranked:
    """Values (n,) in their order: ``first`` and ``last`` are the ranks of those that are equal, by unit."""

    values: Floats
    first: Ints
    last: Ints

    @classmethod
    def of(cls, values: Floats) -> _Ranked:
        _, which, count = np.unique(values, return_inverse=True, return_counts=True)
        ends = np.cumsum(count)
        return cls(values, (ends - count)[which.ravel()], ends[which.ravel()] - 1)

    def best(self, wrong: Ints) -> Floats:
        """The largest statistic of a stretch, for each set (d, k) of units that are wrong."""
        return self._scanned(wrong)[0]

    def stretch(self, wrong: Ints) -> tuple[float, float]:
        """Lowest and highest value of the wrong units (k,) in the best stretch."""
        _, begin, size = self._scanned(wrong[None])
        inside = np.sort(self.values[wrong])[int(begin[0]) : int(begin[0]) + int(size[0])]
        return float(inside[0]), float(inside[-1])

    def _scanned(self, wrong: Ints) -> tuple[Floats, Ints, Ints]:
        n, (draws, k) = len(self.values), wrong.shape
        first, last = np.sort(self.first[wrong], axis=1), np.sort(self.last[wrong], axis=1)
        best = np.zeros(draws)
        begin, of_size = np.zeros(draws, dtype=np.int64), np.full(draws, k)
        each = np.arange(draws)
        # poses that are drawn may have had fewer visits
        sizes = np.geomspace(_FEWEST, max(k, _FEWEST), min(_SIZES, max(k, 1))).round().astype(np.int64)
        for size in np.unique(sizes[sizes <= k]):
            length = last[:, size - 1 :] - first[:, : k - size + 1] + 1
            at = np.argmin(length, axis=1)
            score = _score(float(size), length[each, at].astype(float), float(k), float(n))
            better = score > best
            best, begin, of_size = (
                np.where(better, new, old) for new, old in ((score, best), (at, begin), (size, of_size))
            )
        return best, begin, of_size


def _score(inside: float, length: Floats, wrong: float, n: float) -> Floats:
    """Kulldorff's logarithm of a likelihood ratio, of a stretch of so many units; zero where it holds no more than its
    share, or most of all."""

    def of(k: Floats | float, m: Floats | float) -> Floats:
        part = np.clip(np.asarray(k, dtype=float) / np.maximum(m, 1e-300), 1e-300, 1.0)
        return np.asarray(k * np.log(part) + (m - k) * np.log(np.maximum(1.0 - part, 1e-300)))

    # equal values may hold more wrong ones than were counted
    outside = np.maximum(n - length, wrong - inside)
    told = of(inside, length) + of(wrong - inside, outside) - of(wrong, n)
    more = (inside * outside > (wrong - inside) * length) & (length <= _LONGEST * n)
    return np.where(more, told, 0.0)


def _chance(by_chance: Callable[[int], Floats], score: float) -> float:
    """How often chance has such a score; asked no further once that is often (Besag and Clifford, "Sequential Monte
    Carlo p-values", *Biometrika* 78, 1991)."""
    asked = as_high = 0
    while asked < _DRAWS and as_high < _OFTEN:
        as_high += int((by_chance(_DRAWS // _BATCHES) >= score - 1e-9).sum())
        asked += _DRAWS // _BATCHES
    return (1 + as_high) / (1 + asked)


def _part(count: int) -> Ints:
    """All of so many units, or some of them evenly."""
    return np.unique(np.linspace(0, count - 1, min(count, _MOST)).round().astype(np.int64))


# -- what a verdict rests on ---------------------------------------------------------------------------------------


def checks_of_outliers(run: FittedRun, outliers: Ints, seed: int, *, side: bool) -> tuple[Check, ...]:
    """Whether the rows that are left out of a ``run`` with all that was found in its model are few, and accidents; of
    the first of all nothing is asked where it is left out for the ``side`` that nobody told."""
    data = run.data
    few = Check(
        FEW, "few rows are wrong", f"all {len(data)} rows",
        f"{len(outliers)} are listed as wrong and are in none of these numbers",
        holds=len(outliers) <= WRONG * len(data),
        fails=f"{len(outliers)} of {len(data)} rows stand apart from the others",
    )  # fmt: skip
    if not len(outliers):
        return (few,)
    tested, rows = "rows that are wrong are so each for itself", f"the {len(outliers)} rows listed as wrong"
    places = places_of(run)
    asked = outliers[data.order[outliers] > data.order.min()] if side else outliers
    found = gathered(data, asked[_still_off(run, asked)], places, seed=seed)
    if found is None:
        told = f"they lie as accidents do, in time and in {len(places)} joints and coordinates"
        return few, Check(SINGLY, tested, rows, told, holds=True)
    told = found.where(data)
    return few, Check(SINGLY, tested, rows, told.rstrip(","), holds=False, p=2.0 * found.p, fails=said(found, data))


def _still_off(run: FittedRun, rows: Ints) -> Bools:
    """Which of the rows (k,) stand apart from the others with what was found in the model, too: those that an effect
    explains were wrong beside a model that lacked it, and are no structure of their own."""
    # a reading that was not taken is NaN, and none
    return np.asarray((np.abs(run.residuals[rows]) > _APART * run.scatter)[:, list(run.axes)].any(axis=1))


def said(found: Gathered, data: Measurements) -> str:
    """What lies together, and what to look at."""
    told = found.where(data)
    if not found.name:
        return f"{told}, are wrong and left out: was the instrument or the target knocked, and put back?"
    return f"{told} are wrong and left out: they are no accidents; look at what is there (a dent, dirt, a bad scale)"


def places_of(run: FittedRun) -> dict[str, Floats]:
    """Joints and coordinates (n,) of all rows, by name."""
    data = run.data
    joints = {name: data.joints[:, k] for k, name in enumerate(data.layout.joints)}
    return joints | run.model.place(data, run.fit.predicted, run.fit.values)
