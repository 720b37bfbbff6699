"""What to measure next: the poses that tell tied models apart best.

T-optimality (Atkinson and Fedorov, "The design of experiments for discriminating between two rival models", 1975):
take the first model as fitted for true, and look for poses where the best refit of the rival still misses it most.
Poses are chosen one after another. The new rows are measured after the run, so time goes on; that alone separates a
cause in time from one in space where the run had mixed them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..data import Measurements
from ..errors import FitError
from ..fit.identify import Fit
from ..types import Floats

MOST = 12
_PAUSE_S = 600.0
_SECONDS_PER_POSE = 3.0


def next_poses(true: Fit, rivals: list[Fit], sigma: Floats, most: int = MOST) -> tuple[dict[str, float], ...]:
    """Up to ``most`` reachable poses in the order to measure them, each with the separation that is reached with it.

    ``separation_sigma`` is how far the rival that comes nearest, refitted to everything, is still from the true model,
    in standard deviations. Empty where nothing separates them.
    """
    grid = true.model.reachable(true.data, true.values)
    if grid is None or not rivals:
        return ()
    poses, rows = grid
    # the same poses at each later moment at which they could be measured
    later = [_at(rows, true, k) for k in range(most)]
    try:
        told = [true.model.predict(one, true.values) for one in later]
        problems = [_Problem(true, rival, later, told, sigma) for rival in rivals]
    except FitError:
        return ()
    chosen: list[int] = []
    out = []
    for k in range(most):
        scores = np.min([p.scores(k) for p in problems], axis=0)
        scores[chosen] = -1.0
        best = int(np.argmax(scores))
        if not scores[best] > 0:
            break
        chosen.append(best)
        for p in problems:
            p.add(best, k)
        separation = float(np.sqrt(max(min(p.distance for p in problems), 0.0)))
        names = true.data.layout.coordinates
        out.append({**dict(zip(names, poses[best].tolist(), strict=True)), "separation_sigma": separation})
    return tuple(out)


class _Problem:
    """One rival: its normal equations with the old rows, and what each new pose would add.

    ``later`` are the rows of the poses at each moment, ``told`` what the true model says of them.
    """

    def __init__(
        self, true: Fit, rival: Fit, later: Sequence[Measurements], told: Sequence[Floats], sigma: Floats
    ) -> None:
        count = later[0].coordinates
        sigma = sigma[:count]
        data = rival.data
        used = data.used[:, :count]
        old = rival.model.derivatives(data, rival.values)[:, :count]
        old = np.where(used[:, :, None], old / sigma[:, None], 0.0)
        scale = np.linalg.norm(old.reshape(-1, old.shape[2]), axis=0)
        self.scale = np.where(scale > 0, scale, 1.0)
        flat = old.reshape(-1, old.shape[2]) / self.scale
        apart = (true.model.predict(data, true.values) - rival.predicted)[:, :count]
        apart = np.where(used, apart / sigma, 0.0).reshape(-1)
        self.gram = flat.T @ flat
        self.right = flat.T @ apart
        self.square = float(apart @ apart)
        self.distance = 0.0
        self.new = []
        for rows, there in zip(later, told, strict=True):
            columns = rival.model.derivatives(rows, rival.values)[:, :count] / sigma[:, None] / self.scale
            self.new.append((columns, (there - rival.model.predict(rows, rival.values))[:, :count] / sigma))

    def scores(self, k: int) -> Floats:
        """Distance of the refitted rival from the true model once each pose is added as the k-th."""
        columns, away = self.new[k]
        value, vector = np.linalg.eigh(self.gram)
        keep = value > 1e-10 * value[-1]
        root = vector[:, keep] / np.sqrt(value[keep])
        rest = vector[:, ~keep]
        x = root @ (root.T @ self.right)
        miss = away - columns @ x
        # directions that the old rows do not observe must not count as separation: they are free to fit
        free = columns @ rest
        spread = columns @ root
        covariance = (
            np.eye(columns.shape[1]) + spread @ spread.transpose(0, 2, 1) + 1e8 * free @ free.transpose(0, 2, 1)
        )
        gained = np.einsum("na,na->n", miss, np.linalg.solve(covariance, miss[:, :, None])[:, :, 0])
        return gained + self.square - float(self.right @ x)

    def add(self, pose: int, k: int) -> None:
        """Takes a pose into the data."""
        columns, away = self.new[k][0][pose], self.new[k][1][pose]
        self.gram += columns.T @ columns
        self.right += columns.T @ away
        self.square += float(away @ away)
        value, vector = np.linalg.eigh(self.gram)
        keep = value > 1e-10 * value[-1]
        root = vector[:, keep] / np.sqrt(value[keep])
        x = root @ (root.T @ self.right)
        self.distance = self.square - float(self.right @ x)


def _at(rows: Measurements, fit: Fit, k: int) -> Measurements:
    """The rows at the moment at which the k-th new pose would be measured: after a pause."""
    if fit.data.time_s is None:
        return rows
    end = float(fit.data.time_s.max())
    return replace(rows, time_s=np.full(len(rows), end + _PAUSE_S + k * _SECONDS_PER_POSE))
