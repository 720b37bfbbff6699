"""Calibration of a tool from known loads: gains of the gratings, where they stand, stiffness and free length of the
shaft.

Rows of a load bench: a known force (mN, tool frame) at a known place (mm), nine wavelengths, and where it was measured
the deflection of the shaft at the contact, along the force (mm). Rows without force give the reference. Sources: Eq.
1 and
section VII of Ebrahimi et al. (slope); He et al. 2014 (common mode removed); the fit itself is :mod:`.bench_fit`.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace

import numpy as np

from ...base import linalg
from ...base.types import Floats
from ...errors import FitError, SherkitWarning
from .bench import LEAST_LOADED, LEAST_UNLOADED, Loads, check_loads, check_sizes
from .bench_fit import (
    CONVENTIONS,
    DIFFERENCES,
    BenchFit,
    Convention,
    Drawn,
    Lack,
    Rows,
    Scatter,
    best_fit,
    chi2_as,
    lack_of_fit,
    left_open,
)
from .tool import FlexibleTool, nested

#: Lack of fit is said below this p-value.
_LACK_P = 1e-4
#: What a mean of three fibres answers is not known better than this, over a fibre's own shift.
_MEAN_DOUBT = 0.003


@dataclass(frozen=True, eq=False)
class ToolCalibration:
    """What the loads say. ``tool`` has it all; deviations are one σ.

    ``gains_std`` (2, 2, 3); ``rms_mn_mm`` (2,) is what the moments leave at sections I and II. ``convention`` is how
    the
    table was read, ``chi2`` that of every other reading beside it, by the scatter of the one that was chosen.
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
        others = [f"{self.chi2[c]:.0f}" for c in CONVENTIONS if c in self.chi2 and c != self.convention]
        if not others:
            return f"{self.convention}, as told"
        return f"{self.convention}: χ² {self.chi2[self.convention]:.0f} against {', '.join(others)}"


@linalg.one_thread()
def calibrate_tool(tool: FlexibleTool, loads: Loads) -> ToolCalibration:
    """K_I and K_II, the sections' places, and where deflections were measured EI (also by the paper's slope) and h.

    The reference and the noise come from the unloaded rows, or stay the tool's where there are fewer than five of them.
    Raises :class:`~sherkit.errors.FitError` for too few loads, loads in one direction or at one place only, and
    :class:`~sherkit.errors.MeasurementError` for numbers that cannot be.
    """
    check_loads(tool, loads)
    unloaded, loaded = ~loads.loaded, loads.loaded
    count = int(unloaded.sum())
    reference, noise = np.array(tool.reference_nm), tool.noise_nm
    if count >= LEAST_UNLOADED:
        rest = loads.wavelengths_nm[unloaded]
        reference = rest.mean(axis=0)
        # warmth moves all fibres alike, and is no noise
        within = rest - reference
        within = within - within.mean(axis=1, keepdims=True)
        noise = float(np.sqrt((within**2).sum() / ((count - 1) * 8))) or tool.noise_nm
    rows, shifts = _rows(loads, reference)
    enough = int(rows.bent.sum()) >= LEAST_LOADED
    slope = _slope(tool.length_mm, rows) if enough else None
    check_sizes(tool, _roughly(tool, rows), slope and slope[0], loads.source)
    distances = np.array(tool.distances_mm)
    drawn = Drawn(distances, tool.length_mm, tool.stiffness_mn_mm2, tool.bending == "exact")
    if not enough:
        rows = replace(rows, deflection_mm=np.full(len(rows.depth_mm), np.nan))
    told = (loads.told[0] or tool.bench[0], loads.told[1] or tool.bench[1])
    fits = best_fit(rows, drawn, noise, told)
    best = fits[0]
    value = best.value
    check_sizes(tool, value.gains, slope and slope[0], loads.source)
    if not (0.0 < value.distances_mm[0] < value.distances_mm[1] < value.length_mm):
        raise FitError(
            f"{loads.source}: no tool makes these rows: sections at {value.distances_mm[0]:.3g} and "
            f"{value.distances_mm[1]:.3g} mm of {value.length_mm:.3g} mm; is the drawing that of this tool?"
        )
    lack = [one for one in lack_of_fit(best) if one.p < _LACK_P]
    left = left_open(best, tuple(lack))
    means, off = _means(best, shifts)
    beam = left.beam if enough else np.zeros((2, 2))
    if bent := [float((one.relative**2).mean()) for one in lack if one.unit == "mm"]:
        beam = beam + np.diag([0.0, bent[0] * value.stiffness_mn_mm2**2])
    doubt = replace(
        tool.doubt,
        depth=nested(left.depth), deeper_mm=left.deeper_mm, force=left.force, beam=nested(beam), mean=off,
        reference_nm=noise / float(np.sqrt(count)) if count >= LEAST_UNLOADED else tool.doubt.reference_nm,
    )  # fmt: skip
    made = replace(
        tool,
        gains=nested(value.gains), means=nested(means), distances_mm=nested(value.distances_mm),
        reference_nm=nested(reference), noise_nm=noise, doubt=doubt,
    )  # fmt: skip
    if enough:
        made = replace(made, length_mm=value.length_mm, stiffness_mn_mm2=value.stiffness_mn_mm2)
    sentences = tuple(_sentence(one) for one in lack)
    for sentence in sentences:
        warnings.warn(f"{loads.source}: {sentence}", SherkitWarning, stacklevel=2)
    std = np.sqrt(np.diag(best.covariance).clip(0.0))
    gains = np.sqrt(np.einsum("dk,sadf,fk->sak", DIFFERENCES, _of_gains(best.covariance), DIFFERENCES).clip(0.0))
    moments = np.sqrt((best.left[:, :4].reshape(-1, 2, 2) ** 2).mean(axis=(0, 1)))
    return ToolCalibration(
        made, gains, moments, int(loaded.sum()), count, best.convention, chi2_as(fits, noise),
        np.stack([value.distances_mm, std[8:10]]), (value.zero_mm, float(std[12])), best.scatter, slope,
        (value.stiffness_mn_mm2, value.stiffness_mn_mm2 * float(std[11])) if enough else None,
        (value.length_mm, float(std[10])) if enough else None, sentences,
    )  # fmt: skip


def _rows(loads: Loads, reference_nm: Floats) -> tuple[Rows, Floats]:
    """The loaded rows, and their shifts (n, 6)."""
    on = loads.loaded
    force = loads.force_mn[on]
    size = np.linalg.norm(force, axis=1)
    shifts = loads.wavelengths_nm[on, :6] - reference_nm[:6]
    differences = np.einsum("dk,nsk->nsd", DIFFERENCES, shifts.reshape(-1, 2, 3))
    return Rows(size, force / size[:, None], loads.depth_mm[on], differences, loads.deflection_mm[on]), shifts


def _roughly(tool: FlexibleTool, rows: Rows) -> Floats:
    """Gains (2, 2, 3) by plain least squares on the drawing's arms: for their size."""
    arms = np.array(tool.distances_mm) - rows.depth_mm[:, None]
    moments = (rows.size_mn[:, None] * arms)[:, :, None] * rows.way[:, None, :]
    found = [linalg.lstsq(rows.differences_nm[:, s], moments[:, s], rcond=None)[0].T for s in range(2)]
    return np.array(found) @ DIFFERENCES


def _of_gains(covariance: Floats) -> Floats:
    """Of each row of the gains by differences (2, 2, 2, 2)."""
    blocks = [[covariance[4 * s + 2 * a : 4 * s + 2 * a + 2, 4 * s + 2 * a : 4 * s + 2 * a + 2] for a in range(2)]
              for s in range(2)]  # fmt: skip
    return np.array(blocks)


def _means(fit: BenchFit, shifts: Floats) -> tuple[Floats, float]:
    """What the means of sections I and II answer to moments (2, 2), nm per mN·mm, and how unsure that is over what the
    fibres answer."""
    out, off = np.zeros((2, 2)), [_MEAN_DOUBT]
    for s in range(2):
        moments = fit.expected[:, s, None] * fit.rows.way
        mean = shifts[:, 3 * s : 3 * s + 3].mean(axis=1)
        base = np.column_stack([moments, np.ones(len(mean))])
        found, *_ = linalg.lstsq(base, mean, rcond=None)
        left = mean - base @ found
        out[s] = found[:2]
        spread = linalg.inv(base.T @ base)[:2, :2] * float(left @ left) / (len(mean) - 3)
        own = linalg.singular_values(linalg.inv(fit.value.by_difference[s]))[0]
        off.append(float(np.sqrt(linalg.singular_values(spread)[0]) / own))
    return out, max(off)


def _slope(length_mm: float, rows: Rows) -> tuple[float, float]:
    """EI and its deviation by the paper's slope: ``F (h - d)³`` over the deflection, a line through the origin."""
    there = rows.bent > 0
    bend, load = rows.deflection_mm[there], (rows.size_mn * (length_mm - rows.depth_mm) ** 3)[there]
    slope = float(bend @ load / (bend @ bend))
    left = load - slope * bend
    return slope / 3.0, float(np.sqrt(left @ left / (len(bend) - 1) / (bend @ bend))) / 3.0


def _sentence(one: Lack) -> str:
    return (
        f"{one.what} do not follow the calibrated model: up to {one.most:.2g} {one.unit} go with load and depth as nothing "  # noqa: E501
        f"in it does (p = {one.p:.1g}); look for a bend beyond the model, a depth that is off, or fibres that slip"
    )
