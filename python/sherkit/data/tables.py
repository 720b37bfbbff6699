"""Tables as files: the kind of a file is the ending of its name."""

from __future__ import annotations

from pathlib import Path

import polars as pl

PARQUET = (".parquet", ".pq")


def read_table(path: Path) -> pl.DataFrame:
    """Reads Parquet where the name says so, else CSV with notes after ``#``. Raises polars' own errors."""
    if path.suffix.lower() in PARQUET:
        return pl.read_parquet(path)
    return pl.read_csv(path, comment_prefix="#", infer_schema_length=None)


def write_table(frame: pl.DataFrame, path: str | Path) -> None:
    """Writes Parquet where the name says so, else CSV."""
    path = Path(path)
    if path.suffix.lower() in PARQUET:
        frame.write_parquet(path)
    else:
        frame.write_csv(path)
