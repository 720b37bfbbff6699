"""Measurement files: CSV and Parquet."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from itertools import chain, islice
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import polars as pl

from ..base.arguments import validate_arguments
from ..base.figures import brief
from ..base.types import Ints
from ..errors import MeasurementError
from . import columns as c
from .called import Columns
from .files import bag_in, of_demo, refuse_device
from .frames import clean, from_frame
from .rows import Measurements
from .tables import MARKS, NO_LINE, NO_TEXT, PARQUET, by_spaces, head_of, is_note, is_number, names_given, read_parquet

# -- Decimal commas, in files whose cells are not parted by commas --------------------------------------------------

#: A number with a decimal comma; other commas belong to labels.
_COMMA = r"^\s*[+-]?(\d+,\d*|,\d+)([eE][+-]?\d+)?\s*$"
#: One that may as well have a comma between its thousands.
_MAYBE_THOUSANDS = r"^\s*[+-]?[1-9]\d{0,2},\d{3}\s*$"
#: A number that has thousands, or parts of them, beyond doubt.
_THOUSANDS = r"^\s*[+-]?\d{1,3}(,\d{3}){2,}(\.\d*)?\s*$|^\s*[+-]?\d{1,3}(,\d{3})+\.\d*\s*$"
_POINT = r"^\s*[+-]?(\d+\.\d*|\.\d+)([eE][+-]?\d+)?\s*$"
_WHOLE = r"^\s*[+-]?\d+\s*$"


class DecimalMark:
    """What the cells of a file, block by block, say of its decimal mark.

    A comma is one where some cell of the file cannot be read otherwise (``0,012``, ``1,5``) and no cell has a point.
    ``1,000`` may be one or a thousand: it is one in a column all of whose numbers have commas, or where its own column
    proves it.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._point = ""
        self._comma = ""
        self._proven: set[str] = set()

    def with_points(self, frame: pl.DataFrame, line: Ints) -> pl.DataFrame:
        """The cells with points for decimal commas. Raises :class:`~sherkit.errors.MeasurementError` at the first that
        can be read in two ways."""
        # of the blocks before this one, which have been read with it
        before = self._comma
        commas, doubtful, point, whole, grouped = (
            # of all columns at once: one question for each of them takes as long as one for all
            frame.select(pl.all().str.contains(pattern)).to_dict()
            for pattern in (_COMMA, _MAYBE_THOUSANDS, _POINT, _WHOLE, _THOUSANDS)
        )
        filled = frame.select(pl.all().str.strip_chars() != "").to_dict()
        for name in frame.columns:
            column = frame[name]
            if not self._point and (points := point[name]).any():
                self._point = str(column.filter(points)[0])
                if before:
                    self._refuse(
                        name, column, points, line, f"the decimal mark of this file is the comma ('{brief(before)}')"
                    )
            if (sure := commas[name] & ~doubtful[name]).any():
                self._proven.add(name)
                self._comma = self._comma or str(column.filter(sure)[0])
        out = []
        for name in frame.columns:
            column, comma, thousands = frame[name], commas[name], grouped[name]
            # a column of words may hold anything
            numbers = comma | point[name] | whole[name] | thousands
            if (~numbers & filled[name]).sum() * 2 > len(column):
                out.append(column)
                continue
            if thousands.any():
                self._refuse(name, column, thousands, line, "commas between thousands are not read; leave them out")
            if comma.any() and self._point:
                why = f"the decimal mark of this file is the point ('{brief(self._point)}'); write it without a comma"
                self._refuse(name, column, comma, line, why)
            proven = name in self._proven or (bool(self._comma) and not whole[name].any())
            if doubtful[name].any() and not proven:
                why = "may be a thousand or have a decimal comma; write numbers with a decimal point"
                self._refuse(name, column, doubtful[name], line, why)
            if comma.any():
                column = pl.select(pl.when(comma).then(column.str.replace(",", ".")).otherwise(column).alias(name))[
                    name
                ]
            out.append(column)
        return pl.DataFrame(out) if out else frame

    def _refuse(self, name: str, column: pl.Series, where: pl.Series, line: Ints, why: str) -> NoReturn:
        row = int(where.arg_max() or 0)
        found = brief(column[row])
        raise MeasurementError(f"{self._path}: line {line[row]}, column '{brief(name)}': '{found}': {why}")


# -- CSV as programs write it ---------------------------------------------------------------------------------------

#: In a word, what only a reader that goes cell by cell understands.
_SPECIAL = r'["#\r\x00]'

#: The first lines are not longer than this.
_LONGEST = 1 << 16


def read_plain(path: Path) -> tuple[pl.DataFrame, Ints] | None:
    """The columns of a plain file and the line of each row; None where anything in it needs a closer look.

    What is wrong with a file is said by that closer look, which reads it again: here nothing is refused.
    """
    if not path.is_file():
        return None  # a pipe cannot be read again
    try:
        with path.open("rb") as file:
            head, row = file.readline(_LONGEST), file.readline(_LONGEST)
        byte = np.memmap(path, dtype=np.uint8, mode="r")
        names = head.decode("utf-8-sig").removesuffix("\n").removesuffix("\r")
        first = row.decode().removesuffix("\n").removesuffix("\r")
    except (OSError, ValueError):  # among them: an empty file, and text that is none
        return None
    if names_given() or by_spaces(names) or by_spaces(first):
        return None
    separator = max(MARKS, key=names.count)
    columns = [name.strip() for name in names.split(separator)]
    if all(map(is_number, columns)):
        return None
    cells = first.split(separator)
    if any(mark in names for mark in '"#\r\0') or not all(columns) or not len({*columns}) == len(columns) == len(cells):
        return None
    schema = {
        name: pl.Float64 if _is_plain_number(cell) else pl.String for name, cell in zip(columns, cells, strict=True)
    }
    try:
        frame = pl.read_csv(path, separator=separator, schema=schema, has_header=False, skip_rows=1, quote_char=None)
    except pl.exceptions.PolarsError:
        return None
    rows = int(np.count_nonzero(byte == ord("\n")) - (byte[-1] == ord("\n")))
    number, word = pl.col(pl.Float64), pl.col(pl.String)
    told = frame.select(
        # a number that went wrong is shown by its cell, and an empty cell may be one that is not there
        broken=pl.any_horizontal(number.is_finite().not_().any(), False),
        empty=pl.any_horizontal(pl.all().is_null().any()),
        special=pl.any_horizontal(word.str.contains(_SPECIAL).any(), False),
    ).row(0)
    if frame.height != rows or told[0] or told[2]:
        return None
    if told[1] and np.count_nonzero(byte[len(head) :] == ord(separator)) != rows * (len(columns) - 1):
        return None
    if separator != "," and np.any(byte == ord(",")):
        return None  # decimal commas, perhaps
    return frame, np.arange(2, rows + 2, dtype=np.int64)


def _is_plain_number(cell: str) -> bool:
    """Whether a column that begins so holds numbers; an empty cell may be a reading that was not taken."""
    try:
        float(cell.strip() or "0")
    except ValueError:
        return False
    return True


# -- Reading a file --------------------------------------------------------------------------------------------------

#: A file with a zero byte among this many is no text.
_HEAD = 4096
#: How the files of `sherkit measure` begin (SQLite).
_RUN_FILE = b"SQLite format 3"


@validate_arguments
def read_measurements(path: str | Path, *, columns: Columns | None = None) -> Measurements:
    """Reads a run. Cells are parted by comma, semicolon, tab or spaces (all but the first with decimal comma); lines
    starting with ``#`` are notes, columns without a name are left out.

    ``columns`` gives the names of the file by ours, ``{"q1_mm": "Enc1 [um]"}``; where a header states a unit, in
    brackets or at its end, what it holds is converted, and that is said in a :class:`~sherkit.errors.SherkitWarning`.

    Raises :class:`~sherkit.errors.MeasurementError` naming file, line, column and what was expected.

        run = sk.read_measurements("demo/whole.csv")
        print(len(run), run.layout.readings)
    """
    return read_run(path, columns)


def read_run(path: str | Path, columns: Columns | None = None, layouts: Sequence[c.Layout] = ()) -> Measurements:
    """The same of a robot that has these ``layouts``, of which sentences speak where the columns fit nothing."""
    path = checked(path)
    if path.suffix.lower() in PARQUET:
        return clean(read_parquet(path), str(path), None, "row", columns, layouts)
    frame, line = read_plain(path) or next(csv_blocks(path))
    return clean(frame, str(path), line, "line", columns, layouts)


def checked(path: str | Path) -> Path:
    """The path of a file that exists. Raises :class:`~sherkit.errors.MeasurementError`."""
    path = Path(path)
    if path.is_dir():
        raise MeasurementError(f"{path}: is a folder, expected a CSV or Parquet file{bag_in(path)}")
    if not path.exists():
        raise MeasurementError(f"{path}: there is no such file{of_demo(path)}")
    refuse_device(path, MeasurementError)
    if not path.is_file():
        return path  # of a pipe nothing can be read twice
    try:
        with path.open("rb") as file:
            head = file.read(len(_RUN_FILE))
    except OSError as error:
        raise MeasurementError(f"{path}: cannot be read: {error.strerror}") from None
    if head == _RUN_FILE:
        hint = f"sherkit export {path.name} -o run.csv makes a table of it"
        raise MeasurementError(f"{path}: is the run file of an experiment; {hint}")
    if head.lstrip()[:1] in (b"[", b"{"):
        raise MeasurementError(
            f"{path}: is JSON, expected CSV or Parquet; bluesky's documents are read by sk.from_bluesky and sherkit "
            "import bluesky"
        )
    return path


def csv_blocks(path: Path, most: int | None = None) -> Iterator[tuple[pl.DataFrame, Ints]]:
    """The cells of a CSV as text, and the line of each row in the file: at ``most`` so many at once, by default all.

    A file without rows gives one empty block. Raises :class:`~sherkit.errors.MeasurementError`.
    """
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            head = head_of(str(path), enumerate(file, start=1))
            if head is None:
                raise MeasurementError(f"{path}: {NO_LINE}")
            if "\0" in head.names:
                raise _not_text(path)
            lines, separator, names = head.lines, head.separator, list(head.called)
            if not names:
                names = [name.strip() for name in _cells(path, head.number, head.names, lines, separator)]
            c.check_unique([name for name in names if name], str(path))
            found, mark = False, DecimalMark(path)
            while part := list(islice(lines, most)):
                frame, line = _block(path, names, separator, part, lines)
                if len(line):
                    found = True
                    yield (frame if separator == "," else mark.with_points(frame, line)), line
            if not found:
                yield _frame([], names, separator), np.zeros(0, dtype=np.int64)
    except UnicodeDecodeError:
        raise _not_text(path) from None
    except OSError as error:
        raise MeasurementError(f"{path}: cannot be read: {error.strerror}") from None


def _cells(path: Path, number: int, text: str, lines: Iterator[tuple[int, str]], separator: str) -> list[str]:
    """The cells of a row that may be quoted; a quoted cell may go on over the next lines."""
    try:
        return next(csv.reader(chain([text], (s for _, s in lines)), delimiter=separator, strict=True))
    except csv.Error as error:
        what = "a quotation mark is not closed" if "unexpected end" in str(error) else str(error)
        raise MeasurementError(f"{path}: line {number} is not CSV: {what}") from None


def _block(
    path: Path, names: list[str], separator: str, part: list[tuple[int, str]], rest: Iterator[tuple[int, str]]
) -> tuple[pl.DataFrame, Ints]:
    """Cells and lines of a part of the file; a quoted cell at its end takes from the ``rest``."""
    texts = [s for _, s in part]
    text = "".join(texts).replace("\r\n", "\n")
    special = any(mark in text for mark in '"#\r') or any(map(str.isspace, texts))
    if not special and text.count(separator) == len(part) * (len(names) - 1):
        # as nearly always: every line is a row
        with suppress(pl.exceptions.PolarsError):  # a row too long beside one too short; found below
            return _frame(text, names, separator), np.arange(part[0][0], part[0][0] + len(part))
    lines, cells = [], []
    own = iter(part)
    for number, line in own:
        if is_note(line):
            continue
        row = line.rstrip("\r\n").split(separator)
        if '"' in line:
            row = _cells(path, number, line, chain(own, rest), separator)
        found, wanted = len(row), len(names)
        if found != wanted:
            hint = "; decimal commas need semicolons between cells" if found > wanted and separator == "," else ""
            if found > wanted and not any(is_number(cell.strip()) for cell in row):
                hint = f"; if the names of the columns stand in line {number}, put # before the lines above it"
            raise MeasurementError(f"{path}: line {number} has {found} cells, the header has {wanted}{hint}")
        lines.append(number)
        cells.append(row)
    return _frame(cells, names, separator), np.array(lines, dtype=np.int64)


def _frame(rows: str | list[list[str]], names: list[str], separator: str) -> pl.DataFrame:
    # numbered, not named: polars would rename columns without a name
    schema = {str(k): pl.String for k in range(len(names))}
    if isinstance(rows, str):
        text = io.StringIO(rows)
        frame = pl.read_csv(text, separator=separator, schema=schema, has_header=False, quote_char=None)
    else:
        frame = pl.DataFrame(rows, schema=schema, orient="row")
    return frame.select(pl.col(str(k)).alias(name) for k, name in enumerate(names) if name)


def _not_text(path: Path) -> MeasurementError:
    """Names the line at which a file stops being UTF-8, unless it never was text."""
    with path.open("rb") as file:
        if b"\0" not in file.read(_HEAD):
            file.seek(0)
            for number, raw in enumerate(file, start=1):
                try:
                    raw.decode("utf-8")
                except UnicodeDecodeError as error:
                    byte = raw[error.start]
                    return MeasurementError(f"{path}: line {number} is not UTF-8 (byte {byte:#04x}); save it as UTF-8")
    return MeasurementError(f"{path}: {NO_TEXT}")


# -- A run as a person has it at hand: read already, a file, a frame, or columns by name ---------------------------

#: Measurements, the path of their file, a polars or pandas frame, or a mapping of columns.
RunLike = Any


def run_of(given: RunLike, columns: Columns | None = None, layouts: Sequence[c.Layout] = ()) -> Measurements:
    """The measurements; ``columns`` gives the names of a file or a frame by ours, ``layouts`` are those of its robot.

    Raises :class:`~sherkit.errors.MeasurementError` for what holds none, and as the readers do.
    """
    if isinstance(given, Measurements):
        return given
    if isinstance(given, str | os.PathLike):
        return read_run(Path(given), columns, layouts)
    if isinstance(given, Mapping) or hasattr(given, "columns"):
        return from_frame(given, columns=columns)
    raise MeasurementError(
        f"expected measurements, the path of their file, a frame or columns by name; got {type(given).__name__}"
    )
