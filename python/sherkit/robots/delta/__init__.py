"""The linear delta."""

from ...model.kinds import Asked, Kind
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
    asks=(
        Asked(
            "geometry", "rod_spacing_mm",
            "rods of unequal length (rod_mismatch) cannot be tried without the distance of the two rods of a limb",
            "write it, or rod_spacing_mm = 0 where each limb has a single rod",
        ),
        Asked(
            "joints", "pole_pitch_mm",
            "the period of the encoders' cyclic error (encoder_cyclic) is searched for in the readings instead",
            "write the pitch of their scales, or pole_pitch_mm = 0 where they have none",
        ),
    ),
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
