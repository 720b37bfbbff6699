"""A tool for a control loop in C: its numbers as constants of the library's own types (rust/c/include/sherkit.h)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .tool import FlexibleTool

#: The makers of the noises in C.
_STEPPED = {"ebrahimi_2020": "SHERKIT_NOISE_SWITCHED", "ebrahimi_2020_of_force": "SHERKIT_NOISE_SWITCHED_OF_FORCE"}


def c_header(tool: FlexibleTool, source: str = "tool.toml") -> str:
    """The text of a C header with gratings, shaft, noise and start of a tool; every number without loss."""
    start = float(tool.start_std_mm) ** 2
    if tool.noise in _STEPPED:
        noise = [
            "    sherkit_noise noise = sherkit_noise_ebrahimi_2020();",
            f"    noise.kind = {_STEPPED[tool.noise]};",
            "    return noise;",
        ]
    else:
        numbers = ", ".join(_number(x) for x in (*tool.per_second_mm2, *tool.floor_mm2))
        noise = [f"    return sherkit_noise_propagated({numbers});"]
    lines = [
        f"/* The flexible tool of {source}, written by `sherkit export c`. Lengths mm, forces mN, wavelengths nm. */",
        "#ifndef TOOL_H",
        "#define TOOL_H",
        "",
        '#include "sherkit.h"',
        "",
        "static const sherkit_sensor_calibration tool_gratings = {",
        f"    .gains = {_braced(np.array(tool.gains))},",
        f"    .distances_mm = {_braced(np.array(tool.distances_mm))},",
        f"    .reference_nm = {_braced(np.array(tool.reference_nm).reshape(3, 3))},",
        f"    .noise_nm = {_number(tool.noise_nm)},",
        "};",
        f"static const sherkit_beam tool_beam = {{ {_number(tool.length_mm)}, {_number(tool.stiffness_mn_mm2)} }};",
        f"static const double tool_start_depth_mm = {_number(tool.start_depth_mm)};",
        f"static const double tool_start_variance_mm2 = {_number(start)};",
        "",
        "static inline sherkit_noise tool_noise(void) {",
        *noise,
        "}",
        "",
        "#endif",
        "",
    ]
    return "\n".join(lines)


def _number(value: float) -> str:
    return repr(float(value))


def _braced(values: np.ndarray | Sequence[float]) -> str:
    array = np.asarray(values, dtype=float)
    inside = (_number(v) for v in array) if array.ndim == 1 else (_braced(row) for row in array)
    return "{ " + ", ".join(inside) + " }"
