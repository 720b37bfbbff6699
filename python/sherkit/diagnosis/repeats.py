"""What repeats of a pose hold, before it is called noise.

Within a pose the place is the same: how its readings differ from their mean can follow only the time, the way the
machine came there, or a column. Shapes that describe what is left say which; the noise is what they leave.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ..base.figures import listed
from ..base.types import Floats, Ints
from ..data.columns import bare
from ..evidence.base import Base
from ..evidence.blocks import Block
from ..evidence.fitted_run import FittedRun
from ..evidence.sets import ShapeDescription
from .template import course

#: Declared noise and what repeats show may differ by this factor.
_CONTRADICTS = 3.0
#: Visits beyond the first of each pose without which nothing is told of noise.
_FEWEST = 5
#: Part of a shape's square that must differ between visits of a pose.
_DIFFERS = 1e-6


@dataclass(frozen=True, eq=False)
class Repeats:
    """What repeats hold, as sentences, ``held``; the ``noise`` (columns,) that is left; how many ``rows``."""

    held: tuple[str, ...]
    noise: Floats
    rows: int

    def __str__(self) -> str:
        return listed(list(self.held)) if self.held else "nothing that follows time, the way there, or a column"


def in_repeats(before: Base, left: ShapeDescription, every: FittedRun) -> Repeats | None:
    """What the shapes that describe what a model leaves, ``left`` beside it ``before``, say of repeats; where these
    hold nothing their scatter is that of ``every`` row. None where too few poses were repeated."""
    run = before.family.run
    pose = np.unique(run.view.repeated, return_inverse=True)[1].ravel()
    count = np.bincount(pose)
    free = len(pose) - len(count)
    if free < _FEWEST:
        return None
    axes = list(run.of.axes)
    apart = _apart(left.base.residual, len(axes), pose)
    # what was fitted takes its part of the freedom within poses as well
    free -= free * (left.base.basis.shape[1] - before.basis.shape[1]) / (len(pose) * len(axes))
    noise = run.sigma.copy()
    noise[axes] *= np.sqrt(np.square(apart).sum(axis=0) / free)
    held = []
    now = before
    for shape in left.shapes:
        then = now.beside(shape)
        columns = before.family.columns.of(shape.at)
        if _DIFFERS * np.square(columns).sum() < sum(np.square(_apart(c, len(axes), pose)).sum() for c in columns.T):
            taken = _apart(now.residual - then.residual, len(axes), pose)
            held.append(_told(run.of, shape, np.sqrt(np.square(taken).mean(axis=0)) * run.sigma[axes]))
        now = then
    if not held:
        noise = _scatter(every, noise)
    return Repeats(tuple(held), np.maximum(noise, run.of.digits), int((count[pose] > 1).sum()))


def _scatter(run: FittedRun, noise: Floats) -> Floats:
    """By how much repeats of a pose differ in each reading (columns,) of a run; ``noise`` where too few tell."""
    out, told = noise.copy(), run.fit.repeatability
    for a in run.axes:
        name = run.data.layout.readings[a]
        if told is not None and told.degrees_of_freedom.get(name, 0) >= _FEWEST:
            out[a] = told.sigma[name]
    return out


def _apart(values: Floats, axes: int, pose: Ints) -> Floats:
    """How far values (N,) of rows are from the mean of their pose (n, m)."""
    values = values.reshape(-1, axes)
    count = np.bincount(pose)
    return values - np.stack([np.bincount(pose, one) / count for one in values.T], axis=1)[pose]


def _told(run: FittedRun, shape: Block, size: Floats) -> str:
    """A shape of this size (m,) on each axis, in words."""
    most = [a for a, one in zip(run.axes, size.tolist(), strict=True) if 2.0 * one > size.max()]
    told = course({
        "depends_on": list(shape.depends_on), "axis": [bare(run.names[a]) for a in most], "shape": shape.shape,
        "order": shape.order, "period": shape.period, "at": shape.setting,
    })  # fmt: skip
    return f"{told} by {run.per_unit * float(np.linalg.norm(size)) / np.sqrt(len(most)):.3g} {run.unit}"


def contradicted(run: FittedRun, repeats: Repeats) -> Mapping[str, tuple[float, float]]:
    """Where repeats contradict the noise that was declared: by axis what was declared and what they show, in the unit
    of the run."""
    out = {}
    for a in run.axes:
        each = run.data.sigma[run.used[:, a], a]
        if not np.isfinite(each).all() or not each.any():
            continue
        said, shown = float(np.sqrt(np.mean(each**2))), float(repeats.noise[a])
        if not 1.0 / _CONTRADICTS <= shown / said <= _CONTRADICTS:
            out[bare(run.names[a])] = (run.per_unit * said, run.per_unit * shown)
    return out
