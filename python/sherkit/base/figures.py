"""Names and figures as people read them: the nearest name that is known; as many digits as are known, angles in
degrees, no unit where there is none."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable, Sequence

# -- Names -------------------------------------------------------------------------------------------------------------
# Names that people type: the nearest known one when a name is wrong.

#: Characters of a name, and of a cell, that a sentence repeats.
_LONGEST, _LONGEST_CELL = 200, 80


def on_one_line(found: object) -> str:
    """What a file holds, for a sentence: without ends of lines, and characters that are none."""
    return " ".join("".join(one if one.isprintable() else " " for one in str(found)).split())


def brief(found: object, most: int = _LONGEST_CELL) -> str:
    """The same, cut where nobody would read on."""
    text = on_one_line(found)
    return text if len(text) <= most else f"{text[:most]}…"


def closest(name: str, known: Iterable[str], cutoff: float = 0.6) -> str | None:
    """The known name that looks most like ``name``, where one is as alike as ``cutoff`` (0 to 1)."""
    match = difflib.get_close_matches(name, list(known), n=1, cutoff=cutoff)
    return match[0] if match else None


def nearest(name: str, known: Iterable[str]) -> str:
    """``"; did you mean 'x'?"``, or nothing where no known name is close."""
    match = closest(name, known)
    return f"; did you mean '{match}'?" if match else ""


def listed(names: Iterable[object], most: int = 8) -> str:
    """Names for a sentence, cut after ``most`` with a count of the rest; each cut where nobody would read on."""
    items = [brief(name, _LONGEST) for name in names]
    if len(items) > most:
        return ", ".join(items[:most]) + f" and {len(items) - most} more"
    return ", ".join(items)


def spans(numbers: Iterable[int], most: int = 20) -> str:
    """Numbers for a sentence, sorted, neighbours as one span: 12-14, 40; cut after ``most`` spans."""
    parts: list[list[int]] = []
    for n in sorted(set(map(int, numbers))):
        if parts and n == parts[-1][1] + 1:
            parts[-1][1] = n
        else:
            parts.append([n, n])
    return listed((f"{first}-{last}" if last > first else str(first) for first, last in parts), most)


#: What a model is called as it is drawn, and once its geometry is fitted; each effect that is added then is a step.
NOMINAL, CALIBRATED = "nominal", "geometry calibrated"


def state_with(effects: Sequence[str]) -> str:
    """What a model is called that has these effects, as every screen says it."""
    return " ".join(f"+ {name}" for name in effects) or CALIBRATED


def told_apart(names: Sequence[str]) -> list[str]:
    """Names of which each that comes more than once has its number behind it: what was added, taken out, added."""
    return [one if names.count(one) == 1 else f"{one} ({names[: k + 1].count(one)})" for k, one in enumerate(names)]


# -- Figures -----------------------------------------------------------------------------------------------------------

#: Digits after the point beyond which a figure is written with a power of ten.
_MOST_DECIMALS = 7
#: What two decimals would not show.
_SMALL = 0.095


#: Units of turns that people read in degrees, and how many radians each is.
_TURNS = {"rad": 1.0, "mrad": 1e-3}


def in_people_units(unit: str) -> tuple[str, float]:
    """The unit in which people read a quantity of ``unit``, and how many of these make one of it."""
    if unit == "1":
        return "", 1.0
    first, slash, rest = unit.partition("/")
    if first in _TURNS and rest != first:
        return f"°{slash}{rest}", math.degrees(_TURNS[first])
    return unit, 1.0


def in_names(unit: str) -> str:
    """A unit as names of columns and keys end in it."""
    return unit.replace("µ", "u")


#: Where a quantity is read in a smaller unit: by its own, and how many make one.
_SMALLER = {"mm": ("µm", 1e3), "m": ("µm", 1e6), "um": ("µm", 1.0), "rad": ("mrad", 1e3), "deg": ("mdeg", 1e3)}
#: Plausible sizes beyond which a deviation says that the readings say nothing, and the same of whatever unit.
_UNSEEN_SIZES, _UNSEEN = 100.0, 1e9
#: Beyond this a figure is what an unobserved direction leaves of arithmetic.
_MEANT = 1e30
#: What stands in the place of a value of which the readings say nothing.
NOT_OBSERVED = "not observed by these readings"


def in_small_units(unit: str) -> tuple[str, float]:
    """The unit in which people read errors of a quantity of ``unit``, and how many of these make one of it."""
    return _SMALLER.get(unit, (unit, 1.0))


def is_observed(value: float, std: float, size: float = math.inf) -> bool:
    """Whether readings say anything of a value with this deviation, which has this plausible ``size``."""
    return math.isfinite(std) and std <= min(_UNSEEN_SIZES * size, _UNSEEN * max(abs(value), 1.0))


def with_error(value: float, std: float, *others: float) -> tuple[str, ...]:
    """A value and its standard deviation, rounded to two figures of that; ``others`` to the same place. What the
    readings say nothing of has words in its place.

    Source: JCGM 100:2008 (GUM), 7.2.6.
    """
    if math.isfinite(std) and not is_observed(value, std):
        return "not observed", "–", *(f"{v:.3g}" if is_observed(0.0, v) else "–" for v in others)
    if not (math.isfinite(value) and math.isfinite(std) and std > 0):
        return tuple(f"{v:.3g}" for v in (value, std, *others))
    decimals = 1 - math.floor(math.log10(float(f"{std:.1e}")))
    if decimals > _MOST_DECIMALS:
        return tuple(f"{v:.{max(1, decimals + math.floor(math.log10(max(abs(v), std))))}e}"
                     for v in (value, std, *others))  # fmt: skip
    shown = max(decimals, 0)
    return tuple(f"{round(v, decimals) + 0.0:.{shown}f}" for v in (value, std, *others))


def stated(value: float, std: float, unit: str, size: float = math.inf) -> str:
    """``value ± std unit`` in the unit in which people read it; that it is not observed, where the readings say nothing
    of a quantity of this plausible ``size``."""
    if not (math.isnan(std) or is_observed(value, std, size)):
        return NOT_OBSERVED
    shown, factor = in_people_units(unit)
    number, error = with_error(factor * value, factor * std)
    return f"{number} ± {error}{_behind(shown)}"


#: Powers of ten of odds beyond which nobody doubts.
_BEYOND_DOUBT = 6.0


def odds(power: float) -> str:
    """Odds of ten to a ``power`` to one, in words."""
    if abs(power) > _BEYOND_DOUBT:
        return "above a million to one" if power > 0 else "below one to a million"
    return f"{10.0**power:,.0f} to 1" if power >= 0 else f"1 to {10.0**-power:,.0f}"


def sized(value: float, unit: str) -> str:
    """``value unit`` to three figures, in the unit in which people read it."""
    shown, factor = in_people_units(unit)
    return f"{factor * value:.3g}{_behind(shown)}"


def _behind(unit: str) -> str:
    """A unit as it stands behind a number."""
    return unit if unit.startswith("°") or not unit else f" {unit}"


def number(value: float) -> str:
    """A size with about three figures, the last one meant; two of one that is small."""
    if not math.isfinite(value):
        return "–"
    size = abs(value)
    if 0.0 < size < _SMALL:
        return f"{value:.2g}"
    return f"{value:.0f}" if size >= 100 else f"{value:.1f}" if size >= 10 else f"{value:.2f}"


def in_column(value: float) -> str:
    """A size as it stands below others, eight wide: with two decimals, where that leaves two figures."""
    return f"{value:8.2f}" if value >= _SMALL else f"{number(value):>8}"


def finite(value: float) -> float | None:
    """A figure as JSON holds it: none where it is not finite, or so large that nothing was meant by it."""
    return value if abs(value) < _MEANT else None
