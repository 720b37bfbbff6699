"""Sets of postures of a serial arm that a simulation can name."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from ...base.types import Floats
from .robot import Serial

#: Postures of each, and the part of the limits that a local set keeps to.
_WHOLE, _LOCAL, _PART = 60, 40, 0.2


def postures(robot: Serial, count: int, share: float = 1.0, seed: int = 0) -> Floats:
    """Joint readings (count, k), at random within ``share`` of the limits about home."""
    low, high = robot.ranges
    middle = np.clip(robot.home, low, high)
    at = np.random.default_rng(seed).uniform(size=(count, len(low)))
    return middle + share * (low + at * (high - low) - middle)


#: All that the joints can reach, and the middle of it.
AREAS: Mapping[str, Callable[[Serial], Floats]] = {
    "whole": lambda robot: postures(robot, _WHOLE),
    "local": lambda robot: postures(robot, _LOCAL, _PART),
}
