"""The effects that a diagnosis names: those that the search finds and that earn their place, each given all others; and
the settings with which they are fitted.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np

from ..base.types import Floats, Ints
from ..data import Measurements
from ..errors import EffectError
from ..evidence.base import Base
from ..evidence.blocks import Block
from ..evidence.family import Family
from ..evidence.fitted_run import FittedRun
from ..evidence.names import Names, judged_names
from ..evidence.noise import base_of
from ..evidence.periods import Period, period_of
from ..evidence.run import Run, weighed_run
from ..evidence.sets import EffectSet, Sets, ShapeDescription
from ..evidence.settings import refined, unit_columns
from ..evidence.thresholds import MOST, SURE_SIGMA
from ..fit.identify import Fit, identify
from ..model.base import ModelWithEffects, require_columns
from ..model.effect import Effect, Setting
from .held_out import HeldOutGain, error_held_out, held_out_gain, strongest
from .result import StepReport

M = TypeVar("M", bound=ModelWithEffects)

TOO_MANY = "all that is fitted takes more numbers than these poses leave to judge it by"


@dataclass(eq=False)
class NamedEffects:
    """What the evidence of a run says: the ``added`` effects that it names, in the order in which the error falls, the
    full fit with them, ``final``, and what each of them earns.

    ``first`` is what is in the model before anything is added, ``base`` with all that is named; ``left`` describes what
    that leaves. ``names_judged`` are all that were judged, None where nothing was looked for; ``notes`` are on effects
    that were found and are not named.
    """

    first: Base
    base: Base
    left: ShapeDescription
    names_judged: Names | None
    final: FittedRun
    added: list[Block] = field(default_factory=list)
    gains: list[HeldOutGain] = field(default_factory=list)
    steps: tuple[StepReport, ...] = ()
    notes: list[str] = field(default_factory=list)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the effects, in the order of the steps."""
        return tuple(block.name for block in self.added)

    @property
    def ties(self) -> tuple[EffectSet, ...]:
        """Sets of effects that do as well as those that are named."""
        judged = self.names_judged
        return judged.ties if judged is not None and self.added and not judged.refused else ()

    @property
    def lead(self) -> FittedRun | None:
        """The full fit with what says most of the run, whether it is named or not."""
        judged = self.names_judged
        return None if judged is None or judged.lead is None else judged.lead.run.of

    @property
    def structure(self) -> bool:
        """Whether what is left has one that nothing named explains."""
        judged = self.names_judged
        return judged is not None and not (judged.explains and self.added)

    @property
    def unwitnessed(self) -> str:
        """What would explain all that is left, were there poses to judge it by; empty where nothing would."""
        judged = self.names_judged
        if judged is None or judged.lead is None or not judged.lead.explains or TOO_MANY not in judged.refused.values():
            return ""
        would = list(dict.fromkeys(" & ".join(one.names) for one in (judged.lead, *judged.ties)))
        return f", which {' or '.join(would[:3])} would explain, but {TOO_MANY}: measure more poses"

    @property
    def missing(self) -> float:
        """By how much, in nats, the readings favour that something is missing: what no effect of these explains, or
        what is left beside all that are named."""
        judged = self.names_judged
        if self.structure and self.added:
            return max(self.base.evidence, self.left.evidence)
        if self.structure or judged is None or judged.lead is None:
            return self.first.evidence
        return judged.lead.rest


def searched(
    run: FittedRun,
    effects: Sequence[Effect],
    rows: Ints,
    sigma: Floats,
    repeated_folds: Sequence[Ints],
    *,
    level: float,
    step: Callable[[str], None],
    look: bool,
) -> NamedEffects:
    """Asks the evidence of these rows what is missing, and names what may be named. Nothing is looked for where there
    is nothing to ``look`` for: what a mistake of the set-up leaves says nothing on physics."""
    inside = tuple(e.name for e in run.model.effects if e.name not in run.model.within)
    first = StepReport(None, error_held_out(run, sigma, repeated_folds), inside)
    step("evidence")
    base = base_of(weighed_run(run.on(np.arange(len(run.data)), sigma), rows, effects, sigma), effects)
    sets = Sets(base.family, base, step)
    nothing = NamedEffects(base, base, ShapeDescription((), 0.0, base), None, run, steps=(first,))
    if run.is_exact or not look or base.evidence < -np.log(level):
        return nothing
    names = judged_names(sets)
    lead = names.lead
    if lead is None:
        return replace(nothing, names_judged=names, left=names.alone)
    refused = dict(names.refused)
    if not refused and (why := _too_many(run, lead.run.of)):
        refused = dict.fromkeys(lead.names, why)
    names = replace(names, refused=refused)
    notes = [f"{name} was found and is not named: {why}" for name, why in refused.items()]
    # what goes with them is asked for once they are in the model
    added = [block for block in lead.blocks if block.name not in refused]
    kept = sets.fitted(added) if added else None
    if kept is None:
        return replace(nothing, names_judged=names, left=names.alone, notes=notes)
    step("held-out errors")
    # visits of a pose share what is its own: rows held out by whole poses know
    judged = _judged(run, added, sigma, repeated_folds, first)
    told = judged.told
    if worse := {g.effect: "rows held out are not clearly nearer with it" for g in judged.gains if not g.holds}:
        names = replace(names, refused=refused | worse)
        notes += [f"{name} was found and is not named: {why}" for name, why in worse.items()]
        added = [block for block in judged.added if block.name not in worse]
        kept = sets.fitted(added) if added else None
        if kept is None:
            return replace(nothing, names_judged=names, left=names.alone, notes=notes)
        judged = _judged(run, added, sigma, repeated_folds, first)
    for effect in _going_with(judged.final):
        wider = sets.with_more(kept, effect)
        more = None if wider is None else judged.beside(effect, sigma, repeated_folds)
        if wider is not None and more is not None:
            kept, judged = wider, more
            names = replace(names, lead=kept, beside=sets.described(kept.base, MOST, 1))
    left = names.beside if kept is names.lead else sets.described(kept.base, MOST, 1)
    return NamedEffects(
        base, kept.base, left, names, judged.final, judged.added, judged.gains, judged.steps, [*notes, *told]
    )


def _too_many(run: FittedRun, final: FittedRun) -> str:
    """Why a fit with what was found is no witness; empty where it is one."""
    left = len(np.unique(run.data.groups[run.whole])) * len(run.axes) - final.fit.rank
    if left < final.fit.rank:
        return TOO_MANY
    if run.fit.converged and not final.fit.converged:
        return "with it the fit does not converge"
    return ""


@dataclass(frozen=True, eq=False)
class _Judged:
    """The ``final`` fit with what was ``added``, in the order in which the error falls, step by step, what each
    ``gains`` on rows held out, and what is ``told`` of periods."""

    final: FittedRun
    added: list[Block]
    gains: list[HeldOutGain]
    steps: tuple[StepReport, ...]
    told: tuple[str, ...]

    def beside(self, effect: Effect, sigma: Floats, repeated_folds: Sequence[Ints]) -> _Judged | None:
        """With one more effect; None where rows held out are not clearly nearer with it."""
        final = self.final.refit([(effect, None)])
        gain = held_out_gain(final, effect, sigma=sigma, repeated_folds=repeated_folds)
        if not gain.holds:
            return None
        more = StepReport(effect.name, error_held_out(final, sigma, repeated_folds))
        added = [*self.added, Block("effect", effect=effect)]
        return _Judged(final, added, [*self.gains, gain], (*self.steps, more), self.told)


def _going_with(run: FittedRun) -> list[Effect]:
    """Effects that can be asked for now that another is in the model: of what that one's fit is sure of."""
    sure = {
        p.name for p, value, std in zip(run.fit.parameters, run.fit.values, run.fit.std, strict=True)
        if abs(value) > SURE_SIGMA * std
    }  # fmt: skip
    those = [e for e in run.catalogue if any(f"{e.goes_with}.{p.name}" in sure for p in e.parameters)]
    return run.model.is_testable(those, run.data)[0] if those else []


def _judged(
    run: FittedRun, found: Sequence[Block], sigma: Floats, repeated_folds: Sequence[Ints], base: StepReport
) -> _Judged:
    """Effects that were found, each at the setting that all rows give."""
    left, told = on_all_rows(run, found)
    steps, partial = [base], run
    ordered: list[Block] = []
    while left:
        options = [(error_held_out(with_it, sigma, repeated_folds), k, with_it)
                   for k, with_it in enumerate(refit(partial, (c,)) for c in left)]  # fmt: skip
        error, k, partial = min(options, key=lambda o: (o[0].rms, o[1]))
        ordered.append(left.pop(k))
        steps.append(StepReport(ordered[-1].name, error))
    gains = [
        held_out_gain(partial, block.effect, sigma=sigma, repeated_folds=repeated_folds)
        for block in ordered
        if block.effect is not None
    ]
    return _Judged(partial, ordered, gains, tuple(steps), told)


def refit(run: FittedRun, blocks: Sequence[Block]) -> FittedRun:
    """The full fit with these effects, at the settings they were found with."""
    return run.refit([(block.effect, block.setting) for block in blocks if block.effect is not None])


def not_needed(
    run: FittedRun, effects: Sequence[Effect], sigma: Floats, repeated_folds: Sequence[Ints]
) -> list[HeldOutGain]:
    """What each of the ``effects`` that were in the model earns. Of those that earn nothing the least useful is taken
    out first, and the others are judged without it: of two that say the same only one is not needed."""
    out: list[HeldOutGain] = []
    left = list(effects)
    also: list[str] = []
    while left:
        gains = [held_out_gain(run, e, sigma=sigma, repeated_folds=repeated_folds, also=also) for e in left]
        failing = [one for one in gains if not one.holds]
        if not failing:
            return out + gains
        sizes = {e.name: len(e.parameters) for e in left}
        # what costs most parameters goes first where several bring nothing
        worst = max(failing, key=lambda one: (sizes[one.effect], one.p))
        out.append(worst)
        also.append(worst.effect)
        left = [e for e in left if e.name != worst.effect]
    return out


# -- Settings searched for besides parameters: the moment of a step, the period of a wave --------------------------


def at_its_setting(run: FittedRun, effect: Effect) -> Period | Block | None:
    """The effect at the setting at which it takes most of what a run leaves, with its aliases where that is a period;
    None where it cannot be tried."""
    own = Run.plain(run, np.flatnonzero(run.whole), (effect,), run.noise[0])
    family = Family(own, shapes=False)
    base = Base.of(family, own)
    if effect.is_periodic:
        return period_of(base, effect)
    block = strongest(base).get(effect.name)
    if block is None:
        return None
    found = refined(base, block)
    at_once = next((one for one in family.blocks if one.name == effect.name and one.setting is None), None)
    if effect.is_lagging and at_once is not None and found.setting is not None:
        # Schwarz's price of one number more
        left = [base.rss - base.takes(unit_columns(own, effect, one.setting)) for one in (at_once, found)]
        if len(base.residual) * np.log(left[0] / max(left[1], 1e-300)) < np.log(len(base.residual)):
            return at_once
    return found


def on_all_rows(run: FittedRun, added: Sequence[Block]) -> tuple[list[Block], tuple[str, ...]]:
    """These effects at the settings that all rows of a run give, each with the others in the model; and what a person
    is to know of their periods."""
    out: list[Block] = []
    told: list[str] = []
    for block in added:
        effect = block.effect
        if effect is None or effect.search is None:
            out.append(block)
            continue
        others = [one for one in added if one is not block]
        found = at_its_setting(refit(run, others) if others else run, effect)
        if isinstance(found, Period):
            told += found.sentences
            found = found.block
        out.append(block if found is None else found)
        if effect.is_lagging and (lag := out[-1].setting):
            told.append(f"{block.name}: it comes {lag:.3g} s after the recorded temperature")
    return out, tuple(told)


def adopting(model: M, effects: Sequence[Effect], data: Measurements) -> M:
    """A model with these effects, each at the setting that the rows give it beside those before. Raises
    :class:`~sherkit.errors.EffectError`, also for a column that an effect needs and rows do not have."""
    for effect in effects:
        require_columns(effect, data)
        model = model.adopting(effect, at=setting_for(identify(model, data), effect) if effect.search else None)
    return model


def setting_for(fit: Fit, effect: Effect) -> Setting | None:
    """The setting at which an effect takes most of what a fit leaves: None where it has none to search for, or is as
    good at the one that the model has.

    Raises :class:`~sherkit.errors.EffectError` where no setting can be searched for in these rows.
    """
    if effect.search is None:
        return None
    found = at_its_setting(FittedRun(fit), effect)
    if found is None:
        what = "period" if effect.is_periodic else "lag" if effect.is_lagging else "moment"
        raise EffectError(f"'{effect.name}': no {what} can be searched for in these rows")
    return (found.block if isinstance(found, Period) else found).setting
