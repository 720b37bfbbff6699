"""Columns of the tool's tables as numbers, under our names and in our units; and what to do where one is missing."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable
from pathlib import Path
from types import MappingProxyType

import numpy as np
import polars as pl

from ...base.figures import closest, listed
from ...base.types import Floats
from ...data.called import Columns, factor, header_unit, renamed
from ...data.reader import DecimalMark, checked
from ...data.tables import read_table
from ...errors import MeasurementError
from .tool import TURN

#: Of a file whose columns have our names.
NO_NAMES: Columns = MappingProxyType({})
_QUATERNION = re.compile(r"(.*_)?q[_.]?[wxyz0-3]")


def table_at(path: Path, columns: Columns = NO_NAMES) -> pl.DataFrame:
    """Rows of a file, with those ``columns`` that it has under our names and in our units: runs and benches have some
    of them each. Raises :class:`~sherkit.errors.MeasurementError`."""
    try:
        frame = read_table(checked(path))
    except pl.exceptions.PolarsError as error:
        raise MeasurementError(f"{path}: is not a table: {str(error).splitlines()[0]}") from None
    frame = _with_points(frame, path)
    own = {ours: theirs for ours, theirs in columns.items() if theirs in frame.columns}
    frame, factors = renamed(frame, own, str(path))
    # what is no number is said by whoever needs it
    return frame.with_columns(
        pl.col(name).cast(pl.Float64) * by for name, by in factors.items() if frame[name].dtype.is_numeric()
    )


def _with_points(frame: pl.DataFrame, path: Path) -> pl.DataFrame:
    """The frame with numbers where cells have decimal commas throughout. Raises as :class:`DecimalMark`."""
    words = frame.select(pl.col(pl.String).fill_null(""))
    if not words.width or frame.select(pl.col(pl.Float64)).width:
        return frame
    mended = DecimalMark(path).with_points(words, np.arange(len(words)) + 2)
    numbers = [one.str.strip_chars().cast(pl.Float64, strict=False) for one in mended]
    return frame.with_columns(
        number for number, cells in zip(numbers, mended, strict=True)
        if not (number.is_null() & (cells.str.strip_chars() != "")).any()
    )  # fmt: skip


def numbers_of(frame: pl.DataFrame, needed: Iterable[str], known: Iterable[str], source: str) -> dict[str, Floats]:
    """Columns (n,) of a frame by name, NaN where a cell is empty: all that are ``needed``, and those ``known`` that it
    has. Raises :class:`~sherkit.errors.MeasurementError` naming column and row, counted from 1."""
    known = tuple(known)
    for name in needed:
        if name not in frame.columns:
            hint = instead(name, frame.columns, known) or f"; it has {listed(frame.columns, 24)}"
            raise MeasurementError(f"{source}: column '{name}' is missing{hint}")
    columns: dict[str, Floats] = {}
    for name in (c for c in known if c in frame.columns):
        column = frame[name]
        try:
            columns[name] = column.cast(pl.Float64).to_numpy().astype(float)
        except pl.exceptions.PolarsError:
            row = int(no_numbers(column).arg_max() or 0)
            raise MeasurementError(
                f"{source}: row {row + 1}, column '{name}': '{column[row]}' is not a number"
            ) from None
    return columns


def no_numbers(column: pl.Series) -> pl.Series:
    """Cells (n,) that hold something, and no number."""
    return column.cast(pl.String).cast(pl.Float64, strict=False).is_null() & column.is_not_null()


def instead(name: str, there: Collection[str], known: Collection[str]) -> str:
    """What of the columns that are ``there`` may stand for a missing one, and how it becomes that; empty for none."""
    spare, (stem, wanted) = [one for one in there if one not in known], header_unit(name)
    if name in TURN and (four := [one for one in spare if _QUATERNION.fullmatch(one.lower())]):
        return (
            f"; the file has {listed(four)}: convert quaternions to rotation vectors, tool to base (scipy's Rotation."
            "from_quat, which takes x, y, z, w, and as_rotvec)"
        )
    units = {one: header_unit(one)[1] for one in spare}
    fitting = [one for one in spare if not units[one] or factor(units[one], wanted) is not None]
    same = [one for one in fitting if header_unit(one)[0].lower() == stem]
    lower = {one.lower(): one for one in fitting}
    near = same[0] if same else lower.get(closest(name, lower) or "")
    if not near:
        return ""
    if not units[near] or factor(units[near], wanted) == 1.0:
        return f"; is '{near}' meant to be it? Then [columns] of the tool file says so: {name} = \"{near}\""
    return f"; the file has '{near}': convert it to {wanted}, or let [columns] of the tool file: {name} = \"{near}\""
