"""Files of robots of any kind, TOML in and TOML out; and a robot given by its file."""

from __future__ import annotations

import os
import warnings
from contextlib import suppress
from pathlib import Path
from typing import Any

import tomli_w

from ..base.arguments import validate_arguments
from ..base.figures import listed
from ..data import Measurements
from ..data.called import Columns
from ..data.columns import Layout, check_columns, is_known
from ..data.files import write_whole
from ..data.reader import RunLike, run_of
from ..data.toml import Table, read_toml
from ..errors import MeasurementError, RobotError, SherkitError, SherkitWarning
from .kinds import Robot, kind_of, robot_from_tables

#: The table of a robot file that is about its runs, not about the robot.
_COLUMNS = "columns"
#: A robot, or the path of its file.
RobotLike = Robot | str | os.PathLike[str]


@validate_arguments
def load_robot(path: str | os.PathLike[str]) -> Robot:
    """Reads a robot from TOML. Raises :class:`~sherkit.errors.RobotError` naming file, table and key.

    Settings that a kind of robot asks for and that the file leaves out are said in a
    :class:`~sherkit.errors.SherkitWarning` each, with what cannot be tried or is assumed without them.

        robot = sk.load_robot("demo/robot.toml")
        print(robot.forward([130.0, 130.0, 130.0]))
    """
    if Path(path).suffix == ".py":
        raise RobotError(
            f"{path}: is a Python file, which is not run here; sherkit diagnose, calibrate, effects and app run that "
            "of a machine, and in Python it is imported"
        )
    tables = read_toml(Path(path), "robot")
    if "kind" not in tables and isinstance(tables.get("calibration"), dict):
        raise RobotError(
            f"{path}: is a calibration, where the file of a robot is expected: give that which it was made from; "
            "sherkit verify asks whether the calibration still holds"
        )
    _columns_in(tables, path)
    robot = robot_from_tables({key: value for key, value in tables.items() if key != _COLUMNS}, str(path))
    for asked in kind_of(robot).asks:
        if asked.key not in tables.get(asked.table, {}):
            # from one place, so that Python says it once, however often the file is read
            warnings.warn(f"{path}: {asked}", SherkitWarning, stacklevel=1)
    return robot


def run_for(robot: object, data: RunLike, columns: Columns | None = None) -> Measurements:
    """A run of this robot: where both are files, under the names that the table ``[columns]`` of the robot's gives, or
    those that a machine brings.

    Raises as :func:`load_robot` and :func:`~sherkit.data.read_measurements`.
    """
    if columns is None and isinstance(robot, str | os.PathLike) and isinstance(data, str | os.PathLike):
        columns = columns_of(robot)
    own = getattr(robot, "brings", None)
    if own is None:
        return _by_what_is_known(run_of(data, columns, _layouts_of(robot)))
    given = getattr(robot, "columns", None)
    try:
        return run_of(data, columns or given or None, (own.layout,)).read_as(own.layout)
    except MeasurementError as error:
        if given is None or columns or given or not isinstance(data, str | os.PathLike):
            raise
        names = f"the joints {listed(own.layout.joints)} and the readings {listed(own.layout.readings)}"
        raise MeasurementError(
            f"{error} ({own.name} has {names}; for a file with other names: sk.Machine(…, columns={{ours: theirs}}))"
        ) from None


def _layouts_of(robot: object) -> tuple[Layout, ...]:
    """The kinds of run that a robot may have; none where it is not known, which its own reader says."""
    with warnings.catch_warnings(), suppress(SherkitError):
        warnings.simplefilter("ignore", SherkitWarning)
        known = read_robot(robot)
        return tuple(kind_of(known).layouts) if isinstance(getattr(known, "kind", None), str) else ()
    return ()


def _by_what_is_known(data: Measurements) -> Measurements:
    """Rows that were read before their robot, read again now that it is there."""
    if is_known(data.layout):
        return data
    frame = data.to_frame()
    layout = check_columns(frame.columns, data.source, to_come=False)
    values = {name: frame[name].to_numpy() for name in frame.columns}
    return Measurements.from_columns(values, data.source, data.line, data.counted, layout)


def columns_of(robot: object) -> Columns:
    """The names of columns by ours that the file of a robot gives, for the runs of this robot: ``q1_mm = "Enc1 [mm]"``;
    none where it is given otherwise."""
    if not isinstance(robot, str | os.PathLike):
        return {}
    return _columns_in(read_toml(Path(robot), "robot"), robot)


def _columns_in(tables: dict[str, Any], path: str | os.PathLike[str]) -> Columns:
    with Table(tables, str(path)).table(_COLUMNS, optional=True) as t:
        return {name: t.words(name) for name in t.names()}


@validate_arguments
def save_robot(robot: Robot, path: str | os.PathLike[str]) -> None:
    """Writes a robot file that :func:`load_robot` reads. Raises :class:`~sherkit.errors.NotWritten`, and
    :class:`~sherkit.errors.RobotError` for what is no robot.

        robot = sk.load_robot("demo/robot.toml")
        sk.save_robot(robot, "copy.toml")
    """
    write_whole(path, tomli_w.dumps(robot_of(robot).to_tables()))


def read_robot(given: Any) -> Any:
    """What was given, or the robot of that file; whether it is one is asked by whoever needs that."""
    return load_robot(given) if isinstance(given, str | os.PathLike) else given


def robot_of(given: RobotLike) -> Robot:
    """A robot as it is, or read from its file. Raises :class:`~sherkit.errors.RobotError` for anything else."""
    if isinstance(given, str | os.PathLike):
        return load_robot(given)
    # by its kind alone: Python before 3.12 would ask every property, and a robot without a workspace refuses its middle
    if not isinstance(getattr(given, "kind", None), str):
        raise RobotError(f"expected a robot or the path of its file, got {type(given).__name__}")
    return given
