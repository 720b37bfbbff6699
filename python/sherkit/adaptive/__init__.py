"""Measuring until it is known: the robot chooses its next poses itself."""

from .loop import Adaptive

__all__ = ["Adaptive"]
