"""What a loop was told, as one table: rows come back in any form, fewer, more, later or elsewhere than asked; and which
readings are none."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from ..base.figures import listed, spans
from ..base.types import Bools, Floats, Ints
from ..data import Measurements, from_frame, read_measurements
from ..data.columns import OUTLIER, POSE, REASON, REPEAT, TIME, Layout
from ..data.frames import to_polars
from ..data.in_time import directions
from ..errors import FitError, MeasurementError, SherkitError
from ..evidence.thresholds import MOVES, SAME_PLACE, WRONG
from ..fit.set_up import set_up_mistakes
from ..model.base import ModelWithEffects
from ..model.chain import ChainModel
from ..model.robot_file import run_for
from ..planning.region import Region, planned
from .known import PLACES

# -- Rows as one table -------------------------------------------------------------------------------------------------

_WHERE = "the rows told"


def frame_of_rows(rows: Any) -> pl.DataFrame:
    """Rows in any form as a frame. Raises :class:`~sherkit.errors.MeasurementError`."""
    if isinstance(rows, Measurements):
        return rows.to_frame()
    if isinstance(rows, str | PathLike):
        return read_measurements(Path(rows)).to_frame()
    return to_polars(rows)


def poses(frame: pl.DataFrame) -> list[tuple[int, int]]:
    """Numbers of the poses that were told, and of their repeats."""
    if not {POSE, REPEAT} <= set(frame.columns):
        return []
    return [(int(p), int(r)) for p, r in frame.select(POSE, REPEAT).iter_rows() if p is not None]


def taken(
    frame: pl.DataFrame, asked: Sequence[Mapping[str, Any]], targets: Sequence[str], layout: Layout
) -> pl.DataFrame:
    """What was read of a frame of rows: where joints lead is what was ``asked``, and counts as no reading.

    A reading that is the place asked for, to the last digit, in every row was handed back and not taken. Raises
    :class:`~sherkit.errors.MeasurementError` where that is all of them.
    """
    frame = frame.drop([n for n in ("not_before_s", *targets) if n in frame.columns and n not in layout.readings])
    led = {(row[POSE], row[REPEAT]): row for row in asked}
    if not {POSE, REPEAT} <= set(frame.columns):
        return frame
    keys = [(pose, repeat) for pose, repeat in frame.select(POSE, REPEAT).iter_rows()]
    if not keys or not all(key in led for key in keys):
        return frame
    read = [name for name in layout.readings if name in frame.columns]
    same = [n for n in read if n in targets and frame[n].to_list() == [led[key][n] for key in keys]]
    if read and same == read:
        raise MeasurementError(
            f"{_WHERE}: {', '.join(same)} are where the joints should lead, as ask() gave them, in every row: put what "
            "was read in their place"
        )
    return frame.drop(same)


def added(frame: pl.DataFrame, new: pl.DataFrame, layout: Layout) -> pl.DataFrame:
    """A table with new rows; those that stand there already are known, and a pose that was read again under the same
    number of its repeat is its next one."""
    whole = pl.concat([frame, new], how="diagonal_relaxed") if frame.height else new
    same = [name for name in (POSE, REPEAT, TIME, *layout.joints, *layout.readings) if name in whole.columns]
    whole = whole.unique(subset=same, keep="first", maintain_order=True)
    if {POSE, REPEAT} <= set(whole.columns) and whole.select(POSE, REPEAT).is_duplicated().any():
        repeats: list[Any] = []
        seen: dict[Any, set[Any]] = {}
        for pose, repeat in whole.select(POSE, REPEAT).iter_rows():
            of_pose = seen.setdefault(pose, set())
            free = repeat if repeat not in of_pose or repeat is None else max(of_pose) + 1
            of_pose.add(free)
            repeats.append(free)
        whole = whole.with_columns(pl.Series(REPEAT, repeats))
    return whole


def incomplete(frame: pl.DataFrame, layout: Layout) -> list[str]:
    """Columns beside those of the robot that are not in every row: nothing can be made to depend on them."""
    own = {POSE, REPEAT, TIME, OUTLIER, *layout.joints, *layout.to_joints, *layout.readings, *layout.sigmas,
           *layout.pose_sigmas, *layout.directions, REASON}  # fmt: skip
    return [name for name in frame.columns if name not in own and frame[name].null_count()]


def measurements(frame: pl.DataFrame, robot: Any, model: ModelWithEffects, layout: Layout) -> Measurements:
    """The rows of a table as a run of this robot. Raises :class:`~sherkit.errors.MeasurementError`."""
    frame = _elsewhere(frame, layout)
    read = from_frame(frame.drop(REASON, *incomplete(frame, layout), strict=False), _WHERE)
    data = model.as_declared(run_for(robot, read))
    if isinstance(model, ChainModel):
        try:
            model.require_own(data)
        except FitError as error:
            raise MeasurementError(str(error)) from None
    unknown = [k for k, name in enumerate(layout.directions) if name not in frame.columns]
    if unknown:
        # nobody knows from which side the first pose was approached; without a clock, rows are told in their order
        direction = data.direction.copy()
        direction[:, unknown] = directions(data.joints, data.order, begins=0.0)[:, unknown]
        data = replace(data, direction=direction)
    return data


def _elsewhere(frame: pl.DataFrame, layout: Layout) -> pl.DataFrame:
    """Rows that came back from elsewhere than the pose whose number they have, under numbers of their own."""
    if POSE not in frame.columns or not set(layout.joints) <= set(frame.columns):
        return frame
    joints = frame.select(layout.joints).cast(pl.Float64, strict=False).to_numpy()
    poses = frame[POSE].to_list()
    if any(type(pose) is not int for pose in poses):
        return frame
    near = SAME_PLACE * np.ptp(joints, axis=0)
    first: dict[int, Any] = {}
    free, out = max(poses), []
    for pose, place in zip(poses, joints, strict=True):
        if (np.abs(place - first.setdefault(pose, place)) > near).any():
            free += 1
            pose = free
        out.append(pose)
    return frame if out == poses else frame.with_columns(pl.Series(POSE, out))


def in_order_of_time(frame: pl.DataFrame, robot: Any, model: ModelWithEffects, layout: Layout) -> Measurements:
    """As :func:`measurements`, in the order in which they were read."""
    data = measurements(frame, robot, model, layout)
    return data.select(np.argsort(data.order, kind="stable"))


# -- Readings that are none --------------------------------------------------------------------------------------------
# Readings that are none: a channel that sticks while the robot moves, an encoder that stands while readings move.

#: So many readings running that are the same to the last bit are none, where the robot moved between them by this part
#: of all that it can.
_RUNNING = 3


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
        all_over = model.predict(planned(region.spread(PLACES, 0).joints, data.layout), none)[:, :width]
    except SherkitError:
        return Unread(cells, ())
    way = MOVES * np.ptp(all_over[np.isfinite(all_over).all(axis=1)], axis=0)
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
