"""A machine as it is drawn: its parts as lines in space, from the same model that predicts its readings.

A kind of robot says how its parts are joined (``Kind.drawing``); where they are says its model. So an effect needs no
drawing of its own: with its parameters the same parts stand elsewhere.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..base.figures import listed
from ..base.types import Floats
from ..data import Measurements
from ..data.columns import bare, unit_in
from ..errors import SherkitError

#: How parts are drawn, from the back to the front.
LOOKS = ("guide", "frame", "axis", "rod", "link", "platform", "joint", "sensor", "ray", "target", "shown")

#: A model, a run, the values of its parameters, and readings (n, m) to be taken for places instead of those that the
#: model predicts; gives the machine at each row.
Draw = Callable[[Any, Measurements, Floats, "Floats | None"], "Drawing"]


@dataclass(frozen=True, eq=False)
class DrawnPart:
    """A line (n, k, 3), mm, base frame, at each of n poses, or one point where k is 1; ``look`` is one of
    :data:`LOOKS`."""

    name: str
    look: str
    path_mm: Floats


@dataclass(frozen=True, eq=False)
class Drawing:
    """A machine at n poses. ``target_mm`` (n, 3) is the measured point, ``shown_mm`` (n, 3) where who trusts the
    drawing takes it to be from what the instrument shows, NaN where it shows nothing; both mm, base frame."""

    parts: tuple[DrawnPart, ...]
    target_mm: Floats
    shown_mm: Floats

    def __len__(self) -> int:
        return len(self.target_mm)

    def named(self, name: str) -> Floats:
        """The line (n, k, 3) of a part. Raises ``KeyError``."""
        return {part.name: part.path_mm for part in self.parts}[name]

    @property
    def points_mm(self) -> Floats:
        """The points (n, k, 3) of all parts, one behind another."""
        return np.concatenate([part.path_mm for part in self.parts], axis=1)


def line(*points_mm: Floats) -> Floats:
    """A line (n, k, 3) through points (n, 3), or (3,) where they stand still."""
    return np.stack(np.broadcast_arrays(*map(np.atleast_2d, points_mm)), axis=1)


def with_target(parts: Sequence[DrawnPart], target_mm: Floats, shown_mm: Floats) -> Drawing:
    """A drawing of these parts, the measured point and where it is taken to be, joined by a line."""
    last = (
        DrawnPart("from the measured point to what is read", "ray", line(target_mm, shown_mm)),
        DrawnPart("measured point", "target", line(target_mm)),
        DrawnPart("as it is read", "shown", line(shown_mm)),
    )
    n = len(target_mm)
    every = [DrawnPart(p.name, p.look, np.broadcast_to(p.path_mm, (n, *p.path_mm.shape[1:]))) for p in (*parts, *last)]
    return Drawing(tuple(every), target_mm, shown_mm)


def drawing_of_readings(model: Any, data: Measurements, values: Floats, readings: Floats | None = None) -> Drawing:
    """A machine of which nobody says how it is joined: the point that it reads, and no linkage.

    Raises :class:`~sherkit.errors.SherkitError` where readings are no x, y or z in mm, and as
    :meth:`~sherkit.model.base.ModelWithEffects.predict`.
    """
    names = data.layout.coordinates
    axes = ["xyz".find(bare(name).rpartition("_")[2].lower()) for name in names]
    if len(set(axes)) < len(axes) or min(axes) < 0 or {unit_in(name) for name in names} != {"mm"}:
        raise SherkitError(
            f"what is read ({listed(names)}) is no place in x, y, z, and nobody says how the machine is joined"
        )

    def places(read: Floats) -> Floats:
        out = np.zeros((len(read), 3))
        out[:, axes] = read[:, : len(axes)]
        return out

    target = places(model.predict(data, values))
    return with_target([], target, target if readings is None else places(readings))
