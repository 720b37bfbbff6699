"""A machine as it is drawn: its parts as lines in space, from the same model that predicts its readings.

A kind of robot says how its parts are joined (``Kind.drawing``); where they are says its model. So an effect needs no
drawing of its own: with its parameters the same parts stand elsewhere.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..base.types import Floats
from ..data import Measurements

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
    drawing takes it to be from what the instrument shows, NaN where it shows nothing; both mm, base frame.

    A machine of which no places are known stands in the unit of its readings: ``unit``.
    """

    parts: tuple[DrawnPart, ...]
    target_mm: Floats
    shown_mm: Floats
    unit: str = "mm"

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


def with_target(parts: Sequence[DrawnPart], target_mm: Floats, shown_mm: Floats, unit: str = "mm") -> Drawing:
    """A drawing of these parts, the measured point and where it is taken to be, joined by a line."""
    last = (
        DrawnPart("from the measured point to what is read", "ray", line(target_mm, shown_mm)),
        DrawnPart("measured point", "target", line(target_mm)),
        DrawnPart("as it is read", "shown", line(shown_mm)),
    )
    n = len(target_mm)
    every = [DrawnPart(p.name, p.look, np.broadcast_to(p.path_mm, (n, *p.path_mm.shape[1:]))) for p in (*parts, *last)]
    return Drawing(tuple(every), target_mm, shown_mm, unit)


def drawing_of_readings(model: Any, data: Measurements, values: Floats, readings: Floats | None = None) -> Drawing:
    """Any machine: what its model says that it reads, as a place, and the axes of its frame.

    Readings are taken for places in their own unit, up to three of them; a machine that reads less lies in a plane or
    on a line. Raises as :meth:`~sherkit.model.base.ModelWithEffects.predict`.
    """
    names = data.layout.coordinates[:3]
    target = _as_places(model.predict(data, values), len(names))
    shown = target if readings is None else _as_places(readings, len(names))
    reach = float(np.nanmax(np.abs(target), initial=0.0)) or 1.0
    axes = [
        DrawnPart(f"{name.rpartition('_')[0]} axis", "frame", line(np.zeros(3), reach * np.eye(3)[k]))
        for k, name in enumerate(names)
    ]
    return with_target(axes, target, shown, names[0].rpartition("_")[2])


def _as_places(readings: Floats, count: int) -> Floats:
    out = np.zeros((len(readings), 3))
    out[:, :count] = readings[:, :count]
    return out
