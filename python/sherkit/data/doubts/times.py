"""Times that no clock showed: in another unit, or written anew over rows that were sorted."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ...base.types import Ints
from .. import columns as c
from ..columns import TIME
from ..rows import Measurements
from .doubt import FEWEST, Doubt

#: Few runs are as slow as this for each reading and as long as this on the whole, s.
_SLOW_S = 300.0
_LONG_S = 86_400.0
_FEWEST = 5
#: Steps of time that differ by less than this part of them are all equal.
_EVEN = 1e-6
#: So many steps of a reading are smaller than its noise where a column was sorted by it, and the chance that all of
#: them point one way by themselves is none.
_SMALL_STEPS = 20


def time_in_milliseconds(data: Measurements) -> Iterator[Doubt]:
    """Times that would make a run of a few minutes last for days."""
    if data.time_s is None or len(data) < _FEWEST:
        return
    gaps = np.diff(np.sort(data.time_s))
    velocities = [v for v in (data.covariates.get(name) for name in data.layout.velocities) if v is not None]
    usual = float(np.median(gaps))
    if len(velocities) == data.joints.shape[1]:
        # joints tell how fast time runs, where their speeds are known
        order = np.argsort(data.time_s, kind="stable")
        way = np.abs(np.diff(data.joints[order], axis=0)).sum()
        by_speed = (np.abs(np.column_stack(velocities)[order][1:]) * gaps[:, None]).sum()
        if by_speed > 0 and 500.0 < by_speed / max(float(way), 1e-300) < 2000.0:
            yield Doubt(
                f"{TIME} looks like milliseconds (ms): at the speeds of the run its joints would have moved "
                f"{by_speed / way:.0f} times as far as they did; divide {TIME} by 1000"
            )
        return
    if usual < _SLOW_S or np.ptp(data.time_s) < _LONG_S:
        return
    hours = float(np.ptp(data.time_s)) / 3600.0
    yield Doubt(
        f"{TIME} looks like milliseconds (ms): {len(data)} readings would have taken {hours:.0f} hours, "
        f"{usual / 60:.0f} minutes each, instead of {usual / 1000:.1f} s; divide {TIME} by 1000"
    )


def order_lost(data: Measurements) -> Iterator[Doubt]:
    """Times that rise at even steps over rows that were sorted: by a reading, down to its noise, or by the pose's
    number with all repeats side by side. When what was read first is lost with them, and so are directions."""
    if data.time_s is None or len(data) < max(FEWEST, _SMALL_STEPS):
        return
    order = np.flatnonzero(~data.outlier)
    steps = np.diff(data.time_s[order])
    usual = float(np.median(steps))
    if usual <= 0 or steps.min() < 0:
        return
    by = _sorted_reading(data, order)
    if not by and np.abs(steps - usual).max() <= _EVEN * usual and _by_number(data, order):
        by = f"the number of the pose ({c.POSE})"
    if by:
        yield Doubt(
            f"{TIME} rises with {by} in every row: the table was sorted, it seems, and times were written anew; what "
            "depends on time, order or direction of motion then looks like anything else; give each row the time at "
            "which it was read, or leave the column out"
        )


def _sorted_reading(data: Measurements, order: Ints) -> str:
    """The reading that rises or falls from row to row, down to steps that its own noise would have turned round."""
    repeats = data.repeatability
    for k, name in enumerate(data.layout.coordinates):
        rows = order[data.used[order, k]]
        if len(rows) < _SMALL_STEPS:
            continue
        steps = np.diff(data.readings[rows, k])
        if (steps < 0).any() and (steps > 0).any():
            continue
        noise = 0.0 if repeats is None else repeats.sigma.get(name, 0.0)
        given = data.sigma[rows, k]
        if not noise and np.isfinite(given).all():
            noise = float(np.median(given))
        if int(((np.abs(steps) < noise) & (steps != 0)).sum()) >= _SMALL_STEPS:
            return name
    return ""


def _by_number(data: Measurements, order: Ints) -> bool:
    """Whether poses stand one behind another by their number, most of them read more than once."""
    if data.pose is None:
        return False
    number = data.pose[order]
    steps = np.diff(number)
    return bool((steps >= 0).all() and (steps == 0).sum() >= (steps > 0).sum() > _FEWEST)
