"""Rows of readings with units, repeats and covariates, from files and frames."""

from .arrays import from_arrays
from .frames import from_frame
from .reader import read_measurements
from .rows import Measurements, Repeatability
from .stream import MeasurementStream, stream_measurements

__all__ = [
    "MeasurementStream",
    "Measurements",
    "Repeatability",
    "from_arrays",
    "from_frame",
    "read_measurements",
    "stream_measurements",
]
