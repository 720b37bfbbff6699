"""Columns under other names and in other units: mapped by who knows them, proposed by what people call them, never
guessed.
"""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Callable, Mapping, Sequence

import polars as pl

from ..base.figures import closest, listed
from ..errors import MeasurementError, SherkitWarning
from .columns import ANGLES, LENGTHS, TIME, Layout, bare, known_layouts, unit_in

#: Of what was driven to, in small letters.
DRIVEN = frozenset((
    "target", "soll", "sollwert", "sollposition", "nominal", "command", "commanded", "cmd", "set", "setpoint", "enc",
    "encoder", "axis", "achse", "joint", "gelenk", "motor", "angle", "winkel", "drive", "geber", "consigne", "axe",
))  # fmt: skip
#: Of what an instrument showed there.
READ = frozenset((
    "measured", "meas", "gemessen", "ist", "istwert", "actual", "reading", "laser", "tracker", "smr", "indicated",
    "observed", "interferometer", "mesure", "messwert", "gauge", "reflector", "reflektor",
))  # fmt: skip
#: Of the difference of the two, which is neither.
_DIFFERENCE = frozenset((
    "error", "fehler", "deviation", "abweichung", "diff", "difference", "differenz", "residual", "err", "erreur",
    "delta",
))  # fmt: skip


def _words(name: str) -> set[str]:
    return set(re.findall(r"[^\W\d_]+", name.lower()))


def in_order(
    names: Sequence[str], wanted: Sequence[str], words: frozenset[str], fits: Callable[[str, str], bool]
) -> Mapping[str, str]:
    """Names of the file by the ``wanted`` ones, in the order of both, where as many have one of these ``words`` and a
    unit that fits; empty where not."""
    others = READ if words is DRIVEN else frozenset[str]()
    found = [
        name for name in names
        if _words(name) & words and not _words(name) & (_DIFFERENCE | others) and any(fits(name, one) for one in wanted)
    ]  # fmt: skip
    if not wanted or len(found) != len(wanted) or not all(map(fits, found, wanted)):
        return {}
    return dict(zip(wanted, found, strict=True))


def is_difference(name: str) -> bool:
    """Whether a column is called the difference of what was read and what was driven to."""
    return bool(_words(name) & _DIFFERENCE)


#: Names of columns by ours: ``{"q1_mm": "Enc1 [mm]"}``.
Columns = Mapping[str, str]

_HEADER = re.compile(r"^(?P<stem>.*?)[\s_]*(?:\[(?P<square>[^\[\]]*)\]|\((?P<round>[^()]*)\))$")
#: How much of the unit of a column is one of another, by what they measure.
_BY_UNIT: tuple[dict[str, float], ...] = (
    {"m": 1e3, "cm": 10.0, "mm": 1.0, "um": 1e-3, "nm": 1e-6, "pm": 1e-9, "in": 25.4},
    {
        "rad": 1.0,
        "mrad": 1e-3,
        "urad": 1e-6,
        "deg": math.pi / 180.0,
        "arcmin": math.pi / 10_800.0,
        "arcsec": math.pi / 648_000.0,
    },
    {"s": 1.0, "ms": 1e-3, "us": 1e-6, "min": 60.0, "h": 3600.0},
    {"px": 1.0},
    {"c": 1.0},
    {"N": 1e3, "cN": 10.0, "mN": 1.0, "gf": 9.80665},
)
#: Cells of a row of units beside columns that have none.
_BARE = ("", "-", "1", "%", "k", "kg", "hpa", "mbar", "count", "counts", "text", "string")
#: What people call the time, in small letters.
_TIMES = ("t", "time", "timestamp", "zeit", "temps", "tempo")
_SPELT = {"µm": "um", "μm": "um", "micron": "um", "inch": "in", "°": "deg", "degree": "deg", "degrees": "deg",
          "µrad": "urad", "μrad": "urad", "sec": "s", "µs": "us", "pixel": "px", "pixels": "px", "°C": "c", "C": "c",
          "degC": "c", "mn": "mN"}  # fmt: skip
#: At the end of a name these are units too, beside lengths and angles.
_ENDS = ("_nm", "_pm", "_ms", "_N", "_cN", "_gf")


def header_unit(header: str) -> tuple[str, str]:
    """A header's name and the unit that it states, in brackets or at its end; empty where it states none."""
    found = _HEADER.match(header.strip())
    if found is not None:
        unit = (found["square"] if found["square"] is not None else found["round"]).strip()
        return found["stem"].strip(), _known_unit(unit) or unit
    if unit := unit_in(header):
        return bare(header), _SPELT.get(unit, unit)
    stem, _, end = header.rpartition("_")
    unit = _known_unit(end)
    # in other units than ours, or all in capitals
    return (stem, unit) if stem and f"_{unit}" in (*LENGTHS, *ANGLES, *_ENDS) else (header, "")


def _known_unit(text: str) -> str:
    """A unit as it is spelt here, in capitals too; empty for none."""
    units = (_SPELT.get(one, one) for one in (text, text.lower()))
    return next((unit for unit in units if any(unit in kind for kind in _BY_UNIT)), "")


def is_unit(text: str) -> bool:
    """Whether a cell holds a unit and nothing else."""
    text = text.strip()
    return any(_SPELT.get(text, text) in kind for kind in _BY_UNIT) or text.lower() in _BARE


def factor(unit: str, wanted: str) -> float | None:
    """What turns a number in ``unit``, as people write it, into one in the ``wanted`` unit; None where they measure
    different things."""
    unit, wanted = _SPELT.get(unit, unit), _SPELT.get(wanted, wanted)
    if unit == wanted:
        return 1.0
    return next((kind[unit] / kind[wanted] for kind in _BY_UNIT if unit in kind and wanted in kind), None)


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
        # two names may change places
        if ours != theirs and ours in frame.columns and ours not in columns.values():
            raise MeasurementError(f"{source}: has a column '{ours}' itself; '{theirs}' cannot be read as it")
        unit, wanted = header_unit(theirs)[1], unit_in(ours)
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
    if found or all(joint in names for joint in nearest.joints):
        likely = _likely(names, nearest)
        found |= {ours: name for ours, name in likely.items() if ours not in found and name not in found.values()}
    return nearest, found


def in_toml(columns: Columns) -> str:
    """A mapping as the first line of a robot file has it."""
    return f"columns = {{ {', '.join(f'{ours} = {_quoted(theirs)}' for ours, theirs in columns.items())} }}"


def proposal(names: Sequence[str], own: Sequence[Layout] = ()) -> str:
    """What could be meant by foreign names, as a mapping to be looked at: for the sentence that refuses them."""
    layout, found = meanings(names, own)
    if not {*found, *names} & {*layout.joints}:
        free = [name for name in names if name not in layout.known]
        found |= _numbered(free, layout, lambda _theirs, _ours: True)
        found |= _likely(names, layout) if found else {}
    if not found:
        return ""
    bare_ones = [theirs for theirs in found.values() if not header_unit(theirs)[1]]
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
    if TIME not in names and (name := next(filter(_is_time, names), None)) is not None:
        message = f"{source}: column '{name}' is taken as a covariate; is it meant to be '{TIME}'?"
        warnings.warn(message, SherkitWarning, stacklevel=2)


def _quoted(text: str) -> str:
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'


def _matched(names: Sequence[str], layout: Layout) -> dict[str, str]:
    """The joints and readings of a layout by columns that state a fitting unit and have their name, or their number
    beside the same word."""
    free = [name for name in names if name not in layout.known]
    out = _same(names, layout)
    if numbered := _numbered([name for name in free if name not in out.values()], layout, _fits):
        return numbered | out
    for ours, called in ((layout.joints, DRIVEN), (layout.coordinates, READ)):
        if not any(name in names or name in out for name in ours):
            left = [name for name in free if name not in out.values()]
            out |= in_order(left, ours, called, _fits)
    return out


def _numbered(names: Sequence[str], layout: Layout, fits: Callable[[str, str], bool]) -> dict[str, str]:
    """The joints of a layout by columns that have their numbers behind the same word, where one word has them all."""
    words: dict[str, dict[str, str]] = {}
    for name in names:
        if (found := re.fullmatch(r"(.*?)[\s_-]*(\d)", header_unit(name)[0])) is not None:
            words.setdefault(found[1], {})[found[2]] = name
    wanted = {str(k + 1): ours for k, ours in enumerate(layout.joints)}
    rows = [w for w in words.values() if w.keys() == wanted.keys()]
    fitting = [w for w in rows if all(fits(w[k], ours) for k, ours in wanted.items())]
    return {ours: fitting[0][k] for k, ours in wanted.items()} if len(fitting) == 1 else {}


def _is_time(name: str) -> bool:
    """Whether a column is called the time, in a unit of it."""
    return header_unit(name)[0].lower() in _TIMES and _fits(name, TIME)


def _likely(names: Sequence[str], layout: Layout) -> dict[str, str]:
    """Readings and the time by columns that have their letter behind the same word, stating a fitting unit or none."""
    letters = {bare(ours): ours for ours in layout.readings if len(bare(ours)) == 1}
    words: dict[str, dict[str, str]] = {}
    out: dict[str, str] = {}
    for name in (n for n in names if n not in layout.known):
        stem, unit = header_unit(name)
        last = re.fullmatch(r"(.*?)[\s_-]*([a-z])", stem, re.IGNORECASE)
        if last and last[2].lower() in letters and (not unit or _fits(name, letters[last[2].lower()])):
            words.setdefault(last[1].lower(), {})[last[2].lower()] = name
        if TIME not in names and (_is_time(name) or (stem.lower() in _TIMES and not unit)):
            out.setdefault(TIME, name)
    rows = [w for w in words.values() if w.keys() == letters.keys()]
    if len(rows) == 1:
        out = {letters[letter]: name for letter, name in rows[0].items()} | out
    return out


def _same(names: Sequence[str], layout: Layout) -> dict[str, str]:
    """Joints and readings by columns whose header is their name with a unit, each by one alone."""
    out: dict[str, str] = {}
    for ours in (*layout.joints, *layout.readings):
        same = [n for n in names if n != ours and header_unit(n)[0].lower() == bare(ours).lower() and _fits(n, ours)]
        if len(same) == 1:
            out[ours] = same[0]
    return out


def _fits(theirs: str, ours: str) -> bool:
    unit = header_unit(theirs)[1]
    return bool(unit) and factor(unit, unit_in(ours)) is not None
