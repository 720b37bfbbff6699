"""Linear delta printers: what their firmware knows and probes, what is wrong with them, what goes back to it."""

from typing import TYPE_CHECKING

from ...base.lazy_imports import door

if TYPE_CHECKING:
    from .calibration import PrinterCalibration
    from .gcode import import_duet, import_marlin
    from .kind import KIND as KIND
    from .klipper import import_klipper
    from .model import PrinterModel
    from .robot import PROBED, Printer, Towers

__all__ = [
    "PROBED",
    "Printer",
    "PrinterCalibration",
    "PrinterModel",
    "Towers",
    "import_duet",
    "import_klipper",
    "import_marlin",
]

if not TYPE_CHECKING:
    __getattr__ = door(
        __name__,
        {
            "KIND": "kind",
            "PrinterCalibration": "calibration",
            "import_duet": "gcode",
            "import_marlin": "gcode",
            "import_klipper": "klipper",
            "PrinterModel": "model",
            "PROBED": "robot",
            "Printer": "robot",
            "Towers": "robot",
        },
    )


def __dir__() -> list[str]:
    return [*__all__, "KIND"]
