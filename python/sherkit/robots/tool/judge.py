"""How far estimates are off, over T0 and T1: the paper's Table I.

T0 are the rows in which the filter and the sensor it corrects differ by more than 0.1 mm (depth: the gratings; tip: the
robot's kinematics), T1 all others. Errors of the tip are means of lengths, as the paper has them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...base.types import Bools, Floats
from .alignment import at_times
from .filters import Estimate
from .plausible import check_camera

#: The paper's threshold between T0 and T1.
MISMATCH_MM = 0.1


@dataclass(frozen=True)
class Errors:
    """Mean error in mm of one signal over all rows, over T0 and over T1 (NaN where there is none), and the largest."""

    signal: str
    total: float
    t0: float
    t1: float
    largest: float


@dataclass(frozen=True)
class Judgement:
    """Errors of every signal for one quantity, ``"depth"`` or ``"tip"``; ``share_t0`` of the rows are T0."""

    quantity: str
    truth: str
    share_t0: float
    errors: tuple[Errors, ...]

    def of(self, signal: str) -> Errors:
        """The errors of a signal by name."""
        return next(e for e in self.errors if e.signal == signal)

    def improvement(self, signal: str, over: str) -> float:
        """Part of the error over T0 of signal ``over`` that ``signal`` takes away."""
        return 1.0 - self.of(signal).t0 / self.of(over).t0


def judge(e: Estimate) -> list[Judgement]:
    """Depth where the run has it, tip where a camera saw it. T0 and T1 by the filters of Eqs. 8 and 14.

    Raises :class:`~sherkit.errors.MeasurementError` for a camera whose places are in another unit.
    """
    out = []
    run = e.run
    if run.depth_mm is not None:
        truth = run.depth_mm
        rows = np.isfinite(truth)
        sensor = e.held_depth_mm
        t0 = np.abs(e.depth.value[:, 0] - sensor) > MISMATCH_MM
        signals = {
            "gratings": sensor,
            "kinematics": e.kinematic_depth_mm,
            "filter": e.depth.value[:, 0],
            "filter of both": e.together.value[:, 0],
            "paper's filter": e.paper.value[:, 0],
            "smoother": e.smooth_depth[0][:, 0],
        }
        errors = {name: np.abs(value - truth)[rows] for name, value in signals.items()}
        out.append(_judged("depth", "depth_mm", errors, t0[rows]))
    if len(run.camera_time_s):
        tool = e.tool
        moment = run.camera_time_s - tool.camera_delay_s
        rows = (moment >= run.time_s[0]) & (moment <= run.time_s[-1])
        if rows.any():
            truth = tool.in_base(run.camera_mm[rows])
            moment = moment[rows]
            places = {
                "kinematics": at_times(run.time_s, e.kinematic_tip_mm, moment),
                "filter": at_times(run.time_s, e.tip.value, moment),
                "filter of both": at_times(run.time_s, e.together.value[:, 1:], moment),
                "paper's filter": at_times(run.time_s, e.paper.value[:, 1:], moment),
                "smoother": at_times(run.time_s, e.smooth_together[0][:, 1:], moment),
            }
            check_camera(places["kinematics"], truth, run.source)
            t0 = np.linalg.norm(places["filter"] - places["kinematics"], axis=1) > MISMATCH_MM
            errors = {name: np.linalg.norm(value - truth, axis=1) for name, value in places.items()}
            out.append(_judged("tip", "camera", errors, t0))
    return out


def _judged(quantity: str, truth: str, errors: dict[str, Floats], t0: Bools) -> Judgement:
    def mean(values: Floats) -> float:
        return float(values.mean()) if len(values) else float("nan")

    made = tuple(
        Errors(name, mean(one), mean(one[t0]), mean(one[~t0]), float(one.max())) for name, one in errors.items()
    )
    return Judgement(quantity, truth, float(t0.mean()), made)
