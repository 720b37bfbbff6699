"""Poses that cannot tell what a model asks of them."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ...base import linalg
from ...base.types import Floats
from ..rows import Measurements
from .doubt import FEWEST, Doubt, some

#: What lies beside a line, as a part of its length.
_BESIDE = 0.01
#: The part of the places that is looked at, the nearest to the middle.
_MOST = 0.8


def on_a_line(data: Measurements) -> Iterator[Doubt]:
    """Poses along one line, of a machine with several joints."""
    if len(data.layout.joints) < 2 or len(data) < FEWEST or not data.layout.follows:
        return
    few = some(data)
    rows = few.used[:, : few.coordinates].all(axis=1)
    if rows.sum() < FEWEST or few.coordinates < 2:
        return
    along = _line(few.readings[rows][:, : few.coordinates])
    if along is None:
        return
    most = int(np.argmax(np.abs(along)))
    name = data.layout.coordinates[most]
    where = f"along {name}" if abs(along[most]) > 0.99 else f"mostly along {name}"
    yield Doubt(
        f"all poses stand on one line, {where}: they cannot tell what moves the robot across it, nor most of its "
        "parameters; measure poses in a plane, and at more than one height",
        poses=True,
    )


def _line(places: Floats) -> Floats | None:
    """The direction of the line on which most places (n, k) lie; None where they lie on none, or at one point."""
    places = places - np.median(places, axis=0)
    away = np.abs(places).max(axis=1)
    # wild readings make a line of anything
    _, length, turn = linalg.svd(places[away <= np.quantile(away, _MOST)], full_matrices=False)
    if length[0] == 0 or length[1] > _BESIDE * length[0]:
        return None
    return np.asarray(turn[0])
