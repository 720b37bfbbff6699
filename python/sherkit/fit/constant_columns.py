"""Columns that are the same in every row: readings by mistake or on purpose, joints that froze; and empty ones."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..base import linalg
from ..base.figures import in_people_units, listed
from ..base.types import Floats, Ints
from ..data import Measurements
from ..data.columns import unit_in
from ..errors import SherkitError
from ..model.base import ModelWithEffects
from .plausible import plausible_sizes

#: A reading that never changes is a mistake where the place moves it by more than this part of what moves most.
_MOVES = 0.05
#: A distance that the drawing moves by fewer deviations, as plausible sizes of its parameters have them, is constant by
#: design.
_BY_DESIGN = 10.0
_FEWEST = 5
#: A joint stands beyond its limits by more than this part of what they allow.
_SLACK = 0.1


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
        f"{data.layout.readings[k]} is constant, the same in all {int(data.used[:, k].sum())} rows: "
        + (
            "lengths are known up to one factor, which is the drawing's here; a known distance between two of the "
            "places that were touched would tell it"
            if data.layout.readings[k] == data.layout.distance
            else "whatever lets the robot move less would fit it, so that gains and scales cannot be told from it"
        )
        for k in constant(data)
    )


def unread(data: Measurements) -> tuple[str, ...]:
    """Coordinates that no row reads where others are read, in a sentence."""
    read = np.asarray(data.used[:, : data.coordinates].any(axis=0))
    if read.all() or not read.any():
        return ()
    names = listed([name for name, one in zip(data.layout.coordinates, read, strict=True) if not one])
    return (f"{names}: not read in any row, so that nothing is said of what moves the robot there alone",)


def outside_limits(model: ModelWithEffects, data: Measurements) -> Iterator[str]:
    """Joints that stood beyond the limits that the robot's file names, a sentence each."""
    for name, (low, high) in model.joint_ranges().items():
        joints = data.joints[~data.outlier, data.layout.joints.index(name)]
        outside = (joints < low - _SLACK * (high - low)) | (joints > high + _SLACK * (high - low))
        if outside.any():
            unit, factor = in_people_units(unit_in(name))
            (least, most), own = (f"{factor * v:.4g}" for v in (joints.min(), joints.max())), unit_in(name)
            allowed = f"{factor * low:.4g} to {factor * high:.4g} {unit}"
            yield (
                f"{name}: {np.count_nonzero(outside)} of {len(joints)} rows stand outside its limits in the robot's "
                f"file ({allowed}), at {least} to {most} {unit}: is one of them not in {own}? What is identified, and "
                "where it may be sent, goes by the limits"
            )


def frozen(data: Measurements) -> str:
    """Behind a sentence on what nothing explains, that joints never changed; empty where all did."""
    both = np.concatenate([one.joints[~data.outlier] for one in (data, data.from_other_end)])
    still = np.flatnonzero(np.ptp(both, axis=0) == 0.0)
    names = listed(data.layout.joints[k] for k in still)
    return f"; {names} never changed: where it moved, what writes it froze" if len(still) else ""


def constant_by_mistake(model: ModelWithEffects, data: Measurements) -> Iterator[tuple[int, str]]:
    """Readings that never change though the drawing moves the place: the column and the sentence.

    Where it was held there on purpose, as by a probe that is lowered to a table, the drawing's do not change either.
    """
    still = constant(data)
    if not len(still):
        return
    try:
        drawn = model.predict(data, model.start(data))
    except SherkitError:
        return
    moves = np.ptp(drawn, axis=0)
    distance = data.layout.distance
    if distance is not None and data.layout.readings.index(distance) in still:
        # a probe that touches, a ball in its socket: constant, where an arm a little off its drawing makes it so
        k = data.layout.readings.index(distance)
        by_plausible = model.derivatives(data, model.start(data))[:, k] * plausible_sizes(model)
        if moves[k] < _BY_DESIGN * np.sqrt(np.square(np.std(by_plausible, axis=0)).sum()):
            still = still[still != k]
    if model.stands_anywhere:
        # how it is turned is told by the readings that are in doubt: of directions as many as the drawing's must move
        rows = data.taken[:, : data.coordinates].all(axis=1)
        ours, theirs = (_extents(one[rows, : data.coordinates]) for one in (drawn, data.readings))
        lost = ours[theirs <= _MOVES * theirs.max(initial=0.0)]
        moves[still] = lost.max(initial=0.0)
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


def _extents(places: Floats) -> Floats:
    """How far places (n, c) lie apart along their main directions, from the longest on."""
    if not len(places):
        return np.zeros(places.shape[1])
    middle = places - places.mean(axis=0)
    return np.asarray(np.ptp(middle @ linalg.svd(middle, full_matrices=False)[2].T, axis=0))
