"""Values, covariances and directions from readings; what is held out."""

from .identify import Fit, HeldOut, hold_out, identify
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
