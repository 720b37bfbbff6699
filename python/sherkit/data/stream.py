"""Measurements too large for memory: passed over in blocks, as often as the fit asks."""

from __future__ import annotations

import pickle
import tempfile
import weakref
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import IO, Any

import numpy as np
import polars as pl

from ..base.arguments import Count, as_annotated
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

    The file is parsed once; what was parsed waits in a temporary file for the passes that follow, some 250 bytes a row.
    Reads what :func:`~sherkit.data.read_measurements` reads and names the same places in messages, but
    checks each block by itself: a pose and repeat given twice far apart go unnoticed, and directions of motion
    are not known, since a block does not see the row before it. Raises
    :class:`~sherkit.errors.MeasurementError`, most of it once the blocks are read.
    """
    path = checked(path)
    return MeasurementStream(_Spooled(partial(_blocks, path, block_rows)), str(path))


class _Spooled:
    """Blocks that are parsed once: the first pass writes them to a temporary file, from which later ones read.

    A fit passes over a run several times, and parsing takes far longer than everything else. Without room for the file
    every pass parses.
    """

    def __init__(self, parse: Callable[[], Iterator[Measurements]]) -> None:
        self._parse = parse
        self._file: IO[bytes] | None = None
        #: Where each block begins, once all are written.
        self._places: list[int] | None = None

    def __call__(self) -> Iterator[Measurements]:
        return self._first() if self._places is None or self._file is None else self._again(self._file, self._places)

    def __getstate__(self) -> dict[str, Any]:
        """What parses: a copy has a file of its own."""
        return vars(self) | {"_file": None, "_places": None}

    def _first(self) -> Iterator[Measurements]:
        file, places = tempfile.TemporaryFile(), list[int]()  # noqa: SIM115 (open as long as the stream is)
        close = weakref.finalize(self, file.close)
        whole = False
        try:
            room = True
            for block in self._parse():
                if room:
                    try:
                        places.append(file.tell())
                        pickle.dump(block, file, protocol=pickle.HIGHEST_PROTOCOL)
                    except OSError:
                        room = False
                yield block
            whole = room
        finally:
            if whole:
                self._file, self._places = file, places
            else:
                close()

    @staticmethod
    def _again(file: IO[bytes], places: list[int]) -> Iterator[Measurements]:
        for place in places:
            file.seek(place)
            block: Measurements = pickle.load(file)
            yield block


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
