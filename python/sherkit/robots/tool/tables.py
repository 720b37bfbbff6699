"""Columns of the tool's tables as numbers."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import polars as pl

from ...base.names import closest, listed
from ...base.types import Floats
from ...data.reader import checked
from ...data.tables import read_table
from ...errors import MeasurementError


def table_at(path: Path) -> pl.DataFrame:
    """Rows of a file. Raises :class:`~sherkit.errors.MeasurementError`."""
    try:
        return read_table(checked(path))
    except pl.exceptions.PolarsError as error:
        raise MeasurementError(f"{path}: is not a table: {str(error).splitlines()[0]}") from None


def numbers_of(frame: pl.DataFrame, needed: Iterable[str], known: Iterable[str], source: str) -> dict[str, Floats]:
    """Columns (n,) of a frame by name, NaN where a cell is empty: all that are ``needed``, and those ``known`` that it
    has. Raises :class:`~sherkit.errors.MeasurementError` naming column and row, counted from 1."""
    known = tuple(known)
    for name in needed:
        if name not in frame.columns:
            near = closest(name, [c for c in frame.columns if c not in known])
            hint = f"; is '{near}' meant to be it?" if near else f"; it has {listed(frame.columns, 24)}"
            raise MeasurementError(f"{source}: column '{name}' is missing{hint}")
    columns: dict[str, Floats] = {}
    for name in (c for c in known if c in frame.columns):
        column = frame[name]
        try:
            columns[name] = column.cast(pl.Float64).to_numpy().astype(float)
        except pl.exceptions.PolarsError:
            bad = column.cast(pl.String).cast(pl.Float64, strict=False).is_null() & column.is_not_null()
            row = int(bad.arg_max() or 0)
            raise MeasurementError(
                f"{source}: row {row + 1}, column '{name}': '{column[row]}' is not a number"
            ) from None
    return columns
