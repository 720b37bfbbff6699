"""Identification while the rows come in: the newest residual, how well the parameters are known, and whether that will
do."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import polars as pl

from ..errors import FitError, SherkitError
from ..identification import Fit, identify
from ..measurements import Measurements, from_frame
from ..measurements.columns import POSE, REPEAT, TIME
from ..models import model_of
from ..robots.file import Robot
from .bench import Point

#: A fit is taken anew when the rows have grown by this share: the work stays proportional to the rows.
_GROWTH = 0.02


@dataclass(frozen=True)
class Goal:
    """How well the parameters are to be known: the largest standard deviation, µm (angles at their lever).

    It is that from the readings alone: directions that no pose of this experiment can observe do not count. With
    ``stop`` the run ends where it is reached.
    """

    std_um: float
    stop: bool = False


class Live:
    """Takes points, and says what the fit of the rows so far makes of them.

    ``residual_um`` is that of the newest point, before it was fitted: root of the sum over its readings squared;
    ``worst`` the name and standard deviation, µm, of the parameter that is known worst; both None while too few rows
    are there.
    """

    def __init__(self, robot: Robot, goal: Goal | None = None) -> None:
        self.model = model_of(robot)
        self.goal = goal
        self.fit: Fit | None = None
        self.residual_um: float | None = None
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
        return self.goal is not None and self.worst is not None and self.worst[1] <= self.goal.std_um

    @property
    def rows_to_go(self) -> int | None:
        """Rows that are still needed if standard deviations go on falling with the root of their number."""
        if self.goal is None or self.worst is None:
            return None
        needed = self._fitted * (self.worst[1] / self.goal.std_um) ** 2
        return max(int(np.ceil(needed)) - self.rows, 0)

    def add(self, point: Point) -> None:
        """Takes a point in; fits anew where enough rows have come since the last fit."""
        self._points.append(point)
        self.residual_um = self._residual(point)
        if len(self._points) >= max(self._fitted * (1.0 + _GROWTH), self._fitted + 1):
            self.refit()

    def refit(self) -> None:
        """Fits the rows so far."""
        try:
            data = self._measurements(self._points)
            self.fit = identify(self.model, data, start=None if self.fit is None else self.fit.values)
        except FitError:
            # too few rows for the parameters: nothing can be said yet
            return
        except SherkitError:
            return
        self._fitted = len(self._points)
        free = data.taken.sum() - self.fit.rank
        if free <= 0:
            return
        std = self.fit.std_from_readings * np.array([1e3 * p.lever_mm for p in self.fit.parameters])
        k = int(np.argmax(std))
        self.worst = (self.fit.parameters[k].name, float(std[k]))

    def _residual(self, point: Point) -> float | None:
        if self.fit is None:
            return None
        data = self._measurements([point])
        left = np.where(data.taken, data.readings - self.model.predict(data, self.fit.values), 0.0)
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
