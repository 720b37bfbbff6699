"""Sets of effects that were refitted in full, and how near they come to the data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from ..base.types import Floats
from ..evidence.fitted_run import FittedRun
from ..evidence.sizes import displaces, is_plausible
from ..evidence.whitening import orthonormal
from ..model.sensor_pose import SLIP
from .scan import Scan
from .shapes import Shape, wave
from .stage import Candidate, Stage

# -- Of the shapes that describe what is left as well as one another the simplest comes first, and no period that
# the poses cannot tell from a slow bend ----------------------------------------------------------------------------

#: Difference of Schwarz's criterion that counts as clear (Kass and Raftery, "Bayes factors", JASA 1995).
CLEARLY = 6.0
#: Kinds of shapes, the simplest first.
_SIMPLEST = ("smooth", "step", "interaction", "hysteretic", "periodic")
#: Waves slower than this part of a frequency, and the part of a wave from which on they stand in for it, where values
#: are too far apart to tell.
_SLOWER, _STANDS_IN = 0.8, 0.8
#: Values that tell whether they do.
_LOOKED_AT = 2000


def lowest(stage: Stage, scores: Floats) -> Shape | None:
    """The shape of a stage with the lowest criterion below zero, where there is one: the simplest of those as low."""
    near = as_low(stage, scores)
    return min(near, key=partial(simplicity, stage))[0] if near else None


def simplicity(stage: Stage, one: tuple[Shape, float]) -> tuple[float, ...]:
    """What orders shapes with their criterion, the simplest first: numbers, a period being one; kind; variables."""
    shape, score = one
    numbers = len(stage.scan.numbers(shape.columns)) + (shape.period is not None)
    return numbers, _SIMPLEST.index(shape.shape), len(shape.depends_on), score


def as_low(stage: Stage, scores: Floats, more: float = CLEARLY) -> list[tuple[Shape, float]]:
    """Shapes whose criterion is below zero and higher by less than ``more`` than the lowest, with it, the lowest first.
    A period that slower waves stand in for on these poses is none."""
    out: list[tuple[Shape, float]] = []
    for k in np.argsort(scores[: stage.n_shapes]).tolist():
        if scores[k] >= min(0.0, out[0][1] + more if out else 0.0):
            break
        shape = stage.shapes[k]
        told = shape.period is None or shape.depends_on[0] not in stage.view.place
        if told or not is_alias(stage.view.variables[shape.depends_on[0]], shape.period or 0.0):
            out.append((shape, float(scores[k])))
    return out


def is_alias(values: Floats, period: float) -> bool:
    """Whether slower waves stand in for one of this period at the ``values`` that a variable has: on the lines of a
    grid one as short as their distance is next to nothing, or what any slow bend is."""
    some = np.sort(values)[:: max(len(values) // _LOOKED_AT, 1)]
    u = (some - some[0]) / (some[-1] - some[0])
    waves = np.stack(wave(some, period), axis=1)
    half = np.arange(0, 2.0 * _SLOWER * (some[-1] - some[0]) / period + 1e-9)
    if 2 * len(half) >= len(some):
        return False
    basis = orthonormal(np.cos(np.pi * np.outer(u, half)), 1e-6)
    left = waves - basis @ (basis.T @ waves)
    return bool((left**2).sum() < (1.0 - _STANDS_IN) * (waves**2).sum())


# -- Sets of effects -------------------------------------------------------------------------------------------------


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


def said_of_the_instrument(near: list[Explanation]) -> list[Explanation]:
    """The same sets, in front the one that has a step of the instrument where the first has what the robot does in
    time: where both come as near the data, an instrument is moved more easily than a robot."""
    lead = set(near[0].names) if near else set()
    for k, other in enumerate(near):
        step = next((c.effect for c in other.candidates if c.name == SLIP and SLIP not in lead), None)
        instead = [c.effect for c in near[0].candidates if c.name not in other.names]
        if step is None or {*other.names} - lead != {SLIP} or len(instead) != 1:
            continue
        if "time_s" in instead[0].needs and instead[0].link != step.link and other in as_near(near[:1], [other]):
            return [other, *near[:k], *near[k + 1 :]]
    return near


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
