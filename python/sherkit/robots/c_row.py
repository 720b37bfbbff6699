"""A calibration for a control loop in C: the row of numbers that ``sherkit_delta_init`` and its like read."""

from __future__ import annotations

import numpy as np

from ..errors import CalibrationError
from ..types import Floats
from .calibrated import Calibration

_PER_LINE = 6


def c_row(calibration: Calibration, source: str = "calibrated.toml") -> str:
    """The text of a C header with ``robot_numbers`` and ``robot_count``, every number without loss.

    Raises :class:`~sherkit.errors.CalibrationError` for a machine whose function is Python.
    """
    kind, core = calibration.robot.kind, calibration.core
    if not hasattr(core, "flat"):
        raise CalibrationError(f"{source}: '{kind}' is a function in Python; only built-in robots run in C")
    lines = [
        f"/* The calibrated {kind} robot of {source}, written by `sherkit export c`: for sherkit_{kind}_init. */",
        "#ifndef ROBOT_H",
        "#define ROBOT_H",
        "",
        "#include <stddef.h>",
        "",
        c_array("robot_numbers", core.flat()),
        "static const size_t robot_count = sizeof robot_numbers / sizeof *robot_numbers;",
        "",
        "#endif",
        "",
    ]
    return "\n".join(lines)


def c_array(name: str, numbers: Floats) -> str:
    """A constant array of C."""
    rows = np.split(numbers, range(_PER_LINE, len(numbers), _PER_LINE))
    lines = (", ".join(repr(float(x)) for x in row) for row in rows)
    return f"static const double {name}[] = {{\n    " + ",\n    ".join(lines) + ",\n};\n"
