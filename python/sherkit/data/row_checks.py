"""Rows that contradict themselves are refused when they are made; what looks wrong is said."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np

from ..base.types import Bools, Floats, Ints
from ..errors import MeasurementError, SherkitWarning
from . import columns as c

#: Joints of repeats differ by less than this part of what the joints of a run differ by.
_SAME_POSE = 0.05
#: So many of the poses, and no more, may hold a wild row.
_FEW_POSES = 0.1
#: So many rows say how far readings are spread, and where the unit is wrong.
_ENOUGH = 20_000
#: Joint and position readings whose spreads differ by more than this are in different units.
_UNIT_RATIO = 100.0
#: Columns of one unit are as large as one another, but for so much.
_AS_LARGE = 10.0


def check_rows(data: Any) -> None:
    """Refuses rows, as :class:`~.rows.Measurements` has them, that contradict themselves, and warns of units that look
    wrong. Raises ``MeasurementError``."""
    none: Bools = ~np.any(data.taken, axis=1)
    if none.any():
        raise MeasurementError(
            f"{data.place(none)}: no reading was taken; expected a number in at least one of "
            f"{', '.join(data.layout.readings)}"
        )
    if data.layout.distance is not None:
        _check_distances(data)
    if data.pose is not None and data.repeat is not None:
        keys = (data.repeat, *data.apart, data.pose)
        order = np.lexsort(keys)
        same = np.all([np.diff(key[order]) == 0 for key in keys], axis=0)
        if same.any():
            # rows given twice stand beside each other, the first of them before the others
            again = np.sort(order[1:][same])
            row = again[0]
            other = np.flatnonzero(np.all([key == key[row] for key in keys], axis=0))[0]
            raise MeasurementError(
                f"{data.place(again)}: pose {data.pose[row]} repeat {data.repeat[row]} was given before "
                f"({data.counted} {data.line[other]}); number repeats of a pose 1, 2, 3, …"
            )
    if data.pose is not None and data.layout.joints_tell_pose:
        _check_poses(data, data.pose)
    if data.layout.all_in_mm:
        _warn_of_units(data)


def _check_poses(data: Any, pose: Ints) -> None:
    """Rows of one pose number are repeats, and their spread is noise: they may not stand at places far apart.

    Refused where many do, since the noise would be another; said where few do, which may be wild rows.
    """
    rows = np.flatnonzero(~data.outlier)
    if not len(rows):
        return
    units = [c.unit_in(name) for name in data.layout.joints]
    ranges = np.ptp(data.joints[rows], axis=0)
    reach = np.array([max(r for r, u in zip(ranges, units, strict=True) if u == unit) for unit in units])
    in_order = len(rows) == len(pose) and bool((pose[1:] >= pose[:-1]).all())
    order = rows if in_order else rows[np.argsort(pose[rows], kind="stable")]
    sorted_pose = pose[order]
    starts = np.flatnonzero(np.diff(sorted_pose, prepend=sorted_pose[0] - 1))
    numbers = sorted_pose[starts]
    # how far apart on each joint, in what those of its unit reach
    apart = np.zeros((len(starts), len(units)))
    ends = not data.layout.from_fixed and bool(np.isfinite(data.to_joints).any())
    for end in (data.joints, data.to_joints) if ends else (data.joints,):
        for k, column in enumerate(end.T):
            # rows that are no distances have no other end: NaN says nothing here
            at = column if in_order else column[order]
            apart[:, k] = np.fmax(apart[:, k], np.fmax.reduceat(at, starts) - np.fmin.reduceat(at, starts))
    part = np.divide(apart, reach, out=np.zeros_like(apart), where=reach > 0)
    far = (part > _SAME_POSE).any(axis=1)
    if not far.any():
        return
    worst, joint = divmod(int(np.argmax(part)), len(units))
    more = f", and {int(far.sum()) - 1} more poses do so" if far.sum() > 1 else ""
    said = (
        f"{data.place(rows[pose[rows] == numbers[worst]])}: pose {numbers[worst]} stands at places "
        f"{apart[worst, joint]:.3g} {units[joint]} apart{more}; rows with the same pose number are "
        "taken as repeats, and their spread as noise: give each place its own number, or leave the column out"
    )
    if far.sum() > max(1, _FEW_POSES * len(numbers)) or len(numbers) == 1:
        raise MeasurementError(said)
    warnings.warn(said, SherkitWarning, stacklevel=2)


def _check_distances(data: Any) -> None:
    ends = np.isfinite(data.to_joints)
    if not (ends.any() or data.is_distance.any()):
        return
    needed = 1 if data.layout.from_fixed else ends.shape[1]
    half = ends.sum(axis=1) != np.where(data.is_distance, needed, 0)
    if half.any():
        of = "one, and only one," if data.layout.from_fixed else "all"
        raise MeasurementError(
            f"{data.place(half)}: a distance needs {data.layout.distance} and {of} of "
            f"{', '.join(data.layout.to_joints)}"
        )
    both = data.is_distance & data.taken[:, :-1].any(axis=1)
    if both.any():
        raise MeasurementError(
            f"{data.place(both)}: a row holds a position or a distance, not both; give each its own row"
        )


def _warn_of_units(data: Any) -> None:
    position = data.taken[:, : data.coordinates].all(axis=1) & ~data.outlier
    if position.sum() < 3:
        return
    # robust spreads: one wild row must not look like a wrong unit
    inputs, read = data.joints[position], data.readings[position, : data.coordinates]
    if not inputs.size or not read.size:
        return
    spread, moved = _spread(inputs), _spread(read)
    far = np.abs(np.median(inputs, axis=0)).max() + spread, np.abs(np.median(read, axis=0)).max() + moved
    # a ball bar on a circle hardly moves, and is as long as the joints go
    if spread <= 0 or moved <= 0 or max(far) < _AS_LARGE * min(far):
        return
    joints, positions = ", ".join(data.layout.joints), ", ".join(data.layout.coordinates)
    for ratio, small, large in (
        (spread / moved, positions, joints),
        (moved / spread, joints, positions),
    ):
        if ratio > _UNIT_RATIO:
            warnings.warn(
                f"{data.source}: columns {small} vary {ratio:.0f} times less than {large}; are they in metres, "
                "or the others in micrometres? Expected millimetres.",
                SherkitWarning,
                stacklevel=2,
            )


def _spread(values: Floats) -> float:
    low, high = np.percentile(values[:: 1 + len(values) // _ENOUGH], [5, 95], axis=0)
    return float((high - low).max(initial=0.0))
