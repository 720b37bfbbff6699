"""Names that people type: the nearest known one when a name is wrong."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Sequence

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
