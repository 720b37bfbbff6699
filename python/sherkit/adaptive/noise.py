"""The noise of a loop's readings, as an explanation leaves it, and the rows that stand apart."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..base.types import Bools, Floats, Ints
from ..data import Measurements
from ..data.noise import MAD, noise_of
from ..data.noise import ReadingNoise as Weights
from ..evidence.base import Base, total
from ..evidence.fitted_run import FittedRun
from ..evidence.run import Run, in_time, one_after_another
from ..evidence.thresholds import A_FEW, FAR_SIGMA, SCALES
from ..evidence.whitening import Whitening, correlation_in_time, orthonormal
from ..fit.identify import Fit, identify
from .known import FixedBefore

# -- An error at each pose ---------------------------------------------------------------------------------------------
# Errors that are another one at each pose: told from noise by poses that are read more than once.

#: What has no shape that these poses could tell: another error at each of them, the same when it is read once more; and
#: the logarithm of its weight.
ROUGH, ROUGH_WEIGHT = "something finer than these poses", float(np.log(0.01))


@dataclass(frozen=True)
class Agreement:
    """How a residual divides: what it leaves ``between`` poses and ``within`` them, from reading to reading, with
    degrees of freedom; a pose has ``times`` readings on average."""

    between: float
    within: float
    between_free: int
    within_free: int
    times: float

    @classmethod
    def of(cls, residual: Floats, pose: Ints, free: int) -> Agreement:
        """Of a residual (N,) of ``free`` degrees of freedom, by the numbers (N,) of poses."""
        count = np.bincount(pose)
        poses = int(np.count_nonzero(count))
        within = residual - (np.bincount(pose, residual) / np.maximum(count, 1))[pose]
        squares = float(within @ within)
        within_free = len(pose) - poses
        left = max(float(residual @ residual) - squares, 0.0)
        return cls(left, squares, free - within_free, within_free, len(pose) / max(poses, 1))

    @property
    def log_bf(self) -> float:
        """The logarithm of the Bayes factor of an error of its own at each pose, against noise alone.

        Where errors of poses have a variance of τ² noises, what is left between poses is χ² of 1 + τ² ``times`` the
        noise, and what is left within them of the noise alone: the lack-of-fit test of the field (Draper and Smith,
        *Applied Regression Analysis*, 1998, 2.1), with a prior on τ so that it may be looked at as often as one likes.
        """
        if self.within_free <= 0 or self.between_free <= 0 or not (self.between > 0 and self.within > 0):
            return 0.0
        grown = 1.0 + np.square(SCALES) * self.times
        ratios = (self.between + self.within) / (self.between / grown + self.within)
        free = self.between_free + self.within_free
        each = -0.5 * self.between_free * np.log(grown) + 0.5 * free * np.log(ratios)
        return total(each) - float(np.log(len(SCALES)))


def agreement_of(base: Base) -> Agreement:
    """How what a model leaves divides."""
    m = base.family.run.axes
    each = base.family.run.poses[:, None] * m + np.arange(m)
    return Agreement.of(base.residual, each.ravel(), base.free)


def rough_of(base: Base) -> float:
    """The logarithm of weight times Bayes factor of another error at each pose."""
    return agreement_of(base).log_bf + ROUGH_WEIGHT


# -- Noise -------------------------------------------------------------------------------------------------------------

#: Readings beyond the parameters from which rows can be told to be wrong; noise that is the same.
BEYOND, _SAME = 8, 0.1
#: Part of the rows of a beginning or an end that is far off where they are no accidents.
_NEARLY_ALL = 0.8
#: Plausible sizes are knowledge where readings are fewer than so many times the parameters.
_FEW = 3.0
#: Readings from which on there may be a verdict, and the course of the noise is looked at.
FEWEST = 24
#: Readings that stand for "all axes alike".
_ALIKE = 20.0


@dataclass(frozen=True, eq=False)
class LoopNoise:
    """Rows (k,) that are set ``aside``, the noise ``sigma`` (m,) of the axes, one on average, and how much of it a row
    hands on to the next, ``rho``."""

    aside: Ints
    sigma: Floats
    rho: float

    def is_near(self, other: LoopNoise) -> bool:
        """Whether a look would be the same."""
        same = (np.abs(np.log(self.sigma / other.sigma)) < _SAME).all() and abs(self.rho - other.rho) < _SAME
        return bool(same) and np.array_equal(self.aside, other.aside)


def run_of_rows(known: FixedBefore, data: Measurements, noise: LoopNoise, like: Fit | None = None) -> Run:
    """The rows as the model, or that of another fit from its values, sees them."""
    data = data.mark_outliers(noise.aside) if len(noise.aside) else data
    axes = list(known.axes)
    used = data.used[:, axes]
    declared, over = noise_of(data), np.ones_like(data.readings)
    over[:, axes] = noise.sigma
    if declared.origin == "declared" and used.any():
        each = declared.sigma[:, axes]
        over[:, axes] *= each / np.exp(np.mean(np.log(each[used])))
    model, start = (known.model, None) if like is None else (like.model, like.values)
    # with knowledge of plausible sizes where readings are few
    few = bool(used.sum() < _FEW * len(model.parameters))
    of = FittedRun(identify(model, data, noise=Weights(over, "unknown"), priors=few, start=start))
    rows, sigma = in_time(of, np.arange(len(data))), np.ones(over.shape[1])
    sigma[axes] = noise.sigma
    view = of.linearised(rows, of.catalogue if like is None else (), noise.sigma)
    return Run(of, rows, sigma, view, Whitening(noise.rho, *one_after_another(data.order, data.series, rows)))


def left_by(run: Run, now: LoopNoise, unsure: Ints) -> LoopNoise:
    """What this fit of rows leaves, each reading over what its own weight in the fit takes from it."""
    basis, m = orthonormal(run.view.fitted(run.view.whole)), run.axes
    lever = np.square(basis).sum(axis=1).reshape(-1, m)
    left = run.view.residual / np.sqrt((1.0 - lever).clip(0.02))
    # rows that stand apart from all others, be they set aside already or not
    wrong, spread = np.zeros(0, dtype=np.int64), MAD * float(np.median(np.abs(left)))
    if left.size > len(run.of.fit.values) + BEYOND and spread > 0:
        off = np.nan_to_num(run.of.fit.residuals[:, list(run.of.axes)]) / now.sigma
        off[run.rows] = left
        wrong = np.flatnonzero(accidents((np.abs(off) > FAR_SIGMA * spread).any(axis=1)))
        # what most rows do is no accident of a few: a channel that sticks, one that is read a row late
        wrong = wrong if 2 * len(wrong) <= len(off) else wrong[:0]
    wrong = np.union1d(wrong, unsure)
    # the noise of each axis, drawn towards that of all while rows are few; leverage is in the residuals already
    each = np.square(left * now.sigma).mean(axis=0)
    if not each.any():
        return LoopNoise(wrong, now.sigma, 0.0)
    free, pooled = max(len(left) - basis.shape[1] / m, 1.0), float(each.mean())
    drawn = np.exp((free * np.log(np.maximum(each, 1e-12 * pooled)) + _ALIKE * np.log(pooled)) / (free + _ALIKE))
    told = run.view.time is not None and len(left) >= FEWEST
    rho = correlation_in_time(run.view.residual, basis, run.white.back) if told else 0.0
    return LoopNoise(wrong, np.sqrt(drawn / np.exp(np.mean(np.log(drawn)))), rho)


def accidents(far: Bools) -> Bools:
    """Those of rows in the order of time that are ``far`` off (n,) that are no beginning and no end of the run: what
    nearly all rows do from a moment on is news."""
    out, every = far.copy(), np.arange(len(far))
    for rows in (every, every[::-1]):
        end = int(np.argmax(np.cumsum(np.where(far[rows], 1, -1)))) + 1
        if end >= A_FEW and far[rows[:end]].mean() >= _NEARLY_ALL:
            out[rows[:end]] = False
    return out
