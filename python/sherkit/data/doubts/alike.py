"""Two columns that hold the same though they are different quantities: one was written into the other;
and one value where many were expected.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations, combinations_with_replacement

import numpy as np

from ...base import linalg
from ...base.figures import listed
from ...base.types import Bools, Floats
from .. import columns as c
from ..artefact import is_artefact
from ..noise import MAD
from ..rows import Measurements
from .doubt import FEWEST, DataWarning, some

# -- What the other rows make one expect of a reading, without a model of the machine -------------------------------

#: Terms of the function, and rows for each of them.
_MOST_TERMS = 120
_ROWS_PER_TERM = 3
_DEGREES = (3, 2, 1)
#: A joint that turns by more than this is seen through its sine and cosine, rad.
_TURNS = 0.3
#: Rounds in which rows that are far off lose their weight.
_ROUNDS = 4


def _expected(data: Measurements, values: Floats, rows: Bools) -> tuple[Floats, float] | None:
    """A polynomial in the joints, fitted to ``values`` (n,) in these ``rows``: what it gives in all rows, and its
    robust RMS in those it was fitted to. None where rows are too few.

    Rows that are far off weigh less (Cauchy), so that a few wild ones do not count.
    """
    variables = _variables(data)
    if not variables:
        return None
    for degree in _DEGREES:
        terms = [t for d in range(degree + 1) for t in combinations_with_replacement(range(len(variables)), d)]
        if len(terms) <= _MOST_TERMS and _ROWS_PER_TERM * len(terms) <= rows.sum():
            break
    else:
        return None
    columns = np.stack([np.prod([np.ones(len(values)), *(variables[k] for k in t)], axis=0) for t in terms], axis=1)
    weight = np.ones(int(rows.sum()))
    for _ in range(_ROUNDS):
        root = np.sqrt(weight)
        x = linalg.lstsq(columns[rows] * root[:, None], values[rows] * root, rcond=1e-9)[0]
        off = values[rows] - columns[rows] @ x
        rms = MAD * float(np.median(np.abs(off)))
        weight = 1.0 / (1.0 + (off / max(2.0 * rms, 1e-12)) ** 2)
    return columns @ x, rms


def _variables(data: Measurements) -> list[Floats]:
    """The joints that move, from -1 to 1, each once."""
    out: list[Floats] = []
    for name, column in zip(data.layout.joints, data.joints.T, strict=True):
        reach = float(np.ptp(column))
        if reach == 0:
            continue
        if c.unit_in(name) == "rad" and _TURNS < reach < 4 * np.pi:
            out += [np.sin(column), np.cos(column)]
        else:
            out.append((2.0 * column - column.max() - column.min()) / reach)
    return out


# -- Two columns that hold the same ----------------------------------------------------------------------------------

#: What may lie between two columns that are the same, as a part of their range: rounding.
_ROUNDING = 1e-7
#: Different values from which a line can be told.
_VALUES = 8
#: What other joints leave of a reading, as a part of how far readings spread, where a joint that is missing moved it.
_UNEXPLAINED = 0.05
#: Quantities of columns by the endings of their names: what is no length, angle or pixel is no reading of a place.
_OTHER = ("_c", "_k", "_f", "_kg", "_g", "_s", "_pct", "_hpa", "_pa", "_n", "_a", "_v", "_w")
_OTHER_NAMES = ("temperature", "humidity", "pressure", "load", "payload", "time")


def alike(data: Measurements) -> Iterator[DataWarning]:
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
    read = [(data.readings[:, k], data.used[:, k]) for k in range(data.coordinates) if data.used[:, k].sum() >= FEWEST]
    # across the plane of a plan a reading hardly moves, and is all noise
    most = max((float(np.std(values[rows])) for values, rows in read), default=0.0)
    found = [_expected(data, values, rows) for values, rows in read]
    return any(one is not None and one[1] > _UNEXPLAINED * most for one in found)


def _doubt(data: Measurements, one: str, another: str, line: tuple[float, float]) -> DataWarning:
    factor, offset = line
    if line == (1.0, 0.0):
        what = f"{one} is the same as {another}"
    else:
        rest = f" {'-' if offset < 0 else '+'} {abs(offset):.6g}" if abs(offset) > 1e-9 else ""
        what = f"{one} is {factor:.6g} times {another}{rest}"
    return DataWarning(
        f"{what}, to the last digit, in all {len(data)} rows, though they are different quantities: one column was "
        "copied over the other, it seems; export both from the instruments again",
        columns=True,
    )


# -- One value where many were expected -----------------------------------------------------------------------------

#: Part of the rows that hold the one value, inside the range and at its end, and rows at least.
_INSIDE, _AT_END = 0.1, 0.03
_ROWS = 8
#: The next value comes less often, by this factor.
_ALONE = 3.0
#: How far off the value is where it stands, in robust RMS of what the other rows leave.
_OFF = 5.0
#: Part of the rows at the end of a range that were expected beyond it.
_BEYOND = 0.8
#: Different poses at which the value stands.
_POSES = 5


def piled(data: Measurements) -> Iterator[DataWarning]:
    """Readings that are one value in many rows at places where the others make one expect another.

    Where a plan stands in a plane, or an instrument has few digits, many readings are equal as well; but then they are
    where the joints put them.
    """
    if len(data) < FEWEST or not data.layout.follows:
        return
    few = some(data)
    lost: list[list[tuple[str, float, Bools]]] = []
    for k, name in enumerate(data.layout.coordinates):
        found = _piled(few, few.readings[:, k], few.used[:, k])
        if found is None or is_artefact(data):
            continue
        how, value = found
        here = data.used[:, k] & (data.readings[:, k] == value)
        if how == "lost":
            # one beam that was lost holds all its readings, each at its own value
            same = next((one for one in lost if one[0][1] == value or np.array_equal(one[0][2], here)), None)
            if same is None:
                lost.append(same := [])
            same.append((name, value + 0.0, here))
            continue
        yield DataWarning(
            f"{name} stays at {value:.8g}, the end of its range, in {here.sum()} of {len(data)} rows where the joints "
            "carry it on: the instrument is saturated (clipped), it seems; leave these cells empty, or measure within "
            "its range",
            columns=True,
        )
    for each in lost:
        names, values, rows = zip(*each, strict=True)
        verb, them = ("is", "it") if len(each) == 1 else ("are", "them")
        yield DataWarning(
            f"{listed(names)} {verb} {listed(f'{value:.8g}' for value in dict.fromkeys(values))} in "
            f"{max(int(here.sum()) for here in rows)} of {len(data)} rows where the joints put {them} elsewhere: "
            "readings that were lost, it seems; leave these cells empty",
            columns=True,
        )


def _piled(data: Measurements, values: Floats, used: Bools) -> tuple[str, float] | None:
    """How one value is piled up, ``lost`` or ``clipped``, and the value."""
    u = values[used]
    if len(u) < FEWEST:
        return None
    different, count = np.unique(u, return_counts=True)
    if len(different) < 2 or count.max() < max(_ROWS, _AT_END * len(u)):
        return None
    order = np.argsort(count, kind="stable")[::-1]
    for k in order[:2]:
        value, often = float(different[k]), int(count[k])
        next_most = int(np.delete(count, k).max()) if k == order[0] else int(np.delete(count, order[:2]).max(initial=0))
        if often < max(_ROWS, _AT_END * len(u)) or next_most * _ALONE > often:
            continue
        here = used & (values == value)
        if len(np.unique(data.joints[here], axis=0)) < _POSES:
            continue
        found = _expected(data, values, used & ~here)
        if found is None:
            continue
        there, rms = found
        off = there[here] - value
        if np.median(np.abs(off)) <= _OFF * max(rms, 1e-12):
            continue
        at_end = k == 0 or k == len(different) - 1
        beyond = off if k == len(different) - 1 else -off
        if at_end and (beyond > -rms).mean() >= _BEYOND:
            return "clipped", value
        if often >= _INSIDE * len(u):
            return "lost", value
    return None
