"""Serial arms: joints that turn or slide, one behind another, and a target that a tracker sees."""

from typing import TYPE_CHECKING

from ...base.lazy_imports import door

if TYPE_CHECKING:
    from .calibration import SerialCalibration
    from .full_poses import points_of_poses
    from .identified import as_identified
    from .kind import KIND as KIND
    from .model import SerialModel
    from .points import Distance, Plane
    from .programs import program_of, read_targets
    from .robot import MOST_JOINTS, Joint, Serial
    from .virtual import Hidden, VirtualSerial, postures

__all__ = [
    "MOST_JOINTS",
    "Distance",
    "Hidden",
    "Joint",
    "Plane",
    "Serial",
    "SerialCalibration",
    "SerialModel",
    "VirtualSerial",
    "as_identified",
    "points_of_poses",
    "postures",
    "program_of",
    "read_targets",
]

if not TYPE_CHECKING:
    __getattr__ = door(
        __name__,
        {
            "KIND": "kind",
            "SerialCalibration": "calibration",
            "Distance": "points",
            "points_of_poses": "full_poses",
            "as_identified": "identified",
            "SerialModel": "model",
            "Plane": "points",
            "program_of": "programs",
            "read_targets": "programs",
            "MOST_JOINTS": "robot",
            "Joint": "robot",
            "Serial": "robot",
            "Hidden": "virtual",
            "VirtualSerial": "virtual",
            "postures": "virtual",
        },
    )


def __dir__() -> list[str]:
    return [*__all__, "KIND"]
