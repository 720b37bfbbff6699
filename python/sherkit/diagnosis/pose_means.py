"""The mean of each pose taken out of columns under a filter in time."""

from __future__ import annotations

import numpy as np
import scipy

from ..base import linalg
from ..base.types import Floats, Ints
from .linearised import Whitening, orthonormal

#: The most that an instrument's readings have in common from row to row; rounds in which it settles; slow is what takes
#: more rows than this for one swing, of at most so many.
_COMMON, _ROUNDS, _ROWS, _LINES = 0.8, 5, 30, 30
#: Pairs of rows without which nothing is estimated.
_LEAST = 30


def in_common(left: Floats, accepted: Floats, pose: Ints, lag: Ints) -> Whitening:
    """The filter in time: what neighbours of (n, m) have in common beside the means of poses and all that is slow, by
    restricted likelihood to first order as :func:`~.linearised.correlation_in_time` has it."""
    n, m = left.shape
    lines = np.cos(np.pi * np.linspace(0.0, 1.0, n)[:, None] * np.arange(1, min(n // _ROWS, _LINES) + 1))
    slow = orthonormal(np.concatenate([lines, accepted], axis=1), 1e-6)
    next_to = np.flatnonzero(lag[1:] == 1)
    rho = 0.0
    for _ in range(_ROUNDS if len(next_to) > _LEAST else 0):
        without = Means(pose, Whitening(rho, lag))
        basis = orthonormal(without(slow), 1e-6)
        e = without(left)
        e = e - basis @ (basis.T @ e)
        free = n - without.count - basis.shape[1]
        variance = float((e**2).sum()) / max(free * m, 1)
        if free <= 10 or variance <= 0:
            return Whitening(0.0, lag)
        taken = without.neighbours(next_to) + float((basis[next_to] * basis[next_to + 1]).sum())
        lagged = float((e[next_to] * e[next_to + 1]).sum()) / variance + m * taken
        step = lagged / (len(next_to) * m * max(free / n, 0.05))
        before, rho = rho, float(np.clip(rho + step * (1.0 - rho * rho), -_COMMON, _COMMON))
        # within two standard errors there is none
        if abs(rho - before) < 1e-3 or abs(rho) < 2.0 / np.sqrt(free * m):
            break
    return Whitening(rho if abs(rho) > 2.0 / np.sqrt(n * m) else 0.0, lag)


class Means:
    """Takes the mean of each pose out of columns (n, k) and filters them in time: what the means leave there."""

    def __init__(self, pose: Ints, filtered: Whitening) -> None:
        self.pose, self.filtered = pose, filtered
        self.size = np.bincount(pose)
        self.count = len(self.size)
        if filtered.rho != 0.0:
            n = len(pose)
            here = scipy.sparse.csr_matrix((filtered.here, (np.arange(n), pose)), (n, self.count))
            before = scipy.sparse.csr_matrix((filtered.before[1:], (np.arange(1, n), pose[:-1])), (n, self.count))
            self.means = (here + before).tocsr()
            gram = (self.means.T @ self.means).toarray()
            # poses whose rows the filter makes alike share a mean
            gram[np.diag_indices(self.count)] *= 1.0 + 1e-10
            self.inverse = linalg.inv(gram)

    def __call__(self, columns: Floats) -> Floats:
        """Columns (n, k) filtered, without the means."""
        out = self.filtered(columns)
        if self.filtered.rho == 0.0:
            return out - means_of(out, self.pose)
        return np.asarray(out - self.means @ (self.inverse @ (self.means.T @ out)))

    def neighbours(self, rows: Ints) -> float:
        """Sum of the projection on the means between these rows and those after them."""
        if self.filtered.rho == 0.0:
            return float((1.0 / self.size[self.pose[rows]])[self.pose[rows] == self.pose[rows + 1]].sum())
        first, second = self.means[rows], self.means[rows + 1]
        return float((first @ self.inverse * second.toarray()).sum())


def means_of(values: Floats, pose: Ints) -> Floats:
    """The mean of each row's pose, of values (n, k)."""
    n = len(pose)
    of_pose = scipy.sparse.csr_matrix((np.ones(n), (pose, np.arange(n))), (int(pose.max()) + 1, n))
    mean = (of_pose @ values) / np.bincount(pose)[:, None]
    return np.asarray(mean[pose])
