"""A robot compared with its measurements, step by step: each change, what it left, and the way back."""

from .files import Before, StudyStep
from .study import Study

__all__ = ["Before", "Study", "StudyStep"]
