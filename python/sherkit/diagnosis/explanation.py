"""Sets of effects that were refitted in full, and how near they come to the data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..base.types import Floats
from ..model.effect import Effect
from .fitted_run import FittedRun
from .scan import Scan
from .simplest import CLEARLY
from .sizes import PLAUSIBLE, displaces, sizes_of
from .stage import Candidate, Stage


@dataclass(frozen=True, eq=False)
class Explanation:
    """A set of effects that was refitted in full. ``p_left`` is the familywise p of what it leaves."""

    candidates: tuple[Candidate, ...]
    stage: Stage
    p_left: float

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the effects."""
        return tuple(c.name for c in self.candidates)


def refit(run: FittedRun, candidates: Sequence[Candidate]) -> FittedRun:
    """The full fit with these candidates, at the settings they were found with."""
    return run.refit([c.addition for c in candidates])


def as_near(leading: Sequence[Explanation], every: Sequence[Explanation]) -> list[Explanation]:
    """The leading sets, and behind them all that come as near the data: what chance lets one of them leave at the level
    of the test tells it from no other."""
    if not leading:
        return []

    def scores(e: Explanation) -> Floats:
        """By the fit alone, and with a price on each number."""
        return np.array([schwarz(e.stage.scan, 0), bic(e.stage.scan, e.candidates)])

    limit = np.min([scores(e) for e in leading], axis=0) + CLEARLY
    return [*leading, *(e for e in every if e not in leading and (scores(e) < limit).any())]


def bic(scan: Scan, members: Sequence[Candidate]) -> float:
    """Schwarz's criterion of the model of a scan, for the added effects."""
    return bic_of(scan.sum_of_squares, scan.n * scan.m, members)


def schwarz(scan: Scan, count: int) -> float:
    """Schwarz's criterion of the model of a scan, for ``count`` added parameters."""
    return schwarz_of(scan.sum_of_squares, scan.n * scan.m, count)


def bic_of(left: float, n: int, members: Sequence[Candidate]) -> float:
    """Schwarz's criterion for a sum of squares that is ``left`` of ``n`` residuals with these effects."""
    return schwarz_of(left, n, sum(len(c.effect.parameters) + (c.setting is not None) for c in members))


def schwarz_of(left: float, n: int, count: int) -> float:
    """The same with ``count`` parameters."""
    # what explains everything leaves rounding, of either sign
    return float(n * np.log(max(left / n, np.finfo(float).tiny)) + count * np.log(n))


def plausible(explanation: Explanation, base: FittedRun) -> bool:
    """Whether every added effect came out with a plausible size, and left what was known of the ``base`` so."""
    run = explanation.stage.run
    return all(is_plausible(run, c.effect) for c in explanation.candidates) and not displaces(run.fit, base.fit)


def is_plausible(run: FittedRun, effect: Effect, most: float = PLAUSIBLE) -> bool:
    """Whether no parameter of an effect is beyond so many times its plausible size."""
    return bool((sizes_of(run.fit)[run.owns(effect)] <= most).all())
