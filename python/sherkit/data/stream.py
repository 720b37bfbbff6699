"""Measurements too large for memory: passed over in blocks, as often as the fit asks."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import polars as pl

from ..arguments import Count, as_annotated
from .frames import clean
from .reader import checked, csv_blocks
from .rows import Measurements
from .tables import PARQUET, parquet_errors, try_parquet

BLOCK_ROWS = 100_000


@dataclass(frozen=True)
class MeasurementStream:
    """A run that is read block by block. ``blocks()`` starts a new pass each time it is called."""

    blocks: Callable[[], Iterator[Measurements]]
    source: str


@as_annotated
def stream_measurements(path: str | Path, block_rows: Count = BLOCK_ROWS) -> MeasurementStream:
    """Streams a CSV or Parquet file of any length through the fit in constant memory.

    Reads what :func:`~sherkit.data.read_measurements` reads and names the same places in messages, but
    checks each block by itself: a pose and repeat given twice far apart go unnoticed, and directions of motion
    are not known, since a block does not see the row before it. Raises
    :class:`~sherkit.errors.MeasurementError`, most of it once the blocks are read.
    """
    path = checked(path)
    return MeasurementStream(partial(_blocks, path, block_rows), str(path))


def _blocks(path: Path, block_rows: int) -> Iterator[Measurements]:
    if path.suffix.lower() not in PARQUET:
        for frame, line in csv_blocks(path, block_rows):
            yield _undirected(clean(frame, str(path), line, "line"))
        return
    first = 0
    try_parquet(path)
    with parquet_errors(path):
        for frame in pl.scan_parquet(path).collect_batches(chunk_size=block_rows, maintain_order=True):
            yield _undirected(clean(frame, str(path), np.arange(first, first + frame.height), "row"))
            first += frame.height


def _undirected(block: Measurements) -> Measurements:
    return replace(block, direction=np.full_like(block.direction, np.nan))
