"""Sets of effects, refitted in full, by how much the readings favour each."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..base.types import Floats
from ..errors import SherkitError
from ..model.effect import Effect, Setting
from ..model.sensor_pose import SLIP
from .base import Base, total
from .blocks import Block
from .family import Family
from .fitted_run import FittedRun
from .plausible import displaces, is_plausible
from .run import Run
from .settings import refined
from .thresholds import A_FEW, ALARM, MOST, TIED

# -- Described by shapes -----------------------------------------------------------------------------------------------
# Shapes that describe what a model leaves, one after another, as long as the readings favour one more.

#: Likeliest shapes among which different beginnings are looked for.
_LIKELIEST = 200


@dataclass(frozen=True, eq=False)
class ShapeDescription:
    """``shapes`` in the order in which they were found, by how much the readings favour all of them together,
    ``evidence`` with their prior weights, and the ``base`` with them in the model."""

    shapes: tuple[Block, ...]
    evidence: float
    base: Base


def described(base: Base, most: int = MOST, starts: int = 1) -> ShapeDescription:
    """At most so many shapes that describe what a base leaves; none where nothing is left.

    The likeliest is taken first, then the likeliest beside it. The first need not be the right one: of several
    ``starts`` with shapes of different causes the description that says most is taken.
    """
    if total(base.shapes) < ALARM:
        return ShapeDescription((), 0.0, base)
    first: dict[tuple[object, ...], int] = {}
    for i in np.argsort(-base.shapes)[:_LIKELIEST].tolist():
        first.setdefault(base.family.blocks[i].cause, i)
        if len(first) == starts:
            break
    return max((_from(base, i, most) for i in first.values()), key=lambda one: one.evidence)


def _from(base: Base, first: int, most: int) -> ShapeDescription:
    shapes: list[Block] = []
    evidence, now, i = 0.0, base, first
    while True:
        shapes.append(base.family.blocks[i])
        evidence += float(now.shapes[i])
        now = now.beside(shapes[-1])
        if len(shapes) == most or total(now.shapes) < ALARM:
            break
        i = int(np.argmax(now.shapes))
        if now.shapes[i] < 0:
            break
    if len(shapes) > 1 and base.family.reference is None:
        # one that stood beside much that was still to be described said less than it does beside the others
        evidence = max(evidence, base.one_by_one(shapes[::-1]))
    return ShapeDescription(tuple(shapes), evidence, now)


# -- Sets of effects ---------------------------------------------------------------------------------------------------

#: Prior odds of one more effect.
ONE_MORE = float(np.log(0.1))
#: What takes so much of what the most does is refitted, whatever it says.
_NEARLY = 0.8
#: By how much less, in nats and as a part, a single may say to first order than one that explains, to be refitted.
_BEHIND, _PART_BEHIND = 60.0, 0.1
#: Pairs: how many seconds each, and to first order, of how many firsts.
_SECONDS, FIRSTS = 4, 14
#: Nats that an effect must say by itself before overtones of it are asked for: a worn spot, which is none, says 46 of a
#: wave, one of five noises 594.
_TONE = 100.0
#: Most effects of a set.
_MOST_EFFECTS = 4


_Key = tuple[str, str, Setting, int]


@dataclass(frozen=True, eq=False)
class EffectSet:
    """Effects of a full fit: its ``run``, the ``base`` that it leaves, the logarithm of the Bayes factor ``log_bf``
    against the fit before, and with prior weights, ``value``; whether all is ``plausible``. ``along`` are effects that
    go with one of them and are in the fit, too."""

    blocks: tuple[Block, ...]
    run: Run
    base: Base
    log_bf: float
    value: float
    plausible: bool
    along: tuple[Effect, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the effects, in order."""
        return tuple(sorted(block.name for block in self.blocks))

    @cached_property
    def each(self) -> Floats:
        """What each other block says beside the set (B,)."""
        # the other parts of an effect of which one is in the set may say something
        held = [
            block.effect is not None and any(one.has(block) or block.has(one) for one in self.blocks)
            for block in self.base.family.blocks
        ]
        return np.where(held, -np.inf, self.base.each)

    @cached_property
    def rest(self) -> float:
        """By how much the readings favour that something is missing still."""
        return float(np.logaddexp(total(self.each), self.base.family.log_missing))

    @property
    def explains(self) -> bool:
        """Whether nothing is missing beside it."""
        return self.rest < ALARM


class Sets:
    """The sets of effects of a run, each fitted once, and shapes beside them."""

    #: Pairs that are refitted.
    refits = 7

    def __init__(self, family: Family, base: Base, step: Callable[[str], None] = lambda _: None) -> None:
        self.family, self.base, self.step = family, base, step
        left = np.zeros(len(family))
        for (which, _, _), grams in zip(family.groups, base.left, strict=True):
            left[which] = np.einsum("bkk->b", grams)
        if family.reference is None:
            family.without_twins(base.basis, left)
        self._fitted: dict[tuple[_Key, ...], EffectSet | None] = {}
        self._described: dict[tuple[int, int, int], ShapeDescription] = {}

    @cached_property
    def _of_effects(self) -> Base:
        """The base of effects alone: what shapes say of pairs is not asked."""
        alone = Family(self.family.run, self.family.reference, shapes=False)
        return Base.of(alone.having([one for one in self.family.waves if one.effect is not None]), self.family.run)

    def fitted(self, blocks: Sequence[Block]) -> EffectSet | None:
        """The set in a full fit; None where it cannot be fitted."""
        key = _key(blocks)
        if key not in self._fitted:
            self.step(f"refitting with {' and '.join(name for name, *_ in key)}")
            self._fitted[key] = self._fit(tuple(blocks))
        return self._fitted[key]

    def with_more(self, one: EffectSet, effect: Effect) -> EffectSet | None:
        """A set with one more effect, which is none of the family: it goes with another of the set. None where it
        cannot be fitted, or where the readings do not favour it."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                fit = one.run.of.refit([(effect, None)])
                run = one.run.seen_by(fit)
                base = Base.of(self.family, run)
            except (SherkitError, np.linalg.LinAlgError):
                return None
        more = Block("effect", effect=effect)
        bf = one.base.log_bf_of(base, run, (more,))
        value = one.value + bf + ONE_MORE
        # how large it may be is judged of the one that it goes with
        if value <= one.value + TIED:
            return None
        return EffectSet((*one.blocks, more), run, base, one.log_bf + bf, value, one.plausible)

    def described(self, base: Base, most: int, starts: int) -> ShapeDescription:
        """As :func:`described`, remembered."""
        key = (id(base), most, starts)
        if key not in self._described:
            self._described[key] = described(base, most, starts)
        return self._described[key]

    @cached_property
    def found(self) -> list[EffectSet]:
        """Sets of effects, the likeliest first; none where nothing is missing.

        Singles first; where none explains, pairs; where none does, more, one at a time.
        """
        if self.base.evidence < ALARM:
            return []
        sets = sorted(self._singles(), key=lambda one: -one.value)
        if self._settled(sets):
            return sets
        sets = [self._with_along(one) for one in sets]
        if not self._settled(sets):
            sets += self._pairs(sets)
        sets.sort(key=lambda one: -one.value)
        while sets and len(sets[0].blocks) < _MOST_EFFECTS and not any(one.explains for one in sets):
            lead = sets[0]
            more = [self._with(lead, block) for block in likeliest(self.family, lead.each, 2, lead.names)]
            better = [one for one in more if one is not None and one.value > lead.value + TIED]
            if not better:
                break
            sets = sorted([*sets, *better], key=lambda one: -one.value)
        return sets

    def counted(self, one: EffectSet) -> int:
        """How much is taken to have happened: so many effects."""
        return len(one.blocks)

    def _settled(self, singles: Sequence[EffectSet]) -> bool:
        """Whether one of them explains, and no pair would be less."""
        return any(self.counted(one) <= 2 for one in _whole(singles))

    def leading(self, sets: Sequence[EffectSet]) -> EffectSet:
        """The set that leads: of those that explain, plausible ones first; where shapes beside effects say clearly
        more, the set that they say it with."""
        explaining = [one for one in sets if one.explains]
        lead = max(explaining or sets, key=lambda one: (one.plausible and bool(explaining), one.value))
        lead = self._of_the_machine(lead, explaining)
        partly = [one for one in sets if not one.explains]
        partly.sort(key=lambda one: -(one.value + max(float(one.base.shapes.max(initial=-np.inf)), 0.0)))
        both = [(one, self.described(one.base, MOST, 1)) for one in partly[:A_FEW]]
        # what leaves more than one that explains says no more, whatever its own noise makes of its shapes
        both = [pair for pair in both if not explaining or pair[1].base.rss < lead.base.rss]
        if both:
            mixed, shapes = max(both, key=lambda pair: pair[0].value + pair[1].evidence)
            if not explaining or mixed.value + shapes.evidence > lead.value + TIED:
                return mixed
        return self._of_the_instrument(lead)

    def _of_the_machine(self, lead: EffectSet, others: Sequence[EffectSet]) -> EffectSet:
        """Where an instrument's and a machine's effect say the same of these rows, beside another or alone, that of the
        machine: the instrument is what all is measured by."""
        if not _at_sensor(lead):
            return lead
        most = lead.base.rss * (1.0 + 2.0 / lead.base.free)
        same = [
            one for one in others
            if one.base.rss < most and one.value > lead.value - TIED and _at_sensor(one) < _at_sensor(lead)
            and len(one.blocks) == len(lead.blocks) and one.plausible >= lead.plausible
        ]  # fmt: skip
        return max(same, key=lambda one: one.value, default=lead)

    def _of_the_instrument(self, lead: EffectSet) -> EffectSet:
        """The same set with a step of the instrument where it has one of the robot, if that comes as near
        the data: an instrument is moved more easily than a robot."""
        if SLIP in lead.names:
            return lead
        for block in lead.blocks:
            others = [one for one in lead.blocks if one is not block]
            # a course in time is as likely the instrument's as the robot's; a step of it is asked for
            if block.effect is None or block.effect.search != "time_s":
                continue
            beside = self._of_effects.beside(*map(self._near, others))
            each = np.array([x if one.name == SLIP else -np.inf for x, one in _each(beside)])
            if not np.isfinite(each).any():
                continue
            step = beside.family.blocks[int(np.argmax(each))]
            assert step.effect is not None, "it is one"
            other = self.fitted([*others, refined(beside, step)]) if block.effect.link != step.effect.link else None
            equivalent_models = lead.base.rss * (1.0 + 2.0 * TIED / lead.base.free)
            if other is not None and other.base.rss < equivalent_models:
                # it stands in the other's place: its numbers more are those of where it was put
                other = replace(other, value=max(other.value, lead.value))
                self._fitted[_key(other.blocks)] = other
                return other
        return lead

    # -- within ---------------------------------------------------------------------------------------------------

    def _fit(self, blocks: tuple[Block, ...]) -> EffectSet | None:
        before = self.family.run.of
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                fit: FittedRun = before.refit([(block.effect, block.setting) for block in blocks if block.effect])
                run = self.family.run.seen_by(fit)
                base = Base.of(self.family, run)
            except (SherkitError, np.linalg.LinAlgError):
                return None
        bf = self.base.log_bf_of(base, run, blocks)
        if self.family.reference is None:
            # of several each has a size of its own: one is judged beside the others, where these have been fitted
            names = {block.name for block in blocks}
            less = [one for one in self._fitted.values() if one and len(one.blocks) + 1 == len(blocks)]
            less = [one for one in less if names.issuperset(one.names)]
            bf = max([bf, *(one.log_bf + one.base.log_bf_of(base, run, ()) for one in less)])
        weight = sum(self._weight(block) for block in blocks)
        sizes = all(is_plausible(fit, block.effect) for block in blocks if block.effect)
        value = bf + weight + ONE_MORE * (len(blocks) - 1)
        return EffectSet(blocks, run, base, bf, value, sizes and not displaces(fit.fit, before.fit))

    def _weight(self, block: Block) -> float:
        """Logarithm of its prior weight, which is less where it was chosen from more."""
        at = self.family.where(block)
        return float(self.family.log_weight[at]) + self.family.blocks[at].ways - block.ways

    def _singles(self) -> list[EffectSet]:
        each, gain = self.base.each, self.base.gains[0]
        blocks = likeliest(self.family, each, A_FEW)
        # a cause of many numbers stands behind each that imitates it
        for i in np.argsort(-gain).tolist():
            block = self.family.blocks[i]
            if gain[i] <= _NEARLY * gain.max():
                break
            if block.effect is not None and block.name not in {one.name for one in blocks}:
                blocks.append(block)
        sets: list[EffectSet] = []
        for block in blocks:
            # both to first order: a step says more at its own moment than at the nearest of those that are tried
            first = (min(one.value, float(each[self.family.where(one.blocks[0])])) for one in sets if one.explains)
            best = max(first, default=-np.inf)
            behind = max(_BEHIND, _PART_BEHIND * abs(best)) if np.isfinite(best) else 0.0
            if each[self.family.where(block)] >= best - behind and (one := self.fitted([refined(self.base, block)])):
                sets.append(one)
                # where a part of an effect does not explain, all of it may; where all of it does, a part may as well
                other = self.base.all_or_part(block) if (block.pattern is None) == one.explains else None
                if other is not None and (one := self.fitted([other])):
                    sets.append(one)
        return sets

    def _pairs(self, sets: Sequence[EffectSet]) -> list[EffectSet]:
        """Pairs, by what each second brings beside the first: refitted, and to first order."""
        pairs: dict[tuple[str, ...], tuple[float, Block, Block]] = {}

        def add(worth: float, one: Block, other: Block, *, again: bool) -> None:
            names = tuple(sorted((one.name, other.name)))
            if names not in pairs or (again and worth > pairs[names][0]):
                pairs[names] = (worth, one, other)

        # what explains by itself is no half of a pair, but a part of it may be
        whole = [one.blocks[0] for one in _whole(sets)]
        for one in [one for one in sets if not one.explains][:A_FEW]:
            for block in likeliest(self.family, one.each, _SECONDS, one.names, whole):
                add(one.log_bf + float(one.each[self.family.where(block)]), one.blocks[0], block, again=True)
        of_effects = self._of_effects
        for first in likeliest(of_effects.family, of_effects.each, FIRSTS, (), whole):
            beside = of_effects.beside(first)
            alone = float(of_effects.log_bf[of_effects.family.where(first)])
            for block in likeliest(of_effects.family, beside.each, _SECONDS, (first.name,), whole):
                add(alone + float(beside.each[of_effects.family.where(block)]), first, block, again=False)
        out = []
        for _, a, b in sorted(pairs.values(), key=lambda pair: -pair[0])[: self.refits]:
            # each setting beside the other, until both rest
            first, second = a, b
            for _ in range(2 if a.setting is not None or b.setting is not None else 0):
                second = refined(self._of_effects.beside(self._near(first)), second)
                first = refined(self._of_effects.beside(self._near(second)), first)
            if found := self.fitted([first, second]):
                out.append(found)
        return out

    def _with(self, lead: EffectSet, block: Block) -> EffectSet | None:
        beside = self._of_effects.beside(*(self._near(one) for one in lead.blocks))
        return self.fitted([*lead.blocks, refined(beside, block)])

    def _with_along(self, one: EffectSet) -> EffectSet:
        """The set with what goes with its effects, where it explains with that and not without: what half a cause
        leaves has the shape of none."""
        names, whole = {block.name for block in one.blocks}, one
        for effect in () if one.explains or one.value < _TONE else one.run.of.catalogue:
            if effect.goes_with in names and (more := self.with_more(whole, effect)) is not None:
                whole = replace(more, blocks=one.blocks, along=(*whole.along, effect))
        return whole if whole.explains else one

    def _near(self, block: Block) -> Block:
        family = self._of_effects.family
        return family.blocks[family.where(block)]


def _each(base: Base) -> Iterator[tuple[float, Block]]:
    return zip(base.each.tolist(), base.family.blocks, strict=True)


def _at_sensor(one: EffectSet) -> int:
    return sum(block.effect is not None and block.effect.link == "sensor" for block in one.blocks)


def _key(blocks: Sequence[Block]) -> tuple[_Key, ...]:
    # no name stands there twice, unless at two numbers
    return tuple(sorted((block.name, block.pattern or "", block.setting or 0.0, block.since) for block in blocks))


def likeliest(
    family: Family, each: Floats, most: int, without: Collection[str] = (), nor: Sequence[Block] = ()
) -> list[Block]:
    """The likeliest effects of a family, given what each block says (B,), each at its likeliest setting: ``without``
    these names, ``nor`` all that these blocks are a part of."""
    best: dict[str, Block] = {}
    for i in np.argsort(-each).tolist():
        block = family.blocks[i]
        if block.effect is None or block.name in without or any(block.has(one) for one in nor):
            continue
        if np.isfinite(each[i]):
            best.setdefault(block.name, block)
            if len(best) == most:
                break
    return list(best.values())


def _whole(sets: Sequence[EffectSet]) -> list[EffectSet]:
    """Those that explain and say as much as any: a wave may leave nothing that is asked for beside it, since that would
    be another wave."""
    most = max((one.value for one in sets), default=0.0) - TIED
    return [one for one in sets if one.explains and one.value > most]
