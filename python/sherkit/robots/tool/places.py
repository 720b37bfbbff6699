"""Where a tool brings its tip: wavelengths to force and smoothed depth, these to a bend, the bend to the base.

Eqs. 1, 2, 8 and 9 of Ebrahimi et al. 2020. Depth over the whole run is what least squares have of all moments, the
robot's motion and the hole's wander at once. Unlike the loop's filter it knows no threshold below which a force is
none: the moment at section II says M F = |F|² (l - d), and what that tells of d fades with |F|². So the tip is a smooth
function of gains, references and lengths, and what is fitted to it converges.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy
from scipy.sparse import csr_array

from ...base import linalg
from ...base.types import Bools, Floats
from .runs import ToolRun
from .tool import FlexibleTool, rotation_of

# -- The hole of a run, where it stands still -----------------------------------------------------------------------

#: Forces of less than this part of the usual one do not say where the edge is.
_LEANS = 0.3
#: Part of the force that may be left where the hole stands still.
_STANDS = 0.1
#: What is left of the fit is alike for so long, s.
_ALIKE_S = 1.0
_CLEARANCE = 3
#: No hole is rounder than this, mm.
_LEAST_STD_MM = 0.03


@dataclass(frozen=True, eq=False)
class Hole:
    """Its ``place_mm`` (3,), base; the radius by which it is wider than the shaft, mm, with its standard deviation; and
    how it gives way, mm/mN."""

    place_mm: Floats
    clearance_mm: float
    clearance_std_mm: float
    gives_mm_mn: float

    def in_tool(self, tool: FlexibleTool) -> FlexibleTool:
        """The tool whose file says how wide the hole is."""
        return replace(tool, clearance_mm=self.clearance_mm, clearance_std_mm=self.clearance_std_mm)

    def force(self, tool: FlexibleTool, run: ToolRun, depth_mm: Floats) -> Floats:
        """What it pushes (n, 2), mN, tool frame, at depths (n,)."""
        aside = np.einsum("nji,nj->ni", run.rotations, self.place_mm - run.position_mm)[:, :2]
        far = np.linalg.norm(aside, axis=1)
        push = (far - self.clearance_mm).clip(0.0) / (_softness(tool, depth_mm) + self.gives_mm_mn)
        return np.asarray(aside * (push / np.where(far > 0, far, 1.0))[:, None])


def find_hole(
    tool: FlexibleTool, run: ToolRun, force_mn: Floats, depth_mm: Floats, ways: Floats, moving: Bools
) -> Hole | None:
    """The hole that explains the force (n, 2), mN, where it is ``moving`` (n,) along ``ways`` (n, 2), at depths (n,);
    None where no hole that stands still does."""
    size = np.linalg.norm(force_mn, axis=1)
    usual = float(np.sqrt(np.mean(size**2)))
    leans = moving & (size > _LEANS * usual)
    gives = _softness(tool, depth_mm)
    across = run.rotations.transpose(0, 2, 1)[:, :2, :]
    pushed = np.stack([force_mn / np.where(size > 0, size, 1.0)[:, None], force_mn, ways * gives[:, None]], axis=2)
    columns = np.concatenate([across, -pushed], axis=2)[leans].reshape(-1, 6)
    right = (np.einsum("nij,nj->ni", across, run.position_mm) + force_mn * gives[:, None])[leans].ravel()
    if len(right) < 2 * columns.shape[1]:
        return None
    found, _, rank, _ = linalg.lstsq(columns, right, rcond=None)
    softness = gives[leans] + found[4]
    if rank < columns.shape[1] or not (gives + found[4] > 0).all():
        return None
    left = (columns @ found - right).reshape(-1, 2)
    if not ((left / softness[:, None]) ** 2).sum(axis=1).mean() < (_STANDS * usual) ** 2:
        return None
    alike = max(_ALIKE_S / run.step_s, 1.0)
    variance = linalg.inv(columns.T @ columns)[_CLEARANCE, _CLEARANCE] * float((left**2).mean()) * alike
    std = max(float(np.sqrt(variance)), _LEAST_STD_MM)
    return Hole(found[:3], max(float(found[_CLEARANCE]), 0.0), std, float(found[4]))


def _softness(tool: FlexibleTool, depth_mm: Floats) -> Floats:
    """How the shaft gives way at the contact (n,), mm/mN."""
    return np.asarray((tool.length_mm - depth_mm).clip(0.0) ** 3 / (3.0 * tool.stiffness_mn_mm2))


# -- The places ------------------------------------------------------------------------------------------------------

#: The direction in which a force changes is taken over this time, s.
_SMOOTHING_S = 0.1
#: Readings further apart than this have nothing between them, s.
_BRIDGED_S = 0.2
#: Deviations of noise from which on a force changes.
_MOVES = 3.0
#: Deviations of the force from which on it tells the depth; noise alone would put the contact between the sections.
_TELLS = 5.0
#: The hole strays by this at least, mm²/s: what does not stray at all is no least-squares problem.
_LEAST_WANDER_MM2_S = 1e-5


@dataclass(frozen=True, eq=False)
class Felt:
    """What the gratings say at the rows of the robot: ``noisy_mn`` (n, 2) is the force as it was read, in the tool's
    frame, ``force_mn`` without most of its noise; ``depth_mm`` (n,); ``beside_mn`` (n, 2) is a force that they do not
    feel."""

    noisy_mn: Floats
    force_mn: Floats
    depth_mm: Floats
    beside_mn: Floats | None = None


@dataclass(frozen=True, eq=False)
class TipPlaces:
    """Places of the tip at moments (k,), s by the robot's clock, of a tool in a run."""

    tool: FlexibleTool
    run: ToolRun
    moments_s: Floats

    @cached_property
    def felt(self) -> Felt:
        """Force and depth as the tool file has the gratings."""
        return self.feel(self.tool)

    @cached_property
    def tip_mm(self) -> Floats:
        """The tip (k, 3) in the robot's base, as the tool file has it."""
        return self.tip(self.tool, self.felt)

    @property
    def turn(self) -> Floats:
        """Tool to base (k, 3, 3)."""
        return self._seen.turn

    def ahead(self, width_mn: float) -> Floats:
        """How far the true force (n, 2) is ahead of a felt one that it drags behind it on a rope of this width.

        Where what is felt moves, the rope is tight. Where it stands still, the true force goes from one side to the
        other: as the hole pushes, within the rope's reach, or, where no hole is known, evenly.
        """
        way, moving = self._motion
        if self._hole_beyond is None:
            return width_mn * way
        reach = np.maximum(np.linalg.norm(self._hole_beyond, axis=1), abs(width_mn))[:, None]
        beyond = self._hole_beyond / np.where(reach > 0, reach, 1.0)
        return width_mn * np.where(moving[:, None], way, beyond)

    @cached_property
    def _hole_beyond(self) -> Floats | None:
        """How far ahead of the felt force that of the hole is (n, 2), where there is one."""
        felt, hole = self.felt, self.hole
        return None if hole is None else hole.force(self.tool, self.run, felt.depth_mm) - felt.force_mn

    @cached_property
    def hole(self) -> Hole | None:
        """The hole, where one that stands still explains the force."""
        felt = self.felt
        return find_hole(self.tool, self.run, felt.force_mn, felt.depth_mm, *self._motion)

    @cached_property
    def _motion(self) -> tuple[Floats, Bools]:
        """Along which the force moves (n, 2), and at rest from one side to the other; and where it moves (n,): changes
        over some hundredths of a second by more than noise."""
        force_mn, time = self.felt.force_mn, self.run.time_s
        half = max(1, round(_SMOOTHING_S / self.run.step_s / 2))
        total = np.cumsum(np.vstack([np.zeros((1, 2)), force_mn]), axis=0)
        n = len(force_mn)
        here = np.arange(n)
        ahead, behind = (np.clip(here + k, 0, n) for k in (2 * half + 1, -2 * half))
        later = (total[ahead] - total[here]) / np.maximum(ahead - here, 1)[:, None]
        before = (total[here] - total[behind]) / np.maximum(here - behind, 1)[:, None]
        before[behind == here] = force_mn[behind == here]
        moved = later - before
        size = np.linalg.norm(moved, axis=1)
        # the scatter that noise alone gives such a difference, from what neighbouring rows differ by
        scatter = np.median(np.linalg.norm(np.diff(self.felt.noisy_mn, axis=0), axis=1)) / np.sqrt(half)
        moving = size > _MOVES * scatter
        if not moving.any():
            return np.zeros_like(moved), moving
        way = moved[moving] / size[moving, None]
        return np.column_stack([np.interp(time, time[moving], one) for one in way.T]), moving

    def feel(self, tool: FlexibleTool, wavelengths_nm: Floats | None = None) -> Felt:
        """Force and smoothed depth as another tool, or from other wavelengths (n, 9); lost ones are bridged."""
        return self._felt(tool, self.waves_nm if wavelengths_nm is None else wavelengths_nm, *self._around)

    @cached_property
    def waves_nm(self) -> Floats:
        """Wavelengths (n, 9) as they were at the rows of the robot, NaN where none tells: late ones put back."""
        return self.waves_later(0.0)

    def waves_later(self, delay_s: float) -> Floats:
        """The same where the fibres are later than the file says."""
        run = self.run
        taken = run.fibre_times_s - self.tool.fibre_delay_s - delay_s
        if np.array_equal(taken, run.time_s):
            return np.where(run.present[:, None], run.wavelengths_nm, np.nan)
        here = np.flatnonzero(run.present)
        here = here[np.argsort(taken[here], kind="stable")]
        at, waves = taken[here], run.wavelengths_nm[here]
        out = np.column_stack([np.interp(run.time_s, at, w, left=np.nan, right=np.nan) for w in waves.T])
        # between two readings that are far apart nothing is known
        after = np.clip(np.searchsorted(at, run.time_s), 1, len(at) - 1)
        out[at[after] - at[after - 1] > _BRIDGED_S] = np.nan
        return out

    @cached_property
    def _around(self) -> tuple[Floats, Floats]:
        """About where the contact is (n,), mm, and how the depth goes with the robot (n - 1,), mm a row: what the
        variances and the steps of a depth are taken at, whatever the effect."""
        run, tool = self.run, self.tool
        led = run.insertion_mm_s[1:] * np.diff(run.time_s)
        felt = self._felt(tool, self.waves_nm, np.full(len(run), 0.5 * tool.distances_mm[0]), led)
        size = np.linalg.norm(felt.force_mn, axis=1)
        arc = (tool.length_mm - felt.depth_mm).clip(0.0)
        bend = size * arc**2 / tool.stiffness_mn_mm2
        # the hole stands aside of the unbent shaft by the bend and its own width; the shaft that turns sweeps over that
        aside = felt.force_mn * (bend * arc / 3.0 + tool.clearance_mm)[:, None] / np.where(size > 0, size, 1.0)[:, None]
        hole = np.einsum("nij,nj->ni", run.rotations[:, :, :2], aside)
        swept = np.einsum("ni,ni->n", (hole[1:] + hole[:-1]) / 2.0, np.diff(run.rotations[:, :, 2], axis=0))
        # a bent shaft is longer than its way along the axis
        longer = arc * bend**2 / 15.0 if tool.bending == "exact" else np.zeros(len(run))
        middle = (run.rotations[1:, :, 2] + run.rotations[:-1, :, 2]) / 2.0
        along = np.einsum("ni,ni->n", np.diff(run.position_mm, axis=0), middle)
        return felt.depth_mm, along - swept - np.diff(longer)

    def _felt(self, tool: FlexibleTool, waves_nm: Floats, around_mm: Floats, led: Floats) -> Felt:
        """From wavelengths (n, 9), NaN where they were lost; the depth is about ``around_mm`` (n,), and goes with the
        robot by ``led`` (n - 1,)."""
        run, (near, far) = self.run, tool.distances_mm
        lower, upper = tool.sensor.measure_batch(run.time_s, tool.as_if_cold(waves_nm))[1].transpose(1, 0, 2)
        there = np.isfinite(lower[:, 0])
        force = (upper - lower) / (far - near)
        gains = np.array(tool.gains)
        noise = tool.noise_nm**2 / 2.0 * ((gains - gains.mean(axis=2, keepdims=True)) ** 2).sum(axis=(1, 2))
        # the moments' share in the depth, by Eq. 2 to first order
        share = (far - around_mm) / (far - near)
        variance = noise[1] * (1.0 - share) ** 2 + noise[0] * share**2
        squared = (force**2).sum(axis=1)
        least = _TELLS**2 * 2.0 * (noise[0] + noise[1]) / (far - near) ** 2
        tells = (squared / (squared + least)) ** 2 / (variance + tool.floor_mm2[0] * squared)
        weight, seen = tells * squared, tells * (far * squared - (upper * force).sum(axis=1))
        depth = _smoothed(tool, run, np.where(there, weight, 0.0), np.where(there, seen, 0.0), led)
        if not there.all():
            here = np.flatnonzero(there)
            force = np.column_stack([np.interp(run.time_s, run.time_s[here], force[here, k]) for k in range(2)])
        return Felt(force, self._calmed @ force, depth)

    def tip(self, tool: FlexibleTool, felt: Felt, moments_s: Floats | None = None) -> Floats:
        """The tip (k, 3) of another tool, under another force, or at other moments."""
        at = self._seen if moments_s is None else _Seen(self.run, moments_s, self._calmed)
        force = at.calmed @ felt.noisy_mn
        if felt.beside_mn is not None:
            force = force + at.between @ felt.beside_mn
        poses = np.hstack([at.turn.reshape(-1, 9), at.place])
        return tool.beam.tip_batch(*(np.ascontiguousarray(v) for v in (force, at.between @ felt.depth_mm, poses)))

    @cached_property
    def _calmed(self) -> csr_array:
        return calmed(self.run.time_s)

    @cached_property
    def _seen(self) -> _Seen:
        return _Seen(self.run, self.moments_s, self._calmed)


class _Seen:
    """The robot at moments (k,): ``between`` (k, n) takes what it has at its rows to them, ``calmed`` (k, n) a force;
    ``turn`` (k, 3, 3) and ``place`` (k, 3) of the tool."""

    def __init__(self, run: ToolRun, moments_s: Floats, calm: csr_array) -> None:
        self.between = _between(run.time_s, moments_s)
        self.calmed = self.between @ calm
        self.turn = rotation_of(self.between @ run.turn_rad)
        self.place = self.between @ run.position_mm


def calmed(time_s: Floats) -> csr_array:
    """Takes forces at times (n,) to those without most of their noise, (n, n): a local parabola (Savitzky and Golay
    1964). A picture lies between rows, and a delay that is fitted would else choose rows whose noise suits it."""
    n = len(time_s)
    rows = 2 * round(_SMOOTHING_S / float(np.median(np.diff(time_s))) / 2) + 1
    if not 3 < rows <= n:
        return csr_array(scipy.sparse.identity(n))
    first = np.clip(np.arange(n) - rows // 2, 0, n - rows)
    weights = np.array([scipy.signal.savgol_coeffs(rows, 2, pos=k, use="dot") for k in range(rows)])
    columns = first[:, None] + np.arange(rows)
    return csr_array((weights[np.arange(n) - first].ravel(), columns.ravel(), rows * np.arange(n + 1)), shape=(n, n))


def _between(time_s: Floats, moments_s: Floats) -> csr_array:
    """Takes values at times (n,) to moments (m,), by cubic pieces whose slopes have no jump (Catmull and Rom 1974)."""
    n, m = len(time_s), len(moments_s)
    after = np.clip(np.searchsorted(time_s, moments_s, side="right"), 1, n - 1)
    rows = np.clip(after[:, None] + np.arange(-2, 2), 0, n - 1)
    t = time_s[rows]
    step = t[:, 2] - t[:, 1]
    share = (moments_s - t[:, 1]) / step
    rest = 1.0 - share
    first, second = share * rest**2 * step / (t[:, 2] - t[:, 0]), share**2 * rest * step / (t[:, 3] - t[:, 1])
    weights = np.column_stack(
        [-first, (1.0 + 2.0 * share) * rest**2 + second, share**2 * (3.0 - 2.0 * share) + first, -second]
    )
    return csr_array((weights.ravel(), (np.repeat(np.arange(m), 4), rows.ravel())), shape=(m, n))


def _smoothed(tool: FlexibleTool, run: ToolRun, weight: Floats, seen: Floats, led: Floats) -> Floats:
    """Depth (n,), mm: least squares over measurements ``seen`` / ``weight``, each with a variance of 1 / ``weight``,
    and over steps that are what the robot ``led`` (n - 1,) but for a random walk: a tridiagonal system."""
    step = np.diff(run.time_s)
    tie = 1.0 / (max(tool.per_second_mm2[0], _LEAST_WANDER_MM2_S) * step)
    start = 1.0 / tool.start_known_mm**2
    diagonal, right = weight.copy(), seen.copy()
    diagonal[0] += start
    right[0] += start * tool.start_depth_mm
    diagonal[1:] += tie
    diagonal[:-1] += tie
    right[1:] += tie * led
    right[:-1] -= tie * led
    return np.asarray(linalg.solveh_banded(np.vstack([diagonal, np.append(-tie, 0.0)]), right))
