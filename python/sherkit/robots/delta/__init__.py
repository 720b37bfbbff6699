"""The linear delta."""

from ...model.kinds import Kind
from .calibration import DeltaCalibration
from .columns import DELTA
from .correction import Correction, choose_correction, fit_grid, fit_polynomial
from .effects import CATALOGUE
from .klipper import import_klipper
from .model import DeltaModel
from .paper import paper_local, paper_protocol, paper_whole
from .pose_sets import AREAS, POSES
from .poses import grid
from .robot import ASSEMBLY_MODES, Delta
from .signature import signature
from .virtual import VirtualDelta

KIND = Kind(
    "delta", Delta, DeltaModel, (DELTA,), DeltaCalibration, VirtualDelta,
    coordinates=DELTA.coordinates, poses=POSES, grid="grid", areas=AREAS, signature=signature,
    called="the linear delta", choices={"assembly_mode": ASSEMBLY_MODES},
)  # fmt: skip

__all__ = [
    "CATALOGUE",
    "DELTA",
    "Correction",
    "Delta",
    "DeltaCalibration",
    "DeltaModel",
    "VirtualDelta",
    "choose_correction",
    "fit_grid",
    "fit_polynomial",
    "grid",
    "import_klipper",
    "paper_local",
    "paper_protocol",
    "paper_whole",
]
