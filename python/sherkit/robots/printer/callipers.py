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

from ...base import linalg
from ...base.types import Floats
from ...data import Measurements
from ...errors import SherkitError
from ...fit.identify import identify
from ...model.base import ModelWithEffects
from .robot import WEIGHT

#: What is usual, mm, and the deviation of its logarithm: of a probed height, and of a distance by callipers.
_PROBE, _CALLIPERS = (0.006, 1.0), (0.04, 0.7)
#: Distances count by so many deviations less than is likeliest: taken for too good they pass for a pattern, taken for
#: too rough they tell lengths a little worse.
_CAREFULLY = 1.0
#: Noises that are tried, mm, and how many.
_LEAST_MM, _MOST_MM, _TRIED = 5e-4, 0.5, 32
#: So many plausible sizes may the geometry be off, which is as good as free; a plate or a fault is of its own.
_GEOMETRY = 30.0


def weighed(model: ModelWithEffects, data: Measurements) -> Measurements:
    """The run with its distances in the noise of its heights; as it is where it has none, or they are already."""
    far = data.between_places
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


def _by(data: Measurements, ratio: float) -> Measurements:
    weight = np.where(data.between_places, ratio, 1.0)
    return replace(
        data, readings=data.readings * weight[:, None], sigma=data.sigma * weight[:, None],
        covariates={**data.covariates, WEIGHT: weight},
    )  # fmt: skip


def _ratio(model: ModelWithEffects, data: Measurements) -> float:
    """By how much heights are better than distances, of rows that are weighed by what is usual."""
    fit = identify(model, data)
    tried, _ = model.is_testable(tuple(model.known_effects.values()), data)
    full = reduce(
        lambda one, effect: one.with_effect(effect), (e for e in tried if e not in fit.model.effects), fit.model
    )
    values = np.array([fit.by_name.get(p.name, 0.0) for p in full.parameters])
    by_name = {p.name for p in fit.model.parameters}
    size = np.array([p.size * (_GEOMETRY if p.name in by_name else 1.0) for p in full.parameters])
    used, far = data.used[:, 0], data.between_places
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
    # a wild height that nobody has left out yet makes callipers no better than a probe
    return float(np.exp(min(mean - _CAREFULLY * deviation, 0.0)))


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
