"""A file of measurements as people and programs leave it: its cells as text, and what is in the way of reading them.

The readers refuse at the first thing that is wrong; here all of it is listed, by line, and mended where nothing has to
be guessed.
"""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

from ..base.figures import brief, spans
from ..errors import MeasurementError
from .called import is_unit
from .tables import MARKS, NO_LINE, NO_TEXT, by_spaces, is_note, is_number, nameless, names_given, tabbed

#: Cells that say that nothing was read.
NOTHING = ("---", "--", "-", "n/a", "na", "nan", "#n/a", "#nv", "null", "none", "?", "k.a.", "x", "*", "err", "error")
#: First cells of rows that spreadsheets compute below the others, in small letters.
_SUMMED = (
    "mittelwert", "mittel", "mw", "mean", "average", "avg", "moyenne", "media", "std", "stdev", "sd", "stabw",
    "stdabw", "standardabweichung", "min", "max", "minimum", "maximum", "median", "summe", "sum", "total",
)  # fmt: skip
#: A number with its unit behind it, in the same cell.
WITH_UNIT = re.compile(r"(?P<number>[-+]?\d[\d.,]*(?:[eE][-+]?\d+)?)\s*(?P<unit>[^\d\s.,:/-][^\d:]*)")
#: Lines that tell how cells are parted, and where names begin.
_LOOKED_AT = 200
#: Lines that a sentence names.
_NAMED = 6
#: Lines over which a quoted cell may go on.
_MOST_LINES = 100


@dataclass(frozen=True)
class Problem:
    """Something that is wrong with a file: what, in which ``lines`` and ``column``, and the ``cure``; ``mended`` where
    the table that is made of it is without."""

    said: str
    cure: str
    lines: tuple[int, ...] = ()
    column: str = ""
    mended: bool = True

    def __str__(self) -> str:
        many = len(self.lines) > 1
        where = [f"line{'s' if many else ''} {spans(self.lines, _NAMED)}"] if self.lines else []
        where += [f"column '{brief(self.column)}'"] if self.column else []
        return f"{', '.join(where)}{': ' if where else ''}{self.said}"


@dataclass(frozen=True)
class RawTable:
    """Cells of a file as text: a row each, with its ``line`` in the file, under ``names``; those of a row of units
    stand in the names, in brackets."""

    names: tuple[str, ...]
    rows: list[list[str]]
    line: list[int]
    wrong: list[Problem] = field(default_factory=list)

    def column(self, name: str) -> list[str]:
        """The cells of a column."""
        k = self.names.index(name)
        return [row[k] for row in self.rows]

    def without(self, empty: Sequence[str]) -> RawTable:
        """The table without some columns."""
        keep = [k for k, name in enumerate(self.names) if name not in empty]
        rows = [[row[k] for k in keep] for row in self.rows]
        return replace(self, names=tuple(self.names[k] for k in keep), rows=rows)


def raw_table(path: Path) -> RawTable:
    """Reads a CSV with all that is wrong with it. Raises :class:`~sherkit.errors.MeasurementError` where it holds no
    table at all."""
    wrong: list[Problem] = []
    texts = _text(path, wrong).splitlines()
    lines = [(n, s) for n, s in enumerate(texts, start=1) if not is_note(s)]
    if not lines:
        raise MeasurementError(f"{path}: {NO_LINE}")
    called = names_given()
    lines, separator = _parted(lines)
    cells = list(_cells(path, lines, separator))
    first = _first_row(cells, len(called))
    if called:
        head, units = list(called), list[str]()
        if first:
            wrong.append(Problem("above the rows", "put # before it", tuple(n for n, _ in cells[:first])))
    else:
        above = _noted(texts, cells[first:]) + cells[:first]
        head, units = _head(path, above, cells[first:], wrong)
    names = _names(head, units, wrong)
    rows, line = [], []
    out: dict[str, list[int]] = {}
    short: dict[int, list[int]] = {}
    for number, row in cells[first:]:
        if why := _is_none(row, head, units):
            out.setdefault(why, []).append(number)
        elif len(row) < len(head) or any(row[len(head) :]):
            short.setdefault(len(row), []).append(number)
        else:
            rows.append(row[: len(head)])
            line.append(number)
    for why, numbers in out.items():
        wrong.append(Problem(why, "take the line out", tuple(numbers)))
    for count, numbers in short.items():
        said = f"has {count} cell{'s' if count > 1 else ''}, the header has {len(head)}"
        wrong.append(Problem(said, "complete the row, or take it out", tuple(numbers), mended=False))
    table = RawTable(names, rows, line, wrong)
    unnamed = [name for name in names if name.startswith("\0")]
    for k, name in enumerate(names):
        if name in unnamed and any(table.column(name)):
            wrong.append(Problem(f"column {k + 1} holds cells and has no name: it is not used", "give it a name"))
    return table.without(unnamed)


def _text(path: Path, wrong: list[Problem]) -> str:
    """The file as text, in the encoding that it shows."""
    content = path.read_bytes()
    for mark, encoding in ((b"\xff\xfe", "utf-16"), (b"\xfe\xff", "utf-16")):
        if content.startswith(mark):
            wrong.append(Problem("the file is UTF-16", "save it as UTF-8"))
            return content.decode(encoding, errors="replace")
    if b"\0" in content[:4096]:
        raise MeasurementError(f"{path}: {NO_TEXT}")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        number = content.count(b"\n", 0, error.start) + 1
        said = f"is not UTF-8 (byte {content[error.start]:#04x}); it reads as Windows-1252"
        wrong.append(Problem(said, "save the file as UTF-8", (number,)))
        return content.decode("cp1252", errors="replace")


def _parted(lines: Sequence[tuple[int, str]]) -> tuple[list[tuple[int, str]], str]:
    """What parts the cells: what most lines have equally often. Where spaces do, they become tabs."""
    some = [line for _, line in lines[:_LOOKED_AT]]

    def agreed(mark: str) -> tuple[int, int]:
        count, times = Counter(line.count(mark) for line in some if mark in line).most_common(1)[0]
        return times * (count > 0), count

    marks = [mark for mark in ";\t,|" if any(mark in line for line in some)]
    # decimal commas are as many in every row, too: a mark that is no part of a number goes before
    sure = [mark for mark in marks if mark != "," and agreed(mark)[0] >= 0.5 * len(some)]
    spaced = [len(line.split()) for line in some if by_spaces(line) and _is_data(line.split())]
    if not sure and len(spaced) > 0.4 * len(some):
        count = Counter(spaced).most_common(1)[0][0]
        return [(n, tabbed(line, count)) for n, line in lines], "\t"
    return list(lines), max(sure or marks or [","], key=agreed)


def _cells(path: Path, lines: Sequence[tuple[int, str]], separator: str) -> Iterator[tuple[int, list[str]]]:
    """The rows, each with its first line: a quoted cell may go on over the next lines, unless its quote is never closed
    or closes far below, as a mark of inches would."""
    k = 0
    while k < len(lines):
        number = lines[k][0]
        try:
            row, count = _row(lines, k, separator)
        except csv.Error:
            raise MeasurementError(f"{path}: line {number} is not CSV") from None
        yield number, [_tidy(cell) for cell in row]
        k += count


def _row(lines: Sequence[tuple[int, str]], k: int, separator: str) -> tuple[list[str], int]:
    """Cells of the row that begins with line k of these, and how many lines it takes."""
    if '"' in lines[k][1]:
        some = (f"{text}\n" for _, text in lines[k : k + _MOST_LINES])
        reader = csv.reader(some, delimiter=separator, strict=True)
        with suppress(csv.Error):
            return next(reader), reader.line_num
    return next(csv.reader([lines[k][1]], delimiter=separator)), 1


def _tidy(cell: str) -> str:
    return cell.replace("\u2212", "-").replace("\u00a0", " ").replace("\u202f", "").strip()


def _is_data(row: Sequence[str]) -> bool:
    """A row of measurements: most of its cells are numbers, or say that nothing was read."""
    filled = [cell for cell in row if cell]
    numbers = sum(is_number(cell) or WITH_UNIT.fullmatch(cell) is not None for cell in filled)
    return numbers >= 2 and numbers + sum(cell.lower() in NOTHING for cell in filled) > 0.5 * len(filled)


def _first_row(cells: Sequence[tuple[int, list[str]]], count: int) -> int:
    """Where rows of measurements begin: below names, or at the first that has as many cells as there are ``count``
    names, or as most have."""
    data = [(k, len(row)) for k, (_, row) in enumerate(cells) if _is_data(row)]
    if not data:
        return len(cells)
    first = data[0][0]
    if not count and first and 2 * len([cell for cell in cells[first - 1][1] if cell]) > data[0][1]:
        return first  # below names
    most = count or Counter(n for _, n in data).most_common(1)[0][0]
    return next((k for k, n in data if n == most), first)


def _noted(texts: Sequence[str], rows: Sequence[tuple[int, list[str]]]) -> list[tuple[int, list[str]]]:
    """The last note above the rows, where it names as many columns as these have: so writes numpy.savetxt."""
    if not rows:
        return []
    number, row = rows[0]
    for n in range(number - 1, 0, -1):
        if texts[n - 1].lstrip().startswith("#"):
            note = texts[n - 1].strip().lstrip("#").strip()
            for mark in (*MARKS, None):
                own = [name.strip() for name in note.split(mark)]
                if len(own) == len(row) == len({*own}) and not any(map(is_number, own)):
                    return [(n, own)]
            return []
    return []


def _is_none(row: Sequence[str], head: Sequence[str], units: Sequence[str]) -> str:
    """Why a line among the rows is none; empty where it may be one."""
    filled = [cell for cell in row if cell]
    if not filled:
        return "holds separators alone"
    if list(row[: len(head)]) == list(head) or (units and list(row[: len(units)]) == list(units)):
        return "the names of the columns stand here again"
    if filled[0].lower().rstrip(":") in _SUMMED and len(filled) > 1:
        return "is no row but what was computed of them"
    return "holds a word alone" if len(filled) == 1 < len(head) and filled[0].isalpha() else ""


def _head(
    path: Path, above: list[tuple[int, list[str]]], rows: list[tuple[int, list[str]]], wrong: list[Problem]
) -> tuple[list[str], list[str]]:
    """The names of the columns, and the units below them; what stands above them are notes."""
    if not above or (rows and (_is_data(above[-1][1]) or len([c for c in above[-1][1] if c]) < 2 <= len(rows[0][1]))):
        number, cells = rows[0]
        raise MeasurementError(f"{path}: {nameless(number, len(cells))}")
    units: list[str] = []
    number, row = above[-1]
    if len(above) > 1 and any(row) and all(is_unit(cell.strip("[]()")) for cell in row if cell):
        wrong.append(Problem("is a row of units", "write each unit behind its name: 'x [mm]'", (number,)))
        units, above = row, above[:-1]
        number, row = above[-1]
    notes = tuple(n for n, _ in above[:-1])
    if notes:
        wrong.append(Problem("above the names of the columns", "put # before it, as before every note", notes))
    while row and not row[-1]:
        row = row[:-1]
    return row, units


def _names(head: Sequence[str], units: Sequence[str], wrong: list[Problem]) -> tuple[str, ...]:
    """Names of columns, each once, with their units; those without a name are numbered behind a zero byte."""
    out: list[str] = []
    for k, name in enumerate(head):
        unit = units[k].strip("[]()") if k < len(units) else ""
        full = f"{name} [{unit}]" if name and unit else name or f"\0{k}"
        if full in out:
            wrong.append(
                Problem(f"'{brief(full)}' is the name of two columns", "give each a name of its own", mended=False)
            )
            full = f"{full} ({k + 1})"
        out.append(full)
    return tuple(out)
