"""Errors that are another one at each pose: told from noise by poses that are read more than once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..base.types import Floats, Ints
from ..evidence.base import Base, total
from ..evidence.thresholds import SCALES

#: What has no shape that these poses could tell: another error at each of them, the same when it is read once more; and
#: the logarithm of its weight.
ROUGH, ROUGH_WEIGHT = "something finer than these poses", float(np.log(0.01))


@dataclass(frozen=True)
class Agreement:
    """How a residual divides: what it leaves ``between`` poses and ``within`` them, from reading to reading, with
    degrees of freedom; a pose has ``times`` readings on average."""

    between: float
    within: float
    between_free: int
    within_free: int
    times: float

    @classmethod
    def of(cls, residual: Floats, pose: Ints, free: int) -> Agreement:
        """Of a residual (N,) of ``free`` degrees of freedom, by the numbers (N,) of poses."""
        count = np.bincount(pose)
        poses = int(np.count_nonzero(count))
        within = residual - (np.bincount(pose, residual) / np.maximum(count, 1))[pose]
        squares = float(within @ within)
        within_free = len(pose) - poses
        left = max(float(residual @ residual) - squares, 0.0)
        return cls(left, squares, free - within_free, within_free, len(pose) / max(poses, 1))

    @property
    def log_bf(self) -> float:
        """The logarithm of the Bayes factor of an error of its own at each pose, against noise alone.

        Where errors of poses have a variance of τ² noises, what is left between poses is χ² of 1 + τ² ``times`` the
        noise, and what is left within them of the noise alone: the lack-of-fit test of the field (Draper and Smith,
        *Applied Regression Analysis*, 1998, 2.1), with a prior on τ so that it may be looked at as often as one likes.
        """
        if self.within_free <= 0 or self.between_free <= 0 or not (self.between > 0 and self.within > 0):
            return 0.0
        grown = 1.0 + np.square(SCALES) * self.times
        ratios = (self.between + self.within) / (self.between / grown + self.within)
        free = self.between_free + self.within_free
        each = -0.5 * self.between_free * np.log(grown) + 0.5 * free * np.log(ratios)
        return total(each) - float(np.log(len(SCALES)))


def agreement_of(base: Base) -> Agreement:
    """How what a model leaves divides."""
    m = base.family.run.axes
    each = base.family.run.poses[:, None] * m + np.arange(m)
    return Agreement.of(base.residual, each.ravel(), base.free)


def rough_of(base: Base) -> float:
    """The logarithm of weight times Bayes factor of another error at each pose."""
    return agreement_of(base).log_bf + ROUGH_WEIGHT
