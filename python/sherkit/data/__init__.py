"""Rows of readings with units, repeats and covariates, from files and frames."""

from .bluesky import from_bluesky
from .frames import from_arrays, from_frame
from .reader import read_measurements
from .repeats import Repeatability
from .ros import from_rosbag
from .rows import Measurements
from .stream import MeasurementStream, stream_measurements

__all__ = [
    "MeasurementStream",
    "Measurements",
    "Repeatability",
    "from_arrays",
    "from_bluesky",
    "from_frame",
    "from_rosbag",
    "read_measurements",
    "stream_measurements",
]
