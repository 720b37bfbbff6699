"""Mistakes that the columns show by themselves: no fit gets better without them.

A reading that is the same in every row, times in milliseconds, joints as they were commanded, rows given twice.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import scipy

from ...data import Measurements
from ...data.columns import TIME
from ...errors import SherkitError
from ...model.base import ModelWithEffects
from ...names import listed
from ...types import Ints

#: A reading that never changes is a mistake where the place moves it by more than this part of what moves most.
_MOVES = 0.05
#: Few runs are as slow as this for each reading and as long as this on the whole, s.
_SLOW_S = 300.0
_LONG_S = 86_400.0
#: Repeats whose readings scatter by this many times the declared noise were not at one place.
_SCATTER = 3.0
_LEVEL = 1e-6
_FEWEST = 5
#: So many rows that are others once more were copied, where their times are the same; without times, so many in a row.
_COPIED = 3
_COPIED_IN_A_ROW = 10


def constant(data: Measurements) -> Ints:
    """Columns of readings that are the same, to the bit, in every row that was used."""
    out = []
    for k in range(data.readings.shape[1]):
        u = data.readings[data.used[:, k], k]
        if len(u) >= _FEWEST and np.ptp(u) == 0:
            out.append(k)
    return np.array(out, dtype=np.int64)


def held(data: Measurements) -> tuple[str, ...]:
    """What a constant reading leaves open, in a sentence for each."""
    return tuple(
        f"{data.layout.readings[k]} is constant, the same in all {int(data.used[:, k].sum())} rows: whatever lets the "
        "robot move less would fit it, so that gains and scales cannot be told from it"
        for k in constant(data)
    )


def unread(data: Measurements) -> tuple[str, ...]:
    """Coordinates that no row reads where others are read, in a sentence."""
    read = np.asarray(data.used[:, : data.coordinates].any(axis=0))
    if read.all() or not read.any():
        return ()
    names = listed([name for name, one in zip(data.layout.coordinates, read, strict=True) if not one])
    return (f"{names}: not read in any row, so that nothing is said of what moves the robot there alone",)


def constant_by_mistake(model: ModelWithEffects, data: Measurements) -> Iterator[tuple[int, str]]:
    """Readings that never change though the drawing moves the place: the column and the sentence.

    Where it was held there on purpose, as by a probe that is lowered to a table, the drawing's do not change either.
    """
    still = constant(data)
    if not len(still):
        return
    try:
        moves = np.ptp(model.predict(data, np.zeros(len(model.parameters))), axis=0)
    except SherkitError:
        return
    most = moves[: data.coordinates].max()
    for k in still:
        if moves[k] > _MOVES * most:
            name, per_unit, unit = data.layout.readings[k], data.layout.per_unit, data.layout.unit
            value = float(data.readings[data.used[:, k], k][0])
            yield (
                int(k),
                f"{name} is constant: {value:g}, the same in all {int(data.used[:, k].sum())} rows, where the robot "
                f"moves it by {per_unit * moves[k]:.3g} {unit}; look at the instrument and its cable, or leave the "
                "column out",
            )


def time_in_milliseconds(data: Measurements) -> str | None:
    """Times that would make a run of a few minutes last for days, as a sentence."""
    if data.time_s is None or len(data) < _FEWEST:
        return None
    gaps = np.diff(np.sort(data.time_s))
    velocities = [v for v in (data.covariates.get(name) for name in data.layout.velocities) if v is not None]
    usual = float(np.median(gaps))
    if len(velocities) == data.joints.shape[1]:
        # joints tell how fast time runs, where their speeds are known
        order = np.argsort(data.time_s, kind="stable")
        way = np.abs(np.diff(data.joints[order], axis=0)).sum()
        by_speed = (np.abs(np.column_stack(velocities)[order][1:]) * gaps[:, None]).sum()
        if by_speed > 0 and 500.0 < by_speed / max(float(way), 1e-300) < 2000.0:
            return (
                f"{TIME} looks like milliseconds (ms): at the speeds of the run its joints would have moved "
                f"{by_speed / way:.0f} times as far as they did; divide {TIME} by 1000"
            )
        return None
    if usual < _SLOW_S or np.ptp(data.time_s) < _LONG_S:
        return None
    hours = float(np.ptp(data.time_s)) / 3600.0
    return (
        f"{TIME} looks like milliseconds (ms): {len(data)} readings would have taken {hours:.0f} hours, "
        f"{usual / 60:.0f} minutes each, instead of {usual / 1000:.1f} s; divide {TIME} by 1000"
    )


def copied(data: Measurements) -> str | None:
    """Rows that are earlier ones once more, to the last digit, as a sentence: repeats that are none, by which noise
    would seem smaller than it is."""
    given = [data.joints, data.readings]
    if data.time_s is not None:
        given.append(data.time_s[:, None])
    rows = np.ascontiguousarray(np.column_stack(given) + 0.0)  # a zero has no sign
    factors = np.random.default_rng(0).integers(1, 2**63, rows.shape[1], dtype=np.uint64) | np.uint64(1)
    bits = (rows.view(np.uint64) * factors).sum(axis=1, dtype=np.uint64)
    _, first, inverse = np.unique(bits, return_index=True, return_inverse=True)
    before = first[inverse]
    copies = np.flatnonzero(before < np.arange(len(rows)))
    copies = copies[(rows[copies].view(np.uint64) == rows[before[copies]].view(np.uint64)).all(axis=1)]
    if data.time_s is None:
        # instruments of few digits show a reading again, but not many in the same order
        follows = (np.diff(copies) == 1) & (np.diff(before[copies]) == 1)
        stretches = np.split(copies, np.flatnonzero(~follows) + 1)
        stretches = [one for one in stretches if len(one) >= _COPIED_IN_A_ROW and _moves(data, one)]
        copies = np.concatenate([np.zeros(0, dtype=np.int64), *stretches])
    if len(copies) < _COPIED:
        return None
    return (
        f"{data.place(copies)} are copies of earlier rows, to the last digit of every reading: files that overlap were "
        "joined, it seems; leave the copies out, or the noise looks smaller than it is"
    )


def _moves(data: Measurements, rows: Ints) -> bool:
    return bool((np.ptp(data.joints[rows], axis=0) > 0).any())


def commanded_joints(data: Measurements) -> str | None:
    """Joints that are equal to the bit in all repeats of a pose while their readings scatter far beyond the declared
    noise, as a sentence."""
    if data.pose is None or not np.isfinite(data.sigma[data.used]).all():
        return None
    repeats = data.repeatability
    _, first, group = np.unique(data.pose, return_index=True, return_inverse=True)
    if repeats is None or not np.array_equal(data.joints, data.joints[first][group]):
        return None
    told = []
    for k, name in enumerate(data.layout.readings):
        free = repeats.degrees_of_freedom.get(name, 0)
        if free < _FEWEST:
            continue
        declared = float(np.sqrt(np.mean(data.sigma[data.used[:, k], k] ** 2)))
        spread = _scatter_of_repeats(data, k)
        if spread > _SCATTER * declared and scipy.special.chdtrc(free, free * (spread / declared) ** 2) < _LEVEL:
            each = data.layout.per_unit
            told.append(
                f"{name} scatters by {each * spread:.3g} {data.layout.unit} where {each * declared:.3g} are declared"
            )
    if not told:
        return None
    joints = ", ".join(data.layout.joints)
    return (
        f"joint readings ({joints}) look like commanded values, not read ones: they are equal to the last digit in "
        f"all repeats of a pose while {'; '.join(told)}; write what the encoders read, or declare the scatter as noise"
    )


def _scatter_of_repeats(data: Measurements, column: int) -> float:
    """Spread of repeats about the mean of their pose, by the median over poses: a few wild ones do not count."""
    rows = data.used[:, column]
    group = np.unique(data.groups[rows], return_inverse=True)[1]
    count = np.bincount(group)
    value = data.readings[rows, column]
    mean = np.bincount(group, value) / count
    square = np.bincount(group, (value - mean[group]) ** 2)
    several = count > 1
    usual = scipy.special.chdtri(count[several] - 1, 0.5)
    return float(np.sqrt(np.median(square[several] / usual)))
