"""Readings that stand some rows away from the joints that they belong to: all of them, one column, or from a row on."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ..base.types import Bools, Floats, Ints
from ..data import Measurements
from ..errors import SherkitError
from ..model.base import ModelWithEffects

#: Rows by which readings may stand below their joints; and a column of its own, or readings from a row on.
_ROWS, _ROWS_OF_SOME = (1, -1, 2, -2, 3, -3), (1, -1)
#: Times as near as they stand that ways between readings come to those of the drawing where a row was lost, and rows on
#: either side of it.
_NEARER, _EITHER_SIDE = 3.0, 4
#: A way counts as off by no more than so many times what is usual.
_MOST = 20.0


def of_rows(model: ModelWithEffects, data: Measurements) -> Iterator[tuple[str, str, Measurements]]:
    """What looks wrong, what to do, and the rows as they would be then."""
    everything = list(range(data.readings.shape[1]))
    for by in _ROWS:
        if len(data) > 4 * abs(by):
            where, there, count = _in_words(by)
            looks = f"readings look shifted: they stand {count} {where} the joints that they belong to"
            yield looks, f"move them {there} by {count}", _moved(data, by, everything, [])
    readings = [k for k in range(data.coordinates) if data.used[:, k].any()]
    joints = range(len(data.layout.joints))
    one: list[tuple[str, list[int], list[int]]] = []
    one += [(data.layout.readings[k], [k], []) for k in readings if len(readings) > 1]
    one += [(data.layout.joints[k], [], [k]) for k in joints if len(joints) > 1]
    for by in _ROWS_OF_SOME if len(data) > 4 else ():
        where, there, count = _in_words(by)
        for name, of_readings, of_joints in one:
            looks = f"{name} looks shifted: it stands {count} {where} its row"
            yield looks, f"move it {there} by {count}", _moved(data, by, of_readings, of_joints)
    yield from moved_from_a_row_on(model, data)


def moved_from_a_row_on(model: ModelWithEffects, data: Measurements) -> Iterator[tuple[str, str, Measurements]]:
    """The same where a reading was lost, or one was read twice: the others have moved up, or down."""
    readings = [k for k in range(data.coordinates) if data.used[:, k].any()]
    if len(readings) < 2:
        return
    try:
        drawn = model.predict(data, model.start(data))
    except SherkitError:
        return
    # how far one row is from the next is the same wherever an instrument stands, and near what the drawing says of it
    way, told = (np.linalg.norm(np.diff(one[:, readings], axis=0), axis=1) for one in (data.readings, drawn))
    for by in _ROWS_OF_SOME:
        if (first := _from_where(way, told, by)) is not None:
            where, there, count = _in_words(by)
            looks = (
                f"readings look shifted from {data.counted} {data.line[first]} on: there they stand {count} {where} "
                f"the joints that they belong to, as where {'one was lost' if by < 0 else 'one was read twice'}"
            )
            every = range(data.readings.shape[1])
            yield looks, f"move them {there} by {count} from there on", _moved(data, by, every, [], first)


def _in_words(by: int) -> tuple[str, str, str]:
    where, there = ("below", "up") if by > 0 else ("above", "down")
    return where, there, f"{abs(by)} row{'s' if abs(by) > 1 else ''}"


def _moved(data: Measurements, by: int, readings: Sequence[int], joints: Sequence[int], first: int = 0) -> Measurements:
    """Columns of readings and of joints from ``by`` rows further down, from the row ``first`` on; rows that have none
    are left out, or, where others stay, outliers."""
    rows = np.arange(len(data)) if first else np.arange(max(-by, 0), len(data) - max(by, 0))
    there: Ints = np.where(rows >= first, np.minimum(rows + by, len(data) - 1), rows)
    lost = (rows == (first if by < 0 else len(data) - 1)) & (first > 0)

    def taken_from(values: Floats | Bools, columns: Sequence[int]) -> Any:
        out = values[rows].copy()
        out[:, columns] = values[there][:, columns]
        return out

    kept = data.select(rows)
    return replace(
        kept,
        readings=taken_from(data.readings, readings),
        taken=taken_from(data.taken, readings),
        sigma=taken_from(data.sigma, readings),
        outlier=data.outlier[rows] | data.outlier[there] | lost,
        joints=taken_from(data.joints, joints),
        to_joints=kept.to_joints if data.layout.from_fixed else taken_from(data.to_joints, joints),
        direction=taken_from(data.direction, joints),
    )


def _from_where(way: Floats, told: Floats, by: int) -> int | None:
    """The row from which on readings are those of ``by`` rows further up, by the ways (n - 1,) from each to the next
    and those that the drawing tells; None where they are not."""
    # the way from row i to the next, against that of rows that the readings would belong to
    there = np.arange(len(way)) - by
    inside = (there >= 0) & (there < len(way))
    stays = np.abs(way - told)
    goes = np.where(inside, np.abs(way - told[there.clip(0, len(way) - 1)]), stays)
    known = np.isfinite(stays) & np.isfinite(goes)
    stays, goes = (np.where(known, one, 0.0) for one in (stays, goes))
    # one row far off must not decide
    most = _MOST * max(float(np.median(np.minimum(stays, goes))), 1e-12)
    stays, goes = np.minimum(stays, most), np.minimum(goes, most)
    left = np.concatenate([[0.0], np.cumsum(stays)]) + np.concatenate([np.cumsum(goes[::-1])[::-1], [0.0]])
    first = int(np.argmin(left))
    some = _EITHER_SIDE <= first <= len(way) - _EITHER_SIDE
    # those before it do not go with the others either
    apart = left[0] - left[first] > 0.5 * _EITHER_SIDE * most
    return first if some and apart and left[first] * _NEARER < left[-1] else None
