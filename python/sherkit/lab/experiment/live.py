"""Identification while the rows come in: the newest residual, how well the parameters are known, and whether that will
do."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import polars as pl

from ...base.types import Floats
from ...data import Measurements, from_frame
from ...data.columns import POSE, REPEAT, TIME
from ...errors import FitError
from ...fit.identify import Fit, identify
from ...model.kinds import Robot, kind_of, model_of
from .plan import Plan, Point

#: A fit is taken anew when the rows have grown by this share: the work stays proportional to the rows.
_GROWTH = 0.02


#: What a goal can be set for: where the model puts the robot, or each of its parameters.
GOALS = ("position", "parameters")


@dataclass(frozen=True)
class Goal:
    """How well the model is to be known: the largest standard deviation ``std``, in the unit that people read.

    ``of`` "position": of any coordinate that the model predicts at any pose of the plan, measured yet or not. Of
    "parameters": of any of them, angles at their lever, µm, from the readings alone: directions that no pose can
    observe do not count. Neither says what physics is missing. With ``stop`` the run ends where the goal is reached.
    """

    std: float
    of: str = "position"
    stop: bool = False


class Live:
    """Takes points, and says what the model makes of them: the fit of the rows so far, or else the drawing.

    ``residual`` is that of the newest point, before it was fitted: root of the sum over its readings squared, in
    ``unit``. ``worst`` is the name and standard deviation, in ``goal_unit``, of what is known worst (coordinate or
    parameter, see :class:`Goal`), None while too few rows are there. Without ``fitting`` there is no fit, and
    residuals are those of the drawing.
    """

    def __init__(self, robot: Robot, plan: Plan, goal: Goal | None = None, *, fitting: bool = True) -> None:
        self.model = model_of(robot)
        self.goal = goal
        self.fitting = fitting
        self.unit = kind_of(robot).layout.unit
        self.goal_unit = "µm" if goal is not None and goal.of == "parameters" else self.unit
        self._joints = np.unique(np.array([s.joints for s in plan]), axis=0)
        self.fit: Fit | None = None
        self.residual: float | None = None
        self.worst: tuple[str, float] | None = None
        self._points: list[Point] = []
        self._fitted = 0

    @property
    def rows(self) -> int:
        """Points that were taken in."""
        return len(self._points)

    @property
    def enough(self) -> bool:
        """Whether the goal is reached: further poses no longer help."""
        return self.goal is not None and self.worst is not None and self.worst[1] <= self.goal.std

    @property
    def rows_to_go(self) -> int | None:
        """Rows that are still needed if standard deviations go on falling with the root of their number."""
        if self.goal is None or self.worst is None:
            return None
        needed = self._fitted * (self.worst[1] / self.goal.std) ** 2
        return max(int(np.ceil(needed)) - self.rows, 0)

    def sentence(self) -> str:
        """How well the model is known, and whether further poses help."""
        if self.worst is None:
            return f"{self.rows} rows are too few for a fit"
        what, std = self.worst
        unit = self.goal_unit
        known = f"after {self.rows} rows, {what} is known to {std:.3g} {unit} (standard deviation), all else better"
        if self.goal is None:
            return known
        if self.enough:
            return f"{known}; the goal is {self.goal.std:g} {unit}: further poses no longer help"
        return f"{known}; the goal is {self.goal.std:g} {unit}: about {self.rows_to_go} more rows"

    def short(self) -> str:
        """The same in a few words, for a line that changes."""
        if self.residual is None:
            return ""
        out = f"residual {self.residual:.3g} {self.unit}"
        if self.fit is None:
            return f"{out} from the drawing"
        return out if self.worst is None else f"{out}, {self.worst[0]} ±{self.worst[1]:.3g} {self.goal_unit}"

    def take(self, point: Point) -> None:
        """Takes a point in without fitting it: call :meth:`refit` after the last one."""
        self._points.append(point)

    def add(self, point: Point) -> None:
        """Takes a point in; fits anew where enough rows have come since the last fit."""
        self.take(point)
        self.residual = self._residual(point)
        if self.fitting and len(self._points) >= max(self._fitted * (1.0 + _GROWTH), self._fitted + 1):
            self.refit()

    def refit(self) -> None:
        """Fits the rows so far."""
        if not self._points:
            return
        try:
            data = self._measurements(self._points)
            # from the drawing each time: a start elsewhere would stay in directions that no reading observes
            self.fit = identify(self.model, data)
        except FitError:
            # too few rows for the parameters: nothing can be said yet
            return
        self._fitted = len(self._points)
        free = data.taken.sum() - self.fit.rank
        if free <= 0:
            return
        names, std = self._std(self.fit)
        k = int(np.argmax(std))
        self.worst = (names[k], float(std[k]))

    def _std(self, fit: Fit) -> tuple[tuple[str, ...], Floats]:
        if self.goal is not None and self.goal.of == "parameters":
            lever = np.array([1e3 * p.lever_mm for p in fit.parameters])
            return tuple(p.name for p in fit.parameters), fit.std_from_readings * lever
        rows = fit.data.unmeasured(self._joints)
        by = self.model.derivatives(rows, fit.values)[:, : rows.coordinates]
        # what the readings do not tell counts with its plausible size where it moves a coordinate
        variance = np.einsum("nap,pq,naq->na", by, fit.covariance + fit.unobserved_covariance, by)
        std = rows.layout.per_unit * np.sqrt(variance.clip(0.0).max(axis=0))
        return rows.layout.names[: rows.coordinates], std

    def _residual(self, point: Point) -> float:
        data = self._measurements([point])
        values = np.zeros(len(self.model.parameters)) if self.fit is None else self.fit.values
        left = np.where(data.taken, data.readings - self.model.predict(data, values), 0.0)
        return float(data.layout.per_unit * np.sqrt((left**2).sum()))

    def _measurements(self, points: list[Point]) -> Measurements:
        first = self._points[0].time_s
        columns: dict[str, list[float]] = {TIME: [p.time_s - first for p in points]}
        for name in points[0].values:
            columns[name] = [p.values[name] for p in points]
        frame = pl.DataFrame(columns).with_columns(
            pl.Series(POSE, [p.pose for p in points]), pl.Series(REPEAT, [p.repeat for p in points])
        )
        return from_frame(frame.with_columns(pl.col(pl.Float64).fill_nan(None)), "the run so far")
