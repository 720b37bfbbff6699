"""What repeats of a pose hold, before it is called noise.

Within a pose the place is the same: how its readings differ from their mean can follow only the time, the way the
machine came there, or a column. These are searched as poses are, by the largest score of a family under flips of whole
poses, one shape after the other; the noise is what is left.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..base.names import listed
from ..base.types import Floats, Ints
from ..data import Measurements
from ..data.columns import bare
from ..evidence.fitted_run import FittedRun
from .deviations import DIRECTION, FEWEST, Deviations, Held, means_of

#: Declared noise and what repeats show may differ by this factor.
_CONTRADICTS = 3.0
#: Part of the spread up to which deviations of repeats are the same: rounding, and where a fit stopped.
_SAME = 1e-6


@dataclass(frozen=True, eq=False)
class Repeats:
    """What repeats hold: shapes in the order found, the ``p`` of the first, and the noise (columns,) that is left."""

    held: tuple[Held, ...]
    p: float
    noise: Floats
    rows: int
    unit: str

    @property
    def periods(self) -> tuple[tuple[str, float], ...]:
        """Variables with the periods at which they are in it."""
        return tuple((one.name, one.period) for one in self.held if one.period is not None and not one.by_place)

    def signature(self, run: FittedRun) -> dict[str, Any]:
        """The first shape as a diagnosis describes what no effect explains."""
        first, rows = self.held[0], np.flatnonzero(run.whole)
        known = _variables(run, rows[np.argsort(run.data.order[rows], kind="stable")])
        values = known[first.name] if first.name in known else run.data[first.name][rows]
        low, high = float(values.min()), float(values.max())
        by_axis = {bare(run.names[a]): run.per_unit * float(self.noise[a]) for a in run.axes}
        rest = float(np.sqrt(np.mean([by_axis[name] ** 2 for name in first.axes])))
        others = sum(one.size**2 for one in self.held[1:])
        return {
            "depends_on": [first.name], "shape": first.shape, "order": first.order, "period": first.period,
            "axis": list(first.axes), "share_explained": first.size**2 / (first.size**2 + others + rest**2),
            "at": first.at, "joint": None, "ranges": {first.name: (0.5 * (low + high), 0.5 * (high - low) or 1.0)},
            "indistinguishable": [], "apart": "",
        }  # fmt: skip

    def __str__(self) -> str:
        each = [f"{one} by {one.size:.3g} {self.unit}" for one in self.held]
        return listed(each) if each else "nothing that follows time, the way there, or a column"


def in_repeats(run: FittedRun, *, seed: int) -> Repeats | None:
    """Searches the deviations of repeats from their pose. None where too few poses were repeated."""
    rows = np.flatnonzero(run.whole)
    rows = rows[np.argsort(run.data.order[rows], kind="stable")]
    variables = _variables(run, rows)
    pose = np.unique(run.data.groups[rows], return_inverse=True)[1].ravel()
    repeated = np.bincount(pose)[pose] > 1
    if repeated.sum() - len(np.unique(pose[repeated])) < FEWEST:
        return None
    rows, variables = rows[repeated], {name: values[repeated] for name, values in variables.items()}
    pose = np.unique(pose[repeated], return_inverse=True)[1].ravel()
    search = Deviations(run, rows, pose, variables, _beside(run, rows), seed)
    held, p = search.find()
    return Repeats(tuple(held), p, search.noise(), len(rows), run.unit)


def same_within_poses(one: FittedRun, other: FittedRun) -> bool:
    """Whether two fits of the same rows leave the same deviations of repeats from their pose: an effect that is the
    same at each visit to a pose changes none."""
    rows, axes = np.flatnonzero(one.whole), list(one.axes)
    pose = np.unique(one.data.groups[rows], return_inverse=True)[1].ravel()
    apart = (one.residuals - other.residuals)[rows][:, axes]
    return bool((np.abs(apart - means_of(apart, pose)) <= _SAME * other.scatter[axes]).all())


def by_repeats(
    run: FittedRun, sigma: Floats, repeats: Repeats, *, declared: bool
) -> tuple[Floats, dict[str, tuple[float, float]]]:
    """The noise (columns,) of what repeats leave, where they tell it; and where they contradict what was ``declared``,
    by axis what was declared and what they show, in the unit of the run."""
    out, contradicted = sigma.copy(), {}
    for a in run.axes:
        shown, pose = float(repeats.noise[a]), run.data.pose_sigma[run.used[:, a], a]
        if declared:
            each = run.data.sigma[run.used[:, a], a]
            if not np.isfinite(each).all() or not each.any():
                continue
            said = float(np.sqrt(np.mean(each**2)))
            if 1.0 / _CONTRADICTS <= shown / said <= _CONTRADICTS:
                continue
            contradicted[bare(run.names[a])] = (run.per_unit * said, run.per_unit * shown)
        elif not repeats.held:
            continue
        out[a] = np.hypot(shown, float(np.sqrt(np.mean(pose**2))))
    return out, contradicted


def with_the_way(data: Measurements, held: Sequence[Held], run: FittedRun) -> Measurements:
    """The rows with the columns of the way there that repeats have shown to matter: suspects as any other column."""
    rows = np.arange(len(data))
    order = np.argsort(data.order, kind="stable")
    known = _way(run, rows[order])
    more = {}
    for one in held:
        if one.name in known and one.name not in data.covariates:
            values = np.empty(len(data))
            values[order] = known[one.name]
            more[one.name] = values
    return replace(data, covariates={**data.covariates, **more}) if more else data


def _way(run: FittedRun, rows: Ints) -> dict[str, Floats]:
    """How the machine came to these rows, in the order of time: the inputs of the row before, and the direction of the
    last motion of the point, a unit vector."""
    part = run.data.select(rows)
    out = {f"before_{name}": part.joints[np.maximum(np.arange(len(rows)) - 1, 0), k]
           for k, name in enumerate(part.layout.joints)}  # fmt: skip
    place = run.model.place(part, run.fit.predicted[rows], run.fit.values)
    if place:
        # the place of the pose, not of the reading: what is predicted moves with time and direction as well
        group = np.unique(part.groups, return_inverse=True)[1].ravel()
        count = np.bincount(group)
        points = np.column_stack([(np.bincount(group, values) / count)[group] for values in place.values()])
        steps = np.diff(points, axis=0, prepend=points[:1])
        moved = np.linalg.norm(steps, axis=1)
        # where nothing moved, the motion before still holds
        last = np.maximum.accumulate(np.where(moved > 0, np.arange(len(rows)), 0))
        way = (steps / np.where(moved > 0, moved, 1.0)[:, None])[last]
        out |= {f"came_{bare(name)}": way[:, k] for k, name in enumerate(place)}
    return out


def _variables(run: FittedRun, rows: Ints) -> dict[str, Floats]:
    """What readings at one pose may differ by (rows,), all of them in the order of time."""
    part = run.data.select(rows)
    out = dict(run.model.covariates(part))
    if part.time_s is None:
        out["order"] = np.asarray(part.order, dtype=float)
    for k, name in enumerate(part.layout.joints):
        out[DIRECTION + name] = part.direction[:, k]
    out = {name: values for name, values in _way(run, rows).items() if name not in out} | out
    return {name: np.asarray(v, dtype=float) for name, v in out.items() if np.isfinite(v).all() and np.ptp(v) > 0}


def _beside(run: FittedRun, rows: Ints) -> list[Floats]:
    """What a course in time may be in proportion to (rows,), from -1 to 1: the place, and every other column, as how
    fast the machine moved."""
    part = run.data.select(rows)
    if part.apart:
        # of several targets of one pose its turn makes errors in proportion to the place, of noise alone as well
        return []
    columns = {name: v for name, v in run.model.covariates(part).items() if name != "time_s"}
    known = [*run.model.place(part, run.fit.predicted[rows], run.fit.values).values(), *columns.values()]
    spans = [(np.asarray(v, dtype=float), float(np.ptp(v))) for v in known if np.isfinite(v).all()]
    return [2.0 * (v - v.min()) / span - 1.0 for v, span in spans if span > 0]
