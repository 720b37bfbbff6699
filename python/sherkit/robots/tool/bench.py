"""Rows of a load bench: known forces at known places of the shaft."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import polars as pl

from ...base import linalg
from ...base.types import Bools, Floats
from ...data.tables import write_table
from ...errors import FitError, MeasurementError, SherkitWarning
from .columns import ARC, DEFLECTION, DEPTH, FIBRES, FORCE
from .plausible import check_unit
from .runs import numbers_of, table_at
from .tool import FlexibleTool

#: Forces of less than this are none, mN.
_NO_FORCE_MN = 1e-9
LEAST_UNLOADED, LEAST_LOADED = 5, 12
#: Forces across a line must be this part of those along it, and depths span this much, mm.
_LEAST_WIDTH, _LEAST_SPAN_MM = 0.05, 1.0
#: A bench may have its zero so far off, mm.
_ZERO_MM = 1.0
#: A stiffness or a gain further from the tool file than this comes of another unit.
_UNIT = 100.0


@dataclass(frozen=True, eq=False)
class Loads:
    """Rows of a load bench: ``force_mn`` (n, 2), ``depth_mm`` (n,), ``wavelengths_nm`` (n, 9), ``deflection_mm`` (n,),
    NaN where it was not measured. ``told`` is what the table says of how depth and force are to be read."""

    force_mn: Floats
    depth_mm: Floats
    wavelengths_nm: Floats
    deflection_mm: Floats
    source: str = "loads"
    told: tuple[str | None, str | None] = (None, None)

    def __len__(self) -> int:
        return len(self.force_mn)

    @property
    def loaded(self) -> Bools:
        """Rows (n,) with a force."""
        return np.asarray(np.linalg.norm(self.force_mn, axis=1) > _NO_FORCE_MN)

    def save(self, path: str | Path) -> None:
        """Writes CSV or Parquet that :func:`read_loads` reads."""
        columns = {
            **dict(zip(FORCE, self.force_mn.T, strict=True)),
            ARC if self.told[0] == "arc" else DEPTH: self.depth_mm,
        }
        columns |= {DEFLECTION: self.deflection_mm, **dict(zip(FIBRES, self.wavelengths_nm.T, strict=True))}
        write_table(pl.DataFrame(columns).with_columns(pl.col(DEFLECTION).fill_nan(None)), path)


def read_loads(path: str | Path) -> Loads:
    """Reads the rows of a load bench, whose depths stand in ``depth_mm``, or in ``arc_mm`` where they are lengths of
    shaft.

    Raises :class:`~sherkit.errors.MeasurementError` naming file, column and row."""
    frame = table_at(Path(path))
    by_arc = ARC in frame.columns and DEPTH not in frame.columns
    depth = ARC if by_arc else DEPTH
    needed = (*FORCE, depth, *FIBRES)
    numbers = numbers_of(frame, needed, (*needed, DEFLECTION), str(path))
    for name, values in numbers.items():
        bad = np.isinf(values) if name == DEFLECTION else ~np.isfinite(values)
        if bad.any():
            raise MeasurementError(f"{path}: row {int(np.argmax(bad)) + 1}, column '{name}': expected a finite number")
    numbers.setdefault(DEFLECTION, np.full(len(numbers[depth]), np.nan))

    def array(*names: str) -> Floats:
        return np.ascontiguousarray(np.column_stack([numbers[n] for n in names]))

    return Loads(
        array(*FORCE), numbers[depth], array(*FIBRES), numbers[DEFLECTION], str(path), ("arc" if by_arc else None, None)
    )


def check_loads(tool: FlexibleTool, loads: Loads) -> None:
    """Whether loads can calibrate a tool. Raises :class:`~sherkit.errors.FitError` for too few of them, all in one
    direction or at one place, and :class:`~sherkit.errors.MeasurementError` for numbers that cannot be."""
    rows, source = loads.loaded, loads.source
    if int(rows.sum()) < LEAST_LOADED:
        raise FitError(f"{source}: {int(rows.sum())} rows with a force; expected {LEAST_LOADED} or more")
    check_unit(loads.wavelengths_nm, np.array(tool.reference_nm), source)
    near = tool.distances_mm[0]
    bad = rows & ~((loads.depth_mm >= -_ZERO_MM) & (loads.depth_mm < near))
    if bad.any():
        row = int(np.argmax(bad))
        raise MeasurementError(
            f"{source}: row {row + 1}, column '{DEPTH}': a load at {loads.depth_mm[row]:g} mm from the tip; expected 0 "
            f"to {near:g}, below section I: is it measured from the clamp?"
        )
    width = linalg.singular_values(loads.force_mn[rows])
    if width[1] < _LEAST_WIDTH * width[0]:
        raise FitError(f"{source}: all loads push along one line; gains need loads from all around the shaft")
    for name, values in zip(FIBRES[:6], loads.wavelengths_nm.T, strict=False):
        if np.ptp(values) == 0.0:
            raise MeasurementError(f"{source}: column '{name}' repeats one number under all loads: a dead fibre?")
    bent = rows & np.isfinite(loads.deflection_mm)
    if int(bent.sum()) >= LEAST_LOADED and np.ptp(loads.depth_mm[bent]) < _LEAST_SPAN_MM:
        raise FitError(
            f"{source}: all deflections are of loads at {loads.depth_mm[bent].mean():g} mm from the tip; stiffness and "
            f"length need loads at several places (or leave out {DEFLECTION}, and both stay as they are)"
        )
    if int((~rows).sum()) < LEAST_UNLOADED:
        warnings.warn(
            f"{source}: {int((~rows).sum())} rows without a force; with {LEAST_UNLOADED} or more reference_nm and "
            "noise_nm would come from them, so they stay those of the tool file",
            SherkitWarning, stacklevel=3,
        )  # fmt: skip


def check_sizes(tool: FlexibleTool, gains: Floats, slope_mn_mm2: float | None, source: str) -> None:
    """Whether gains (2, 2, 3) and the stiffness by the slope are of a size with the tool file's. Raises
    :class:`~sherkit.errors.MeasurementError`: a factor of 100 and more is another unit."""
    gain = float(np.linalg.norm(gains) / np.linalg.norm(np.array(tool.gains)))
    stiffness = 1.0 if slope_mn_mm2 is None else slope_mn_mm2 / tool.stiffness_mn_mm2
    if 1.0 / _UNIT < gain < _UNIT and 1.0 / _UNIT < stiffness < _UNIT:
        return
    both = not 1.0 / _UNIT < gain < _UNIT
    found = f"gains are {gain:.2g} times" if both else f"the stiffness is {stiffness:.2g} times"
    unit = "are forces in mN?" if both else f"is {DEFLECTION} in mm?"
    raise MeasurementError(
        f"{source}: {found} what the tool file has: {unit} If this is no mistake, put the right size into the tool "
        "file first"
    )
