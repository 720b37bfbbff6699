"""Measurements from any table in memory: polars, pandas, or a mapping of columns."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import polars as pl

from ..errors import MeasurementError
from . import columns as c
from .rows import Measurements


def from_frame(frame: Any, source: str = "frame") -> Measurements:
    """Measurements from a polars or pandas frame or a mapping of columns to sequences.

    Null (polars) and NaN (pandas, NumPy) mean "not taken" in reading columns and are refused elsewhere.
    Raises :class:`~sherkit.errors.MeasurementError` naming row (from 0) and column.
    """
    return clean(to_polars(frame), source, None)


def to_polars(frame: Any) -> pl.DataFrame:
    """Any of the accepted tables as a polars frame; raises :class:`MeasurementError` for anything else."""
    if isinstance(frame, pl.DataFrame):
        return frame
    if isinstance(frame, pl.LazyFrame):
        return frame.collect()
    if isinstance(frame, Mapping) or hasattr(frame, "columns"):
        columns = {str(name): np.asarray(frame[name]) for name in getattr(frame, "columns", frame)}
        lengths = {name: len(v) for name, v in columns.items()}
        if len(set(lengths.values())) > 1:
            raise MeasurementError(f"frame: columns have different lengths: {lengths}")
        return pl.DataFrame(
            {k: v.astype(str) if v.dtype.kind == "O" and _is_text(v) else v for k, v in columns.items()},
            strict=False,
        )
    raise MeasurementError(f"expected a polars or pandas frame or a mapping of columns, got {type(frame).__name__}")


def _is_text(values: Any) -> bool:
    return any(isinstance(v, str) for v in values)


def clean(frame: pl.DataFrame, source: str, line: Any) -> Measurements:
    """Checks cell by cell that a frame holds numbers where numbers belong, and builds the rows.

    ``line`` (n,) gives the place of each row for messages; None counts from 0.
    """
    frame = frame.rename({name: name.strip() for name in frame.columns})
    c.check_columns(frame.columns, source)
    if frame.height == 0:
        raise MeasurementError(f"{source}: holds no row, only column names; expected measurements")
    counted = "row" if line is None else "line"
    line = np.arange(frame.height) if line is None else line
    place = f"{source}: {counted}"
    columns: dict[str, Any] = {}
    for name in frame.columns:
        column = frame[name]
        number = _numbers(column, name, place, line)
        columns[name] = column.fill_null("").cast(pl.String).to_numpy() if number is None else number
    return Measurements.from_columns(columns, source, np.asarray(line, dtype=np.int64), counted)


def _numbers(column: pl.Series, name: str, place: str, line: Any) -> Any:
    """The column as floats, None where it is a label; raises at the first cell that is no number."""
    known = name in c.KNOWN
    text = column.dtype == pl.String
    raw = column.str.strip_chars() if text else column
    if text:
        raw = raw.set(raw == "", None)
    try:
        number = raw.cast(pl.Float64, strict=False)
    except pl.exceptions.PolarsError:
        number = pl.Series(name, [None] * len(raw), dtype=pl.Float64)
    bad = (number.is_null() & raw.is_not_null()).to_numpy()
    if bad.any():
        if not known and bad.mean() > 0.5:
            return None
        _refuse(place, line, bad, name, f"'{raw[int(np.argmax(bad))]}' is not a number")
    values = number.to_numpy().astype(float)
    missing = number.is_null().to_numpy()
    # NaN is how pandas and NumPy say "nothing"; in a file it is a number that went wrong
    broken = ~np.isfinite(values) & ~missing if text or not known else np.isinf(values)
    if broken.any():
        row = int(np.argmax(broken))
        _refuse(place, line, broken, name, f"{values[row]} is not a measurement; leave the cell empty")
    empty = np.isnan(values)
    if empty.all() and not known:
        return None
    if empty.any() and name not in c.MAY_BE_EMPTY:
        what = "a reading column may be empty, this one not" if known else "expected a number in every row"
        _refuse(place, line, empty, name, f"is empty; {what}")
    if name in (c.POSE, c.REPEAT):
        fraction = values != np.floor(values)
        if fraction.any():
            _refuse(place, line, fraction, name, f"{values[int(np.argmax(fraction))]} is not a whole number")
    if name in c.SIGMAS:
        low = values <= 0
        if low.any():
            _refuse(place, line, low, name, f"{values[int(np.argmax(low))]} must be greater than zero")
    return values


def _refuse(place: str, line: Any, bad: Any, name: str, what: str) -> None:
    rows = np.flatnonzero(bad)
    more = f" (and {len(rows) - 1} more rows)" if len(rows) > 1 else ""
    raise MeasurementError(f"{place} {line[rows[0]]}, column '{name}': {what}{more}")
