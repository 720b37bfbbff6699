"""How large the noise of each reading is, and where that is known from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..base.types import Floats
from . import Measurements

#: Standard deviation of a Gaussian per median absolute deviation.
MAD = 1.482602218505602
#: Fewer degrees of freedom than this from repeats say too little about the noise to weigh by.
_MIN_FREEDOM = 5


@dataclass(frozen=True, eq=False)
class Noise:
    """Standard deviation of every reading (n, m), in its own unit, and its origin; an error of the pose that the rows
    declare is in it.

    ``origin`` is ``"declared"`` (sigma columns), ``"repeats"`` (pure error) or ``"unknown"``, in which case all
    readings weigh the same and the scale comes from the residuals.
    """

    sigma: Floats
    origin: str


def noise_of(data: Measurements) -> Noise:
    """The noise of each reading: declared where the file says, else from repeats, else unknown (one unit each)."""
    noise = _of_readings(data)
    if not data.pose_sigma.any():
        return noise
    # an error of the pose that is declared alone is all the noise that is known
    alone = noise.origin == "unknown"
    sigma = np.hypot(np.where(alone & (data.pose_sigma > 0), 0.0, noise.sigma), data.pose_sigma)
    return Noise(sigma, "declared" if (data.pose_sigma > 0)[data.taken].all() else noise.origin)


def _of_readings(data: Measurements) -> Noise:
    """The noise without what repeats of a pose share."""
    sigma = data.sigma
    needed = data.taken
    if np.isfinite(sigma[needed]).all():
        return Noise(np.where(needed, sigma, 1.0), "declared")
    repeats = data.repeatability
    if repeats is not None:
        columns = np.full(len(data.layout.readings), np.nan)
        for k, name in enumerate(data.layout.readings):
            if repeats.degrees_of_freedom.get(name, 0) >= _MIN_FREEDOM and repeats.sigma[name] > 0:
                columns[k] = repeats.sigma[name]
        filled = np.where(np.isfinite(sigma), sigma, columns)
        if np.isfinite(filled[needed]).all():
            return Noise(np.where(needed, filled, 1.0), "repeats")
    return Noise(np.ones_like(sigma), "unknown")
