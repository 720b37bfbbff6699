"""Whether what is left is steady in the course of a run, or wanders slowly, as no noise of single readings does.

A filter takes out what neighbours in time have in common, since instruments do err so. What moves over tens of rows is
more than that: to such a filter it looks like noise, and repeats that lie far apart count it as theirs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from ..base.types import Floats
from ..data.columns import bare
from .fitted_run import FittedRun

#: Slow is what takes more rows than this for one swing; of so many swings in the run at least, and at most.
_ROWS, _FEWEST, _MOST = 30, 3, 30
#: Rows below which slow and quick are not told apart.
_LEAST = 60
#: Chance that steady noise is said to wander.
_LEVEL = 1e-3
#: The most that an instrument's readings have in common from row to row; what has more wanders.
_COMMON = 0.7


@dataclass(frozen=True)
class SlowDrift:
    """The axis that wanders most of those of which it is no chance, or else most surely; by how much, RMS, and what is
    left from row to row besides, both in the unit of errors; ``p`` over all axes."""

    axis: str
    p: float
    size: float
    beside: float

    @property
    def counts(self) -> bool:
        """Whether it is no chance."""
        return self.p <= _LEVEL


def slow_drift_of(run: FittedRun) -> SlowDrift | None:
    """What is left of a run by the time at which it was read; None where that is not known, or for too few rows.

    Of the periodogram of what an autoregression of first order leaves, of no more than a few rows' memory, the slowest
    lines hold a share that is a beta variable for steady noise (Percival and Walden, *Spectral Analysis for Physical
    Applications*, 1993, ch. 6).
    """
    data = run.data
    rows = np.flatnonzero(run.whole)
    if data.time_s is None or len(rows) < _LEAST:
        return None
    # several targets are read at one time
    moments, at = np.unique(data.time_s[rows], return_inverse=True)
    count = np.bincount(at)
    if len(moments) < _LEAST:
        return None
    axes = list(run.axes)
    left = np.column_stack([np.bincount(at, run.residuals[rows, a]) / count for a in axes])
    p, size, beside = _slow(left - left.mean(axis=0))
    p = np.minimum(1.0, len(axes) * p)
    worst = int(np.argmax(np.where(p <= _LEVEL, size, 0.0)) if (p <= _LEVEL).any() else np.argmin(p))
    names = [bare(name) for name in run.names]
    return SlowDrift(
        names[axes[worst]], float(p[worst]), run.per_unit * float(size[worst]),
        run.per_unit * float(beside[worst]),
    )  # fmt: skip


def _slow(left: Floats) -> tuple[Floats, Floats, Floats]:
    """For each column of (n, m) in the order of time: the chance of so much that is slow in steady noise, its size
    beyond what steady noise would have there, and that of the rest."""
    n = len(left)
    lines = int(np.clip(n // _ROWS, _FEWEST, _MOST))
    power = (left[:-1] ** 2).sum(axis=0)
    rho = np.clip((left[1:] * left[:-1]).sum(axis=0) / np.where(power > 0, power, 1.0), 0.0, _COMMON)
    white = left[1:] - rho * left[:-1]
    every = (n - 2) // 2
    of_white = _periodogram(white)[1 : every + 1]
    total = of_white.sum(axis=0)
    p = np.ones(left.shape[1])
    for count in {_FEWEST, lines}:
        share = of_white[:count].sum(axis=0) / np.where(total > 0, total, 1.0)
        # the upper tail of the beta distribution; scipy.stats would take longer to import than all of this to say
        once = scipy.special.betainc(every - count, count, 1.0 - share)
        p = np.minimum(p, np.where(total > 0, 2.0 * once, 1.0))
    slow, quick = np.split(2.0 * _periodogram(left)[1:] / n**2, [lines])
    # steady noise is as strong in the slow lines as in others
    noise = quick.mean(axis=0) * lines
    return p, np.sqrt(np.maximum(slow.sum(axis=0) - noise, 0.0)), np.sqrt(quick.sum(axis=0) + noise)


def _periodogram(columns: Floats) -> Floats:
    return np.asarray(np.abs(np.fft.rfft(columns, axis=0)) ** 2)
