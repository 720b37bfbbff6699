"""Where a tool brings its tip: wavelengths to force and smoothed depth, these to a bend, the bend to the base.

Eqs. 1, 2, 8 and 9 of Ebrahimi et al. 2020, by the same sensing, filter and beam that a control loop runs.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..._core import DepthFilter
from ...types import Floats
from .alignment import at_times
from .runs import ToolRun
from .tool import FlexibleTool, rotation_of

#: The direction in which a force changes is taken over this time, s.
_SMOOTHING_S = 0.1


@dataclass(frozen=True, eq=False)
class Felt:
    """What the gratings say at the rows of the robot: ``force_mn`` (n, 2) in the tool's frame, ``depth_mm`` (n,)."""

    force_mn: Floats
    depth_mm: Floats


@dataclass(frozen=True, eq=False)
class Places:
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

    @cached_property
    def turn(self) -> Floats:
        """Tool to base (k, 3, 3)."""
        return rotation_of(at_times(self.run.time_s, self.run.turn_rad, self.moments_s))

    @cached_property
    def changing(self) -> Floats:
        """The way (n, 2) in which the force changes, of length one in motion and less where it rests."""
        return _direction(self.run.time_s, self.felt.force_mn)

    def feel(self, tool: FlexibleTool, wavelengths_nm: Floats | None = None) -> Felt:
        """Force and smoothed depth as another tool, or from other wavelengths (n, 9); lost ones are bridged."""
        run = self.run
        waves = run.wavelengths_nm if wavelengths_nm is None else wavelengths_nm
        measured = tool.sensor.measure_batch(run.time_s, np.ascontiguousarray(waves))[0]
        start = DepthFilter(tool.start_depth_mm, tool.start_std_mm**2, float(run.time_s[0]), tool.filter_noise)
        depth, _ = start.smooth(run.time_s, np.ascontiguousarray(run.insertion_mm_s), measured, run.present)
        force = measured[:, 1:3]
        if not run.present.all():
            here = np.flatnonzero(run.present)
            force = np.column_stack([np.interp(run.time_s, run.time_s[here], force[here, k]) for k in range(2)])
        return Felt(force, depth[:, 0])

    def tip(self, tool: FlexibleTool, felt: Felt, moments_s: Floats | None = None) -> Floats:
        """The tip (k, 3) of another tool, under another force, or at other moments."""
        run, moments = self.run, self.moments_s if moments_s is None else moments_s
        force, depth, turn, place = (
            at_times(run.time_s, v, moments) for v in (felt.force_mn, felt.depth_mm, run.turn_rad, run.position_mm)
        )
        poses = np.hstack([rotation_of(turn).reshape(-1, 9), place])
        return tool.beam.tip_batch(*(np.ascontiguousarray(v) for v in (force, depth, poses)))


def _direction(time_s: Floats, force_mn: Floats) -> Floats:
    step = float(np.median(np.diff(time_s)))
    half = max(1, round(_SMOOTHING_S / step / 2))
    total = np.cumsum(np.vstack([np.zeros((1, 2)), force_mn]), axis=0)
    n = len(force_mn)
    ahead, behind = (np.clip(np.arange(n) + k, 0, n) for k in (2 * half + 1, -2 * half))
    here = np.arange(n)
    later = (total[ahead] - total[here]) / np.maximum(ahead - here, 1)[:, None]
    before = (total[here] - total[behind]) / np.maximum(here - behind, 1)[:, None]
    before[behind == here] = force_mn[behind == here]
    moved = later - before
    noise = np.median(np.linalg.norm(np.diff(force_mn, axis=0), axis=1)) / np.sqrt(2 * half)
    size = np.linalg.norm(moved, axis=1)
    return np.asarray(moved / np.sqrt(size**2 + (3.0 * noise) ** 2 + 1e-12)[:, None])
