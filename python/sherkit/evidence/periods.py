"""How well the period of an effect is known, and which others fit these poses as well.

What a wave takes of a residual, as a function of its frequency, is the periodogram; given the fitted parameters it is
the profile of the likelihood (Lomb, "Least-squares frequency analysis of unequally spaced data", Astrophys. Space Sci.
1976; VanderPlas, "Understanding the Lomb-Scargle periodogram", ApJS 2018).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import tau

import numpy as np
import scipy

from ..base.figures import listed
from ..base.types import Floats, Ints
from ..model.effect import Effect, Setting
from .base import Base
from .blocks import Block
from .ripple import CLEARLY, Ripple, ripple_of, wave_takes
from .settings import columns_at
from .thresholds import A_FEW

#: A frequency of the grid may lie half a step off its peak and take this part of it.
_NEAR_PEAK = 0.6


@dataclass(frozen=True)
class Period:
    """The period at which an effect takes most, in the unit of the joints, and its standard deviation.

    ``given`` is the one that the model has, None where it has none, and ``in_file`` where a robot's file says it.
    ``aliases`` are others that these poses cannot tell from it. ``block`` is the effect at the period to use, or at a
    period for each joint; ``own`` are the joints whose waves take more than chance, each at the period that it would
    have by itself, None where none does. ``made_by`` says what makes waves in such a machine.
    """

    block: Block
    value: float
    std: float
    given: Setting | None
    aliases: tuple[float, ...]
    in_file: str = ""
    own: Ripple | None = None
    made_by: str = ""

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
        if isinstance(self.block.setting, tuple):
            return (f"{effect.name}: {self.made_by or 'waves '}of {self._of_each(unit)}",)
        value = _told(self.value, self.std)
        per_turn = f", {round(tau / self.value)} per turn" if unit == "rad" else ""
        out = []
        if not self.chosen:
            joints = f" ({self.made_by}of {listed(self._joints)})" if self.own and self.made_by else ""
            out.append(f"{effect.name}: period {value} {unit}{per_turn}{joints}{self._instead(unit)}")
        if self.aliases:
            others = listed([f"{alias:.4g}" for alias in self.aliases])
            at = f"{self.given:g}" if self.chosen and isinstance(self.given, float) else value
            out.append(
                f"{effect.name}: a period of {others} {unit} fits as well as {at} {unit} (alias: these poses cannot "
                "tell one from the other); poses at uneven distances would"
            )
        return tuple(out)

    @property
    def _joints(self) -> list[str]:
        """Those whose waves are seen, in their order."""
        assert self.own is not None, "none is seen"
        return [f"joint {k}" for k, name in enumerate(self.own.inputs, start=1) if name in self.own.found]

    def _of_each(self, unit: str) -> str:
        """Joints that have waves, with their periods."""
        assert self.own is not None, "they were found"
        out = []
        for joint, name in zip(self._joints, (one for one in self.own.joints if one in self.own.found), strict=True):
            frequency, std = self.own.found[name]
            count, off = tau * frequency, tau * std
            if unit != "rad":
                at = f"{_told(1.0 / frequency, std / frequency**2)} {unit}"
            else:
                whole = abs(count - round(count)) < 1e-9 * count
                at = f"{f'{round(count)}' if whole else _told(count, off)} per turn"
            out.append(f"{joint} at {at}")
        return ", of ".join(out)

    def _instead(self, unit: str) -> str:
        """What the model had, or the file lacks."""
        if isinstance(self.given, float):
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
    waves = sorted(
        (i for i in tried if isinstance(base.family.blocks[i].setting, float)), key=lambda i: -_period(base, i)
    )
    if not waves:
        return None
    view = base.family.run.view
    at = np.array([1.0 / _period(base, i) for i in waves])
    gains = base.gains[0][waves]
    spans = [float(np.ptp(view.stood[name])) for name in view.waving(effect)]
    span, ring = max(spans), effect.search == "period_rad"
    step = float(np.median(np.diff(at))) if len(at) > 1 else 0.5 / span

    def taken(frequency: float) -> float:
        return _taken(base, effect, 1.0 / frequency)

    best, most = _peak(taken, at[int(np.argmax(gains))], step, ring=ring)
    noise = (base.rss - most) / max(base.free - 2 * len(spans), 1)
    had = next(period for one, period in view.periodic if one.name == effect.name)
    usual = 0.5 * tau if had is None and ring else had if isinstance(had, float) else None
    least = (2.0 * np.log(len(at)) + CLEARLY) * noise
    if usual is not None and 1.0 / usual <= at.max() + step and most - taken(1.0 / usual) < least:
        best, most = 1.0 / usual, taken(1.0 / usual)
    given = next((base.family.blocks[i] for i in tried if base.family.blocks[i].setting is None), None)
    stays = given is not None and isinstance(had, float) and best == 1.0 / had
    others: list[float] = []
    for k in _peaks(gains, _NEAR_PEAK * most):
        other, takes = _peak(taken, at[k], step, ring=ring)
        if all(abs(other - one) * span > 0.5 for one in (best, *others)) and most - takes < CLEARLY * noise:
            others.append(other)
    # how sharply the profile falls on both sides
    h = 0.1 / span
    bend = (2.0 * most - taken(best - h) - taken(best + h)) / h**2
    std = np.sqrt(2.0 * noise / bend) / best**2 if bend > 0 else np.inf
    block = given if given is not None and stays else replace(base.family.blocks[waves[0]], setting=1.0 / best)
    model, own = base.family.run.of.model, ripple_of(base, effect, alone=True)
    if own is not None:
        each = own.periods(1.0 / best)
        if own.given or _taken(base, effect, each) - most > own.chance * noise:
            most, block = _taken(base, effect, each), replace(block, setting=each)
    if given is not None and isinstance(had, tuple) and most - _taken(base, effect, had) < least:
        block = given
    aliases = tuple(1.0 / one for one in others[:A_FEW])
    made_by = f"{model.waves_are} " if model.waves_are else ""
    return Period(block, 1.0 / best, float(std), had, aliases, model.period_in_file, own, made_by)


def _period(base: Base, i: int) -> float:
    setting = base.family.blocks[i].setting
    assert isinstance(setting, float), "these waves have one period"
    return setting


def _taken(base: Base, effect: Effect, period: Setting) -> float:
    """Sum of squares that a wave on all inputs takes."""
    return wave_takes(base, base.family.run.flat(columns_at(base.family.run, effect, period)))


def _peak(taken: Callable[[float], float], near: float, step: float, *, ring: bool) -> tuple[float, float]:
    """The frequency at which a wave takes most, and how much, about one of the grid; of a ring whole numbers a turn."""
    if ring:
        turns = np.arange(np.round(tau * (near - step)), np.round(tau * (near + step)) + 1.0)
        return max(((k / tau, taken(k / tau)) for k in turns.tolist() if k >= 2.0), key=lambda one: one[1])
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
