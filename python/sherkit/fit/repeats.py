"""The noise as repeats of a pose show it beside a model: what an effect in the model moves between them is no noise."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..data.noise import MIN_FREEDOM, ReadingNoise
from ..data.rows import Repeatability, pure_error

#: A noise that differs by less than this part is the same.
_SAME = 0.02


def repeatability_of(fit: Any) -> Repeatability | None:
    """By how much repeats differ in what a :class:`~sherkit.fit.identify.Fit` leaves, pooled over poses; None where no
    pose was read twice. Source: Draper and Smith, *Applied Regression Analysis*, 1.5, of residuals."""
    data = fit.data
    return pure_error(data.layout.readings, fit.residuals, data.used, data.groups)


def noise_beside(fit: Any) -> ReadingNoise | None:
    """The noise of each reading where repeats tell it, with what the model explains of them taken off; None where that
    is the noise that the fit was weighed with."""
    found = repeatability_of(fit) if fit.noise.origin == "repeats" else None
    if found is None:
        return None
    before, now = fit.data.repeatability, np.ones(len(fit.data.layout.readings))
    for k, name in enumerate(fit.data.layout.readings):
        if before.degrees_of_freedom.get(name, 0) >= MIN_FREEDOM and before.sigma[name] > 0 and found.sigma[name] > 0:
            now[k] = found.sigma[name] / before.sigma[name]
    if np.abs(now - 1.0).max() < _SAME:
        return None
    declared = np.isfinite(fit.data.sigma)
    return ReadingNoise(np.where(declared, fit.noise.sigma, fit.noise.sigma * now), "repeats")
