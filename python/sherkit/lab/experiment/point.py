"""What is read at a step."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Point:
    """What was read at a step: its pose and repeat, the host's time (s since 1970), and values by column name."""

    pose: int
    repeat: int
    time_s: float
    values: Mapping[str, float]
