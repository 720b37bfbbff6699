"""The period of an effect: made finer than the grid, how well it is known, and which others fit these poses as well.

What a wave takes of a residual, as a function of its frequency, is the periodogram; given the fitted parameters it is
the profile of the likelihood (Lomb, "Least-squares frequency analysis of unequally spaced data", Astrophys. Space Sci.
1976; VanderPlas, "Understanding the Lomb-Scargle periodogram", ApJS 2018).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from ..base import linalg
from ..base.names import listed
from ..base.types import Floats, Ints
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
