"""The column names of a table of measurements, and what they mean."""

from __future__ import annotations

import warnings

from ..errors import MeasurementError, SherkitWarning
from ..names import closest, listed

JOINTS = ("q1_mm", "q2_mm", "q3_mm")
TO_JOINTS = ("to_q1_mm", "to_q2_mm", "to_q3_mm")
POSITION = ("x_mm", "y_mm", "z_mm")
DISTANCE = "distance_mm"
READINGS = (*POSITION, DISTANCE)
SIGMAS = tuple(f"sigma_{name}" for name in READINGS)
TIME = "time_s"
DIRECTIONS = ("direction_1", "direction_2", "direction_3")
TEMPERATURE = "temperature_c"
POSE = "pose"
REPEAT = "repeat"
OUTLIER = "outlier"

KNOWN = (*JOINTS, *TO_JOINTS, *READINGS, *SIGMAS, *DIRECTIONS, TIME, POSE, REPEAT, OUTLIER)
#: Columns where an empty cell means "not taken here".
MAY_BE_EMPTY = (*TO_JOINTS, *READINGS, *SIGMAS)

#: A covariate whose name is as alike as this to a column that is not there may be a slip of the finger.
_MISSPELT = 0.8
_UNITS = ("_m", "_um", "_µm", "_cm", "_in", "_mm")


def check_unique(names: list[str], where: str) -> None:
    """Refuses a column name that is given twice. Raises ``MeasurementError``."""
    if len(set(names)) < len(names):
        twice = sorted({f"'{n}'" for n in names if names.count(n) > 1})
        raise MeasurementError(f"{where}: column {listed(twice)} appears more than once")


def check_columns(names: list[str], where: str) -> None:
    """Refuses a table that lacks what every delta run has, or holds a reading in another unit.

    Raises ``MeasurementError``; warns of a covariate whose name looks like a misspelt column.
    """
    for needed in JOINTS:
        if needed not in names:
            raise MeasurementError(_missing(needed, names, where, "the reading of a joint"))
    readings = [r for r in READINGS if r in names]
    if not readings:
        what = "at least one of x_mm, y_mm, z_mm or distance_mm"
        raise MeasurementError(_missing("x_mm", names, where, what))
    if DISTANCE in names:
        for needed in TO_JOINTS:
            if needed not in names:
                what = "the joints at the other end of each distance"
                raise MeasurementError(_missing(needed, names, where, what))
    absent = [n for n in KNOWN if n not in names]
    for name in (n for n in names if n not in KNOWN):
        stem = name.rsplit("_", 1)[0]
        if f"{stem}_mm" in absent and name.removeprefix(stem) in _UNITS:
            raise MeasurementError(f"{where}: column '{name}': convert it to millimetres and name it '{stem}_mm'")
        typed = closest(name.lower(), absent, cutoff=_MISSPELT)
        if typed:
            message = f"{where}: column '{name}' is taken as a covariate; is it meant to be '{typed}'?"
            warnings.warn(message, SherkitWarning, stacklevel=2)


def _missing(name: str, names: list[str], where: str, what: str) -> str:
    stem = name.rsplit("_", 1)[0]
    for unit in _UNITS:
        if stem + unit in names:
            return (
                f"{where}: column '{name}' is missing ({what}); the file has '{stem + unit}': "
                f"convert it to millimetres and name it '{name}'"
            )
    unknown = [n for n in names if n not in KNOWN]
    typed = closest(name, unknown)
    hint = f"; is '{typed}' meant to be it?" if typed else f"; the file has {listed(names, 12)}"
    return f"{where}: column '{name}' is missing ({what}){hint}"
