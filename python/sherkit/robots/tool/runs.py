"""A recorded run of the tool: robot and gratings at their rate, the camera at its own, each with its time stamps; and
what its numbers cannot be.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from ...base import linalg
from ...base.figures import listed
from ...base.types import Bools, Floats
from ...data.called import Columns
from ...data.columns import TIME
from ...data.tables import write_table
from ...errors import FitError, MeasurementError, SherkitWarning
from .frozen import Frozen, frozen_pose, frozen_stretches, repeats, rows_of, sentences
from .leaps import Leaps, leaps_of
from .tables import NO_NAMES, numbers_of, table_at
from .tool import CAMERA, DEPTH, FIBRE_TIME, FIBRES, KNOWN, POSITION, TURN, rotation_of

# -- What numbers cannot be: other units, another clock, another tool, a camera that saw something else -----------

_UNITS = {"pm": 1e3, "um": 1e-3, "m": 1e-9}
#: No load moves a grating further than this, nm.
OUT_OF_REACH_NM = 8.0
#: Rows of a robot are no further apart, and readings no further from their rows, s.
_SLOWEST_S, _STRANGE_CLOCK_S = 0.5, 1.0
#: Rows of one run are no further apart, s.
_LONGEST_S = 3600.0
#: Rows are missing where none came for so long, s, and for so many usual steps.
_GAP_S, _GAP_STEPS = 0.5, 20.0
_LONGEST_TURN_RAD = 2.0 * np.pi + 0.1
#: A depth that never exceeds this is none, or in another unit, mm.
_LEAST_DEPTH_MM = 0.1
#: From here on two clouds have one shape, or nothing in common; and how unlike in size they may be.
_SAME, _UNLIKE, _SCALE = 0.8, 0.9, 30.0
#: A reflection takes this much of what a turn leaves, where the motion has three directions.
_MIRRORED = 0.02
#: A camera further off than a tool is long was never registered, mm.
ELSEWHERE_MM = 60.0


def check_unit(wavelengths_nm: Floats, reference_nm: tuple[float, ...], source: str) -> None:
    """Raises :class:`~sherkit.errors.MeasurementError` for wavelengths (n, 9) that are not in nm, or are shifts."""
    known = wavelengths_nm[np.isfinite(wavelengths_nm)]
    if not len(known):
        return
    ratio, there = float(np.median(known)) / float(np.mean(reference_nm)), float(np.mean(reference_nm))
    for unit, factor in _UNITS.items():
        if 0.5 < ratio / factor < 2.0:
            raise MeasurementError(
                f"{source}: the wavelengths of {FIBRES[0]} and the others seem to be in {unit}; expected nm, near "
                f"{there:.0f}"
            )
    if not 0.3 < ratio < 3.0:
        raise MeasurementError(
            f"{source}: {FIBRES[0]} and the others hold numbers around {np.median(known):.3g}; expected wavelengths in "
            f"nm, near {there:.0f}, and not their shifts"
        )


def check_wavelengths(wavelengths_nm: Floats, reference_nm: tuple[float, ...], source: str) -> None:
    """As :func:`check_unit`, and for wavelengths of another tool than the one with these references (9,)."""
    check_unit(wavelengths_nm, reference_nm, source)
    shift = np.abs(wavelengths_nm - reference_nm)
    off = float(np.median(shift[np.isfinite(shift)])) if np.isfinite(shift).any() else 0.0
    if off > OUT_OF_REACH_NM:
        raise MeasurementError(
            f"{source}: the wavelengths lie {off:.3g} nm from reference_nm of the tool file, which no force does: is "
            "it the file of this tool?"
        )


def check_clocks(time_s: Floats, later_s: Floats | None, source: str) -> None:
    """Raises :class:`~sherkit.errors.MeasurementError` for rows (n,) of a robot that are too far apart, and for
    readings that are stamped so much ``later_s`` (k,) than their rows, by another clock."""
    step = float(np.median(np.diff(time_s)))
    if step > _SLOWEST_S:
        raise MeasurementError(
            f"{source}: rows of the robot are {step:g} s apart; expected {_SLOWEST_S:g} s or less: is time_s in "
            "another unit?"
        )
    if (leap := float(np.diff(time_s).max())) >= _LONGEST_S:
        at = int(np.argmax(np.diff(time_s)))
        raise MeasurementError(
            f"{source}: time_s leaps by {leap:.3g} s behind {time_s[at]:.9g} s: is it that of another clock from there "
            "on? Rows before and behind are runs of their own"
        )
    apart = float(np.median(np.abs(later_s))) if later_s is not None and len(later_s) else 0.0
    if apart > _STRANGE_CLOCK_S:
        raise MeasurementError(
            f"{source}: {FIBRE_TIME} lies {apart:.3g} s from time_s; expected seconds by the robot's clock"
        )


def check_turn(turn_rad: Floats, source: str) -> None:
    """Raises :class:`~sherkit.errors.MeasurementError` for rotation vectors (n, 3) of more than a turn."""
    most = float(np.linalg.norm(turn_rad, axis=1).max())
    if most > _LONGEST_TURN_RAD:
        raise MeasurementError(
            f"{source}: {TURN[0]} and the others make a turn of {most:.3g} rad; expected a rotation vector in rad: are "
            "they degrees?"
        )


def check_depth(depth_mm: Floats, source: str) -> None:
    """Warns of known depths (n,) that are in another unit."""
    most = float(np.nanmax(np.abs(depth_mm)))
    if 0.0 < most < _LEAST_DEPTH_MM:
        warnings.warn(f"{source}: {DEPTH} never exceeds {most:.2g} mm: is it in m?", SherkitWarning, stacklevel=3)


@dataclass(frozen=True)
class Likeness:
    """How alike two clouds are in shape: ``rigid`` is 1 for a turn and a scale, ``mirrored`` for one with a reflection;
    ``scale`` is the second's size over the first's."""

    scale: float
    rigid: float
    mirrored: float

    @property
    def best(self) -> float:
        """With or without a reflection."""
        return max(self.rigid, self.mirrored)

    @property
    def other_units(self) -> str:
        """What is wrong where the first is a robot's and the second a camera's in other units, or nothing."""
        if 1.0 / _SCALE < self.scale < _SCALE:
            return ""
        return (
            f"the camera's places span {self.scale:.3g} times those of the robot; expected both in mm ({CAMERA[0]}, "
            f"{POSITION[0]})"
        )


def likeness(first_mm: Floats, second_mm: Floats) -> Likeness:
    """Of points (n, 3) to points (n, 3) (Umeyama, IEEE PAMI 1991)."""
    a, b = (p - p.mean(axis=0) for p in (first_mm, second_mm))
    u, s, v = linalg.svd(a.T @ b)
    size_a, size_b = float((a**2).sum()), float((b**2).sum())
    if size_a == 0.0 or size_b == 0.0:
        return Likeness(1.0, 0.0, 0.0)
    last = s[2] * np.sign(np.linalg.det(u) * np.linalg.det(v))
    both = np.sqrt(size_a * size_b)
    one, other = float(s[0] + s[1] + last) / both, float(s[0] + s[1] - last) / both
    return Likeness(float(np.sqrt(size_b / size_a)), one, other)


def check_shapes(robot_mm: Floats, camera_mm: Floats, source: str) -> None:
    """Raises :class:`~sherkit.errors.FitError` for a free motion (n, 3) that a camera saw (n, 3) otherwise than moved
    and turned: in another unit, mirrored, or not at all."""
    alike = likeness(robot_mm, camera_mm)
    if alike.best < _UNLIKE:
        raise FitError(
            f"{source}: the camera's places do not follow the robot's (likeness {alike.best:.2f}, where 1 is the same "
            "motion): did the camera see the tip of the free tool, in the same seconds?"
        )
    if wrong := alike.other_units:
        raise FitError(f"{source}: {wrong}")
    if alike.mirrored > _SAME and alike.mirrored - alike.rigid > _MIRRORED:
        raise FitError(
            f"{source}: the camera sees the motion mirrored: one of {', '.join(CAMERA)} is turned round, or two of "
            "them are swapped"
        )


def check_camera(robot_mm: Floats, seen_mm: Floats, source: str) -> None:
    """Of a run: places (n, 3) of the unbent tip, and of the tip as a registered camera saw it in the base. Raises
    :class:`~sherkit.errors.MeasurementError` for other units, and warns of a camera that stands elsewhere."""
    alike = likeness(robot_mm, seen_mm)
    if alike.rigid > _SAME and (wrong := alike.other_units):
        raise MeasurementError(f"{source}: {wrong}")
    off = float(np.median(np.linalg.norm(seen_mm - robot_mm, axis=1)))
    if off > ELSEWHERE_MM:
        warnings.warn(
            f"{source}: the camera sees the tip {off:.0f} mm from where the robot has it: is [camera] of the tool file "
            "that of this camera? sherkit register finds it from a free motion",
            SherkitWarning, stacklevel=3,
        )  # fmt: skip


# -- The run ---------------------------------------------------------------------------------------------------------

_LEAST = 3


@dataclass(frozen=True, eq=False)
class ToolRun:
    """Rows of the robot: ``time_s`` (n,), pose of the unbent tip ``position_mm`` (n, 3) and ``turn_rad`` (n, 3, a
    rotation vector, tool to base; z along the shaft to the tip), ``wavelengths_nm`` (n, 9; NaN where none came).

    Rows of the camera, in its own frame and by its own clock: ``camera_time_s`` (m,), ``camera_mm`` (m, 3).
    ``depth_mm`` (n,) is the insertion depth from elsewhere, zero before the hole, to judge by, NaN or None where
    unknown. ``fibre_time_s`` (n,) is when the interrogator took the row's wavelengths, by the robot's clock; None where
    it does not say.
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
    def step_s(self) -> float:
        """From row to row, as it usually is."""
        return float(np.median(np.diff(self.time_s)))

    @cached_property
    def rotations(self) -> Floats:
        """Tool to base (n, 3, 3)."""
        return rotation_of(self.turn_rad)

    @cached_property
    def poses(self) -> Floats:
        """Poses (n, 12) as the core takes them: the rotation's rows, then the place of the unbent tip."""
        return np.ascontiguousarray(np.hstack([self.rotations.reshape(-1, 9), self.position_mm]))

    @cached_property
    def insertion_mm_s(self) -> Floats:
        """Velocity along the shaft since the row before (n,), positive into the eye (Eq. 8); zero at the first."""
        step = np.diff(self.time_s)
        moved = np.diff(self.position_mm, axis=0) / np.where(step > 0, step, np.inf)[:, None]
        return np.append(0.0, np.einsum("ni,ni->n", moved, self.rotations[1:, :, 2]))

    @cached_property
    def fibre_times_s(self) -> Floats:
        """When the wavelengths of each row (n,) were taken: as stamped, or the row's own time."""
        if self.fibre_time_s is None:
            return self.time_s
        return np.where(np.isfinite(self.fibre_time_s), self.fibre_time_s, self.time_s)

    @cached_property
    def present(self) -> Bools:
        """Rows (n,) with all wavelengths of sections I and II that are :meth:`new_readings`."""
        return self.new_readings(np.asarray(np.isfinite(self.believed_nm[:, :6]).all(axis=1)))

    @cached_property
    def leaps(self) -> Leaps:
        """Single readings that are off, and gratings that jump for good."""
        read = np.asarray(np.isfinite(self.wavelengths_nm).any(axis=1)) & ~self.again
        return leaps_of(self.time_s, self.wavelengths_nm, self.new_readings(read))

    @cached_property
    def believed_nm(self) -> Floats:
        """Wavelengths (n, 9), NaN where they froze or leap off for once."""
        return np.where(self.lost_fibres[:, None] | self.leaps.single, np.nan, self.wavelengths_nm)

    def new_readings(self, read: Bools) -> Bools:
        """Those of the rows ``read`` (n,) that hold no reading which an earlier one has already, where the robot's pose
        is known."""
        read = read & ~self.lost_fibres & ~self.lost_pose
        if self.fibre_time_s is None:
            return read
        before = np.maximum.accumulate(np.where(read, self.fibre_times_s, -np.inf))
        return np.asarray(read & (self.fibre_times_s > np.concatenate([[-np.inf], before[:-1]])))

    @cached_property
    def again(self) -> Bools:
        """Rows (n,) that hold the reading of the row before, to the last digit."""
        return repeats(self.wavelengths_nm)

    @cached_property
    def frozen_fibres(self) -> list[Frozen]:
        """Stretches in which one reading came again and again."""
        return frozen_stretches(self.time_s, self.again)

    @cached_property
    def frozen_pose(self) -> list[Frozen]:
        """Stretches in which the robot's pose stood while the tool moved."""
        waves = np.where(self.again[:, None], np.nan, self.wavelengths_nm)
        return frozen_pose(self.time_s, self.position_mm, self.turn_rad, waves)

    @cached_property
    def lost_fibres(self) -> Bools:
        """Rows (n,) that hold a reading of long ago."""
        return rows_of(self.frozen_fibres, len(self))

    @cached_property
    def lost_pose(self) -> Bools:
        """Rows (n,) of which nobody knows where the robot was."""
        return rows_of(self.frozen_pose, len(self))

    @cached_property
    def gaps(self) -> list[tuple[float, float]]:
        """Spans, s, in which no row of the robot came though some should have."""
        step = np.diff(self.time_s)
        after = np.flatnonzero(step > max(_GAP_S, _GAP_STEPS * self.step_s))
        return [(float(self.time_s[k]), float(self.time_s[k + 1])) for k in after]

    @property
    def froze(self) -> list[str]:
        """A sentence on each stream that stood still while the others went on."""
        return sentences(self.frozen_fibres, self.frozen_pose)

    def further_on(self, by_mm: float) -> ToolRun:
        """With places so much further on along the shaft, towards the tip."""
        return replace(self, position_mm=self.position_mm + by_mm * self.rotations[:, :, 2])

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


def read_tool_run(path: str | Path, columns: Columns = NO_NAMES) -> ToolRun:
    """Reads a run. A row may hold the robot (pose and wavelengths), the camera, or both; ``columns`` are names of the
    file by ours, as a tool has them from ``[columns]`` of its file.

    Raises :class:`~sherkit.errors.MeasurementError` naming file, column and row for what is missing, half there, not a
    number, or out of the order of time.
    """
    return tool_run_of(table_at(Path(path), columns), str(path))


def tool_run_of(frame: pl.DataFrame, source: str = "frame") -> ToolRun:
    """A run from a polars frame. Raises as :func:`read_tool_run`; rows are counted from 1."""
    columns = numbers_of(frame, (TIME, *POSITION, *TURN, *FIBRES), KNOWN, source)
    for name, values in columns.items():
        if name not in FIBRES:
            _refuse(np.isinf(values), f"{source}: row {{}}, column '{name}': expected a finite number, or nothing")
    time = columns[TIME]
    _refuse(~np.isfinite(time), f"{source}: row {{}}, column '{TIME}': expected a time, s")

    def together(names: tuple[str, ...], what: str) -> tuple[Floats, Bools]:
        values = np.column_stack([columns.get(n, np.full(len(time), np.nan)) for n in names])
        there = np.isfinite(values)
        half = there.any(axis=1) & ~there.all(axis=1)
        _refuse(half, f"{source}: row {{}}: {what} needs all of {listed(names)}")
        return values, there.all(axis=1)

    pose, robot = together((*POSITION, *TURN), "a pose")
    places, camera = together(CAMERA, "a place of the camera")
    waves = np.column_stack([columns[n] for n in FIBRES])
    read = np.asarray(np.isfinite(waves).any(axis=1))
    _refuse(~robot & read, f"{source}: row {{}}: wavelengths without the robot's pose")
    if int(robot.sum()) < _LEAST:
        raise MeasurementError(f"{source}: holds {int(robot.sum())} rows with a pose; expected {_LEAST} or more")
    for rows, who in ((robot, "the robot"), (camera, "the camera")):
        back = np.flatnonzero(np.diff(time[rows]) <= 0)
        if len(back):
            row = int(np.flatnonzero(rows)[back[0] + 1])
            raise MeasurementError(f"{source}: row {row + 1}: the time of {who} does not grow")
    stamps = columns.get(FIBRE_TIME)
    if stamps is not None:
        lacking = robot & read & ~np.isfinite(stamps)
        _refuse(lacking, f"{source}: row {{}}, column '{FIBRE_TIME}': expected when its wavelengths were taken, s")
        stamps = stamps[robot]
    check_clocks(time[robot], None if stamps is None else stamps[read[robot]] - time[robot & read], source)
    check_turn(pose[robot, 3:], source)
    depth = columns.get(DEPTH)
    depth = None if depth is None or not np.isfinite(depth[robot]).any() else depth[robot]
    if depth is not None:
        check_depth(depth, source)
        # before the hole there is no depth: the filter says zero of it
        depth = depth.clip(0.0)
    return ToolRun(
        time_s=time[robot],
        position_mm=pose[robot, :3],
        turn_rad=pose[robot, 3:],
        wavelengths_nm=np.ascontiguousarray(waves[robot]),
        camera_time_s=time[camera],
        camera_mm=places[camera],
        depth_mm=depth,
        source=source,
        fibre_time_s=stamps,
    )


def _refuse(bad: Any, sentence: str) -> None:
    if bad.any():
        raise MeasurementError(sentence.format(int(np.argmax(bad)) + 1))


def warn_frozen(run: ToolRun) -> None:
    """Warns of streams that stood still while the others went on."""
    for sentence in run.froze:
        warnings.warn(f"{run.source}: {sentence[0].lower()}{sentence[1:]}", SherkitWarning, stacklevel=3)


def read_free_motion(path: str | Path, columns: Columns = NO_NAMES) -> ToolRun:
    """A run in which the free tool was led around before its camera, as :func:`read_tool_run`. Raises as
    :func:`require_camera`, and warns of streams that froze."""
    run = read_tool_run(path, columns)
    require_camera(run)
    warn_frozen(run)
    return run


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
        "robot_hz": 1.0 / run.step_s if span > 0 else float("nan"),
        "pictures": len(run.camera_time_s),
        "without_fibres": int((~run.present).sum()),
    }
