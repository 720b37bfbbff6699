"""Is a stated deviation true? Coverage of 95 %, NEES, and the largest error in deviations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

_FINEST_MM = 1e-3


@dataclass(frozen=True)
class Honesty:
    """``coverage`` of 95 % regions, ``nees`` per degree of freedom (1 where honest), ``largest`` error of a coordinate
    in its deviations, ``beyond_5`` rows with more than five, ``mean_error_mm``; of ``rows``."""

    rows: int
    coverage: float
    nees: float
    largest: float
    beyond_5: int
    mean_error_mm: float


def honesty(value: ArrayLike, covariance: ArrayLike, truth: ArrayLike) -> Honesty:
    """Of estimates (n,) or (n, k) with variances (n,) or covariances (n, k, k). Rows without a truth are left out.

    A row whose estimate or covariance is no number counts as not covered. A micrometre is added to each deviation:
    nobody's claim is finer, and along the shaft it may be zero.
    """
    x, t = (np.asarray(v, dtype=float) for v in (value, truth))
    x, t = x.reshape(len(x), -1), t.reshape(len(t), -1)
    k = x.shape[1]
    spread = np.asarray(covariance, dtype=float).reshape(len(x), k, k) + _FINEST_MM**2 * np.eye(k)
    known = np.isfinite(t).all(axis=1)
    off, spread = (x - t)[known], spread[known]
    std = np.sqrt(np.einsum("nii->ni", spread))
    usable = np.isfinite(off).all(axis=1) & np.isfinite(spread).all(axis=(1, 2)) & (std > 0).all(axis=1)
    squared, scaled = np.full(len(off), np.inf), np.full(len(off), np.inf)
    squared[usable] = np.einsum(
        "ni,ni->n", off[usable], np.linalg.solve(spread[usable], off[usable][..., None])[..., 0]
    )
    scaled[usable] = (np.abs(off[usable]) / std[usable]).max(axis=1)
    covered = float((squared <= stats.chi2.ppf(0.95, k)).mean())
    size = float(np.linalg.norm(off, axis=1).mean())
    return Honesty(len(off), covered, float(squared.mean() / k), float(scaled.max()), int((scaled > 5.0).sum()), size)


def pooled(some: Sequence[Honesty]) -> Honesty:
    """Of several runs, weighted by their rows."""
    rows = np.array([h.rows for h in some], dtype=float)

    def mean(name: str) -> float:
        values: NDArray[np.float64] = np.array([getattr(h, name) for h in some])
        return float(values @ rows / rows.sum())

    return Honesty(int(rows.sum()), mean("coverage"), mean("nees"), max(h.largest for h in some),
                   sum(h.beyond_5 for h in some), mean("mean_error_mm"))  # fmt: skip
