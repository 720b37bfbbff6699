"""sherkit finds the physics that a robot's model is missing.

What a person does stands here; what belongs to one robot or to one step stands in the submodules: ``sk.delta``,
``sk.serial``, ``sk.spherical``, ``sk.tool``; ``sk.data``, ``sk.model``, ``sk.fit``, ``sk.diagnosis``, ``sk.planning``,
``sk.report``, ``sk.lab``, ``sk.errors``.
"""

from importlib import import_module as _import_module
from typing import Any as _Any

from . import starting as _starting  # noqa: F401  # isort: skip
from . import data, diagnosis, errors, fit, lab, model, planning
from ._core import __version__
from .calibrate import calibrate
from .data import Measurements, from_frame, read_measurements
from .diagnosis import diagnose
from .errors import SherkitError, SherkitWarning
from .fit.identify import identify
from .model.effect import Effect, effect
from .model.robot_file import load_robot, save_robot
from .notebook import Shown as _Shown
from .robots import delta, serial, spherical, tool
from .robots.files import load_calibration
from .study import Study

__all__ = [
    "Effect", "Measurements", "SherkitError", "SherkitWarning", "Study", "__version__", "calibrate", "data", "delta",
    "diagnose", "diagnosis", "effect", "errors", "fit", "from_frame", "identify", "lab", "load_calibration",
    "load_robot", "model", "planning", "read_measurements", "report", "save_robot", "serial", "spherical", "tool",
]  # fmt: skip


def _draw(value: object) -> str | None:
    """HTML of a value for a notebook, where ``sherkit[view]`` is installed; what draws is loaded when asked for."""
    try:
        from .report.notebook import cell
    except ModuleNotFoundError:
        return None
    return cell(value)


_Shown.draw = _draw


def __getattr__(name: str) -> _Any:
    # what draws needs Bokeh, and is loaded when it is asked for
    if name == "report":
        return _import_module(f".{name}", __name__)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return list(__all__)
