"""Decimal commas, in files whose cells are not parted by commas: read where the file proves them, never guessed."""

from __future__ import annotations

from pathlib import Path
from typing import NoReturn

import polars as pl

from ..base.names import brief
from ..base.types import Ints
from ..errors import MeasurementError

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
