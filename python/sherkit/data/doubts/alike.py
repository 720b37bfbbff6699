"""Two columns that hold the same though they are different quantities: one was written into the other."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations

import numpy as np

from ...base.types import Bools, Floats
from .. import columns as c
from ..rows import Measurements
from .doubt import FEWEST, Doubt, some
from .expected import expected

#: What may lie between two columns that are the same, as a part of their range: rounding.
_ROUNDING = 1e-7
#: Different values from which a line can be told.
_VALUES = 8
#: What other joints leave of a reading, as a part of how far readings spread, where a joint that is missing moved it.
_UNEXPLAINED = 0.05
#: Quantities of columns by the endings of their names: what is no length, angle or pixel is no reading of a place.
_OTHER = ("_c", "_k", "_f", "_kg", "_g", "_s", "_pct", "_hpa", "_pa", "_n", "_a", "_v", "_w")
_OTHER_NAMES = ("temperature", "humidity", "pressure", "load", "payload", "time")


def alike(data: Measurements) -> Iterator[Doubt]:
    """Readings that are joints, times, temperatures or one another in every row; joints that are one another though the
    readings show that both moved. Noise alone keeps readings apart, so that rounding is all that may lie between."""
    if len(data) < FEWEST:
        return
    few, layout = some(data), data.layout
    readings = {
        name: (data.readings[:, k], data.used[:, k])
        for k, name in enumerate(layout.coordinates) if data.used[:, k].sum() >= FEWEST
    }  # fmt: skip
    every = ~data.outlier
    joints = {name: (data.joints[:, j], every) for j, name in enumerate(layout.joints)}
    other = {name: (v, every) for name, v in data.covariates.items() if _is_other(name)}
    if data.time_s is not None:
        other[c.TIME] = (data.time_s, every)
    told: set[str] = set()
    pairs = [*combinations(readings, 2), *((r, o) for r in readings for o in (*joints, *other))]
    columns = {**joints, **other, **readings}
    for one, another in pairs:
        line = _line(columns[one], columns[another])
        if line is not None and one not in told:
            told.add(one)
            yield _doubt(data, one, another, line)
    if told:
        return
    for one, another in [*combinations(joints, 2), *((j, o) for j in joints for o in other)]:
        line = _line(joints[one], columns[another])
        # a plan may well move joints alike, or at even steps of time: then the readings follow the others
        if line is not None and (another in joints or line == (1.0, 0.0)) and _lacks(few, another):
            yield _doubt(data, another, one, line if another in other else _inverse(line))


def _is_other(name: str) -> bool:
    low = name.lower()
    return low.endswith(_OTHER) or any(low.startswith(word) for word in _OTHER_NAMES)


def _line(one: tuple[Floats, Bools], another: tuple[Floats, Bools]) -> tuple[float, float] | None:
    """Factor and offset by which the first is the second in all rows that have both; None where it is not."""
    rows = np.flatnonzero(one[1] & another[1])
    if len(rows) < FEWEST:
        return None
    # most columns part in the first rows
    for at in (rows[np.unique(np.linspace(0, len(rows) - 1, 4 * _VALUES).astype(np.int64))], rows):
        y, x = one[0][at], another[0][at]
        low, high = int(np.argmin(x)), int(np.argmax(x))
        reach = float(x[high] - x[low])
        if reach == 0 or np.ptp(y) == 0:
            return None
        factor = float(y[high] - y[low]) / reach
        offset = float(y[low] - factor * x[low])
        if np.abs(y - factor * x - offset).max() > _ROUNDING * np.ptp(y):
            return None
    if len(np.unique(y[: 64 * _VALUES])) < _VALUES:
        return None
    same = np.abs(y - x).max() <= _ROUNDING * np.ptp(y)
    return (1.0, 0.0) if same else (factor, offset)


def _inverse(line: tuple[float, float]) -> tuple[float, float]:
    return 1.0 / line[0], -line[1] / line[0]


def _lacks(data: Measurements, name: str) -> bool:
    """Whether the joints leave more of a reading than joints would, that were all there."""
    turning = np.array([c.unit_in(joint) == "rad" for joint in data.layout.joints])
    read = [(data.readings[:, k], data.used[:, k]) for k in range(data.coordinates) if data.used[:, k].sum() >= FEWEST]
    # across the plane of a plan a reading hardly moves, and is all noise
    most = max((float(np.std(values[rows])) for values, rows in read), default=0.0)
    found = [expected(data.joints, turning, values, rows) for values, rows in read]
    return any(one is not None and one[1] > _UNEXPLAINED * most for one in found)


def _doubt(data: Measurements, one: str, another: str, line: tuple[float, float]) -> Doubt:
    factor, offset = line
    if line == (1.0, 0.0):
        what = f"{one} is the same as {another}"
    else:
        rest = f" {'-' if offset < 0 else '+'} {abs(offset):.6g}" if abs(offset) > 1e-9 else ""
        what = f"{one} is {factor:.6g} times {another}{rest}"
    return Doubt(
        f"{what}, to the last digit, in all {len(data)} rows, though they are different quantities: one column was "
        "copied over the other, it seems; export both from the instruments again",
        columns=True,
    )
