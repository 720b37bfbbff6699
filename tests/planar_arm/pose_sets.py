"""Sets of poses of the planar arm that a plan or a simulation can name."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from sherkit.base.types import Floats
from sherkit.data.toml import Table

from .robot import PlanarArm


def fan(robot: PlanarArm, per_side: int, share: float = 1.0) -> Floats:
    """Places x, y (n, 2), mm: a fan before the arm, ``per_side`` distances by as many directions."""
    reach = sum(robot.length_mm)
    radii = reach * np.linspace(0.65 - 0.27 * share, 0.65 + 0.27 * share, per_side)
    angles = np.linspace(-1.3, 1.3, per_side) * share
    return np.array([(r * np.cos(a), r * np.sin(a)) for r in radii for a in angles])


def _fan(robot: PlanarArm, table: Table) -> Floats:
    return fan(robot, table.whole("per_side", least=1))


#: Places (n, 2), mm, by the name that the plan gives them.
POSES: Mapping[str, Callable[[PlanarArm, Table], Floats]] = {"fan": _fan}
#: All of the fan, and the middle of it.
AREAS: Mapping[str, Callable[[PlanarArm], Floats]] = {
    "whole": lambda robot: fan(robot, 9),
    "local": lambda robot: fan(robot, 6, 0.4),
}
