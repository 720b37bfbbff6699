"""The effects that a diagnosis names: those that the search finds and that earn their place, each given all others; and
the settings with which they are fitted.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ..base.types import Floats, Ints
from ..errors import EffectError
from ..evidence.base import Base
from ..evidence.family import Family
from ..evidence.fitted_run import FittedRun
from ..evidence.names import Names, names_of
from ..evidence.run import run_of
from ..evidence.sets import EffectSet, Sets
from ..fit.identify import Fit
from ..model.effect import Effect
from .answers import StepReport
from .columns import Columns
from .held_out import HeldOutGain, error_of, held_out_gain
from .periods import Period, period_of
from .search import Search
from .stage import Candidate, Stage

#: Nothing that is missing is asked for where a fit leaves nothing but rounding.
_NOTHING = -np.inf


@dataclass(eq=False)
class Named:
    """What the evidence of a run says: the ``added`` effects that it names, in the order in which the error falls, the
    full fit with them, ``final``, and what each of them earns.

    ``names`` are all that were judged, None where nothing was looked for; ``missing`` and ``left`` are the evidence, in
    nats, that something is missing before anything is added and after; ``stage`` is the run as reports show it;
    ``notes`` are on effects that were found and are not named.
    """

    stage: Stage
    search: Search
    names_judged: Names | None
    missing: float
    left: float
    final: FittedRun
    added: list[Candidate] = field(default_factory=list)
    gains: list[HeldOutGain] = field(default_factory=list)
    steps: tuple[StepReport, ...] = ()
    notes: list[str] = field(default_factory=list)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the effects, in the order of the steps."""
        return tuple(c.name for c in self.added)

    @property
    def ties(self) -> tuple[EffectSet, ...]:
        """Sets of effects that do as well as those that are named."""
        judged = self.names_judged
        return judged.ties if judged is not None and self.added and not judged.refused else ()

    @property
    def structure(self) -> bool:
        """Whether what is left has one that nothing named explains."""
        judged = self.names_judged
        return judged is not None and judged.lead is not None and not (judged.explains and self.added)


def searched(
    run: FittedRun,
    effects: Sequence[Effect],
    rows: Ints,
    sigma: Floats,
    repeated_folds: Sequence[Ints],
    *,
    level: float,
    seed: int,
    step: Callable[[str], None],
    look: bool,
) -> Named:
    """Asks the evidence of these rows what is missing, and names what may be named. Nothing is looked for where there
    is nothing to ``look`` for: what a mistake of the set-up leaves says nothing on physics."""
    search = Search(run, effects, rows, sigma)
    stage = search.stage(search.base)
    first = (StepReport(None, error_of(run, sigma, repeated_folds)),)
    if run.is_exact:
        return Named(stage, search, None, _NOTHING, _NOTHING, run, steps=first)
    step("evidence")
    family = Family(run_of(run.on(np.arange(len(run.data)), sigma), rows, effects, sigma))
    sets = Sets(family, Base.of(family, family.run), step)
    missing = sets.base.evidence
    if not look or missing < -np.log(level):
        return Named(stage, search, None, missing, missing, run, steps=first)
    names = names_of(sets)
    lead = names.lead
    if lead is None:
        return Named(stage, search, names, missing, missing, run, steps=first)
    refused = dict(names.refused)
    if not refused and (why := _too_many(run, lead.run.of)):
        refused = dict.fromkeys(lead.names, why)
    names = replace(names, refused=refused)
    notes = [f"{name} was found and is not named: {why}" for name, why in refused.items()]
    named = [block for block in lead.blocks if block.name not in refused]
    added = [Candidate(b.effect, Columns(exact=True), b.setting) for b in named if b.effect is not None]
    if not added:
        return Named(stage, search, names, missing, missing, run, steps=first, notes=notes)
    added, told = on_all_rows(run, added)
    step("held-out errors")
    final, ordered, gains, steps = _judged(run, added, sigma, repeated_folds, seed, first[0])
    notes += told
    return Named(stage, search, names, missing, lead.rest, final, ordered, gains, steps, notes)


def _too_many(run: FittedRun, final: FittedRun) -> str:
    """Why a fit with what was found is no witness; empty where it is one."""
    left = len(np.unique(run.data.standing[run.whole])) * len(run.axes) - final.fit.rank
    if left < final.fit.rank - run.fit.rank:
        return "it takes more numbers than these poses leave to judge it by"
    if run.fit.converged and not final.fit.converged:
        return "with it the fit does not converge"
    return ""


def _judged(
    run: FittedRun,
    added: Sequence[Candidate],
    sigma: Floats,
    repeated_folds: Sequence[Ints],
    seed: int,
    base: StepReport,
) -> tuple[FittedRun, list[Candidate], list[HeldOutGain], tuple[StepReport, ...]]:
    """The fit with all that was found, in the order in which the error falls, and what each earns."""
    steps, left, partial = [base], list(added), run
    ordered: list[Candidate] = []
    while left:
        options = [(error_of(with_it, sigma, repeated_folds), k, with_it)
                   for k, with_it in enumerate(refit(partial, (c,)) for c in left)]  # fmt: skip
        error, k, partial = min(options, key=lambda o: (o[0].rms, o[1]))
        ordered.append(left.pop(k))
        steps.append(StepReport(ordered[-1].name, error))
    gains = [held_out_gain(partial, c.effect, sigma=sigma, repeated_folds=repeated_folds, seed=seed) for c in ordered]
    return partial, ordered, gains, tuple(steps)


def refit(run: FittedRun, candidates: Sequence[Candidate]) -> FittedRun:
    """The full fit with these candidates, at the settings they were found with."""
    return run.refit([c.addition for c in candidates])


def not_needed(
    run: FittedRun, effects: Sequence[Effect], sigma: Floats, repeated_folds: Sequence[Ints], seed: int
) -> list[HeldOutGain]:
    """What each of the ``effects`` that were in the model earns. Of those that earn nothing the least useful is taken
    out first, and the others are judged without it: of two that say the same only one is not needed."""
    out: list[HeldOutGain] = []
    left = list(effects)
    also: list[str] = []
    while left:
        gains = [held_out_gain(run, e, sigma=sigma, repeated_folds=repeated_folds, also=also, seed=seed) for e in left]
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


def at_its_setting(run: FittedRun, effect: Effect) -> Candidate | None:
    """The effect at the setting at which it takes most of what a run leaves; None where it cannot be tried."""
    search, stage = _looked_at(run, effect)
    return next((c for c in search.strongest_settings(stage) if c.name == effect.name), None)


def _looked_at(run: FittedRun, effect: Effect) -> tuple[Search, Stage]:
    rows = np.flatnonzero(run.whole)
    search = Search(run, (effect,), rows, run.noise[0], rho=0.0)
    return search, search.stage(search.base)


def on_all_rows(run: FittedRun, added: Sequence[Candidate]) -> tuple[list[Candidate], tuple[str, ...]]:
    """These effects at the settings that all rows of a run give, each with the others in the model; and what a person
    is to know of their periods."""
    out: list[Candidate] = []
    told: list[str] = []
    for candidate in added:
        if candidate.effect.search is None:
            out.append(candidate)
            continue
        others = [c for c in added if c is not candidate]
        beside = refit(run, others) if others else run
        period = period_in(beside, candidate.effect) if candidate.effect.is_periodic else None
        found = at_its_setting(beside, candidate.effect) if period is None else period.candidate
        out.append(candidate if found is None else found)
        told += () if period is None else period.sentences
        if out[-1].effect.is_lagging and (lag := out[-1].setting):
            told.append(f"{candidate.name}: it comes {lag:.3g} s after the recorded temperature")
    return out, tuple(told)


def as_shown(found: Named) -> Stage:
    """What was seen first, as a report shows it: each effect at the setting that was found, or at which it would have
    been tried first."""
    first = found.stage
    at = {c.name: c for c in found.search.strongest_settings(first)}
    for added in found.added:
        tried = [c for c in first.candidates if c.name == added.name and (c.setting is None) == (added.setting is None)]
        if tried:
            near = min(tried, key=lambda c: abs((c.setting or 0.0) - (added.setting or 0.0)))
            at[added.name] = replace(near, setting=added.setting)
    return first.asking(list(at.values()))


def period_in(run: FittedRun, effect: Effect) -> Period | None:
    """The period at which an effect takes most of what a run leaves, with its aliases; None where it cannot be
    tried."""
    _, stage = _looked_at(run, effect)
    return period_of(stage, [c for c in stage.candidates if c.name == effect.name], aliases=True)


def setting_for(fit: Fit, effect: Effect) -> float | None:
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
    return found.setting
