"""Robots: nominal geometry, workspace, region of interest, and how to read them from TOML."""

from .delta import Delta
from .file import Robot, load_robot, save_robot
from .spherical import CameraView, Spherical

__all__ = ["CameraView", "Delta", "Robot", "Spherical", "load_robot", "save_robot"]
