"""Robots: nominal geometry, workspace, region of interest, and how to read them from TOML."""

from .delta import Delta
from .file import load_robot, save_robot

__all__ = ["Delta", "load_robot", "save_robot"]
