"""The linear delta."""

from ...model.kinds import Kind, RequiredSetting
from .calibration import DeltaCalibration
from .correction import Correction, choose_correction, fit_grid, fit_polynomial
from .drawing import drawing, signature
from .model import CATALOGUE, DeltaModel
from .paper import paper_protocol
from .robot import AREAS, ASSEMBLY_MODES, DELTA, POSES, Delta, grid, paper_local, paper_whole
from .virtual import VirtualDelta

#: A described example, not the paper's robot: no nominal dimension of that one is printed.
_EXAMPLE = Delta(
    base_radius_mm=(90.0, 90.0, 90.0),
    base_angle_deg=(90.0, 210.0, 330.0),
    platform_radius_mm=(30.0, 30.0, 30.0),
    platform_angle_deg=(90.0, 210.0, 330.0),
    rod_length_mm=(120.0, 120.0, 120.0),
    rod_spacing_mm=40.0,
    target_offset_mm=(0.0, 0.0, -25.0),
    pole_pitch_mm=2.0,
    workspace_radius_mm=30.0,
    workspace_z_mm=(-22.0, 22.0),
    region_half_width_mm=10.0,
    required_um=20.0,  # what subretinal injection needs (Xiao et al., ISMR 2022)
)

KIND = Kind(
    "delta", Delta, DeltaModel, (DELTA,), DeltaCalibration, VirtualDelta,
    coordinates=DELTA.coordinates, poses=POSES, grid="grid", areas=AREAS, signature=signature,
    called="the linear delta", choices={"assembly_mode": ASSEMBLY_MODES}, example=_EXAMPLE,
    drawing=drawing,
    asks=(
        RequiredSetting(
            "geometry", "rod_spacing_mm",
            "rods of unequal length (rod_mismatch) cannot be tried without the distance of the two rods of a limb",
            "write it, or rod_spacing_mm = 0 where each limb has a single rod",
        ),
        RequiredSetting(
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
    "paper_local",
    "paper_protocol",
    "paper_whole",
]
