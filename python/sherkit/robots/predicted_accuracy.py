"""What is promised of a place: the radius that holds a robot in 95 of 100 cases, in words and as a table."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import polars as pl

from ..base.figures import in_small_units
from ..base.types import Bools, Floats
from ..data.columns import bare, unit_in

#: Poses that would leave more than this part of what could hide are no advice.
_HELPS = 0.9
#: An addition of more than this part of the radius is worth a measurement.
_MATTERS = 0.1
#: Digits of what a person is asked to drive to, by unit.
_DIGITS = {"mm": 1, "rad": 3}


@dataclass(frozen=True)
class PredictedAccuracy:
    """How far off the mean of many visits to a place may be, in 95 of 100 cases: pose accuracy (ISO 9283).

    ``radius_mm`` holds for effects that the poses of the run can show; ``addition_mm`` is what effects of the catalogue
    at plausible size could do there besides, unseen between the poses; ``effect`` is the one that does most of it and
    ``advice`` the measurement that would narrow it, both empty where there is none. ``visit_mm`` holds 95 of 100 single
    readings there, scatter and all. NaN for a place out of reach. All holds at ``temperature_c`` and at ``time_s`` on
    the run's clock; None where nothing that is known of the robot depends on it.
    """

    radius_mm: float
    addition_mm: float
    visit_mm: float = float("nan")
    effect: str = ""
    advice: str = ""
    temperature_c: float | None = None
    time_s: float | None = None
    #: Of radius, addition and visit, where the robot's coordinates are no lengths.
    unit: str = "mm"
    #: How far outside the poses of the run its joints are there, in half of what these range over; zero among them.
    beyond: float = 0.0

    @property
    def total_mm(self) -> float:
        """Radius and addition: the pose accuracy that is promised."""
        return self.radius_mm + self.addition_mm

    @property
    def matters(self) -> bool:
        """Whether the addition is worth a measurement: more than a tenth of the radius."""
        return self.addition_mm > _MATTERS * self.radius_mm

    def __str__(self) -> str:
        if math.isnan(self.radius_mm):
            return "out of reach"
        within, shown = f"within {self._sized(self.total_mm)} in 95 of 100 cases", self._sized(self.radius_mm)
        if self.visit_mm > self.total_mm:
            within = f"the mean of many visits {within}, single readings within {self._sized(self.visit_mm)}"
        within += self._when
        if self.beyond > 0:
            within += f", extrapolated: its joints are {self.beyond:.2g} half ranges outside the poses measured"
        if not self.effect:
            return f"{within}; the poses leave no room for an effect between them"
        text = f"{within}: {shown} by what the poses show, the rest by what they could not, mostly {self.effect}"
        return f"{text}. {self.advice}" if self.matters and self.advice else text

    def _sized(self, value: float) -> str:
        unit, factor = in_small_units(self.unit)
        return f"{factor * value:{'.1f' if unit == 'µm' else '.3g'}} {unit}"

    @property
    def _when(self) -> str:
        """For which temperature and moment it holds, where that matters."""
        out = "" if self.temperature_c is None else f", at {self.temperature_c:.1f} °C"
        return out if self.time_s is None else f"{out}, {self.time_s / 60.0:.0f} min after the run's clock began"


@dataclass(frozen=True, eq=False)
class Hiding:
    """An effect that hides: its name with its period or moment, coordinates (r, d) at which readings would tell most of
    it, and the part that they would leave."""

    name: str
    places: Floats
    left: float


@dataclass(frozen=True, eq=False)
class PredictedAccuracies:
    """:class:`PredictedAccuracy` of many places: ``radius_mm``, ``addition_mm`` and ``visit_mm`` (n,), NaN where not
    ``reached`` (n,); ``worst`` says what hides most at each; all at one ``temperature_c`` and ``time_s``."""

    radius_mm: Floats
    addition_mm: Floats
    visit_mm: Floats
    worst: tuple[Hiding | None, ...]
    reached: Bools
    why: tuple[str, ...]
    coordinates: tuple[str, ...]
    temperature_c: float | None = None
    time_s: float | None = None
    #: Of radius, addition and visit, where the robot's coordinates are no lengths.
    unit: str = "mm"
    #: As of one (n,); None where nobody asked.
    beyond: Floats | None = None

    @property
    def total_mm(self) -> Floats:
        """Both together (n,): what is promised."""
        return self.radius_mm + self.addition_mm

    def __len__(self) -> int:
        return len(self.radius_mm)

    def __getitem__(self, row: int) -> PredictedAccuracy:
        one = self.worst[row]
        sizes = (float(self.radius_mm[row]), float(self.addition_mm[row]), float(self.visit_mm[row]))
        said = ("", "") if one is None else (one.name, self._advice(one))
        far = 0.0 if self.beyond is None else float(np.nan_to_num(self.beyond[row]))
        return PredictedAccuracy(*sizes, *said, self.temperature_c, self.time_s, self.unit, far)

    def _advice(self, one: Hiding) -> str:
        """Where to measure, and what it would bring; nothing where that is next to nothing."""
        if not len(one.places) or one.left > _HELPS:
            return ""
        names, unit = ", ".join(map(bare, self.coordinates)), unit_in(self.coordinates[0])
        digits = _DIGITS.get(unit, 3)
        at = "; ".join(", ".join(f"{v:.{digits}f}" for v in place) for place in one.places)
        return f"To narrow it, measure also at {names} = {at} {unit}: that would leave {100 * one.left:.0f} % of it."

    def to_frame(self) -> pl.DataFrame:
        """A polars frame: radius_mm, addition_mm, total_mm, visit_mm, effect, advice, measured; else null."""
        each = [self[k] for k in range(len(self))]
        names = ("radius_mm", "addition_mm", "total_mm", "visit_mm", "effect", "advice")
        columns = {name: [getattr(one, name) for one in each] for name in names}
        columns["measured"] = [one.beyond == 0.0 for one in each]
        return pl.DataFrame(columns).with_columns(pl.col(pl.Float64).fill_nan(None))
