"""Full poses of what an arm holds, place and turn, as the places of three points of it."""

from __future__ import annotations

import os
import re
import warnings
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import polars as pl

from ...base.arguments import validate_arguments
from ...base.figures import listed
from ...base.types import Floats, Ints
from ...data import Measurements
from ...data.called import header_unit
from ...data.frames import clean, to_polars
from ...data.reader import RunLike, checked, csv_blocks
from ...data.tables import PARQUET, read_parquet
from ...errors import MeasurementError, SherkitWarning
from ...fit.set_up_hypotheses import UNITS
from ...model.sensor_pose import registered
from .frames import QUATERNION, of_rpy, place_in_matrix, triple, turns_of
from .robot import POSITION, TARGET, Serial

#: Pairs of places that are compared, and by what part they may differ from the drawing's and be the same.
_PAIRS, _ALIKE = 2000, 1.3
#: What controllers call the readings of the joints, before the number of each.
_JOINTS = re.compile(r"(?:joint|axis|achse|j|a|q)[\s_]*([1-9])")


@validate_arguments
def points_of_poses(arm: Serial, run: RunLike, lever_mm: float = 100.0) -> tuple[Serial, Measurements]:
    """The arm with three targets in the place of one, and a run of these in the place of full poses.

    Columns beside ``x_mm, y_mm, z_mm``: ``rx_rad, ry_rad, rz_rad``, or ``_deg``, a rotation vector; ``qx, qy, qz, qw``;
    ``roll_deg, pitch_deg, yaw_deg``; those of a 4 × 4 matrix, ``t11`` to ``t34``; or as controllers write a pose, X, Y,
    Z with A, B, C (KUKA), W, P, R (FANUC) or q1 to q4 (ABB) and the joints J1 … or A1 …, mm and degrees. They turn the
    axes of the tool into those of the instrument; numbers that do so in another convention alone are read in that, and
    a :class:`~sherkit.errors.SherkitWarning` names it. Target 1 is the place; 2 and 3 lie ``lever_mm``
    from it along x and y of the tool (``tool_rpy_deg``), so that a turn counts by what it moves there: the lever at
    which the instrument is as fine in turns as in places is the best one. What an instrument misreads of a place moves
    all three, which a diagnosis takes for one witness; deviations of parameters are up to 1.7 times too small where
    places alone tell them.

    Raises :class:`~sherkit.errors.MeasurementError` for columns that are none of these or not numbers, for a
    quaternion that is not of length one, for places in another unit than their columns say, and for an arm that carries
    other targets already.
    """
    data = _read(arm, run)
    if data.layout != arm.layout:
        raise MeasurementError(f"{data.source}: is no run of this arm; its joints are {listed(arm.layout.joints)}")
    if arm.more_targets_mm or TARGET in data.covariates:
        raise MeasurementError(
            f"{data.source}: full poses take targets 2 and 3, and this arm has other targets already"
        )
    if not np.isfinite(lever_mm) or lever_mm <= 0:
        raise MeasurementError(f"lever_mm: expected a length above 0, got {lever_mm:g}")
    without = np.flatnonzero(~data.taken[:, : data.coordinates].all(axis=1))
    if len(without):
        raise MeasurementError(f"{data.place(without)}: a full pose needs {', '.join(POSITION)} as well as a turn")
    frame = data.to_frame()
    drawn = np.array([arm.tool_frame(q) for q in data.joints])
    place = data.readings[:, : data.coordinates]
    _require_mm(data, place, drawn[:, :3, 3])
    there = registered(drawn[:, :3, 3], place)
    stand = None if there is None else there.turn
    found = turns_of(partial(_numbers, data), frame.columns, drawn[:, :3, :3], data.source, stand)
    if found is None:
        raise MeasurementError(
            f"{data.source}: no columns tell the turn of a pose; expected rx_rad, ry_rad, rz_rad or rx_deg, ry_deg, "
            f"rz_deg, {', '.join(QUATERNION)}, a matrix t11 … t33, or A, B, C, W, P, R or q1 … q4 as controllers write "
            f"them; the file has {listed(frame.columns, 20)}"
        )
    turns, names = found.matrices, found.columns
    dropped = [name for name in frame.columns if "sigma_" in name]
    if dropped:
        warnings.warn(
            f"{data.source}: {listed(dropped)}: the noise of places alone, which is not that of points at a lever; it "
            "is left out, and repeats of poses tell the noise",
            SherkitWarning,
            stacklevel=2,
        )
    points = np.stack([place, place + lever_mm * turns[:, :, 0], place + lever_mm * turns[:, :, 1]], axis=1)
    frame = frame.drop(*names, *dropped)
    frame = frame[np.repeat(np.arange(len(data)), 3)]
    columns = dict(zip(POSITION, points.reshape(-1, 3).T, strict=True)) | {TARGET: np.tile([1.0, 2.0, 3.0], len(data))}
    frame = frame.with_columns(**{name: pl.Series(values) for name, values in columns.items()})
    held = of_rpy(np.deg2rad(arm.tool_rpy_deg))
    x, y = (np.array(arm.target_mm) + lever_mm * held[:, k] for k in range(2))
    with_three = replace(arm, more_targets_mm=(triple(x), triple(y)))
    return with_three, clean(frame, data.source, np.repeat(data.line, 3), data.counted)


def _require_mm(data: Measurements, place: Floats, drawn: Floats) -> None:
    """Refuses places (n, 3) that lie by another unit less far apart than those of the drawing: a lever of so many mm is
    added to them. Raises :class:`~sherkit.errors.MeasurementError`."""
    few = np.random.default_rng(0).integers(len(drawn), size=(2, _PAIRS))
    apart, wanted = (float(np.median(np.linalg.norm(one[few[0]] - one[few[1]], axis=1))) for one in (place, drawn))
    for unit, factor in UNITS["mm"]:
        if abs(np.log(max(wanted, 1e-9) / max(apart * factor, 1e-9))) < np.log(_ALIKE):
            raise MeasurementError(
                f"{data.source}: {', '.join(POSITION)} look like {unit}: places lie {apart:.3g} mm apart in the middle "
                f"where the joints of this arm say {wanted:.3g}; multiply by {factor:g}, or name the columns by their "
                "unit"
            )


def _read(arm: Serial, run: RunLike) -> Measurements:
    """The run, also where joints and place have the names of a controller."""
    if isinstance(run, Measurements):
        return run
    if isinstance(run, str | os.PathLike):
        source, frame, line = cells_of(run)
        counted = "row" if line is None else "line"
    else:
        frame, line, source, counted = to_polars(run), None, "frame", "row"
    columns = meant(arm, frame.columns)
    named = {theirs: f"{theirs} [{unit}]" for theirs, unit in columns.values() if unit}
    mapping = {ours: named.get(theirs, theirs) for ours, (theirs, _) in columns.items()}
    return clean(frame.rename(named), source, line, counted, mapping, (arm.layout,))


def cells_of(path: str | os.PathLike[str]) -> tuple[str, pl.DataFrame, Ints | None]:
    """A table as it stands in its file: the file, its columns, and the line of each row, None of a Parquet file."""
    file = checked(Path(path))
    return str(file), *((read_parquet(file), None) if file.suffix.lower() in PARQUET else next(csv_blocks(file)))


def meant(arm: Serial, names: Sequence[str]) -> dict[str, tuple[str, str]]:
    """Columns of joints and place by ours, where they have other names: each with the unit that it is taken to be in,
    empty where it names one itself."""
    out: dict[str, tuple[str, str]] = {}
    if not any(name in names for name in arm.layout.joints):
        numbered = {int(at[1]): n for n in names if (at := _JOINTS.fullmatch(header_unit(n)[0].lower().strip()))}
        if len(numbered) >= len(arm.joints) and min(numbered) == 1:
            for k, (ours, joint) in enumerate(zip(arm.layout.joints, arm.joints, strict=True), start=1):
                if k in numbered:
                    out[ours] = numbered[k], "" if header_unit(numbered[k])[1] else "mm" if joint.slides else "deg"
    stems = {header_unit(n)[0].lower().strip(): n for n in names}
    place = [stems.get(axis) or stems.get(f"t{axis}") or stems.get(f"p{axis}") or "" for axis in "xyz"]
    if not all(place):
        place = list(place_in_matrix(names))
    for ours, theirs in zip(POSITION, place, strict=False):
        if ours not in names and theirs:
            out[ours] = theirs, "" if header_unit(theirs)[1] else "mm"
    taken = [theirs for theirs, unit in out.values() if unit]
    if taken:
        warnings.warn(
            f"{listed(taken, 9)}: no unit is written there; lengths are read as mm, angles as degrees",
            SherkitWarning,
            stacklevel=2,
        )
    return out


def _numbers(data: Measurements, names: Sequence[str]) -> Floats:
    """These columns (n, ·). Raises ``MeasurementError`` for one that holds something else."""
    for name in names:
        bad = ~np.isfinite(data.covariates[name]) if name in data.covariates else np.ones(len(data), dtype=bool)
        if bad.any():
            raise MeasurementError(f"{data.place(bad)}: {name}: expected a number")
    return np.column_stack([data.covariates[name] for name in names])
