"""Values, covariances and directions from readings; what is held out."""

from .hold_out import HeldOut, hold_out
from .identify import Fit, identify
from .stream import StreamFit, identify_stream

__all__ = [
    "Fit",
    "HeldOut",
    "StreamFit",
    "hold_out",
    "identify",
    "identify_stream",
]
