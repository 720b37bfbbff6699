"""Measurements too large for memory: passed over in blocks, as often as the fit asks."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import polars as pl

from ..errors import MeasurementError
from .frames import clean
from .reader import PARQUET
from .rows import Measurements

BLOCK_ROWS = 100_000


@dataclass(frozen=True)
class MeasurementStream:
    """A run that is read block by block. ``blocks()`` starts a new pass each time it is called."""

    blocks: Callable[[], Iterator[Measurements]]
    source: str


def stream_measurements(path: str | Path, block_rows: int = BLOCK_ROWS) -> MeasurementStream:
    """Streams a CSV (comma-separated) or Parquet file of any length through the fit in constant memory.

    Each block is checked like a file of its own; lines in messages count data rows from 0. Raises
    :class:`~sherkit.errors.MeasurementError`.
    """
    path = Path(path)
    if not path.exists():
        raise MeasurementError(f"{path}: there is no such file")

    def blocks() -> Iterator[Measurements]:
        if path.suffix.lower() in PARQUET:
            scan = pl.scan_parquet(path)
        else:
            scan = pl.scan_csv(path, infer_schema=False)
        first = 0
        for frame in scan.collect_batches(chunk_size=block_rows, maintain_order=True):
            yield clean(frame, str(path), range(first, first + frame.height))
            first += frame.height

    return MeasurementStream(blocks, str(path))
