"""Columns under other names and units: ``x [um]``, ``Enc1 (mm)``. They are mapped by who knows them, never guessed."""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Mapping, Sequence
from typing import Any

import polars as pl

from ..base.names import closest, listed
from ..errors import MeasurementError, SherkitWarning
from .columns import TIME, Layout, bare, known_layouts, unit_in

#: Names of columns by ours: ``{"q1_mm": "Enc1 [mm]"}``.
Columns = Mapping[str, str]

_HEADER = re.compile(r"^(?P<stem>.*?)[\s_]*(?:\[(?P<square>[^\[\]]*)\]|\((?P<round>[^()]*)\))$")
#: How much of the unit of a column is one of another, by what they measure.
_UNITS: tuple[dict[str, float], ...] = (
    {"m": 1e3, "cm": 10.0, "mm": 1.0, "um": 1e-3, "nm": 1e-6, "in": 25.4},
    {"rad": 1.0, "mrad": 1e-3, "urad": 1e-6, "deg": math.pi / 180.0},
    {"s": 1.0, "ms": 1e-3, "us": 1e-6, "min": 60.0, "h": 3600.0},
    {"px": 1.0},
    {"c": 1.0},
    {"N": 1e3, "mN": 1.0},
)
#: Cells of a row of units beside columns that have none.
_BARE = ("", "-", "1", "%", "k", "kg", "hpa", "mbar", "count", "counts", "text", "string")
#: What people call the time, in small letters.
_TIMES = ("t", "time", "timestamp", "zeit", "temps", "tempo")
_SPELT = {"µm": "um", "μm": "um", "micron": "um", "inch": "in", "°": "deg", "degree": "deg", "degrees": "deg",
          "µrad": "urad", "μrad": "urad", "sec": "s", "µs": "us", "pixel": "px", "pixels": "px", "°C": "c", "C": "c",
          "degC": "c"}  # fmt: skip


def stated(header: str) -> tuple[str, str]:
    """A header's name and the unit that it states, in brackets or at its end; empty where it states none."""
    found = _HEADER.match(header.strip())
    if found is None:
        return bare(header), unit_in(header)
    unit = (found["square"] if found["square"] is not None else found["round"]).strip()
    return found["stem"].strip(), _SPELT.get(unit, unit)


def is_unit(text: str) -> bool:
    """Whether a cell holds a unit and nothing else."""
    text = text.strip()
    return any(_SPELT.get(text, text) in kind for kind in _UNITS) or text.lower() in _BARE


def factor(unit: str, wanted: str) -> float | None:
    """What turns a number in ``unit`` into one in the ``wanted`` unit; None where they measure different things."""
    if unit == wanted:
        return 1.0
    return next((kind[unit] / kind[wanted] for kind in _UNITS if unit in kind and wanted in kind), None)


def renamed(frame: pl.DataFrame, columns: Columns, source: str) -> tuple[pl.DataFrame, dict[str, float]]:
    """The frame under our names, and by what each of its columns is to be multiplied; a conversion is said.

    Raises :class:`~sherkit.errors.MeasurementError` for a column that is not there, is wanted twice or measures
    something else.
    """
    factors: dict[str, float] = {}
    for ours, theirs in columns.items():
        if theirs not in frame.columns:
            near = closest(theirs, frame.columns)
            hint = f"; is '{near}' meant?" if near else f"; the file has {listed(frame.columns, 12)}"
            raise MeasurementError(f"{source}: column '{theirs}' is missing, which is to be read as '{ours}'{hint}")
        if ours != theirs and ours in frame.columns:
            raise MeasurementError(f"{source}: has a column '{ours}' itself; '{theirs}' cannot be read as it")
        unit, wanted = stated(theirs)[1], unit_in(ours)
        if not unit or not wanted:
            continue
        by = factor(unit, wanted)
        if by is None:
            raise MeasurementError(f"{source}: column '{theirs}' is in {unit}; '{ours}' is in {wanted}")
        if by != 1.0:
            factors[ours] = by
    if len(set(columns.values())) < len(columns):
        twice = sorted({v for v in columns.values() if list(columns.values()).count(v) > 1})
        raise MeasurementError(f"{source}: column '{twice[0]}' is to be read as two columns")
    if factors:
        said = listed((f"'{columns[ours]}' as {ours}" for ours in factors), 6)
        warnings.warn(f"{source}: converted from the units of the header: {said}", SherkitWarning, stacklevel=2)
    return frame.rename({theirs: ours for ours, theirs in columns.items()}), factors


def meanings(names: Sequence[str], layouts: Sequence[Layout] = ()) -> tuple[Layout, dict[str, str]]:
    """The kind of run that foreign names come nearest to, of all or of some, and what could be meant by them: names of
    columns by ours."""

    def named(layout: Layout) -> tuple[int, int]:
        """How many columns would have a meaning, and how few of them by another name."""
        meant = _matched(names, layout)
        return len(meant) + sum(name in names for name in (*layout.joints, *layout.readings)), -len(meant)

    nearest = max(layouts or known_layouts(), key=named)
    found = _matched(names, nearest)
    if found:
        likely = _likely(names, nearest)
        found |= {ours: name for ours, name in likely.items() if ours not in found and name not in found.values()}
    return nearest, found


def in_toml(columns: Columns) -> str:
    """A mapping as the first line of a robot file has it."""
    return f"columns = {{ {', '.join(f'{ours} = {_quoted(theirs)}' for ours, theirs in columns.items())} }}"


def proposal(names: Sequence[str]) -> str:
    """What could be meant by foreign names, as a mapping to be looked at: for the sentence that refuses them."""
    found = meanings(names)[1]
    if not found:
        return ""
    bare_ones = [theirs for theirs in found.values() if not stated(theirs)[1]]
    unit = ", those without a unit in ours" if bare_ones else ""
    return (
        f"; if these are meant{unit}, say so at the beginning of the robot file, or to read_measurements: "
        f"{in_toml(found)}"
    )


def refuse_unmapped(names: Sequence[str], layout: Layout, source: str) -> None:
    """Refuses a reading under a foreign name beside those that are known: it would pass for a covariate."""
    for ours, theirs in _same(names, layout).items():
        if ours not in names:
            raise MeasurementError(f"{source}: column '{theirs}' is not read as '{ours}'{proposal(names)}")


def _quoted(text: str) -> str:
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'


def _matched(names: Sequence[str], layout: Layout) -> dict[str, str]:
    """The joints and readings of a layout by columns that state a fitting unit and have their name, or their number
    beside the same word."""
    free = [name for name in names if name not in layout.known]
    out = _same(names, layout)
    words: dict[str, dict[str, str]] = {}
    for name in free:
        numbered = re.fullmatch(r"(.*?)[\s_-]*(\d)", stated(name)[0])
        if numbered and name not in out.values():
            words.setdefault(numbered[1], {})[numbered[2]] = name
    wanted = {str(k + 1): ours for k, ours in enumerate(layout.joints)}
    rows: list[Any] = [w for w in words.values() if w.keys() == wanted.keys()]
    fitting = [w for w in rows if all(_fits(w[k], ours) for k, ours in wanted.items())]
    if len(fitting) == 1:
        out = {ours: fitting[0][k] for k, ours in wanted.items()} | out
    return out


def _likely(names: Sequence[str], layout: Layout) -> dict[str, str]:
    """Readings and the time by columns that have their letter behind the same word, stating a fitting unit or none."""
    letters = {bare(ours): ours for ours in layout.readings if len(bare(ours)) == 1}
    words: dict[str, dict[str, str]] = {}
    out: dict[str, str] = {}
    for name in (n for n in names if n not in layout.known):
        stem, unit = stated(name)
        last = re.fullmatch(r"(.*?)[\s_-]*([a-z])", stem, re.IGNORECASE)
        if last and last[2].lower() in letters and (not unit or _fits(name, letters[last[2].lower()])):
            words.setdefault(last[1].lower(), {})[last[2].lower()] = name
        if stem.lower() in _TIMES and (not unit or _fits(name, TIME)) and TIME not in names:
            out.setdefault(TIME, name)
    rows = [w for w in words.values() if w.keys() == letters.keys()]
    if len(rows) == 1:
        out = {letters[letter]: name for letter, name in rows[0].items()} | out
    return out


def _same(names: Sequence[str], layout: Layout) -> dict[str, str]:
    """Readings by columns whose header is their name with a unit in brackets, each by one alone."""
    out: dict[str, str] = {}
    for ours in layout.readings:
        same = [n for n in names if n.strip()[-1:] in "])" and stated(n)[0].lower() == bare(ours) and _fits(n, ours)]
        if len(same) == 1:
            out[ours] = same[0]
    return out


def _fits(theirs: str, ours: str) -> bool:
    unit = stated(theirs)[1]
    return bool(unit) and factor(unit, unit_in(ours)) is not None
