"""Calibration of a tool from known loads: gains of the gratings, where they stand, stiffness and free length of the
shaft.

Rows of a load bench: a known force (mN, tool frame) at a known place (mm), nine wavelengths, and where it was measured
the deflection of the shaft at the contact, along the force (mm). Rows without force give the reference. Sources: Eq.
1 and section VII of Ebrahimi et al. (slope); He et al. 2014 (common mode removed); the fit itself is :mod:`.bench_fit`.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import polars as pl

from ...base import linalg
from ...base.types import Bools, Floats
from ...data.called import Columns
from ...data.tables import write_table
from ...errors import FitError, MeasurementError, SherkitWarning
from .bench_doubts import against_drawing, drawn_gains, wrong_loads
from .bench_fit import (
    AS_GOOD,
    CONVENTIONS,
    DIFFERENCES,
    BenchFit,
    Convention,
    LoadRows,
    Scatter,
    fit_as_reads_best,
    lack_of_fit,
    left_open,
)
from .runs import check_unit
from .tables import NO_NAMES, numbers_of, table_at
from .tool import ARC, DEFLECTION, DEPTH, FIBRES, FORCE, FlexibleTool, nested

# -- Rows of a load bench -----------------------------------------------------------------------------------------

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
    NaN where it was not measured. ``depth_in`` is the column of the depths, which says how they are to be read."""

    force_mn: Floats
    depth_mm: Floats
    wavelengths_nm: Floats
    deflection_mm: Floats
    source: str = "loads"
    depth_in: str = DEPTH

    def __len__(self) -> int:
        return len(self.force_mn)

    @property
    def loaded(self) -> Bools:
        """Rows (n,) with a force."""
        return np.asarray(np.linalg.norm(self.force_mn, axis=1) > _NO_FORCE_MN)

    def save(self, path: str | Path) -> None:
        """Writes CSV or Parquet that :func:`read_loads` reads."""
        columns = {**dict(zip(FORCE, self.force_mn.T, strict=True)), self.depth_in: self.depth_mm}
        columns |= {DEFLECTION: self.deflection_mm, **dict(zip(FIBRES, self.wavelengths_nm.T, strict=True))}
        write_table(pl.DataFrame(columns).with_columns(pl.col(DEFLECTION).fill_nan(None)), path)


def read_loads(path: str | Path, columns: Columns = NO_NAMES) -> Loads:
    """Reads the rows of a load bench, whose depths stand in ``depth_mm``, or in ``arc_mm`` where they are lengths of
    shaft; ``columns`` are names of the file by ours.

    Raises :class:`~sherkit.errors.MeasurementError` naming file, column and row."""
    frame = table_at(Path(path), columns)
    depth = depth_column(frame)
    needed = (*FORCE, depth, *FIBRES)
    numbers = numbers_of(frame, needed, (*needed, DEFLECTION), str(path))
    for name, values in numbers.items():
        bad = np.isinf(values) if name == DEFLECTION else ~np.isfinite(values)
        if bad.any():
            raise MeasurementError(f"{path}: row {int(np.argmax(bad)) + 1}, column '{name}': expected a finite number")
    numbers.setdefault(DEFLECTION, np.full(len(numbers[depth]), np.nan))

    def array(*names: str) -> Floats:
        return np.ascontiguousarray(np.column_stack([numbers[n] for n in names]))

    return Loads(array(*FORCE), numbers[depth], array(*FIBRES), numbers[DEFLECTION], str(path), depth)


def depth_column(frame: pl.DataFrame) -> str:
    """Where a bench has its depths."""
    return ARC if ARC in frame.columns and DEPTH not in frame.columns else DEPTH


def check_loads(tool: FlexibleTool, loads: Loads) -> None:
    """Whether loads can calibrate a tool. Raises :class:`~sherkit.errors.FitError` for too few of them, all in one
    direction or at one place, and :class:`~sherkit.errors.MeasurementError` for numbers that cannot be."""
    rows, source = loads.loaded, loads.source
    if int(rows.sum()) < LEAST_LOADED:
        raise FitError(f"{source}: {int(rows.sum())} rows with a force; expected {LEAST_LOADED} or more")
    check_unit(loads.wavelengths_nm, tool.reference_nm, source)
    near = tool.distances_mm[0]
    bad = rows & ~((loads.depth_mm >= -_ZERO_MM) & (loads.depth_mm < near))
    if bad.any():
        row = int(np.argmax(bad))
        raise MeasurementError(
            f"{source}: row {row + 1}, column '{loads.depth_in}': a load at {loads.depth_mm[row]:g} mm from the tip; "
            f"expected 0 to {near:g}, below section I: is it measured from the clamp?"
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


def check_sizes(tool: FlexibleTool, rows: LoadRows, slope_mn_mm2: float | None, source: str) -> None:
    """Whether the gains of rows and the stiffness by their slope are of a size with the tool file's. Raises
    :class:`~sherkit.errors.MeasurementError`: a factor of 100 and more is another unit."""
    gain = float(np.linalg.norm(drawn_gains(tool, rows)) / np.linalg.norm(tool.gains))
    stiffness = 1.0 if slope_mn_mm2 is None else slope_mn_mm2 / tool.stiffness_mn_mm2
    for what, ratio, unit in (
        ("gains are", gain, "are forces in mN?"),
        ("the stiffness is", stiffness, f"is {DEFLECTION} in mm?"),
    ):
        if not 1.0 / _UNIT < ratio < _UNIT:
            raise MeasurementError(
                f"{source}: {what} {ratio:.2g} times what the tool file has: {unit} If this is no mistake, put the "
                "right size into the tool file first"
            )


# -- The calibration ----------------------------------------------------------------------------------------------

#: Places of the moments of sections I and II, along and across the load, among the residuals.
_OF_SECTIONS = np.array([[0, 3], [1, 4]])
#: No bench has its loads further from where they are said to be, mm, nor drags by more of the force.
_FARTHEST_MM, _MOST_FRICTION = 1.0, 0.5
#: Lack of fit is said below this p-value.
_LACK_P = 1e-4
#: What a mean of three fibres answers is not known better than this, over a fibre's own shift.
_MEAN_DOUBT = 0.003


@dataclass(frozen=True, eq=False)
class ToolCalibration:
    """What the loads say. ``tool`` has it all; deviations are one σ.

    ``gains_std`` (2, 2, 3); ``rms_mn_mm`` (2,) is what the moments leave at sections I and II. ``convention`` is how
    the
    table was read, ``chi2`` by how much less likely each reading is than the likeliest (twice the logarithm).
    ``distances_mm`` (2, 2) are sections with their deviations, ``zero_mm`` by how much the bench counts too deep;
    ``slope_mn_mm2`` is EI by the paper's slope at the drawn length, ``stiffness_mn_mm2`` and ``length_mm`` are fitted,
    all three None without deflections. ``scatter`` is what rows scatter by. ``lack_of_fit`` are sentences on what the
    loads do that the model does not say, each with its p-value.
    """

    tool: FlexibleTool
    gains_std: Floats
    rms_mn_mm: Floats
    loaded: int
    unloaded: int
    convention: Convention
    chi2: dict[Convention, float]
    distances_mm: Floats
    zero_mm: tuple[float, float]
    scatter: Scatter
    slope_mn_mm2: tuple[float, float] | None
    stiffness_mn_mm2: tuple[float, float] | None
    length_mm: tuple[float, float] | None
    lack_of_fit: tuple[str, ...] = ()

    @property
    def read_as(self) -> str:
        """How the table was read, and how much worse every other reading is."""
        if len(self.chi2) < 2:
            return f"{self.convention}, as told"
        own = self.chi2[self.convention]
        others = {c: self.chi2[c] - own for c in CONVENTIONS if c in self.chi2 and c != self.convention}
        near = min(others, key=lambda c: others[c])
        if others[near] > AS_GOOD:
            return (
                f"{self.convention}: χ² is less by {', '.join(f'{v:.0f}' for v in others.values())} than as else read"
            )
        return (
            f"{self.convention}, or as well: {near} (χ² differs by {abs(others[near]):.1f}); larger bends "
            "would tell, or [bench] of the tool file"
        )


@linalg.one_thread()
def calibrate_tool(tool: FlexibleTool, loads: Loads) -> ToolCalibration:
    """K_I and K_II, the sections' places, and where deflections were measured EI (also by the paper's slope) and h.

    The reference and the noise come from the unloaded rows, or stay the tool's where there are fewer than five of them.
    Raises :class:`~sherkit.errors.FitError` for too few loads, loads in one direction or at one place only, and
    :class:`~sherkit.errors.MeasurementError` for numbers that cannot be.
    """
    check_loads(tool, loads)
    loaded = loads.loaded
    count = int((~loaded).sum())
    reference, noise = reference_of(tool, loads), tool.noise_nm
    if count >= LEAST_UNLOADED:
        # warmth moves all fibres alike, and is no noise
        within = loads.wavelengths_nm[~loaded] - reference
        within = within - within.mean(axis=1, keepdims=True)
        noise = float(np.sqrt((within**2).sum() / ((count - 1) * 8))) or tool.noise_nm
    rows = loaded_rows(tool, loads)
    bad, why = wrong_loads(tool, rows)
    wrong = np.flatnonzero(loaded)[bad] + 1
    noticed = [f"row {row}: {one}; it is left out" for row, one in zip(wrong, why, strict=True)]
    rows = rows.some(~bad)
    noticed += against_drawing(tool, rows)
    enough = int(rows.bent.sum()) >= LEAST_LOADED
    slope = _slope(tool.length_mm, rows) if enough else None
    check_sizes(tool, rows, slope and slope[0], loads.source)
    if not enough:
        rows = replace(rows, deflection_mm=np.full(len(rows.depth_mm), np.nan))
    told = ("arc", tool.bench[1]) if loads.depth_in == ARC else tool.bench
    best, chi2 = fit_as_reads_best(rows, tool, noise, told)
    value, std = best.value, np.sqrt(np.diag(best.covariance).clip(0.0))
    if not (0.0 < value.distances_mm[0] < value.distances_mm[1] < value.length_mm):
        raise FitError(
            f"{loads.source}: no tool makes these rows: sections at {value.distances_mm[0]:.3g} and "
            f"{value.distances_mm[1]:.3g} mm of {value.length_mm:.3g} mm; is the drawing that of this tool?"
        )
    if not (np.abs(best.expected[:, :2]).max(axis=0) > 0.0).all():
        raise FitError(
            f"{loads.source}: no tool makes these rows: by what fits best no load bends section I or II; are depths in "
            "mm from the tip, and forces in mN?"
        )
    lacks = [one for one in lack_of_fit(best) if one.p < _LACK_P]
    noticed += strange(best.scatter)
    means, off = _means(best)
    doubt = replace(
        left_open(best, lacks), mean=off,
        reference_nm=noise / float(np.sqrt(count)) if count >= LEAST_UNLOADED else tool.doubt.reference_nm,
    )  # fmt: skip
    made = replace(
        tool,
        gains=nested(value.gains), means=nested(means), distances_mm=nested(value.distances_mm),
        reference_nm=nested(reference), noise_nm=noise, doubt=doubt,
    )  # fmt: skip
    if enough:
        made = replace(made, length_mm=value.length_mm, stiffness_mn_mm2=value.stiffness_mn_mm2)
    sentences = (*noticed, *map(str, lacks))
    for sentence in sentences:
        warnings.warn(f"{loads.source}: {sentence}", SherkitWarning, stacklevel=2)
    by_difference = best.covariance[:8, :8].reshape(2, 2, 2, 2, 2, 2)
    gains = np.einsum("dk,sadsaf,fk->sak", DIFFERENCES, by_difference, DIFFERENCES).clip(0.0)
    return ToolCalibration(
        made, np.sqrt(gains), np.sqrt((best.left[:, _OF_SECTIONS] ** 2).mean(axis=(0, 2))), int(loaded.sum()), count,
        best.model.convention, chi2, np.stack([value.distances_mm, std[8:10]]), (value.zero_mm, float(std[12])),
        best.scatter, slope, (value.stiffness_mn_mm2, value.stiffness_mn_mm2 * float(std[11])) if enough else None,
        (value.length_mm, float(std[10])) if enough else None, sentences,
    )  # fmt: skip


def strange(scatter: Scatter) -> list[str]:
    """Sentences on a scatter that no bench has, into which a column of another unit goes."""
    told = []
    if scatter.place_mm > _FARTHEST_MM:
        told.append(
            f"loads stood {scatter.place_mm:.2g} mm from where the table has them: are depths in mm, from the tip?"
        )
    if scatter.friction > _MOST_FRICTION:
        told.append(
            f"loads drag along the shaft by {scatter.friction:.2g} of their force: are depths and forces those of "
            "these rows?"
        )
    return told


def reference_of(tool: FlexibleTool, loads: Loads) -> Floats:
    """Wavelengths (9,) of the unloaded rows; the tool's where there are too few."""
    rest = loads.wavelengths_nm[~loads.loaded]
    return np.asarray(rest.mean(axis=0) if len(rest) >= LEAST_UNLOADED else tool.reference_nm)


def loaded_rows(tool: FlexibleTool, loads: Loads) -> LoadRows:
    """The loaded rows, their shifts from the unloaded ones."""
    on = loads.loaded
    force = loads.force_mn[on]
    size = np.linalg.norm(force, axis=1)
    shifts = loads.wavelengths_nm[on] - reference_of(tool, loads)
    return LoadRows(size, force / size[:, None], loads.depth_mm[on], shifts, loads.deflection_mm[on])


def _means(fit: BenchFit) -> tuple[Floats, float]:
    """What the means of sections I and II answer to moments (2, 2), nm per mN·mm, and how unsure that is over what the
    fibres answer."""
    out, off, r = np.zeros((2, 2)), [_MEAN_DOUBT], fit.model.rows
    for s in range(2):
        moments = fit.expected[:, s, None] * r.way
        mean = r.shifts_nm[:, 3 * s : 3 * s + 3].mean(axis=1)
        base = np.column_stack([moments, np.ones(len(mean))])
        found, *_ = linalg.lstsq(base, mean, rcond=None)
        left = mean - base @ found
        out[s] = found[:2]
        spread = linalg.inv(base.T @ base)[:2, :2] * float(left @ left) / (len(mean) - 3)
        own = linalg.singular_values(linalg.inv(fit.value.by_difference[s]))[0]
        off.append(float(np.sqrt(linalg.singular_values(spread)[0]) / own))
    return out, max(off)


def _slope(length_mm: float, rows: LoadRows) -> tuple[float, float]:
    """EI and its deviation by the paper's slope: ``F (h - d)³`` over the deflection, a line through the origin."""
    there = rows.bent > 0
    bend, load = rows.deflection_mm[there], (rows.size_mn * (length_mm - rows.depth_mm) ** 3)[there]
    slope = float(bend @ load / (bend @ bend))
    left = load - slope * bend
    return slope / 3.0, float(np.sqrt(left @ left / (len(bend) - 1) / (bend @ bend))) / 3.0
