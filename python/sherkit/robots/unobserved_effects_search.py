"""Which effects of the catalogue a run's poses could not show: each is tried, periodic ones at every period."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy

from ..base import linalg
from ..base.types import Floats
from ..model.effect import Effect
from .calibration_run import CalibrationRun
from .part import Part
from .unobserved_effects import UnobservedEffect
from .unobserved_effects_fit import Asked, LinearFit, rows_of

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
#: Poses that are advised, at most, and what they are to leave.
_ADVISED = 4
_LEFT = 0.2

#: Derivatives by sine and cosine, at the rows and at the asked places.
_Wave = tuple[Floats, Floats]


@dataclass(frozen=True, eq=False)
class Search:
    """The run that a part was made from, and where that is asked."""

    run: CalibrationRun
    part: Part
    asked: Asked

    def found(self) -> tuple[UnobservedEffect, ...]:
        """Effects that could do something between the poses, those that hide most first."""
        if not len(self.asked.joints):
            return ()
        least = _LEAST * float(np.trace(self.asked.spread.mean(axis=0)))
        out: list[tuple[float, UnobservedEffect]] = []
        # beside a wave in the model there may be another
        inside = [e for e in self._all.deployed.effects if e.is_periodic]
        for effect in (*self._choice[0], *inside):
            each = [self.told(effect, setting) for setting in self._settings(effect)]
            worst = max((hides for hides, _ in each), default=0.0)
            out += [one for one in each if one[0] >= max(least, _KEPT * worst)]
        return tuple(one for _, one in sorted(out, key=lambda o: -o[0]))

    @property
    def untried(self) -> tuple[str, ...]:
        """Effects of which nothing can be said: the run lacks a column that they need."""
        return tuple(self._choice[1])

    @cached_property
    def _choice(self) -> tuple[list[Effect], dict[str, str]]:
        fit = self.run.fit
        return fit.model.can_be_tried(tuple(self._all.deployed.known_effects.values()), fit.data)

    @cached_property
    def _all(self) -> LinearFit:
        return LinearFit(self.run.fit, self.part, self.asked, rows_of(self.run.fit, one_each=False))

    @cached_property
    def _quick(self) -> LinearFit:
        """One row of each pose: enough to see which periods they show."""
        return replace(self._all, rows=rows_of(self.run.fit, one_each=True))

    def told(self, effect: Effect, setting: float | None) -> tuple[float, UnobservedEffect]:
        """How much is hidden (mean square at the asked places), and what of it."""
        made, missed = self._all.assess(effect, setting, *self._all.columns(effect, setting))
        places, left = self._advised(made.moment, missed)
        return made.hides(missed), replace(made, places=places, left=left)

    def _advised(self, moment: Floats, missed: Floats) -> tuple[Floats, float]:
        """Asked places (r, d) at which readings would tell most, one after the other, and the part that they leave."""
        noise = self.asked.spread.mean(axis=0)
        over = np.tensordot(missed, missed, ([0, 1], [0, 1]))
        before = float(np.trace(over @ moment))
        chosen: list[int] = []
        left = 1.0
        while before > 0.0 and len(chosen) < _ADVISED and left > _LEFT:
            there = missed @ moment
            # of readings without noise nothing is left in some directions
            inverse = linalg.pinv(there @ missed.transpose(0, 2, 1) + noise, hermitian=True)
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
            made, missed = quick.assess(effect, 1.0 / frequency, *wave)
            return made.hides(missed)

        def unseen(_: float, wave: _Wave) -> float:
            return -quick.least_seen(wave[0])

        def taken(_: float, wave: _Wave) -> float:
            return quick.taken(wave[0])

        out: list[float] = []
        # what alone takes all that a correction took is hidden by that, in a peak too narrow for the first measure
        measures = (hides, unseen, taken) if self.part.corrects else (hides, unseen)
        waves = ((f, quick.wave(f)) for f in tried)
        found = np.array([[measure(f, wave) for measure in measures] for f, wave in waves])
        for measure, values in zip(measures, found.T, strict=True):
            for k in _peaks(values):
                best = float(tried[k])
                if not ring:
                    best = _nearby(measure, quick.wave, best, step)
                if all(abs(best - other) * span > 0.5 for other in out):
                    out.append(best)
        given = self.run.fit.model.setting_of(effect)
        known = [] if given is None or effect in self.run.fit.model.effects else [given]
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
