"""Sets of poses of the delta: grids on horizontal planes, the paper's, and what a plan or a simulation can name."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from ...base.types import Floats
from ...data.toml import Table
from ...model.kinds import MOST_IN_LINE, MOST_PER_SIDE
from .robot import Delta


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


# -- By name ------------------------------------------------------------------------------------------------------


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
