"""Files of calibrations: the version they are written in, for which robot they are, and what is wrong with one."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import tomli_w

import sherkit._core as _core

from ..data.files import write_whole
from ..data.toml import Table, read_toml
from ..errors import CalibrationError, SherkitError
from ..model.kinds import Robot

#: 2: what the poses of a run could not show is written beside what they did; before, accuracy left that out. 3: under
#: the key ``unobserved_effects``, which was ``unshown``. 4: how single readings scatter is apart from what the model
#: leaves; where it is not, as in earlier files, it is counted as that.
FORMAT = 4


def write(path: Path, settings: Mapping[str, Any], robot: Robot, parts: Mapping[str, dict[str, Any]]) -> None:
    """Writes the tables of a calibration: what it is made by, its robot, what was identified."""
    tables = {
        "calibration": {"format": FORMAT, "made_by": f"sherkit {_core.__version__}", **settings},
        "robot": robot.to_tables(),
        **parts,
    }
    write_whole(path, tomli_w.dumps(tables))


@contextmanager
def reading(path: Path, tables: dict[str, Any]) -> Iterator[Table]:
    """The tables of a file to read from; whatever is wrong with them is a :class:`CalibrationError` that names it."""
    try:
        yield Table(tables, str(path), error=CalibrationError)
    except (TypeError, ValueError, OverflowError, SherkitError) as error:
        said = str(error)
        raise CalibrationError(said if said.startswith(f"{path}: ") else f"{path}: {said}") from None


def tables_of(path: Path, kind: str | None = None) -> dict[str, Any]:
    """The tables of a calibration file, for a robot of this kind or, left out, of any.

    Raises :class:`~sherkit.errors.CalibrationError`.
    """
    tables = read_toml(path, "calibration", CalibrationError)
    settings = tables.get("calibration")
    if isinstance(settings, dict) and settings.get("format") in (2, 3):
        for part in tables.values():
            if isinstance(part, dict) and "unshown" in part:
                part["unobserved_effects"] = part.pop("unshown")
        settings["format"] = FORMAT
    if isinstance(settings, dict) and settings.get("format") == 1:
        raise CalibrationError(
            f"{path}: was written by an earlier version ([calibration] format = {settings['format']}, expected "
            f"{FORMAT}) and does not say what its poses could not show; calibrate again from the run"
        )
    if not isinstance(settings, dict) or settings.get("format") != FORMAT:
        raise CalibrationError(
            f"{path}: is not a calibration of this version (expected [calibration] format = {FORMAT})"
        )
    robot = tables.get("robot")
    found = robot.get("kind") if isinstance(robot, dict) else None
    if kind is not None and isinstance(found, str) and found != kind:
        raise CalibrationError(
            f"{path}: robot.kind: expected '{kind}', found '{found}'; sherkit.load_calibration reads every kind"
        )
    return tables
