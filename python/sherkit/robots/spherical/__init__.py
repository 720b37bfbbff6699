"""The spherical robot, seen by a camera."""

import math
from typing import Any

from ...model.kinds import Kind, RequiredSetting
from .calibration import RemoteCentre, SphericalCalibration, remote_centre
from .drawing import drawing
from .model import SPHERICAL_CATALOGUE, SphericalModel, TaskError, identify_joints, task_error
from .poses import AREAS, POSES, sphere_patch, straightness, straightness_by
from .robot import (
    ASSEMBLY_MODES,
    SPHERICAL_ANGLES,
    SPHERICAL_PIXELS,
    WORKING_MODES,
    CameraView,
    Spherical,
    camera_placement,
    camera_written_otherwise,
    picture_half_angle,
)
from .virtual import VirtualSpherical

_PLACED: dict[str, Any] = {"phi_deg": 90.0, "gamma_deg": 45.0, "distance_mm": 446.2}
_LENS: dict[str, Any] = {"size_px": (1280, 640), "focal_px": (710.0, 710.0)}
_EXAMPLE = Spherical(
    45.0, 45.0, 200.0, joint_limits_deg=(-180.0, 270.0), phi_deg=(60.0, 120.0), gamma_deg=(25.0, 65.0),
    camera=CameraView.facing(0.5 * math.pi, 0.25 * math.pi, _PLACED["distance_mm"], **_LENS),
)  # fmt: skip

KIND = Kind(
    "spherical", Spherical, SphericalModel, (SPHERICAL_PIXELS, SPHERICAL_ANGLES), SphericalCalibration,
    VirtualSpherical, coordinates=SPHERICAL_ANGLES.coordinates, poses=POSES, areas=AREAS,
    called="the spherical robot and its camera", example=_EXAMPLE, drawing=drawing,
    spelt=({"camera": {**_LENS, **_PLACED}},),
    choices={"assembly_mode": ASSEMBLY_MODES, "working_mode": WORKING_MODES}, misread=camera_written_otherwise,
    asks=(
        RequiredSetting(
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
