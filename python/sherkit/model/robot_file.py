"""Files of robots of any kind, TOML in and TOML out; and a robot given by its file."""

from __future__ import annotations

import os
import warnings
from pathlib import Path

import tomli_w

from ..data.files import write_whole
from ..data.toml import read_toml
from ..errors import RobotError, SherkitWarning
from .kinds import Robot, kind_of, robot_from_tables

#: A robot, or the path of its file.
RobotLike = Robot | str | os.PathLike[str]


def load_robot(path: str | os.PathLike[str]) -> Robot:
    """Reads a robot from TOML. Raises :class:`~sherkit.errors.RobotError` naming file, table and key.

    Settings that a kind of robot asks for and that the file leaves out are said in a
    :class:`~sherkit.errors.SherkitWarning` each, with what cannot be tried or is assumed without them.
    """
    tables = read_toml(Path(path), "robot")
    robot = robot_from_tables(tables, str(path))
    for asked in kind_of(robot).asks:
        if asked.key not in tables.get(asked.table, {}):
            # from one place, so that Python says it once, however often the file is read
            warnings.warn(f"{path}: {asked}", SherkitWarning, stacklevel=1)
    return robot


def save_robot(robot: Robot, path: str | os.PathLike[str]) -> None:
    """Writes a robot file that :func:`load_robot` reads. Raises :class:`~sherkit.errors.NotWritten`."""
    write_whole(path, tomli_w.dumps(robot.to_tables()))


def robot_of(given: RobotLike) -> Robot:
    """A robot as it is, or read from its file. Raises :class:`~sherkit.errors.RobotError` for anything else."""
    if isinstance(given, str | os.PathLike):
        return load_robot(given)
    # by its kind alone: Python before 3.12 would ask every property, and a robot without a workspace refuses its middle
    if not isinstance(getattr(given, "kind", None), str):
        raise RobotError(f"expected a robot or the path of its file, got {type(given).__name__}")
    return given
