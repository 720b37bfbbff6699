"""All that is wrong with a file of measurements at once, and what its columns could be: ``sherkit check``."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from ..base.figures import brief, closest, listed
from ..errors import FitError, MeasurementError, SherkitWarning
from .called import Columns, factor, header_unit, is_difference, meanings
from .columns import POSE, REPEAT, TEMPERATURE, TIME, Layout, bare, known_layouts, unit_in
from .doubts import doubts
from .frames import clean
from .raw_table import NOTHING, WITH_UNIT, Problem, RawTable, raw_table
from .reader import checked
from .rows import Measurements
from .tables import PARQUET, is_number, read_parquet

#: What people call what every run may have, in small letters.
_CALLED = {
    TEMPERATURE: ("temperatur", "temperature", "temp", "temperatura", "température", "raumtemperatur", "t_room"),
    POSE: ("pose", "punkt", "point", "messpunkt", "position nr", "pos", "nr", "no", "nummer"),
    REPEAT: ("repeat", "repetition", "wiederholung", "wdh", "durchgang", "zyklus", "messung"),
}
_DAY = re.compile(r"\d{1,4}[./-]\d{1,2}[./-]\d{2,4}")
_CLOCK = re.compile(r"\d{1,2}:\d{2}(:\d{2}([.,]\d+)?)?(\s*[AaPp][Mm])?")
_DAYS = ("%Y-%m-%d", "%d.%m.%Y", "%d.%m.%y", "%Y/%m/%d", "%m/%d/%Y", "%d/%m/%Y", "%d-%m-%Y")
_CLOCKS = ("%H:%M:%S.%f", "%H:%M:%S", "%H:%M", "%I:%M:%S %p", "%I:%M %p")
_HALF_A_DAY_S, _DAY_S = 43_200.0, 86_400.0


@dataclass(frozen=True)
class FileCheck:
    """What is wrong with a file, and what is in it.

    ``wrong`` lists everything; ``columns`` are the names of the file by ours, ``further`` the columns that are read as
    covariates, ``unused`` those that are not read, each with what it could be or nothing; ``unsaid`` are columns of
    other names than ours that no robot file explains. ``data`` are the rows once all that can be is mended, None where
    ``refused`` says why not.
    """

    source: str
    wrong: Sequence[Problem]
    columns: Columns
    further: Sequence[str]
    unused: Mapping[str, str]
    data: Measurements | None
    refused: str
    unsaid: Columns

    @property
    def is_good(self) -> bool:
        """Whether the file can be read as it is."""
        return not self.wrong and not self.refused and not self.unsaid

    @property
    def is_mended(self) -> bool:
        """Whether ``data`` are all rows of the file, with nothing guessed."""
        return self.data is not None and all(one.mended for one in self.wrong)

    def to_json(self) -> dict[str, Any]:
        """All of it, without the rows."""
        return {
            "format": "sherkit check 1",
            "source": self.source,
            "good": self.is_good,
            "mended": self.is_mended,
            "wrong": [
                {"lines": list(w.lines), "column": w.column, "said": w.said, "cure": w.cure, "mended": w.mended}
                for w in self.wrong
            ],
            "columns": dict(self.columns),
            "further": list(self.further),
            "unused": dict(self.unused),
            "rows": None if self.data is None else len(self.data),
            "refused": self.refused,
        }


def _anybody(_: Measurements) -> None:
    """A run of whatever robot."""


def check_file(
    path: str | Path, *, columns: Columns | None = None, layouts: Sequence[Layout] = (), whose: str = "",
    require: Callable[[Measurements], None] = _anybody,
) -> FileCheck:  # fmt: skip
    """Reads a file of measurements as far as it can be read, and says all that is wrong with it.

    ``columns`` are the names that a robot file gives, ``layouts`` the kinds of run that its robot, called ``whose``,
    may have; left out, all that are known. ``require`` raises where the rows are none of this robot. Raises
    :class:`~sherkit.errors.MeasurementError` where there is no file, or no table in it.
    """
    path = checked(path)
    table = _of_parquet(path) if path.suffix.lower() in PARQUET else raw_table(path)
    return _Checking(table, str(path), columns or {}, tuple(layouts), whose, require).result()


def _of_parquet(path: Path) -> RawTable:
    frame = read_parquet(path)
    cells = [["" if v is None else str(v) for v in frame[name]] for name in frame.columns]
    rows = [list(row) for row in zip(*cells, strict=True)]
    return RawTable(tuple(frame.columns), rows, list(range(len(rows))))


@dataclass
class _Checking:
    """One check as it goes on: columns are mended in the order in which a reader would stumble over them."""

    table: RawTable
    source: str
    given: Columns
    layouts: tuple[Layout, ...]
    whose: str
    require: Callable[[Measurements], None]
    cells: dict[str, list[str]] = field(init=False)
    words: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.cells = {name: self.table.column(name) for name in self.table.names}
        self.wrong = self.table.wrong
        for ours, theirs in self.given.items():
            if theirs not in self.cells:
                said = f"is missing, which is to be read as '{ours}' by the robot's file"
                cure = "name it there as it is here, or leave it out there"
                self.wrong.append(Problem(said, cure, column=theirs, mended=False))

    def result(self) -> FileCheck:
        """All of it."""
        self._times()
        self._units_in_cells()
        self._nothing_read()
        self._marks()
        layout, columns = self._meanings()
        if self._counts_rows(columns):
            # as the number of a pose each of its repeats would be another
            del columns[POSE]
        numbers = [name for name in self.cells if name not in self.words]
        meant = {theirs: ours for ours, theirs in columns.items()}
        known = {*layout.known, *layout.velocities, *layout.apart, *layout.loads, TEMPERATURE}
        further = [name for name in numbers if meant.get(name, name) not in known]
        unused = {name: _could_be(name, {*known} - {*columns}) for name in (*self.words, *further)}
        data, refused = self._read(columns)
        counts = {ours: theirs for ours, theirs in columns.items() if ours in (POSE, REPEAT) and ours != theirs}
        if refused and (guessed := {ours: v for ours, v in counts.items() if ours not in self.given}):
            # what was taken for the number of a pose need not be one
            others = {ours: theirs for ours, theirs in columns.items() if ours not in guessed}
            data, _ = self._read(others)
            if data is not None:
                columns, further = others, [*further, *guessed.values()]
                for ours, theirs in guessed.items():
                    why = f"is not read as '{ours}': {refused.removeprefix(f'{self.source}: ')}"
                    self.wrong.append(Problem(why, f"name it '{ours}' if it is", column=theirs))
            refused = refused if data is None else ""
        if data is not None:
            told = (doubt.sentence for doubt in doubts(data, by_hand=True) if not doubt.poses)
            self.wrong += [Problem(one, "look at it; it is read as it stands", mended=False) for one in told]
        return FileCheck(
            self.source, tuple(self.wrong), columns, further,
            {name: what for name, what in unused.items() if name in self.words or what}, data, refused,
            {ours: name for ours, name in columns.items() if ours != name and ours not in self.given},
        )  # fmt: skip

    def _counts_rows(self, columns: Columns) -> bool:
        """Whether what looks like the number of a pose, and is not called so, is another in each row."""
        called = columns.get(POSE, POSE)
        cells = [] if called == POSE or POSE in self.given else self.cells[called]
        return len(cells) > 1 and len({*cells}) == len(cells)

    def _foreign(self, names: set[str]) -> str:
        """That these columns are no run of the robot, and which of its own are missing; empty where they may be one."""
        lacking = [[joint for joint in one.joints if joint not in names] for one in self.layouts]
        read = [bool(names & {*one.readings}) for one in self.layouts]
        if not self.layouts or any(seen and not joints for joints, seen in zip(lacking, read, strict=True)):
            return ""
        missing = [listed(fewest, 12)] if (fewest := min(lacking, key=len)) else []
        if not any(read):
            wanted = dict.fromkeys(name for one in self.layouts for name in one.readings)
            missing.append(f"at least one of {listed(wanted, 12)}")
        has = listed(self.table.names, 12)
        otherwise = [f"'{theirs}' as {ours}" for ours, theirs in self.given.items() if theirs in fewest]
        has += f", where the robot's file reads {listed(otherwise)}" if otherwise else ""
        if apart := [name for name in self.table.names if is_difference(name)]:
            has += f" ('{brief(apart[0])}' is called a difference: what was read is that and what was driven to)"
        return f"{self.source}: is no run of {self.whose}: lacks {' and '.join(missing)}; the file has {has}"

    def _read(self, columns: Columns) -> tuple[Measurements | None, str]:
        renamed = {ours: theirs for ours, theirs in columns.items() if ours != theirs}
        if not self.table.rows:
            return None, f"{self.source}: holds no row of measurements"
        if foreign := self._foreign({*columns, *(name for name in self.cells if name not in columns.values())}):
            return None, foreign
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always", SherkitWarning)
            try:
                line = np.array(self.table.line, dtype=np.int64)
                data = clean(pl.DataFrame(self.cells), self.source, line, "line", renamed, self.layouts)
                self.require(data)
            except (FitError, MeasurementError) as error:
                return None, str(error)
        doubts = [str(w.message) for w in said if issubclass(w.category, SherkitWarning)]
        for one in doubts:
            if "converted from the units" not in one:
                self.wrong.append(Problem(one.removeprefix(f"{self.source}: "), "look at it; it is read as it stands"))
        return data, ""

    # -- cells ---------------------------------------------------------------------------------------------

    def _lines(self, where: Sequence[bool]) -> tuple[int, ...]:
        return tuple(n for n, here in zip(self.table.line, where, strict=True) if here)

    def _times(self) -> None:
        """Days and times of day become seconds."""
        moments: dict[str, str] = {}
        for name, cells in self.cells.items():
            filled = [cell for cell in cells if cell]
            for kind, pattern in (("day", _DAY), ("clock", _CLOCK), ("both", None)):
                whole = pattern or re.compile(f"{_DAY.pattern}[T ]+{_CLOCK.pattern}(Z|[+-]\\d\\d:?\\d\\d)?")
                if filled and sum(whole.fullmatch(cell) is not None for cell in filled) > 0.5 * len(filled):
                    moments[name] = kind
        both: str | None = next((n for n, kind in moments.items() if kind == "both"), None)
        clock: str | None = next((n for n, kind in moments.items() if kind == "clock"), None)
        day: str | None = next((n for n, kind in moments.items() if kind == "day"), None)
        self.words += [one for one in moments if one not in (both or clock, day)]
        timed = both or clock
        if timed is None or (TIME in self.cells and timed != TIME):
            self.words += [one for one in (timed, day) if one is not None and one not in self.words]
            return
        texts = self.cells[timed]
        if both is None and day is not None:
            texts = [f"{d} {t}".strip() for d, t in zip(self.cells[day], texts, strict=True)]
        seconds, bad = _seconds(texts)
        if seconds is None:
            said = f"'{brief(texts[bad])}' is no time that is known"
            line = self.table.line[bad]
            self.wrong.append(Problem(said, "write seconds, counted from any moment", (line,), timed, mended=False))
            self.words.append(timed)
            return
        said = f"holds {'dates with times' if both or day else 'times of day'}; as {TIME} they count from the first row"
        self.wrong.append(Problem(said, f"write seconds under {TIME}", column=timed))
        self.cells = {TIME if n == timed else n: v for n, v in self.cells.items() if n != day or both is not None}
        self.cells[TIME] = [f"{v:.10g}" for v in seconds]

    def _units_in_cells(self) -> None:
        """Units behind every number go to the name of the column."""
        for name, cells in list(self.cells.items()):
            found = [WITH_UNIT.fullmatch(cell) for cell in cells if cell and cell.lower() not in NOTHING]
            units = {one["unit"].strip() for one in found if one}
            if not found or not all(found) or len(units) != 1:
                continue
            unit = units.pop()
            self.wrong.append(
                Problem(
                    f"every cell ends in '{brief(unit)}'",
                    f"write the unit once: '{brief(name)} [{brief(unit)}]'",
                    (),
                    name,
                )
            )
            new = f"{name} [{unit}]"
            stripped = [one["number"] if (one := WITH_UNIT.fullmatch(cell)) else cell for cell in cells]
            self.cells = {new if n == name else n: stripped if n == name else v for n, v in self.cells.items()}

    def _nothing_read(self) -> None:
        """Columns of words are set aside; in columns of numbers, what says that nothing was read becomes empty, and
        what else is no number is said."""
        for name, cells in self.cells.items():
            filled = [cell for cell in cells if cell and cell.lower() not in NOTHING]
            if name in self.words or sum(map(is_number, filled)) * 2 <= len(filled):
                if name not in self.words:
                    self.words.append(name)
                continue
            nothing = [cell.lower() in NOTHING for cell in cells]
            if any(nothing):
                said = f"'{brief(cells[nothing.index(True)])}' is no number; it says that nothing was read"
                self.wrong.append(Problem(said, "leave the cell empty", self._lines(nothing), name))
                self.cells[name] = ["" if no else cell for cell, no in zip(cells, nothing, strict=True)]
            bad = [bool(cell) and not no and not is_number(cell) for cell, no in zip(cells, nothing, strict=True)]
            if any(bad):
                said = f"'{brief(cells[bad.index(True)])}' is not a number"
                self.wrong.append(Problem(said, "write the number, or leave the cell empty", self._lines(bad), name,
                                        mended=False))  # fmt: skip

    def _marks(self) -> None:
        """Decimal commas and marks between thousands, where the file proves which is which."""
        marks = {name: _mark_of(cells) for name, cells in self.cells.items() if name not in self.words}
        proven = {mark for mark in marks.values() if mark in (".", ",")}
        for name, mark in marks.items():
            cells = self.cells[name]
            if mark == "?":
                mark = proven.copy().pop() if len(proven) == 1 else "."
                if len(proven) != 1 or mark == ".":
                    some = [bool(re.search(r",\d{3}$", cell)) for cell in cells]
                    said = f"'{brief(cells[some.index(True)])}' may be a thousand or have a decimal comma"
                    self.wrong.append(Problem(said, "write numbers with a decimal point", self._lines(some), name,
                                            mended=False))  # fmt: skip
                    continue
            if mark == "!":
                some = ["," in cell and "." not in cell for cell in cells]
                self.wrong.append(Problem("has decimal commas and decimal points", "write one of them",
                                        self._lines(some), name, mended=False))  # fmt: skip
                continue
            other = "," if mark == "." else "."
            thousands = [other in cell for cell in cells]
            if any(thousands):
                said = f"'{brief(cells[thousands.index(True)])}' has marks between its thousands"
                self.wrong.append(Problem(said, "leave them out", self._lines(thousands), name))
            self.cells[name] = [cell.replace(other, "").replace(mark, ".") for cell in cells]

    def _in_celsius(self, name: str, unit: str) -> None:
        """Kelvin and Fahrenheit, where the header states them, become degrees Celsius."""
        scale = {"K": "K", "kelvin": "K", "°F": "F", "F": "F", "degF": "F"}.get(unit)
        if scale is None:
            return
        self.wrong.append(Problem(f"is in {'kelvin' if scale == 'K' else 'Fahrenheit'}", "write °C", column=name))
        with suppress(ValueError):  # what is no number is said already
            self.cells[name] = [f"{_celsius(float(c), scale):.10g}" if c else c for c in self.cells[name]]

    # -- names ---------------------------------------------------------------------------------------------

    def _meanings(self) -> tuple[Layout, dict[str, str]]:
        """The kind of run, and the names of the file by ours."""
        names = [name for name in self.cells if name not in self.words]
        given = {ours: theirs for ours, theirs in self.given.items() if theirs in names}
        free = [name for name in names if name not in given.values()]
        layout, found = meanings([*free, *given], self.layouts or known_layouts())
        columns = given | {ours: theirs for ours, theirs in found.items() if ours not in given}
        for name in free:
            if name in columns.values():
                continue
            stem, unit = header_unit(name)
            for ours in (*layout.known, *layout.velocities):
                convertible = not unit or factor(unit, unit_in(ours)) is not None
                if stem.lower() == bare(ours).lower() and ours not in columns and convertible:
                    columns[ours] = name
                    break
            if stem.lower() in _CALLED[TEMPERATURE]:
                self._in_celsius(name, unit)
            for ours, called in _CALLED.items():
                whole = ours == TEMPERATURE or all(re.fullmatch(r"\d*", cell) for cell in self.cells[name])
                if stem.lower() in called and whole and ours not in columns and ours not in names:
                    columns.setdefault(ours, name)
        return layout, {ours: theirs for ours, theirs in columns.items() if theirs in names}


def _celsius(degrees: float, unit: str) -> float:
    return degrees - 273.15 if unit == "K" else (degrees - 32.0) / 1.8


def _mark_of(cells: Sequence[str]) -> str:
    """The decimal mark of a column: "." or ",", "?" where its commas may as well stand between thousands, "!" where it
    has both."""
    commas = points = doubtful = 0
    for cell in cells:
        last = max(cell.rfind(","), cell.rfind("."))
        if "," in cell and "." in cell:
            commas, points = commas + (cell[last] == ","), points + (cell[last] == ".")
        elif cell.count(",") > 1:
            points += 1  # 1,234,567
        elif cell.count(".") > 1:
            commas += 1
        elif "," in cell:
            maybe = re.fullmatch(r"[-+]?[1-9]\d{0,2},\d{3}", cell) is not None
            doubtful, commas = doubtful + maybe, commas + (not maybe)
        elif "." in cell:
            points += 1
    if commas and points:
        return "!"
    return "," if commas else "." if points or not doubtful else "?"


def _seconds(texts: Sequence[str]) -> tuple[list[float] | None, int]:
    """Seconds from the first moment; None, and the first that is none, where some is none."""
    formats = ("iso", *(f"{day} {clock}" for day in _DAYS for clock in _CLOCKS), *_CLOCKS)
    best = 0
    for one in formats:
        moments: list[datetime] = []
        for text in texts:
            try:
                tidy = text.replace(",", ".")
                moments.append(datetime.fromisoformat(tidy) if one == "iso" else datetime.strptime(tidy, one))
            except ValueError:
                break
        if len(moments) == len(texts):
            seconds = [(moment - moments[0]).total_seconds() for moment in moments]
            if one in _CLOCKS:  # a run that goes on after midnight
                for k in range(1, len(seconds)):
                    while seconds[k] < seconds[k - 1] - _HALF_A_DAY_S:
                        seconds[k] += _DAY_S
            return seconds, 0
        best = max(best, len(moments))
    return None, best


def _could_be(name: str, ours: set[str]) -> str:
    """What of ours a column could be; empty where nothing is near."""
    stem = header_unit(name)[0].lower()
    for one, called in _CALLED.items():
        if stem in called and one in ours:
            return one
    return closest(stem, ours, 0.75) or ""


def said_of(found: FileCheck) -> str:
    """In one line, how many things are wrong and what comes of it."""
    if found.refused and not found.wrong:
        return f"{found.source}: cannot be used"
    count = len(found.wrong)
    if found.is_good:
        return f"{found.source}: nothing is wrong, {len(found.data or ())} rows"
    many = f"{count} thing{'s are' if count != 1 else ' is'} wrong" if count else "cannot be read as it is"
    own = list(found.unsaid.values())
    many_own = f"{len(own)} columns have names of their own" if len(own) > 1 else "one column has a name of its own"
    foreign = f"; {many_own}: {listed(own, 12)}" if own else ""
    return f"{found.source}: {many}{foreign}"
