"""Which effects may be named: by two numbers each, in nats."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import tau

import numpy as np

from ..base.types import Floats
from ..fit.identify import ABSURD
from .base import Base, log_bayes
from .blocks import Block
from .plausible import is_plausible, times_plausible
from .sets import EffectSet, Sets, ShapeDescription
from .thresholds import ALARM, MOST, NEEDED, PLAINLY, PLAUSIBLE, SURE, TELLS, TIED

#: Most steps in time that are taken for as many accidents.
_STEPS = 2
#: Plausible sizes from which on an effect is no alternative to others, however well it fits.
_FAR = 20.0
#: Waves over the range of a joint from which on it is seen that they repeat.
_REPEATS = 1.5
#: Beginnings of a description that takes the place of an effect.
_STARTS = 3
#: Numbers of three effects or more up to which they imitate nothing by being many.
_FEW = 6


@dataclass(frozen=True)
class Told:
    """What is told of one effect: ``needed`` (d), by how much the set with it and shapes says more than the others with
    the best shapes in its place; ``tells`` (t), its own Bayes factor beside all shapes that were found without it."""

    name: str
    needed: float
    tells: float
    #: How many plausible sizes its largest parameter is.
    size: float
    #: Of a wave, a shape that is none and does as well, to 10,000 to 1.
    bend: Block | None = None


@dataclass(frozen=True, eq=False)
class Names:
    """What a run lacks.

    ``lead`` is the set that says most, None where nothing is missing; ``told`` has the two numbers of each of its
    effects, ``refused`` those that are not named, with the reason; ``ties`` are sets that do as well. ``beside`` and
    ``alone`` describe with shapes what the lead leaves, and what is left without any effect.
    """

    lead: EffectSet | None
    told: tuple[Told, ...]
    refused: dict[str, str]
    ties: tuple[EffectSet, ...]
    beside: ShapeDescription
    alone: ShapeDescription
    #: What is left without any effect.
    without: Base
    #: By how much the lead says more where its effects are of one part each.
    of_one_part: float = 0.0

    @property
    def named(self) -> tuple[str, ...]:
        """Effects that may be named."""
        return tuple(one.name for one in self.told if one.name not in self.refused)

    @property
    def alike(self) -> tuple[EffectSet, ...]:
        """Sets of other names that do as well as the lead, and that first; none where not all of it is named."""
        if self.lead is None or self.named != tuple(block.name for block in self.lead.blocks):
            return ()
        others = {one.names: one for one in reversed(self.ties) if one.names != self.lead.names}
        return (self.lead, *reversed(others.values()))

    @property
    def tied(self) -> tuple[tuple[str, ...], ...]:
        """What these readings cannot tell apart, in words, as one tie or none."""
        told = tuple(" & ".join(one.names) for one in self.alike)
        return (told,) if len(told) > 1 else ()

    @property
    def explains(self) -> bool:
        """Whether nothing is missing beside all that are named."""
        return self.lead is not None and not self.refused and self.lead.explains and not self.shapes_say_more

    @property
    def shapes_say_more(self) -> bool:
        """Whether shapes alone say clearly more than the effects with shapes do."""
        value = -np.inf if self.lead is None else self.lead.value + self.of_one_part
        return self.lead is not None and self.alone.evidence > value + self.beside.evidence + SURE


def judged_names(sets: Sets) -> Names:
    """Searches a run's sets of effects and judges each effect of the leading one."""
    found = sets.found
    alone = sets.described(sets.base, MOST, 1)
    if not found:
        return Names(None, (), {}, (), alone, alone, sets.base)
    judged = _judged(sets, sets.leading(found), found, alone)
    if judged.lead is None or not judged.lead.explains or not judged.refused:
        return judged
    # what shapes say as much as may be a tie's that is less beside them
    others = (_judged(sets, tie, found, alone) for tie in judged.ties if tie.explains and tie.plausible)
    return next((one for one in others if not one.refused), judged)


def _judged(sets: Sets, lead: EffectSet, found: list[EffectSet], alone: ShapeDescription) -> Names:
    """Each effect of a set that leads or is tied with it."""
    beside = sets.described(lead.base, MOST, 1)
    # where effects say far more than shapes no other beginning of these changes that
    if lead.value + beside.evidence - alone.evidence < 2.0 * NEEDED:
        alone = sets.described(sets.base, MOST, _STARTS)
    fewer = _of_one_part(sets.base, *_columns(lead, 0)) if len(lead.blocks) == 1 else 0.0
    judged = Names(lead, (), {}, _ties(sets, lead, found), beside, alone, sets.base, fewer)
    # three or more with many numbers imitate anything; what no shape follows is left, too, where poses are off by
    # errors of their own
    own = lead.base.own_errors()
    off = own is not None and own.evidence > ALARM
    many = len(lead.blocks) > 2 and sum(len(b.effect.parameters) for b in lead.blocks if b.effect) > _FEW
    partly = not lead.explains or judged.shapes_say_more or many or off
    told: dict[str, Told] = {}
    refused: dict[str, str] = {}
    kept: EffectSet | None = lead
    while kept is not None:
        # what is named is told without the help of what is not
        left = beside if kept is lead else sets.described(kept.base, MOST, _STARTS)
        those = [_told(sets, kept, left, alone, k, partly=partly) for k in range(len(kept.blocks))]
        told |= {one.name: one for one in those}
        why = {one.name: reason for one in those if (reason := _refused(kept, one, alone, partly=partly))}
        refused |= why
        partly = True
        stay = [block for block in kept.blocks if block.name not in why]
        less = sets.fitted(stay) if why and stay else None
        # what says as much without them had no help of them
        kept = None if less is None or less.value > kept.value - TIED else less
    if any(one.size > ABSURD for one in told.values()):
        refused = dict.fromkeys(told, "its size would be absurd")
    return replace(judged, told=tuple(told.values()), refused=refused)


def _told(
    sets: Sets, lead: EffectSet, beside: ShapeDescription, alone: ShapeDescription, k: int, *, partly: bool
) -> Told:
    block = lead.blocks[k]
    assert block.effect is not None, "shapes are not named"
    fit = lead.run.of
    size = float(times_plausible(fit.fit)[fit.owns(block.effect)].max())
    others = tuple(one for one in lead.blocks if one is not block)
    less = sets.fitted(others) if others else None
    if others and less is None:
        return Told(block.name, np.inf, np.inf, size)
    without = alone if less is None else sets.described(less.base, MOST, _STARTS)
    needed = lead.value + beside.evidence - (0.0 if less is None else less.value) - without.evidence
    columns, parts = _columns(lead, k)
    if not partly:
        # of what is left in part, one number of many takes its share by chance
        needed += _of_one_part(sets.base if less is None else less.base, columns, parts)
    wave = any(p.name.startswith("sine") for p in block.effect.parameters)
    bends = wave and needed < TIED and all(shape.period is None for shape in without.shapes)
    bend = next(iter(without.shapes), None) if bends else None
    return Told(block.name, needed, _tells(without.base, columns), size, bend)


def _columns(lead: EffectSet, k: int) -> tuple[Floats, list[str]]:
    """Columns (N, p) of an effect of a set as the full fit has them, of unit length, and of what part of it
    each is; empty where it is of none."""
    fit, effect = lead.run.of, lead.blocks[k].effect
    assert effect is not None, "shapes are not named"
    at = fit.owns(effect)
    columns = lead.run.flat(lead.run.view.fitted(lead.run.view.whole)[:, :, at])
    length = np.linalg.norm(columns, axis=0)
    parts = {k: part for part, numbers in effect.parts.items() for k in numbers}
    return columns[:, length > 0] / length[length > 0], [parts.get(k, "") for k in np.flatnonzero(length > 0).tolist()]


def _tells(base: Base, columns: Floats) -> float:
    """The logarithm of the Bayes factor of columns (N, p) beside what a base has."""
    part = base.takes(columns) / max(base.rss, 1e-300)
    return float(log_bayes(np.array([part]), np.array([columns.shape[1]]), base.free, len(base.residual))[0])


def _of_one_part(base: Base, columns: Floats, parts: Sequence[str]) -> float:
    """By how much an effect that any part may have, as :func:`_columns` has it, says more as that of one part alone,
    which of them being as likely as any other and as all together: shapes are of one, and pay for no other."""
    every = dict.fromkeys(parts)
    if "" in every or len(every) < 2:
        return 0.0
    each = [_tells(base, columns[:, [one == part for one in parts]]) for part in every]
    return max(max(each) - float(np.log(2.0 * len(every))) - _tells(base, columns), 0.0)


def _refused(lead: EffectSet, one: Told, alone: ShapeDescription, *, partly: bool) -> str:
    """Why an effect of a set is not named; empty where it may be. ``partly`` where the set does not explain all."""
    # where one or two explain all, what follows no cause may do a little better, but not clearly; but of a wave
    # whose period was looked for a bend or a bump of the joint, as of a rack in two pieces, is as good a cause
    wave = any(block.effect is not None and block.effect.is_periodic for block in lead.blocks if block.name == one.name)
    bend = wave and any(_bends(alone.base, shape) for shape in alone.shapes)
    least = NEEDED if partly else TIED if bend else -SURE
    steps = [block for block in lead.blocks if block.effect and block.effect.search == "time_s"]
    if len(steps) > _STEPS and one.name in {block.name for block in steps}:
        return "steps at three moments or more are no accident each: something switches to and fro"
    if any(block.name == one.name and _never_repeats(lead, block) for block in lead.blocks):
        return "a wave of which the run shows less than one and a half is any bend"
    if one.needed < least:
        return "shapes that follow no cause say as much in its place"
    if partly and one.size > PLAUSIBLE:
        return "its size is more than any robot's, and something is left that it does not explain"
    if partly and one.tells < TELLS and one.needed < PLAINLY:
        return "it says nothing beside the shapes that describe this run without it"
    return ""


def _never_repeats(lead: EffectSet, block: Block) -> bool:
    """Whether nobody saw the wave of an effect repeat, whose period was looked for, at the joint that has most of it:
    on a ring, with one or two a turn, there is a cause for it."""
    if block.effect is None or not block.effect.is_periodic or block.setting is None:
        return False
    run, setting, at = lead.run, block.setting, lead.run.of.owns(block.effect)
    moved = run.flat(run.view.fitted(run.view.whole)[:, :, at]) * run.of.fit.values[at]
    most = int(np.argmax(np.square(moved[:, ::2] + moved[:, 1::2]).sum(axis=0)))
    period = setting[most] if isinstance(setting, tuple) else setting
    # what is nearer to two a turn than to three
    slowest = tau / 2.5 if block.effect.search == "period_rad" else np.inf
    reach = float(np.ptp(run.view.stood[run.view.waving(block.effect)[most]]))
    return period <= slowest and reach < _REPEATS * period


def _bends(base: Base, shape: Block) -> bool:
    """Whether a shape is a bend or a bump of a joint, or a wave of it that nobody saw repeat."""
    if shape.period is None or shape.pattern is None:
        return shape.shape in ("kink", "bump")
    return float(np.ptp(base.family.run.view.stood[shape.pattern])) < _REPEATS * shape.period


def _is_no_robots(one: EffectSet) -> bool:
    return not all(is_plausible(one.run.of, block.effect, _FAR) for block in one.blocks if block.effect)


def _ties(sets: Sets, lead: EffectSet, found: list[EffectSet]) -> tuple[EffectSet, ...]:
    """Sets of no more effects that say as much, or are no more and come as near the data, and leave as little; beside a
    plausible lead none of numbers that are beyond all doubt no robot's."""
    equivalent_models = lead.base.rss * (1.0 + 2.0 * TIED / lead.base.free)
    return tuple(
        one
        for one in found
        if one is not lead
        and len(one.blocks) <= len(lead.blocks)
        and (
            one.value > lead.value - TIED
            or (one.explains and one.base.rss < equivalent_models and sets.counted(one) <= sets.counted(lead))
        )
        and one.rest < max(lead.rest, ALARM) + TIED
        and not (lead.plausible and _is_no_robots(one))
    )
