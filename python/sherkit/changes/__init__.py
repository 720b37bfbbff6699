"""What has changed since: a machine before and after, over the years, and whether its calibration still holds."""

from .change_model import ParameterChange
from .comparison import Comparison, compare
from .history import Course, History, history
from .verification import verify, verifying_poses
from .verified import Verification

__all__ = [
    "Comparison", "Course", "History", "ParameterChange", "Verification", "compare", "history", "verify",
    "verifying_poses",
]  # fmt: skip
