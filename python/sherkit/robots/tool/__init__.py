"""The flexible tool whose fibres feel the force."""

from typing import TYPE_CHECKING

from ...base.lazy_imports import door

if TYPE_CHECKING:
    from .alignment import Registration, align, register
    from .calibration import Loads, ToolCalibration, calibrate_tool, read_loads
    from .consistency import judge, known
    from .effects import TOOL_CATALOGUE
    from .filters import Estimate, estimate
    from .model import ToolModel
    from .runs import ToolRun, read_tool_run, tool_run_of
    from .tool import FlexibleTool, load_tool
    from .virtual import VirtualTool

__all__ = [
    "TOOL_CATALOGUE",
    "Estimate",
    "FlexibleTool",
    "Loads",
    "Registration",
    "ToolCalibration",
    "ToolModel",
    "ToolRun",
    "VirtualTool",
    "align",
    "calibrate_tool",
    "estimate",
    "judge",
    "known",
    "load_tool",
    "read_loads",
    "read_tool_run",
    "register",
    "tool_run_of",
]

if not TYPE_CHECKING:
    __getattr__ = door(
        __name__,
        {
            "Registration": "alignment",
            "align": "alignment",
            "register": "alignment",
            "Loads": "calibration",
            "ToolCalibration": "calibration",
            "calibrate_tool": "calibration",
            "read_loads": "calibration",
            "TOOL_CATALOGUE": "effects",
            "Estimate": "filters",
            "estimate": "filters",
            "judge": "consistency",
            "known": "consistency",
            "ToolModel": "model",
            "ToolRun": "runs",
            "read_tool_run": "runs",
            "tool_run_of": "runs",
            "FlexibleTool": "tool",
            "load_tool": "tool",
            "VirtualTool": "virtual",
        },
    )


def __dir__() -> list[str]:
    return list(__all__)
