"""Whether the depth of a run is to be trusted: one verdict, said once, with what to do; and what was noticed: columns
of the robot that were exchanged, a run that began elsewhere than the tool file says, a hole that goes along, lags.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import scipy

from ...base.answer import Answer, ToDo
from ...base.types import Floats
from .alignment import at_times
from .consistency import NeesConsistency
from .filters import Estimate
from .runs import ToolRun

#: Without a truth: a mean of squared innovations over their variances beyond which deviations are too small.
_TOO_FAR = 1.5
#: Clocks that differ by less say nothing that is worth a sentence, s.
_LATE_S = 0.008
#: Fibres that lag by less say nothing that is worth a sentence, over the bend.
_LAGS = 0.004


@dataclass(frozen=True)
class Trust:
    """``verdict``: ``trusted``, ``too careful``, ``overconfident`` or ``unknown``; the sentence that says so with what
    to do, and what else was noticed in the run."""

    verdict: str
    sentence: str
    to_do: str
    noticed: tuple[str, ...]

    @property
    def answer(self) -> Answer:
        """What it says for whoever reads nothing else."""
        return Answer(f"the depth is {self.verdict}", "", (self.sentence, *self.noticed), (ToDo(self.to_do),))


def trust(e: Estimate, truths: list[NeesConsistency]) -> Trust:
    """From what is known of the depth's errors, where the run tells a truth; else from its innovations, which see no
    bias and never know that a filter is too careful."""
    mistaken, froze = [*exchanged(e), *began(e)], e.run.froze
    noticed = (*mistaken, *froze, *_noticed(e))
    why = " for what is said below" if noticed else ""
    of = [k for k in truths if (k.quantity, k.signal, k.condition) == ("depth", "filter", "whole run")]
    std = float(np.median(e.depth_std_mm))
    if of and of[0].verdict != "unknown":
        k = of[0]
        told = f"{100 * k.coverage:.0f} % of the rows lie in its 95 % interval, NEES {k.nees:.2f}, ± {std:.2f} mm"
        verdict = {"consistent": "trusted"}.get(k.verdict, k.verdict)
    else:
        c = e.depth.consistency
        verdict = "unknown" if not np.isfinite(c.ratio) else ("overconfident" if c.ratio > _TOO_FAR else "trusted")
        told = f"innovations squared are {c.ratio:.2f} of what is stated, ± {std:.2f} mm; no truth is in this run"
    # of a run that was recorded wrongly innovations tell nothing
    wrong = "put that right, and estimate again" if mistaken else "use the other seconds, or measure again"
    if (mistaken or froze) and verdict != "overconfident":
        verdict = "unknown"
    do = {
        "trusted": "use the estimate with its deviation",
        "too careful": "use it as it is; more loads on the bench would narrow the deviation",
        "overconfident": f"count on more than the deviation{why or ', and calibrate the tool again on its bench'}",
        "unknown": wrong
        if mistaken or froze
        else "nothing was measured that tells; look at what the rows say of themselves",
    }[verdict]
    return Trust(verdict, told, do, noticed)


def _noticed(e: Estimate) -> list[str]:
    out = []
    if (share := float(e.goes_along[-1])) > 0.0:
        out.append(
            f"The hole goes along with the shaft, by about {100 * share:.0f} % of each slide: the depth is known less "
            "well than where it stays. Support the eye, or slide more slowly"
        )
    late_s = float(e.late_s[-1])
    if abs(late_s) > _LATE_S:
        ms = 1e3 * abs(late_s)
        out.append(
            f"The robot's rows are about {ms:.0f} ms later than the gratings: the tip is led on by as much, and its "
            "deviation is larger. Give both one clock"
            if late_s > 0.0
            else f"The gratings are about {ms:.0f} ms later than the robot's rows, or lag as if they were: `sherkit "
            "tool` finds the delay of the fibres, which the tool file holds ([gratings] delay_s)"
        )
    lags = float(np.median(e.lags))
    if lags > _LAGS:
        out.append(
            f"Fibres lag behind their bends, by about {100 * lags:.1f} % of the bend, which the bench did not show: "
            "the deviation is larger for it. A bench that loads from all sides, up and down, would say so"
        )
    return out


# -- Columns of a run that were exchanged: its robot beside its camera, with each mistake undone ---------------------

#: Asked is where the tip stands further from the camera than so many of its deviations; with a mistake undone it must
#: come this much nearer, and no further off than the others.
_SEEN_OFF, _NEARER, _NEAR = 2.5, 0.5, 4.0


def _of_angles(order: str, run: ToolRun) -> ToolRun:
    """With turns that are three angles about the axes, in an order as scipy names it."""
    return replace(run, turn_rad=scipy.spatial.transform.Rotation.from_euler(order, run.turn_rad).as_rotvec())


_ANGLES = "robot_rx_rad, robot_ry_rad and robot_rz_rad are roll, pitch and yaw about axes that"
_UNDONE: dict[str, Callable[[ToolRun], ToolRun]] = {
    "robot_x_mm and robot_y_mm are exchanged": lambda run: replace(run, position_mm=run.position_mm[:, [1, 0, 2]]),
    "robot_rx_rad, robot_ry_rad and robot_rz_rad are those of the inverse turn, base to tool": lambda run: replace(
        run, turn_rad=-run.turn_rad
    ),
    f"{_ANGLES} stand still, and no rotation vector": partial(_of_angles, "xyz"),
    f"{_ANGLES} turn with the tool, and no rotation vector": partial(_of_angles, "XYZ"),
}


def exchanged(e: Estimate) -> list[str]:
    """A sentence where the tip comes to where the camera saw it with such a mistake undone, and not without."""
    run, tool = e.run, e.tool
    moments, seen = e.pictures
    if len(moments) < 20:
        return []

    def off(tip: Floats) -> float:
        return float(np.median(np.linalg.norm(at_times(run.time_s, tip, moments) - seen, axis=1)))

    before = off(e.together.value[:, 1:])
    if before < _SEEN_OFF * tool.camera_std_mm:
        return []
    told = []
    for what, undone in _UNDONE.items():
        again = undone(run)
        tracker = tool.tracker(float(run.time_s[0]), again.poses[0])
        there, waves = np.asarray(np.isfinite(run.wavelengths_nm).any(axis=1)), np.ascontiguousarray(run.wavelengths_nm)
        after = off(tracker.run(run.time_s, again.poses, run.fibre_times_s, waves, there)["state"][:, 1:])
        if after < _NEARER * before and after < _NEAR * tool.camera_std_mm:
            told.append(
                f"{run.source}: {what}: with that undone the tip is {after:.2f} mm from the camera's, now "
                f"{before:.2f} mm"
            )
    return told


# -- Where a run began, by its first forces, beside where the tool file says that it begins ---------------------------

#: The first forces are those of so long, s.
_FIRST_S = 3.0
#: Asked is where both differ by so many deviations; how far the hole stands aside puts the depth off by about so much
#: when the tool turns, mm.
_BEGAN_OFF, _ASIDE_MM = 4.0, 0.5
#: In one hole depths of the whole run differ from what these say by no more than this part of it.
_ONE_HOLE = 0.25


def began(e: Estimate) -> list[str]:
    """A sentence where the tool file says where runs begin, and the first forces say that this one did not."""
    run, tool = e.run, e.tool
    told = np.isfinite(e.fibre_depth_mm)
    if tool.start_std_mm is None or not told.any():
        return []
    step = float(np.median(np.diff(run.time_s)))
    told &= np.cumsum(told) <= max(1, round(_FIRST_S / step))
    last = int(np.flatnonzero(told)[-1])
    way = run.rotations[:, :, 2]
    hole = run.position_mm[0] - tool.start_depth_mm * way[0]
    carried = np.einsum("ni,ni->n", run.position_mm - hole, way)
    bent = e.together.value[:, 0] - e.arc_mm
    every = e.fibre_depth_mm + bent - carried
    off = every[told]
    # fibres that lag keep a share of the bends before, each its own; the lever is the longest, as the depth is in doubt
    near, far = tool.distances_mm
    size = np.linalg.norm(e.force_mn, axis=1)
    most = np.fmax.accumulate(np.where(np.isfinite(size), size, 0.0))
    lags = float(e.lags.max()) * (most / size)[told] * near * far / (far - near)
    variance = e.fibre_depth_std_mm[told] ** 2 + lags**2
    mean = float((off / variance).sum() / (1.0 / variance).sum())
    strays = tool.per_second_mm2[0] * float(run.time_s[last] - run.time_s[0])
    # what puts one depth off puts all of these seconds off
    sure = float(np.sqrt(tool.start_std_mm**2 + variance.min() + strays + _ASIDE_MM**2))
    # a shaft that is pressed elsewhere each time has no hole at which it began
    apart = float(np.nanmedian(np.abs(every - mean)))
    if abs(mean) < _BEGAN_OFF * sure or apart > _ONE_HOLE * abs(mean):
        return []
    where = tool.start_depth_mm + mean
    began_at = f"{where:.1f} mm inside" if where > 0.0 else f"{-where:.1f} mm before the hole"
    return [
        f"By its first forces {run.source} began {began_at}, and the tool file says {tool.start_depth_mm:g} ± "
        f"{tool.start_std_mm:g} mm: what is said before these forces is off by as much. Leave start_std_mm of [filter] "
        "out where nobody knows how deep a run begins, or write how deep this one did"
    ]
