"""Values that cannot be what the column's name says."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ...base.types import Floats
from ..columns import TEMPERATURE, unit_in
from ..rows import Measurements
from .doubt import FEWEST, Doubt

#: Temperatures of a room or a machine in it, and such as nothing of it ever has, °C.
_COLDEST, _HOTTEST = -60.0, 180.0
_KELVIN = (240.0, 360.0)
#: A room in degrees Fahrenheit, which changes by so little in a run.
_FAHRENHEIT, _ROOM_F = (59.0, 90.0), 20.0
#: Part of the rows in which a thermometer said nothing, at least.
_LOST = 0.005
#: A value is no temperature of this run where it is so many ranges of the others away, and so many °C.
_AWAY, _AWAY_C = 3.0, 8.0
#: Two turns: no joint of an arm goes farther, and no direction is as large, rad.
_TWO_TURNS = 4 * np.pi


def temperature(data: Measurements) -> Iterator[Doubt]:
    """Temperatures in kelvin or degrees Fahrenheit, and zeros of a thermometer that did not answer."""
    given = data.covariates.get(TEMPERATURE)
    if given is None or len(data) < FEWEST:
        return
    values = given[~data.outlier]
    if not len(values):
        return
    usual, reach = float(np.median(values)), float(np.ptp(values))
    looks = ""
    if _KELVIN[0] < usual < _KELVIN[1] and values.min() > _HOTTEST:
        looks = f"looks like kelvin: it is about {usual:.0f}, which is {usual - 273.15:.0f} °C; subtract 273.15"
    elif _FAHRENHEIT[0] < values.min() and values.max() < _FAHRENHEIT[1] and reach < _ROOM_F:
        looks = (
            f"looks like degrees Fahrenheit: it is about {usual:.0f}, which is {(usual - 32) / 1.8:.0f} °C; subtract "
            "32 and divide by 1.8"
        )
    elif values.min() < _COLDEST or values.max() > _HOTTEST:
        extreme = float(values[np.argmax(np.abs(values - usual))])
        looks = f"holds {extreme:.4g}, which is no temperature in °C; look at its unit, and leave out what was not read"
    elif (lost := _lost(values)) is not None:
        value, count = lost
        looks = (
            f"is {value:.4g} in {count} of {len(values)} rows and about {usual:.3g} in the others: readings of the "
            "thermometer that were lost, it seems; fill them from their neighbours"
        )
    if looks:
        yield Doubt(f"{TEMPERATURE} {looks} (or give it another name, where it was really so)")


def _lost(values: Floats) -> tuple[float, int] | None:
    """One value, far from all others, that comes again and again."""
    for value in (float(values.min()), float(values.max())):
        here = values == value
        rest = values[~here]
        if not max(3, _LOST * len(values)) <= here.sum() < 0.5 * len(values):
            continue
        gap = float(np.abs(rest - value).min())
        if gap > max(_AWAY * float(np.ptp(rest)), _AWAY_C) and len(np.unique(rest)) > 1:
            return value, int(here.sum())
    return None


def angles(data: Measurements) -> Iterator[Doubt]:
    """Angles of more than two turns, of joints and of coordinates."""
    layout = data.layout
    columns = [(name, data.joints[~data.outlier, k]) for k, name in enumerate(layout.joints)]
    columns += [(name, data.readings[data.used[:, k], k]) for k, name in enumerate(layout.coordinates)]
    for name, values in columns:
        if unit_in(name) != "rad" or len(values) < FEWEST:
            continue
        most = float(np.quantile(np.abs(values), 0.5))
        if most > _TWO_TURNS:
            yield Doubt(
                f"{name} is beyond two turns in most rows ({most / (2 * np.pi):.3g} turns is usual): it does not look "
                "like radians (degrees? divide by 57.2958)"
            )
