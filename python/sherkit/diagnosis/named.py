"""The effects that a diagnosis names: those that the search finds and that earn their place, each given all others; and
the settings with which they are fitted.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from ..base.types import Floats, Ints
from ..errors import EffectError
from ..evidence.fitted_run import FittedRun
from ..evidence.sizes import ABSURD, sizes_of
from ..fit.identify import Fit
from ..model.effect import Effect
from .answers import StepReport
from .beside import Alone, innocents
from .explanation import refit
from .held_out import HeldOutGain, error_of, held_out_gain
from .periods import Period, period_of
from .search import Search, SearchResult
from .shapes import Shape
from .stage import Candidate, Stage

#: Searches that end with a refusal before no other effects are tried.
_MOST_SEARCHES = 4
#: Other periods that compete with the one that was found.
_MOST_PERIODS = 24


@dataclass(eq=False)
class Named:
    """The last search, the full fit with the effects that it named, in the order in which the error falls, and what
    each of them earns; ``notes`` on effects that were found and did not earn their place."""

    search: Search
    result: SearchResult
    final: FittedRun
    gains: list[HeldOutGain] = field(default_factory=list)
    steps: tuple[StepReport, ...] = ()
    notes: list[str] = field(default_factory=list)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the effects, in the order of the steps."""
        return tuple(c.name for c in self.result.added)


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
    periods: Sequence[tuple[str, float]] = (),
) -> Named:
    """Searches on all rows. An effect that does not earn its place on rows held out, as a member of what was found, is
    not named: the search is made again without it. Nothing is looked for where there is nothing to ``look`` for: what a
    mistake of the set-up leaves says nothing on physics. ``periods`` (variable, period) are tried as shapes besides."""
    refused: list[str] = []
    notes: list[str] = []
    alone: Alone | None = None
    in_model: tuple[Shape, ...] = ()
    searches, rho = 0, None
    while True:
        searches += 1
        tried = [e for e in effects if e.name not in refused]
        search = Search(run, tried, rows, sigma, level=level, rho=rho, seed=seed, periods=periods, step=step)
        result = search.find(in_model) if look else search.as_it_stands()
        # the noise is as correlated in time whoever is asked
        rho = search.rho
        base = StepReport(None, error_of(run, sigma, repeated_folds))
        if not result.added:
            return Named(search, result, run, [], (base,), notes)
        result.added, told = on_all_rows(run, result.added)
        step("held-out errors")
        final, gains, steps = _judged(run, result, tried, sigma, repeated_folds, seed, base)
        falls = all(after.error.rms < before.error.rms for before, after in pairwise(steps))
        refusals = _refusals(run, final, result, gains, falls)
        if not refusals:
            alone = alone or Alone(search, result.stages[0])
            refusals = innocents(search, result, final, gains, sigma, alone)
            if len(refusals) == len(gains):
                # nothing is lost by what describes the run: whoever is to be named is found in what that leaves
                in_model = alone.every.shapes
        if not refusals:
            return Named(search, result, final, gains, steps, [*notes, *told])
        refused += [name for name, _ in refusals]
        if searches == _MOST_SEARCHES:
            # one after another is found and earns nothing: nobody new is asked any more
            effects = [e for e in effects if any(one.holds for one in gains if one.effect == e.name)]
        notes += [f"{name} was found and is not named: {why}" for name, why in refusals]


def _refusals(
    run: FittedRun, final: FittedRun, result: SearchResult, gains: Sequence[HeldOutGain], falls: bool
) -> list[tuple[str, str]]:
    """The effect that must not be named whatever else shows, and why; none where each may."""
    sizes = sizes_of(final.fit)
    absurd = [c.name for c in result.added if (sizes[final.owns(c.effect)] > ABSURD).any()]
    if absurd:
        return [(absurd[-1], "its size would be absurd")]
    left = len(np.unique(run.data.standing[run.whole])) * len(run.axes) - final.fit.rank
    if left < final.fit.rank - run.fit.rank:
        return [(result.added[-1].name, "it takes more numbers than these poses leave to judge it by")]
    if run.fit.converged and not final.fit.converged:
        return [(result.added[-1].name, "with it the fit does not converge")]
    failing = [one for one in gains if not one.holds]
    if not failing and falls:
        return []
    worst = max(failing or gains, key=lambda one: one.p)
    why = (
        f"on rows that had no part in choosing it the error goes from {worst.without:.4g} to {worst.with_it:.4g} "
        f"{run.unit} (p = {worst.p:.2g}), and it is chosen again for {worst.again:.0%} of them"
    )
    return [(worst.effect, why)]


def _judged(
    run: FittedRun,
    result: SearchResult,
    effects: Sequence[Effect],
    sigma: Floats,
    repeated_folds: Sequence[Ints],
    seed: int,
    base: StepReport,
) -> tuple[FittedRun, list[HeldOutGain], tuple[StepReport, ...]]:
    """The fit with all that was found, what each earns, and the fall of the error; ``result.added`` is put in order."""
    steps, left, partial = [base], list(result.added), run
    ordered: list[Candidate] = []
    while left:
        options = [(error_of(with_it, sigma, repeated_folds), k, with_it)
                   for k, with_it in enumerate(refit(partial, (c,)) for c in left)]  # fmt: skip
        error, k, partial = min(options, key=lambda o: (o[0].rms, o[1]))
        ordered.append(left.pop(k))
        steps.append(StepReport(ordered[-1].name, error))
    result.added = ordered
    alike = {name for other in result.alternatives for name in other.names} | {c.name for c in ordered}
    gains = [
        held_out_gain(
            partial,
            c.effect,
            sigma=sigma,
            repeated_folds=repeated_folds,
            tried=effects,
            alike=alike,
            periods=_other_periods(result, c),
            seed=seed,
        )
        for c in ordered
    ]
    return partial, gains, tuple(steps)


def _other_periods(result: SearchResult, candidate: Candidate) -> tuple[float, ...]:
    """Periods apart from the one found at which a periodic effect took most: other rows might have chosen them."""
    stage = result.stages[0]
    if not candidate.effect.is_periodic:
        return ()
    found = candidate.setting or stage.run.model.setting_of(candidate.effect) or np.inf
    apart = 1.0 / max(float(np.ptp(stage.view.inputs[n])) for n in stage.view.waving)
    tried = [
        (gain, c.setting)
        for gain, c in zip(stage.gains.tolist(), stage.candidates, strict=True)
        if c.name == candidate.name and c.setting is not None and abs(1.0 / c.setting - 1.0 / found) > apart
    ]
    return tuple(setting for _, setting in sorted(tried, reverse=True)[:_MOST_PERIODS])


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
    search = Search(run, (effect,), rows, run.noise[0], level=0.01, rho=0.0)
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


def as_shown(search: Search, found: SearchResult) -> Stage:
    """What a search saw first, as a report shows it: each effect at the setting that was found, or at which it would
    have been tried first."""
    first = found.stages[0]
    at = {c.name: c for c in search.strongest_settings(first)}
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
