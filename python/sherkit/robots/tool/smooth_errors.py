"""How well a fit to pictures is known whose errors are alike at neighbouring places and times.

A camera's errors are smooth over its field, so pictures of one region share them, and a frame that is fitted takes a
part of them that no residual shows. The errors of an axis are a Gaussian process over place and time beside white
noise; its size and reaches are those of the largest restricted likelihood, which knows what the fit has taken
(Patterson and Thompson, Biometrika 1971; Rasmussen and Williams, Gaussian Processes, 2006, 5.4.1). The covariance of
the least-squares estimate under such errors is the sandwich H⁻¹ Jᵀ C J H⁻¹.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.linalg import cho_solve

from ...base import linalg
from ...base.types import Floats

#: Pictures, evenly over the run, from which size and reaches are taken: what they cost grows with the cube.
_MOST = 240
#: What is tried: reaches over place and time in parts of what the run spans, and the variance of the smooth errors over
#: that of the noise.
_REACHES_MM, _REACHES_S = np.geomspace(0.05, 0.8, 5), np.array([0.03, 0.2, 10.0])
_RATIOS = np.concatenate([[0.0], np.geomspace(0.01, 100.0, 9)])


@dataclass(frozen=True, eq=False)
class SmoothErrors:
    """Errors of one axis: white ``noise_mm``, and smooth ones of ``size_mm`` that are alike within ``reach_mm`` and
    ``reach_s``. ``covariance`` (p, p) is that of the parameters fitted by least squares."""

    noise_mm: float
    size_mm: float
    reach_mm: float
    reach_s: float
    covariance: Floats


def smooth_errors(jacobian: Floats, residuals_mm: Floats, places_mm: Floats, time_s: Floats) -> SmoothErrors:
    """Of a least-squares fit with derivatives (n, m, p) that leaves residuals (n, m), at places (n, 3), mm, and times
    (n,). Raises :class:`~sherkit.errors.Singular` for derivatives that are no fit's."""
    n, m, p = jacobian.shape
    flat = jacobian.reshape(n * m, p)
    # the same size for angles, lengths and delays
    unit = np.linalg.norm(flat, axis=0)
    inverse = linalg.inv((flat / unit).T @ (flat / unit))
    some = np.unique(np.linspace(0, n - 1, min(n, _MOST)).round().astype(np.int64))
    j, e = jacobian[some] / unit, residuals_mm[some]
    apart = ((places_mm[some, None] - places_mm[None, some]) ** 2).sum(axis=2)
    later = (time_s[some, None] - time_s[None, some]) ** 2
    spans = np.sqrt([max(apart.max(), 1e-12), max(later.max(), 1e-12)])

    covariances, criteria, told = [], [], []
    for wide, long in product(_REACHES_MM * spans[0], _REACHES_S * spans[1]):
        alike = np.exp(-0.5 * (apart / wide**2 + later / long**2))
        within = np.einsum("nmi,nk,kmj->ij", j, alike, j, optimize=True) * (n / len(some)) ** 2
        for ratio in _RATIOS:
            criterion, variance = _restricted(j, e, ratio * alike)
            criteria.append(criterion)
            covariances.append(variance * (inverse + ratio * inverse @ within @ inverse))
            told.append((variance, ratio * variance, wide, long))
    share = np.exp(-0.5 * (np.array(criteria) - min(criteria)))
    share /= share.sum()
    noise, size, wide, long = np.array(told)[int(np.argmax(share))]
    covariance = np.einsum("k,kij->ij", share, covariances) / np.outer(unit, unit)
    return SmoothErrors(float(np.sqrt(noise)), float(np.sqrt(size)), float(wide), float(long), covariance)


def _restricted(j: Floats, e: Floats, smooth: Floats) -> tuple[float, float]:
    """Minus twice the restricted log-likelihood of residuals (n, m) whose smooth part has a covariance (n, n) in units
    of the noise's, and the variance of the noise that goes with it."""
    n, m, p = j.shape
    factor = (linalg.cholesky(np.eye(n) + smooth), True)
    solved = cho_solve(factor, np.concatenate([j.reshape(n, -1), e], axis=1))
    weighted, left = solved[:, : m * p].reshape(j.shape), solved[:, m * p :]
    gram, right = np.einsum("nmi,nmk->ik", j, weighted), np.einsum("nmi,nm->i", j, left)
    free = e.size - p
    variance = max(float((e * left).sum() - right @ linalg.solve(gram, right)), 1e-300) / free
    determinant = 2.0 * m * np.log(np.diag(factor[0])).sum() + np.linalg.slogdet(gram)[1]
    return float(free * np.log(variance) + determinant), variance
