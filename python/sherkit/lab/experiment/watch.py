"""While a run goes on: whether what the sensors say and what the joints say can both be true.

The robot is not as drawn, and nobody knows yet how. So the drawing is taken with all errors and effects that its kind
knows, each with its plausible size as a standard deviation (doubled): a linear Gaussian model, fitted anew as rows come
(extended Kalman filter, with its rows linearised again from time to time; Bar-Shalom, Li and Kirubarajan, *Estimation
with Applications to Tracking and Navigation*, ch. 10). It says for every row how far its readings may be from where the
rows before put them. The first rows may be anywhere; a few rows later motions between poses are known far better than
any place. What no such robot does, one of the instruments did. A sensor that may stand anywhere is first taken to see
the robot in its own axes; where rows speak against that, they tell where it stands, and are all judged from there.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from ...base import linalg
from ...base.figures import listed
from ...base.types import Floats
from ...data import Measurements
from ...data.columns import TIME
from ...errors import SherkitError, SherkitWarning
from ...fit.least_squares import LeastSquaresProblem
from ...model.chain import ChainModel
from ...model.effect import Effect
from ...model.kinds import Robot, kind_of, model_of
from ...model.sensor_pose import POSE, TURNS
from .accused import Accused, ComparedRow, accuse
from .plan import Point

#: Plausible sizes are taken so many times larger: a robot may be worse than most.
_WORSE = 2.0
#: Covariates that every run has; effects that need others are left to the noise.
_ALWAYS = frozenset({"direction", TIME})
#: A row this many standard deviations away in all (norm of its whitened readings), or a few rows together.
_ROW = 7.0
_ROWS = 8.0
_TOGETHER = 5
#: A row further away than this is not fitted, and one of those concerned where the run pauses.
_ODD = 4.0
#: So many rows the assumed noise counts as, in its estimate; and what no effect leaves, in times the assumed noise: a
#: sensor that was wrong from the first row on must not pass for noise.
_NOISE_ROWS = 2.0
_LOUDEST = 5.0
#: All rows are linearised anew while they are so few, and whenever they have grown by this share.
_FEW = 30
_GROWTH = 0.1
#: A column that is the same in so many rows is held, where the drawing says that it moved by so many times the noise.
_STILL = 4
_MOVED = 20.0
#: So many rows are asked where a sensor stands, and how well they tell it before the robot is known, rad and mm.
_STANDS, _TURNED_RAD, _SHIFTED_MM = 6, 0.5, 200.0
#: Evaluations in which a model may bend to its rows, and fits in which the noise settles.
_EVALUATIONS, _BENDS = 8, 4


@dataclass(frozen=True)
class RunWarning:
    """Why a run pauses: the ``instrument`` that is to be looked at, ``why``, and the ``steps`` that may be wrong."""

    instrument: str
    why: str
    steps: tuple[int, ...]


class Watch:
    """Takes rows in their order and says when one cannot be true.

    ``owners`` name the instrument of each column, joints and coordinates; ``noise`` is the standard deviation of a
    reading to begin with, in the unit of the coordinates. Columns that are not read are left out; where there are none,
    or the kind has no model, nothing is judged.
    """

    def __init__(self, robot: Robot, owners: Mapping[str, str], noise: float) -> None:
        self.layout = kind_of(robot).layout
        self._points: list[Point] = []
        plain = model_of(robot)
        self._read = [k for k, name in enumerate(self.layout.coordinates) if name in owners]
        if not isinstance(plain, ChainModel):
            # a kind without a chain has no sizes of errors from which anything could be judged
            self._read = []
            return
        base = {p.name for p in plain.base}
        known = [
            e for e in plain.known_effects.values() if not base & {p.name for p in (*e.parameters, *e.qualified())}
        ]
        always = tuple(e for e in known if e.search is None and not e.goes_with and set(e.needs) <= _ALWAYS)
        self.model = replace(plain, free=tuple(p.name for p in plain.base), effects=always)
        self._steps = _stepping(plain, [e for e in known if e.search == TIME])
        self._owners = owners
        self._prior = _WORSE * np.array([p.size for p in self.model.parameters])
        self._assumed = noise
        # the drawing: all errors zero, and the sensor where the rows say that it stands
        self._drawn = np.zeros(len(self._prior))
        names, anywhere = [p.name for p in self.model.parameters], plain.stands_anywhere
        whole = len(self._read) == len(self.layout.coordinates)
        self._pose = {name: names.index(name) for name in anywhere if whole}
        self._so_far: list[tuple[int, Point]] = []
        self._doubted = False
        self._newest: list[tuple[int, Point]] = []
        self._first_s: float | None = None
        self._begin()

    def _begin(self) -> None:
        """Nothing is known but the drawing."""
        self._points = []
        self._noise = self._assumed
        self._values = self._drawn.copy()
        self._covariance = np.diag(self._prior**2)
        self._linearised = 0
        self._recent: list[ComparedRow] = []

    def learn(self, points: Sequence[Point]) -> None:
        """Takes in rows that are known to be right."""
        if not self._read or not points:
            return
        if self._pose and (off := self._registration(points)) is not None:
            self._stands_at(off)
        self._points += points
        for _ in range(_BENDS):
            self._linearise()

    def take(self, step: int, point: Point) -> RunWarning | None:
        """Judges the row, and takes it in where nothing speaks against it."""
        if not self._read or not np.isfinite(self._readings([point])).any():
            return None
        self._newest = [*self._newest, (step, point)][-_STILL:]
        if (held := self._held()) is not None:
            return held
        doubt = self._judged(step, point)
        if not self._pose:
            return doubt
        self._so_far.append((step, point))
        self._doubted |= doubt is not None
        return self._judged_from_where_it_stands(doubt) if self._doubted else None

    def _judged_from_where_it_stands(self, doubt: RunWarning | None) -> RunWarning | None:
        """All rows so far judged anew from where they say that the sensor stands, which is asked once: a turned frame
        is no fault. None while they are too few to say it."""
        if len(self._so_far) < _STANDS:
            return None
        rows, off = self._so_far, self._registration([point for _, point in self._so_far])
        if off is None:
            self._pose, self._so_far = {}, []
            return doubt
        self._stands_at(off)
        anew = (self._judged(*one) for one in rows)
        return next((one for one in anew if one is not None), None)

    def _stands_at(self, off: Floats) -> None:
        """Begins anew with the sensor there (6,), which is asked once."""
        for name, k in self._pose.items():
            self._drawn[k] = off[POSE.index(name)]
            self._prior[k] = np.hypot(self._drawn[k], _TURNED_RAD if name in TURNS else _SHIFTED_MM)
        self._pose, self._so_far = {}, []
        self._begin()

    def _registration(self, points: Sequence[Point]) -> Floats | None:
        """Where the sensor must stand (6,) for most of these rows to be as drawn."""
        return self.model.registration(self._rows(points))

    def _judged(self, step: int, point: Point) -> RunWarning | None:
        """The row by what those before it say; it is taken in where nothing speaks against it."""
        seen = self._seen(step, point)
        if seen is None:
            motors = self._owners[self.layout.joints[0]]
            return RunWarning(motors, "its joints say a place where the robot cannot be", (step,))
        self._recent = [*self._recent, seen][-_TOGETHER:]
        together = np.sqrt(sum(s.distance**2 for s in self._recent))
        if seen.distance > _ROW or together > _ROWS:
            odd = [s for s in self._recent if s is seen or s.distance > _ODD]
            found = accuse(odd, self._recent[: -len(odd)] if len(odd) < len(self._recent) else [], self.layout)
            return self._doubt(found, odd)
        # of a row where the robot as known so far cannot be, at the edge of its reach, nothing is learnt: a fit would
        # begin at the drawing again
        if seen.distance <= _ODD and np.isfinite(self._cost([point], self._values)):
            self._include(point)
        return None

    def judge(self, point: Point) -> RunWarning | None:
        """The same for a robot that stands where no row is taken: nothing is taken in."""
        if not self._read or (self._pose and self._doubted):
            return None
        seen = self._seen(-1, point)
        if seen is None or seen.distance <= _ROW:
            return None
        return self._doubt(accuse([seen], [], self.layout), [seen])

    # --- the parts of it

    def _doubt(self, found: Accused, odd: Sequence[ComparedRow]) -> RunWarning:
        steps = tuple(sorted(s.step for s in odd if s.step >= 0))
        return RunWarning(self._whose(found.columns), found.why, steps)

    def _held(self) -> RunWarning | None:
        """A column whose last digit stands still while the robot moves, by the drawing: no fit is to explain that."""
        steps, points = [s for s, _ in self._newest], [p for _, p in self._newest]
        drawing = self._drawn
        if len(points) < _STILL or not np.isfinite(self._cost(points, drawing)):
            return None
        moved = np.ptp(self._predicted(points, drawing)[0], axis=0)
        held = (np.ptp(self._readings(points), axis=0) == 0.0) & (moved > _MOVED * self._assumed)
        if not held.any():
            return None
        columns = [name for name, h in zip(self._columns, held, strict=True) if h]
        why = f"{listed(columns)} did not change in the last digit since step {steps[0]}, while the robot moved"
        return RunWarning(self._whose(columns), why, tuple(steps))

    def _whose(self, columns: Sequence[str]) -> str:
        return " or ".join(dict.fromkeys(self._owners[c] for c in columns))

    @property
    def _columns(self) -> list[str]:
        """The coordinates that are read."""
        return [self.layout.coordinates[k] for k in self._read]

    def _rows(self, points: Sequence[Point]) -> Measurements:
        """These points as rows, with the coordinates that are read."""
        if self._first_s is None:
            self._first_s = points[0].time_s
        layout = self.layout
        columns = {TIME: np.array([p.time_s - self._first_s for p in points])}
        for name in layout.directions:
            columns[name] = np.array([p.values.get(name, 1.0) for p in points])
        joints = np.array([[p.values[name] for name in layout.joints] for p in points])
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", SherkitWarning)
            rows = Measurements.planned(joints, layout, "the run so far", **columns)
        readings = np.full(rows.readings.shape, np.nan)
        readings[:, self._read] = self._readings(points)
        return rows.with_readings(readings)

    def _readings(self, points: Sequence[Point]) -> Floats:
        """The coordinates that are read (n, m); NaN where a cell is empty."""
        names = self._columns
        return np.array([[p.values.get(name, np.nan) for name in names] for p in points])

    def _predicted(self, points: Sequence[Point], values: Floats) -> tuple[Floats, Floats]:
        """Readings (n, m) and their derivatives (n, m, p) at these values."""
        rows = self._rows(points)
        columns = self.model.derivatives(rows, values)[:, self._read]
        return self.model.predict(rows, values)[:, self._read], columns

    def _seen(self, step: int, point: Point) -> ComparedRow | None:
        """The row beside what the model makes of it, or the drawing where the model cannot be at these joints; None
        where neither can."""
        values = self._start([point])
        if values is None:
            return None
        covariance = self._covariance if values is self._values else np.diag(self._prior**2)
        predicted, by = (a[0] for a in self._predicted([point], values))
        (read,) = self._readings([point])
        spread = by @ covariance @ by.T + self._noise**2 * np.eye(len(read))
        for model, sizes in self._steps:
            more = model.derivatives(self._rows([point]), np.zeros(len(model.parameters)))[0, self._read] * sizes
            spread += more @ more.T
        seen = ComparedRow(step, self._columns, read, predicted, spread, partial(self._by_joints, point, values))
        return seen if seen.distance <= _ODD else replace(seen, least=self._reconsidered(point))

    def _reconsidered(self, point: Point) -> float:
        """How far the row is from the others where the model may bend to it: the root of what the fit's sum of squares
        grows by. Tells a robot far from its drawing, whose rows are no longer linear in its errors, from a fault."""
        without = self._least(self._points) if self._points else 0.0
        return float(np.sqrt(max(self._least([*self._points, point]) - without, 0.0)))

    def _least(self, points: Sequence[Point]) -> float:
        """The least sum of squares, of readings and plausible sizes, that a few steps find."""
        fitted = self._fitted(points)
        return np.inf if fitted is None else self._cost(points, fitted[0])

    def _start(self, points: Sequence[Point]) -> Floats | None:
        """The present values, or the drawing where those cannot be at these joints; None where neither can."""
        tried = (self._values, self._drawn)
        return next((values for values in tried if np.isfinite(self._cost(points, values))), None)

    def _cost(self, points: Sequence[Point], values: Floats) -> float:
        """The sum of squares, of readings and plausible sizes; infinite where no such robot can be at these joints."""
        try:
            predicted = self.model.predict(self._rows(points), values)[:, self._read]
        except SherkitError:
            return np.inf
        miss = (self._readings(points) - predicted) / self._noise
        return float(np.nansum(miss**2) + ((values / self._prior) ** 2).sum())

    def _fitted(self, points: Sequence[Point]) -> tuple[Floats, Floats] | None:
        """Values and their covariance by readings and plausible sizes, a few steps from :meth:`_start`."""
        if (start := self._start(points)) is None:
            return None
        rows = self._rows(points)
        problem = LeastSquaresProblem(self.model, rows, self._prior)
        weights = np.isfinite(rows.readings) / self._noise
        found = problem.solve(weights, start, priors=True, max_evaluations=_EVALUATIONS)[0].result()
        return found["values"], found["covariance"]

    def _by_joints(self, point: Point, values: Floats) -> Floats:
        """Derivatives (m, k) of the readings by the joints, at these values."""
        out, width = [], 1e-4
        for name in self.layout.joints:
            sides = [replace(point, values={**point.values, name: point.values[name] + s * width}) for s in (1.0, -1.0)]
            try:
                high, low = self.model.predict(self._rows(sides), values)[:, self._read]
            except SherkitError:
                # at the very edge of what the robot reaches
                high = low = np.zeros(len(self._read))
            out.append((high - low) / (2.0 * width))
        return np.array(out).T

    def _include(self, point: Point) -> None:
        """Takes the row in: by a fit of all rows while they are few or have grown, by a step of the filter between."""
        self._points.append(point)
        if len(self._points) <= _FEW or len(self._points) > self._linearised * (1.0 + _GROWTH):
            self._linearise()
            return
        try:
            predicted, by = (a[0] for a in self._predicted([point], self._values))
        except SherkitError:
            return
        miss = self._readings([point])[0] - predicted
        there = np.isfinite(miss)
        by, miss = by[there], miss[there]
        spread = by @ self._covariance @ by.T + self._noise**2 * np.eye(len(miss))
        gain = linalg.solve(spread, by @ self._covariance).T
        self._values = self._values + gain @ miss
        self._covariance = self._covariance - gain @ by @ self._covariance

    def _linearise(self) -> None:
        """A fit of all rows from the present values, with the plausible sizes as a prior; the noise that it leaves."""
        if not self._points or (fitted := self._fitted(self._points)) is None:
            return
        self._values, self._covariance = fitted
        rows = self._rows(self._points)
        left = (rows.readings - self.model.predict(rows, self._values))[np.isfinite(rows.readings)]
        told = len(self._prior) - float((np.diag(self._covariance) / self._prior**2).sum())
        assumed = _NOISE_ROWS * len(self._read)
        free = max(len(left) - told, 0.0) + assumed
        estimated = float(np.sqrt((assumed * self._assumed**2 + left @ left) / free))
        self._noise = min(estimated, _LOUDEST * self._assumed)
        self._linearised = len(self._points)


def _stepping(plain: ChainModel, effects: Sequence[Effect]) -> list[tuple[ChainModel, Floats]]:
    """Each effect that begins at some moment, as a model in which it has begun, and its plausible sizes: where one may
    begin at any row, every row may be that much elsewhere."""
    out = []
    for effect in effects:
        made = plain.with_effect(effect, at=-1.0)
        own = made.owns(effect)
        sizes = np.zeros(len(made.parameters))
        sizes[own] = [p.size for p in made.parameters[own]]
        out.append((made, sizes))
    return out
