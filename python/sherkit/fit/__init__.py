"""Values, covariances and directions from readings; what is held out."""

from .hold_out import HeldOut, hold_out
from .identify import Fit, identify
from .set_up import Mistake, set_up_mistakes
from .stream import StreamFit, identify_stream

__all__ = [
    "Fit",
    "HeldOut",
    "Mistake",
    "StreamFit",
    "hold_out",
    "identify",
    "identify_stream",
    "set_up_mistakes",
]
