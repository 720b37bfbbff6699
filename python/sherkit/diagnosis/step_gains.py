"""What a step in time takes of residuals, wherever it stands."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from ..base.types import Floats, Ints


def step_gains(left: Floats, columns: Iterable[Floats], cuts: Ints, least: float) -> Floats:
    """Sum of squares (c,) that a step on all axes, from each cut on, takes of what orthonormal ``columns``, each
    (n, m), ``left`` (n, m); nothing where these leave less than the part ``least`` of it."""
    n, m = left.shape
    inside = np.zeros((len(cuts), m))
    for column in columns:
        inside += _since(column, cuts) ** 2
    free = (n - cuts)[:, None] - inside
    return np.where(free > least * n, _since(left, cuts) ** 2 / np.maximum(free, 1e-12), 0.0).sum(axis=1)


def _since(values: Floats, cuts: Ints) -> Floats:
    """Sums (c, m) of values (n, m) from each cut on."""
    return np.cumsum(values[::-1], axis=0)[::-1][cuts]
