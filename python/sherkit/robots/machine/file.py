"""A machine from the Python file that makes it. Runs the file with the rights of whoever names it."""

from __future__ import annotations

import os
from pathlib import Path
from types import ModuleType

from ...base.names import listed
from ...errors import RobotError
from ...model.kinds import Robot
from ...model.python_file import run_python
from ...model.robot_file import RobotLike, load_robot
from .machine import Machine

_PYTHON = ".py"


def is_machine(path: str | os.PathLike[str]) -> bool:
    """Whether a path is that of a Python file, which would be run."""
    return Path(path).suffix.lower() == _PYTHON


def load_machine(path: str | os.PathLike[str]) -> Machine:
    """The machine that a Python file makes at its top level.

    Raises :class:`~sherkit.errors.RobotError` where the file is not there, fails, or makes none or several.
    """

    def take(module: ModuleType) -> Machine:
        found = {key: value for key, value in vars(module).items() if isinstance(value, Machine)}
        if len(found) != 1:
            has = f"makes {listed(found)}" if found else "makes none"
            raise RobotError(f"{path}: expected one machine at its top level, machine = sk.Machine(...); it {has}")
        return next(iter(found.values()))

    return run_python(path, "a machine", take, RobotError)


def robot_at(path: str | os.PathLike[str]) -> tuple[Robot, RobotLike]:
    """A robot by its file or a machine by its Python file, which is run; and what :func:`run_for` wants of either.

    Only for paths that a person has typed: no file of data names what is to be run. Raises as :func:`load_robot`.
    """
    if is_machine(path):
        made = load_machine(path)
        return made, made
    return load_robot(path), path
