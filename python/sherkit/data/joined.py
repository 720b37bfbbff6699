"""Two runs of one machine as one."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import polars as pl

from ..base.names import listed
from ..base.types import Ints
from ..errors import MeasurementError, SherkitWarning
from .columns import OUTLIER, POSE, REPEAT, Layout
from .frames import from_frame
from .rows import Measurements


def joined(first: Measurements, second: Measurements) -> Measurements:
    """Both runs as one, the second after the first. Poses of the second get numbers of their own.

    A second run whose clock began anew is taken to have been measured later: its time goes on where the first ends, as
    if no time lay between. Warns of that, and of columns that are left out because only one run has them. Raises
    :class:`~sherkit.errors.MeasurementError` where such a run is one that the first has already.
    """
    if first.time_s is not None and second.time_s is not None and second.time_s.min() <= first.time_s.max():
        if _within(first, second):
            raise MeasurementError(f"{second.source}: its {len(second)} rows are in {first.source} already")
        begins, ended = float(second.time_s.min()), float(first.time_s.max())
        pause = float(np.median(np.diff(np.sort(first.time_s)))) if len(first) > 1 else 1.0
        goes_on = ended + max(pause, 1e-3)
        second = replace(second, time_s=second.time_s - begins + goes_on)
        warnings.warn(
            f"{second.source}: its time starts at {begins:g} s, before {first.source} ends ({ended:g} s), so it is "
            f"taken to have been measured later and goes on at {goes_on:g} s; how long the pause "
            "really was is not known, and drift over it is not either",
            SherkitWarning,
            stacklevel=4,
        )
    a, b = first.to_frame(), second.to_frame()
    if first.pose is not None or second.pose is None:
        # poses of the second run are others, whatever their numbers: between two runs more may have changed
        before, after = _numbered(first), _numbered(second)
        a = a.with_columns(pl.Series(POSE, before))
        b = b.with_columns(pl.Series(POSE, after + before.max()))
        if REPEAT in a.columns and REPEAT not in b.columns:
            b = b.with_columns(pl.int_range(1, pl.len() + 1, dtype=pl.Int64).over(POSE).alias(REPEAT))
    a, b = _complete(a, b.columns, first.layout), _complete(b, a.columns, first.layout)
    common = [c for c in a.columns if c in b.columns]
    lost = [c for c in (*a.columns, *b.columns) if c not in common and not c.startswith("direction_")]
    if lost:
        warnings.warn(
            f"{first.source} and {second.source}: column {listed(lost)} is left out, since only one run has it",
            SherkitWarning,
            stacklevel=4,
        )
    both = pl.concat([a.select(common), b.select(common)], how="vertical_relaxed")
    # directions are those of each run by itself
    for k in range(first.direction.shape[1]):
        direction = np.concatenate([first.direction[:, k], second.direction[:, k]])
        if np.isfinite(direction).all():
            both = both.with_columns(pl.Series(f"direction_{k + 1}", direction))
    return from_frame(both, first.source)


def _within(first: Measurements, second: Measurements) -> bool:
    """Whether the rows of ``second`` stand one after another in ``first``, whatever the clock says."""
    if second.joints.shape[1] != first.joints.shape[1] or second.readings.shape[1] != first.readings.shape[1]:
        return False
    a, b = (np.nan_to_num(np.hstack([run.joints, run.readings]), nan=np.inf) for run in (first, second))
    starts = np.flatnonzero((a[: max(len(a) - len(b) + 1, 0)] == b[0]).all(axis=1))
    return any(np.array_equal(a[k : k + len(b)], b) for k in starts)


def _numbered(run: Measurements) -> Ints:
    """Pose numbers (n,) as they are given, else by repeats of the joint readings, from 1."""
    return run.groups + 1 if run.pose is None else run.pose


def _complete(frame: pl.DataFrame, wanted: Sequence[str], layout: Layout) -> pl.DataFrame:
    """A run with the columns of another whose absence says something: nothing marked, not declared, not taken."""
    for name in wanted:
        if name in frame.columns:
            continue
        if name == OUTLIER:
            frame = frame.with_columns(pl.lit(0, dtype=pl.Int64).alias(name))
        elif name in layout.may_be_empty:
            frame = frame.with_columns(pl.lit(None, dtype=pl.Float64).alias(name))
    return frame
