"""Depth and tip over a recorded run: by kinematics, by the gratings alone, filtered, filtered together, smoothed.

Everything runs in the core; what a loop does step by step (:class:`sherkit._core.TipFilter` and the others) gives the
same numbers to the last bit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

import sherkit._core as _core

from ...errors import MeasurementError
from ...types import Floats
from .runs import ToolRun
from .tool import FlexibleTool

#: Places of the columns of a measurement.
_FORCE, _DEPTH, _DEPTH_VARIANCE = slice(1, 3), 7, 8
#: Two-sided band for the mean NIS.
NIS_LEVEL = 0.99


@dataclass(frozen=True, eq=False)
class Track:
    """One estimate over the run: ``value`` (n, k), its covariance (n, k, k), and how the filter fared.

    ``status`` (n,) sums flags (see :func:`status_in_words`), ``nis`` (n,) are normalised innovations squared, of
    ``degrees`` (n,) freedom; zero where a step only predicted.
    """

    value: Floats
    covariance: Floats
    status: NDArray[np.uint8]
    nis: Floats
    degrees: NDArray[np.uint8]

    @property
    def std(self) -> Floats:
        """Standard deviations (n, k)."""
        return np.sqrt(np.einsum("nii->ni", self.covariance).clip(0.0))

    @property
    def consistency(self) -> Consistency:
        """How well the filter knew its own errors."""
        used = self.degrees > 0
        return consistency(float(self.nis[used].sum()), int(self.degrees[used].sum()))


@dataclass(frozen=True)
class Consistency:
    """Mean NIS per degree of freedom (1 where the noise is right) with its 99 % band, and what that means."""

    ratio: float
    low: float
    high: float

    @property
    def verdict(self) -> str:
        """``consistent``, ``overconfident``, ``too careful``, or ``unknown`` where nothing was measured."""
        if not np.isfinite(self.ratio):
            return "unknown"
        return (
            "consistent"
            if self.low <= self.ratio <= self.high
            else ("overconfident" if self.ratio > self.high else "too careful")
        )


def consistency(total: float, degrees: int) -> Consistency:
    """From a sum of NIS and its degrees of freedom: χ² with independent innovations (Bar-Shalom, 5.4)."""
    if degrees == 0:
        return Consistency(float("nan"), float("nan"), float("nan"))
    low, high = stats.chi2.ppf([(1 - NIS_LEVEL) / 2, (1 + NIS_LEVEL) / 2], degrees) / degrees
    return Consistency(total / degrees, float(low), float(high))


@dataclass(frozen=True, eq=False)
class Estimate:
    """A run with everything that was estimated on it. All arrays have the rows of ``run``.

    ``force_mn`` (n, 2), ``fibre_depth_mm`` (n,) and its ``fibre_depth_std_mm`` are the gratings alone (Eqs. 1, 2), NaN
    or infinite without force; ``held_depth_mm`` (n,) repeats the last depth of a force, as a display would.
    ``depth`` and ``tip`` are the filters of Eq. 8 and 14, ``together`` the one state (depth, tip), ``smooth_depth`` and
    ``smooth_together`` the same from all measurements of the run: values and covariances.
    """

    tool: FlexibleTool
    run: ToolRun
    measurements: Floats
    misfit: Floats
    depth: Track
    tip: Track
    together: Track
    smooth_depth: tuple[Floats, Floats]
    smooth_together: tuple[Floats, Floats]

    @property
    def force_mn(self) -> Floats:
        """Sclera force (n, 2), tool frame."""
        return self.measurements[:, _FORCE]

    @property
    def fibre_depth_mm(self) -> Floats:
        """Depth by the gratings alone (n,)."""
        told = np.isfinite(self.measurements[:, _DEPTH_VARIANCE])
        return np.where(told, self.measurements[:, _DEPTH], np.nan)

    @property
    def fibre_depth_std_mm(self) -> Floats:
        """Its standard deviation (n,), infinite where there is no force."""
        return np.sqrt(self.measurements[:, _DEPTH_VARIANCE])

    @property
    def held_depth_mm(self) -> Floats:
        """Depth by the gratings (n,), the last one kept where there is none; the start's before the first."""
        known = np.isfinite(self.fibre_depth_mm)
        last = np.maximum.accumulate(np.where(known, np.arange(len(known)), -1))
        return np.where(last >= 0, self.fibre_depth_mm[last.clip(0)], self.tool.start_depth_mm)

    @property
    def kinematic_tip_mm(self) -> Floats:
        """The unbent tip (n, 3): what the robot alone believes."""
        return self.run.position_mm

    @property
    def kinematic_depth_mm(self) -> Floats:
        """Depth (n,) by adding up the robot's motion along the shaft."""
        step = np.diff(self.run.time_s, prepend=self.run.time_s[0])
        return self.tool.start_depth_mm + np.cumsum(self.run.insertion_mm_s * step)


def estimate(tool: FlexibleTool, run: ToolRun) -> Estimate:
    """Runs sensing, the filters and the smoothers over a recorded run.

    Rows without wavelengths are predicted over. Raises :class:`~sherkit.errors.MeasurementError` for a run in which no
    row has wavelengths.
    """
    if not run.present.any():
        raise MeasurementError(f"{run.source}: no row has wavelengths; there is nothing to estimate from")
    waves = np.ascontiguousarray(run.wavelengths_nm)
    measured, _, misfit, _, _ = tool.sensor.measure_batch(run.time_s, waves)
    there = np.ascontiguousarray(run.present)
    noise, start = tool.filter_noise, float(run.time_s[0])
    variance = tool.start_std_mm**2
    times, along = run.time_s, np.ascontiguousarray(run.insertion_mm_s)
    moved = np.ascontiguousarray(run.velocities_mm_s)

    depth_filter = _core.DepthFilter(tool.start_depth_mm, variance, start, noise)
    smooth_depth = depth_filter.smooth(times, along, measured, there)
    depth = Track(*depth_filter.filter(times, along, measured, there))
    depths = np.ascontiguousarray(np.column_stack([depth.value[:, 0], depth.covariance[:, 0, 0]]))
    tip_filter = _core.TipFilter(tool.beam, run.poses[0], variance, start, noise)
    tip = Track(*tip_filter.filter(times, moved, run.poses, depths, measured, there))
    joint = _core.DepthTipFilter(tool.beam, tool.start_depth_mm, run.poses[0], (variance, variance), start, noise)
    smooth_together = joint.smooth(times, moved, run.poses, measured, there)
    together = Track(*joint.filter(times, moved, run.poses, measured, there))
    return Estimate(tool, run, measured, misfit, depth, tip, together, smooth_depth, smooth_together)


def status_in_words(track: Track) -> dict[str, int]:
    """How many rows had which flag."""
    flags = {
        "updated": _core.STATUS_UPDATED,
        "without a measurement": _core.STATUS_MISSING,
        "measured too late": _core.STATUS_LATE,
        "not finite": _core.STATUS_NOT_FINITE,
        "without a force that tells the depth": _core.STATUS_NO_FORCE,
        "without a motion": _core.STATUS_NO_MOTION,
        "with a clock that does not run": _core.STATUS_CLOCK,
    }
    return {name: int(((track.status & flag) > 0).sum()) for name, flag in flags.items()}
