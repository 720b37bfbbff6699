"""Which joints show given readings: Gauss and Newton from the nearest of places tried, within the ranges of the joints.

Machines with more joints than readings take the nearest solution to where they begin; with fewer, only readings that
they can show are reached.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy

from ...base import linalg
from ...base.types import Bools, Floats

#: Places over the ranges of the joints from which one begins.
_PLACES = 1024
_ROUNDS = 30
#: Part of a range by which a step counts as none.
_STILL = 1e-12
#: Part of a range by which a solution may leave it: a machine is not quite as drawn.
_SLACK = 0.02


def starts(forward: Callable[[Floats], Floats], readings: Floats, box: Floats) -> Floats:
    """For each of the readings (n, m) the nearest place (n, k) of the joints, of many over their ``box`` (k, 2)."""
    low, high = box.T
    joints = low + (high - low) * scipy.stats.qmc.Halton(len(low), scramble=False).random(_PLACES + 1)[1:]
    shown = forward(joints)
    known = np.isfinite(shown).all(axis=1)
    joints, shown = joints[known], shown[known]
    if not len(joints):
        return np.full((len(readings), len(low)), np.nan)
    out = np.empty((len(readings), len(low)))
    for first in range(0, len(readings), 512):
        part = readings[first : first + 512]
        apart = ((part[:, None, :] - shown[None, :, :]) ** 2).sum(axis=2)
        out[first : first + 512] = joints[np.argmin(apart, axis=1)]
    return out


def settled(
    forward: Callable[[Floats], tuple[Floats, Floats]], readings: Floats, start: Floats, box: Floats
) -> tuple[Floats, Bools]:
    """Joints (n, k) that show these readings (n, m), and which rows settled; others are NaN.

    ``forward`` gives readings and their derivatives by the joints.
    """
    low, high = box.T
    span = high - low
    joints = start.copy()
    still = np.zeros(len(joints), dtype=bool)
    best = np.full(len(joints), np.inf)
    step = np.zeros_like(joints)
    shorter = np.ones(len(joints))
    for _ in range(_ROUNDS):
        shown, by_joints = forward(joints + shorter[:, None] * step)
        off = np.where(np.isfinite(shown).all(axis=1), np.linalg.norm(readings - shown, axis=1), np.inf)
        # a step that makes it worse is taken half as far
        good = off <= np.maximum(best * (1 + 1e-9), 1e-12 * np.linalg.norm(readings, axis=1))
        joints = np.where(good[:, None], joints + shorter[:, None] * step, joints)
        best = np.where(good, off, best)
        fresh = good & np.isfinite(by_joints).all(axis=(1, 2))
        if fresh.any():
            by = by_joints[fresh] * span  # joints in parts of their ranges
            now = linalg.pinv(by, rcond=1e-12) @ (readings[fresh] - shown[fresh])[:, :, None]
            step[fresh] = now[:, :, 0] * span
        # what is already at its place stays
        shorter = np.where(
            good, np.minimum(1.0, 0.5 / np.maximum(np.abs(step / span).max(axis=1), 1e-300)), 0.5 * shorter
        )
        still = (np.abs(step / span).max(axis=1) < _STILL) | (shorter < 1e-6)
        if still.all():
            break
    scale = np.abs(readings).max(axis=1) + 1.0
    within = ((joints >= low - _SLACK * span) & (joints <= high + _SLACK * span)).all(axis=1)
    reached = (best <= 1e-9 * scale) & within & np.isfinite(joints).all(axis=1)
    return np.where(reached[:, None], joints, np.nan), reached
