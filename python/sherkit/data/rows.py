"""Measurements: an immutable table of readings, of any machine."""

from __future__ import annotations

import hashlib
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
from numpy.typing import NDArray

from ..base.figures import listed, nearest
from ..base.types import Bools, Floats, Ints
from ..errors import EffectError, ShapeError, SherkitWarning
from . import columns as c
from .in_time import Room, begin_of, directions, order_in_time, velocities
from .repeats import Repeatability, pure_error
from .row_checks import check_rows
from .set_up import JoinedSetUp, set_up_names
from .tables import write_table


@dataclass(frozen=True, eq=False)
class Measurements:
    """Rows of readings of a machine. Arrays have one row per reading and are not to be written to.

    ``layout`` names the columns and their units. ``joints`` (n, k), the machine's inputs; ``to_joints`` (n, e), the
    other ends of distances, NaN where the row is none; ``readings`` (n, m), coordinates and then the distance, and
    ``taken`` (n, m) telling which were taken; ``sigma`` (n, m), NaN where no noise was declared; ``outlier`` (n,) rows
    that the user marked as wrong: kept, listed, not fitted. ``line`` (n,) is the line of the row in its file
    (``counted`` is ``"line"``) or its number from 0 in a frame (``"row"``), for messages. ``direction`` (n, k) is the
    sign of the last motion of each joint, from the columns ``direction_1`` … or from the order in time; NaN where
    neither is known. ``order`` (n,) is the place of the row in the run it was taken from, by time where that is known.
    ``block`` (n,) says which rows are held out together in validation; where it is None, neighbours are.
    """

    joints: Floats
    to_joints: Floats
    readings: Floats
    taken: Bools
    sigma: Floats
    pose_sigma: Floats
    time_s: Floats | None
    pose: Ints | None
    repeat: Ints | None
    outlier: Bools
    covariates: Mapping[str, Floats]
    labels: Mapping[str, NDArray[Any]]
    source: str
    line: Ints
    counted: str
    direction: Floats
    order: Ints
    layout: c.Layout
    block: Ints | None = None
    #: The room of the whole run, of which these may be some rows; None where what follows it has caught up.
    room: Room | None = None
    #: The clock at the begin of that run; zero where no times are known.
    begins_s: float = 0.0
    #: Set-ups before the last whose readings were brought into its axes.
    set_ups: tuple[JoinedSetUp, ...] = ()

    # -- making ------------------------------------------------------------------------------------------

    @classmethod
    def from_columns(
        cls,
        values: Mapping[str, NDArray[Any]],
        source: str,
        line: Ints | None = None,
        counted: str = "row",
        layout: c.Layout | None = None,
    ) -> Measurements:
        """Builds rows from clean columns: floats, NaN only where a reading was not taken.

        Raises :class:`~sherkit.errors.MeasurementError` for a row without any reading, half a distance, or a
        pose and repeat given twice. Warns where units do not fit.
        """
        layout = c.layout_of(list(values)) if layout is None else layout
        n = len(next(iter(values.values())))
        line = np.arange(n, dtype=np.int64) if line is None else line

        def stack(names: Sequence[str]) -> Floats:
            out = np.full((n, len(names)), np.nan)
            for k, name in enumerate(names):
                if name in values:
                    out[:, k] = values[name]
            return out

        joints = stack(layout.joints)
        to = stack(layout.to_joints) if layout.to_joints else np.full(joints.shape, np.nan)
        readings = stack(layout.readings)
        taken = np.isfinite(readings)
        time_s = np.asarray(values[c.TIME], dtype=float) if c.TIME in values else None
        whole = {k: values[k].astype(np.int64) if k in values else None for k in (c.POSE, c.REPEAT)}
        known = set(layout.known)
        rest = {k: v for k, v in values.items() if k not in known}
        if not {*layout.velocities} & {*rest} and (moving := velocities(joints, time_s)) is not None:
            rest |= dict(zip(layout.velocities, moving.T, strict=False))
        if c.SETUP in rest:
            rest[c.SETUP] = set_up_names(rest[c.SETUP], f"{source}: {counted}", line)
        data = cls(
            joints=joints,
            to_joints=to,
            readings=np.where(taken, readings, 0.0),
            taken=taken,
            sigma=stack(layout.sigmas),
            pose_sigma=np.nan_to_num(stack(layout.pose_sigmas)),
            time_s=time_s,
            pose=whole[c.POSE],
            repeat=whole[c.REPEAT],
            outlier=values[c.OUTLIER] != 0 if c.OUTLIER in values else np.zeros(n, dtype=bool),
            covariates={k: np.asarray(v, dtype=float) for k, v in rest.items() if v.dtype.kind in "fiub"},
            labels={k: v for k, v in rest.items() if v.dtype.kind not in "fiub"},
            source=source,
            line=line,
            counted=counted,
            direction=_directions(values, joints),
            order=order_in_time(time_s, n),
            layout=layout,
            room=Room.of(time_s, values.get(c.TEMPERATURE)),
            begins_s=begin_of(time_s),
        )
        check_rows(data)
        return data

    def read_as(self, layout: c.Layout) -> Measurements:
        """The same rows for a machine with these columns, where they have other ones in common with another kind of
        robot; as they are where they lack some."""
        frame = self.to_frame()
        if layout == self.layout or not {*layout.joints, *layout.readings} <= set(frame.columns):
            return self
        values = {name: frame[name].to_numpy() for name in frame.columns}
        return Measurements.from_columns(values, self.source, self.line, self.counted, layout)

    @classmethod
    def planned(cls, joints: Floats, layout: c.Layout, source: str = "plan", **columns: Floats) -> Measurements:
        """Rows at these joint readings (n, k) whose readings are still to come; they count as taken, and as zero.

        ``columns`` are time, directions and covariates, where they are known.
        """
        values = {name: np.asarray(joints, dtype=float)[:, k] for k, name in enumerate(layout.joints)}
        values |= {name: np.zeros(len(joints)) for name in layout.coordinates}
        with warnings.catch_warnings():
            # readings that are all zero look as if they were in another unit
            warnings.simplefilter("ignore", SherkitWarning)
            return cls.from_columns({**values, **columns}, source, layout=layout)

    # -- using -------------------------------------------------------------------------------------------

    def __len__(self) -> int:
        return len(self.joints)

    def __repr__(self) -> str:
        kinds = [
            name for name, any_ in zip(self.layout.readings, np.any(self.taken, axis=0).tolist(), strict=True) if any_
        ]
        poses = "" if self.pose is None else f", {len(np.unique(self.pose))} poses"
        return f"Measurements({len(self)} rows{poses}, {', '.join(kinds)}, from {self.source})"

    def place(self, rows: NDArray[Any]) -> str:
        """Where rows stand, for a message: file and lines."""
        lines = self.line[rows]
        return f"{self.source}: {self.counted}{'s' if len(lines) > 1 else ''} {listed(lines)}"

    def select(self, rows: NDArray[Any]) -> Measurements:
        """The rows of a mask or of indices, in that order; all of them as they stand are this run itself."""
        rows = np.asarray(rows)
        if len(rows) == len(self) and (rows.all() if rows.dtype == bool else (rows == np.arange(len(self))).all()):
            return self
        if rows.dtype == bool:
            rows = np.flatnonzero(rows)

        def pick(value: Any) -> Any:
            return None if value is None else value[rows]

        return replace(
            self,
            **{
                name: pick(getattr(self, name))
                for name in (
                    "joints", "to_joints", "readings", "taken", "sigma", "pose_sigma",
                    "time_s", "pose", "repeat", "outlier", "line", "direction", "order", "block",
                )
            },
            covariates={k: v[rows] for k, v in self.covariates.items()},
            labels={k: v[rows] for k, v in self.labels.items()},
        )  # fmt: skip

    def later(self, lag_s: float) -> Floats | None:
        """Temperature (n,), °C, of what follows the room with this time constant; None where it is not known."""
        now = self.covariates.get(c.TEMPERATURE)
        if now is None or self.room is None or self.time_s is None or lag_s <= 0.0:
            return now
        return self.room.later(self.time_s, lag_s)

    def __getitem__(self, name: str) -> Floats:
        """An input or a covariate (n,). Raises :class:`~sherkit.errors.EffectError` for a name that is not there."""
        if name in self.layout.joints:
            return self.joints[:, self.layout.joints.index(name)]
        if name in self.covariates:
            return self.covariates[name]
        if name == c.TIME and self.time_s is not None:
            return self.time_s
        known = [*self.layout.joints, *self.covariates]
        raise EffectError(f"these rows have no '{name}'{nearest(name, known)}; they have {listed(known, 20)}")

    @cached_property
    def digest(self) -> str:
        """What tells these rows, in any order, from those of any other run: of joints and readings."""
        every = np.column_stack([self.joints, np.where(self.taken, self.readings, 0.0)]) + 0.0
        return hashlib.sha256(every[np.lexsort(every.T)].tobytes()).hexdigest()[:16]

    def with_readings(self, readings: Floats) -> Measurements:
        """The same rows with other readings (n, m), NaN where one was not taken. Raises ``ShapeError``."""
        if readings.shape != self.readings.shape:
            raise ShapeError(f"{self.source}: readings: expected {self.readings.shape}, got {readings.shape}")
        taken = np.isfinite(readings)
        return replace(self, readings=np.where(taken, readings, 0.0), taken=taken)

    def mark_outliers(self, rows: NDArray[Any]) -> Measurements:
        """The same rows with the given ones marked as outliers, on top of those marked before."""
        outlier = self.outlier.copy()
        outlier[rows] = True
        return replace(self, outlier=outlier)

    def kept(self) -> Measurements:
        """The same rows, none of them marked as an outlier."""
        return replace(self, outlier=np.zeros(len(self), dtype=bool))

    @cached_property
    def used(self) -> Bools:
        """Readings (n, m) that were taken, in rows that are not marked as outliers."""
        return self.taken & ~self.outlier[:, None]

    @property
    def coordinates(self) -> int:
        """How many of the reading columns are coordinates; they come first."""
        return len(self.layout.coordinates)

    @cached_property
    def is_distance(self) -> Bools:
        """Which rows are distances."""
        if self.layout.distance is None:
            return np.zeros(len(self), dtype=bool)
        return self.taken[:, -1]

    @cached_property
    def between_places(self) -> Bools:
        """Which rows are distances whose other end is a pose, too."""
        if not self.layout.to_joints or self.layout.from_fixed:
            return np.zeros(len(self), dtype=bool)
        return np.asarray(np.isfinite(self.to_joints).all(axis=1))

    @cached_property
    def from_other_end(self) -> Measurements:
        """The same rows with the ends of distances between places exchanged: what was read is the same."""
        far = self.between_places[:, None]
        if not far.any():
            return replace(self)
        joints = np.ascontiguousarray(np.where(far, self.to_joints, self.joints))
        return replace(self, joints=joints, to_joints=np.where(far, self.joints, self.to_joints))

    @cached_property
    def came_from(self) -> Floats:
        """``direction`` (n, k), zero at distances between places: nobody knows from where their ends were reached."""
        return np.where(self.between_places[:, None], 0.0, self.direction)

    def unmeasured(self, joints: Floats) -> Measurements:
        """Rows that were not measured yet: these joints (k, n), and covariates as they were on average."""
        n = len(joints)
        made = self.select(np.zeros(n, dtype=np.int64))
        taken = np.array([name != self.layout.distance for name in self.layout.readings])
        return replace(
            made,
            joints=np.ascontiguousarray(joints),
            to_joints=np.full((n, self.to_joints.shape[1]), np.nan),
            taken=np.tile(taken, (n, 1)),
            direction=np.ones_like(joints),
            room=None,
            outlier=np.zeros(n, dtype=bool),
            labels={
                k: np.full(n, self.last_set_up, dtype=object) if k == c.SETUP else v for k, v in made.labels.items()
            },
            covariates={
                # a robot warms and stays warm; other covariates come back, numbers of things with the first of them
                k: np.full(n, float(v[-1] if k == c.TEMPERATURE else 1.0 if k in self.layout.apart else v.mean()))
                for k, v in self.covariates.items()
            },
        )

    def to_be_read(self, layout: c.Layout) -> Measurements:
        """The same rows where the coordinates of another layout with these joints are still to be read."""
        n, m = len(self), len(layout.readings)
        taken = np.tile([name != layout.distance for name in layout.readings], (n, 1))
        nothing = np.full((n, m), np.nan)
        return replace(self, layout=layout, readings=np.zeros((n, m)), taken=taken, sigma=nothing)

    @cached_property
    def distances_or_none(self) -> Floats | None:
        """``to_joints`` where any row is a distance, else None, as the core takes it."""
        return self.to_joints if self.is_distance.any() or self.between_places.any() else None

    @cached_property
    def apart(self) -> tuple[Floats, ...]:
        """Numbers that tell readings at one pose apart (n,), those that this run holds."""
        ends = dict(zip(self.layout.to_joints, np.nan_to_num(self.to_joints.T), strict=False))
        known = {**self.covariates, **ends}
        own = [known[name] for name in self.layout.apart if name in known]
        if self.set_up is not None and len(numbers := np.unique(self.set_up, return_inverse=True)[1]):
            own.append(numbers.astype(float))
        return tuple(own)

    @property
    def set_up(self) -> NDArray[Any] | None:
        """The set-up (n,) of the instrument in which each row was read, by name; None where all are of one place."""
        return self.labels.get(c.SETUP)

    @property
    def last_set_up(self) -> str:
        """The set-up in which the instrument stood last."""
        return "" if self.set_up is None else str(self.set_up[int(np.argmax(self.order))])

    @cached_property
    def groups(self) -> Ints:
        """A number (n,) per row, equal for repeats of the same reading: of one target, at one pose.

        Where no pose is given, rows are repeats whose joint readings are equal to the last bit, and those of the other
        end of a distance: readings that were commanded come back exactly, those that were read never do.
        """
        if self.pose is not None:
            given = np.column_stack([self.pose, *self.apart])
            return np.unique(given, axis=0, return_inverse=True)[1].ravel().astype(np.int64)
        still = self.layout.by_time and self.time_s is not None and not (self.joints != self.joints[:1]).any()
        if still or not self.layout.joints_tell_pose:
            return np.arange(len(self), dtype=np.int64)
        # The joints alone make a pose, as its number does where one is given. The side from which it was approached,
        # a payload, the temperature may differ between repeats: they move the point by much less than another pose
        # does, and what they do is seen best where nothing else changed. As poses of their own, such rows would be
        # held out apart, and a pose's own error would count once for each of them as if it were new.
        ends = np.where(np.isnan(self.to_joints), np.inf, self.to_joints)
        return _numbered(np.column_stack([self.joints, ends, *self.apart]))

    @cached_property
    def series(self) -> Ints:
        """A number (n,) per row, equal where the same is read, at whatever pose: each target by itself."""
        return _numbered(np.column_stack([np.zeros(len(self)), *self.apart]))

    @cached_property
    def standing(self) -> Ints:
        """A number (n,) per row, equal where the machine stood at the same pose, whichever of its targets was read.

        What is wrong with the pose is wrong with all of them: as evidence they are one.
        """
        if not self.apart:
            return self.groups
        if self.pose is not None:
            return np.unique(self.pose, return_inverse=True)[1].ravel().astype(np.int64)
        ends = [k for k, name in enumerate(self.layout.to_joints) if name not in self.layout.apart]
        return _numbered(np.column_stack([self.joints, np.nan_to_num(self.to_joints[:, ends], nan=np.inf)]))

    @cached_property
    def repeatability(self) -> Repeatability | None:
        """Pure error from repeats of a pose, pooled over poses; None where no pose was read twice.

        Outliers that the user marked are left out. A pose's readings are compared with their own mean, so
        the figure is free of any model (Draper and Smith, *Applied Regression Analysis*, 1.5).
        """
        return pure_error(self.layout.readings, self.readings, self.used, self.groups)

    # -- leaving -----------------------------------------------------------------------------------------

    def to_frame(self) -> pl.DataFrame:
        """A polars frame with the file's column names; what was not taken is null."""
        columns: dict[str, Any] = {}
        layout = self.layout
        for name, values in ((c.TIME, self.time_s), (c.POSE, self.pose), (c.REPEAT, self.repeat)):
            if values is not None:
                columns[name] = values
        for k, name in enumerate(self.layout.joints):
            columns[name] = self.joints[:, k]
        blocks = (
            (layout.to_joints, self.to_joints),
            (layout.readings, np.where(self.taken, self.readings, np.nan)),
            (layout.sigmas, self.sigma),
            (layout.pose_sigmas, np.where(self.pose_sigma > 0, self.pose_sigma, np.nan)),
        )
        for names, block in blocks:
            for k, name in enumerate(names):
                if np.isfinite(block[:, k]).any():
                    columns[name] = block[:, k]
        # a selection of rows no longer shows how the joints came there
        columns |= {name: self.direction[:, k] for k, name in enumerate(layout.directions) if self._remembers(k)}
        if self.outlier.any():
            columns[c.OUTLIER] = self.outlier.astype(np.int64)
        if self.block is not None:
            columns["block"] = self.block
        frame = pl.DataFrame({**columns, **self.covariates, **self.labels})
        return frame.with_columns(pl.col(pl.Float64).fill_nan(None))

    @property
    def tells_sides(self) -> bool:
        """Whether it is told from which side each joint came last: not merely by the order of the rows."""
        return any(map(self._remembers, range(self.joints.shape[1])))

    def _remembers(self, joint: int) -> bool:
        """Whether the direction of a joint is known and does not follow from time and joints of these rows."""
        known = self.direction[:, joint]
        if not np.isfinite(known).all():
            return False
        values = {} if self.time_s is None else {c.TIME: self.time_s}
        return not np.array_equal(_directions(values, self.joints)[:, joint], known)

    def save(self, path: str | Path) -> None:
        """Writes CSV or Parquet, by the ending of the name."""
        write_table(self.to_frame(), path)


def _directions(values: Mapping[str, NDArray[Any]], joints: Floats) -> Floats:
    """Sign of the last motion of each joint: as the file says, else from the order in time, +1 at the start."""
    out = np.full(joints.shape, np.nan)
    if c.TIME in values:
        out = directions(joints, order_in_time(values[c.TIME], len(joints)), begins=1.0)
    for k in range(joints.shape[1]):
        if f"direction_{k + 1}" in values:
            out[:, k] = np.sign(np.asarray(values[f"direction_{k + 1}"], dtype=float))
    return out


def _numbered(rows: Floats) -> Ints:
    """A number (n,) for each row (n, k), as they come, the same for equal ones: without repeats, by row."""
    _, first, number = np.unique(rows + 0.0, axis=0, return_index=True, return_inverse=True)
    return np.argsort(np.argsort(first))[number.ravel()].astype(np.int64)
