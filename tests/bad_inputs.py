"""Bad measurement files, one thing wrong in each, and the table in the documents of what sherkit says to them.

``python tests/bad_inputs.py --write`` runs each and rewrites the table between the two markers in docs/files.md.
"""

from __future__ import annotations

import contextlib
import os
import sys
import tempfile
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from sherkit import SherkitError, SherkitWarning, read_measurements

PAGE = Path(__file__).parent.parent / "docs" / "files.md"
START, END = "<!-- bad-inputs -->", "<!-- /bad-inputs -->"
NAME = "readings.csv"

#: Line 1 is a note, line 2 the header, lines 3 to 6 the rows.
GOOD = """\
# probed on Monday
pose,repeat,q1_mm,q2_mm,q3_mm,x_mm,y_mm,z_mm
1,1,128.923,128.923,128.923,0.012,-0.021,0.004
1,2,128.923,128.923,128.923,0.013,-0.019,0.006
2,1,141.655,130.071,126.512,-1.957,8.034,4.991
3,1,118.402,125.873,133.960,7.021,-8.984,-2.036
"""
_DISTANCES = """\
q1_mm,q2_mm,q3_mm,to_q1_mm,to_q2_mm,to_q3_mm,x_mm,distance_mm
128.923,128.923,128.923,,,,0.012,
128.923,128.923,128.923,141.655,130.071,126.512,,9.652
"""


@dataclass(frozen=True)
class Bad:
    """A file with one thing wrong; ``says`` are the parts that its message must have.

    ``content`` is None for a file that is not there, empty for a folder where ``folder`` is set.
    """

    wrong: str
    says: tuple[str, ...]
    content: str | bytes | None
    folder: bool = False
    warns: bool = False
    #: It names all rows concerned, of which a block of a stream holds some.
    names_all: bool = False

    def write(self, folder: Path) -> Path:
        """Makes the file in ``folder``; returns its path."""
        path = folder / NAME
        if self.folder:
            path.mkdir()
        elif self.content is not None:
            path.write_bytes(self.content.encode() if isinstance(self.content, str) else self.content)
        return path

    def message(self, path: Path) -> str:
        """What sherkit says to the file; empty where it says nothing."""
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error", SherkitWarning)
                read_measurements(path)
        except (SherkitError, SherkitWarning) as said:
            if self.warns == isinstance(said, SherkitWarning):
                return str(said)
        return ""


def _line(number: int, row: str) -> str:
    """The good file with another row on a line, or none."""
    lines = GOOD.splitlines()
    lines[number - 1 : number] = [row] if row else []
    return "\n".join(lines) + "\n"


def _cell(number: int, column: str, text: str) -> str:
    """The good file with another cell on a line."""
    lines = GOOD.splitlines()
    cells = lines[number - 1].split(",")
    cells[lines[1].split(",").index(column)] = text
    return _line(number, ",".join(cells))


def _scaled(columns: str, factor: float) -> str:
    """The good file with columns in another unit, their names unchanged."""
    lines = GOOD.splitlines()
    names = lines[1].split(",")
    for k, line in enumerate(lines[2:], start=2):
        cells = [f"{float(v) * factor:.7g}" if n in columns else v for n, v in zip(names, line.split(","), strict=True)]
        lines[k] = ",".join(cells)
    return "\n".join(lines) + "\n"


def _sigma(text: str) -> str:
    lines = GOOD.splitlines()
    lines[1:] = [lines[1] + ",sigma_x_mm", *(f"{s},0.005" for s in lines[2:])]
    lines[4] = lines[4].removesuffix("0.005") + text
    return "\n".join(lines) + "\n"


def _poses() -> str:
    """The good file with one pose number, and repeats of it."""
    lines = GOOD.splitlines()
    lines[2:] = [",".join(["1", str(k), *row.split(",")[2:]]) for k, row in enumerate(lines[2:], start=1)]
    return "\n".join(lines) + "\n"


def _times_of_day() -> str:
    """The good file with times in its last column, one of them by the clock."""
    note, names, *rows = GOOD.splitlines()
    times = ["0", "20", "09:00:40", *(str(20 * k) for k in range(3, len(rows)))]
    return "\n".join([note, f"{names},time_s", *(f"{row},{t}" for row, t in zip(rows, times, strict=True))]) + "\n"


BAD = (
    Bad("a reading in micrometres", ("'x_um'", "millimetres", "'x_mm'"), GOOD.replace("x_mm", "x_um")),
    Bad("a unit in the header", ("'x [um]'", 'columns = { x_mm = "x [um]" }'), GOOD.replace("x_mm", "x [um]")),
    Bad("a joint in metres", ("'q1_mm' is missing", "'q1_m'", "millimetres"), GOOD.replace("q1_mm", "q1_m")),
    Bad("a misspelt column", ("'q2_mm' is missing", "'q2mm' meant"), GOOD.replace("q2_mm", "q2mm")),
    Bad(
        "no reading column",
        ("'x_mm' is missing", "y_mm, z_mm or distance_mm", "the file has pose"),
        GOOD.replace("x_mm,y_mm,z_mm", "left,right,up"),
    ),
    Bad(
        "a misspelt optional column",
        ("'poses'", "covariate", "meant to be 'pose'"),
        GOOD.replace("pose,", "poses,"),
        warns=True,
    ),
    Bad("a column twice", ("column 'x_mm' appears more than once",), GOOD.replace("y_mm", "x_mm")),
    Bad("text in a number", ("line 5, column 'x_mm'", "'1.9s7' is not a number"), _cell(5, "x_mm", "1.9s7")),
    Bad("NaN", ("line 5, column 'y_mm'", "nan is not a measurement", "leave the cell empty"), _cell(5, "y_mm", "NaN")),
    Bad("infinity", ("line 6, column 'q3_mm'", "inf is not a measurement"), _cell(6, "q3_mm", "inf")),
    Bad("an empty joint", ("line 4, column 'q2_mm'", "is empty"), _cell(4, "q2_mm", "")),
    Bad("no reading in a row", ("line 4", "no reading was taken"), _line(4, "1,2,128.923,128.923,128.923,,,")),
    Bad("a pose number that is none", ("line 5, column 'pose'", "2.5 is not a whole number"), _cell(5, "pose", "2.5")),
    Bad("a pose and repeat twice", ("line 4", "pose 1 repeat 1", "line 3"), _cell(4, "repeat", "1")),
    Bad(
        "one pose number for all rows", ("pose 1 stands at places", "mm apart", "as repeats"), _poses(), names_all=True,
    ),
    Bad(
        "a thousand, or a one?",
        ("line 5, column 'x_mm': '1,957'", "decimal mark of this file is the point"),
        _cell(5, "x_mm", "@").replace(",", ";").replace("@", "1,957"),
    ),
    Bad("negative noise", ("line 5, column 'sigma_x_mm'", "-0.005", "greater than zero"), _sigma("-0.005")),
    Bad("half a distance", ("line 3", "all of to_q1_mm, to_q2_mm, to_q3_mm"), _DISTANCES.replace("130.071", "")),
    Bad(
        "a position and a distance in one row",
        ("line 3", "a position or a distance, not both"),
        _DISTANCES.replace(",,9.652", ",0.012,9.652"),
    ),
    Bad(
        "a row too short", ("line 4 has 7 cells", "header has 8"), _line(4, "1,2,128.923,128.923,128.923,0.013,-0.019")
    ),
    Bad(
        "lines above the names",
        ("line 3 has 8 cells", "names of the columns stand in line 3", "put #"),
        "Tracker 4711\n" + GOOD,
    ),
    Bad("times of day", ("line 5, column 'time_s': '09:00:40'", "expected seconds"), _times_of_day()),
    Bad(
        "decimal commas between commas",
        ("line 3 has 14 cells", "header has 8", "semicolons"),
        GOOD.replace(".", ","),
    ),
    Bad(
        "a quotation mark that is not closed",
        ("line 5 is not CSV", "quotation mark is not closed"),
        _line(5, '2,1,141.655,130.071,126.512,-1.957,8.034,"4.991'),
    ),
    Bad(
        "readings in metres under a name in mm",
        ("x_mm, y_mm, z_mm vary", "metres", "Expected millimetres"),
        _scaled("x_mm,y_mm,z_mm", 1e-3),
        warns=True,
    ),
    Bad(
        "joints in metres under a name in mm",
        ("q1_mm, q2_mm, q3_mm vary", "metres", "Expected millimetres"),
        _scaled("q1_mm,q2_mm,q3_mm", 1e-3),
        warns=True,
    ),
    Bad("only a header", ("holds no row", "expected measurements"), "".join(GOOD.splitlines(True)[:2])),
    Bad("an empty file", ("is empty", "column names"), ""),
    Bad(
        "letters of an old encoding", ("line 1 is not UTF-8", "0xfc"), GOOD.replace("probed", "früh").encode("latin-1")
    ),
    Bad("a picture, not a table", ("is not text", "CSV", ".parquet"), b"\x89PNG\r\n\x1a\n\x00\x00\x00\rIHDR\x00\x00"),
    Bad("a folder", ("is a folder", "CSV or Parquet"), "", folder=True),
    Bad("a file that is not there", ("there is no such file",), None),
)  # fmt: skip


@contextlib.contextmanager
def workplace() -> Iterator[Path]:
    """A folder of its own to run in, so that messages hold short names."""
    here = Path.cwd()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        try:
            yield Path()
        finally:
            os.chdir(here)


def table() -> str:
    """The Markdown table, each message from running sherkit on the file."""
    rows = ["| what is wrong | what sherkit says |", "| --- | --- |"]
    for bad in BAD:
        with workplace() as folder:
            message = bad.message(bad.write(folder))
        kind = "warning: " if bad.warns else ""
        rows.append(f"| {bad.wrong} | {kind}{message} |".replace("||", "| |"))
    return "\n".join(rows)


def between_markers(text: str) -> tuple[str, str, str] | None:
    """A text before, between and after the markers, markers left with the outer parts; None without them."""
    before, start, rest = text.partition(START)
    block, end, after = rest.partition(END)
    return (before + start, block, end + after) if start and end else None


def main(arguments: list[str]) -> str:
    """Prints the table, or writes it into the page; returns what went wrong, if anything did."""
    if arguments not in ([], ["--write"]):
        return "usage: python tests/bad_inputs.py [--write]"
    if not arguments:
        print(table())
        return ""
    parts = between_markers(PAGE.read_text(encoding="utf-8"))
    if parts is None:
        return f"{PAGE} has no {START} … {END}"
    PAGE.write_text(f"{parts[0]}\n{table()}\n{parts[2]}", encoding="utf-8")
    return ""


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]) or None)
