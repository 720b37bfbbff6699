"""What repeats of a pose hold, before it is called noise.

Within a pose the place is the same: how its readings differ from their mean can follow only the time, the way the
machine came there, or a column. Shapes that describe what is left say which; the noise is what they leave.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import scipy

from ..base.figures import listed, sized
from ..base.types import Floats, Ints
from ..data import Measurements
from ..data.columns import bare, unit_in
from ..data.noise import step_of
from ..errors import SherkitError
from ..evidence.base import Base
from ..evidence.blocks import Block
from ..evidence.fitted_run import FittedRun
from ..evidence.sets import ShapeDescription
from ..evidence.thresholds import HELD_EFFECT, LOUDER, NEVER
from ..fit.identify import identify
from .signature import numbers_of
from .template import course

# -- What repeats hold -------------------------------------------------------------------------------------------------

#: Declared noise and what repeats show may differ by this factor.
CONTRADICTS = 3.0
#: Visits beyond the first of each pose without which nothing is told of noise.
_FEWEST = 5
#: Part of the noise below which there is plainly less of it.
_QUIETER = 0.5


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
    common = run.white.in_common
    # what the filter made of one visit beside the others of its pose is made undone
    undone = 1.0 if common is None else 1.0 / common.times
    apart = undone * _apart(left.base.residual, len(axes), pose)
    # what was fitted takes its part of the freedom within poses as well
    free -= free * (left.base.basis.shape[1] - before.basis.shape[1]) / (len(pose) * len(axes))
    noise = run.sigma.copy()
    noise[axes] *= np.sqrt(np.square(apart).sum(axis=0) / free)
    held = []
    now = before
    for shape in left.shapes:
        then = now.beside(shape)
        columns = before.family.columns.of(shape.at)
        if HELD_EFFECT * np.square(columns).sum() < sum(np.square(_apart(c, len(axes), pose)).sum() for c in columns.T):
            taken = _apart(now.residual - then.residual, len(axes), pose)
            held.append(_told(run.of, shape, undone * np.sqrt(np.square(taken).mean(axis=0)) * run.sigma[axes]))
        now = then
    if not held:
        noise = _scatter(every, noise)
    return Repeats(tuple(held), np.maximum(noise, run.of.digits), int((count[pose] > 1).sum()))


def noise_beside(lead: FittedRun | None, sigma: Floats) -> Floats | None:
    """The noise (columns,) by repeats beside what says most of a run, where that is plainly less than ``sigma``
    (columns,) on any axis; else None."""
    if lead is None:
        return None
    noise = _scatter(lead, sigma)
    quieter = np.where(noise < _QUIETER * sigma, np.maximum(noise, lead.digits), sigma)
    return quieter if (quieter < sigma).any() else None


def _scatter(run: FittedRun, noise: Floats) -> Floats:
    """By how much repeats of a pose differ in each reading (columns,) of a run; ``noise`` where too few tell."""
    out, told = noise.copy(), run.fit.repeatability
    for a in run.axes:
        if told is not None and _freedom(run, a) >= _FEWEST:
            out[a] = told.sigma[run.data.layout.readings[a]]
    return out


def _freedom(run: FittedRun, axis: int) -> int:
    """How many visits beyond the first of each pose tell how a reading scatters."""
    told = run.fit.repeatability
    return 0 if told is None else told.degrees_of_freedom.get(run.data.layout.readings[axis], 0)


def _apart(values: Floats, axes: int, pose: Ints) -> Floats:
    """How far values (N,) of rows are from the mean of their pose (n, m)."""
    values = values.reshape(-1, axes)
    count = np.bincount(pose)
    return values - np.stack([np.bincount(pose, one) / count for one in values.T], axis=1)[pose]


def _told(run: FittedRun, shape: Block, size: Floats) -> str:
    """A shape of this size (m,) on each axis, in words."""
    most = [a for a, one in zip(run.axes, size.tolist(), strict=True) if 2.0 * one > size.max()]
    told = course({**numbers_of(shape, [bare(run.names[a]) for a in most]), "joint": None})
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
        free = _freedom(run, a)
        chance = np.sqrt(scipy.special.chdtri(free, NEVER) / free) if free >= _FEWEST else np.inf
        most = min(CONTRADICTS, max(LOUDER, float(chance)))
        if not 1.0 / CONTRADICTS <= shown / said <= most:
            out[bare(run.names[a])] = (run.per_unit * said, run.per_unit * shown)
    return out


# -- Digits that a file leaves out -------------------------------------------------------------------------------------
# Digits that a file leaves out: columns that stand in steps, and what these alone do to what a fit leaves.
#
# A joint that is written in steps of g is wrong by up to g/2, the same whenever the robot stands there; a reading
# is rounded after its noise, so that repeats agree on a part of the error that grows as the noise gets small.
# Source: Widrow and Kollár, *Quantization Noise* (2008), chapters 4 and 5: the variance g²/12, and the
# characteristic function from which shared_by_repeats follows.

#: What is left beyond noise is that of steps where it has this part of its square at least, at most this many
#: of it; of what is left with a noise that nobody knows, this part.
_SHARE = (0.5, 1.7)
_SHARE_WITH_NOISE = 0.25
#: Digits are looked at where rounding alone has this part of what is left at least, and were cut off where all poses
#: together are so much likelier once they are put back, as twice a logarithm.
_CUT = 0.1
_LIKELIER = 30.0
#: Rows that tell how a joint moves a reading.
_ROWS = 2000
#: Terms of a series whose terms fall at least as 1/k²: what is cut off is less than 1 % of its sum.
_TERMS = 200


@dataclass(frozen=True)
class Rounded:
    """Columns that stand in steps, and the error per reading that these alone would leave, in the unit of the run."""

    steps: tuple[str, ...]
    size: float
    unit: str
    joints: bool
    cut: bool = False

    def __str__(self) -> str:
        cure = (
            "write joints with all the digits that the encoders give; if the robot was exactly there, look elsewhere"
            if self.joints else "write what the instrument read with all its digits"
        )  # fmt: skip
        how = ", cut off rather than rounded" if self.cut else ""
        return f"{'; '.join(self.steps)}{how}: that alone leaves {self.size:.2g} {self.unit}; {cure}"


def shared_by_repeats(step: float, spread: float) -> float:
    """The standard deviation of the error that rounding to ``step`` leaves in the mean of many repeats, where these
    differ by ``spread``.

    Of Gaussian noise σ the mean error at a place is a Fourier series in the place, with the variance
    B² = g²/(2π²) Σ exp(-(2πkσ/g)²)/k²; repeats then differ by σ² + g²/12 - B² (Widrow and Kollár, 4.3 and 5).
    """
    k = np.arange(1, _TERMS)

    def square(sigma: float) -> float:
        return float(step**2 / (2 * np.pi**2) * (np.exp(-((2 * np.pi * k * sigma / step) ** 2)) / k**2).sum())

    def beyond(sigma: float) -> float:
        return sigma**2 + step**2 / 12 - square(sigma) - spread**2

    if beyond(0.0) >= 0:
        return float(np.sqrt(square(0.0)))
    return float(np.sqrt(square(float(scipy.optimize.brentq(beyond, 0.0, spread + step)))))


def rounded(run: FittedRun, beyond: float, sigma: Floats, *, noise_known: bool) -> Rounded | None:
    """What columns in steps leave, where that is as much as what is left ``beyond`` the noise, the RMS of readings in
    the unit of the run; else None. ``sigma`` (columns,) is the noise of a reading; where it is not known, what is left
    has it in it."""
    axes = list(run.axes)
    rows = np.flatnonzero(run.whole)
    data = run.data.select(rows[np.unique(np.linspace(0, len(rows) - 1, min(len(rows), _ROWS)).astype(np.int64))])
    least = _SHARE[0] if noise_known else _SHARE_WITH_NOISE
    by_joints = _of_joints(run, data, run.data.joints[rows])
    by_readings = {}
    for a in axes:
        step = step_of(run.data.readings[rows, a])
        left = shared_by_repeats(step, float(sigma[a])) if noise_known and step else step / np.sqrt(12.0)
        by_readings[run.data.layout.readings[a]] = (step, left * run.per_unit)
    for joints, parts in ((True, by_joints), (False, by_readings)):
        square = sum(left**2 for _, left in parts.values())
        if 0 < least * beyond**2 <= square <= _SHARE[1] * beyond**2:
            return Rounded(_steps_in_words(parts, square), float(np.sqrt(square)), run.unit, joints)
    return None


@dataclass(frozen=True)
class RoundingSteps:
    """What columns in steps leave, what a fit ``left`` in all, and where the columns fit better ``put_back`` by half a
    step, that fit."""

    rounded: Rounded
    left: float
    put_back: FittedRun | None

    @property
    def alone(self) -> bool:
        """Whether they are most of all that is left; far larger ones are those of a grid of round numbers, to which the
        robot was sent."""
        return _SHARE[0] * self.left**2 <= self.rounded.size**2 <= _SHARE[1] * self.left**2


def steps_in(run: FittedRun) -> RoundingSteps | None:
    """Columns whose steps are most of all that a fit leaves, noise and all, or which were cut off to them; else None.

    On a grid such errors repeat from place to place and look like physics. Digits that were cut off leave four times as
    much of the square as digits that were rounded, the same way everywhere or towards zero: columns are put back by
    half a step, and it is seen whether that was left.
    """
    rows = np.flatnonzero(run.whole)
    data = run.data.select(rows[np.unique(np.linspace(0, len(rows) - 1, min(len(rows), _ROWS)).astype(np.int64))])
    readings = len(np.unique(run.data.standing[rows])) * len(run.axes)
    by_readings = {}
    for a in run.axes:
        step = step_of(run.data.readings[rows, a])
        by_readings[run.data.layout.readings[a]] = (step, step * run.per_unit / np.sqrt(12.0))
    out = []
    for joints, parts in ((True, _of_joints(run, data, run.data.joints[rows])), (False, by_readings)):
        size = float(np.sqrt(sum(one**2 for _, one in parts.values())))
        best, put_back = _rms(run), None
        if size == 0 or size < best * _CUT:
            continue
        each = np.array([step for step, _ in parts.values()])
        for towards_zero in (False, True):
            there = _put_back(run, each, joints=joints, towards_zero=towards_zero)
            if there is not None and readings * np.log(best / max(_rms(there), 1e-300)) > _LIKELIER / 2.0:
                best, put_back = _rms(there), there
        told = Rounded(_steps_in_words(parts, size**2), size, run.unit, joints, put_back is not None)
        out.append(RoundingSteps(told, best, put_back))
    return next((one for one in out if one.alone), next((one for one in out if one.put_back), None))


def _rms(run: FittedRun) -> float:
    """What a fit leaves, RMS of readings in the unit of the run."""
    return run.per_row * float(np.sqrt(np.mean(run.residuals[run.whole][:, list(run.axes)] ** 2)))


def _put_back(run: FittedRun, steps: Floats, *, joints: bool, towards_zero: bool) -> FittedRun | None:
    """The fit to columns that are half a step higher, or half a step farther from zero; None where there is none."""
    data, axes = run.data, list(run.axes)
    columns = data.joints if joints else data.readings[:, axes]
    moved = columns + 0.5 * steps * (np.sign(columns) if towards_zero else 1.0)
    if joints:
        changed = replace(data, joints=np.ascontiguousarray(moved))
    else:
        readings = data.readings.copy()
        readings[:, axes] = moved
        changed = replace(data, readings=np.where(data.taken, readings, 0.0))
    try:
        return FittedRun(identify(run.model, changed, noise=run.fit.noise, start=run.fit.values))
    except SherkitError:
        return None


def _of_joints(run: FittedRun, data: Measurements, joints: Floats) -> dict[str, tuple[float, float]]:
    """The step of each joint (k, joints) and what it leaves, RMS of readings, in the unit of the run."""
    out = {}
    for j, name in enumerate(data.layout.joints):
        step = step_of(joints[:, j])
        half = np.zeros(joints.shape[1])
        half[j] = 0.5 * step
        try:
            ends = [
                run.model.predict(replace(data, joints=data.joints + s * half), run.fit.values) for s in (-1.0, 1.0)
            ]
        except SherkitError:
            # a place that the robot cannot reach
            return {}
        moved = (ends[1] - ends[0])[:, list(run.axes)]
        out[name] = (step, run.per_row * float(np.sqrt(np.mean(moved**2) / 12.0)))
    return out


def _steps_in_words(parts: dict[str, tuple[float, float]], square: float) -> tuple[str, ...]:
    """Columns that matter, by their step."""
    told: dict[str, list[str]] = {}
    for name, (step, left) in parts.items():
        if left**2 > 0.02 * square:
            told.setdefault(sized(step, unit_in(name)), []).append(name)
    verb = {True: "stands", False: "stand"}
    return tuple(f"{listed(names)} {verb[len(names) == 1]} in steps of {step}" for step, names in told.items())
