"""A planar arm of two joints: a third kind of robot, kept as a proof that one folder is all that a kind needs.

The same files as in the folder of a built-in robot. Its compiled core would be ``rust/core/src/chain/planar.rs``, which
is a test there as this is here; ``core.py`` stands for the binding.
"""

from sherkit.model.kinds import Kind

from .calibration import PlanarCalibration
from .columns import PLANAR, TIP
from .model import PlanarModel
from .pose_sets import AREAS, POSES
from .robot import ELBOWS, PlanarArm
from .virtual import VirtualPlanarArm

KIND = Kind(
    "planar", PlanarArm, PlanarModel, (PLANAR,), PlanarCalibration, VirtualPlanarArm, coordinates=TIP, poses=POSES,
    areas=AREAS, choices={"elbow": ELBOWS},
)  # fmt: skip

__all__ = ["KIND", "PlanarArm", "PlanarCalibration", "PlanarModel", "VirtualPlanarArm"]
