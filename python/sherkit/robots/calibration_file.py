"""Files of calibrations: the version they are written in, and for which robot they are."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

from ..errors import CalibrationError

FORMAT = 1


def tables_of(path: Path, kind: str | None = None) -> dict[str, Any]:
    """The tables of a calibration file, for a robot of this kind or, left out, of any.

    Raises :class:`~sherkit.errors.CalibrationError`.
    """
    try:
        tables = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise CalibrationError(f"{path}: cannot be read: {error.strerror}") from None
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise CalibrationError(f"{path}: is not valid TOML: {error}") from None
    settings = tables.get("calibration")
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
