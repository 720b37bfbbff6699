"""Measurement files: CSV and Parquet."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import numpy as np
import polars as pl

from ..errors import MeasurementError
from .frames import clean
from .rows import Measurements

PARQUET = (".parquet", ".pq")


def read_measurements(path: str | Path) -> Measurements:
    """Reads a run. CSV may use comma, semicolon (with decimal comma) or tab; lines starting with ``#`` are notes.

    Raises :class:`~sherkit.errors.MeasurementError` naming file, line, column and what was expected.
    """
    path = Path(path)
    if not path.exists():
        raise MeasurementError(f"{path}: there is no such file")
    if path.is_dir():
        raise MeasurementError(f"{path}: is a folder, expected a CSV or Parquet file")
    if path.suffix.lower() in PARQUET:
        try:
            frame = pl.read_parquet(path)
        except pl.exceptions.PolarsError as error:
            raise MeasurementError(f"{path}: is not a Parquet file: {error}") from None
        return clean(frame, str(path), None)
    frame, line = read_csv(path)
    return clean(frame, str(path), line)


def read_csv(path: Path) -> tuple[pl.DataFrame, np.ndarray]:
    """The cells of a CSV as text, and the line of each row in the file."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise MeasurementError(f"{path}: byte {error.start} is not UTF-8 text; expected a CSV file") from None
    lines = text.splitlines()
    kept = [(n, s) for n, s in enumerate(lines, start=1) if s.strip() and not s.lstrip().startswith("#")]
    if not kept:
        raise MeasurementError(f"{path}: is empty; expected a line of column names and rows of measurements")
    header = kept[0][1]
    separator = max(",;\t", key=header.count)
    width = len(next(csv.reader([header], delimiter=separator)))
    if len(kept) == 1:
        numbers = np.zeros(0, dtype=np.int64)
        names = next(csv.reader([header], delimiter=separator))
        return pl.DataFrame({n: pl.Series([], dtype=pl.String) for n in names}), numbers
    _check_widths(path, kept, separator, width)
    try:
        frame = pl.read_csv(
            io.StringIO("\n".join(s for _, s in kept)),
            separator=separator,
            infer_schema=False,
        )
    except pl.exceptions.PolarsError as error:
        raise MeasurementError(f"{path}: cannot be read as CSV: {str(error).splitlines()[0]}") from None
    if separator == ";":
        frame = frame.with_columns(pl.all().str.replace(",", ".", literal=True))
    return frame, np.array([n for n, _ in kept[1:]], dtype=np.int64)


def _check_widths(path: Path, kept: list[tuple[int, str]], separator: str, width: int) -> None:
    for number, line in kept[1:]:
        if line.count(separator) + 1 != width and '"' not in line:
            found = line.count(separator) + 1
            raise MeasurementError(f"{path}: line {number} has {found} cells, the header has {width}")
