"""The noise within poses, and the readings that stand apart from the others of theirs."""

from __future__ import annotations

import numpy as np

from ..base.types import Bools, Floats, Ints
from ..data.noise import MAD
from .lack_of_fit import normal_beyond


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
    threshold = normal_beyond(0.5 * level / (n * m))
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
