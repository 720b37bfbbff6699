"""For a control loop in C (rust/c/include/sherkit.h): a flexible tool as constants of the library's own types."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ..c_header import c_number
from .tool import FlexibleTool


def tool_header(tool: FlexibleTool, source: str = "tool.toml") -> str:
    """The text of a C header with what :func:`sherkit_tool_filter_init` asks for; every number without loss.

    ``tool_settings`` are gratings, shaft and what the calibration does not know, ``tool_start_depth_mm`` and its
    variance how the filter begins, ``tool_fibre_delay_s`` is to be taken off the time of each reading.
    """
    doubt = tool.doubt
    fields = {
        "sensor": f"{{ .gains = {_braced(tool.gains)}, .distances_mm = {_braced(tool.distances_mm)}, .reference_nm = "
        f"{_braced(np.reshape(tool.reference_nm, (3, 3)))}, .noise_nm = {c_number(tool.noise_nm)} }}",
        "beam": _braced((tool.length_mm, tool.stiffness_mn_mm2)),
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
        f"static const double tool_start_variance_mm2 = {c_number(tool.start_known_mm**2)};",
        f"static const double tool_fibre_delay_s = {c_number(tool.fibre_delay_s)};",
        "",
        "#endif",
        "",
    ]
    return "\n".join(lines)


def _braced(values: ArrayLike) -> str:
    array = np.asarray(values, dtype=float)
    return "{ " + ", ".join(map(c_number if array.ndim == 1 else _braced, array)) + " }"
