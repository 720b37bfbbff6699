"""Rows of any machine, from NumPy arrays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base.figures import listed
from ..base.types import Bools, Floats, Ints
from ..errors import NotFinite, ShapeError
from .columns import Layout
from .in_time import begin_of, order_in_time
from .rows import Measurements


def from_arrays(
    *,
    place: Mapping[str, Floats],
    readings: Floats,
    names: Sequence[str],
    unit: str,
    covariates: Mapping[str, Floats] | None = None,
    time_s: Floats | None = None,
    pose: Ints | None = None,
    block: Ints | None = None,
    sigma: Floats | None = None,
    outlier: Bools | None = None,
    line: Ints | None = None,
    source: str = "readings",
) -> Measurements:
    """Rows of readings of any machine, whose model is fitted and diagnosed as a robot's is.

    ``place`` maps names to values (n,) that say where the machine was: its inputs, or the direction it looked in.
    ``readings`` (n, m) are all in ``unit``, NaN where one was not taken; ``names`` names their columns. ``covariates``
    are further columns (n,); ``time_s`` (n,); ``pose`` (n,) is equal for repeats; ``sigma`` (n, m) is the noise, in
    ``unit``, where it is known; ``outlier`` (n,) marks rows that are kept and listed but not fitted; ``line`` (n,)
    is the number of the row in its file. ``block`` (n,) says which rows are held out together in validation; left
    out, neighbours in ``place`` are.

    Raises :class:`~sherkit.errors.ShapeError` or :class:`~sherkit.errors.NotFinite` naming the column.
    """
    if readings.ndim != 2 or readings.shape[1] != len(names) or not len(readings):
        raise ShapeError(f"{source}: readings: expected (n, {len(names)}) for {listed(names)}, got {readings.shape}")
    taken = np.isfinite(readings)
    for name, column in zip(names, taken.T, strict=True):
        if not column.any():
            raise NotFinite(f"{source}: readings: no number in '{name}'; leave the column out")
    n = len(readings)
    marked = np.zeros(n, dtype=bool) if outlier is None else outlier
    numbers = np.arange(n, dtype=np.int64) if line is None else line
    others: dict[str, NDArray[Any] | None] = {**place, **(covariates or {})}
    others |= {"time_s": time_s, "pose": pose, "block": block, "outlier": marked, "line": numbers}
    for name, other in others.items():
        if other is None:
            continue
        if other.shape != (n,):
            raise ShapeError(f"{source}: column '{name}': expected {n} rows, got {other.shape}")
        if not np.isfinite(other).all():
            row = int(numbers[np.argmin(np.isfinite(other))])
            raise NotFinite(f"{source}: row {row}: column '{name}' is not a finite number")
    if sigma is not None and (sigma.shape != readings.shape or not (sigma > 0).all()):
        raise ShapeError(f"{source}: sigma: expected positive numbers of shape {readings.shape}")
    inputs = np.column_stack([np.asarray(v, dtype=float) for v in place.values()]) if place else np.zeros((n, 0))
    return Measurements(
        joints=inputs,
        to_joints=np.full(inputs.shape, np.nan),
        readings=np.where(taken, readings, 0.0),
        taken=taken,
        sigma=np.full(readings.shape, np.nan) if sigma is None else sigma,
        pose_sigma=np.zeros(readings.shape),
        time_s=time_s,
        pose=pose,
        repeat=None,
        outlier=marked,
        covariates=dict(covariates or {}),
        labels={},
        source=source,
        line=numbers,
        counted="row",
        # the side from which an input came to its value is not known of a machine that is not
        direction=np.full(inputs.shape, np.nan),
        order=order_in_time(time_s, n) if line is None else numbers,
        # a place need not be all that the machine was told: which rows are repeats, the caller says
        layout=Layout(tuple(place), tuple(names), unit, 1.0, joints_tell_pose=False),
        block=block,
        begins_s=begin_of(time_s),
    )
