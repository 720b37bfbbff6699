"""One look at the rows read so far: what they say of everything that may be missing.

The model is fitted, wrong rows are set aside, the noise is taken as the best explanation leaves it (of each axis, and
from one row to the next), everything is weighed beside the model (:mod:`sherkit.evidence`), and the first effects are
fitted in full: what an effect leaves to first order about the drawing is no judgement on it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..base.types import Floats, Ints
from ..data import Measurements
from ..evidence import thresholds
from ..evidence.base import Base
from ..evidence.blocks import Block
from ..evidence.family import Family
from ..evidence.run import Run
from ..evidence.sets import ONE_MORE, EffectSet, Sets
from ..evidence.settings import refined
from ..fit.identify import Fit
from .known import FixedBefore
from .noise import ROUGH, LoopNoise, expected, left_by, rough_of, run_of_rows

_ROUNDS = 3
#: Sets that are fitted in full: at most so many, within this of the best (a logarithm).
_FULL, _NEAR = 4, 12.0
#: Pairs looked at: of the first so many effects, and shapes, with every other.
_FIRST, _FIRST_SHAPES = 5, 2
#: Evidence from which on pairs are looked at and effects fitted in full.
_WORTH = np.log(5.0)
#: The part of a set that another one must hold to be that once more, in a wider form.
_HOLDS = 0.98
#: By how much one set must be likelier than another to be far better, and what may be left beside one that leaves
#: nothing (logarithms).
FAR, LEFT = thresholds.TIED, float(np.log(20.0))

#: A cause by name, at what it is set to; of a set all of them.
Key = tuple[str, float | None]
Keys = tuple[Key, ...]


@dataclass(frozen=True, eq=False)
class FittedSet:
    """A set of effects in the model, fitted in full: ``log_bf`` against the model alone, ``rest`` what is left beside
    it, as the logarithm of a mean Bayes factor over all others."""

    keys: Keys
    of: EffectSet
    log_bf: float
    rest: float

    @property
    def fit(self) -> Fit:
        """The fit."""
        return self.of.run.of.fit

    @property
    def names(self) -> tuple[str, ...]:
        """Of the effects, in the order of their names."""
        return tuple(sorted(name for name, _ in self.keys))


@dataclass(frozen=True, eq=False)
class InterimAnalysis:
    """What ``readings`` rows say: ``log_evidence`` that something is missing, ``sets`` with the logarithm of weight
    times Bayes factor, best first, ``fitted`` the first of them in full."""

    known: FixedBefore
    data: Measurements
    base: Base
    log_evidence: float
    sets: tuple[tuple[Keys, float], ...]
    fitted: tuple[FittedSet, ...]
    noise: LoopNoise
    blocks: Mapping[Key, Block]

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
    def by_effect(self) -> dict[str, Block]:
        """Of each effect the block at its middle setting."""
        every: dict[str, list[Block]] = {}
        for block in self.base.family.blocks:
            if block.effect is not None:
                every.setdefault(block.name, []).append(block)
        return {name: some[len(some) // 2] for name, some in every.items()}

    def of(self, keys: Keys) -> list[Block]:
        """The blocks of a set."""
        return [self.blocks[key] for key in keys]

    def is_shape(self, keys: Keys) -> bool:
        """Whether a set is a shape of what is in no catalogue."""
        return any(self.blocks[key].effect is None for key in keys)

    @cached_property
    def effects(self) -> tuple[tuple[Keys, float], ...]:
        """The sets that explain, best first."""
        return tuple((keys, value) for keys, value in self.sets if not self.is_shape(keys))

    @cached_property
    def shapes(self) -> tuple[tuple[Keys, float], ...]:
        """The sets with a shape in them, best first."""
        return tuple((keys, value) for keys, value in self.sets if self.is_shape(keys))

    def shape_beside(self, explaining: Sequence[Keys]) -> tuple[Keys, float]:
        """The best set with a shape that is not one of these and something besides. One that holds all that the first
        of them does is that once more, in a wider form: it needs only be less likely."""
        names = [{name for name, _ in keys} for keys in explaining]
        best: tuple[Keys, float] = (), -np.inf
        for keys, value in self.shapes:
            if value <= best[1]:
                break
            if not any(one <= {name for name, _ in keys} for one in names):
                lower = value - thresholds.SURE if explaining and self.holds(keys, explaining[0]) else value
                best = max(best, (keys, lower), key=lambda one: one[1])
        return best

    def holds(self, wider: Keys, keys: Keys) -> bool:
        """Whether what a set takes of the readings could be taken by another one as well, whatever it takes."""
        narrow, wide = (self.base.beside(*self.of(some)) for some in (keys, wider))
        told, beside = self.base.residual - narrow.residual, wide.basis[:, self.base.basis.shape[1] :]
        return float(np.square(beside.T @ told).sum()) > _HOLDS * float(told @ told)

    def left(self, *blocks: Block) -> Floats:
        """What the model leaves of the columns (N, k) of these."""
        columns = self.raw(*blocks)
        return np.asarray(columns - self.base.basis @ (self.base.basis.T @ columns))

    def raw(self, *blocks: Block, at: Family | None = None) -> Floats:
        """Columns (N, k) of these, or of those in another family, as large as the reference has them."""
        family = at or self.base.family
        there = [block if at is None else at.blocks[at.where(block)] for block in blocks if len(block.at)]
        each = [family.columns.of(block.at) * family.prior(block) for block in there]
        return np.concatenate([np.zeros((len(family.run.residual), 0)), *each], axis=1)

    @cached_property
    def lead(self) -> FittedSet | None:
        """The best of the sets that were fitted in full, one cause before two: a pair leads only where it is far better
        than each of its two, or both leave something."""
        for one in self.fitted:
            parts = [other for other in self.fitted if set(other.names) < set(one.names) and other.rest < LEFT]
            if not any(self.value(other.keys) > self.value(one.keys) - FAR for other in parts):
                return one
        return self.fitted[0] if self.fitted else None

    @property
    def best(self) -> EffectSet | None:
        """What explains best, where anything has to be explained."""
        return self.lead.of if self.lead is not None and self.log_evidence > LEFT else None

    @cached_property
    def leading(self) -> tuple[tuple[Keys, float], ...]:
        """What leads and the best two besides, the leader with something more aside: that is no rival of it."""
        first = self.lead.keys if self.lead is not None else self.sets[0][0] if self.sets else ()
        mine = {name for name, _ in first}
        others = [one for one in self.sets if not mine <= {name for name, _ in one[0]}]
        return ((first, self.value(first)), *others[:2]) if first else ()

    def value(self, keys: Keys) -> float:
        """The logarithm of weight times Bayes factor of a set."""
        return next((value for other, value in self.sets if other == keys), -np.inf)


def look(known: FixedBefore, data: Measurements, before: InterimAnalysis | None = None) -> InterimAnalysis:
    """Looks at rows in the order of time; the noise that the look ``before`` found is where it begins. Raises
    :class:`~sherkit.errors.FitError` where nothing can be fitted."""
    # where nobody knows from which side the first pose was approached, lost motion would make it another slip
    unsure = np.flatnonzero((data.direction == 0.0).all(axis=1)) if moved(data) else np.zeros(0, dtype=np.int64)
    now = LoopNoise(unsure, np.ones(len(known.axes)), 0.0)
    if before is not None:
        # what explained best explains the new rows, as a rule
        best = before.run.of if before.best is None else before.best.run.of
        now = expected(known, data, before.noise, unsure, best.fit)
    for _ in range(_ROUNDS):
        found = _looked(known, data, now)
        then = left_by(found.run if found.best is None else found.best.run, now, unsure)
        if then.is_near(now):
            break
        now = then
    return found


def moved(data: Measurements) -> bool:
    """Whether any joint moved while the rows were read."""
    return bool((data.direction != 0.0).any())


class _Values:
    """The logarithms of weight times Bayes factor of all sets, each by the names in it."""

    def __init__(self, family: Family) -> None:
        self.family = family
        self.blocks: dict[Key, Block] = {(ROUGH, None): Block(ROUGH)}
        self.of: dict[frozenset[str], tuple[Keys, float]] = {}
        self._names, number = np.unique([called(block) for block in family.blocks], return_inverse=True)
        self._number = number.ravel()

    def put(self, keys: Keys, value: float, *, anew: bool = False) -> None:
        """What a set is worth, if that is more than was known, or ``anew``."""
        names = frozenset(name for name, _ in keys)
        if anew or names not in self.of or value > self.of[names][1]:
            self.of[names] = (tuple(sorted(keys, key=lambda key: key[0])), value)

    def causes(self, each: Floats) -> dict[Key, float]:
        """Causes at their likeliest settings, given what each block (B,) is worth: the sum over settings."""
        value, best = np.full(len(self._names), -np.inf), np.zeros(len(self._names), dtype=np.int64)
        np.logaddexp.at(value, self._number, each)
        order = np.argsort(each, kind="stable")
        best[self._number[order]] = order
        keys = [(name, float(i)) for name, i in zip(self._names.tolist(), best.tolist(), strict=True)]
        self.blocks |= {key: self.family.blocks[int(key[1])] for key in keys}
        return {key: one for key, one in zip(keys, value.tolist(), strict=True) if np.isfinite(one)}

    def put_beside(self, keys: Keys, value: float, each: Floats, *, anew: bool = False) -> None:
        """All pairs with a cause of this value, given what each block (B,) is worth beside it."""
        for key, more in self.causes(each).items():
            if key[0] != keys[0][0]:
                self.put((*keys, key), value + ONE_MORE + more, anew=anew)

    def is_shape(self, keys: Keys) -> bool:
        """Whether a set has a shape in it."""
        return any(self.blocks[key].effect is None for key in keys)

    @property
    def ordered(self) -> list[tuple[Keys, float]]:
        """Sets, the likeliest first."""
        return sorted(self.of.values(), key=lambda one: -one[1])


def called(block: Block) -> str:
    """How a cause is told."""
    return block.name or (f"{block.shape} in {' and '.join(block.depends_on)}" if block.depends_on else block.shape)


def _looked(known: FixedBefore, data: Measurements, noise: LoopNoise) -> InterimAnalysis:
    family = Family(run_of_rows(known, data, noise), known.reference)
    base = Base.of(family, family.run)
    values, sets, rough = _Values(family), Sets(family, base), rough_of(base)
    for key, value in values.causes(base.each).items():
        values.put((key,), value)
    values.put(((ROUGH, None),), rough)
    log_evidence = float(np.logaddexp(base.evidence, rough))
    fitted: list[FittedSet] = []
    if log_evidence > _WORTH:
        # shapes are among pairs, since two effects must not be named for what one effect and an unknown, or two
        # unknowns, would do as well
        alone = [one for one in values.ordered if one[0][0][0] != ROUGH]
        effects = [one for one in alone if not values.is_shape(one[0])]
        for keys, value in (*effects[:_FIRST], *[one for one in alone if values.is_shape(one[0])][:_FIRST_SHAPES]):
            values.put_beside(keys, value, base.beside(values.blocks[keys[0]]).each)
        first = [one for one in values.ordered if not values.is_shape(one[0])]
        asked = [keys for keys, value in first[:_FULL] if value > first[0][1] - _NEAR]
        # to first order a pair may make up for what one of its two does beyond that
        asked += [values.of[frozenset([name])][0] for keys in asked[:2] if len(keys) > 1 for name, _ in keys]
        named = {frozenset(name for name, _ in keys): keys for keys in reversed(asked)}
        for names, keys in sorted(named.items(), key=lambda one: len(one[0])):
            # where one effect leaves nothing, a second is worth what it adds to that
            if any(set(done.names) < names and done.rest < LEFT for done in fitted):
                continue
            if one := sets.fitted(_settled(base, [values.blocks[key] for key in keys])):
                values.put(keys, one.value)
                left = float(np.logaddexp(one.rest, rough_of(one.base)))
                found = values.of[frozenset(one.names)]
                fitted.append(FittedSet(found[0], one, one.log_bf + found[1] - one.value, left))
    for done in fitted:
        if len(done.keys) == 1:
            values.put_beside(done.keys, done.of.value, done.of.each, anew=done.rest < LEFT)
    fitted.sort(key=lambda one: -values.of[frozenset(one.names)][1])
    # pairs may have found another setting likelier
    fitted = [replace(one, keys=values.of[frozenset(one.names)][0]) for one in fitted]
    return InterimAnalysis(
        known, data, base, log_evidence, tuple(values.ordered), tuple(fitted), noise, values.blocks
    )  # fmt: skip


def _settled(base: Base, blocks: list[Block]) -> list[Block]:
    """Effects at the settings that take most, each beside the others."""
    family = base.family
    for k, block in enumerate(blocks):
        if block.setting is not None:
            others = [family.blocks[family.where(other)] for other in blocks if other is not block]
            blocks[k] = refined(base.beside(*others), block)
    return blocks
