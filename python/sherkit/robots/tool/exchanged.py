"""Columns of a run that were exchanged: its robot beside its camera, with each mistake undone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import scipy

from ...base.types import Floats
from .alignment import at_times
from .filters import Estimate
from .runs import ToolRun

#: Asked is where the tip stands further from the camera than so many of its deviations; with a mistake undone it must
#: come this much nearer, and no further off than the others.
_FAR, _NEARER, _NEAR = 2.5, 0.5, 4.0


def _swapped(run: ToolRun) -> ToolRun:
    return replace(run, position_mm=np.ascontiguousarray(run.position_mm[:, [1, 0, 2]]))


def _inverse(run: ToolRun) -> ToolRun:
    return replace(run, turn_rad=-run.turn_rad)


def _of_angles(order: str) -> Callable[[ToolRun], ToolRun]:
    """Turns that are three angles about the axes, in an order as scipy names it."""

    def undone(run: ToolRun) -> ToolRun:
        turn = scipy.spatial.transform.Rotation.from_euler(order, run.turn_rad).as_rotvec()
        return replace(run, turn_rad=np.ascontiguousarray(turn))

    return undone


_ANGLES = "robot_rx_rad, robot_ry_rad and robot_rz_rad are roll, pitch and yaw about axes that"
_UNDONE: dict[str, Callable[[ToolRun], ToolRun]] = {
    "robot_x_mm and robot_y_mm are exchanged": _swapped,
    "robot_rx_rad, robot_ry_rad and robot_rz_rad are those of the inverse turn, base to tool": _inverse,
    f"{_ANGLES} stand still, and no rotation vector": _of_angles("xyz"),
    f"{_ANGLES} turn with the tool, and no rotation vector": _of_angles("XYZ"),
}


def exchanged(e: Estimate) -> list[str]:
    """A sentence where the tip comes to where the camera saw it with such a mistake undone, and not without."""
    run, tool = e.run, e.tool
    moment = run.camera_time_s - tool.camera_delay_s
    seen = (moment >= run.time_s[0]) & (moment <= run.time_s[-1])
    if int(seen.sum()) < 20:
        return []
    truth = tool.in_base(run.camera_mm[seen])

    def off(tip: Floats) -> float:
        return float(np.median(np.linalg.norm(at_times(run.time_s, tip, moment[seen]) - truth, axis=1)))

    before = off(e.together.value[:, 1:])
    told: list[str] = []
    if before < _FAR * tool.camera_std_mm:
        return told
    for what, undone in _UNDONE.items():
        again = undone(run)
        tracker = tool.tracker(float(run.time_s[0]), again.poses[0])
        there = np.ascontiguousarray(np.isfinite(run.wavelengths_nm).any(axis=1))
        waves = np.ascontiguousarray(run.wavelengths_nm)
        tip = tracker.run(again.time_s, again.poses, again.fibre_times_s, waves, there)["state"][:, 1:]
        after = off(tip)
        if after < _NEARER * before and after < _NEAR * tool.camera_std_mm:
            told.append(
                f"{run.source}: {what}: with that undone the tip is {after:.2f} mm from the camera's, now "
                f"{before:.2f} mm"
            )
    return told
