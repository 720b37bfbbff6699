"""A period for each joint: gears and encoders need not be alike.

The periodogram of each joint by itself, beside the waves of the others, until none of them moves.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import comb, tau

import numpy as np
import scipy

from ..base import linalg
from ..base.types import Floats
from ..model.effect import Effect
from .base import Base
from .blocks import Block, Columns, Visits
from .family import Family
from .made import Maker, waves_of_gear
from .run import Run
from .thresholds import ROUNDS

#: Change of χ² from which on a period counts as better than another, besides what choosing among all brings by
#: chance: beyond it the odds are "very strong" (Kass and Raftery, "Bayes factors", JASA 1995).
CLEARLY = 10.0
#: Part of a wave's square that what is in the model must leave for it to be seen.
SEEN = 0.01
#: Waves over a joint's range by which its frequency may still move.
_MOVED = 0.02
#: Deviation up to which a whole number of waves a turn is told from the next.
_TOLD = 0.35
#: Part of the numbers read up to which all other effects may stand beside the waves.
_BESIDE = 0.4


@dataclass(frozen=True, eq=False)
class Ripple:
    """Waves of an ``effect`` with a period for each joint.

    ``found`` maps the joints whose waves take more than chance to frequency and its standard deviation; ``ways`` is the
    logarithm of how many such choices there are, ``chance`` what choosing brings by chance, in squared noises.
    ``given`` are the periods that a robot's file says of its joints; ``joints`` are those of ``inputs`` that may have
    a wave.
    """

    effect: Effect
    inputs: tuple[str, ...]
    joints: tuple[str, ...]
    found: Mapping[str, tuple[float, float]]
    given: Mapping[str, float]
    ways: float
    chance: float
    #: Over which each joint is read.
    spans: Mapping[str, float]

    def periods(self, common: float) -> tuple[float, ...]:
        """One for each joint: its own, else that of the file, else the ``common`` one."""
        own = {name: 1.0 / frequency for name, (frequency, _) in self.found.items()}
        return tuple(own.get(name, self.given.get(name, common)) for name in self.joints)

    def add_to(self, made: Maker) -> None:
        """A block of the waves that were found, at the periods of all."""
        view, pieces = made.view, []
        for name, (frequency, _) in self.found.items():
            angle = tau * frequency * view.stood[name]
            pieces.append((made.waves_of(name, angle, np.ones(1)), np.arange(2)))
        made.add("effect", (), pieces, effect=self.effect, setting=self.likeliest, ways=self.ways)

    def is_shape(self, block: Block) -> bool:
        """Whether a shape is the wave of one of these joints, as good as at its period."""
        name = block.pattern or ""
        if block.shape != "periodic" or name not in self.found or not block.period:
            return False
        return abs(1.0 / block.period - self.found[name][0]) * self.spans[name] <= 1.0

    @property
    def likeliest(self) -> tuple[float, ...]:
        """The same where no period is common to all: others as the first that was found."""
        return self.periods(1.0 / next(iter(self.found.values()))[0])


def ripple_of(base: Base, effect: Effect, *, alone: bool = False) -> Ripple | None:
    """The waves that joints have of their own beside what is in a model; None where none takes more than chance.

    ``alone`` where nothing but them may be missing: else all other effects stand beside them, at any size, since what
    else is missing would look like waves.
    """
    run, view, waving = base.family.run, base.family.run.view, base.family.run.view.waving(effect)
    given = {name: period for name, period in run.of.model.given_periods.items() if name in waving}
    families = _pairs(run, effect, given)
    spans = {name: float(np.ptp(view.stood[name])) for name in waving}
    if not families:
        return None
    plain = base.asked(next(iter(families.values())))
    if not alone:
        plain = _beside_all(plain, effect)
    asked = {name: plain.asked(family) for name, family in families.items()}
    by_chance = {name: 2.0 * np.log(len(family)) + CLEARLY for name, family in families.items()}
    found: dict[str, tuple[float, float]] = {}

    def again(which: Sequence[str]) -> bool:
        """Looks for the wave of each of these anew, beside the others; whether any has moved, or is none any more."""
        before = dict(found)
        for name in which:
            found.pop(name, None)
            others = _beside(asked[name], found)
            near = _setting(families[name], int(np.argmax(others.gains[0])))
            frequency, std, takes = _peak(others, effect, name, 1.0 / near, is_given=name in given)
            if takes > by_chance[name] * _noise(others, takes):
                found[name] = frequency, std
        return before.keys() != found.keys() or any(
            abs(before[name][0] - at) * spans[name] > _MOVED for name, (at, _) in found.items()
        )

    while len(found) < len(families):
        now = {name: _beside(one, found) for name, one in asked.items() if name not in found}
        worth = {name: one.gains[0].max() / _noise(one) - by_chance[name] for name, one in now.items()}
        name = max(worth, key=worth.__getitem__)
        if not worth[name] > 0:
            break
        again([name])
        if name not in found:
            break
    for _ in range(ROUNDS if len(found) > 1 else 0):
        if not again(list(found)):
            break
    if not found:
        return None
    choices = comb(len(waving), len(found)) * len(waving)
    ways = float(sum(np.log(len(families[name])) for name in found) + np.log(choices))
    chance = float(sum(by_chance[name] for name in found))
    return Ripple(effect, tuple(view.inputs), waving, found, given, ways, chance, spans)


def wave_takes(base: Base, columns: Floats) -> float:
    """Sum of squares that sines and cosines (N, 2 k) of inputs take.

    Beside a period at which these poses cannot see a wave (joints that stand at its multiples), one of metres takes
    what a straight line would: what the model leaves of a wave but for so little does not count as one.
    """
    # sine and cosine of an input share a scale: where it stands at multiples of a period, there is no sine
    pairs = np.square(columns).sum(axis=0).reshape(-1, 2).mean(axis=1)
    columns = columns / np.sqrt(np.maximum(np.repeat(pairs, 2), np.finfo(float).tiny))
    over = columns - base.basis @ (base.basis.T @ columns)
    left, directions = linalg.eigh(over.T @ over)
    seen = left > SEEN
    return float(((directions[:, seen].T @ (over.T @ base.residual)) ** 2 / left[seen]).sum())


def _pairs(run: Run, effect: Effect, given: Mapping[str, float]) -> Mapping[str, Family]:
    """Sine and cosine of each joint by itself, at each period that is tried: made once of the rows of a run, as its
    first fit sees them, which tells any other where to look."""
    key = ("gears", effect.name, tuple(given.items()))
    if key not in run.kept:
        each = ((name, _pairs_of(run, effect, name, given.get(name))) for name in run.view.waving(effect))
        run.kept[key] = {name: family for name, family in each if family is not None and len(family)}
    out: Mapping[str, Family] = run.kept[key]
    return out


def _pairs_of(run: Run, effect: Effect, name: str, given: float | None) -> Family | None:
    """Those of one joint; None of one that stands still."""
    made, view = Maker(run, Visits.of(run)), run.view
    values = view.stood[name]
    reach = float(np.ptp(values))
    counts = waves_of_gear(values, view.axes / view.ends) if given is None else np.array([reach / given])
    if not reach > 0 or not len(counts):
        return None
    part = made.waves_of(name, tau * values / reach, counts)
    for k, count in enumerate(counts.tolist()):
        pair = np.array([k, len(counts) + k])
        made.add("effect", (), [(part, pair)], effect=effect, setting=reach / count, pattern=name)
    parts, blocks = made.done()
    out = Family(run, made=(Columns(run, made.visits, parts), blocks))
    out.least = np.full(len(out), SEEN)
    return out


def _beside_all(base: Base, effect: Effect) -> Base:
    """With every other effect that has no setting to search for in the model, as far as the readings bear that."""
    run, view = base.family.run, base.family.run.view
    which = [at for one, at in view.effects if one.name != effect.name]
    count = sum(at.stop - at.start for at in which)
    if not count or base.basis.shape[1] + count > _BESIDE * len(base.residual):
        return base
    every = view.effects_in(view.whole)
    columns = run.flat(np.concatenate([every[:, :, at] for at in which], axis=2))
    length = np.linalg.norm(columns, axis=0)
    return base.with_columns(columns[:, length > 0] / length[length > 0], SEEN**0.5)


def _beside(base: Base, found: Mapping[str, tuple[float, float]]) -> Base:
    """With these waves in the model, and with what goes twice as often: the overtone of one joint is no wave of
    another."""
    if not found:
        return base
    waves = [(name, k * at) for name, (at, _) in found.items() for k in (1.0, 2.0)]
    columns = np.concatenate([_pair(base.family.run, *wave) for wave in waves], axis=1)
    return base.with_columns(columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300), SEEN**0.5)


def _pair(run: Run, name: str, frequency: float) -> Floats:
    """Sine and cosine (N, 2) of a joint."""
    angle = tau * frequency * run.view.stood[name]
    return run.flat(run.view.arriving(name, np.stack([np.sin(angle), np.cos(angle)], axis=1)))


def _noise(base: Base, takes: float = 0.0) -> float:
    return max((base.rss - takes) / max(base.free, 1), 1e-300)


def _setting(family: Family, i: int) -> float:
    setting = family.blocks[i].setting
    assert isinstance(setting, float), "a wave of one joint has one period"
    return setting


def _peak(base: Base, effect: Effect, name: str, near: float, *, is_given: bool) -> tuple[float, float, float]:
    """The frequency near one of the grid at which the wave of a joint takes most, its standard deviation, and what it
    takes. On a ring a whole number a turn, where one is told from the next, is taken if it does as well; one that is
    given stays."""
    run = base.family.run
    span = float(np.ptp(run.view.stood[name]))

    def takes(frequency: float) -> float:
        return wave_takes(base, _pair(run, name, frequency))

    if is_given:
        return near, 0.0, takes(near)
    step = 0.5 / span
    found = scipy.optimize.minimize_scalar(
        lambda f: -takes(f), bounds=(max(near - step, 0.5 * near), near + step), method="bounded",
        options={"xatol": 1e-2 * step},
    )  # fmt: skip
    best, most, h = float(found.x), -float(found.fun), 0.1 / span
    noise = _noise(base, most)
    bend = (2.0 * most - takes(best - h) - takes(best + h)) / h**2
    std = float(np.sqrt(2.0 * noise / bend)) if bend > 0 else np.inf
    whole = max(round(tau * best), 2) / tau
    told = effect.search == "period_rad" and tau * std < _TOLD
    if told and most - (exactly := takes(whole)) < CLEARLY * noise:
        return whole, std, exactly
    return best, std, most
