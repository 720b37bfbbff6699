"""CSV as programs write it: every line a row, every cell a number or a word. Polars reads it at once."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import polars as pl

from ..base.types import Ints

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
    separator = max(",;\t", key=names.count)
    columns = [name.strip() for name in names.split(separator)]
    cells = first.split(separator)
    if any(mark in names for mark in '"#\r\0') or not all(columns) or not len({*columns}) == len(columns) == len(cells):
        return None
    schema = {name: pl.Float64 if _is_number(cell) else pl.String for name, cell in zip(columns, cells, strict=True)}
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


def _is_number(cell: str) -> bool:
    """Whether a column that begins so holds numbers; an empty cell may be a reading that was not taken."""
    try:
        float(cell.strip() or "0")
    except ValueError:
        return False
    return True
