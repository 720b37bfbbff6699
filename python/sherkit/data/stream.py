"""Measurements too large for memory, passed over in blocks as often as the fit asks; and two runs joined to one."""

from __future__ import annotations

import pickle
import tempfile
import warnings
import weakref
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import IO, Any

import numpy as np
import polars as pl

from ..base.arguments import Count, validate_arguments
from ..base.figures import listed
from ..base.types import Ints
from ..errors import MeasurementError, SherkitWarning
from .columns import OUTLIER, POSE, REPEAT, Layout
from .frames import clean, from_frame
from .reader import checked, csv_blocks
from .rows import Measurements
from .tables import PARQUET, parquet_errors, try_parquet

BLOCK_ROWS = 100_000


@dataclass(frozen=True)
class MeasurementStream:
    """A run that is read block by block. ``blocks()`` starts a new pass each time it is called."""

    blocks: Callable[[], Iterator[Measurements]]
    source: str


@validate_arguments
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


# -- Two runs of one machine as one --------------------------------------------------------------------------------


def joined(first: Measurements, second: Measurements) -> Measurements:
    """Both runs as one, the second after the first. Poses of the second get numbers of their own.

    A second run whose clock began anew is taken to have been measured later: its time goes on where the first ends, as
    if no time lay between. Warns of that, and of columns that are left out because only one run has them. Raises
    :class:`~sherkit.errors.MeasurementError` where such a run is one that the first has already.
    """
    if first.time_s is not None and second.time_s is not None and second.time_s.min() <= first.time_s.max():
        if _within(first, second):
            raise MeasurementError(f"{second.source}: its {len(second)} rows are in {first.source} already")
        begins, ended = float(second.time_s.min()), float(first.time_s.max())
        pause = float(np.median(np.diff(np.sort(first.time_s)))) if len(first) > 1 else 1.0
        goes_on = ended + max(pause, 1e-3)
        second = replace(second, time_s=second.time_s - begins + goes_on)
        warnings.warn(
            f"{second.source}: its time starts at {begins:g} s, before {first.source} ends ({ended:g} s), so it is "
            f"taken to have been measured later and goes on at {goes_on:g} s; how long the pause "
            "really was is not known, and drift over it is not either",
            SherkitWarning,
            stacklevel=4,
        )
    a, b = first.to_frame(), second.to_frame()
    if first.pose is not None or second.pose is None:
        # poses of the second run are others, whatever their numbers: between two runs more may have changed
        before, after = _numbered(first), _numbered(second)
        a = a.with_columns(pl.Series(POSE, before))
        b = b.with_columns(pl.Series(POSE, after + before.max()))
        if REPEAT in a.columns and REPEAT not in b.columns:
            b = b.with_columns(pl.int_range(1, pl.len() + 1, dtype=pl.Int64).over(POSE).alias(REPEAT))
    a, b = _complete(a, b.columns, first.layout), _complete(b, a.columns, first.layout)
    common = [c for c in a.columns if c in b.columns]
    lost = [c for c in (*a.columns, *b.columns) if c not in common and not c.startswith("direction_")]
    if lost:
        warnings.warn(
            f"{first.source} and {second.source}: column {listed(lost)} is left out, since only one run has it",
            SherkitWarning,
            stacklevel=4,
        )
    both = pl.concat([a.select(common), b.select(common)], how="vertical_relaxed")
    # directions are those of each run by itself
    for k in range(first.direction.shape[1]):
        direction = np.concatenate([first.direction[:, k], second.direction[:, k]])
        if np.isfinite(direction).all():
            both = both.with_columns(pl.Series(f"direction_{k + 1}", direction))
    return from_frame(both, first.source)


def _within(first: Measurements, second: Measurements) -> bool:
    """Whether the rows of ``second`` stand one after another in ``first``, whatever the clock says."""
    if second.joints.shape[1] != first.joints.shape[1] or second.readings.shape[1] != first.readings.shape[1]:
        return False
    a, b = (np.nan_to_num(np.hstack([run.joints, run.readings]), nan=np.inf) for run in (first, second))
    starts = np.flatnonzero((a[: max(len(a) - len(b) + 1, 0)] == b[0]).all(axis=1))
    return any(np.array_equal(a[k : k + len(b)], b) for k in starts)


def _numbered(run: Measurements) -> Ints:
    """Pose numbers (n,) as they are given, else by repeats of the joint readings, from 1."""
    return run.groups + 1 if run.pose is None else run.pose


def _complete(frame: pl.DataFrame, wanted: Sequence[str], layout: Layout) -> pl.DataFrame:
    """A run with the columns of another whose absence says something: nothing marked, not declared, not taken."""
    for name in wanted:
        if name in frame.columns:
            continue
        if name == OUTLIER:
            frame = frame.with_columns(pl.lit(0, dtype=pl.Int64).alias(name))
        elif name in layout.may_be_empty:
            frame = frame.with_columns(pl.lit(None, dtype=pl.Float64).alias(name))
    return frame
