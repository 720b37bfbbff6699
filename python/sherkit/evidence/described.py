"""Shapes that describe what a model leaves, one after another, as long as the readings favour one more."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .base import Base, total
from .blocks import Block
from .thresholds import ALARM

#: Most shapes of a description.
MOST = 10
#: Likeliest shapes among which different beginnings are looked for.
_LIKELIEST = 200


@dataclass(frozen=True, eq=False)
class ShapeDescription:
    """``shapes`` in the order in which they were found, by how much the readings favour all of them together,
    ``evidence`` with their prior weights, and the ``base`` with them in the model."""

    shapes: tuple[Block, ...]
    evidence: float
    base: Base


def described(base: Base, most: int = MOST, starts: int = 1) -> ShapeDescription:
    """At most so many shapes that describe what a base leaves; none where nothing is left.

    The likeliest is taken first, then the likeliest beside it. The first need not be the right one: of several
    ``starts`` with shapes of different causes the description that says most is taken.
    """
    if total(base.shapes) < ALARM:
        return ShapeDescription((), 0.0, base)
    first: dict[tuple[object, ...], int] = {}
    for i in np.argsort(-base.shapes)[:_LIKELIEST].tolist():
        first.setdefault(base.family.blocks[i].cause, i)
        if len(first) == starts:
            break
    return max((_from(base, i, most) for i in first.values()), key=lambda one: one.evidence)


def _from(base: Base, first: int, most: int) -> ShapeDescription:
    shapes: list[Block] = []
    evidence, now, i = 0.0, base, first
    while True:
        shapes.append(base.family.blocks[i])
        evidence += float(now.shapes[i])
        now = now.beside(shapes[-1])
        if len(shapes) == most or total(now.shapes) < ALARM:
            break
        i = int(np.argmax(now.shapes))
        if now.shapes[i] < 0:
            break
    return ShapeDescription(tuple(shapes), evidence, now)
