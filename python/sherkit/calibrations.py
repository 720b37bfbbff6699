"""The calibration of each kind of robot: made from a fit, and read from a file that says its kind."""

from __future__ import annotations

from pathlib import Path

from .calibration import Calibration
from .calibration_file import tables_of
from .errors import CalibrationError
from .names import listed
from .spherical_calibration import SphericalCalibration

AnyCalibration = Calibration | SphericalCalibration
CALIBRATIONS: dict[str, type[Calibration] | type[SphericalCalibration]] = {
    "delta": Calibration,
    "spherical": SphericalCalibration,
}


def load_calibration(path: str | Path) -> AnyCalibration:
    """Reads a calibration of any robot. Raises :class:`~sherkit.errors.CalibrationError` naming file and key."""
    path = Path(path)
    robot = tables_of(path)[0].get("robot")
    kind = robot.get("kind") if isinstance(robot, dict) else None
    if kind not in CALIBRATIONS:
        raise CalibrationError(f"{path}: [robot] kind: expected one of {listed(CALIBRATIONS)}, found {kind!r}")
    return CALIBRATIONS[kind].load(path)
