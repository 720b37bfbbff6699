"""Readings that are the same in every row, and such as no row holds: held on purpose, or by mistake."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ...base.names import listed
from ...base.types import Ints
from ...data import Measurements
from ...errors import SherkitError
from ...model.base import ModelWithEffects

#: A reading that never changes is a mistake where the place moves it by more than this part of what moves most.
_MOVES = 0.05
_FEWEST = 5


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
