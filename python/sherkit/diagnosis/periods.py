"""The period, moment or lag of an effect made finer than the grid; how well a period is known, and which others fit
these poses as well.

What a wave takes of a residual, as a function of its frequency, is the periodogram; given the fitted parameters it is
the profile of the likelihood (Lomb, "Least-squares frequency analysis of unequally spaced data", Astrophys. Space Sci.
1976; VanderPlas, "Understanding the Lomb-Scargle periodogram", ApJS 2018).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import scipy

from ..base import linalg
from ..base.names import listed
from ..base.types import Floats, Ints
from .columns import Block
from .stage import Candidate, Stage
from .waves import OVERSAMPLING, TURN, frequencies, rings

#: Change of χ² from which on a period counts as better than another, besides what choosing among all brings by
#: chance: beyond it the odds are "very strong" (Kass and Raftery, "Bayes factors", JASA 1995).
_CLEARLY = 10.0
#: A frequency of the grid may lie half a step off its peak and take this part of it.
_NEAR_PEAK = 0.6
#: Aliases that are named.
_MOST_ALIASES = 6
#: Part of a wave's sum of squares that the fitted parameters must leave for it to be seen.
_SEEN = 0.01


@dataclass(frozen=True)
class Period:
    """The period at which an effect takes most, in the unit of the joints, and its standard deviation.

    ``given`` is the one that the model has, None where it has none, and ``in_file`` where a robot's file says it;
    ``chosen`` whether that is as good. ``aliases`` are others that these poses cannot tell from it. ``candidate`` is
    the effect at the period to use.
    """

    candidate: Candidate
    value: float
    std: float
    given: float | None
    aliases: tuple[float, ...]
    in_file: str = ""

    @property
    def chosen(self) -> bool:
        """Whether the effect stays at the period that the model has."""
        return self.candidate.setting is None

    @property
    def sentences(self) -> tuple[str, ...]:
        """What a person is to know of it."""
        effect = self.candidate.effect
        unit = (effect.search or "").removeprefix("period_")
        value = _told(self.value, self.std)
        per_turn = f", {round(TURN / self.value)} per turn" if unit == "rad" else ""
        out = []
        if not self.chosen:
            out.append(f"{effect.name}: period {value} {unit}{per_turn}{self._instead(unit)}")
        if self.aliases:
            others = listed([f"{alias:.4g}" for alias in self.aliases])
            at = f"{self.given:g}" if self.chosen else value
            out.append(
                f"{effect.name}: a period of {others} {unit} fits as well as {at} {unit} (alias: these poses cannot "
                "tell one from the other); poses at uneven distances would"
            )
        return tuple(out)

    def _instead(self, unit: str) -> str:
        """What the model had, or the file lacks."""
        if self.given is not None:
            return f" where the model had {self.given:g} {unit}" + (f": correct {self.in_file}" if self.in_file else "")
        return f"; the robot file does not give it: add {self.in_file}" if self.in_file else ""


def _told(value: float, std: float) -> str:
    """A number with its deviation, to two digits of that."""
    if not 0 < std < abs(value):
        return f"{value:.6g}"
    digits = max(0, 1 - int(np.floor(np.log10(std))))
    return f"{value:.{digits}f} ± {std:.{digits}f}"


def period_of(stage: Stage, tried: Sequence[Candidate], *, aliases: bool = False) -> Period | None:
    """The best period of an effect among what a thorough stage has tried of it; None where it tried none.

    The period that the model has stays unless another is clearly better; so does, on a ring, the half turn, which is
    what two reading heads leave. Only where asked for are the aliases found.
    """
    given = next((c for c in tried if c.setting is None), None)
    waves = [c for c in tried if c.setting is not None]
    if not waves:
        return None
    place = {id(c): k for k, c in enumerate(stage.candidates)}
    gains = np.array([stage.gains[place[id(c)]] for c in waves])
    at = np.array([1.0 / (c.setting or np.inf) for c in waves])
    profile = _Profile(stage)
    top = int(np.argmax(gains))
    best, most = profile.peak(at[top])
    noise = (stage.scan.sum_of_squares - most) / max(stage.scan.free - 2 * len(stage.view.waving), 1)
    clearly = (2.0 * np.log(len(at)) + _CLEARLY) * noise
    had = next(period for effect, period in stage.view.periodic if effect is waves[top].effect)
    usual = 0.5 * TURN if had is None and profile.whole else had
    if usual is not None and 1.0 / usual > profile.highest:
        usual = None
    taken = profile.taken(1.0 / usual) if usual is not None else 0.0
    if usual is not None and most - taken < clearly:
        best, most = 1.0 / usual, taken
    stays = given is not None and 1.0 / best == had
    near = waves[int(np.argmin(np.abs(at - best)))]
    candidate = given if given is not None and stays else replace(near, setting=1.0 / best)
    others: list[float] = []
    if aliases:
        for k in _peaks(gains, _NEAR_PEAK * most):
            other, takes = profile.peak(at[k])
            apart = abs(other - best) * profile.span > 0.5 and all(abs(other - o) * profile.span > 0.5 for o in others)
            if apart and most - takes < _CLEARLY * noise:
                others.append(other)
    std = profile.deviation(best, noise) / best**2
    return Period(
        candidate, 1.0 / best, std, had, tuple(1.0 / f for f in others[:_MOST_ALIASES]), stage.run.model.period_in_file
    )


def _peaks(gains: Floats, least: float) -> Ints:
    """Local maxima of a periodogram that take at least so much, the highest first."""
    padded = np.concatenate([[-np.inf], gains, [-np.inf]])
    peaks = np.flatnonzero((gains >= padded[:-2]) & (gains >= padded[2:]) & (gains >= least))
    return peaks[np.argsort(-gains[peaks], kind="stable")]


class _Profile:
    """What a wave on all inputs takes of a stage's residual, given what is fitted, at any frequency.

    Beside a frequency at which these poses cannot see a wave (joints that stand at its multiples), one of metres takes
    what a straight line would. What the fitted parameters leave of a wave but for so little does not count as one.
    """

    def __init__(self, stage: Stage) -> None:
        self.stage = stage
        self.whole = rings(stage.view)
        grid = np.sort(frequencies(stage.view))
        self.span = max(float(np.ptp(stage.view.inputs[n])) for n in stage.view.waving)
        self.highest = stage.scan.waves.waves.highest * stage.scan.waves.waves.unit if stage.scan.waves else 0.0
        self.step = float(np.median(np.diff(grid))) if len(grid) > 1 else 1.0 / (OVERSAMPLING * self.span)

    def taken(self, frequency: float) -> float:
        """Sum of squares that it takes."""
        gram, along, whole = self.stage.scan.along_waves(frequency)
        # sine and cosine of an input share a scale: where it stands at multiples of a period, there is no sine
        pairs = whole.reshape(-1, 2).mean(axis=1)
        scale = 1.0 / np.sqrt(np.maximum(np.repeat(pairs, 2), np.finfo(float).tiny))
        left, directions = linalg.eigh(scale[:, None] * gram * scale)
        seen = left > _SEEN
        taken = (directions[:, seen].T @ (scale * along)) ** 2 / left[seen]
        return float(taken.sum())

    def peak(self, near: float) -> tuple[float, float]:
        """The frequency at which it takes most, and how much, about one of the grid."""
        if self.whole:
            turns = np.arange(np.round(TURN * (near - self.step)), np.round(TURN * (near + self.step)) + 1.0)
            scored = [(self.taken(k / TURN), k / TURN) for k in turns if k >= 2.0]
            return max(scored)[::-1]
        low = max(near - self.step, 0.5 * near)
        found = scipy.optimize.minimize_scalar(
            lambda f: -self.taken(f), bounds=(low, near + self.step), method="bounded",
            options={"xatol": 1e-3 * self.step},
        )  # fmt: skip
        return float(found.x), -float(found.fun)

    def deviation(self, frequency: float, noise: float) -> float:
        """Standard deviation of a frequency, from how sharply the profile falls on both sides."""
        h = 0.1 / self.span
        around = [self.taken(f) for f in (frequency - h, frequency, frequency + h)]
        bend = (2.0 * around[1] - around[0] - around[2]) / h**2
        return float(np.sqrt(2.0 * noise / bend)) if bend > 0 else float("inf")


# -- Settings in time, made finer than their grid: the moment of a step, the lag of what follows -------------------

#: A lag is known no better than by this factor where a stand is; and so many are looked at between two of the grid.
_FINER = 9
#: Part of the longest row of columns below which a direction of them is none.
_NOTHING = 1e-9


def at_the_row(stage: Stage, candidate: Candidate) -> Candidate:
    """A step at a searched time to the row: the cut that leaves least.

    A step at a link is compared with the same columns without a step, since what is fitted holds them, or nearly so:
    of what each reading is off by the mean, of what a joint is off by its zero.
    """
    view = stage.view
    if candidate.effect.search != "time_s" or candidate.setting is None or view.time is None:
        return candidate
    time, e = view.time, view.residual
    n = len(e)
    near = int(np.searchsorted(time, candidate.setting))
    reach = n // 20 + 2
    cuts = np.arange(max(near - reach, 2), min(near + reach, n - 2))
    place = next((at for effect, at in view.in_time if effect.name == candidate.name), None)
    if place is None:
        total, sums = e.sum(axis=0), np.cumsum(e, axis=0)
        before = sums[cuts - 1]
        gain = ((before - cuts[:, None] / n * total) ** 2).sum(axis=1) / (cuts * (n - cuts) / n)
    else:
        gain = _of_columns(np.concatenate([view.effects_in(rows)[:, :, place] for rows in view.blocks]), e, cuts)
    cut = int(cuts[np.argmax(gain)])
    # between the last reading before and the first after
    return Candidate(candidate.effect, candidate.columns, float(0.5 * (time[cut - 1] + time[cut])))


def _of_columns(columns: Floats, e: Floats, cuts: Ints) -> Floats:
    """Sum of squares (c,) of residuals (n, m) that columns (n, m, k) take from each cut on beside themselves."""
    first, last = int(cuts[0]), int(cuts[-1]) + 1
    whole = np.einsum("nmk,nml->kl", columns, columns)
    scale = np.sqrt(np.diag(whole))
    columns = (
        columns[:, :, scale > _NOTHING * scale.max(initial=0.0)] / scale[scale > _NOTHING * scale.max(initial=0.0)]
    )

    def since(rows: slice) -> tuple[Floats, Floats]:
        return np.einsum("nmk,nml->nkl", columns[rows], columns[rows]), np.einsum("nmk,nm->nk", columns[rows], e[rows])

    gram, along = (one.sum(axis=0) for one in since(slice(None)))
    before = [one.sum(axis=0) for one in since(slice(0, first))]
    grams, alongs = (b + np.cumsum(one, axis=0) for b, one in zip(before, since(slice(first, last)), strict=True))
    # the sums up to a cut hold the rows before it alone
    grams = np.concatenate([before[0][None], grams])[: len(cuts)]
    alongs = np.concatenate([before[1][None], alongs])[: len(cuts)]
    inverse = linalg.pinv(gram, hermitian=True)
    left = grams - grams @ inverse @ grams
    of = alongs - grams @ inverse @ along
    return np.einsum("ck,ckl,cl->c", of, linalg.pinv(left, rcond=1e-9, hermitian=True), of)


def best_lag(stage: Stage, best: Candidate, at_once: tuple[float, Candidate] | None) -> Candidate:
    """An effect at the lag that leaves least, between those of the grid; at that of the model where a lag is not worth
    its number."""
    behind = next((one for effect, one in stage.view.lagging if effect.name == best.name), None)
    if best.setting is None or behind is None:
        return best

    def columns(lag: float, rows: slice, block: Block) -> Floats:
        del block
        return stage.filtered.on(behind(lag), rows)

    lags = best.setting * 2.0 ** np.linspace(-1.0, 1.0, _FINER)
    image = stage.scan.image([partial(columns, lag) for lag in lags.tolist()])
    left = np.array([image.rss(k) for k in range(len(lags))])
    finest = int(np.argmin(left))
    if at_once is not None:
        total, n = stage.scan.sum_of_squares, stage.scan.n * stage.scan.m
        # Schwarz's price of one number more
        if n * np.log((total - at_once[0]) / max(left[finest], np.finfo(float).tiny)) < np.log(n):
            return at_once[1]
    return Candidate(best.effect, best.columns, float(lags[finest]))
