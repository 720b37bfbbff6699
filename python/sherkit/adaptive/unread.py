"""Readings that are none: a channel that sticks while the robot moves, an encoder that stands while readings move."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..base.names import listed, spans
from ..base.types import Bools, Floats, Ints
from ..data import Measurements
from ..diagnosis.gathered import WRONG
from ..errors import SherkitError
from ..fit.set_up import set_up_mistakes
from ..model.base import ModelWithEffects
from .region import Region, planned

#: So many readings running that are the same to the last bit are none, where the robot moved between them by this part
#: of all that it can.
_RUNNING, _MOVES = 3, 0.05
#: Places of the region at which it is looked how far it can move.
_PLACES = 64


@dataclass(frozen=True, eq=False)
class Unread:
    """Cells (n, m) of readings that were not read, and what is said of them, with channel and rows."""

    cells: Bools
    sentences: tuple[str, ...]

    def too_many(self, last: int) -> bool:
        """Whether the rest is no run, or the ``last`` rows say that it goes on."""
        rows: Bools = np.asarray(self.cells.any(axis=1))
        return bool(rows.sum() > WRONG * len(rows) or rows[-last:].all())

    def without(self, data: Measurements) -> Measurements:
        """The data with these cells empty."""
        return replace(data, taken=data.taken & ~self.cells) if self.cells.any() else data


def unread_cells(model: ModelWithEffects, region: Region, data: Measurements) -> Unread:
    """What of these rows, in the order of time, was not read."""
    cells, out = np.zeros(data.taken.shape, dtype=bool), []
    width, none = data.coordinates, np.zeros(len(model.parameters))
    try:
        drawn = model.predict(data, none)[:, :width]
        all_over = model.predict(planned(region.spread(_PLACES, 0).joints, data.layout), none)[:, :width]
    except SherkitError:
        return Unread(cells, ())
    way = _MOVES * np.ptp(all_over[np.isfinite(all_over).all(axis=1)], axis=0)
    for k, name in enumerate(data.layout.readings[:width]):
        rows = np.flatnonzero(data.taken[:, k] & np.isfinite(drawn[:, k]))
        stuck = rows[_standing(data.readings[rows, k], drawn[rows, k : k + 1], way[k : k + 1])]
        if len(stuck):
            cells[stuck, k] = True
            out.append(
                f"{name} stays {_value(data.readings[stuck, k])}in {_rows(data, stuck)}, the same to the last digit "
                "while the robot moved: the sensor sticks, it seems; look at it and its cable"
            )
    whole = np.flatnonzero(data.taken[:, :width].all(axis=1))
    moved = data.readings[whole, :width]
    # one joint may rest while others move; all of them do not
    still = [_standing(one, moved, way) for one in data.joints[whole].T]
    if still and (frozen := whole[np.logical_and.reduce(still)]).size:
        cells[frozen] = True
        out.append(
            f"{listed(data.layout.joints)} stay the same to the last digit in {_rows(data, frozen)} while the readings "
            "move: look whether the encoders are read"
        )
    return Unread(cells, tuple(out))


def mistaken(model: ModelWithEffects, data: Measurements, values: Floats | None = None) -> tuple[str, ...]:
    """What in the set-up explains readings that nothing fits: columns that are exchanged, readings a row late."""
    try:
        return tuple(one.sentence for one in set_up_mistakes(model, data, values))
    except SherkitError:
        return ()


def _standing(values: Floats, moved_by: Floats, way: Floats) -> Bools:
    """Which values (n,) are of a run of equal ones over which what moves them (n, m) goes farther than its ``way``."""
    out = np.zeros(len(values), dtype=bool)
    for run in np.split(np.arange(len(values)), np.flatnonzero(np.diff(values) != 0) + 1):
        if len(run) >= _RUNNING and (np.ptp(moved_by[run], axis=0) > way).any():
            out[run] = True
    return out


def _value(values: Floats) -> str:
    return f"{values[0]:.6g} " if len(np.unique(values)) == 1 else ""


def _rows(data: Measurements, rows: Ints) -> str:
    return f"{data.counted}s {spans(data.line[rows])}"
