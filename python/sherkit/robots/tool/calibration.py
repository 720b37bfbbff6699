"""Calibration of a tool from known loads: gains of the gratings, stiffness and free length of the shaft.

Rows of a load bench: a known force (mN, tool frame) at a known distance from the tip (mm), nine wavelengths, and where
it was measured the deflection of the shaft at the contact, along the force (mm). Rows without force give the reference.
Sources: Eq. 1 and section VII of Ebrahimi et al. (slope); He et al. 2014 (common mode removed).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import polars as pl

import sherkit._core as _core

from ...data.reader import checked
from ...data.tables import read_table, write_table
from ...errors import FitError, MeasurementError
from ...names import listed
from ...types import Floats
from .columns import DEFLECTION, DEPTH, FIBRES, FORCE
from .tool import FlexibleTool

#: Forces of less than this are none, mN.
_NO_FORCE_MN = 1e-9
_LEAST_UNLOADED = 5
_LEAST_LOADED = 12


@dataclass(frozen=True, eq=False)
class Loads:
    """Rows of a load bench: ``force_mn`` (n, 2), ``depth_mm`` (n,), ``wavelengths_nm`` (n, 9), ``deflection_mm`` (n,),
    NaN where it was not measured."""

    force_mn: Floats
    depth_mm: Floats
    wavelengths_nm: Floats
    deflection_mm: Floats
    source: str = "loads"

    def __len__(self) -> int:
        return len(self.force_mn)

    def save(self, path: str | Path) -> None:
        """Writes CSV or Parquet that :func:`read_loads` reads."""
        columns = {**dict(zip(FORCE, self.force_mn.T, strict=True)), DEPTH: self.depth_mm}
        columns |= {DEFLECTION: self.deflection_mm, **dict(zip(FIBRES, self.wavelengths_nm.T, strict=True))}
        write_table(pl.DataFrame(columns).with_columns(pl.col(DEFLECTION).fill_nan(None)), path)


def read_loads(path: str | Path) -> Loads:
    """Reads the rows of a load bench. Raises :class:`~sherkit.errors.MeasurementError` naming file, column and row."""
    path = checked(path)
    try:
        frame = read_table(path)
        missing = [name for name in (*FORCE, DEPTH, *FIBRES) if name not in frame.columns]
        if missing:
            raise MeasurementError(f"{path}: column '{missing[0]}' is missing; it has {listed(frame.columns, 24)}")
        if DEFLECTION not in frame.columns:
            frame = frame.with_columns(pl.lit(None, dtype=pl.Float64).alias(DEFLECTION))
        numbers = frame.select(pl.col(*FORCE, DEPTH, *FIBRES, DEFLECTION).cast(pl.Float64))
    except pl.exceptions.PolarsError as error:
        raise MeasurementError(f"{path}: expected a table of numbers: {str(error).splitlines()[0]}") from None
    for name in (*FORCE, DEPTH, *FIBRES):
        bad = ~np.isfinite(numbers[name].to_numpy().astype(float))
        if bad.any():
            raise MeasurementError(f"{path}: row {int(np.argmax(bad)) + 1}, column '{name}': expected a finite number")

    def array(*names: str) -> Floats:
        return np.ascontiguousarray(np.column_stack([numbers[n].to_numpy().astype(float) for n in names]))

    return Loads(array(*FORCE), array(DEPTH)[:, 0], array(*FIBRES), array(DEFLECTION)[:, 0], str(path))


@dataclass(frozen=True, eq=False)
class ToolCalibration:
    """What the loads say. ``tool`` has it all; deviations are one σ.

    ``gains_std`` (2, 2, 3); ``rms_mn_mm`` (2,) is what the moments leave at sections I and II. ``slope_mn_mm2`` is EI
    by the paper's slope at the drawn length, ``stiffness_mn_mm2`` and ``length_mm`` by the fit of both; all None
    without deflections.
    """

    tool: FlexibleTool
    gains_std: Floats
    rms_mn_mm: Floats
    loaded: int
    unloaded: int
    slope_mn_mm2: tuple[float, float] | None
    stiffness_mn_mm2: tuple[float, float] | None
    length_mm: tuple[float, float] | None


def calibrate_tool(tool: FlexibleTool, loads: Loads) -> ToolCalibration:
    """K_I and K_II, and where deflections were measured EI (by the paper's slope, and with the length h together).

    The reference and the noise come from the unloaded rows, or stay the tool's where there are fewer than five of them.
    Raises :class:`~sherkit.errors.FitError` for too few loads, or loads in one direction only.
    """
    unloaded = np.linalg.norm(loads.force_mn, axis=1) <= _NO_FORCE_MN
    if int((~unloaded).sum()) < _LEAST_LOADED:
        raise FitError(f"{loads.source}: {int((~unloaded).sum())} rows with a force; expected {_LEAST_LOADED} or more")
    reference, noise = np.array(tool.reference_nm), tool.noise_nm
    if int(unloaded.sum()) >= _LEAST_UNLOADED:
        rest = loads.wavelengths_nm[unloaded]
        reference = rest.mean(axis=0)
        # warmth moves all fibres alike, and is no noise
        within = rest - reference
        within = within - within.mean(axis=1, keepdims=True)
        noise = float(np.sqrt((within**2).sum() / ((len(rest) - 1) * 8)))
    gains, spread, left = np.zeros((2, 2, 3)), np.zeros((2, 2, 3)), np.zeros(2)
    force, depth = np.ascontiguousarray(loads.force_mn[~unloaded]), np.ascontiguousarray(loads.depth_mm[~unloaded])
    for section in range(2):
        columns = slice(3 * section, 3 * section + 3)
        shifts = np.ascontiguousarray(loads.wavelengths_nm[~unloaded, columns] - reference[columns])
        found = _core.tool_fit_gain(tool.distances_mm[section], shifts, force, depth)
        gains[section] = found["gain"]
        variance = np.diag(found["residual_covariance"])
        spread[section] = np.sqrt(np.outer(variance, np.diag(found["unit_covariance"]).clip(0.0)))
        left[section] = float(np.sqrt(variance.mean()))
    made = replace(
        tool,
        gains=gains.tolist(),  # type: ignore[arg-type]
        reference_nm=tuple(reference.tolist()),
        noise_nm=noise if noise > 0 else tool.noise_nm,
    )
    slope = stiffness = length = None
    measured = np.isfinite(loads.deflection_mm) & ~unloaded
    if int(measured.sum()) >= _LEAST_LOADED:
        size = np.ascontiguousarray(np.linalg.norm(loads.force_mn[measured], axis=1))
        at, bent = (np.ascontiguousarray(v[measured]) for v in (loads.depth_mm, loads.deflection_mm))
        slope = _core.tool_fit_slope(tool.length_mm, size, at, bent)
        both = _core.tool_fit_beam(size, at, bent, np.zeros(len(at), dtype=bool), tool.beam)
        std = np.sqrt(np.diag(both["covariance"]).clip(0.0))
        length, stiffness = (both["length_mm"], float(std[0])), (both["stiffness"], float(std[1]))
        made = replace(made, length_mm=both["length_mm"], stiffness_mn_mm2=both["stiffness"])
    return ToolCalibration(
        made, spread, left, int((~unloaded).sum()), int(unloaded.sum()), slope, stiffness, length
    )  # fmt: skip
