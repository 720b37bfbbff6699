"""Calibration of a tool from known loads: gains of the gratings, stiffness and free length of the shaft.

Rows of a load bench: a known force (mN, tool frame) at a known distance from the tip (mm), nine wavelengths, and where
it was measured the deflection of the shaft at the contact, along the force (mm). Rows without force give the reference.
Sources: Eq. 1 and section VII of Ebrahimi et al. (slope); He et al. 2014 (common mode removed).

Loads have noise, too. Gains are the loads' regression on the wavelengths, whose own noise, known from the unloaded
rows, is taken back out of the normal matrix (Fuller, Measurement Error Models, 2.2). Stiffness is a regression of the
deflection on the force: for it the force is the one that the calibrated gratings feel, not the load cell's, so that its
noise does not make the shaft softer (instrumental variables, ibid. 1.4).
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace

import numpy as np
import scipy

import sherkit._core as _core

from ...errors import SherkitWarning
from ...types import Floats
from .bench import LEAST_LOADED, LEAST_UNLOADED, Loads, check_loads, check_sizes
from .tool import FlexibleTool, nested

_ROUNDS = 3
#: Lack of fit is said below this p-value.
_LACK_P = 1e-3


@dataclass(frozen=True, eq=False)
class ToolCalibration:
    """What the loads say. ``tool`` has it all; deviations are one σ.

    ``gains_std`` (2, 2, 3); ``rms_mn_mm`` (2,) is what the moments leave at sections I and II. ``slope_mn_mm2`` is EI
    by the paper's slope at the drawn length, ``stiffness_mn_mm2`` and ``length_mm`` by the fit of both; all None
    without deflections. ``tool.doubt`` holds the covariances of all of it.

    ``lack_of_fit`` are sentences on what the loads do that the model does not say, each with its p-value.
    """

    tool: FlexibleTool
    gains_std: Floats
    rms_mn_mm: Floats
    loaded: int
    unloaded: int
    slope_mn_mm2: tuple[float, float] | None
    stiffness_mn_mm2: tuple[float, float] | None
    length_mm: tuple[float, float] | None
    lack_of_fit: tuple[str, ...] = ()


def calibrate_tool(tool: FlexibleTool, loads: Loads) -> ToolCalibration:
    """K_I and K_II, and where deflections were measured EI (by the paper's slope, and with the length h together).

    The reference and the noise come from the unloaded rows, or stay the tool's where there are fewer than five of them.
    Raises :class:`~sherkit.errors.FitError` for too few loads, loads in one direction or at one place only, and
    :class:`~sherkit.errors.MeasurementError` for numbers that cannot be.
    """
    check_loads(tool, loads)
    unloaded = ~loads.loaded
    reference, noise = np.array(tool.reference_nm), tool.noise_nm
    if int(unloaded.sum()) >= LEAST_UNLOADED:
        rest = loads.wavelengths_nm[unloaded]
        reference = rest.mean(axis=0)
        # warmth moves all fibres alike, and is no noise
        within = rest - reference
        within = within - within.mean(axis=1, keepdims=True)
        noise = float(np.sqrt((within**2).sum() / ((len(rest) - 1) * 8)))
    loaded = ~unloaded
    force, depth = loads.force_mn[loaded], np.ascontiguousarray(loads.depth_mm[loaded])
    size = np.ascontiguousarray(np.linalg.norm(force, axis=1))
    shifts = loads.wavelengths_nm[loaded, :6] - reference[:6]
    measured = np.isfinite(loads.deflection_mm[loaded])
    enough = int(measured.sum()) >= LEAST_LOADED
    slope = stiffness = length = None
    made = replace(tool, reference_nm=tuple(reference.tolist()), noise_nm=noise if noise > 0 else tool.noise_nm)
    # gains hang on the beam by what an elastica adds to a moment, and the beam on the gains by the force felt
    for _ in range(_ROUNDS):
        gains = _gains(made, shifts, force, size, depth)
        if slope is None and enough:
            pushed, at, bent = (np.ascontiguousarray(v[measured]) for v in (size, depth, loads.deflection_mm[loaded]))
            slope = _core.tool_fit_slope(tool.length_mm, pushed, at, bent)
        check_sizes(tool, gains.value, slope and slope[0], loads.source)
        made = replace(made, gains=nested(gains.value))
        if not enough:
            break
        felt = gains.felt(made, shifts, force, size, depth)[measured]
        at, bent = (np.ascontiguousarray(v[measured]) for v in (depth, loads.deflection_mm[loaded]))
        both, covariance = _beam(made, felt, at, bent, gains.relative)
        std = np.sqrt(np.diag(covariance))
        length, stiffness = (both[0], float(std[0])), (both[1], float(std[1]))
        made = replace(made, length_mm=both[0], stiffness_mn_mm2=both[1], doubt=replace(
            made.doubt, beam=nested(covariance)))  # fmt: skip
    count = int(unloaded.sum())
    doubt = replace(
        made.doubt,
        gains=nested(gains.covariance),
        reference_nm=made.noise_nm / float(np.sqrt(count)) if count >= LEAST_UNLOADED else made.doubt.reference_nm,
    )
    made = replace(made, doubt=doubt)
    lack = _lack_of_fit(made, shifts, force, size, depth, loads.deflection_mm[loaded])
    for sentence in lack:
        warnings.warn(f"{loads.source}: {sentence}", SherkitWarning, stacklevel=2)
    std = np.sqrt(np.einsum("sakk->sak", gains.covariance).clip(0.0))
    return ToolCalibration(made, std, gains.left_mn_mm, int(loaded.sum()), count, slope, stiffness, length, lack)


@dataclass(frozen=True, eq=False)
class _Gains:
    """Gains (2, 2, 3), the covariance of their rows (2, 2, 3, 3), what the moments leave at each section (2,)."""

    value: Floats
    covariance: Floats
    left_mn_mm: Floats

    @property
    def relative(self) -> float:
        """Deviation of a force felt by what the gains do not know, over the force."""
        own = np.einsum("sakk->", self.covariance) / (self.value**2).sum()
        return float(np.sqrt(max(own, 0.0)))

    def felt(self, tool: FlexibleTool, shifts: Floats, force: Floats, size: Floats, depth: Floats) -> Floats:
        """The loads (n,) as the gratings feel them, along the cell's direction."""
        way = force / size[:, None]
        arms = tool.beam.loads_batch(size, depth, tool.distances_mm)[:, :2]
        moments = np.stack([_moment(self.value[s], shifts[:, 3 * s : 3 * s + 3], way) for s in range(2)], axis=1)
        weight = 1.0 / np.einsum("sak,sak->s", self.value, self.value)
        return np.ascontiguousarray((moments * arms * weight).sum(axis=1) / (arms**2 * weight).sum(axis=1))


def _moment(gain: Floats, shifts: Floats, way: Floats) -> Floats:
    """Moments (n,) of a section along ways (n, 2)."""
    return np.asarray(np.einsum("na,ak,nk->n", way, gain, shifts - shifts.mean(axis=1, keepdims=True)))


def _gains(tool: FlexibleTool, shifts: Floats, force: Floats, size: Floats, depth: Floats) -> _Gains:
    arms = tool.beam.loads_batch(size, depth, tool.distances_mm)[:, :2]
    value, covariance, left = np.zeros((2, 2, 3)), np.zeros((2, 2, 3, 3)), np.zeros(2)
    for s in range(2):
        # the fit takes a moment for force times arm; an elastica's is a little less
        arm = np.where(tool.distances_mm[s] > depth, tool.distances_mm[s] - depth, 1.0)
        share = np.ascontiguousarray(force * (arms[:, s] / arm)[:, None])
        own = np.ascontiguousarray(shifts[:, 3 * s : 3 * s + 3])
        found = _core.tool_fit_gain(tool.distances_mm[s], own, share, depth, tool.noise_nm)
        value[s] = found["gain"]
        variance = np.diag(found["residual_covariance"])
        covariance[s] = variance[:, None, None] * found["unit_covariance"]
        left[s] = float(np.sqrt(variance.mean()))
    return _Gains(value, covariance, left)


def _beam(
    tool: FlexibleTool, felt: Floats, at: Floats, bent: Floats, relative: float
) -> tuple[tuple[float, float], Floats]:
    """Length and stiffness, and their covariance, from deflections at the contact under the forces felt."""
    start = tool.beam
    small = felt * start.contact_compliance_batch(at)
    exact = start.loads_batch(felt, at, tool.distances_mm)[:, 2]
    # as a cantilever would have bent
    same = np.ascontiguousarray(bent * np.where(exact > 0, small / np.where(exact > 0, exact, 1.0), 1.0))
    found = _core.tool_fit_beam(felt, at, same, np.zeros(len(at), dtype=bool), start)
    covariance = np.array(found["covariance"])
    # forces that are all too large by a share make a shaft that is too stiff by the same
    covariance[1, 1] += (relative * found["stiffness"]) ** 2
    return (found["length_mm"], found["stiffness"]), covariance


def _lack_of_fit(
    tool: FlexibleTool, shifts: Floats, force: Floats, size: Floats, depth: Floats, deflection: Floats
) -> tuple[str, ...]:
    """What is left of moments and deflections against load and depth: an F-test for what the model has no term for."""
    said = []
    way = force / size[:, None]
    predicted = tool.beam.loads_batch(size, depth, tool.distances_mm)
    for s, name in enumerate(("I", "II")):
        expected = size * predicted[:, s]
        left = _moment(np.array(tool.gains[s]), shifts[:, 3 * s : 3 * s + 3], way) - expected
        said.append((f"the moments at section {name}", "mN mm", expected, left))
    there = np.isfinite(deflection)
    if int(there.sum()) >= LEAST_LOADED:
        said.append(("the deflections", "mm", predicted[there, 2], (deflection - predicted[:, 2])[there]))
    out = []
    for what, unit, expected, left in said:
        at = depth[there] if unit == "mm" else depth
        scaled, deep = expected / np.abs(expected).max(), at / max(float(at.max()), 1e-9)
        p, most = _f_test(left, scaled[:, None], np.column_stack([scaled**2, scaled**3, scaled * deep]))
        if p < _LACK_P:
            out.append(
                f"{what} do not follow the calibrated model: up to {most:.2g} {unit} go with load and depth as nothing "
                f"in it does (p = {p:.1g}); look for a bend beyond the model, a depth that is off, or fibres that slip"
            )
    return tuple(out)


def _f_test(values: Floats, base: Floats, more: Floats) -> tuple[float, float]:
    """p-value of ``more`` regressors beyond ``base``, and the most that they explain."""
    full = np.hstack([base, more])
    (a, *_), (b, *_) = (np.linalg.lstsq(x, values, rcond=None) for x in (base, full))
    less, least = ((values - base @ a) ** 2).sum(), ((values - full @ b) ** 2).sum()
    free = len(values) - full.shape[1]
    if free < 1 or least <= 0:
        return 1.0, 0.0
    ratio = (less - least) / more.shape[1] / (least / free)
    return float(scipy.stats.f.sf(ratio, more.shape[1], free)), float(np.abs(full @ b - base @ a).max())
