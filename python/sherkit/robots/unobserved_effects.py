"""Which effects of the catalogue a run's poses could not show: each is tried, periodic ones at every period."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
import scipy

from ..base import linalg
from ..base.types import Floats
from ..data.columns import TEMPERATURE
from ..model.effect import Effect
from .calibration_run import CalibrationRun
from .identified_model import BiasBound, IdentifiedModel
from .linear_fit import AccuracyQuery, LinearFit, used_rows

#: Waves over the range of a joint down to which periods are tried, and frequencies per width of a peak.
_WAVES = 120
_OVERSAMPLING = 2.0
_TURN = 2.0 * np.pi
#: Periods that are looked at closer, by either measure; those are kept that hide this part of what the worst does.
_PEAKS = 4
_KEPT = 0.3
#: Peaks that differ by less than this part of the range are as high as each other: aliases, of which the long is said.
_EQUAL = 0.05
#: Parts of the run's time at which a step could have happened.
_MOMENTS = (0.1, 0.25, 0.4, 0.5, 0.6, 0.75, 0.9)
#: An effect counts from this part of the known spread on.
_LEAST = 0.01
#: By how much another room may be warmer than that of the run: a hall in summer.
_ANOTHER_ROOM_K = 10.0
#: Poses that are advised, at most, and what they are to leave.
_ADVISED = 4
_LEFT = 0.2

#: Derivatives by sine and cosine, at the rows and at the asked places.
_Wave = tuple[Floats, Floats]


@dataclass(frozen=True, eq=False)
class Search:
    """The run that a part was made from, and where that is asked."""

    run: CalibrationRun
    part: IdentifiedModel
    asked: AccuracyQuery

    def found(self) -> tuple[BiasBound, ...]:
        """Effects that could do something between the poses, those that hide most first."""
        if not len(self.asked.joints):
            return ()
        least = [_LEAST * float(np.trace(one.spread.mean(axis=0))) for one in self.asked.counted]
        out: list[tuple[float, BiasBound]] = []
        # beside a wave in the model there may be another
        inside = [e for e in self._all.deployed.effects if e.is_periodic]
        for effect in (*self._choice[0], *inside):
            each = [self.told(effect, setting) for setting in self._settings(effect)]
            worst = np.max([hides for hides, _ in each], axis=0, initial=0.0)
            # in whichever frame it matters
            enough = np.maximum(least, _KEPT * worst)
            kept = [(float(hides[0]), one) for hides, one in each if (hides >= enough).any()]
            if not kept and TEMPERATURE in effect.needs:
                kept = [(float(hides[0]), one) for hides, one in each if self._hides_in_another_room(effect, one)]
                # no place of today's room tells of it
                kept = [(hidden, replace(one, places=one.places[:0], left=1.0)) for hidden, one in kept]
            out += kept
        return tuple(one for _, one in sorted(out, key=lambda o: -o[0]))

    @property
    def untried(self) -> tuple[str, ...]:
        """Effects of which nothing can be said: the run lacks a column that they need."""
        return tuple(self._choice[1])

    @cached_property
    def _choice(self) -> tuple[list[Effect], dict[str, str]]:
        fit = self.run.fit
        return fit.model.is_testable(tuple(self._all.deployed.may_be_off.values()), fit.data)

    @cached_property
    def _all(self) -> LinearFit:
        return LinearFit(self.run.fit, self.part, self.asked, used_rows(self.run.fit, one_each=False))

    @cached_property
    def _quick(self) -> LinearFit:
        """One row of each pose: enough to see which periods they show."""
        return replace(self._all, rows=used_rows(self.run.fit, one_each=True))

    def _hides_in_another_room(self, effect: Effect, one: BiasBound) -> bool:
        """Whether it would hide as much as is known in a room that is warmer than in the run, where none of it hides at
        the temperature of the run."""
        there = self._warmer.columns(effect, one.setting)[1]
        hides = [one.hides(self._warmer.missed(one, effect, there, frame)) for frame in self.asked.counted]
        known = [float(np.trace(frame.spread.mean(axis=0))) for frame in self.asked.counted]
        return any(much >= least > 0.0 for much, least in zip(hides, known, strict=True))

    @cached_property
    def _warmer(self) -> LinearFit:
        now = self.asked.now.copy()
        now[:, 1] += _ANOTHER_ROOM_K
        return replace(self._all, asked=replace(self.asked, now=now))

    def told(self, effect: Effect, setting: float | None) -> tuple[Floats, BiasBound]:
        """How much is hidden in each frame (mean square at the asked places), and what of it."""
        rows, there = self._all.columns(effect, setting)
        made = self._all.assess(effect, setting, rows)
        missed = [self._all.missed(made, effect, there, frame) for frame in self.asked.counted]
        places, left = self._advised(made.moment, missed[0], self._all.missed(made, effect, there))
        return np.array([made.hides(one) for one in missed]), replace(made, places=places, left=left)

    def _advised(self, moment: Floats, missed: Floats, read: Floats) -> tuple[Floats, float]:
        """Asked places (r, d) at which readings, which miss ``read`` (q, d, k) by it, would tell most of what
        coordinates miss (q, d, k), one after the other, and the part that they leave."""
        noise = self.asked.counted[0].spread.mean(axis=0)
        over = np.tensordot(missed, missed, ([0, 1], [0, 1]))
        before = float(np.trace(over @ moment))
        chosen: list[int] = []
        left = 1.0
        while before > 0.0 and len(chosen) < _ADVISED and left > _LEFT:
            there = read @ moment
            # of readings without noise nothing is left in some directions
            inverse = linalg.pinv(there @ read.transpose(0, 2, 1) + noise, hermitian=True)
            gains = np.trace(inverse @ (there @ over @ there.transpose(0, 2, 1)), axis1=1, axis2=2)
            gains[chosen] = -np.inf  # twice at one place would tell of the noise there
            best = int(np.argmax(gains))
            chosen.append(best)
            moment = moment - there[best].T @ inverse[best] @ there[best]
            left = float(np.sqrt(max(np.trace(over @ moment), 0.0) / before))
        return self.asked.coordinates[chosen], left

    # -- settings ------------------------------------------------------------------------------------------

    def _settings(self, effect: Effect) -> Sequence[float | None]:
        """Those at which an effect is tried: periods that hide most, moments within the run; none where it has none."""
        if effect.search is None or effect.is_lagging:
            return (None,)
        if effect.is_periodic:
            return self._periods(effect)
        time = self.run.fit.data.time_s
        return [] if time is None else np.quantile(time, _MOMENTS).tolist()

    def _periods(self, effect: Effect) -> list[float]:
        """Periods at which it would miss most beyond what is shown, and at which the poses show least of it."""
        quick = self._quick
        span = float(np.ptp(quick.joints, axis=0).max()) if len(quick.joints) else 0.0
        if span <= 0.0:
            return []
        step = 1.0 / (_OVERSAMPLING * span)
        tried = step * np.arange(2.0, _OVERSAMPLING * _WAVES + 1.0)
        ring = effect.search == "period_rad"
        if ring:
            # the error of a ring closes in a turn; once per turn is an effect of its own
            tried = np.unique(np.round(tried * _TURN).clip(2.0)) / _TURN

        def hides(frequency: float, wave: _Wave) -> float:
            made = quick.assess(effect, 1.0 / frequency, wave[0])
            return made.hides(quick.missed(made, effect, wave[1], self.asked.counted[0]))

        def unseen(_: float, wave: _Wave) -> float:
            return -quick.least_seen(wave[0])

        def taken(_: float, wave: _Wave) -> float:
            return quick.taken(wave[0])

        out: list[float] = []
        # what alone takes all that a correction took is hidden by that, in a peak too narrow for the first measure
        measures = (hides, unseen, taken) if self.part.corrects else (hides, unseen)
        waves = ((f, quick.wave(effect, f)) for f in tried)
        found = np.array([[measure(f, wave) for measure in measures] for f, wave in waves])
        for measure, values in zip(measures, found.T, strict=True):
            for k in _peaks(values):
                best = float(tried[k])
                if not ring:
                    best = _nearby(measure, partial(quick.wave, effect), best, step)
                if all(abs(best - other) * span > 0.5 for other in out):
                    out.append(best)
        given = self.run.fit.model.setting_of(effect)
        known: list[float] = []
        if given is not None and effect not in self.run.fit.model.effects:
            known = sorted(set(given)) if isinstance(given, tuple) else [given]
        return [*known, *(1.0 / f for f in out)]


def _nearby(
    measure: Callable[[float, _Wave], float], wave: Callable[[float], _Wave], middle: float, step: float
) -> float:
    """Where a measure of a frequency and its wave is highest within a step of a peak."""
    found = scipy.optimize.minimize_scalar(
        lambda f: -measure(f, wave(f)), bounds=(max(middle - step, 0.5 * step), middle + step), method="bounded",
        options={"xatol": 1e-5 * step},
    )  # fmt: skip
    return float(found.x)


def _peaks(values: Floats) -> list[int]:
    """The highest places that no neighbour is higher than; of those as high as each other the first."""
    ends = np.concatenate([[-np.inf], values, [-np.inf]])
    tops = np.flatnonzero((values >= ends[:-2]) & (values >= ends[2:]))
    height = np.round((values[tops] - values.min()) / max(float(np.ptp(values)), 1e-300) / _EQUAL)
    return [int(k) for k in tops[np.argsort(-height, kind="stable")][:_PEAKS]]
