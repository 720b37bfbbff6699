"""One value where many were expected: zeros of readings that were lost, the end of a range that was reached."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ...base.names import listed
from ...base.types import Bools, Floats
from .. import columns as c
from ..rows import Measurements
from .doubt import FEWEST, Doubt, some
from .expected import expected

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


def piled(data: Measurements) -> Iterator[Doubt]:
    """Readings that are one value in many rows at places where the others make one expect another.

    Where a plan stands in a plane, or an instrument has few digits, many readings are equal as well; but then they are
    where the joints put them.
    """
    if len(data) < FEWEST or not data.layout.follows:
        return
    few = some(data)
    turning = np.array([c.unit_in(joint) == "rad" for joint in data.layout.joints])
    told: dict[tuple[str, float], list[tuple[str, int]]] = {}
    for k, name in enumerate(data.layout.coordinates):
        found = _piled(few.joints, turning, few.readings[:, k], few.used[:, k])
        if found is not None:
            how, value = found
            count = int((data.used[:, k] & (data.readings[:, k] == value)).sum())
            told.setdefault((how, value if how == "lost" else float(k)), []).append((name, count))
            if how != "lost":
                told[(how, float(k))] = [(f"{name} stays at {value:.8g}", count)]
    for (how, value), each in told.items():
        names, count = listed([name for name, _ in each]), max(n for _, n in each)
        rows = f"in {count} of {len(data)} rows where the joints"
        verb, them = ("is", "it") if len(each) == 1 else ("are", "them")
        if how == "lost":
            sentence = (
                f"{names} {verb} {value + 0.0:.8g} {rows} put {them} elsewhere: readings that were lost, it seems; "
                "leave these cells empty"
            )
        else:
            sentence = (
                f"{names}, the end of its range, {rows} carry it on: the instrument is saturated (clipped), it seems; "
                "leave these cells empty, or measure within its range"
            )
        yield Doubt(sentence, columns=True)


def _piled(joints: Floats, turning: Bools, values: Floats, used: Bools) -> tuple[str, float] | None:
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
        if len(np.unique(joints[here], axis=0)) < _POSES:
            continue
        found = expected(joints, turning, values, used & ~here)
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
