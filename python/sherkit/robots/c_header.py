"""For a control loop in C (rust/c/include/sherkit.h): a calibrated robot's row of numbers."""

from __future__ import annotations

import math
import re
from typing import Any

from ..base.figures import listed
from ..base.types import Floats
from ..errors import CalibrationError
from ..model.kinds import catalogue_of, kind_of
from .calibrated import Calibration

#: The type of the C library by the kind of robot that a row is of (rust/core/src/flat/mod.rs): its second number.
_TYPES = {1.0: "sherkit_delta", 2.0: "sherkit_spherical", 3.0: "sherkit_serial"}
_IN_A_LINE = 6
#: Joints of which the covariates of a serial arm have a direction.
_DIRECTIONS = 9
#: C has none for what is infinite.
_NO_LITERAL = "#include <math.h>\n"


def covariates_needed(calibration: Calibration) -> dict[str, tuple[str, ...]]:
    """The effects of a calibration that follow time, temperature or the direction of motion, and which of these each
    needs: a control loop has to say them. What an instrument makes of a reading is in no loop."""
    known = catalogue_of(calibration.robot)
    names = dict.fromkeys(name for part in calibration.parts_made for name in part.effects)
    distance = kind_of(calibration.robot).layout.distance
    needs = {name: tuple(one for one in known[name].needs if one != distance) for name in names}
    return {name: told for name, told in needs.items() if told}


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
    time_s, temperature_c, *direction = calibration.parts_made[0].now
    finite = all(map(math.isfinite, [*row, time_s, temperature_c, *direction]))
    guard = f"{name.upper()}_H"
    now = [c_number(time_s), c_number(temperature_c)]
    now.append(f"{{{', '.join(map(c_number, direction))}}}")
    if kind == "sherkit_serial":
        now[-1] = f"{{{', '.join(map(c_number, [*direction, *[0.0] * (_DIRECTIONS - len(direction))]))}}}"
        now.append("0.0")
    return f"""\
/* The calibrated {calibration.robot.kind} robot of {comment(source)}, written by `sherkit export c`. \
Lengths mm, angles rad. */
#ifndef {guard}
#define {guard}

{"" if finite else _NO_LITERAL}#include "sherkit.h"

{c_array(f"{name}_numbers", row)}

/* {_said_of_covariates(covariates_needed(calibration), name)} */
static const {kind}_covariates {name}_now = {{{", ".join(now)}}};

/* Loads the calibration. Its numbers are not copied: they stand above for as long as the program runs. */
static inline sherkit_result {name}_init({kind} *robot)
{{
    return {kind}_init(robot, {name}_numbers, sizeof {name}_numbers / sizeof *{name}_numbers);
}}

#endif
"""


def _said_of_covariates(needed: dict[str, tuple[str, ...]], name: str) -> str:
    """What a program is to give beside the target."""
    said = ["No effect in it needs covariates: they may be NULL."]
    if needed:
        said = [f"{effect} needs {listed(needs)}." for effect, needs in needed.items()]
        said.append("Where that is NaN, or covariates are NULL, every call ends with SHERKIT_NOT_FINITE.")
    said.append(f"{name}_now is what Python takes where it is told none: the end of the run, its mean temperature,")
    said.append("the middle of what is lost at a reversal.")
    return "\n   ".join(said)


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


def comment(text: str) -> str:
    """A file's name cannot end a comment."""
    return re.sub(r"[^\w. -]", "_", text)
