"""How far readings that were repeated are from each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..base.types import Bools, Floats, Ints


@dataclass(frozen=True)
class Repeatability:
    """Spread of repeated readings of the same pose: pooled standard deviation per reading.

    ``sigma`` maps a reading (``x_mm`` …) to its pure error, ``degrees_of_freedom`` to how many
    readings it rests on beyond one per pose.
    """

    sigma: dict[str, float]
    degrees_of_freedom: dict[str, int]


def pure_error(names: Sequence[str], values: Floats, used: Bools, groups: Ints) -> Repeatability | None:
    """How far ``values`` (n, m) of one group are from each other, of those that are ``used`` (n, m); None where every
    group has one row."""
    sigma: dict[str, float] = {}
    freedom: dict[str, int] = {}
    for k, name in enumerate(names):
        rows = used[:, k]
        if not rows.any():
            continue
        group = np.unique(groups[rows], return_inverse=True)[1]
        count = np.bincount(group)
        value = values[rows, k]
        mean = np.bincount(group, value) / count
        free = int((count - 1).sum())
        if free > 0:
            sigma[name] = float(np.sqrt(((value - mean[group]) ** 2).sum() / free))
            freedom[name] = free
    return Repeatability(sigma, freedom) if sigma else None
