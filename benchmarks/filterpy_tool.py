"""The tip filter of the flexible tool as a user would write it on filterpy: Eqs. 10 to 14 of the tool paper.

All that does not depend on the state is computed beforehand for the whole run, in NumPy; a step is filterpy's own
predict and update.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from filterpy.kalman import KalmanFilter
from numpy.typing import NDArray

Floats = NDArray[np.float64]

LENGTH_MM, STIFFNESS = 60.0, 3.39e6 / 3.0
DT_S = 0.005


@dataclass(frozen=True)
class Run:
    """A recorded run: force, depth, and where the robot has the unbent tip."""

    times_s: Floats
    velocities_mm_s: Floats
    rotations: Floats
    shifts_mm: Floats
    depths_mm: Floats
    forces_mN: Floats


def recorded(n: int, seed: int = 0) -> Run:
    """A run of 200 Hz in which the force comes and goes."""
    random = np.random.default_rng(seed)
    times = DT_S * np.arange(1, n + 1)
    c, s, zero, one = np.cos(0.2 * times), np.sin(0.2 * times), np.zeros(n), np.ones(n)
    shifts = np.stack([np.sin(times), np.cos(times), 3 * np.sin(0.5 * times)], axis=1)
    size = 120 * np.maximum(0, np.sin(0.7 * times))
    forces = np.stack([size * c, size * s], axis=1) + random.normal(size=(n, 2))
    return Run(
        times,
        np.gradient(shifts, DT_S, axis=0) + 0.1 * random.normal(size=(n, 3)),
        np.stack([c, -s, zero, s, c, zero, zero, zero, one], axis=1).reshape(n, 3, 3),
        shifts,
        10 + 3 * np.sin(0.5 * times),
        forces,
    )


class TipFilter:
    """filterpy's filter with the paper's noise."""

    def __init__(self, run: Run) -> None:
        a = LENGTH_MM - run.depths_mm
        bend = a**3 / (3 * STIFFNESS) + a**2 * run.depths_mm / (2 * STIFFNESS)
        deflection = np.column_stack([run.forces_mN * bend[:, None], np.zeros(len(a))])
        self.back = np.ascontiguousarray(run.rotations.transpose(0, 2, 1))
        # what is measured, where the tip's coordinates are turned into the tool's frame
        self.z = deflection + np.einsum("nij,nj->ni", self.back, run.shifts_mm)
        small = np.linalg.norm(run.forces_mN, axis=1) < 50
        self.r = np.where(small[:, None, None], np.diag([10, 10, 0.0]), np.diag([0.002, 0.002, 0.0]))
        self.u = run.velocities_mm_s
        self.filter = KalmanFilter(dim_x=3, dim_z=3, dim_u=3)
        self.filter.x = run.shifts_mm[0].copy()
        self.filter.P = np.eye(3)
        self.filter.F = np.eye(3)
        self.filter.B = DT_S * np.eye(3)
        self.filter.Q = 0.01 * np.eye(3)

    def step(self, i: int) -> None:
        self.filter.predict(u=self.u[i])
        self.filter.update(self.z[i], R=self.r[i], H=self.back[i])

    def whole(self) -> Floats:
        """Estimates of all steps."""
        out = np.empty((len(self.z), 3))
        for i in range(len(out)):
            self.step(i)
            out[i] = self.filter.x
        return out
