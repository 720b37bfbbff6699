"""What would have been found: silence without power is no answer."""

from __future__ import annotations

import numpy as np
import scipy

from .lack_of_fit import rising_root, z_score
from .stage import Candidate, Stage

POWER = 0.8


def noncentrality(threshold: float, rank: int, free: int) -> float:
    """Sum of squares, in units of the noise, with which ``rank`` columns pass a deviate of ``threshold`` in 80 %.

    Noncentral χ², since the degrees of freedom of the residual are many.
    """
    # the gain at which the z score reaches the threshold
    total = float(free)

    def excess(gain: float) -> float:
        return float(z_score(np.array(gain), np.array(rank), total, free)) - threshold

    high = total * 0.999
    if excess(high) < 0:
        return float("inf")
    gain = rising_root(excess, 1e-9, high)
    return rising_root(lambda nc: 1.0 - scipy.special.chndtr(gain, rank, nc) - POWER, 0.0, 4.0 * gain + 200.0)


def smallest_found(stage: Stage, candidate: Candidate, threshold: float) -> tuple[float, float]:
    """The effect that would have been found with 80 % power: in plausible sizes, and as the RMS of what it leaves.

    All parameters at a random sign of the same multiple of their plausible sizes.
    """
    size = np.array([p.size for p in candidate.effect.parameters])
    if candidate.columns.functions:
        # a step's function was centred and scaled to unit length: one plausible step is this much of it
        size = size / stage.sigma * np.sqrt(stage.scan.n / 4.0)
    needed = noncentrality(threshold, len(size), stage.scan.free)
    at_size = float(np.diag(stage.scan.of(candidate.columns).gram) @ size**2)
    if at_size <= 0:
        return float("inf"), float("inf")
    times = float(np.sqrt(needed / at_size))
    rms = float(np.sqrt(needed / (stage.scan.n * stage.scan.m)) * np.sqrt(np.mean(stage.sigma**2)))
    return times, rms * stage.run.per_row
