"""What the virtual robots have in common: the order in which they are driven to their poses."""

from __future__ import annotations

import numpy as np

from ..base.types import Ints
from ..errors import ShapeError

_ORDERS = ("planes", "shuffled")


def walked(poses: int, repeats: int, order: str, rng: np.random.Generator) -> tuple[Ints, dict[str, Ints]]:
    """Which of the poses each row (n,) is at, and the columns of a run that say it, counted from 1.

    ``planes``: as listed, pass after pass; ``shuffled``: anew for each pass. Raises
    :class:`~sherkit.errors.ShapeError`.
    """
    if order not in _ORDERS:
        raise ShapeError(f"order: '{order}' is not known; choose {' or '.join(_ORDERS)}")
    if repeats < 1:
        raise ShapeError(f"repeats: expected at least 1, got {repeats}")
    listed = np.arange(poses)
    pose = np.concatenate([rng.permutation(listed) if order == "shuffled" else listed for _ in range(repeats)])
    return pose, {"pose": pose + 1, "repeat": np.repeat(np.arange(repeats) + 1, poses)}
