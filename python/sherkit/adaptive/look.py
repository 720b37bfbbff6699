"""One look at the rows read so far: what they say of everything that may be missing.

The model is fitted, wrong rows are set aside, the noise is taken as the best explanation leaves it (of each axis, and
from one row to the next), and effects are searched, fitted in full and judged as a diagnosis does
(:mod:`sherkit.evidence`), over a reference that is fixed beforehand.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..base.types import Bools, Floats, Ints
from ..data import Measurements
from ..data.noise import MAD, noise_of
from ..data.noise import ReadingNoise as Weights
from ..errors import SherkitError
from ..evidence.base import Base, total
from ..evidence.blocks import Block
from ..evidence.family import Family
from ..evidence.fitted_run import FittedRun
from ..evidence.names import Names, judged_names
from ..evidence.run import Run, in_time, one_after_another
from ..evidence.sets import EffectSet, Sets
from ..evidence.thresholds import A_FEW, FAR_SIGMA, SCALES, SURE, TIED, TWIN
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


# -- The look ----------------------------------------------------------------------------------------------------------

_ROUNDS = 3


@dataclass(frozen=True, eq=False)
class InterimAnalysis:
    """What ``readings`` rows say: ``log_evidence`` that something is missing, the ``sets`` of effects that would
    explain it, best first, and what may be named (``names``) of them."""

    known: FixedBefore
    data: Measurements
    base: Base
    sets: tuple[EffectSet, ...]
    names: Names
    noise: LoopNoise

    @property
    def readings(self) -> int:
        """Rows that were read."""
        return len(self.data)

    @property
    def aside(self) -> Ints:
        """Rows (k,) that are wrong."""
        return self.noise.aside

    @property
    def run(self) -> Run:
        """The rows that are used, beside the model alone."""
        return self.base.family.run

    @property
    def fit(self) -> Fit:
        """The model alone."""
        return self.run.of.fit

    @cached_property
    def log_evidence(self) -> float:
        """The logarithm of by how much the readings favour that something is missing, physics finer than the poses
        too."""
        return float(np.logaddexp(self.base.evidence, rough_of(self.base)))

    @property
    def lead(self) -> EffectSet | None:
        """The set that leads."""
        return self.names.lead

    @property
    def best_fit(self) -> Fit:
        """With what leads, or the model alone."""
        return self.fit if self.lead is None else self.lead.run.of.fit

    @cached_property
    def rest(self) -> float:
        """By how much the readings favour that something is missing beside the leader; without one, at all."""
        return self.log_evidence if self.lead is None else float(np.logaddexp(self.lead.rest, rough_of(self.lead.base)))

    @property
    def ties(self) -> tuple[EffectSet, ...]:
        """Sets that these rows cannot tell from the leader, itself first: over a fixed reference what was expected of
        each counts, too, and not only how near it comes."""
        if self.lead is None:
            return ()
        near = {self.lead.names: self.lead}
        for one in self.names.ties:
            # at another moment an effect is the same
            if one.value > self.lead.value - TIED:
                near.setdefault(one.names, one)
        return tuple(near.values())

    @cached_property
    def ahead(self) -> float:
        """By how much the leader says more than shapes in its place: those that describe what is left without it, or
        the best one where nothing has to be described. One that holds all that the leader takes is that once more, in a
        wider form: it needs only be less likely."""
        alone, lead = self.names.alone, self.lead
        of_shapes = alone.evidence if alone.shapes else float(self.base.shapes.max(initial=-np.inf))
        if lead is None:
            return -of_shapes
        told = self.base.residual - lead.base.residual
        for wider in alone.shapes[:1]:
            basis = self.base.beside(wider).basis[:, self.base.basis.shape[1] :]
            of_shapes -= SURE if float(np.square(basis.T @ told).sum()) > TWIN * float(told @ told) else 0.0
        return lead.value + self.names.of_one_part + self.names.beside.evidence - of_shapes

    @cached_property
    def causes(self) -> dict[str, float]:
        """What would explain the readings, by name, with its value: the leader, then the best first; a leader with
        something more is no rival of it."""
        lead = self.lead
        out = {" & ".join(one.names): one.value
               for one in self.sets if lead is None or not set(lead.names) <= set(one.names)}  # fmt: skip
        first = {} if lead is None else {" & ".join(lead.names): lead.value}
        return first | dict(sorted((out | self.unknown).items(), key=lambda one: -one[1]))

    @cached_property
    def unknown(self) -> dict[str, float]:
        """What is in no catalogue and would explain the readings without any effect, by name, with its value."""
        alone = self.names.alone
        return {ROUGH: rough_of(self.base)} | (
            {" & ".join(map(called, alone.shapes[:2])): alone.evidence} if alone.shapes else {}
        )

    @cached_property
    def by_effect(self) -> dict[str, Block]:
        """Of each effect the block at its middle setting."""
        every: dict[str, list[Block]] = {}
        for block in self.base.family.blocks:
            if block.effect is not None:
                every.setdefault(block.name, []).append(block)
        return {name: some[len(some) // 2] for name, some in every.items()}

    def left(self, *blocks: Block) -> Floats:
        """What the model leaves of the columns (N, k) of these."""
        columns = self.raw(*blocks)
        return np.asarray(columns - self.base.basis @ (self.base.basis.T @ columns))

    def raw(self, *blocks: Block, at: Family | None = None) -> Floats:
        """Columns (N, k) of these, or of those in another family, as large as the reference has them."""
        family = self.base.family if at is None else at
        there = [family.blocks[family.where(block)] for block in blocks]
        each = [family.columns.of(block.at) * family.prior(block) for block in there if len(block.at)]
        return np.concatenate([np.zeros((len(family.run.residual), 0)), *each], axis=1)


def look(known: FixedBefore, data: Measurements, before: InterimAnalysis | None = None) -> InterimAnalysis:
    """Looks at rows in the order of time; the noise that the look ``before`` found is where it begins. Raises
    :class:`~sherkit.errors.FitError` where nothing can be fitted."""
    unsure = of_no_side(data)
    now = LoopNoise(unsure, np.ones(len(known.axes)), 0.0)
    if before is not None:
        now = before.noise
        with suppress(SherkitError):
            # what explained best explains the new rows, as a rule
            now = left_by(run_of_rows(known, data, now, before.best_fit), now, unsure)
    for _ in range(_ROUNDS):
        family = Family(run_of_rows(known, data, now), known.reference)
        sets = Sets(family, Base.of(family, family.run))
        then = left_by(sets.leading(sets.found).run if sets.found else family.run, now, unsure)
        if then.is_near(now):
            break
        now = then
    return InterimAnalysis(known, data, sets.base, tuple(sets.found), judged_names(sets), now)


def of_no_side(data: Measurements) -> Ints:
    """Rows (k,) of which nobody knows from which side they were approached, as the first, where joints move: lost
    motion would make another slip of them."""
    still = (data.direction == 0.0).all(axis=1)
    return np.flatnonzero(still & ~still.all())


def called(block: Block) -> str:
    """How a cause is told."""
    return block.name or (f"{block.shape} in {' and '.join(block.depends_on)}" if block.depends_on else block.shape)
