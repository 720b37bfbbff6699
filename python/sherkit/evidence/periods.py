"""How well the period of an effect is known, and which others fit these poses as well.

What a wave takes of a residual, as a function of its frequency, is the periodogram; given the fitted parameters it is
the profile of the likelihood (Lomb, "Least-squares frequency analysis of unequally spaced data", Astrophys. Space Sci.
1976; VanderPlas, "Understanding the Lomb-Scargle periodogram", ApJS 2018).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import scipy

from ..base import linalg
from ..base.names import listed
from ..base.types import Floats, Ints
from ..model.effect import Effect
from .base import Base
from .blocks import Block
from .settings import columns_at
from .waves import TURN

#: Change of χ² from which on a period counts as better than another, besides what choosing among all brings by
#: chance: beyond it the odds are "very strong" (Kass and Raftery, "Bayes factors", JASA 1995).
_CLEARLY = 10.0
#: A frequency of the grid may lie half a step off its peak and take this part of it.
_NEAR_PEAK = 0.6
#: Aliases that are named.
_MOST_ALIASES = 6
#: Part of a wave's square that what is in the model must leave for it to be seen.
_SEEN = 0.01


@dataclass(frozen=True)
class Period:
    """The period at which an effect takes most, in the unit of the joints, and its standard deviation.

    ``given`` is the one that the model has, None where it has none, and ``in_file`` where a robot's file says it.
    ``aliases`` are others that these poses cannot tell from it. ``block`` is the effect at the period to use.
    """

    block: Block
    value: float
    std: float
    given: float | None
    aliases: tuple[float, ...]
    in_file: str = ""

    @property
    def chosen(self) -> bool:
        """Whether the effect stays at the period that the model has."""
        return self.block.setting is None

    @property
    def sentences(self) -> tuple[str, ...]:
        """What a person is to know of it."""
        effect = self.block.effect
        assert effect is not None, "shapes have no period of their own"
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


def period_of(base: Base, effect: Effect) -> Period | None:
    """The best period of an effect beside what is in a model, with its aliases; None where none can be tried.

    The period that the model has stays unless another is clearly better; so does, on a ring, the half turn, which is
    what two reading heads leave.
    """
    tried = [i for i, block in enumerate(base.family.blocks) if block.name == effect.name]
    waves = sorted((i for i in tried if base.family.blocks[i].setting), key=lambda i: -_period(base, i))
    if not waves:
        return None
    view = base.family.run.view
    at = np.array([1.0 / _period(base, i) for i in waves])
    gains = base.gains[0][waves]
    spans = [float(np.ptp(view.inputs[name])) for name in view.waving]
    span, ring = max(spans), effect.search == "period_rad"
    step = float(np.median(np.diff(at))) if len(at) > 1 else 0.5 / span

    def taken(frequency: float) -> float:
        return _taken(base, effect, 1.0 / frequency)

    best, most = _peak(taken, at[int(np.argmax(gains))], step, ring=ring)
    noise = (base.rss - most) / max(base.free - 2 * len(spans), 1)
    had = next(period for one, period in view.periodic if one.name == effect.name)
    usual = 0.5 * TURN if had is None and ring else had
    least = (2.0 * np.log(len(at)) + _CLEARLY) * noise
    if usual is not None and 1.0 / usual <= at.max() + step and most - taken(1.0 / usual) < least:
        best, most = 1.0 / usual, taken(1.0 / usual)
    given = next((base.family.blocks[i] for i in tried if base.family.blocks[i].setting is None), None)
    stays = given is not None and had is not None and best == 1.0 / had
    others: list[float] = []
    for k in _peaks(gains, _NEAR_PEAK * most):
        other, takes = _peak(taken, at[k], step, ring=ring)
        if all(abs(other - one) * span > 0.5 for one in (best, *others)) and most - takes < _CLEARLY * noise:
            others.append(other)
    # how sharply the profile falls on both sides
    h = 0.1 / span
    bend = (2.0 * most - taken(best - h) - taken(best + h)) / h**2
    std = np.sqrt(2.0 * noise / bend) / best**2 if bend > 0 else np.inf
    block = given if given is not None and stays else replace(base.family.blocks[waves[0]], setting=1.0 / best)
    aliases = tuple(1.0 / one for one in others[:_MOST_ALIASES])
    return Period(block, 1.0 / best, float(std), had, aliases, base.family.run.of.model.period_in_file)


def _period(base: Base, i: int) -> float:
    setting = base.family.blocks[i].setting
    assert setting is not None, "a wave has a period"
    return setting


def _taken(base: Base, effect: Effect, period: float) -> float:
    """Sum of squares that a wave on all inputs takes.

    Beside a period at which these poses cannot see a wave (joints that stand at its multiples), one of metres takes
    what a straight line would: what the model leaves of a wave but for so little does not count as one.
    """
    columns = base.family.run.flat(columns_at(base.family.run, effect, period))
    # sine and cosine of an input share a scale: where it stands at multiples of a period, there is no sine
    pairs = np.square(columns).sum(axis=0).reshape(-1, 2).mean(axis=1)
    columns = columns / np.sqrt(np.maximum(np.repeat(pairs, 2), np.finfo(float).tiny))
    over = columns - base.basis @ (base.basis.T @ columns)
    left, directions = linalg.eigh(over.T @ over)
    seen = left > _SEEN
    return float(((directions[:, seen].T @ (over.T @ base.residual)) ** 2 / left[seen]).sum())


def _peak(taken: Callable[[float], float], near: float, step: float, *, ring: bool) -> tuple[float, float]:
    """The frequency at which a wave takes most, and how much, about one of the grid; of a ring whole numbers a turn."""
    if ring:
        turns = np.arange(np.round(TURN * (near - step)), np.round(TURN * (near + step)) + 1.0)
        return max(((k / TURN, taken(k / TURN)) for k in turns.tolist() if k >= 2.0), key=lambda one: one[1])
    found = scipy.optimize.minimize_scalar(
        lambda f: -taken(f), bounds=(max(near - step, 0.5 * near), near + step), method="bounded",
        options={"xatol": 1e-3 * step},
    )  # fmt: skip
    return float(found.x), -float(found.fun)


def _peaks(gains: Floats, least: float) -> Ints:
    """Local maxima of a periodogram that take at least so much, the highest first."""
    padded = np.concatenate([[-np.inf], gains, [-np.inf]])
    peaks = np.flatnonzero((gains >= padded[:-2]) & (gains >= padded[2:]) & (gains >= least))
    return peaks[np.argsort(-gains[peaks], kind="stable")]
