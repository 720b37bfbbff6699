"""Measurement noise of the sensor."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from .geometry import Array


@dataclass(frozen=True)
class Noise:
    """Noise added to the readings; every option composes with the others.

    ``sigma_mm``: sd per axis (one value or three) on the robot's axis of symmetry.
    ``rim_factor``: sd at the workspace radius over sd on the axis, growing linearly between.
    ``student``: Student t(3) innovations scaled to the same sd instead of gaussian ones.
    ``rho``: AR(1) correlation from one row to the next in time, on each axis by itself.
    ``outlier_fraction`` of the rows get a jump in a random direction, of a size uniform in
    ``outlier_sigmas`` times sd.
    """

    sigma_mm: float | tuple[float, float, float] = 0.0
    rim_factor: float = 1.0
    student: bool = False
    rho: float = 0.0
    outlier_fraction: float = 0.0
    outlier_sigmas: tuple[float, float] = (20.0, 50.0)

    def draw(self, rng: np.random.Generator, points: Array, time_s: Array, workspace_radius: float) -> Array:
        """Noise (n, 3), mm, for readings taken at ``points`` (n, 3), mm."""
        n = len(points)
        # t(3) has variance 3.
        unit = rng.standard_t(3, (n, 3)) / np.sqrt(3) if self.student else rng.normal(size=(n, 3))
        if self.rho:
            order = np.argsort(time_s, kind="stable")
            fresh = np.sqrt(1 - self.rho**2)
            # The first row keeps full variance: the process is stationary from the start.
            for before, now in pairwise(order):
                unit[now] = self.rho * unit[before] + fresh * unit[now]
        outliers = rng.choice(n, round(self.outlier_fraction * n), replace=False)
        jump = rng.normal(size=(len(outliers), 3))
        jump /= np.linalg.norm(jump, axis=1, keepdims=True)
        unit[outliers] += jump * rng.uniform(*self.outlier_sigmas, (len(outliers), 1))
        rim = np.hypot(points[:, 0], points[:, 1]) / workspace_radius
        return unit * np.asarray(self.sigma_mm) * (1 + (self.rim_factor - 1) * rim)[:, None]
