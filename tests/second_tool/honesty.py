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
    """``coverage`` of 95 % regions, ``nees`` per degree of freedom (1 where honest), ``largest`` error along an axis of
    the region in its deviations, ``beyond_5`` rows with more than five, ``mean_error_mm``; of ``rows``."""

    rows: int
    coverage: float
    nees: float
    largest: float
    beyond_5: int
    mean_error_mm: float


def honesty(value: ArrayLike, covariance: ArrayLike, truth: ArrayLike) -> Honesty:
    """Of estimates (n,) or (n, k) with variances (n,) or covariances (n, k, k). Rows without a truth are left out.

    A row whose estimate or covariance is no number counts as not covered. Nobody's claim is finer than a micrometre: an
    axis of the region along which less is said (up the shaft of a tool that hardly bends) is no degree of freedom, but
    an error of two micrometres along it is not covered, and of five lies beyond five deviations.
    """
    x, t = (np.asarray(v, dtype=float) for v in (value, truth))
    x, t = x.reshape(len(x), -1), t.reshape(len(t), -1)
    k = x.shape[1]
    spread = np.asarray(covariance, dtype=float).reshape(len(x), k, k)
    known = np.isfinite(t).all(axis=1)
    off, spread = (x - t)[known], spread[known]
    usable = np.isfinite(off).all(axis=1) & np.isfinite(spread).all(axis=(1, 2))
    variances, axes = np.linalg.eigh(np.where(usable[:, None, None], spread, 0.0))
    along = np.abs(np.einsum("nij,ni->nj", axes, np.where(usable[:, None], off, 0.0)))
    said = variances > _FINEST_MM**2
    scaled = along / np.sqrt(np.where(said, variances, _FINEST_MM**2))
    degrees = said.sum(axis=1)
    squared = (scaled**2 * said).sum(axis=1)
    limit = stats.chi2.ppf(0.95, np.arange(1, k + 1))
    within = squared <= np.concatenate([[0.0], limit])[degrees]
    fine = np.where(said, 0.0, scaled).max(axis=1)
    covered = usable & within & (fine <= 2.0)
    worst = np.where(usable, scaled.max(axis=1), np.inf)
    freedom = int(degrees[usable].sum())
    nees = float(squared[usable].sum() / freedom) if usable.all() and freedom else np.inf if freedom else 0.0
    size = float(np.linalg.norm(off, axis=1).mean())
    return Honesty(len(off), float(covered.mean()), nees, float(worst.max()), int((worst > 5.0).sum()), size)


def pooled(some: Sequence[Honesty]) -> Honesty:
    """Of several runs, weighted by their rows."""
    rows = np.array([h.rows for h in some], dtype=float)

    def mean(name: str) -> float:
        values: NDArray[np.float64] = np.array([getattr(h, name) for h in some])
        return float(values @ rows / rows.sum())

    return Honesty(int(rows.sum()), mean("coverage"), mean("nees"), max(h.largest for h in some),
                   sum(h.beyond_5 for h in some), mean("mean_error_mm"))  # fmt: skip
