"""A fit to start from that outliers have not ruined."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy

from ..base.types import Bools, Floats, Ints
from ..data.noise import MAD
from ..errors import SherkitError
from ..evidence.fitted_run import FittedRun
from ..evidence.thresholds import ROUNDING, ROUNDS
from ..fit.least_squares import LeastSquaresProblem

#: Residuals are cut to this many spreads; what is further than so many stands apart.
CUT, _APART = 1.5, 10.0


def robust_start(run: FittedRun, rows: Ints) -> FittedRun:
    """The fit, or where gross errors have ruined it another one, without what stands apart from a robust one that began
    at the drawing.

    It is ruined where it did not end, or where the median row is further off than before the fit.
    """
    axes = list(run.axes)
    data = run.data.select(rows)
    problem = LeastSquaresProblem(run.model, data)
    floor = np.maximum(ROUNDING * np.ptp(data.readings[:, axes], axis=0), 1e-12)

    def typical(values: Floats) -> float:
        return float(np.median(np.linalg.norm(problem.residuals(values)[:, axes] / run.noise[0][axes], axis=1)))

    values = run.model.start(data)
    if run.fit.converged and typical(run.fit.values) <= typical(values):
        return run
    for _ in range(ROUNDS):
        weights, left = np.zeros(data.readings.shape), problem.residuals(values)[:, axes]
        spread = np.maximum(MAD * np.median(np.abs(left), axis=0), floor)
        weights[:, axes] = 1.0 / spread
        before = typical(values)
        try:
            there = problem.solve(weights, values, loss="huber")[0].trial
            if typical(there) >= (1.0 - 1e-6) * before:
                break
        except SherkitError:  # not every step ends at a robot that could be built
            break
        values = there
    left = problem.residuals(values)[:, axes]
    spread = np.maximum(MAD * np.median(np.abs(left), axis=0), floor)
    return run.without(rows[(np.abs(left) > _APART * spread).any(axis=1)])


def median(values: Floats, weight: Floats) -> Floats:
    """That (…) of values (n, …), each of this ``weight`` (n,)."""
    if np.ptp(weight) <= 0:
        return np.asarray(np.median(values, axis=0))
    order = np.argsort(values, axis=0)
    half = np.cumsum(weight[order], axis=0) >= 0.5 * weight.sum()
    return np.asarray(np.take_along_axis(values, np.take_along_axis(order, half.argmax(axis=0)[None], 0), 0)[0])


def huber(e: Floats, fitted: Callable[[Floats], Floats], weight: Floats) -> Floats:
    """What a fit leaves of residuals (n, m) when outliers are cut to size; ``fitted`` is what it takes of any, and
    their spread is that by ``weight`` (n,)."""
    left = e
    before = np.inf
    for _ in range(5 * ROUNDS):
        limit = CUT * MAD * median(np.abs(left), weight)
        tame = e - left + np.clip(left, -limit, limit)
        left = e - fitted(tame)
        now = float(limit.sum())
        if abs(before - now) <= 1e-3 * now:
            break
        before = now
    return left


# -- The noise within poses, and the readings that stand apart from the others of theirs ---------------------------


def apart_from_pose(e: Floats, repeated: Ints, floor: Floats, level: float) -> tuple[Floats, Bools]:
    """Noise (m,) within poses, zero where it is not known; and the rows (n,) that stand apart from the other
    readings of their pose."""
    n, m = e.shape
    group = np.unique(repeated, return_inverse=True)[1].ravel()
    order = np.argsort(group, kind="stable")
    ordered, ids = e[order], group[order]
    steps = np.diff(ordered, axis=0)[np.diff(ids) == 0]
    if len(steps) < 5:
        return np.zeros(m), np.zeros(n, dtype=bool)
    noise = np.maximum(MAD * np.median(np.abs(steps), axis=0) / np.sqrt(2.0), floor)
    threshold = scipy.special.chdtri(m, level / n)
    count = np.bincount(group)
    starts = np.concatenate([[0], np.cumsum(count)[:-1]])
    far = np.zeros(n, dtype=bool)
    for size in np.unique(count[count >= 2]):
        rows = starts[count == size][:, None] + np.arange(size)
        off = (ordered[rows] - np.median(ordered[rows], axis=1, keepdims=True)) / noise
        far[order[rows]] = np.square(off).sum(axis=2) > threshold * (1.0 if size > 2 else 0.5)
    steps = np.diff(ordered, axis=0)[(np.diff(ids) == 0) & ~far[order][1:] & ~far[order][:-1]]
    return np.sqrt(0.5 * (steps**2).mean(axis=0)) if len(steps) else noise, far
