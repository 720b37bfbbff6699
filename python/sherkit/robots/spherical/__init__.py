"""The spherical robot, seen by a camera."""

from ...model.kinds import Asked, Kind
from .calibration import SphericalCalibration
from .camera import CameraView
from .camera_placement import camera_placement, picture_half_angle
from .columns import SPHERICAL_ANGLES, SPHERICAL_PIXELS
from .effects import SPHERICAL_CATALOGUE
from .model import SphericalModel
from .paper import TaskError, identify_joints, task_error
from .pose_sets import AREAS, POSES
from .poses import sphere_patch
from .remote_centre import RemoteCentre, remote_centre
from .robot import ASSEMBLY_MODES, WORKING_MODES, Spherical
from .straightness import straightness, straightness_by
from .virtual import VirtualSpherical

KIND = Kind(
    "spherical", Spherical, SphericalModel, (SPHERICAL_PIXELS, SPHERICAL_ANGLES), SphericalCalibration,
    VirtualSpherical, coordinates=SPHERICAL_ANGLES.coordinates, poses=POSES, areas=AREAS,
    called="the spherical robot and its camera",
    choices={"assembly_mode": ASSEMBLY_MODES, "working_mode": WORKING_MODES},
    asks=(
        Asked(
            "geometry", "gravity",
            "the weight is taken to pull along -z, against the actuated axis, and gravity_flexure is tried in that "
            "direction alone",
            "write its direction, which is [0, 0, -1] where z points up",
        ),
    ),
)  # fmt: skip

__all__ = [
    "SPHERICAL_ANGLES",
    "SPHERICAL_CATALOGUE",
    "SPHERICAL_PIXELS",
    "CameraView",
    "RemoteCentre",
    "Spherical",
    "SphericalCalibration",
    "SphericalModel",
    "TaskError",
    "VirtualSpherical",
    "camera_placement",
    "identify_joints",
    "picture_half_angle",
    "remote_centre",
    "sphere_patch",
    "straightness",
    "straightness_by",
    "task_error",
]
