"""What a user would write instead: the linear delta in vectorised NumPy, fitted with SciPy."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

#: Radius, angle, offset and rod of each limb, among its six numbers.
FREE = np.array([6 * limb + k for limb in range(3) for k in range(4)])


def forward(p: Floats, q: Floats) -> Floats:
    """Platform centres (n, 3) from joints (n, 3) and 18 parameters, by intersecting three spheres."""
    limb = p.reshape(3, 6)
    a = limb[:, 0] * np.cos(limb[:, 1]) - limb[:, 4] * np.cos(limb[:, 5])
    b = limb[:, 0] * np.sin(limb[:, 1]) - limb[:, 4] * np.sin(limb[:, 5])
    h = q + limb[:, 2]
    r = limb[:, 3]
    # differences of the sphere equations are linear in x and y, with z left as a parameter
    det = 2 * ((a[1] - a[0]) * (b[2] - b[0]) - (a[2] - a[0]) * (b[1] - b[0]))
    s = a**2 + b**2 + h**2 - r**2
    k2, k3 = s[:, 1] - s[:, 0], s[:, 2] - s[:, 0]
    g2, g3 = h[:, 1] - h[:, 0], h[:, 2] - h[:, 0]
    x0 = (k2 * (b[2] - b[0]) - k3 * (b[1] - b[0])) / det
    y0 = (k3 * (a[1] - a[0]) - k2 * (a[2] - a[0])) / det
    x1 = -2 * (g2 * (b[2] - b[0]) - g3 * (b[1] - b[0])) / det
    y1 = -2 * (g3 * (a[1] - a[0]) - g2 * (a[2] - a[0])) / det
    u, v = x0 - a[0], y0 - b[0]
    qa = x1**2 + y1**2 + 1
    qb = u * x1 + v * y1 - h[:, 0]
    qc = u**2 + v**2 + h[:, 0] ** 2 - r[0] ** 2
    z = (-qb - np.sqrt(qb**2 - qa * qc)) / qa
    return np.stack([x0 + x1 * z, y0 + y1 * z, z], axis=1)


def forward_plain(p: Floats, q: Floats, shift: Floats | float = 0.0) -> Floats:
    """The same as it is usually written: vectors and cross products, no algebra by hand. ``shift`` (n, 3, 2) moves the
    carriages sideways."""
    limb = p.reshape(3, 6)
    base = limb[:, :1] * np.stack([np.cos(limb[:, 1]), np.sin(limb[:, 1])], axis=1)
    plate = limb[:, 4:5] * np.stack([np.cos(limb[:, 5]), np.sin(limb[:, 5])], axis=1)
    centres = np.empty((len(q), 3, 3))
    centres[:, :, :2] = base - plate + shift
    centres[:, :, 2] = q + limb[:, 2]
    s1, s2, s3 = centres[:, 0], centres[:, 1], centres[:, 2]
    r = limb[:, 3]
    ex = s2 - s1
    d = np.linalg.norm(ex, axis=1, keepdims=True)
    ex = ex / d
    i = np.sum(ex * (s3 - s1), axis=1, keepdims=True)
    ey = s3 - s1 - i * ex
    ey = ey / np.linalg.norm(ey, axis=1, keepdims=True)
    ez = np.cross(ex, ey)
    j = np.sum(ey * (s3 - s1), axis=1, keepdims=True)
    x = (r[0] ** 2 - r[1] ** 2 + d**2) / (2 * d)
    y = (r[0] ** 2 - r[2] ** 2 + i**2 + j**2) / (2 * j) - i / j * x
    z = np.sqrt(r[0] ** 2 - x**2 - y**2)
    side = -np.sign(ez[:, 2:])
    return s1 + x * ex + y * ey + side * z * ez


def derivatives(p: Floats, q: Floats) -> tuple[Floats, Floats, Floats]:
    """Platform centres (n, 3), their derivatives (n, 3, 12) by radius, angle, offset and rod of each limb, and by what
    moves the end of each rod (n, 3, 3, 3: coordinate, limb, direction), by the rule for implicit functions."""
    limb = p.reshape(3, 6)
    x = forward(p, q)
    cos, sin = np.cos(limb[:, 1]), np.sin(limb[:, 1])
    a = limb[:, 0] * cos - limb[:, 4] * np.cos(limb[:, 5])
    b = limb[:, 0] * sin - limb[:, 4] * np.sin(limb[:, 5])
    rods = np.stack([x[:, :1] - a, x[:, 1:2] - b, x[:, 2:] - q - limb[:, 2]], axis=2)
    # (x - c) · dx = (x - c) · dc + r dr for each limb: the inverse by cross products
    across = np.stack([np.cross(rods[:, (k + 1) % 3], rods[:, (k + 2) % 3]) for k in range(3)], axis=2)
    inverse = across / np.einsum("nk,nk->n", rods[:, 0], across[:, :, 0])[:, None, None]
    by_end = inverse[:, :, :, None] * rods[:, None]
    out = np.empty((len(q), 3, 12))
    out[:, :, 0::4] = by_end[..., 0] * cos + by_end[..., 1] * sin
    out[:, :, 1::4] = limb[:, 0] * (by_end[..., 1] * cos - by_end[..., 0] * sin)
    out[:, :, 2::4] = by_end[..., 2]
    out[:, :, 3::4] = inverse * limb[:, 3]
    return x, out, by_end


def turned(by: Floats) -> tuple[Floats, Floats]:
    """The rotation about a vector (3,) and by what its change turns (3, 3 each), by Rodrigues' formula."""
    angle = np.sqrt(by @ by)
    k = np.array([[0.0, -by[2], by[1]], [by[2], 0.0, -by[0]], [-by[1], by[0], 0.0]])
    once, twice = np.sinc(angle / np.pi), 0.5 * np.sinc(0.5 * angle / np.pi) ** 2
    rest = (1.0 - once) / angle**2 if angle > 1e-4 else 1.0 / 6.0
    return np.eye(3) + once * k + twice * (k @ k), np.eye(3) + twice * k + rest * (k @ k)


def designed(p: Floats, q: Floats, offset: Floats, values: Floats) -> tuple[Floats, Floats]:
    """Readings (n, 3) for 18 values, geometry and the sensor's turn and shift, and their derivatives (n, 3, 18)."""
    full = p.copy()
    full[FREE] += values[:12]
    x, by_geometry, _ = derivatives(full, q)
    rotation, change = turned(values[12:15])
    there = (x + offset) @ rotation.T
    out = np.zeros((len(q), 3, 18))
    out[:, :, :12] = rotation @ by_geometry
    # a further turn about each axis moves a point by the cross product of both
    across = np.cross(change.T[None, :, :], there[:, None, :])
    out[:, :, 12:15] = across.transpose(0, 2, 1)
    out[:, [0, 1, 2], [15, 16, 17]] = 1.0
    return there + values[15:], out


def gauss_newton(p: Floats, q: Floats, measured: Floats, offset: Floats) -> tuple[Floats, float]:
    """Values (18,) of geometry and sensor to the minimum, by normal equations, and the sum of squares left there."""
    values, last = np.zeros(18), np.inf
    for _ in range(30):
        predicted, columns = designed(p, q, offset, values)
        left = measured - predicted
        cost = float(np.einsum("nk,nk->", left, left))
        if last - cost <= 1e-12 * cost:
            break
        last = cost
        design = columns.reshape(-1, 18)
        size = np.sqrt(np.einsum("nk,nk->k", design, design))
        gram = (design.T @ design) / np.outer(size, size)
        # some directions change no reading: what is left of them is rounding
        eigenvalues, vectors = np.linalg.eigh(gram)
        kept = eigenvalues > 1e-12 * eigenvalues[-1]
        step = vectors[:, kept] @ ((vectors[:, kept].T @ ((design.T @ left.ravel()) / size)) / eigenvalues[kept])
        values = values + step / size
    return values, cost
