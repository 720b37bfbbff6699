"""Zeros and senses of several joints at once, as a vendor counts them where a table of the arm counts otherwise.

One joint at a time shows nothing while the others are wrong. Distances between places know no sensor's pose: of all
combinations of quarter turns and senses that is taken whose places lie as far apart as those that were read, wherever
the last link holds the target.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np

from ..base import linalg
from ..base.types import Floats
from ..data import Measurements
from ..data.columns import unit_in
from ..errors import SherkitError
from ..model.base import ModelWithEffects
from ..model.chain import ChainModel
from .set_up_hypotheses import SetUpHypothesis, joints_as

#: Joints that turn, fewest and most, and rows that are looked at.
_FEWEST, _MOST, _ROWS = 3, 6, 10
#: How far a target is moved to see what that does, mm, and steps by which its place is found.
_BY_MM, _STEPS = 100.0, 4
#: Part of the distances that may be left.
_LEFT, _AS_GOOD = 0.1, 2.0
_SENSES, _QUARTERS = (1.0, -1.0), (0.0, 0.5 * np.pi, np.pi, -0.5 * np.pi)


def several_joints(model: ModelWithEffects, data: Measurements) -> SetUpHypothesis | None:
    """The run with its joints as the drawing counts them, where that is another zero or sense of several; None where
    none explains how far its places lie apart."""
    turning = [k for k, name in enumerate(data.layout.joints) if unit_in(name) == "rad"]
    rows = np.flatnonzero(data.used[:, : data.coordinates].all(axis=1))
    if not (isinstance(model, ChainModel) and model.stands_anywhere and model.reads_places(data)):
        return None
    if not (data.coordinates == 3 and _FEWEST <= len(turning) <= _MOST and len(rows) >= _ROWS):
        return None
    some = data.select(rows[np.linspace(0, len(rows) - 1, _ROWS).astype(np.int64)])
    # where the first begins is a turn of the sensor's, where the last does is one of a target that may sit anywhere
    zeros: list[tuple[float, ...]] = [_QUARTERS] * len(turning)
    zeros[0] = _QUARTERS[:1]
    zeros[-1] = _QUARTERS[:1] if model.targets_anywhere else _QUARTERS
    ways = np.array(list(product(*(list(product(_SENSES, each)) for each in zeros))))
    try:
        left, places = _left(model, some, turning, ways)
    except SherkitError:
        return None
    # distances are those of the mirrored arm, too
    likely = [k for k in np.flatnonzero(left <= _AS_GOOD * left.min()) if _turned(places[k], some.readings[:, :3])]
    if left.min() > _LEFT or not likely:
        return None
    flips, zeros_off = ways[:, :, 0] < 0, ways[:, :, 1] != 0
    best = min(likely, key=lambda k: (int((flips[k] | zeros_off[k]).sum()), int(flips[k].sum())))
    factor, offset = np.ones(len(data.layout.joints)), np.zeros(len(data.layout.joints))
    factor[turning], offset[turning] = ways[best].T
    changed = np.flatnonzero((factor < 0) | (offset != 0)).tolist()
    if not changed:
        return None
    said = [_in_words(data.layout.joints[k], float(factor[k]), round(np.rad2deg(offset[k]))) for k in changed]
    looks, advice = zip(*said, strict=True)
    there = joints_as(data, range(len(factor)), factor, offset)
    return SetUpHypothesis(
        f"the joints look counted from other zeros: {', '.join(looks)}", "; ".join(advice), model, there
    )


def _in_words(name: str, factor: float, degrees: int) -> tuple[str, str]:
    if factor > 0:
        return f"{name} off by {-degrees:+d}°", f"add {degrees:+d}° to {name}"
    if degrees:
        return f"{name} the other way from {degrees:+d}°", f"{name} is {degrees:+d}° minus what it holds"
    return f"{name} the other way", f"change the sign of {name}"


def _turned(places: Floats, read: Floats) -> bool:
    """Whether places (n, 3) are those that were read, turned and shifted, and not mirrored (Kabsch, 1976)."""
    ours, theirs = (one - one.mean(axis=0) for one in (places, read))
    left, size, right = linalg.svd(theirs.T @ ours)
    mirrored = np.linalg.det(left @ right) < 0
    # in a plane nobody knows
    return not mirrored or bool(size[2] < _LEFT * size[1])


def _left(
    model: ModelWithEffects, some: Measurements, turning: list[int], ways: Floats
) -> tuple[Floats, Floats]:  # fmt: skip
    """What is left of the distances of places, over these (root mean square), of each of the ``ways`` (w, k, 2), and
    the places (w, n, 3)."""
    n, count = len(some), len(ways)
    joints = np.tile(some.joints, (count, 1, 1))
    joints[:, :, turning] = joints[:, :, turning] * ways[:, None, :, 0] + ways[:, None, :, 1]
    every = some.select(np.tile(np.arange(n), count))
    every = replace(every, joints=np.ascontiguousarray(joints.reshape(count * n, -1)))
    held = np.array([p.name in model.targets_anywhere[:3] for p in model.parameters], dtype=bool)
    drawn = np.zeros(len(model.parameters))
    places = [model.predict(every, drawn)[:, :3]]
    places += [
        model.predict(every, np.where(np.arange(len(held)) == k, _BY_MM, 0.0))[:, :3] for k in np.flatnonzero(held)
    ]
    first, second = np.triu_indices(n, 1)
    apart = [(one.reshape(count, n, 3)[:, first] - one.reshape(count, n, 3)[:, second]) for one in places]
    read = some.readings[first, :3] - some.readings[second, :3]
    read_mm = np.linalg.norm(read, axis=1)
    by = np.stack([one - apart[0] for one in apart[1:]], axis=3) if held.any() else np.zeros((*apart[0].shape, 0))
    at = np.zeros((count, by.shape[3]))
    for step in range(_STEPS + 1):
        there = apart[0] + np.einsum("wpij,wj->wpi", by, at)
        length = np.maximum(np.linalg.norm(there, axis=2), 1e-9)
        off = length - read_mm
        if step < _STEPS and by.shape[3]:
            slope = np.einsum("wpij,wpi->wpj", by, there) / length[:, :, None]
            square = np.einsum("wpi,wpj->wij", slope, slope) + 1e-6 * np.eye(by.shape[3])
            at = at - linalg.solve(square, np.einsum("wpi,wp->wi", slope, off)[:, :, None])[:, :, 0]
    base, *moved = (one.reshape(count, n, 3) for one in places)
    there = base + sum((at[:, k, None, None] * (one - base) for k, one in enumerate(moved)), np.zeros_like(base))
    return np.sqrt(np.square(off).mean(axis=1) / np.square(read_mm).mean()), there
