"""Measurement files: CSV and Parquet."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterator
from contextlib import suppress
from itertools import chain, islice
from pathlib import Path

import numpy as np
import polars as pl

from ..base.arguments import as_annotated
from ..base.types import Ints
from ..errors import MeasurementError
from . import columns as c
from .decimals import DecimalMark
from .frames import clean
from .headers import Columns
from .plain import read_plain
from .rows import Measurements
from .tables import PARQUET, read_parquet

#: A file with a zero byte among this many is no text.
_HEAD = 4096
#: How the files of `sherkit measure` begin (SQLite).
_RUN_FILE = b"SQLite format 3"


@as_annotated
def read_measurements(path: str | Path, *, columns: Columns | None = None) -> Measurements:
    """Reads a run. CSV may use comma, semicolon or tab (the last two with decimal comma); lines starting with
    ``#`` are notes, columns without a name are left out.

    ``columns`` gives the names of the file by ours, ``{"q1_mm": "Enc1 [um]"}``; where a header states a unit, in
    brackets or at its end, what it holds is converted, and that is said in a :class:`~sherkit.errors.SherkitWarning`.

    Raises :class:`~sherkit.errors.MeasurementError` naming file, line, column and what was expected.

        run = sk.read_measurements("demo/whole.csv")
        print(len(run), run.layout.readings)
    """
    path = checked(path)
    if path.suffix.lower() in PARQUET:
        return clean(read_parquet(path), str(path), None, "row", columns)
    frame, line = read_plain(path) or next(csv_blocks(path))
    return clean(frame, str(path), line, "line", columns)


def checked(path: str | Path) -> Path:
    """The path of a file that exists. Raises :class:`~sherkit.errors.MeasurementError`."""
    path = Path(path)
    if path.is_dir():
        bag = (
            "; it looks like a ROS 2 bag, which sk.from_rosbag and sherkit import rosbag read"
            if any(path.glob("*.db3")) or any(path.glob("*.mcap"))
            else ""
        )
        raise MeasurementError(f"{path}: is a folder, expected a CSV or Parquet file{bag}")
    if not path.exists():
        raise MeasurementError(f"{path}: there is no such file")
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
            lines = enumerate(file, start=1)
            number, header = next(_data(lines), (0, ""))
            if not header:
                raise MeasurementError(f"{path}: is empty; expected a line of column names and rows of measurements")
            if "\0" in header:
                raise _not_text(path)
            separator = max(",;\t", key=header.count)
            names = [name.strip() for name in _cells(path, number, header, lines, separator)]
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


def _data(lines: Iterator[tuple[int, str]]) -> Iterator[tuple[int, str]]:
    """Lines that are neither blank nor notes."""
    return ((n, s) for n, s in lines if s.strip() and not s.lstrip().startswith("#"))


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
    for number, line in _data(own):
        row = line.rstrip("\r\n").split(separator)
        if '"' in line:
            row = _cells(path, number, line, chain(own, rest), separator)
        found, wanted = len(row), len(names)
        if found != wanted:
            hint = "; decimal commas need semicolons between cells" if found > wanted and separator == "," else ""
            if found > wanted and not any(map(_is_number, row)):
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


def _is_number(cell: str) -> bool:
    return bool(re.fullmatch(r"\s*[-+]?[\d.,]*\d[\d.,eE+-]*\s*", cell))


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
    return MeasurementError(f"{path}: is not text; expected CSV as UTF-8, or Parquet in a file named .parquet")
