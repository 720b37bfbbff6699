"""How far off a robot is that was calibrated by what a loop holds, at its end and while it goes on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..base import linalg
from ..calibration import calibrate
from ..errors import SherkitError
from ..fit.identify import Fit, residuals
from .known import PLACES
from .look import InterimAnalysis
from .task import Task


@linalg.one_thread()
def accuracy_um(task: Task, found: InterimAnalysis, effects: tuple[str, ...], fit: Fit) -> float | None:
    """How far off the calibrated robot may be anywhere in the region, in 95 of 100 cases, µm: the largest over places.

    As a calibration of these rows promises it (:class:`~sherkit.robots.accuracy.PredictedAccuracy`); of a
    kind without one, or an effect that a calibration cannot hold, by the covariance of the fit. None where that is in
    no length.
    """
    places = found.known.region.spread(PLACES, task.seed + 1)
    try:
        made = calibrate(task.robot, found.data, effects=effects, correction="none").calibration
        # the region is one of the drawing: where its poses are in the calibration's frame is the calibration's to say
        there = made.forward_batch(places.joints)
        promised = made.predicted_accuracies(there.values[there.reached]).radius_mm
        if np.isfinite(promised).any():
            return float(1e3 * np.nanmax(promised))
    except SherkitError:
        pass
    return found.known.accuracy_um(found.data, fit, task.seed)


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
    fit = now.lead.fit if now.lead is not None else now.fit
    try:
        accuracy = now.known.accuracy_um(now.data, fit, seed)
    except SherkitError:  # a fit by which the robot reaches nothing
        accuracy = None
    if before is None:
        return Progress(now.readings, float("nan"), float("nan"), accuracy)
    geometry = _missed(before.fit, before, now)
    lead = geometry if before.lead is None else _missed(before.lead.fit, before, now)
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
