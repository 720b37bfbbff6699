"""What a user would write instead: the linear delta in vectorised NumPy, fitted with SciPy."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


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


def forward_plain(p: Floats, q: Floats) -> Floats:
    """The same as it is usually written: vectors and cross products, no algebra by hand."""
    limb = p.reshape(3, 6)
    base = limb[:, :1] * np.stack([np.cos(limb[:, 1]), np.sin(limb[:, 1])], axis=1)
    plate = limb[:, 4:5] * np.stack([np.cos(limb[:, 5]), np.sin(limb[:, 5])], axis=1)
    centres = np.empty((len(q), 3, 3))
    centres[:, :, :2] = base - plate
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
