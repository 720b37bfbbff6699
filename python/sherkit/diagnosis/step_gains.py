"""What a step in time takes of residuals, wherever it stands."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from ..base.types import Floats, Ints


def step_gains(left: Floats, inside: Floats, cuts: Ints, least: float) -> Floats:
    """Sum of squares (c,) that a step on all axes, from each cut on, takes of what orthonormal columns ``left`` (n, m);
    nothing where they leave less than the part ``least`` of it. They have ``inside`` (c, m) of its square."""
    n = len(left)
    free = (n - cuts)[:, None] - inside
    return np.where(free > least * n, _since(left, cuts) ** 2 / np.maximum(free, 1e-12), 0.0).sum(axis=1)


def within(columns: Iterable[Floats], cuts: Ints) -> Floats | float:
    """Of the square of a step from each cut on (c, m), what orthonormal ``columns``, each (n, m), have; nothing of
    none."""
    return sum((_since(column, cuts) ** 2 for column in columns), 0.0)


def _since(values: Floats, cuts: Ints) -> Floats:
    """Sums (c, m) of values (n, m) from each cut on."""
    return np.cumsum(values[::-1], axis=0)[::-1][cuts]
