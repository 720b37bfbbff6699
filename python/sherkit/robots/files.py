"""Files of calibrations, of any kind of robot."""

from __future__ import annotations

from pathlib import Path

from ..base.arguments import as_annotated
from .calibrated import Calibration


@as_annotated
def load_calibration(path: str | Path) -> Calibration:
    """Reads a calibration of any robot.

    Raises :class:`~sherkit.errors.CalibrationError` naming file and key.

        calibration = sk.load_calibration("demo/calibrated.toml")
        joints = calibration.inverse([1.0, -2.0, 3.0])
    """
    return Calibration.load(path)
