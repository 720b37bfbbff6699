"""Where a run measured, in joints: the convex hull of its poses, and how far a posture lies outside it.

A box of places says little of an arm: a place may be inside it with joints that nothing like was measured. Distances to
the hull are those of its nearest point, a sum of poses with weights that are not negative (Wolfe, "Finding the nearest
point in a polytope", Mathematical Programming 1976; by non-negative least squares), with each joint in half of what it
ranges over, so that one is the way from the middle of the poses to their rim.
"""

from __future__ import annotations

import numpy as np
import scipy

from ..base.types import Floats

#: Poses that are kept of a run, the outermost of it; and directions in which these are looked for.
_KEPT, _DIRECTIONS = 300, 3000
#: Digits of what is kept: joints are read no finer.
_DIGITS = 6
#: A joint that moves less than this part of the one that moves most stands still; by so much of that it may be off.
_STILL = 0.01
#: So far outside counts as measured, in half ranges: a tenth of the range, as for a box.
MARGIN = 0.2
#: What is rounding of it.
_ROUNDING = 1e-6
#: By which the sum of weights is held at one, in units of the other equations.
_ONE = 1e3


def outermost(joints: Floats) -> Floats:
    """Of the joints (n, j) of a run those of its outermost poses (k, j); all of them where they are few."""
    known = np.unique(np.round(joints[np.isfinite(joints).all(axis=1)], _DIGITS), axis=0)
    if len(known) <= _KEPT:
        return known
    spread = known.std(axis=0)
    scaled = (known - known.mean(axis=0)) / np.where(spread > 0, spread, 1.0)
    directions = np.random.default_rng(0).normal(size=(_DIRECTIONS, scaled.shape[1]))
    directions = np.concatenate([directions, np.eye(scaled.shape[1]), -np.eye(scaled.shape[1])])
    extreme, often = np.unique(np.argmax(scaled @ directions.T, axis=0), return_counts=True)
    kept = extreme[np.argsort(-often, kind="stable")[:_KEPT]]
    return known[np.sort(kept)]


def beyond(poses: Floats, joints: Floats) -> Floats:
    """How far each posture (n, j) lies outside the hull of ``poses`` (k, j), in half ranges (n,); zero inside it, and
    where no poses are known."""
    out = np.zeros(len(joints))
    if not poses.size:  # no poses, or nothing that moves
        return out
    middle, half = 0.5 * (poses.max(axis=0) + poses.min(axis=0)), 0.5 * np.ptp(poses, axis=0)
    half = np.maximum(half, _STILL * max(float(half.max()), 1e-12) / MARGIN)
    there, asked = (poses - middle) / half, (joints - middle) / half
    equations = np.vstack([there.T, np.full(len(there), _ONE)])
    for k, q in enumerate(asked):
        out[k] = scipy.optimize.nnls(equations, np.append(q, _ONE))[1] if np.isfinite(q).all() else np.inf
    return np.where(out <= _ROUNDING, 0.0, out)
