"""A machine from the Python file that makes it. Runs the file with the rights of whoever names it."""

from __future__ import annotations

import importlib.util
import os
import sys
from pathlib import Path

from ...errors import RobotError, SherkitError
from ...model.kinds import Robot
from ...model.robot_file import RobotLike, load_robot
from ...names import listed
from .machine import Machine

_PYTHON = ".py"


def is_machine(path: str | os.PathLike[str]) -> bool:
    """Whether a path is that of a Python file, which would be run."""
    return Path(path).suffix.lower() == _PYTHON


def load_machine(path: str | os.PathLike[str]) -> Machine:
    """The machine that a Python file makes at its top level.

    Raises :class:`~sherkit.errors.RobotError` where the file is not there, fails, or makes none or several.
    """
    path = Path(path)
    if not path.is_file():
        raise RobotError(f"{path}: there is no such file of a machine")
    name = path.stem
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise RobotError(f"{path}: is not a Python file")
    module = importlib.util.module_from_spec(spec)
    before = sys.modules.get(name)
    sys.modules[name] = module  # what it defines is found again by name: in copies, in other processes
    try:
        spec.loader.exec_module(module)
        return _only(path, {key: value for key, value in vars(module).items() if isinstance(value, Machine)})
    except (Exception, SystemExit) as error:
        del sys.modules[name]
        if before is not None:
            sys.modules[name] = before
        if isinstance(error, SherkitError):
            raise
        raise RobotError(f"{path}: {type(error).__name__}: {error}") from error


def _only(path: Path, found: dict[str, Machine]) -> Machine:
    if len(found) != 1:
        has = f"makes {listed(found)}" if found else "makes none"
        raise RobotError(f"{path}: expected one machine at its top level, machine = sk.Machine(...); it {has}")
    return next(iter(found.values()))


def robot_at(path: str | os.PathLike[str]) -> tuple[Robot, RobotLike]:
    """A robot by its file or a machine by its Python file, which is run; and what :func:`run_for` wants of either.

    Only for paths that a person has typed: no file of data names what is to be run. Raises as :func:`load_robot`.
    """
    if is_machine(path):
        made = load_machine(path)
        return made, made
    return load_robot(path), path
