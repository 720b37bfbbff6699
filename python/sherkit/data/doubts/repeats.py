"""Rows that stand for readings that nobody took: copies of others, averages written once for each repeat, joints as
they were commanded; and deviations that were declared in another unit."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import scipy

from ...base.figures import listed
from ...base.types import Ints
from ..artefact import is_artefact
from ..noise import step_of
from ..rows import Measurements
from .doubt import DataWarning

#: Repeats whose readings scatter by this many times the declared noise were not at one place.
_SCATTER = 3.0
_LEVEL = 1e-6
_FEWEST = 5
#: So many rows that are others once more were copied, where their times are the same; without times, so many in a row.
_COPIED = 3
_COPIED_IN_A_ROW = 10
#: Part of the repeated poses whose readings are all equal; an instrument of so many digits shows its own noise.
_EQUAL = 0.8
_DIGITS = 30_000
#: Declared deviations are in another unit where they are so many times the scatter, or the scatter so many times
#: them. So many repeats tell.
_TOO_MUCH = 30.0
_THOUSAND = (300.0, 30_000.0)
_REPEATS = 8


def copied(data: Measurements) -> Iterator[DataWarning]:
    """Rows that are earlier ones once more, to the last digit: repeats that are none, by which noise would seem smaller
    than it is."""
    given = [data.joints, data.readings]
    if data.time_s is not None:
        given.append(data.time_s[:, None])
    rows = np.ascontiguousarray(np.column_stack(given) + 0.0)  # a zero has no sign
    factors = np.random.default_rng(0).integers(1, 2**63, rows.shape[1], dtype=np.uint64) | np.uint64(1)
    bits = (rows.view(np.uint64) * factors).sum(axis=1, dtype=np.uint64)
    in_order = np.sort(bits)
    if (in_order[1:] != in_order[:-1]).all():
        return
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
        return
    yield DataWarning(
        f"{data.place(copies)} are copies of earlier rows, to the last digit of every reading: files that overlap were "
        "joined, it seems; leave the copies out, or the noise looks smaller than it is"
    )


def _moves(data: Measurements, rows: Ints) -> bool:
    return bool((np.ptp(data.joints[rows], axis=0) > 0).any())


def averaged(data: Measurements) -> Iterator[DataWarning]:
    """Repeats that are equal to the last digit in every reading, by an instrument whose digits show its noise."""
    every = data.used.any(axis=1)
    rows = np.flatnonzero(every)
    group = np.unique(data.groups[rows], return_inverse=True)[1].ravel()
    count = np.bincount(group)
    if (count > 1).sum() < _FEWEST:
        return
    order = np.argsort(group, kind="stable")
    starts = np.concatenate([[0], np.cumsum(count[:-1])])
    equal, fine = np.ones(len(count), dtype=bool), False
    for k in range(data.coordinates):
        u = np.where(data.used[rows, k], data.readings[rows, k], np.inf)[order]
        equal &= np.maximum.reduceat(u, starts) == np.minimum.reduceat(u, starts)
        shown = data.readings[data.used[:, k], k]
        if equal.any() and len(shown) and np.ptp(shown) > 0:
            fine |= np.ptp(shown) > _DIGITS * step_of(shown)
    part = float(equal[count > 1].mean())
    if fine and part >= _EQUAL and not is_artefact(data):
        yield DataWarning(
            f"repeats are equal to the last digit at {int(equal[count > 1].sum())} of {int((count > 1).sum())} poses: "
            "averages written as repeats, or copies, it seems; give each reading as it was taken, or one row for each "
            "pose, or their scatter says nothing of the noise"
        )


def declared(data: Measurements) -> Iterator[DataWarning]:
    """Deviations that cannot be those of the readings: far beyond their scatter, or a thousandth of it."""
    wrong: dict[float, list[str]] = {}
    for k, name in enumerate(data.layout.readings):
        rows = data.used[:, k]
        given = data.sigma[rows, k]
        if not len(given) or not np.isfinite(given).all():
            continue
        usual, reach = float(np.median(given)), float(np.ptp(data.readings[rows, k]))
        repeats = data.repeatability
        enough = repeats is not None and repeats.degrees_of_freedom.get(name, 0) >= _REPEATS
        spread = _scatter_of_repeats(data, k) if enough else 0.0
        each, unit = data.layout.per_unit, data.layout.unit
        if spread > 0 and (usual > _TOO_MUCH * spread or _THOUSAND[0] < spread / usual < _THOUSAND[1]):
            said = f"{each * usual:.3g} {unit} where repeats differ by {each * spread:.3g}"
            wrong.setdefault(np.sign(usual - spread), []).append(f"{data.layout.sigmas[k]} ({said})")
        elif not enough and data.layout.follows and usual > reach > 0:
            wrong.setdefault(1.0, []).append(
                f"{data.layout.sigmas[k]} ({each * usual:.3g} {unit} where all readings lie within {each * reach:.3g})"
            )
    for sign, told in wrong.items():
        far, other = ("larger", "smaller") if sign > 0 else ("smaller", "larger")
        yield DataWarning(
            f"{listed(told)}: declared deviations are far {far} than the readings' own scatter: they look like another "
            f"unit ({other} by 1000?); divide them, multiply them, or leave these columns out"
        )


def commanded(data: Measurements) -> Iterator[DataWarning]:
    """Joints that are equal to the bit in all repeats of a pose while their readings scatter far beyond the declared
    noise."""
    if data.pose is None or not np.isfinite(data.sigma[data.used]).all():
        return
    repeats = data.repeatability
    _, first, group = np.unique(data.pose, return_index=True, return_inverse=True)
    if repeats is None or not np.array_equal(data.joints, data.joints[first][group]):
        return
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
        return
    joints = ", ".join(data.layout.joints)
    yield DataWarning(
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
