"""Tables as files: the kind of a file is the ending of its name; how a text parts its cells and names its columns."""

from __future__ import annotations

import io
import re
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

import polars as pl

from ..errors import MeasurementError
from .files import write_whole

# -- How a text parts its cells ----------------------------------------------------------------------------------------
# How a text parts its cells and what it calls its columns: asked first by everything that reads a table of text.
#
# Cells are parted by comma, semicolon, tab or spaces; spaces become tabs here, so that nobody else has to know of
# them. A table without names has those that a person gives (``--columns a,b,c``), or those of the note right above
# its rows, as ``numpy.savetxt`` writes it.

MARKS = ",;\t"
#: What to say of a file that holds no line of a table, and of one that is no text.
NO_LINE = "is empty; expected a line of column names and rows of measurements"
NO_TEXT = "is not text; expected CSV as UTF-8, or Parquet in a file named .parquet"
#: Names of columns in the order of the file, for the files that are read now.
_GIVEN: ContextVar[tuple[str, ...]] = ContextVar("names of columns", default=())
_NUMBER = re.compile(r"[-+]?(\d[\d.,]*|[.,]\d+)([eE][-+]?\d+)?")
#: One with a decimal comma, or whole: cells that spaces part may hold commas.
_WITH_COMMA = re.compile(r"[-+]?\d+(,\d+)?([eE][-+]?\d+)?")
_SPACES = re.compile(r"\s+")
#: Between two names, not before the unit of one.
_BETWEEN = re.compile(r"\s+(?![\[(])")
_WIDE = re.compile(r"\t|\s{2,}")


def is_number(cell: str) -> bool:
    """Whether a cell is a number, with whatever marks between its digits."""
    return _NUMBER.fullmatch(cell) is not None


@contextmanager
def columns_called(names: Sequence[str]) -> Iterator[None]:
    """Tables of text that are read in here have these columns, in the order of the file; none given: their own.

    Raises :class:`~sherkit.errors.MeasurementError` for a name that is empty or given twice.
    """
    tidy = tuple(name.strip() for name in names)
    if not all(tidy) or len(set(tidy)) < len(tidy):
        raise MeasurementError(
            f"--columns: expected a name of its own for each column, as in a,b,c; got '{','.join(names)}'"
        )
    token = _GIVEN.set(tidy)
    try:
        yield
    finally:
        _GIVEN.reset(token)


def names_given() -> tuple[str, ...]:
    """The names that a person gave for the columns of what is read now; empty where none were given."""
    return _GIVEN.get()


# -- Cells parted by spaces ------------------------------------------------------------------------------------------


def by_spaces(line: str) -> bool:
    """Whether nothing but spaces can part the cells of a line."""
    parts = line.split()
    if len(parts) < 2 or '"' in line or ";" in line or "\t" in line.strip():
        return False
    return "," not in line or all(_WITH_COMMA.fullmatch(one) for one in parts)


def tabbed(line: str, cells: int = 0) -> str:
    """A line whose cells spaces part, with tabs for them; names may hold spaces where the rows have so many ``cells``:
    two spaces part them, or what is no unit in brackets begins the next."""
    text, end = line.strip(), "\n" if line.endswith("\n") else ""
    ways = [one.split(text) for one in (_SPACES, _BETWEEN, _WIDE)]
    fitting = [way for way in ways if len(way) == cells]
    return "\t".join((fitting or ways)[0]) + end


# -- Where a text begins ---------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Head:
    """The ``names`` line of a table with its number, or the names in ``called`` where it has none; the mark that parts
    its cells; and the ``lines`` below, each with its number, in which that mark parts the cells."""

    number: int
    names: str
    called: tuple[str, ...]
    separator: str
    lines: Iterator[tuple[int, str]]


def head_of(source: str, lines: Iterator[tuple[int, str]]) -> Head | None:
    """Where a table of text begins, of its numbered ``lines``; None where it holds none.

    Raises :class:`~sherkit.errors.MeasurementError` for one that has no names.
    """
    called = names_given()
    note, (number, first) = _first(lines)
    if not first:
        return None
    while called and not _is_row(first, len(called)):
        # what stands above the first row is no row, whatever it is
        number, first = next(lines, (0, ""))
        if not first:
            raise MeasurementError(f"{source}: has no row of {len(called)} cells, as many as --columns names")
    spaced = by_spaces(first)
    separator = "\t" if spaced else max(MARKS, key=first.count)
    begun = tabbed(first) if spaced else first
    cells = [cell.strip() for cell in begun.split(separator)]
    if called:
        # a word alone is the end of many a log
        rows = ((n, s) for n, s in chain([(number, first)], lines) if not s.strip().isalpha())
        return Head(number, "", called, separator, _tabs(rows, spaced))
    if not all(map(is_number, cells)):
        if not spaced:
            return Head(number, first, (), separator, lines)
        row = next(((n, s) for n, s in lines if not is_note(s)), None)
        below = lines if row is None else chain([row], lines)
        if row is None or not by_spaces(row[1]):  # a line of words above another sort of table
            return Head(number, first, (), max(MARKS, key=first.count), below)
        return Head(number, tabbed(first, len(row[1].split())), (), separator, _tabs(below, True))
    for own in (note.split(separator), tabbed(note, len(cells)).split("\t")):
        told = tuple(name.strip() for name in own)
        if len(told) == len(cells) == len({*told}) and all(told) and not any(map(is_number, told)):
            return Head(number, "", told, separator, _tabs(chain([(number, first)], lines), spaced))
    raise MeasurementError(f"{source}: {nameless(number, len(cells))}")


def nameless(number: int, cells: int) -> str:
    """What to say of a table whose ``cells`` columns have no names."""
    return (
        f"has no line of column names: line {number} is a row of {cells} cells already; --columns with {cells} names, "
        "as in a,b,c, says what they are, or a first line does"
    )


def _first(lines: Iterator[tuple[int, str]]) -> tuple[str, tuple[int, str]]:
    """The last note above the first line that is none, and that line."""
    note = ""
    for number, line in lines:
        if not is_note(line):
            return note, (number, line)
        note = line.strip().lstrip("#").strip() or note
    return note, (0, "")


def is_note(line: str) -> bool:
    """Whether a line is blank or a note."""
    return not line.strip() or line.lstrip().startswith("#")


def _is_row(line: str, cells: int) -> bool:
    """Whether a line is a row of so many cells, most of them numbers."""
    parts = line.split() if by_spaces(line) else line.strip().split(max(MARKS, key=line.count))
    return len(parts) == cells and sum(is_number(one.strip()) for one in parts) * 2 > cells


def _tabs(lines: Iterator[tuple[int, str]], spaced: bool) -> Iterator[tuple[int, str]]:
    if not spaced:
        return lines
    return ((number, line if is_note(line) else tabbed(line)) for number, line in lines)


# -- Tables ------------------------------------------------------------------------------------------------------------

PARQUET = (".parquet", ".pq")
#: The first and the last bytes of every Parquet file.
_MAGIC = b"PAR1"
#: Larger files are not read twice; their damage is said where it does not end the program.
_TRIED_BYTES = 100 * 2**20
#: What a trial may take: a damaged file can name any size.
_TRIAL_S = 120.0
_TRIAL = """
import sys
sys.path[:] = {path}
try:
    import resource
    resource.setrlimit(resource.RLIMIT_AS, (8 << 30, 8 << 30))
except (ImportError, ValueError, OSError):
    pass
import polars
try:
    polars.read_parquet({file})
except BaseException as error:
    print((str(error).splitlines() or [type(error).__name__])[0])
    sys.exit(1)
"""


def read_table(path: Path) -> pl.DataFrame:
    """Reads Parquet where the name says so, else text with notes after ``#``, its cells parted as :mod:`.head` finds
    them. Raises polars' own errors for text."""
    if path.suffix.lower() in PARQUET:
        return read_parquet(path)
    if not path.is_file():
        return pl.read_csv(path, comment_prefix="#", infer_schema_length=None)  # a pipe cannot be read twice
    with suppress(UnicodeDecodeError), path.open(encoding="utf-8-sig", newline="") as file:
        head = head_of(str(path), enumerate(file, start=1))
        if head is not None and (head.called or head.separator != ","):
            first = "" if head.called else head.names.rstrip("\r\n") + "\n"
            text = io.StringIO(first + "".join(line for _, line in head.lines))
            names = list(head.called) or None
            return pl.read_csv(
                text, separator=head.separator, has_header=not names, new_columns=names, comment_prefix="#",
                infer_schema_length=None,
            )  # fmt: skip
    return pl.read_csv(path, comment_prefix="#", infer_schema_length=None)


def read_parquet(path: Path) -> pl.DataFrame:
    """A Parquet file as it is. Raises :class:`~sherkit.errors.MeasurementError` where it is none, or damaged."""
    try_parquet(path)
    with parquet_errors(path):
        return pl.read_parquet(path)


def try_parquet(path: Path) -> None:
    """Reads a file in a process of its own: polars panics at some damaged files, and some end the whole program.

    Raises :class:`~sherkit.errors.MeasurementError`.
    """
    with path.open("rb") as file:
        head = file.read(4)
        file.seek(max(0, path.stat().st_size - 4))
        if head != _MAGIC or file.read(4) != _MAGIC:
            raise not_parquet(path, "it does not begin and end as one")
    if sys.executable and path.stat().st_size <= _TRIED_BYTES and (why := _tried(path)) is not None:
        raise not_parquet(path, why)


def _tried(path: Path) -> str | None:
    """What is wrong with a Parquet file, as a process of its own finds it; None where it can be read."""
    source = _TRIAL.format(path=ascii([p for p in sys.path if p]), file=ascii(str(path.resolve())))
    try:
        done = subprocess.run(
            [sys.executable, "-I", "-X", "utf8", "-c", source], capture_output=True, encoding="utf-8", errors="replace",
            timeout=_TRIAL_S, check=False, stdin=subprocess.DEVNULL,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return f"reading it takes more than {_TRIAL_S:g} s"
    return done.stdout.strip() or "it is damaged" if done.returncode else None


@contextmanager
def parquet_errors(path: Path) -> Iterator[None]:
    """Whatever polars says of a Parquet file as a sentence."""
    try:
        yield
    except (pl.exceptions.PolarsError, pl.exceptions.PanicException, OSError) as error:
        raise not_parquet(path, str(error)) from None


def not_parquet(path: Path, why: str) -> MeasurementError:
    """What to say of a file that is called Parquet and is none."""
    return MeasurementError(f"{path}: is not a Parquet file: {why.splitlines()[0] if why else 'it is damaged'}")


def write_table(frame: pl.DataFrame, path: str | Path) -> None:
    """Writes Parquet where the name says so, else CSV. Raises :class:`~sherkit.errors.NotWritten`."""
    held = io.BytesIO()
    if Path(path).suffix.lower() in PARQUET:
        frame.write_parquet(held)
    else:
        frame.write_csv(held)
    write_whole(path, held.getvalue())
