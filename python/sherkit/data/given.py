"""A run as a person has it at hand: read already, a file, a frame, or columns by name."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..errors import MeasurementError
from .frames import from_frame
from .headers import Columns
from .reader import read_measurements
from .rows import Measurements

#: Measurements, the path of their file, a polars or pandas frame, or a mapping of columns.
RunLike = Any


def run_of(given: RunLike, columns: Columns | None = None) -> Measurements:
    """The measurements; ``columns`` gives the names of a file or a frame by ours.

    Raises :class:`~sherkit.errors.MeasurementError` for what holds none, and as the readers do.
    """
    if isinstance(given, Measurements):
        return given
    if isinstance(given, str | os.PathLike):
        return read_measurements(Path(given), columns=columns)
    if isinstance(given, Mapping) or hasattr(given, "columns"):
        return from_frame(given, columns=columns)
    raise MeasurementError(
        f"expected measurements, the path of their file, a frame or columns by name; got {type(given).__name__}"
    )
