"""What a loop was told, what it holds by each look at it, and how far off the robot is then."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import polars as pl

from ..base import linalg
from ..calibration import calibrate
from ..data import Measurements
from ..data.columns import REASON, TIME
from ..errors import SherkitError, SherkitWarning
from ..fit.error import axes_of
from ..fit.identify import Fit, residuals
from . import rule, told
from .known import PLACES, FixedBefore
from .look import BEYOND, InterimAnalysis, look
from .task import Task
from .told import mistaken, unread_cells
from .vouching import against

# -- What a loop holds -------------------------------------------------------------------------------------------------

#: Readings to begin with at least.
_START = 12


class BatchLooks(Task):
    """Looks wherever a batch is whole."""

    def _begin_anew(self) -> None:
        self._known: FixedBefore | None = None
        self._looks: list[tuple[InterimAnalysis, rule.RuleState]] = []
        self._asked = []
        self._asked_at = -1
        self._looked = 0
        #: Why nothing could be fitted at the last look; what speaks against the rows as witnesses that nothing is
        #: missing; cells that were not read.
        self.blind = ""
        self.against: tuple[str, ...] = ()
        self.stuck: tuple[str, ...] = ()

    @cached_property
    def start(self) -> int:
        """Readings before the first look: as many as tell the parameters, and a few more."""
        axes = max(len(self.layout.coordinates), 1)
        return min(max(_START, -(-(len(self.model.parameters) + BEYOND) // axes)), self.budget)

    @property
    def readings(self) -> int:
        """Rows that were told."""
        return self.frame.height

    @property
    def data(self) -> Measurements:
        """What was told, in the order of time. Raises :class:`~sherkit.errors.MeasurementError` before that."""
        return told.in_order_of_time(self.frame, self.robot, self.model, self.layout)

    @property
    def last(self) -> InterimAnalysis | None:
        """The last look."""
        return self._looks[-1][0] if self._looks else None

    @property
    def looks(self) -> tuple[InterimAnalysis, ...]:
        """Every look so far."""
        return tuple(found for found, _ in self._looks)

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why each of the rows was driven, in the order of time; empty where that was not told."""
        if REASON not in self.frame.columns:
            return ()
        why = [one or "" for one in self.frame[REASON].to_list()]
        order = np.argsort(self._read(self.frame).order, kind="stable")
        return tuple(why[k] for k in order)

    @property
    def state(self) -> rule.RuleState:
        """What is held after the last look."""
        return self._looks[-1][1] if self._looks else rule.RuleState()

    @property
    def _boundary(self) -> int:
        """How many rows there are at the next look."""
        return min(self._looked + self.batch if self._looked else self.start, self.budget)

    def tell(self, rows: Any) -> None:
        """Takes what was read: rows as they were asked, with readings and any other column, as a list of dicts, a
        frame, columns by name, measurements or a file.

        Rows may be fewer, more, later or elsewhere than asked; those that were told before are known. Raises
        :class:`~sherkit.errors.MeasurementError` for what are no rows of this robot, and nothing is taken then.
        """
        frame = told.frame_of_rows(rows)
        if not frame.height:
            return
        whole = told.added(self.frame, told.taken(frame, self._asked, self.region.targets, self.layout), self.layout)
        data = self._read(whole)
        late = self.frame.height and TIME in whole.columns and self._looks and data.time_s is not None
        if late and (data.time_s[self.frame.height :] < data.time_s[: self.frame.height].max()).any():  # type: ignore[index]
            self._begin_anew()
        self.frame = whole
        self._advance()
        self._close_if_done()

    def _read(self, frame: pl.DataFrame) -> Measurements:
        return told.measurements(frame, self.robot, self.model, self.layout)

    @linalg.one_thread()
    def _advance(self) -> None:
        """Looks wherever a batch is whole."""
        while self.readings >= self._boundary > self._looked:
            boundary = self._boundary
            some = self.data.select(np.arange(boundary))
            stuck = unread_cells(self.model, self.region, some)
            self.stuck, self.blind, self.against = stuck.sentences, "", ()
            if stuck.too_many(self.batch):
                self.blind = "what is left of these readings tells nothing"
            else:
                try:
                    self._look_at(stuck.without(some))
                except SherkitError as error:
                    self.against = mistaken(self.model, some)
                    self.blind = f"{boundary} readings cannot be fitted: {error}"
            self._looked = boundary

    def _look_at(self, some: Measurements) -> None:
        if self._known is None:
            axes = axes_of(some)
            self._known = FixedBefore.of(
                self.model.for_run(some), self.region, some, axes, max(60.0 * self.span_min, 600.0)
            )
        found = look(self._known, some, self.last)
        spanned = some.time_s is None or float(np.ptp(some.time_s)) >= 60.0 * self.span_min * (1 - 1e-9)
        self.against = against(found, self.required_um, self.level, self.seed)
        state = rule.after(self.state, found, spanned=spanned, vouched=not self.against, level=self.level)
        self._looks.append((found, state))


# -- How far off the robot is ------------------------------------------------------------------------------------------
# How far off a robot is that was calibrated by what a loop holds, at its end and while it goes on.


@linalg.one_thread()
def accuracy_um(
    task: Task, found: InterimAnalysis, effects: tuple[str, ...], fit: Fit, *, from_one_side: bool = False
) -> tuple[float | None, str]:
    """How far off the calibrated robot may be anywhere in the region, in 95 of 100 cases, µm: the largest over places;
    and the effect that does most of it which these poses cannot show, empty where that is none of it.

    As a calibration of these rows promises it (:class:`~sherkit.robots.predicted_accuracy.PredictedAccuracy`); of a
    kind without one, or an effect that a calibration cannot hold, by the covariance of the fit. None where that is in
    no length. What effects could do that these poses cannot show is part of it where readings are no lengths: else
    :mod:`.vouching` asks from which size on they would have been seen. ``from_one_side`` is how far it is off where it
    is told that each joint came upwards.
    """
    places = found.known.region.spread(PLACES, task.seed + 1)
    try:
        with warnings.catch_warnings():
            # it is asked at every look; what is wrong with the rows the loop says itself
            warnings.simplefilter("ignore", SherkitWarning)
            made = calibrate(task.robot, found.data, effects=effects, correction="none").calibration
        # the region is one of the drawing: where its poses are in the calibration's frame is the calibration's to say
        there = made.forward_batch(places.joints)
        made_there = made.predicted_accuracies(
            there.values[there.reached], direction=np.ones(len(found.data.layout.joints)) if from_one_side else None
        )
        all_of_it = found.data.layout.unit != "µm"
        promised = made_there.total_mm if all_of_it else made_there.radius_mm
        if np.isfinite(promised).any():
            worst = int(np.nanargmax(promised))
            return float(1e3 * promised[worst]), made_there[worst].effect if all_of_it else ""
    except SherkitError:
        pass
    return found.known.accuracy_um(found.data, fit, task.seed), ""


@dataclass(frozen=True)
class Progress:
    """Of the look at ``readings`` rows: root mean square of what the look before leaves at the rows since, by the
    geometry alone and by what leads, in the unit of people (µm, pixels …; not finite where nothing can be said), and
    how far off a robot calibrated by it may be anywhere in 95 of 100 cases, µm, as the covariance of the fit has it."""

    readings: int
    by_geometry: float
    by_lead: float
    accuracy_um: float | None


def progress(before: InterimAnalysis | None, now: InterimAnalysis, seed: int) -> Progress:
    """How far it is at a look, by what the one before it held."""
    fit = now.best_fit
    try:
        accuracy = now.known.accuracy_um(now.data, fit, seed)
    except SherkitError:  # a fit by which the robot reaches nothing
        accuracy = None
    if before is None:
        return Progress(now.readings, float("nan"), float("nan"), accuracy)
    geometry = _missed(before.fit, before, now)
    lead = geometry if before.lead is None else _missed(before.best_fit, before, now)
    return Progress(now.readings, geometry, lead, accuracy)


def _missed(fit: Fit, before: InterimAnalysis, now: InterimAnalysis) -> float:
    """Root mean square of what a fit leaves at the rows that were read after it."""
    axes = list(now.known.axes)
    new = slice(before.readings, now.readings)
    try:
        left = residuals(fit.model, now.data, fit.values)[new][:, axes]
    except SherkitError:  # a fit by which the robot reaches less than it was seen to
        return float("nan")
    left = left[now.data.used[new][:, axes] & np.isfinite(left)]
    return float(now.data.layout.per_unit * np.sqrt(np.mean(np.square(left)))) if len(left) else float("nan")
