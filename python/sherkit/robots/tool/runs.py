"""A recorded run of the tool: robot and gratings at their rate, the camera at its own, each with its time stamps."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from ...base.names import closest, listed
from ...base.types import Bools, Floats
from ...data.columns import TIME
from ...data.reader import checked
from ...data.tables import read_table, write_table
from ...errors import MeasurementError
from .plausible import check_clocks, check_depth, check_turn
from .tool import CAMERA, DEPTH, FIBRE_TIME, FIBRES, KNOWN, POSITION, TURN, rotation_of

# -- Columns of the tool's tables as numbers ------------------------------------------------------------------------


def table_at(path: Path) -> pl.DataFrame:
    """Rows of a file. Raises :class:`~sherkit.errors.MeasurementError`."""
    try:
        return read_table(checked(path))
    except pl.exceptions.PolarsError as error:
        raise MeasurementError(f"{path}: is not a table: {str(error).splitlines()[0]}") from None


def numbers_of(frame: pl.DataFrame, needed: Iterable[str], known: Iterable[str], source: str) -> dict[str, Floats]:
    """Columns (n,) of a frame by name, NaN where a cell is empty: all that are ``needed``, and those ``known`` that it
    has. Raises :class:`~sherkit.errors.MeasurementError` naming column and row, counted from 1."""
    known = tuple(known)
    for name in needed:
        if name not in frame.columns:
            near = closest(name, [c for c in frame.columns if c not in known])
            hint = f"; is '{near}' meant to be it?" if near else f"; it has {listed(frame.columns, 24)}"
            raise MeasurementError(f"{source}: column '{name}' is missing{hint}")
    columns: dict[str, Floats] = {}
    for name in (c for c in known if c in frame.columns):
        column = frame[name]
        try:
            columns[name] = column.cast(pl.Float64).to_numpy().astype(float)
        except pl.exceptions.PolarsError:
            bad = column.cast(pl.String).cast(pl.Float64, strict=False).is_null() & column.is_not_null()
            row = int(bad.arg_max() or 0)
            raise MeasurementError(
                f"{source}: row {row + 1}, column '{name}': '{column[row]}' is not a number"
            ) from None
    return columns


# --------------------------------------------------------------------------------------------------------------

_LEAST = 3


@dataclass(frozen=True, eq=False)
class ToolRun:
    """Rows of the robot: ``time_s`` (n,), pose of the unbent tip ``position_mm`` (n, 3) and ``turn_rad`` (n, 3, a
    rotation vector, tool to base; z along the shaft to the tip), ``wavelengths_nm`` (n, 9; NaN where none came).

    Rows of the camera, in its own frame and by its own clock: ``camera_time_s`` (m,), ``camera_mm`` (m, 3).
    ``depth_mm`` (n,) is the insertion depth from elsewhere, to judge by, NaN or None where unknown. ``fibre_time_s``
    (n,) is when the interrogator took the row's wavelengths, by the robot's clock; None where it does not say.
    """

    time_s: Floats
    position_mm: Floats
    turn_rad: Floats
    wavelengths_nm: Floats
    camera_time_s: Floats
    camera_mm: Floats
    depth_mm: Floats | None = None
    source: str = "run"
    fibre_time_s: Floats | None = None

    def __len__(self) -> int:
        return len(self.time_s)

    def __repr__(self) -> str:
        return f"ToolRun({self.source}: {len(self)} rows, {len(self.camera_time_s)} of the camera)"

    @cached_property
    def rotations(self) -> Floats:
        """Tool to base (n, 3, 3)."""
        return rotation_of(self.turn_rad)

    @cached_property
    def poses(self) -> Floats:
        """Poses (n, 12) as the core takes them: the rotation's rows, then the place of the unbent tip."""
        return np.ascontiguousarray(np.hstack([self.rotations.reshape(-1, 9), self.position_mm]))

    @cached_property
    def velocities_mm_s(self) -> Floats:
        """Velocity of the unbent tip (n, 3) since the row before, base frame; zero at the first."""
        step = np.diff(self.time_s)
        moved = np.diff(self.position_mm, axis=0) / np.where(step > 0, step, np.inf)[:, None]
        return np.vstack([np.zeros((1, 3)), moved])

    @cached_property
    def insertion_mm_s(self) -> Floats:
        """Velocity along the shaft (n,), positive into the eye (Eq. 8)."""
        return np.asarray(np.einsum("ni,ni->n", self.velocities_mm_s, self.rotations[:, :, 2]))

    @cached_property
    def fibre_times_s(self) -> Floats:
        """When the wavelengths of each row (n,) were taken: as stamped, or the row's own time."""
        if self.fibre_time_s is None:
            return self.time_s
        return np.where(np.isfinite(self.fibre_time_s), self.fibre_time_s, self.time_s)

    @cached_property
    def present(self) -> Bools:
        """Rows (n,) with all wavelengths of sections I and II, and no reading that an earlier row has already."""
        whole = np.isfinite(self.wavelengths_nm[:, :6]).all(axis=1)
        if self.fibre_time_s is None:
            return np.asarray(whole)
        before = np.maximum.accumulate(np.where(whole, self.fibre_times_s, -np.inf))
        return np.asarray(whole & (self.fibre_times_s > np.concatenate([[-np.inf], before[:-1]])))

    def without_fibres(self, rows: Bools) -> ToolRun:
        """The same run with these wavelengths lost."""
        waves = self.wavelengths_nm.copy()
        waves[rows] = np.nan
        return replace(self, wavelengths_nm=waves)

    def save(self, path: str | Path) -> None:
        """Writes CSV or Parquet that :func:`read_tool_run` reads: rows of the robot and of the camera by time."""
        robot = pl.DataFrame(
            {
                TIME: self.time_s,
                **dict(zip(POSITION, self.position_mm.T, strict=True)),
                **dict(zip(TURN, self.turn_rad.T, strict=True)),
                **dict(zip(FIBRES, self.wavelengths_nm.T, strict=True)),
                **({} if self.fibre_time_s is None else {FIBRE_TIME: self.fibre_time_s}),
                **({} if self.depth_mm is None else {DEPTH: self.depth_mm}),
            }
        )
        camera = pl.DataFrame({TIME: self.camera_time_s, **dict(zip(CAMERA, self.camera_mm.T, strict=True))})
        frame = pl.concat([robot, camera], how="diagonal").sort(TIME, maintain_order=True)
        write_table(frame.with_columns(pl.col(pl.Float64).fill_nan(None)), path)


def read_tool_run(path: str | Path) -> ToolRun:
    """Reads a run. A row may hold the robot (pose and wavelengths), the camera, or both.

    Raises :class:`~sherkit.errors.MeasurementError` naming file, column and row for what is missing, half there, not a
    number, or out of the order of time.
    """
    return tool_run_of(table_at(Path(path)), str(path))


def tool_run_of(frame: pl.DataFrame, source: str = "frame") -> ToolRun:
    """A run from a polars frame. Raises as :func:`read_tool_run`; rows are counted from 1."""
    columns = numbers_of(frame, (TIME, *POSITION, *TURN, *FIBRES), KNOWN, source)
    for name, values in columns.items():
        if name not in FIBRES:
            _refuse(np.isinf(values), f"{source}: row {{}}, column '{name}': expected a finite number, or nothing")
    time = columns[TIME]
    _refuse(~np.isfinite(time), f"{source}: row {{}}, column '{TIME}': expected a time, s")
    pose = np.column_stack([columns[n] for n in (*POSITION, *TURN)])
    there = np.isfinite(pose)
    _refuse(
        there.any(axis=1) & ~there.all(axis=1),
        f"{source}: row {{}}: a pose needs all of {listed((*POSITION, *TURN), 6)}",
    )
    robot = there.all(axis=1)
    camera_all = np.column_stack([columns.get(n, np.full(len(time), np.nan)) for n in CAMERA])
    seen = np.isfinite(camera_all)
    _refuse(
        seen.any(axis=1) & ~seen.all(axis=1),
        f"{source}: row {{}}: a place of the camera needs all of {listed(CAMERA, 3)}",
    )
    camera = seen.all(axis=1)
    waves = np.column_stack([columns[n] for n in FIBRES])
    _refuse(~robot & np.isfinite(waves).any(axis=1), f"{source}: row {{}}: wavelengths without the robot's pose")
    if int(robot.sum()) < _LEAST:
        raise MeasurementError(f"{source}: holds {int(robot.sum())} rows with a pose; expected {_LEAST} or more")
    for rows, who in ((robot, "the robot"), (camera, "the camera")):
        back = np.flatnonzero(np.diff(time[rows]) <= 0)
        if len(back):
            row = int(np.flatnonzero(rows)[back[0] + 1])
            raise MeasurementError(f"{source}: row {row + 1}: the time of {who} does not grow")
    stamps = columns.get(FIBRE_TIME)
    if stamps is not None:
        lacking = robot & np.isfinite(waves).any(axis=1) & ~np.isfinite(stamps)
        _refuse(lacking, f"{source}: row {{}}, column '{FIBRE_TIME}': expected when its wavelengths were taken, s")
    taken = None if stamps is None else np.where(np.isfinite(waves).any(axis=1), stamps, np.nan)[robot]
    check_clocks(time[robot], taken, source)
    check_turn(pose[robot, 3:], source)
    depth = columns.get(DEPTH)
    depth = None if depth is None or not np.isfinite(depth[robot]).any() else depth[robot]
    if depth is not None:
        check_depth(depth, source)
    return ToolRun(
        time_s=time[robot],
        position_mm=pose[robot, :3],
        turn_rad=pose[robot, 3:],
        wavelengths_nm=np.ascontiguousarray(waves[robot]),
        camera_time_s=time[camera],
        camera_mm=camera_all[camera],
        depth_mm=depth,
        source=source,
        fibre_time_s=None if stamps is None else stamps[robot],
    )


def _refuse(bad: Any, sentence: str) -> None:
    if bad.any():
        raise MeasurementError(sentence.format(int(np.argmax(bad)) + 1))


def require_camera(run: ToolRun) -> None:
    """Raises :class:`~sherkit.errors.MeasurementError` for a run that no camera saw."""
    if not len(run.camera_time_s):
        raise MeasurementError(f"{run.source}: holds no place of the camera ({listed(CAMERA, 3)})")


def summary(run: ToolRun) -> dict[str, Any]:
    """Sizes and rates, for people."""
    span = float(run.time_s[-1] - run.time_s[0])
    return {
        "rows": len(run),
        "seconds": span,
        "robot_hz": (len(run) - 1) / span if span > 0 else float("nan"),
        "pictures": len(run.camera_time_s),
        "without_fibres": int((~run.present).sum()),
    }
