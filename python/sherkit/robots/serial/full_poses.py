"""Full poses of what an arm holds, place and turn, as the places of three points of it."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import polars as pl
import scipy

from ...base.arguments import as_annotated
from ...base.names import listed
from ...base.types import Floats
from ...data import Measurements
from ...data.frames import clean
from ...data.reader import RunLike, run_of
from ...errors import MeasurementError, SherkitWarning
from .frames import Triple, of_rpy
from .robot import POSITION, TARGET, Serial

#: Columns that tell the turn, from the axes of what is held to those of the instrument: a rotation vector, or a
#: quaternion of length one.
VECTORS: Mapping[str, float] = {"rad": 1.0, "deg": np.pi / 180.0}
QUATERNION = ("qx", "qy", "qz", "qw")
#: A quaternion is of length one but for its digits.
_LENGTH = 1e-3


@as_annotated
def points_of_poses(arm: Serial, run: RunLike, lever_mm: float = 100.0) -> tuple[Serial, Measurements]:
    """The arm with three targets in the place of one, and a run of these in the place of full poses.

    Columns beside ``x_mm, y_mm, z_mm``: ``rx_rad, ry_rad, rz_rad``, or ``_deg``, a rotation vector; or ``qx, qy, qz,
    qw``. They turn the axes of the tool into those of the instrument. Target 1 is the place; 2 and 3 lie ``lever_mm``
    from it along x and y of the tool (``tool_rpy_deg``), so that a turn counts by what it moves there: the lever at
    which the instrument is as fine in turns as in places is the best one. What an instrument misreads of a place moves
    all three, which a diagnosis takes for one witness; deviations of parameters are up to 1.7 times too small where
    places alone tell them.

    Raises :class:`~sherkit.errors.MeasurementError` for columns that are none of these or not numbers, for a
    quaternion that is not of length one, and for an arm that carries other targets already.
    """
    data = run_of(run)
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
    turns, names = _turns(data)
    dropped = [name for name in data.to_frame().columns if "sigma_" in name]
    if dropped:
        warnings.warn(
            f"{data.source}: {listed(dropped)}: the noise of places alone, which is not that of points at a lever; it "
            "is left out, and repeats of poses tell the noise",
            SherkitWarning,
            stacklevel=2,
        )
    place = data.readings[:, : data.coordinates]
    points = np.stack([place, place + lever_mm * turns[:, :, 0], place + lever_mm * turns[:, :, 1]], axis=1)
    frame = data.to_frame().drop(*names, *dropped)
    frame = frame[np.repeat(np.arange(len(data)), 3)]
    columns = dict(zip(POSITION, points.reshape(-1, 3).T, strict=True)) | {TARGET: np.tile([1.0, 2.0, 3.0], len(data))}
    frame = frame.with_columns(**{name: pl.Series(values) for name, values in columns.items()})
    held = of_rpy(np.deg2rad(arm.tool_rpy_deg).tolist())
    more = tuple(_triple(np.array(arm.target_mm) + lever_mm * held[:, k]) for k in range(2))
    return (
        replace(arm, more_targets_mm=more),
        clean(frame, data.source, np.repeat(data.line, 3), data.counted),
    )


def _triple(point: Floats) -> Triple:
    return float(point[0]), float(point[1]), float(point[2])


def _turns(data: Measurements) -> tuple[Floats, tuple[str, ...]]:
    """Turns (n, 3, 3), and the columns that tell them."""
    turn = scipy.spatial.transform.Rotation
    for unit, scale in VECTORS.items():
        names = tuple(f"r{axis}_{unit}" for axis in "xyz")
        if numbers := _numbers(data, names):
            return turn.from_rotvec(scale * np.column_stack(numbers)).as_matrix(), names
    if numbers := _numbers(data, QUATERNION):
        q = np.column_stack(numbers)
        off = np.abs(np.linalg.norm(q, axis=1) - 1.0) > _LENGTH
        if off.any():
            raise MeasurementError(
                f"{data.place(off)}: {', '.join(QUATERNION)}: expected a quaternion of length one, found "
                f"{float(np.linalg.norm(q[off][0])):.4g}"
            )
        return turn.from_quat(q).as_matrix(), QUATERNION
    raise MeasurementError(
        f"{data.source}: no columns tell the turn of a pose; expected rx_rad, ry_rad, rz_rad or rx_deg, ry_deg, rz_deg "
        f"(a rotation vector) or {', '.join(QUATERNION)}; the file has {listed(tuple(data.to_frame().columns), 20)}"
    )


def _numbers(data: Measurements, names: tuple[str, ...]) -> list[Floats]:
    """These columns, or none where one is not there. Raises ``MeasurementError`` for one that holds something else."""
    known = {**data.covariates, **data.labels}
    if not set(names) <= set(known):
        return []
    for name in names:
        bad = ~np.isfinite(data.covariates[name]) if name in data.covariates else np.ones(len(data), dtype=bool)
        if bad.any():
            raise MeasurementError(f"{data.place(bad)}: {name}: expected a number")
    return [data.covariates[name] for name in names]
