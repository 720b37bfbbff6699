"""sherkit finds the physics that a robot's model is missing.

What a person does stands here; what belongs to one robot or to one step stands in the submodules: ``sk.delta``,
``sk.serial``, ``sk.spherical``, ``sk.tool``; ``sk.changes``, ``sk.data``, ``sk.model``, ``sk.fit``, ``sk.diagnosis``,
``sk.planning``, ``sk.report``, ``sk.lab``, ``sk.errors``. Each is loaded when it is first asked for.
"""

from importlib import import_module as _import_module
from typing import TYPE_CHECKING as _TYPE_CHECKING

from .base import starting as _starting  # noqa: F401  # isort: skip
from .base import built_in as _built_in
from .base.lazy_imports import door as _door
from .base.notebook import Shown as _Shown

if _TYPE_CHECKING:
    from . import changes, data, diagnosis, errors, fit, lab, model, planning, report
    from ._core import __version__
    from .adaptive import Adaptive
    from .calibration import calibrate
    from .changes import compare, history, verify
    from .data import Measurements, from_bluesky, from_frame, from_rosbag, read_measurements
    from .diagnosis import diagnose
    from .errors import SherkitError, SherkitWarning
    from .fit import identify
    from .fleets import fleet
    from .model.effect import Effect, effect
    from .model.robot_file import load_robot, save_robot
    from .model.sensor_pose import SensorPose
    from .model.tolerances import Stated
    from .robots import delta, serial, spherical, tool
    from .robots.calibrated import load_calibration
    from .robots.machine import Machine
    from .study import Study

__all__ = [
    "Adaptive", "Effect", "Machine", "Measurements", "SensorPose", "SherkitError", "SherkitWarning", "Stated",
    "Study", "__version__", "calibrate", "changes", "compare", "data", "delta", "diagnose", "diagnosis", "effect",
    "errors", "fit", "fleet", "from_bluesky", "from_frame", "from_rosbag", "history", "identify", "lab",
    "load_calibration", "load_robot", "model", "planning", "read_measurements", "report", "save_robot", "serial",
    "spherical", "tool", "verify",
]  # fmt: skip


def _draw(value: object) -> str | None:
    """HTML of a value for a notebook, where ``sherkit[view]`` is installed; what draws is loaded when asked for."""
    try:
        from .report.notebook import cell
    except ModuleNotFoundError:
        return None
    return cell(value)


_Shown.draw = _draw
_built_in.load = lambda: _import_module(".robots.known", __name__)

if not _TYPE_CHECKING:  # to who reads types, a name that is not above does not exist
    __getattr__ = _door(
        __name__,
        {
            "Adaptive": "adaptive", "Effect": "model.effect", "Machine": "robots.machine", "Measurements": "data",
            "SensorPose": "model.sensor_pose", "SherkitError": "errors",
            "SherkitWarning": "errors", "Stated": "model.tolerances", "Study": "study",
            "__version__": "_core", "calibrate": "calibration", "compare": "changes",
            "history": "changes", "verify": "changes", "diagnose": "diagnosis",
            "effect": "model.effect", "fleet": "fleets", "from_bluesky": "data", "from_frame": "data",
            "from_rosbag": "data", "identify": "fit",
            "load_calibration": "robots.calibrated", "load_robot": "model.robot_file", "read_measurements": "data",
            "save_robot": "model.robot_file",
        },
        {
            **{
                name: name
                for name in ("changes", "data", "diagnosis", "errors", "fit", "lab", "model", "planning", "report")
            },
            **{name: f"robots.{name}" for name in ("delta", "serial", "spherical", "tool")},
        },
    )  # fmt: skip


def __dir__() -> list[str]:
    return list(__all__)
