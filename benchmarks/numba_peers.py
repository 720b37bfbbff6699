"""What a user would write in an afternoon with numba: the same formulas in loops, compiled, on one core."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@njit(cache=True)
def delta_forward(p: Floats, q: Floats) -> Floats:
    """Platform centres (n, 3) of the linear delta, by intersecting three spheres; p (18,), q (n, 3)."""
    a, b = np.empty(3), np.empty(3)
    for k in range(3):
        a[k] = p[6 * k] * math.cos(p[6 * k + 1]) - p[6 * k + 4] * math.cos(p[6 * k + 5])
        b[k] = p[6 * k] * math.sin(p[6 * k + 1]) - p[6 * k + 4] * math.sin(p[6 * k + 5])
    det = 0.5 / ((a[1] - a[0]) * (b[2] - b[0]) - (a[2] - a[0]) * (b[1] - b[0]))
    b2, b1, a2, a1 = (b[2] - b[0]) * det, (b[1] - b[0]) * det, (a[2] - a[0]) * det, (a[1] - a[0]) * det
    c1 = a[0] ** 2 + b[0] ** 2 - p[3] ** 2
    c2 = a[1] ** 2 + b[1] ** 2 - p[9] ** 2 - c1
    c3 = a[2] ** 2 + b[2] ** 2 - p[15] ** 2 - c1
    out = np.empty((len(q), 3))
    for i in range(len(q)):
        h1, h2, h3 = q[i, 0] + p[2], q[i, 1] + p[8], q[i, 2] + p[14]
        k2, k3 = c2 + h2 * h2 - h1 * h1, c3 + h3 * h3 - h1 * h1
        g2, g3 = h2 - h1, h3 - h1
        x0, y0 = k2 * b2 - k3 * b1, k3 * a1 - k2 * a2
        x1, y1 = -2 * (g2 * b2 - g3 * b1), -2 * (g3 * a1 - g2 * a2)
        u, v = x0 - a[0], y0 - b[0]
        qa = x1 * x1 + y1 * y1 + 1
        qb = u * x1 + v * y1 - h1
        qc = u * u + v * v + h1 * h1 - p[3] ** 2
        z = (-qb - math.sqrt(qb * qb - qa * qc)) / qa
        out[i, 0], out[i, 1], out[i, 2] = x0 + x1 * z, y0 + y1 * z, z
    return out


@njit(cache=True)
def spherical_forward(alpha: float, beta: float, q: Floats) -> Floats:
    """φ, γ (n, 2) of two equal limbs (Eqs. 34, 35)."""
    out = np.empty((len(q), 2))
    sa, sb2, ends = math.sin(alpha), math.sin(beta) ** 2, math.cos(alpha) + math.cos(beta)
    for i in range(len(q)):
        half = 0.5 * (q[i, 0] - q[i, 1])
        root = math.sqrt(sb2 - (sa * math.sin(half)) ** 2)
        out[i, 0] = 0.5 * (q[i, 0] + q[i, 1])
        out[i, 1] = 2 * math.atan((sa * math.cos(half) + root) / ends)
    return out


@njit(cache=True)
def spherical_inverse(alpha: float, beta: float, x: Floats) -> Floats:
    """Joints (n, 2) of two equal limbs."""
    out = np.empty((len(x), 2))
    sa, ca, cb = math.sin(alpha), math.cos(alpha), math.cos(beta)
    for i in range(len(x)):
        half = math.acos((cb - ca * math.cos(x[i, 1])) / (sa * math.sin(x[i, 1])))
        out[i, 0], out[i, 1] = x[i, 0] + half, x[i, 0] - half
    return out


@njit(cache=True)
def project(points: Floats, turn: Floats, shift: Floats, matrix: Floats, lens: Floats) -> Floats:
    """Pixels (n, 2) of points (n, 3), mm, through five coefficients of distortion."""
    out = np.empty((len(points), 2))
    k1, k2, p1, p2, k3 = lens[0], lens[1], lens[2], lens[3], lens[4]
    for i in range(len(points)):
        a, b, c = points[i, 0], points[i, 1], points[i, 2]
        z = turn[2, 0] * a + turn[2, 1] * b + turn[2, 2] * c + shift[2]
        x = (turn[0, 0] * a + turn[0, 1] * b + turn[0, 2] * c + shift[0]) / z
        y = (turn[1, 0] * a + turn[1, 1] * b + turn[1, 2] * c + shift[1]) / z
        r = x * x + y * y
        radial = 1 + r * (k1 + r * (k2 + r * k3))
        out[i, 0] = matrix[0, 0] * (x * radial + 2 * p1 * x * y + p2 * (r + 2 * x * x)) + matrix[0, 2]
        out[i, 1] = matrix[1, 1] * (y * radial + p1 * (r + 2 * y * y) + 2 * p2 * x * y) + matrix[1, 2]
    return out
