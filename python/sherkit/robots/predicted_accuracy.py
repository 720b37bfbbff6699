"""What is promised of a place: the radius that the poses of the run show, and what they could not have shown."""

from __future__ import annotations

import math
from dataclasses import dataclass

import polars as pl

from ..base.types import Bools, Floats
from ..data.columns import bare, unit_in

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
    readings there, scatter and all. NaN for a place out of reach.
    """

    radius_mm: float
    addition_mm: float
    visit_mm: float = float("nan")
    effect: str = ""
    advice: str = ""

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
        within, shown = f"within {1e3 * self.total_mm:.1f} µm in 95 of 100 cases", f"{1e3 * self.radius_mm:.1f} µm"
        if self.visit_mm > self.total_mm:
            within = f"the mean of many visits {within}, single readings within {1e3 * self.visit_mm:.1f} µm"
        if not self.effect:
            return f"{within}; the poses leave no room for an effect between them"
        text = f"{within}: {shown} by what the poses show, the rest by what they could not, mostly {self.effect}"
        return f"{text}. {self.advice}" if self.matters else text


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
    ``reached`` (n,); ``worst`` says what hides most at each."""

    radius_mm: Floats
    addition_mm: Floats
    visit_mm: Floats
    worst: tuple[Hiding | None, ...]
    reached: Bools
    why: tuple[str, ...]
    coordinates: tuple[str, ...]

    @property
    def total_mm(self) -> Floats:
        """Both together (n,): what is promised."""
        return self.radius_mm + self.addition_mm

    def __len__(self) -> int:
        return len(self.radius_mm)

    def __getitem__(self, row: int) -> PredictedAccuracy:
        one = self.worst[row]
        sizes = (float(self.radius_mm[row]), float(self.addition_mm[row]), float(self.visit_mm[row]))
        if one is None:
            return PredictedAccuracy(*sizes)
        return PredictedAccuracy(*sizes, one.name, self._advice(one))

    def _advice(self, one: Hiding) -> str:
        """Where to measure, and what it would bring."""
        if not len(one.places):
            return ""
        names = ", ".join(bare(name) for name in self.coordinates)
        unit = unit_in(self.coordinates[0])
        digits = _DIGITS.get(unit, 3)
        at = "; ".join(", ".join(f"{v:.{digits}f}" for v in place) for place in one.places)
        return f"To narrow it, measure also at {names} = {at} {unit}: that would leave {100 * one.left:.0f} % of it."

    def to_frame(self) -> pl.DataFrame:
        """A polars frame: radius_mm, addition_mm, total_mm, visit_mm, effect, advice; what is out of reach is null."""
        each = [self[k] for k in range(len(self))]
        return pl.DataFrame(
            {
                "radius_mm": self.radius_mm,
                "addition_mm": self.addition_mm,
                "total_mm": self.total_mm,
                "visit_mm": self.visit_mm,
                "effect": [one.effect for one in each],
                "advice": [one.advice for one in each],
            }
        ).with_columns(pl.col(pl.Float64).fill_nan(None))
