"""For a control loop in C (rust/c/include/sherkit.h): a calibrated robot's row of numbers, a tool as constants of the
library's own types.
"""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..base.types import Floats
from ..errors import CalibrationError
from .calibrated import Calibration
from .tool.tool import FlexibleTool

#: The type of the C library by the kind of robot that a row is of (rust/core/src/flat.rs), as its second number says.
_TYPES = {1.0: "sherkit_delta", 2.0: "sherkit_spherical", 3.0: "sherkit_serial"}
_IN_A_LINE = 6


def calibration_header(calibration: Calibration, source: str = "calibrated.toml", name: str = "robot") -> str:
    """The text of a C header that loads a calibration: ``<name>_init(&robot)``; every number without loss.

    Raises :class:`~sherkit.errors.CalibrationError` for a robot that the C library does not have.
    """
    core: Any = getattr(calibration, "core", None)
    row: Floats | None = core.flat() if hasattr(core, "flat") else None
    kind = None if row is None else _TYPES.get(float(row[1]))
    if row is None or kind is None:
        raise CalibrationError(
            f"{source}: a {calibration.robot.kind} robot runs in Python alone; the C library has deltas, spherical "
            "robots, serial arms and the flexible tool"
        )
    guard = f"{name.upper()}_H"
    includes = ["#include <math.h>"] if not all(map(math.isfinite, row)) else []
    lines = [
        f"/* The calibrated {calibration.robot.kind} robot of {_comment(source)}, written by `sherkit export c`. "
        "Lengths mm, angles rad. */",
        f"#ifndef {guard}",
        f"#define {guard}",
        "",
        *includes,
        '#include "sherkit.h"',
        "",
        c_array(f"{name}_numbers", row),
        "",
        "/* Loads the calibration. Its numbers are not copied: they stand above for as long as the program runs. */",
        f"static inline sherkit_result {name}_init({kind} *robot)",
        "{",
        f"    return {kind}_init(robot, {name}_numbers, sizeof {name}_numbers / sizeof *{name}_numbers);",
        "}",
        "",
        "#endif",
        "",
    ]
    return "\n".join(lines)


def tool_header(tool: FlexibleTool, source: str = "tool.toml") -> str:
    """The text of a C header with what :func:`sherkit_tool_filter_init` asks for; every number without loss.

    ``tool_settings`` are gratings, shaft and what the calibration does not know, ``tool_start_depth_mm`` and its
    variance how the filter begins, ``tool_fibre_delay_s`` is to be taken off the time of each reading.
    """
    doubt = tool.doubt
    fields = {
        "sensor": "{ "
        + ", ".join(
            (
                f".gains = {_braced(tool.gains)}",
                f".distances_mm = {_braced(tool.distances_mm)}",
                f".reference_nm = {_braced(np.array(tool.reference_nm).reshape(3, 3))}",
                f".noise_nm = {c_number(tool.noise_nm)}",
            )
        )
        + " }",
        "beam": f"{{ {c_number(tool.length_mm)}, {c_number(tool.stiffness_mn_mm2)} }}",
        "exact": str(int(tool.bending == "exact")),
        "means_nm": _braced(tool.means),
        "mean_doubt": c_number(doubt.mean),
        "depth_covariance": _braced(doubt.depth),
        "deeper_doubt_mm": c_number(doubt.deeper_mm),
        "turn_doubt_rad": c_number(doubt.turn_rad),
        "force_doubt": c_number(doubt.force),
        "reference_doubt_nm": c_number(doubt.reference_nm),
        "warmth_unlike": c_number(doubt.unlike),
        "warmth": _braced(tool.warmth),
        "warmth_doubt": c_number(doubt.warmth),
        "beam_covariance": _braced(doubt.beam),
        "clearance_mm": c_number(tool.clearance_mm),
        "clearance_doubt_mm": c_number(tool.clearance_std_mm),
        "per_second_mm2": c_number(tool.per_second_mm2[0]),
    }
    lines = [
        f"/* The flexible tool of {source}, written by `sherkit export c`. Lengths mm, forces mN, wavelengths nm. */",
        "#ifndef TOOL_H",
        "#define TOOL_H",
        "",
        '#include "sherkit.h"',
        "",
        "static const sherkit_tool tool_settings = {",
        *(f"    .{name} = {value}," for name, value in fields.items()),
        "};",
        f"static const double tool_start_depth_mm = {c_number(tool.start_depth_mm)};",
        f"static const double tool_start_variance_mm2 = {c_number(tool.start_std_mm**2)};",
        f"static const double tool_fibre_delay_s = {c_number(tool.fibre_delay_s)};",
        "",
        "#endif",
        "",
    ]
    return "\n".join(lines)


def _braced(values: ArrayLike) -> str:
    array = np.asarray(values, dtype=float)
    inside = (c_number(v) for v in array) if array.ndim == 1 else (_braced(row) for row in array)
    return "{ " + ", ".join(inside) + " }"


def c_array(name: str, numbers: Floats) -> str:
    """A C array of doubles. What is infinite needs ``math.h``: C has no literal for it."""
    words = [c_number(x) for x in numbers]
    rows = [", ".join(words[i : i + _IN_A_LINE]) for i in range(0, len(words), _IN_A_LINE)]
    return f"static const double {name}[] = {{\n    " + ",\n    ".join(rows) + ",\n};"


def c_number(value: float) -> str:
    """A double as C reads it, without loss."""
    if math.isfinite(value):
        return repr(float(value))  # a NumPy number says its type too
    return "NAN" if math.isnan(value) else f"{'-' if value < 0 else ''}INFINITY"


def _comment(text: str) -> str:
    """A file's name cannot end a comment."""
    return re.sub(r"[^\w. -]", "_", text)
