"""Depth and tip over a recorded run: by kinematics, by the gratings alone, filtered, and by the paper's own filters.

Everything runs in the core; what a loop does step by step (:class:`sherkit._core.ToolFilter`) gives the same numbers to
the last bit.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, ClassVar

import numpy as np
import scipy
from numpy.typing import NDArray

import sherkit._core as _core

from ...base import linalg
from ...base.notebook import Shown
from ...base.types import Bools, Floats
from ...errors import MeasurementError
from .frozen import strayed_mm2
from .runs import OUT_OF_REACH_NM, ToolRun, check_wavelengths
from .tool import FIBRES, FlexibleTool

# -- What an interrogator does wrong, in words ----------------------------------------------------------------------

#: A grating that was not believed for fewer rows is a single outlier, and counted with the others.
_LASTING_ROWS = 20
_REPEATED = 0.9
_SWAPPED_NM = 0.08


@dataclass(frozen=True)
class GratingFault:
    """A grating (column) that was not believed in ``rows`` rows from ``since_s`` to ``until_s``, and what it did."""

    column: str
    since_s: float
    until_s: float
    rows: int
    what: str

    def __str__(self) -> str:
        return (
            f"{self.column}: {self.what}; left out in {self.rows} rows from {self.since_s:.2f} to {self.until_s:.2f} s"
        )


def _what(k: int, rows: Bools, shift: Floats, bits: Bools) -> str:
    mine = shift[rows, k]
    if np.isnan(mine).mean() > 0.5:
        return "shows nothing"
    known = mine[np.isfinite(mine)]
    middle = float(np.median(known))
    for j in range(9):
        # a column that shows its neighbour's peak stands off by the distance of their references
        if j != k and bits[rows, j].mean() > 0.5 and np.isfinite(shift[rows, j]).any():
            apart = middle + float(np.nanmedian(shift[rows, j]))
            if abs(middle) > _SWAPPED_NM and abs(apart) < 0.3 * abs(middle):
                return f"shows the peak of {FIBRES[j]}, which shows its"
    if (np.diff(known) == 0).mean() > _REPEATED:
        return "is stuck or saturated: it repeats one number"
    if np.median(np.abs(known)) > OUT_OF_REACH_NM:
        return "shows what no grating can"
    section = slice(3 * (k // 3), 3 * (k // 3) + 3)
    if bits[rows][:, section].all(axis=1).mean() > 0.5:
        return "stands in a section that does not agree with the others: one of its three drifts"
    return "does not agree with the other gratings"


# -- The estimate ----------------------------------------------------------------------------------------------------

#: Places of the columns of a measurement, and of depth and tip in the state of both.
_FORCE, _DEPTH, _DEPTH_VARIANCE = slice(1, 3), 7, 8
DEPTH_PART, TIP_PART = slice(0, 1), slice(1, 4)
#: A filter that stands off its gratings for longer, s, has left them.
_AWAY_S = 0.5
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

    def part(self, columns: slice) -> Track:
        """Some of the columns."""
        return replace(self, value=self.value[:, columns], covariance=self.covariance[:, columns, columns])

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
        if self.ratio > self.high:
            return "overconfident"
        return "consistent" if self.low <= self.ratio else "too careful"


def consistency(total: float, degrees: int) -> Consistency:
    """From a sum of NIS and its degrees of freedom: χ² with independent innovations (Bar-Shalom, 5.4)."""
    if degrees == 0:
        return Consistency(float("nan"), float("nan"), float("nan"))
    low, high = scipy.stats.chi2.ppf([(1 - NIS_LEVEL) / 2, (1 + NIS_LEVEL) / 2], degrees) / degrees
    return Consistency(total / degrees, float(low), float(high))


@dataclass(frozen=True, eq=False)
class Estimate(Shown):
    """A run with everything that was estimated on it. All arrays have the rows of ``run``.

    ``measurements`` are the gratings alone (Eqs. 1, 2): ``fibre_force_mn`` (n, 2), ``fibre_depth_mm`` (n,) with
    ``fibre_depth_std_mm``, NaN or infinite without force; ``held_depth_mm`` (n,) repeats the last depth of a force, as
    a display would. ``together`` is what a loop runs (:class:`sherkit._core.ToolFilter`): depth and tip, with the
    calibration's doubt in the deviations; so is ``force_mn`` (n, 2), the force of the hole across the shaft in the
    tool's frame, without gratings that are not believed, with ``force_std_mn`` (n,) of each component. ``depth`` and
    ``tip`` are its parts, or, where the tool asks for the paper's noise, the filters of Eqs. 8 and 14. ``misfit`` (n,)
    is about 1 where the moments agree; ``faulty`` (n,) has a bit for each grating that was not believed,
    ``faulty_sections`` (n, 3) says where, ``gated`` (n,) whose reading was not used, and ``faults`` names them.
    ``arc_mm`` (n,) is the length of shaft beyond the hole, where ``depth`` is the paper's l.
    ``paper`` are depth and tip (n, 4) by the paper's own filters (Eqs. 8 and 14), always beside the others, and
    ``hole`` (n, 4) what was learnt: its clearance (mm), what it gives way (mm/mN), the gratings' turn (rad), and by how
    much they count all depths deeper (mm). ``goes_along`` (n,) is by which share of its slides
    the shaft was seen to take the hole along, zero where that may be chance; what is seen grows with the run: its last
    row counts. ``lags`` (n,) is by how much fibres were
    seen to lag behind their bends, over the bend. ``late_s`` (n,) is by how much the robot's rows were seen to be later
    than the gratings, mostly to a third; where it is positive the tip has been led on by it. ``strays_mm_s`` (n,) is
    how fast the edge of the hole was seen to stray from where the motion of the tool has it.
    """

    drawn_by: ClassVar[str] = "sherkit.robots.tool.pictures:pictures_of_estimate"

    tool: FlexibleTool
    run: ToolRun
    measurements: Floats
    misfit: Floats
    depth: Track
    tip: Track
    together: Track
    force_mn: Floats
    force_std_mn: Floats
    faulty: NDArray[np.uint16]
    arc_mm: Floats
    paper: Track
    hole: Floats
    goes_along: Floats
    lags: Floats
    late_s: Floats
    strays_mm_s: Floats

    def __repr__(self) -> str:
        depth = self.depth.value[:, 0]
        truth = self.run.depth_mm
        told = "" if truth is None else f", {np.sqrt(np.nanmean((depth - truth) ** 2)):.3f} mm off"
        return (
            f"Estimate({self.run.source}: {len(self.run)} rows; depth {depth.min():.2f} to {depth.max():.2f} mm{told}, "
            f"± {np.median(self.depth.std[:, 0]):.3f}; {self.depth.consistency.verdict})"
        )

    @property
    def left_out(self) -> Bools:
        """Gratings (n, 9) that were not believed."""
        return np.asarray((self.faulty[:, None] >> np.arange(9)) & 1 > 0)

    @property
    def faulty_sections(self) -> Bools:
        """Sections I, II, III (n, 3) in which a grating was not believed."""
        return np.asarray(self.left_out.reshape(-1, 3, 3).any(axis=2))

    @property
    def gated(self) -> Bools:
        """Rows (n,) whose reading contradicted the state or itself, and was not used."""
        return np.asarray(self.together.status & _core.STATUS_GATED > 0)

    @cached_property
    def faults(self) -> tuple[GratingFault, ...]:
        """Gratings that were left out for a while, and what they did."""
        bits = self.left_out
        shift = self.run.wavelengths_nm - self.tool.reference_nm
        found = []
        for k, rows in enumerate(bits.T):
            at = self.run.time_s[rows]
            if len(at) >= _LASTING_ROWS:
                what = _what(k, rows, shift, bits)
                found.append(GratingFault(FIBRES[k], float(at[0]), float(at[-1]), len(at), what))
        return tuple(found)

    @cached_property
    def away(self) -> list[tuple[float, float]]:
        """Spans, s, of more than half a second in which the filter stood off what its gratings said of the depth,
        always to
        the same side and by more than the deviation of their difference."""
        off = self.arc_mm + self.hole[:, 3] - self.fibre_depth_mm
        known = np.isfinite(off)
        ratio = off[known] / np.sqrt(self.fibre_depth_std_mm[known] ** 2 + self.together.covariance[known, 0, 0])
        side = np.where(ratio > 1.0, 1, np.where(ratio < -1.0, -1, 0))
        time = self.run.time_s[known]
        edges = np.flatnonzero(np.diff(side, prepend=0, append=0))
        spans = [(time[a], time[b - 1]) for a, b in pairwise(edges) if side[a] != 0]
        return [(float(a), float(b)) for a, b in spans if b - a > _AWAY_S]

    @cached_property
    def pictures(self) -> tuple[Floats, Floats]:
        """Of the camera's pictures inside the robot's time: their moments (k,) by the robot's clock, and where the tip
        was seen (k, 3), robot's base."""
        time, moments = self.run.time_s, self.run.camera_time_s - self.tool.camera_delay_s
        inside = (moments >= time[0]) & (moments <= time[-1])
        return moments[inside], self.tool.in_base(self.run.camera_mm[inside])

    @property
    def depth_std_mm(self) -> Floats:
        """Standard deviation of the depth (n,)."""
        return self.depth.std[:, 0]

    @property
    def fibre_force_mn(self) -> Floats:
        """Sclera force (n, 2) by the gratings alone, tool frame, all of them believed."""
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


@linalg.one_thread()
def estimate(tool: FlexibleTool, run: ToolRun) -> Estimate:
    """Runs sensing and the filters over a recorded run.

    A reading is used at the time it was taken: its stamp where the run has one, less the delay of the fibres.
    Rows without wavelengths are predicted over, as are those of wavelengths that froze or leap off for once, and those
    in which the robot's pose stood while the tool moved: there deviations are of how far this robot goes in as much
    time. Raises :class:`~sherkit.errors.MeasurementError` for a run in which no row has wavelengths, or whose
    wavelengths are in another unit or of another tool.
    """
    waves, stamps, reading = _readings(tool, run)
    if not reading.any():
        raise MeasurementError(f"{run.source}: no row has wavelengths; there is nothing to estimate from")
    check_wavelengths(waves, tool.reference_nm, run.source)
    measured = tool.sensor.measure_batch(stamps, tool.as_if_cold(waves))[0]
    start, pose = float(run.time_s[0]), run.poses[0]
    told = tracked(tool, run)
    slides, goes = strayed_mm2(run.position_mm, run.rotations[:, :, 2], run.lost_pose)
    told["covariance"][:, 0, 0] += slides
    told["covariance"][:, [1, 2, 3], [1, 2, 3]] += goes[:, None]
    together = _track(told)
    # the paper's measurement is of the row that it came in
    paper = _track(tool.paper_filter(start, pose).run(run.time_s, run.poses, run.time_s, waves, run.present))
    chosen = together if tool.noise == "propagated" else paper
    inner = told["inner"]
    return Estimate(
        tool, run, measured, told["misfit"], chosen.part(DEPTH_PART), chosen.part(TIP_PART), together,
        told["force_mn"], np.sqrt(told["force_variance"]), told["faulty"], told["arc_mm"], paper, inner[:, 2:6],
        inner[:, 10], inner[:, 11], inner[:, 12], np.sqrt(inner[:, 1]),
    )  # fmt: skip


def _readings(tool: FlexibleTool, run: ToolRun) -> tuple[Floats, Floats, Bools]:
    """Wavelengths (n, 9) that are believed, when they were taken (n,), s, and rows (n,) that bring new ones."""
    waves = run.believed_nm
    stamps = np.ascontiguousarray(run.fibre_times_s - tool.fibre_delay_s)
    return waves, stamps, run.new_readings(np.asarray(np.isfinite(waves).any(axis=1)))


def tracked(tool: FlexibleTool, run: ToolRun) -> dict[str, Any]:
    """What a loop would say over the run, as the core gives it."""
    waves, stamps, reading = _readings(tool, run)
    start = tool.tracker(float(run.time_s[0]), run.poses[0])
    told: dict[str, Any] = start.run(run.time_s, run.poses, stamps, waves, reading)
    return told


def _track(told: dict[str, Any]) -> Track:
    return Track(told["state"], told["covariance"], told["status"], told["nis"], told["degrees"])


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
        "with a reading that was refused": _core.STATUS_GATED,
    }
    return {name: int(((track.status & flag) > 0).sum()) for name, flag in flags.items()}
