"""Whether rows that stand apart are accidents, each for itself, or lie together: in time, in a joint, in a place.

What is wrong by accident is so anywhere. A dent in a rail, dirt on a scale, a target that was knocked are wrong in one
stretch: a structure, which no row that is left out may hide. The stretch that holds most of them for its length is
looked for by a scan (Kulldorff, "A spatial scan statistic", *Commun. Statist. Theory Meth.* 26, 1997), in every joint
and coordinate and in the order of time; its chance is multiplied by the number of stretches and variables that were
looked at, so that the level holds over all of them together (Bonferroni).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import scipy

from ..base.figures import number, spans
from ..base.types import Bools, Floats, Ints
from ..data import Measurements
from ..data.columns import bare, unit_in
from ..evidence.fitted_run import FittedRun
from ..evidence.thresholds import ACCIDENT, SURE_SIGMA, WRONG
from .result import FEW, SINGLY, Check

#: So many wrong poses, or visits, lie together at least.
_FEWEST = 3
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
    data: Measurements, outliers: Ints, places: Mapping[str, Floats], *, level: float = ACCIDENT
) -> Gathered | None:
    """The stretch in which rows that stand apart (k,) lie together; None where they lie as accidents do.

    ``places`` name to values (n,) where the machine was: joints and coordinates, the latter as a model has them, since
    what was read there is what is wrong. Rows that are marked otherwise count for nothing.
    """
    wrong = np.zeros(len(data), dtype=bool)
    wrong[outliers] = True
    every = np.flatnonzero(wrong | ~data.outlier)
    pose = np.unique(data.standing[every], return_inverse=True)[1].ravel()
    # a pose is one witness of where it stands, a visit to it one of when it was there
    order = np.argsort(data.order[every], kind="stable")
    visit = np.empty(len(order), dtype=np.int64)
    visit[order] = np.cumsum(np.diff(pose[order], prepend=-1) != 0) - 1
    asked = [("", visit, visit.astype(float)), *((name, pose, values[every]) for name, values in places.items())]
    found = [one for one in (_stretch(*each, every, wrong[every]) for each in asked) if one is not None]
    # two questions, of time and of place; where both are as rare, the one that holds fewer of the others
    ways = [2.0 * one.p * (len(places) if one.name else 1) for one in found]
    best = min(zip(ways, found, strict=True), key=lambda one: (one[0], -one[1].inside / one[1].there), default=None)
    return replace(best[1], p=best[0]) if best is not None and best[0] <= level else None


def _stretch(name: str, unit: Ints, values: Floats, every: Ints, off: Bools) -> Gathered | None:
    """The stretch of ``values`` (n,) that holds most units that are wrong for its length, with its chance.

    Of k wrong ones among n, those behind the first of a stretch lie anywhere: how many come as soon is hypergeometric,
    and each of k may be the first, and each number of them the one that is counted.
    """
    count = np.bincount(unit)
    mean = np.bincount(unit, values) / count
    wrong = np.flatnonzero(np.bincount(unit, off) > 0)
    n, k = len(mean), len(wrong)
    if k < _FEWEST or not np.ptp(mean) > 0:
        return None
    ranked, at = np.sort(mean), np.sort(mean[wrong])
    first, last = np.searchsorted(ranked, at), np.searchsorted(ranked, at, side="right")
    best = 1.0, 0.0, 0.0
    sizes = np.unique(np.geomspace(_FEWEST, k, _SIZES).round().astype(np.int64))
    for size in sizes:
        length = last[size - 1 :] - first[: k - size + 1]
        begin = int(np.argmin(length))
        if length[begin] <= _LONGEST * n:
            p = _at_least(int(size) - 1, n - 1, k - 1, int(length[begin]) - 1)
            best = min(best, (p, float(at[begin]), float(at[begin + size - 1])))
    chance, low, high = best
    if chance == 1.0:
        return None
    inside = ((mean >= low) & (mean <= high))[unit]
    there, here = unit[inside], unit[off & inside]
    return Gathered(
        name,
        low,
        high,
        every[off & inside],
        len(np.unique(here)),
        len(np.unique(there)),
        min(chance * k * len(sizes), 1.0),
    )


# -- what a verdict rests on ---------------------------------------------------------------------------------------


def checks_of_outliers(run: FittedRun, outliers: Ints, *, side: bool) -> tuple[Check, ...]:
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
    found = gathered(data, asked[_still_off(run, asked)], places)
    if found is None:
        told = f"they lie as accidents do, in time and in {len(places)} joints and coordinates"
        return few, Check(SINGLY, tested, rows, told, holds=True)
    told = found.where(data)
    return few, Check(SINGLY, tested, rows, told.rstrip(","), holds=False, p=found.p, fails=said(found, data))


def _still_off(run: FittedRun, rows: Ints) -> Bools:
    """Which of the rows (k,) stand apart from the others with what was found in the model, too: those that an effect
    explains were wrong beside a model that lacked it, and are no structure of their own."""
    # a reading that was not taken is NaN, and none
    return np.asarray((np.abs(run.residuals[rows]) > SURE_SIGMA * run.scatter)[:, list(run.axes)].any(axis=1))


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


def _at_least(few: int, n: int, k: int, drawn: int) -> float:
    """Chance that of ``n``, ``k`` of them wrong, so many ``drawn`` hold a ``few`` wrong ones or more: hypergeometric,
    without scipy.stats, which takes longer to import than most diagnoses."""
    some = np.arange(max(few, drawn - (n - k)), min(k, drawn) + 1)

    def ways(a: int, b: Ints | int) -> Floats:
        return -np.log(a + 1.0) - scipy.special.betaln(a - b + 1.0, b + 1.0)

    each = ways(k, some) + ways(n - k, drawn - some) - ways(n, drawn)
    return min(float(np.exp(each).sum()), 1.0)
