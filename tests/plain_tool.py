"""The paper's two filters written down plainly (Ebrahimi et al. 2020, Eqs. 1, 2, 8, 9, 10 to 14), for comparison.

Nothing of the package is used: gains, lengths and stiffness as numbers, a run as arrays, textbook equations.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


class Plain(NamedTuple):
    """Depth (n,), its variance (n,), tip (n, 3), the diagonal of its covariance (n, 3)."""

    depth_mm: Floats
    variance: Floats
    tip_mm: Floats
    tip_variance: Floats


def plain_filter(
    gains: Floats, distances_mm: Floats, length_mm: float, stiffness: float, reference_nm: Floats,
    rotations: Floats, places_mm: Floats, wavelengths_nm: Floats, start_mm: float, start_variance: float,
) -> Plain:  # fmt: skip
    """Over rows (n,) of rotations (n, 3, 3), places of the unbent tip (n, 3) and wavelengths (n, 9)."""
    own = gains - gains.mean(axis=2, keepdims=True)
    shift = (wavelengths_nm - reference_nm)[:, :6].reshape(-1, 2, 3)
    moments = np.einsum("sak,nsk->nsa", own, shift)
    force = (moments[:, 1] - moments[:, 0]) / (distances_mm[1] - distances_mm[0])
    size = np.linalg.norm(force, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        measured = distances_mm[1] - np.linalg.norm(moments[:, 1], axis=1) / size
    n, d, p = len(force), start_mm, start_variance
    tip, spread = places_mm[0].copy(), np.eye(3) * start_variance
    out = Plain(np.zeros(n), np.zeros(n), np.zeros((n, 3)), np.zeros((n, 3)))
    for k in range(n):
        moved = places_mm[k] - places_mm[k - 1] if k else np.zeros(3)
        d, p = d + float(moved @ rotations[k - 1, :, 2]) * (k > 0), p + 0.0025
        tip, spread = tip + moved, spread + 0.01 * np.eye(3)
        if np.isfinite(measured[k]):
            pushed = size[k] >= 50.0
            gain = p / (p + (0.005 if pushed else 1e6))
            d, p = d + gain * (measured[k] - d), p * (1.0 - gain)
            arm = length_mm - min(max(d, 0.0), length_mm)
            bend = (arm**3 / 3.0 + arm**2 * (length_mm - arm) / 2.0) / stiffness
            h = rotations[k].T
            seen = np.array([*(force[k] * bend), 0.0]) + h @ places_mm[k]
            noise = np.diag([0.002, 0.002, 0.0] if pushed else [10.0, 10.0, 0.0])
            weight = spread @ h.T @ np.linalg.inv(h @ spread @ h.T + noise)
            tip, spread = tip + weight @ (seen - h @ tip), (np.eye(3) - weight @ h) @ spread
        out.depth_mm[k], out.variance[k], out.tip_mm[k], out.tip_variance[k] = d, p, tip, np.diag(spread)
    return out


class PlainTool(NamedTuple):
    """Gains (2, 2, 3), the nine references, bending stiffness."""

    gains: Floats
    reference_nm: Floats
    stiffness: float


def plain_calibration(
    force_mn: Floats,
    depth_mm: Floats,
    wavelengths_nm: Floats,
    deflection_mm: Floats,
    distances_mm: Floats,
    length_mm: float,
) -> PlainTool:
    """A bench (n, 2), (n,), (n, 9), (n,) as the paper reads it: moments F (l_i - d) by small bends (Eq. 1, section
    VII)."""
    size = np.linalg.norm(force_mn, axis=1)
    on = size > 0.0
    reference = wavelengths_nm[~on].mean(axis=0)
    shift = (wavelengths_nm - reference)[on, :6].reshape(-1, 2, 3)
    own = shift - shift.mean(axis=2, keepdims=True)
    arms = distances_mm - depth_mm[on, None]
    gains = [np.linalg.lstsq(own[:, s], force_mn[on] * arms[:, s, None], rcond=None)[0].T for s in range(2)]
    bend = size[on] * (length_mm - depth_mm[on]) ** 3 / 3.0
    return PlainTool(np.array(gains), reference, float(bend @ bend / (bend @ deflection_mm[on])))
