"""Robust losses: how wide residuals spread, and how far they are from the assumed noise."""

from __future__ import annotations

import numpy as np

from ..base.types import Floats
from ..data.noise import MAD

LOSSES = ("linear", "huber", "cauchy", "tukey")


def spread(residuals: Floats, weights: Floats) -> Floats:
    """Robust spread of the weighted residuals (n, m), one per reading column, (m,)."""
    u = residuals * weights
    out = np.ones(weights.shape[1])
    for k in range(weights.shape[1]):
        used = weights[:, k] > 0
        if used.any():
            mad = MAD * float(np.median(np.abs(u[used, k])))
            out[k] = mad if mad > 0 else 1.0
    return out


def scale(residuals: Floats, weights: Floats, rank: int, loss: str) -> float:
    """Ratio of the residuals (n, m) to the assumed noise, by which the deviations grow.

    With a robust loss, Huber's correction (Huber and Ronchetti, *Robust Statistics*, Eq. 7.81).
    """
    u = (residuals * weights)[weights > 0]
    free = len(u) - rank
    if free <= 0:
        return 1.0
    if loss == "linear":
        return float(np.sqrt((u**2).sum() / free))
    wide = np.broadcast_to(spread(residuals, weights), weights.shape)[weights > 0]
    psi, slope = _influence(u / wide, loss)
    mean_slope = float(slope.mean())
    if mean_slope <= 0:
        return float(np.sqrt((u**2).sum() / free))
    correction = 1 + rank / len(u) * float(slope.var()) / mean_slope**2
    return float(correction * np.sqrt(((psi * wide) ** 2).sum() / free) / mean_slope)


def _influence(u: Floats, loss: str) -> tuple[Floats, Floats]:
    """ψ and ψ' of the losses, with the constants of the core."""
    if loss == "huber":
        inside = np.abs(u) <= 1.345
        return np.clip(u, -1.345, 1.345), inside.astype(float)
    if loss == "cauchy":
        t = (u / 2.385) ** 2
        return u / (1 + t), (1 - t) / (1 + t) ** 2
    t = np.minimum((u / 4.685) ** 2, 1.0)
    return u * (1 - t) ** 2, np.where(t < 1, (1 - t) * (1 - 5 * t), 0.0)
