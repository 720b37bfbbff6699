"""What a user would write instead: the spherical robot in vectorised NumPy, from the paper's Eqs. 34 and 35."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def forward(alpha: float, beta: float, q: Floats) -> Floats:
    """φ, γ (n, 2) from joints (n, 2)."""
    half = (q[:, 0] - q[:, 1]) / 2
    root = np.sqrt(np.sin(beta) ** 2 - (np.sin(alpha) * np.sin(half)) ** 2)
    gamma = 2 * np.arctan((np.sin(alpha) * np.cos(half) + root) / (np.cos(alpha) + np.cos(beta)))
    return np.stack([(q[:, 0] + q[:, 1]) / 2, gamma], axis=1)


def inverse(alpha: float, beta: float, x: Floats) -> Floats:
    """Joints (n, 2) from φ, γ (n, 2)."""
    half = np.arccos((np.cos(beta) - np.cos(alpha) * np.cos(x[:, 1])) / (np.sin(alpha) * np.sin(x[:, 1])))
    return np.stack([x[:, 0] + half, x[:, 0] - half], axis=1)


def forward_of_cones(alpha: tuple[float, float], beta: tuple[float, float], q: Floats) -> Floats:
    """The same of a mechanism with two unlike limbs: two cones about the elbows meet (general α₁, α₂, β₁, β₂)."""
    first, second = (
        np.stack([np.sin(a) * np.cos(t), np.sin(a) * np.sin(t), np.full(len(q), np.cos(a))], axis=1)
        for a, t in zip(alpha, q.T, strict=True)
    )
    dot = (first * second).sum(axis=1)
    normal = np.cross(first, second)
    area = (normal * normal).sum(axis=1)
    k1, k2 = np.cos(beta[0]), np.cos(beta[1])
    plane = ((k1 - k2 * dot) / area)[:, None] * first + ((k2 - k1 * dot) / area)[:, None] * second
    out = np.sqrt((1 - (plane * plane).sum(axis=1)) / area)[:, None] * normal
    axis = np.where(((plane + out)[:, 2] < (plane - out)[:, 2])[:, None], plane + out, plane - out)
    return np.stack([np.arctan2(axis[:, 1], axis[:, 0]), np.arccos(axis[:, 2])], axis=1)
