"""Sets of poses: grids over the workspace in φ and γ."""

from __future__ import annotations

import numpy as np

from ...base.types import Floats
from ...errors import RobotError
from .robot import Spherical


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
