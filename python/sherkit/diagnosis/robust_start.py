"""A fit to start from that outliers have not ruined."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy

from ..base import linalg
from ..base.types import Bools, Floats, Ints
from ..data.noise import MAD
from ..errors import SherkitError
from ..evidence.fitted_run import DIGITS, FittedRun
from ..evidence.whitening import orthonormal

#: Residuals are cut to this many spreads.
CUT = 1.5
ROUNDS = 20


def robust_start(run: FittedRun, rows: Ints) -> FittedRun:
    """The fit, or where gross errors have ruined it another one, from the drawing and without what stands apart there.

    It is ruined where it did not end, or where the median row is further off than before the fit.
    """
    axes = list(run.axes)
    data = run.data.select(rows)
    model = run.model

    def typical(values: Floats) -> float:
        try:
            left = (data.readings - model.predict(data, values))[:, axes] / run.noise[0][axes]
        except SherkitError:  # not every step ends at a robot that could be built
            return np.inf
        return float(np.median(np.linalg.norm(left, axis=1)))

    drawn = model.start(data)
    now = typical(run.fit.values)
    if run.fit.converged and now <= typical(drawn):
        return run
    values, best = drawn, typical(drawn)
    floor = np.maximum(DIGITS * np.ptp(data.readings[:, axes], axis=0), 1e-12)
    for _ in range(ROUNDS):
        # the step that the bulk of the rows asks for, until it gains no more
        residual = (data.readings - model.predict(data, values))[:, axes]
        columns = model.derivatives(data, values)[:, axes]
        step = _robust_step(residual, columns, floor)
        while typical(values + step) > best and np.abs(step).max() > 0:
            step = 0.5 * step
            if np.abs(step).max() < 1e-9 * np.abs(values).max(initial=1e-9):
                break
        else:
            values = values + step
            gained, best = best - typical(values), typical(values)
            if gained > 1e-6 * best:
                continue
        break
    left = (data.readings - model.predict(data, values))[:, axes]
    spread = MAD * np.median(np.abs(left), axis=0)
    far = (np.abs(left) > 10.0 * np.maximum(spread, floor)).any(axis=1)
    return run.without(rows[far])


def _robust_step(residual: Floats, columns: Floats, floor: Floats) -> Floats:
    """The linear step (p,) that residuals (n, m) ask for, outliers cut to size; ``floor`` (m,) is what digits do."""
    spread = np.maximum(MAD * np.median(np.abs(residual), axis=0), floor)
    e = residual / spread
    a = (columns / spread[:, None]).reshape(e.size, -1)
    scale = np.maximum(np.linalg.norm(a, axis=0), 1e-300)
    q = orthonormal(a)
    left = huber(e, lambda tame: (q @ (q.T @ tame.reshape(-1))).reshape(e.shape))
    return linalg.lstsq(a / scale, (e - left).reshape(-1), rcond=1e-9)[0] / scale


def huber(e: Floats, fitted: Callable[[Floats], Floats]) -> Floats:
    """What a fit leaves of residuals (n, m) when outliers are cut to size; ``fitted`` is what it takes of any."""
    left = e
    before = np.inf
    for _ in range(5 * ROUNDS):
        limit = CUT * MAD * np.median(np.abs(left), axis=0)
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
    threshold = float(-scipy.special.ndtri(0.5 * level / (n * m)))
    count = np.bincount(group)
    starts = np.concatenate([[0], np.cumsum(count)[:-1]])
    far = np.zeros(n, dtype=bool)
    for size in np.unique(count[count >= 2]):
        rows = starts[count == size][:, None] + np.arange(size)
        block = ordered[rows]
        limit = threshold * noise * (1.0 if size > 2 else np.sqrt(0.5))
        apart = np.abs(block - np.median(block, axis=1, keepdims=True)) > limit
        far[order[rows.ravel()]] = apart.any(axis=2).ravel()
    steps = np.diff(ordered, axis=0)[(np.diff(ids) == 0) & ~far[order][1:] & ~far[order][:-1]]
    return np.sqrt(0.5 * (steps**2).mean(axis=0)) if len(steps) else noise, far
