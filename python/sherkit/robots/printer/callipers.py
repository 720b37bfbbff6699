"""Distances by callipers beside heights by a probe: how much each of the two counts.

A probe repeats to a few micrometres, callipers to some hundredths of a millimetre. Which of them a run has, its own
rows say as far as they can: both noises have the posterior that what is left gives them, over all that the geometry,
the plate and known faults could explain (Patterson and Thompson, "Recovery of inter-block information when block sizes
are unequal", Biometrika 1971), with what is usual of either as prior, since a dozen distances hold few degrees of
freedom. A distance is then read in the probe's noise: its length times the ratio, in the rows as in what the model
says, so that each row is worth the same to whoever fits, tests or holds out rows.
"""

from __future__ import annotations

from dataclasses import replace
from functools import reduce

import numpy as np
import scipy

from ...base import linalg
from ...base.types import Bools, Floats
from ...data import Measurements
from ...errors import SherkitError
from ...fit.identify import Fit, identify
from .model import PrinterModel, distances, shapes_at
from .robot import PLATE, PROBED, PROBING, WEIGHT

#: What is usual, mm, and the deviation of its logarithm: of a probed height, and of a distance by callipers.
_PROBE, _CALLIPERS = (0.006, 1.0), (0.04, 0.7)
#: Distances count by so many deviations less than is likeliest: taken for too good they pass for a pattern, taken for
#: too rough they tell lengths a little worse.
_CAREFULLY = 1.0
#: Noises that are tried, mm, and how many.
_LEAST_MM, _MOST_MM, _TRIED = 5e-4, 0.5, 32
#: So many plausible sizes may the geometry be off, which is as good as free; a plate or a fault is of its own.
_GEOMETRY = 30.0


def weighed(model: PrinterModel, data: Measurements) -> Measurements:
    """The run with its distances in the noise of its heights; as it is where it has none, or they are already."""
    far = distances(data)
    if WEIGHT in data.covariates or not far.any() or far.all():
        return data
    if np.isfinite(data.sigma[data.taken]).all():
        squares = np.square(data.sigma[:, 0])
        return _by(data, float(np.sqrt(squares[~far].mean() / squares[far].mean())))
    usual = _PROBE[0] / _CALLIPERS[0]
    try:
        found = _ratio(model, _by(data, usual))
    except SherkitError:
        # whoever fits these rows is told what is wrong with them
        found = usual
    return _by(data, found)


# -- What they say of lengths ---------------------------------------------------------------------------------------

#: A bowl that plates usually have, mm at :data:`~.model.SPAN_MM` from the middle.
BOWL_MM = 0.1
_RING = 2
#: Where lengths are asked for, as a part of the radius of the printed area, and in how many directions.
_OUT, _WAYS = 0.7, 6


def lengths_of(data: Measurements, left: Floats) -> float:
    """What is ``left`` (n, 1) of distances, RMS, mm; zero where none was measured."""
    rows, weight = _of_distances(data)
    return float(np.sqrt(np.mean(np.square(left[rows, 0] / weight)))) if rows.any() else 0.0


def size_of(best: Fit, left: Floats) -> tuple[float, float] | None:
    """By which part distances are longer than numbers say that ``left`` this (n, 1), and within which part that is
    known in 95 of 100 cases, by what the ``best`` fit leaves; None without distances."""
    data = best.data
    rows, _ = _of_distances(data)
    if not rows.any():
        return None
    length, off = data.readings[rows, 0], left[rows, 0]
    rest = best.residuals[data.used]
    noise = float(np.sqrt(rest @ rest / max(len(rest) - best.rank, 1)))
    within = noise / float(np.sqrt(length @ length)) * float(scipy.special.stdtrit(max(len(length) - 1, 1), 0.975))
    return float(length @ off / (length @ length)), within


def size_by_bowl(plain: Fit) -> float:
    """By which part sizes change where a bowl of :data:`BOWL_MM` is taken for other numbers, as heights alone do."""
    data, model = plain.data, plain.model
    bowl = shapes_at(model.tips(data)[:, :2], 0.0)[:, _RING] * BOWL_MM
    bent = replace(data, readings=data.readings - np.where(distances(data), 0.0, bowl)[:, None])
    robot = model.robot
    turn = 2 * np.pi * np.arange(_WAYS) / _WAYS
    reach = _OUT * (robot.workspace_radius_mm or 0.8 * robot.towers.radius_mm)
    at = reach * np.column_stack([np.cos(turn), np.sin(turn)])
    sent = [robot.inverse_batch(np.column_stack([xy, robot.plane_mm(xy)])).values for xy in (at, -at)]
    ends = dict(zip(PROBED.to_joints, sent[1].T, strict=True))
    nothing = dict.fromkeys((PLATE, PROBING), np.zeros(_WAYS))
    plan = Measurements.planned(sent[0], PROBED, "lengths", **ends, **nothing)
    try:
        fits = plain, identify(model, bent, noise=plain.noise, start=plain.values)
    except SherkitError:
        return 0.0
    now, then = (one.model.predict(plan, one.values)[:, 0] for one in fits)
    return float(np.abs(then / now - 1.0).mean())


def _of_distances(data: Measurements) -> tuple[Bools, Floats]:
    """Which rows (n,) are distances that count, and what they are multiplied by."""
    rows = distances(data) & data.used[:, 0]
    return rows, data.covariates.get(WEIGHT, np.ones(len(data)))[rows]


# -- The noise of each ----------------------------------------------------------------------------------------------


def _by(data: Measurements, ratio: float) -> Measurements:
    weight = np.where(distances(data), ratio, 1.0)
    return replace(
        data, readings=data.readings * weight[:, None], sigma=data.sigma * weight[:, None],
        covariates={**data.covariates, WEIGHT: weight},
    )  # fmt: skip


def _ratio(model: PrinterModel, data: Measurements) -> float:
    """By how much heights are better than distances, of rows that are weighed by what is usual."""
    fit = identify(model, data)
    tried, _ = model.is_testable(tuple(model.known_effects.values()), data)
    full = reduce(lambda one, effect: one.with_effect(effect), tried, fit.model)
    values = np.array([fit.by_name.get(p.name, 0.0) for p in full.parameters])
    by_name = {p.name for p in fit.model.parameters}
    size = np.array([p.size * (_GEOMETRY if p.name in by_name else 1.0) for p in full.parameters])
    used, far = data.used[:, 0], distances(data)
    weight = data.covariates[WEIGHT]
    columns = full.derivatives(data, values)[:, 0] * size / weight[:, None]
    left = (data.readings - full.predict(data, values))[:, 0] / weight
    parts = [(columns[rows], left[rows]) for rows in (used & ~far, used & far)]
    grams = [(c.T @ c, c.T @ r, float(r @ r), len(r)) for c, r in parts]
    noise = np.geomspace(_LEAST_MM, _MOST_MM, _TRIED)
    score = np.array([[_log_posterior(grams, (one, other)) for other in noise] for one in noise])
    likely = np.exp(score - score.max())
    likely /= likely.sum()
    ratio = np.log(noise[:, None] / noise)
    mean = float((likely * ratio).sum())
    deviation = float(np.sqrt((likely * (ratio - mean) ** 2).sum()))
    return float(np.exp(mean - _CAREFULLY * deviation))


def _log_posterior(grams: list[tuple[Floats, Floats, float, int]], noise: tuple[float, float]) -> float:
    """Of the noises of heights and distances, by the Gram matrices of their columns in plausible sizes."""
    over = [1.0 / one**2 for one in noise]
    inner = sum((g * o for (g, *_), o in zip(grams, over, strict=True)), np.eye(len(grams[0][0])))
    right = sum((b * o for (_, b, *_), o in zip(grams, over, strict=True)), np.zeros(len(inner)))
    root = linalg.cholesky(inner)
    taken = linalg.solve(root, right)
    squares = sum(s * o for (*_, s, _), o in zip(grams, over, strict=True)) - float(taken @ taken)
    counts = sum(n * np.log(o) for (*_, n), o in zip(grams, over, strict=True))
    out = 0.5 * (counts - squares) - float(np.log(np.diag(root)).sum())
    usual = ((np.log(one) - np.log(mm)) / sd for one, (mm, sd) in zip(noise, (_PROBE, _CALLIPERS), strict=True))
    return out - 0.5 * sum(float(z) ** 2 for z in usual)
