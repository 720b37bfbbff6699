"""What the kind of delta printers brings."""

from ...model.kinds import Kind
from ..delta.robot import POSITION
from .calibration import PrinterCalibration
from .model import PrinterModel
from .robot import ANGLES, PROBED, Printer, Towers

_EXAMPLE = Printer.with_towers(
    Towers(100.0, ANGLES, (220.0, 220.0, 220.0), (250.0, 250.0, 250.0)), workspace_radius_mm=80.0, probings=("default",)
)

KIND = Kind(
    "printer", Printer, PrinterModel, (PROBED,), PrinterCalibration, coordinates=POSITION,
    called="the linear delta printer", example=_EXAMPLE,
)  # fmt: skip
