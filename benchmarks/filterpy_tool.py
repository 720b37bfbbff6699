"""The paper's filters of the flexible tool as a user would write them on filterpy: Eqs. 8 to 14 of the tool paper.

All that does not depend on the state is computed beforehand for the whole run, in NumPy: what the gratings say of force
and depth, how the tool moved. A step is filterpy's own predict and update, of the depth and then of the tip.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from filterpy.kalman import KalmanFilter
from numpy.typing import NDArray

Floats = NDArray[np.float64]

LENGTH_MM, STIFFNESS = 60.0, 3.39e6 / 3.0
DISTANCES_MM = np.array([40.0, 50.0])
ANGLES = 2 * np.pi / 3 * np.arange(3)
GAINS = np.tile(3200.0 * np.stack([np.cos(ANGLES), np.sin(ANGLES)]), (2, 1, 1))
REFERENCE_NM = np.full(9, 1550.0)
NOISE_NM = 1e-3
DT_S = 0.005
START_MM, START_MM2 = 10.0, 1.0


@dataclass(frozen=True)
class Run:
    """A recorded run: poses (n, 12) of the tool, rotation by rows and place, and wavelengths (n, 9)."""

    times_s: Floats
    poses: Floats
    wavelengths_nm: Floats


def recorded(n: int, seed: int = 0) -> Run:
    """A run of 200 Hz in which the force comes and goes."""
    random = np.random.default_rng(seed)
    times = DT_S * np.arange(1, n + 1)
    c, s, zero, one = np.cos(0.2 * times), np.sin(0.2 * times), np.zeros(n), np.ones(n)
    deeper = 3 * np.sin(0.5 * times)
    poses = np.stack([c, -s, zero, s, c, zero, zero, zero, one, np.sin(times), np.cos(times), deeper], axis=1)
    size = 120 * np.maximum(0, np.sin(0.7 * times))
    forces = np.stack([size * c, size * s], axis=1)
    arms = DISTANCES_MM - (START_MM + deeper)[:, None]
    shifts = np.einsum("sfa,ns,na->nsf", np.linalg.pinv(GAINS), arms, forces)
    waves = np.tile(REFERENCE_NM, (n, 1)) + NOISE_NM * random.normal(size=(n, 9))
    waves[:, :6] += shifts.reshape(n, 6)
    return Run(times, poses, waves)


class PaperFilters:
    """filterpy's filters with the paper's noise."""

    def __init__(self, run: Run) -> None:
        n = len(run.times_s)
        shifts = (run.wavelengths_nm - REFERENCE_NM).reshape(n, 3, 3)[:, :2]
        shifts = shifts - shifts.mean(axis=2, keepdims=True)
        moments = np.einsum("saf,nsf->nsa", GAINS, shifts)
        self.force = (moments[:, 1] - moments[:, 0]) / (DISTANCES_MM[1] - DISTANCES_MM[0])
        size = np.linalg.norm(self.force, axis=1)
        self.measured = DISTANCES_MM[1] - np.linalg.norm(moments[:, 1], axis=1) / size
        rotations, places = run.poses[:, :9].reshape(n, 3, 3), run.poses[:, 9:]
        self.moved = np.diff(places, axis=0, prepend=places[:1])
        axes = np.concatenate([rotations[:1, :, 2], rotations[:-1, :, 2]])
        self.deeper = np.einsum("ni,ni->n", self.moved, axes)
        self.back = np.ascontiguousarray(rotations.transpose(0, 2, 1))
        # where the unbent tip is in the tool's frame, were it turned alone
        self.unbent = np.einsum("nij,nj->ni", self.back, places)
        small = size < 50
        self.of_depth = np.where(small, 1e6, 0.005)
        self.of_tip = np.where(small[:, None, None], np.diag([10, 10, 0.0]), np.diag([0.002, 0.002, 0.0]))
        self.depth = KalmanFilter(dim_x=1, dim_z=1, dim_u=1)
        self.tip = KalmanFilter(dim_x=3, dim_z=3, dim_u=3)
        starts = ((self.depth, np.array([START_MM]), 0.0025), (self.tip, places[0].copy(), 0.01))
        for one, start, per_step in starts:
            size_of = np.eye(len(start))
            one.x, one.P, one.F, one.B, one.Q = start, START_MM2 * size_of, size_of, size_of, per_step * size_of
        self.depth.H = np.eye(1)

    def step(self, i: int) -> None:
        self.depth.predict(u=self.deeper[i : i + 1])
        self.depth.update(self.measured[i], R=self.of_depth[i])
        d = float(self.depth.x[0])
        a = LENGTH_MM - d
        bend = a**3 / (3 * STIFFNESS) + a**2 * d / (2 * STIFFNESS)
        z = self.unbent[i].copy()
        z[:2] += bend * self.force[i]
        self.tip.predict(u=self.moved[i])
        self.tip.update(z, R=self.of_tip[i], H=self.back[i])

    def whole(self) -> Floats:
        """Estimates of all steps: depth, tip (n, 4)."""
        out = np.empty((len(self.force), 4))
        for i in range(len(out)):
            self.step(i)
            out[i, 0], out[i, 1:] = self.depth.x[0], self.tip.x
        return out
