"""Sets of poses of the spherical robot that a plan or a simulation can name."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from ...base.types import Floats
from ...data.toml import Table
from ...model.kinds import MOST_IN_LINE, MOST_PER_SIDE
from .poses import sphere_patch
from .robot import Spherical
from .straightness import LINES, targets


def _patch(robot: Spherical, table: Table) -> Floats:
    return sphere_patch(
        robot, table.whole("per_side", least=1, most=MOST_PER_SIDE), table.number("share", 1.0, positive=True)
    )


def _line(robot: Spherical, table: Table) -> Floats:
    # the straightness experiment
    line = LINES[table.text("line", tuple(LINES))]
    return targets(robot.seen, robot.radius_mm, line, table.whole("count", 41, least=3, most=MOST_IN_LINE))


def _list(robot: Spherical, table: Table) -> Floats:
    del robot
    rows = table.rows("list_deg", 2)
    if not rows:
        raise table.fail("list_deg", "at least one direction")
    return np.deg2rad(np.array(rows))


#: Directions φ, γ (n, 2), rad, by the name that the plan gives them.
POSES: Mapping[str, Callable[[Spherical, Table], Floats]] = {"patch": _patch, "line": _line, "list": _list}
#: The whole workspace, and the middle half of it.
AREAS: Mapping[str, Callable[[Spherical], Floats]] = {
    "whole": lambda robot: sphere_patch(robot, 12),
    "local": lambda robot: sphere_patch(robot, 8, 0.5),
}
