"""Whether a sensor stands where it is known to.

What is known of its pose is a prior, which readings contradict where both together are less likely than chance (a prior
predictive check: Box, "Sampling and Bayes' inference in scientific modelling and robustness", 1980). Then either it
stands elsewhere, or it takes up what the model lacks.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from ..base import linalg
from ..base.types import Floats
from ..model.sensor_pose import POSE, SHIFTS, TURNS
from .identify import Fit

#: A known pose is contradicted where chance would do as much in one run of so many.
_LEVEL = 1e-4
#: Directions of which readings tell less than this part of what is known already contradict nothing.
_TELLS = 0.01


@dataclass(frozen=True)
class KnownStand:
    """How far a fit has a sensor, as it is ``called``, from where it is known to stand: shift, mm, and turn, degrees,
    each with how well that is known (0 where it is not), and how likely that is (``p``: χ² of as many directions as the
    readings tell)."""

    shift_mm: float
    shift_sd_mm: float
    turn_deg: float
    turn_sd_deg: float
    p: float
    called: str

    @property
    def holds(self) -> bool:
        """Whether chance would do as much."""
        return self.p > _LEVEL

    def __str__(self) -> str:
        each = ((self.shift_mm, self.shift_sd_mm, " mm"), (self.turn_deg, self.turn_sd_deg, "°"))
        told = [
            (f"{off:.0f}{unit}" if off >= 100.0 else f"{off:.2g}{unit}", f"± {sd:.2g}{unit}")
            for off, sd, unit in each if sd > 0
        ]  # fmt: skip
        off, known = zip(*told, strict=True)
        return f"{' and '.join(off)} from where the robot's file has it, known within {' and '.join(known)}"


def known_stand(fit: Fit) -> KnownStand | None:
    """How far the sensor is from where it is known to stand; None where nothing is known of it that readings tell.

    With ``z`` (k,) the values in what is known of them and ``c`` an eigenvalue of their covariance there, readings
    weigh ``a = r² (1/c - 1)`` along its direction, by noise that is ``r`` times as large as it was taken for. If the
    sensor stands as well as is known, ``z`` has the variance ``(a/(1 + a))² (1 + r²/a)`` there.
    """
    named = [(k, p) for k, p in enumerate(fit.parameters) if p.known and p.name in POSE]
    if not named:
        return None
    at, sd = np.array([k for k, _ in named]), np.array([p.size for _, p in named])
    z = fit.values[at] / sd
    covariance = (fit.covariance + fit.unobserved_covariance)[np.ix_(at, at)] / np.outer(sd, sd)
    c, directions = linalg.eigh(covariance)
    ratio = float(fit.scale) ** 2
    a = ratio * (1.0 / c.clip(1e-300, 1.0) - 1.0)
    told = a > _TELLS
    if not told.any():
        return None
    a = a[told]
    along = directions[:, told].T @ z
    square = float((along**2 / ((a / (1.0 + a)) ** 2 * (1.0 + ratio / a))).sum())
    off, known = dict.fromkeys(POSE, 0.0), dict.fromkeys(POSE, 0.0)
    for k, p in named:
        off[p.name], known[p.name] = float(fit.values[k]), p.size
    sizes = [float(np.linalg.norm([off[name] for name in part])) for part in (SHIFTS, TURNS)]
    sds = [max(known[name] for name in part) for part in (SHIFTS, TURNS)]
    return KnownStand(
        sizes[0], sds[0], float(np.rad2deg(sizes[1])), float(np.rad2deg(sds[1])),
        float(scipy.special.chdtrc(len(a), square)), "camera" if fit.data.layout.unit == "px" else "sensor",
    )  # fmt: skip


def off_stand(fit: Fit) -> Floats:
    """The values (p,) of a fit that have the sensor elsewhere than where it is known to stand; zero where they do not,
    or chance would do as much."""
    stand = known_stand(fit)
    if stand is None or stand.holds:
        return np.zeros(len(fit.values))
    return np.where([p.known and p.name in POSE for p in fit.parameters], fit.values, 0.0)
