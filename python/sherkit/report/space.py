"""The workspace in three dimensions: the machine, where it was measured, how far it was off, and how far it will be."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

from ..base.types import Floats, Ints
from ..data import Measurements
from ..errors import SherkitError
from ..fit.identify import Fit
from ..model.drawing import Draw, Drawing
from ..model.kinds import draw_of, kind_of
from ..robots.calibrated import Calibration
from .picture import thinned
from .scene import Arrows, Field, Scene

#: So many arrows are drawn, and places at which the accuracy is predicted.
_MOST_ARROWS, _MOST_CELLS = 3000, 700
#: Height by width: with what is said above it, a scene stands on one screen.
_ASPECT, _ASPECT_OF_ALL = 0.42, 0.8
#: Rings of the largest errors.
_WORST = 5
#: Heights that a run kept to, if they are no more; else slabs of equally many places.
_PLANES, _SLABS = 12, 6


def space_of(
    before: Fit, after: Fit, titles: tuple[str, ...], calibration: Calibration | None = None, *, moment: int = 0,
    whole: bool = False,
) -> Scene | None:  # fmt: skip
    """The scene of two fits of one run: errors of the one and of the other, mean of the repeats of a pose. Where both
    are the same, its errors once. It begins with the errors of the fit of this number, ``moment``, and shows the
    ``whole`` machine or what is measured of it.

    Errors are those of the place that who trusts the drawing reads off the instrument: for a camera, on the sphere of
    the drawing. None where the run says no places: distances alone, or poses with a coordinate that was not read.
    """
    data, draw = after.data, draw_of(after.model)
    count = data.coordinates
    rows = np.flatnonzero(~data.is_distance & data.taken[:, :count].all(axis=1) & ~data.outlier)
    if len(rows) < 2:
        return None
    _, first, group = np.unique(data.groups[rows], return_index=True, return_inverse=True)
    keep = thinned(len(first), _MOST_ARROWS)
    try:
        where, errors, machine = _errors(draw, (before, after), data.select(rows), first[keep], group, keep)
    except SherkitError:
        return None
    if before is after:
        errors, titles = errors[:1], titles[:1]
    good = np.isfinite(where).all(axis=1) & np.isfinite(errors).all(axis=(0, 2))
    where, errors, lines = where[good], errors[:, good], data.line[rows[first[keep]]][good]
    if len(where) < 2:
        return None
    sizes = np.linalg.norm(errors, axis=2)
    mm = machine.unit == "mm"
    arrows = Arrows(
        where, list(errors), titles, lines.astype(float), "pose at " + data.counted,
        [np.argsort(-s)[:_WORST].astype(float) for s in sizes], _slabs(where[:, 2]), "height",
        "µm" if mm else machine.unit, 1e3 if mm else 1.0, _round(float(np.quantile(sizes[0], 0.9))),
    )  # fmt: skip
    field = None if calibration is None else _field(calibration, draw, after, where)
    label = f"{machine_name(after.model)} and the errors of {len(where)} poses, {' and '.join(titles)}"
    aspect = _ASPECT_OF_ALL if whole else _ASPECT
    moment = min(moment, len(errors) - 1)
    return Scene(label, [(0.0, machine)], 0.0, arrows, field, machine.unit, aspect, moment, whole)


def machine_name(model: Any) -> str:
    """What people call the machine of a model."""
    name = "the machine" if model.robot is None else kind_of(model.robot).title
    return name[:1].upper() + name[1:]


def _errors(
    draw: Draw, fits: tuple[Fit, Fit], data: Measurements, first: Ints, group: Ints, keep: Ints
) -> tuple[Floats, Floats, Drawing]:
    """Places (k, 3), errors of each fit (2, k, 3), and the machine amid them; repeats of a pose are averaged."""
    plain = [np.zeros_like(fit.values) for fit in fits]
    read = draw(fits[0].model, data, plain[0], data.readings[:, : data.coordinates]).shown_mm

    def mean(values: Floats) -> Floats:
        sums = np.zeros((group.max() + 1, 3))
        np.add.at(sums, group, values)
        return (sums / np.bincount(group)[:, None])[keep]

    errors = [mean(read - draw(fit.model, data, fit.values, None).shown_mm) for fit in fits]
    where = mean(read)
    middle = int(np.nanargmin(np.linalg.norm(where - np.nanmean(where, axis=0), axis=1)))
    pose = data.select(first[[middle]])
    return where, np.array(errors), draw(fits[0].model, pose, plain[0], None)


def _slabs(height: Floats) -> list[tuple[float, float, str]]:
    levels = np.unique(height.round(3))
    room = 1e-3 + 1e-3 * float(np.ptp(height))
    if len(levels) <= _PLANES:
        return [(float(z) - room, float(z) + room, f"{z:.4g} mm") for z in levels]
    # poses that were commanded to a few heights lie a little beside them
    near = np.split(np.sort(height), np.flatnonzero(np.diff(np.sort(height)) > 0.04 * np.ptp(height)) + 1)
    if 1 < len(near) <= _PLANES:
        return [(float(z[0]) - room, float(z[-1]) + room, f"{np.mean(z):.3g} mm") for z in near]
    edges = np.quantile(height, np.linspace(0, 1, _SLABS + 1))
    return [(float(a), float(b), f"{a:.3g} to {b:.3g} mm") for a, b in pairwise(edges)]


def _round(length: float) -> float:
    power = 10.0 ** np.floor(np.log10(length)) if length > 0 else 1.0
    return float(power * max(step for step in (1, 2, 5) if step * power <= max(length, power)))


def _field(calibration: Calibration, draw: Draw, fit: Fit, where: Floats) -> Field | None:
    """The accuracy that the calibration promises over the workspace, as a field of places."""
    planes = calibration.planes(2 * int(np.sqrt(_MOST_CELLS / 3)) // 2)
    grid = np.ascontiguousarray(planes.grid[planes.inside])
    try:
        found = fit.model.robot.inverse_batch(grid)
        grid = grid[found.reached]
        promised = 1e3 * calibration.predicted_accuracies(grid).total_mm
        model = replace(fit.model, effects=())
        rows = fit.data.unmeasured(found.values[found.reached])
        places = draw(model, rows, np.zeros(len(model.parameters)), None).target_mm
    except SherkitError:
        return None
    good = np.isfinite(promised) & np.isfinite(places).all(axis=1)
    if not good.any():
        return None
    cell = float(np.sqrt(np.prod(np.ptp(where, axis=0)[:2]) / max(1, good.sum() / 3)))
    high = float(np.quantile(promised[good], 0.98))
    return Field(places[good], promised[good], 0.0, high, "µm", "accuracy to come, 95 %", cell)
