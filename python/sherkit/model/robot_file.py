"""Files of robots of any kind, TOML in and TOML out; and a robot given by its file."""

from __future__ import annotations

import os
from pathlib import Path

import tomli_w

from ..data.toml import read_toml
from ..errors import RobotError
from .kinds import Robot, robot_from_tables

#: A robot, or the path of its file.
RobotLike = Robot | str | os.PathLike[str]


def load_robot(path: str | os.PathLike[str]) -> Robot:
    """Reads a robot from TOML. Raises :class:`~sherkit.errors.RobotError` naming file, table and key."""
    return robot_from_tables(read_toml(Path(path), "robot"), str(path))


def save_robot(robot: Robot, path: str | os.PathLike[str]) -> None:
    """Writes a robot file that :func:`load_robot` reads."""
    Path(path).write_text(tomli_w.dumps(robot.to_tables()), encoding="utf-8")


def robot_of(given: RobotLike) -> Robot:
    """A robot as it is, or read from its file. Raises :class:`~sherkit.errors.RobotError` for anything else."""
    if isinstance(given, str | os.PathLike):
        return load_robot(given)
    # by its kind alone: Python before 3.12 would ask every property, and a robot without a workspace refuses its middle
    if not isinstance(getattr(given, "kind", None), str):
        raise RobotError(f"expected a robot or the path of its file, got {type(given).__name__}")
    return given
