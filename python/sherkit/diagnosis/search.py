"""Every effect as reports show it: to first order, at the setting at which it takes most."""

from __future__ import annotations

from collections.abc import Sequence
from weakref import WeakKeyDictionary

import numpy as np

from ..base.types import Floats, Ints
from ..evidence.fitted_run import FittedRun
from ..model.effect import Effect
from .periods import at_the_row, best_lag, period_of
from .stage import Candidate, Stage, stage_of


class Search:
    """Carries what stays the same: rows, noise (columns,), effects."""

    def __init__(
        self, base: FittedRun, effects: Sequence[Effect], rows: Ints, sigma: Floats, *, rho: float | None = None
    ) -> None:
        self.effects, self.rows, self.sigma, self.rho = tuple(effects), rows, sigma, rho
        self.base = base.on(rows, sigma)
        self._strongest_of: WeakKeyDictionary[Stage, list[Candidate]] = WeakKeyDictionary()

    def stage(self, run: FittedRun) -> Stage:
        """The stage of a run; the correlation of the noise is estimated once, at the first."""
        stage = stage_of(run, self.effects, np.arange(len(self.rows)), self.sigma, rho=self.rho)
        self.rho = stage.filtered.rho
        return stage

    def strongest_settings(self, stage: Stage) -> list[Candidate]:
        """One candidate per effect: where a setting is searched for, the one that takes most, made finer."""
        if (known := self._strongest_of.get(stage)) is not None:
            return known
        tried: dict[str, list[tuple[float, Candidate]]] = {}
        for gain, candidate in zip(stage.gains.tolist(), stage.candidates, strict=True):
            tried.setdefault(candidate.name, []).append((gain, candidate))
        found = self._strongest_of[stage] = [self._strongest(stage, scored) for scored in tried.values()]
        return found

    def _strongest(self, stage: Stage, scored: Sequence[tuple[float, Candidate]]) -> Candidate:
        """Of one effect at several settings, the one that takes most, made finer."""
        _, best = max(scored, key=lambda s: s[0])
        if best.effect.is_periodic:
            period = period_of(stage, [c for _, c in scored])
            return best if period is None else period.candidate
        if best.effect.is_lagging:
            at_once = next((c for c in scored if c[1].setting is None), None)
            return best_lag(stage, best, at_once)
        return at_the_row(stage, best)
