"""The flexible tool whose fibres feel the force."""

from .alignment import Registration, align, register
from .calibration import Loads, ToolCalibration, calibrate_tool, read_loads
from .effects import TOOL_CATALOGUE
from .filters import Estimate, estimate
from .known import judge, known
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
