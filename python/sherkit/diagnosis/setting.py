"""Settings of effects that are searched for besides their parameters: the moment of a step, the period of a wave."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..errors import EffectError
from ..fit.identify import Fit
from ..model.effect import Effect
from .explanation import refit
from .fitted_run import FittedRun
from .periods import Period, period_of
from .search import Search, SearchResult
from .stage import Candidate, Stage


def searched(run: FittedRun, effect: Effect) -> Candidate | None:
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
        found = searched(beside, candidate.effect) if period is None else period.candidate
        out.append(candidate if found is None else found)
        told += () if period is None else period.sentences
        if out[-1].effect.is_lagging and (lag := out[-1].setting):
            told.append(f"{candidate.name}: it comes {lag:.3g} s after the recorded temperature")
    return out, tuple(told)


def as_shown(search: Search, found: SearchResult) -> Stage:
    """What a search saw first, as a report shows it: an effect whose period is searched at the one that was found, or
    at which it would have been tried first."""
    first = found.stages[0]
    tried = (*search.strongest_settings(first), *found.added)
    at = {c.name: c for c in tried if c.effect.is_periodic and c.columns.waves}
    return first.asking([*(c for c in first.candidates if not c.columns.waves), *at.values()])


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
    found = searched(FittedRun(fit), effect)
    if found is None:
        what = "period" if effect.is_periodic else "lag" if effect.is_lagging else "moment"
        raise EffectError(f"'{effect.name}': no {what} can be searched for in these rows")
    return found.setting
