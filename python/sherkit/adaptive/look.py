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

from ..base.types import Floats, Ints
from ..data import Measurements
from ..errors import SherkitError
from ..evidence.base import Base
from ..evidence.blocks import Block
from ..evidence.family import Family
from ..evidence.names import Names, judged_names
from ..evidence.run import Run
from ..evidence.sets import EffectSet, Sets
from ..evidence.thresholds import SURE, TIED, TWIN
from ..fit.identify import Fit
from .known import FixedBefore
from .noise import ROUGH, LoopNoise, left_by, rough_of, run_of_rows

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
