"""Sets of poses of the delta that a plan or a simulation can name."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from ...base.types import Floats
from ...data.toml import Table
from ...model.kinds import MOST_IN_LINE, MOST_PER_SIDE
from .paper import paper_local, paper_whole
from .poses import grid
from .robot import Delta


def _grid(robot: Delta, table: Table) -> Floats:
    del robot
    half, per_side = table.number("half_width_mm", positive=True), table.whole("per_side", least=1, most=MOST_PER_SIDE)
    return grid(half, per_side, table.some_numbers("planes_mm", (0.0,)))


def _line(robot: Delta, table: Table) -> Floats:
    del robot
    begin, end = table.numbers("from_mm", 3), table.numbers("to_mm", 3)
    return np.linspace(begin, end, table.whole("count", 41, least=2, most=MOST_IN_LINE))


def _list(robot: Delta, table: Table) -> Floats:
    del robot
    rows = table.rows("list_mm", 3)
    if not rows:
        raise table.fail("list_mm", "at least one place")
    return np.array(rows)


#: Places (n, 3), mm, by the name that the plan gives them.
POSES: Mapping[str, Callable[[Delta, Table], Floats]] = {
    "paper_local": lambda robot, table: paper_local(),
    "paper_whole": lambda robot, table: paper_whole(),
    "grid": _grid,
    "line": _line,
    "list": _list,
}
#: The paper's experiments.
AREAS: Mapping[str, Callable[[Delta], Floats]] = {
    "whole": lambda robot: paper_whole(),
    "local": lambda robot: paper_local(),
}
