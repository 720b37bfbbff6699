"""Sets of poses: grids on horizontal planes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...base.types import Floats


def grid(half_width_mm: float, per_side: int, planes_mm: Sequence[float]) -> Floats:
    """Points (n, 3), mm: square grids of ``per_side``² over ±``half_width_mm``, one per height, plane by plane.

    Rows are walked back and forth, so that neighbours in the list are neighbours in space.
    """
    ticks = np.linspace(-half_width_mm, half_width_mm, per_side)
    plane = [(x, y) for j, y in enumerate(ticks) for x in (ticks if j % 2 == 0 else ticks[::-1])]
    return np.array([(x, y, z) for z in planes_mm for x, y in plane], dtype=float).reshape(-1, 3)
