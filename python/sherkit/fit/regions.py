"""Held out means elsewhere too: the error of a fit in whole regions of its joints' space that it did not see.

Poses are halved across their widest direction in standardised joints, and each half again (a k-d tree on principal
axes: Sproull, Algorithmica 1991), into four regions that are compact and alike in number. Each is left out whole and
predicted by the fit to the rest (Roberts et al., "Cross-validation strategies for data with temporal, spatial …
structure", Ecography 2017: blocks as large as the steps from what is measured to what is asked). Beside it stands the
drawing, of which the rest tells where the instrument and the target are, and nothing else. All is linear around the
full fit, as in :mod:`.error`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..base import linalg
from ..base.figures import finite, number
from ..base.types import Bools, Floats, Ints
from ..data import Measurements
from ..errors import FitError
from ..model.base import ModelWithEffects
from .error import ErrorSize, FitLike, axes_of, known_deviations, sigma_of
from .folds import Folds, blocks

# -- Regions -----------------------------------------------------------------------------------------------------------

#: How often poses are halved, into how many regions; and the poses that each must have.
_HALVINGS, _POSES = 2, 6
REGIONS = 2**_HALVINGS
#: Rows that are looked at, at most: more tell the same.
_MOST = 600
#: Readings that the rest must hold for each parameter.
_READINGS = 2.0
#: By how much a fit must be worse than the drawing in one region to count as worse: less is chance.
_WORSE = 1.2
#: By how much an error in regions is much larger than one between poses: with the right model it is within a half.
_MUCH = 2.0


@dataclass(frozen=True, eq=False)
class Elsewhere:
    """Errors where a fit saw nothing: ``error`` of the fit and ``drawing`` of the drawing over all left-out regions,
    and the root mean squares of each region (r,), ``by_region`` and ``drawing_by_region``, in the same unit. ``about``
    says of each by which joint it stands apart, and where that is."""

    error: ErrorSize
    drawing: ErrorSize
    by_region: Floats
    drawing_by_region: Floats
    about: tuple[str, ...]

    @property
    def is_worse(self) -> bool:
        """Whether the drawing is nearer in a region, by more than chance: then what the rest says is not carried so
        far."""
        return bool((self.by_region > _WORSE * self.drawing_by_region).any())

    def beside(self, home: ErrorSize) -> float:
        """How many times as large the error in regions is as that between poses, at least one."""
        known = home.held_out and 0.0 < home.rms < np.inf and np.isfinite(self.error.rms)
        return max(self.error.rms / home.rms, 1.0) if known else 1.0

    def sentence(self, home: ErrorSize) -> str:
        """What a person must know of it beside the error ``home`` between poses; empty where there is nothing."""
        unit = self.error.unit
        if self.is_worse:
            k = int(np.argmax(self.by_region / np.maximum(self.drawing_by_region, 1e-300)))
            return (
                f"Where {self.about[k]}, left out whole, the fit to the rest is off by {number(self.by_region[k])} "
                f"{unit} RMS and the drawing by {number(self.drawing_by_region[k])}: the calibration does not hold "
                "away from the poses measured."
            )
        if home.held_out and self.error.rms > _MUCH * home.rms:
            k = int(np.argmax(self.by_region))
            return (
                f"Regions left out whole are off by {number(self.error.rms)} {unit} RMS, poses among others by "
                f"{number(home.rms)}; most where {self.about[k]}: away from the poses measured the calibration is that "
                "much worse."
            )
        return ""

    def to_json(self) -> dict[str, Any]:
        """For programs."""
        return {
            "regions": len(self.by_region), "error": self.error.to_json(), "drawing": self.drawing.to_json(),
            "by_region": [finite(v) for v in self.by_region.tolist()],
            "drawing_by_region": [finite(v) for v in self.drawing_by_region.tolist()],
            "about": list(self.about),
        }  # fmt: skip


#: What to do about what :meth:`Elsewhere.sentence` says, of a fit without priors and of one with them.
TO_DO = {
    False: "Measure where it is to work, or take the drawing as one more measurement: sherkit calibrate --priors.",
    True: "Measure where it is to work.",
}


def regions_of(data: Measurements, rows: Ints) -> Ints | None:
    """The region (k,) of each of these ``rows`` (k,), repeats of a pose in one; None where poses or joints are too
    few to make any."""
    if not data.layout.joints:
        return None
    _, first, pose = np.unique(data.standing[rows], return_index=True, return_inverse=True)
    joints = data.joints[rows][first]
    joints = joints[:, np.isfinite(joints).all(axis=0)]
    spread = joints.std(axis=0)
    moved = spread > 1e-9 * np.maximum(np.abs(joints).max(axis=0, initial=0.0), 1.0)
    if not moved.any() or len(joints) < _POSES * REGIONS:
        return None
    return _halved(joints[:, moved] / spread[moved], _HALVINGS)[pose.ravel()]


def some_of(data: Measurements, rows: Ints) -> Ints:
    """These rows; of many as many poses, evenly among all, as tell the same."""
    pose = np.unique(data.standing[rows], return_inverse=True)[1].ravel()
    if len(rows) <= _MOST:
        return rows
    count = pose.max() + 1
    kept = np.unique(np.linspace(0, count - 1, max(_MOST * count // len(rows), 2)).astype(np.int64))
    return rows[np.isin(pose, kept)]


def _about(data: Measurements, rows: Ints, region: Ints) -> tuple[str, ...]:
    """Of each region the joint by which it stands farthest from the middle, and where that is."""
    joints = data.joints[rows]
    middle, spread = np.nanmean(joints, axis=0), np.nanstd(joints, axis=0)
    out = []
    for k in range(region.max() + 1):
        there = np.nanmean(joints[region == k], axis=0)
        j = int(np.argmax(np.nan_to_num(np.abs(there - middle) / np.where(spread > 0, spread, np.inf))))
        out.append(f"{data.layout.joints[j]} is about {there[j]:.3g}")
    return tuple(out)


def _halved(points: Floats, times: int) -> Ints:
    """A number for each point (k, d): halves across the widest direction, and those again."""
    if not times:
        return np.zeros(len(points), dtype=np.int64)
    centred = points - points.mean(axis=0)
    _, axes = linalg.eigh(centred.T @ centred)
    # by digits that no rounding changes, then in the order of the rows
    along = np.round(centred @ axes[:, -1], 9)
    upper = np.argsort(np.argsort(along, kind="stable"), kind="stable") >= len(points) // 2
    out = np.zeros(len(points), dtype=np.int64)
    for side, inside in enumerate((~upper, upper)):
        out[inside] = 2 ** (times - 1) * side + _halved(points[inside], times - 1)
    return out


@linalg.one_thread()
def errors_elsewhere(fit: FitLike) -> Elsewhere | None:
    """The errors of a fit and of the drawing in each region that is left out; None where there are too few poses, or no
    joint that moved."""
    model, data = fit.model, fit.data
    used = data.used & np.isfinite(fit.residuals)
    rows = some_of(data, np.flatnonzero(used.any(axis=1)))
    region = regions_of(data, rows) if len(rows) else None
    if region is None:
        return None
    rest = used[rows].sum() - np.bincount(region, used[rows].sum(axis=1)).max()
    if rest < _READINGS * len(fit.values):
        return None
    start, some = model.start(data), data.select(rows)
    try:
        drawn = some.readings - model.predict(some, start)
    except FitError:
        return None
    sigma, there = sigma_of(fit, used), used[rows] & np.isfinite(drawn)
    weight = np.where(there, 1.0 / sigma, 0.0)
    frame = frame_parameters(model)

    def squares(values: Floats, residuals: Floats, which: Ints, known: Floats | None) -> Floats:
        left = np.where(there, residuals, 0.0) * weight
        if len(which):
            by_model = model.linearised_by_blocks(some, values)
            left = _left_out(lambda part: by_model(part).parameters[:, :, which] * weight[part, :, None], left, region,
                             known)  # fmt: skip
        return np.where(there, (left * data.layout.per_unit * sigma) ** 2, np.nan)

    every = np.arange(len(fit.values))
    both = [squares(fit.values, fit.residuals[rows], every, known_deviations(fit)), squares(start, drawn, frame, None)]
    errors = [
        ErrorSize.of(one, data.layout.unit, held_out=True, names=data.layout.readings, together=axes_of(data))
        for one in both
    ]
    own = list(axes_of(data))
    each = [
        np.array([np.sqrt(np.nanmean(np.nansum(one[region == k][:, own], axis=1))) for k in range(region.max() + 1)])
        for one in both
    ]
    return Elsewhere(errors[0], errors[1], each[0], each[1], _about(data, rows, region))


def frame_parameters(model: Any) -> Ints:
    """Which parameters say only where the instrument stands and where its target sits, whatever the robot is."""
    own = {*model.free_of_pose, *model.targets_anywhere}
    for effect in (*model.effects, *getattr(model, "set_ups", ())):
        if effect.name in model.within or effect not in model.effects:
            own |= {p.name for p in effect.qualified()}
    return np.array([k for k, p in enumerate(model.parameters) if p.name in own], dtype=np.int64)


def _left_out(columns: Callable[[slice], Floats], residual: Floats, region: Ints, known: Floats | None) -> Floats:
    """What is left of a residual (k, m) in each region by the fit to the others."""
    folds = Folds.of(columns, residual, region[None], known)
    return np.concatenate([folds.errors(columns(part), residual[part], part)[0] for part in blocks(len(residual))])


# -- How well a drawing holds ------------------------------------------------------------------------------------------
# How well a drawing holds, told by the readings: the part of the plausible sizes by which parameters are off it.
#
# Sizes of a kind of robot are those of any shop's; one maker's arm may hold a tenth of them. Among parameters that
# the readings tell, moves from the drawing show how large such moves are, and the others are held as closely:
# empirical Bayes (Morris, "Parametric empirical Bayes inference", JASA 1983), by the evidence of one part for all
# parameters with where the instrument stands projected out (restricted likelihood: Patterson and Thompson,
# Biometrika 1971), linear around a fit. A part as plausible before any row is read as its own logarithm is near
# zero: where readings tell nothing, sizes stay as they are.

#: Parts that are asked for: what is known better is measured, and says so in the robot's file; what is farther off is
#: another robot.
_LEAST, _LARGEST = 1e-2, 4.0
#: So many of them, each a hundredth larger than the one before.
_PARTS = 600
#: Part of a column's square that what projected it out must leave.
_LEFT = 1e-9


def scaled_sizes(model: ModelWithEffects, part: float) -> Floats:
    """Plausible sizes (p,), those of the drawing times a part."""
    size = np.array([p.size for p in model.parameters])
    return np.where(drawn_by(model), part * size, size) if part != 1.0 else size


def sizes_told(model: ModelWithEffects, sizes: Floats, values: Floats) -> Floats:
    """Sizes (p,) of which those of an effect follow what readings find of it, where that is more: no drawing says how
    large an effect is that is there, and one held to the size that is usual would be found too small."""
    out, names = sizes.copy(), np.array([p.name.partition(".")[0] for p in model.parameters])
    anywhere = frame_parameters(model)
    for name in {e.name for e in model.effects if e.name not in model.within}:
        own = np.setdiff1d(np.flatnonzero(names == name), anywhere)
        if len(own):
            out[own] *= max(float(np.sqrt(np.mean(np.square(values[own] / sizes[own])))), 1.0)
    return out


def in_plausible_sizes(basis: Floats, model: ModelWithEffects, sizes: Floats) -> Floats:
    """Directions (m, p), orthonormal in these ``sizes`` (p,), in plausible ones."""
    plausible = scaled_sizes(model, 1.0)
    if not len(basis) or (sizes == plausible).all():
        return basis
    turned, _ = linalg.qr((basis * sizes / plausible).T)
    return np.asarray(turned.T)


def drawn_by(model: ModelWithEffects) -> Bools:
    """Which parameters (p,) a drawing states: none of an effect, of the instrument, or that somebody has measured."""
    drawn = np.array([not p.known for p in model.parameters], dtype=bool)
    drawn[len(model.bare) :] = False
    drawn[frame_parameters(model)] = False
    return drawn


def part_of(fit: FitLike) -> float:
    """The part of the plausible sizes that the readings of a fit find most likely."""
    own = drawn_by(fit.model)
    if not own.any():
        return 1.0
    gram, right, squares, free = _projected(fit, own)
    size = np.array([p.size for p in fit.model.parameters])[own]
    values, axes = linalg.eigh(gram * np.outer(size, size))
    seen = values > _LEFT * max(float(values[-1]), 1e-300)
    numbers, free = free, free - int(seen.sum())
    if free <= 0 or not seen.any():
        return 1.0
    told = values[seen]
    along = np.square(axes[:, seen].T @ (size * right)) / told
    rest = max(squares - float(along.sum()), 0.0)
    # readings scatter no less than they are known to
    least = 1.0 if fit.noise.origin != "unknown" else 1e-300

    # of parts that are so many times the deviation of a reading, the likeliest noise, and minus the log evidence
    ratio = np.geomspace(_LEAST, _LARGEST, _PARTS) / np.sqrt(max(rest / free, least))
    spread = 1.0 + np.multiply.outer(ratio**2, told)
    left = rest + (along / spread).sum(axis=1)
    noise = np.maximum(left / numbers, least)
    part = ratio * np.sqrt(noise)
    against = numbers * np.log(noise) + left / noise + np.log(spread).sum(axis=1) + np.log(part) ** 2
    return float(np.clip(part[np.argmin(against)], _LEAST, _LARGEST))


def _projected(fit: FitLike, own: Bools) -> tuple[Floats, Floats, float, int]:
    """Products of the columns of these parameters (k,) with each other (k, k) and with what was read beside the drawing
    (k,), its square, and how many numbers are left, over the noise; without what the other columns take."""
    model, data = fit.model, fit.data
    used = data.used & np.isfinite(fit.residuals)
    rows = some_of(data, np.flatnonzero(used.any(axis=1)))
    weight = np.where(used, 1.0 / fit.noise.sigma, 0.0)[rows]
    left = np.where(used, fit.residuals, 0.0)[rows]
    columns = model.linearised_by_blocks(data.select(rows), fit.values)
    total = np.zeros((len(own) + 1,) * 2)
    for some in blocks(len(rows)):
        by = columns(some).parameters
        beside = left[some] + by[:, :, own] @ fit.values[own]
        whole = np.concatenate([by, beside[:, :, None]], axis=2) * weight[some, :, None]
        whole = whole.reshape(-1, len(total))
        total += whole.T @ whole
    kept, other = np.append(np.flatnonzero(own), len(own)), np.flatnonzero(~own)
    length = np.sqrt(np.maximum(np.diag(total)[other], 1e-300))
    value, turn = linalg.eigh(total[np.ix_(other, other)] / np.outer(length, length))
    seen = value > _LEFT * max(float(value[-1]), 1e-300) if len(value) else np.zeros(0, dtype=bool)
    across = (turn[:, seen] / np.sqrt(value[seen])).T @ (total[np.ix_(other, kept)] / length[:, None])
    rest = total[np.ix_(kept, kept)] - across.T @ across
    return rest[:-1, :-1], rest[:-1, -1], float(rest[-1, -1]), int(used[rows].sum()) - int(seen.sum())
