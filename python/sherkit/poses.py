"""Sets of poses: the paper's two grid experiments, and grids in general."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .errors import RobotError
from .robots.spherical import Spherical

Floats = NDArray[np.float64]


def grid(half_width_mm: float, per_side: int, planes_mm: Sequence[float]) -> Floats:
    """Points (n, 3), mm: square grids of ``per_side``² over ±``half_width_mm``, one per height, plane by plane.

    Rows are walked back and forth, so that neighbours in the list are neighbours in space.
    """
    ticks = np.linspace(-half_width_mm, half_width_mm, per_side)
    plane = [(x, y) for j, y in enumerate(ticks) for x in (ticks if j % 2 == 0 else ticks[::-1])]
    return np.array([(x, y, z) for z in planes_mm for x, y in plane], dtype=float).reshape(-1, 3)


def paper_whole() -> Floats:
    """588 poses: planes z = -20, 0, 20 mm of 14 × 14 over ±20 mm (Xiao et al. 2022, section III)."""
    return grid(20.0, 14, (-20.0, 0.0, 20.0))


def paper_local() -> Floats:
    """363 poses: planes z = -10, 0, 10 mm of 11 × 11 over ±10 mm. The paper's text counts 393."""
    return grid(10.0, 11, (-10.0, 0.0, 10.0))


def sphere_patch(robot: Spherical, per_side: int, share: float = 1.0) -> Floats:
    """Directions φ, γ (n, 2), rad: a grid over the middle ``share`` of a spherical robot's workspace, row by row.

    Rows are walked back and forth. Raises :class:`~sherkit.errors.RobotError` where the robot has no workspace.
    """
    if robot.phi_deg is None or robot.gamma_deg is None:
        raise RobotError("a grid over the workspace needs [workspace] phi_deg and gamma_deg in the robot file")
    ticks = []
    for low, high in (robot.phi_deg, robot.gamma_deg):
        middle, half = 0.5 * (low + high), 0.5 * share * (high - low)
        ticks.append(np.deg2rad(np.linspace(middle - half, middle + half, per_side)))
    phi, gamma = ticks
    return np.array([(a, b) for j, b in enumerate(gamma) for a in (phi if j % 2 == 0 else phi[::-1])], dtype=float)
