"""How large the noise of each reading is, where that is known from, and how many digits a column has."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..base.types import Floats
from . import Measurements

#: Standard deviation of a Gaussian per median absolute deviation.
MAD = 1.482602218505602
#: Fewer degrees of freedom than this from repeats say too little about the noise to weigh by.
MIN_FREEDOM = 5


@dataclass(frozen=True, eq=False)
class ReadingNoise:
    """Standard deviation of every reading (n, m), in its own unit, and its origin; an error of the pose that the rows
    declare is in it.

    ``origin`` is ``"declared"`` (sigma columns), ``"repeats"`` (pure error) or ``"unknown"``, in which case all
    readings weigh the same and the scale comes from the residuals.
    """

    sigma: Floats
    origin: str


def noise_of(data: Measurements) -> ReadingNoise:
    """The noise of each reading: declared where the file says, else from repeats, else unknown (one unit each)."""
    known: ReadingNoise | None = vars(data).get("_noise")
    if known is None:
        known = vars(data)["_noise"] = _with_poses(data, _of_readings(data))
    return known


def _with_poses(data: Measurements, noise: ReadingNoise) -> ReadingNoise:
    """The same with the errors of poses that the rows declare."""
    if not data.pose_sigma.any():
        return noise
    # an error of the pose that is declared alone is all the noise that is known
    alone = noise.origin == "unknown"
    sigma = np.hypot(np.where(alone & (data.pose_sigma > 0), 0.0, noise.sigma), data.pose_sigma)
    return ReadingNoise(sigma, "declared" if (data.pose_sigma > 0)[data.taken].all() else noise.origin)


def _of_readings(data: Measurements) -> ReadingNoise:
    """The noise without what repeats of a pose share."""
    sigma, needed = data.sigma, data.taken
    if (np.isfinite(sigma) | ~needed).all():
        return ReadingNoise(np.where(needed, sigma, 1.0), "declared")
    repeats = data.repeatability
    if repeats is not None:
        columns = np.full(len(data.layout.readings), np.nan)
        for k, name in enumerate(data.layout.readings):
            if repeats.degrees_of_freedom.get(name, 0) >= MIN_FREEDOM and repeats.sigma[name] > 0:
                columns[k] = repeats.sigma[name]
        filled = np.where(np.isfinite(sigma), sigma, columns)
        if np.isfinite(filled[needed]).all():
            return ReadingNoise(np.where(needed, filled, 1.0), "repeats")
    return ReadingNoise(np.ones_like(sigma), "unknown")


# -- Columns that stand in steps: how many digits a file has of them -----------------------------------------------

#: Different values from which steps can be read, so many that are looked at first, and how far values may stand beside
#: a step, in steps.
_FEWEST = 8
_FIRST = 256
_BESIDE = 0.01
#: The smallest difference between values may be this many steps.
_MOST_STEPS = 100


def step_of(values: Floats) -> float:
    """The largest step of which all differences between ``values`` (n,) are multiples; zero where there is none.

    Values that are no further apart than rounding are one.
    """
    apart = _apart(values[np.unique(np.linspace(0, len(values) - 1, min(len(values), _FIRST)).astype(np.int64))])
    if len(apart) < _FEWEST - 1:
        return 0.0
    every: Floats | None = None
    for several in range(1, _MOST_STEPS + 1):
        step = _fitted(apart, apart.min() / several)
        if _are_multiples(apart, step):
            every = _apart(values) if every is None else every
            if _are_multiples(every, step := _fitted(every, step)):
                return step
    return 0.0


def _apart(values: Floats) -> Floats:
    """Differences between neighbours among different values; such as are no further apart than rounding are one."""
    u = np.unique(values)
    apart = np.diff(u)
    return apart[apart > 1e-12 * max(abs(u[0]), abs(u[-1]))]


def _fitted(apart: Floats, step: float) -> float:
    """A step from the whole range, which tells it better than two values."""
    return float(apart.sum() / np.rint(apart / step).sum())


def _are_multiples(apart: Floats, step: float) -> bool:
    count = apart / step
    return bool((np.abs(count - np.rint(count)) < _BESIDE).all())
