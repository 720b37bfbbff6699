"""What a loop shows while it goes on: how far off a model is at readings before it is fitted to them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from ..base import linalg
from ..data.columns import unit_in
from ..fit.identify import Fit, residuals
from .choice import later
from .look import Look

#: Places at which the accuracy is asked, and the share of cases that it holds for.
PLACES, SHARE = 60, 0.95


@dataclass(frozen=True)
class Progress:
    """Of the look at ``readings`` rows: root mean square of what the look before leaves at the rows since, by the
    geometry alone and by what leads, in the unit of people (µm, pixels …; not finite where nothing can be said), and
    how far off a robot calibrated by it may be anywhere in 95 of 100 cases, µm, as the covariance of the fit has it."""

    readings: int
    by_geometry: float
    by_lead: float
    accuracy_um: float | None


def progress(before: Look | None, now: Look, seed: int) -> Progress:
    """How far it is at a look, by what the one before it held."""
    fit = now.lead.fit if now.lead is not None else now.fit
    accuracy = accuracy_by_covariance_um(now, fit, seed)
    if before is None:
        return Progress(now.readings, float("nan"), float("nan"), accuracy)
    geometry = _missed(before.fit, before, now)
    lead = geometry if before.lead is None else _missed(before.lead.fit, before, now)
    return Progress(now.readings, geometry, lead, accuracy)


def _missed(fit: Fit, before: Look, now: Look) -> float:
    """Root mean square of what a fit leaves at the rows that were read after it."""
    axes = list(now.family.axes)
    new = slice(before.readings, now.readings)
    left = residuals(fit.model, now.data, fit.values)[new][:, axes]
    left = left[now.data.used[new][:, axes] & np.isfinite(left)]
    return float(now.data.layout.per_unit * np.sqrt(np.mean(np.square(left)))) if len(left) else float("nan")


@linalg.one_thread()
def accuracy_by_covariance_um(found: Look, fit: Fit, seed: int) -> float | None:
    """How far off the fitted model may be anywhere in the region, in 95 of 100 cases, µm: the largest over places, to
    first order; None where readings are no lengths."""
    axes = list(found.family.axes)
    if not all(unit_in(fit.data.layout.readings[a]) == "mm" for a in axes):
        return None
    places = found.family.region.spread(PLACES, seed + 1)
    rows = later(found.data, places, 0.0, np.random.default_rng(seed))
    by = fit.model.derivatives(rows, fit.values)[:, axes]
    each = np.einsum("nmp,pq,nkq->nmk", by, fit.covariance + fit.unobserved_covariance, by)
    largest = float(linalg.eigvalsh(each)[:, -1].max())
    return float(1e3 * np.sqrt(scipy.stats.chi2.ppf(SHARE, len(axes)) * max(largest, 0.0)))
