"""Noise that rows share, of one pose or from one row to the next: the filter that takes it out, how much of it there
is; bases of columns."""

from __future__ import annotations

import math
from typing import Self

import numpy as np
import scipy

from ..base import linalg
from ..base.types import Floats, Ints
from .thresholds import DIFFERENCES, ROUNDING

#: Part of the noise that rows have in common at most: repeats that are equal but for rounding are no exact ones.
MOST_IN_COMMON = 1.0 - ROUNDING


class InCommon:
    """What takes out errors that rows have in common, as of where a marker sits: ``pose`` (n,) says which rows,
    ``size`` (n,) how large such an error is in each, in noises of its own; all is ``times`` as large after it."""

    def __init__(self, pose: Ints, size: Floats, times: float = 1.0) -> None:
        squares = np.bincount(pose, size**2)
        along = size / np.sqrt(np.where(squares > 0, squares, 1.0))[pose]
        n = len(pose)
        self._pose = pose
        self._poses = scipy.sparse.csr_array((along, (pose, np.arange(n))), shape=(len(squares), n))
        self._whole, self.times = np.sqrt(1.0 + squares), times

    @classmethod
    def part(cls, pose: Ints, part: float) -> Self:
        """Of a part of the noise's variance, the same in all rows; every row keeps its own. What repeats differ by is
        never nothing."""
        rows, part = np.unique(pose, return_inverse=True)[1].ravel(), min(part, MOST_IN_COMMON)
        return cls(rows, np.full(len(rows), math.sqrt(part / (1.0 - part))), 1.0 / math.sqrt(1.0 - part))

    @property
    def log_determinant(self) -> float:
        """Logarithm of the filter's determinant."""
        return len(self._pose) * math.log(self.times) - float(np.log(self._whole).sum())

    def __call__(self, values: Floats) -> Floats:
        """Values (n, …) without them: the filter is its own transpose."""
        return self._along(values, 1.0 / self._whole) * self.times

    def back(self, values: Floats) -> Floats:
        """Values (n, …) with them again."""
        return self._along(values, self._whole) / self.times

    def _along(self, values: Floats, times: Floats) -> Floats:
        flat = values.reshape(len(values), -1)
        return np.asarray(flat + self._poses.T @ ((times - 1.0)[:, None] * (self._poses @ flat))).reshape(values.shape)


class Whitening:
    """The AR(1) filter along the first axis; every row keeps its variance. What rows have ``in_common`` is taken apart
    before.

    ``lag`` (n,) is how many rows of the run lie between a row and the one before it here (1 where it follows at once):
    across a gap the correlation is ``rho`` to that power. A row of the result is ``here`` times its own value and
    ``before`` times that of the row before it, (n,) each. ``back`` (n,) is how many rows further up that one stands, 0
    where there is none: those of several targets, read in turn, each follow their own. Left out, it is the next.
    """

    def __init__(self, rho: float, lag: Ints, back: Ints | None = None, in_common: InCommon | None = None) -> None:
        self.rho, self.lag, self.back, self.in_common = rho, lag, back, in_common
        carried = np.sign(rho) ** lag * np.abs(rho) ** lag
        #: Rows that follow another, and those that they follow.
        self.late: slice | Ints = slice(1, None)
        self.early: slice | Ints = slice(None, -1)
        if back is None:
            carried[:1] = 0.0
        else:
            carried[back == 0] = 0.0
            self.late = np.flatnonzero(back)
            self.early = self.late - back[self.late]
        self.here = 1.0 / np.sqrt(1.0 - carried**2)
        self.before = -carried * self.here

    @classmethod
    def none(cls, rows: int) -> Self:
        """What leaves so many rows as they are."""
        return cls(0.0, np.ones(rows, dtype=np.int64))

    @property
    def is_plain(self) -> bool:
        """Whether it leaves everything as it is."""
        return self.rho == 0.0 and self.in_common is None

    def with_rho(self, rho: float) -> Whitening:
        """The same rows with another correlation."""
        return Whitening(rho, self.lag, self.back, self.in_common)

    def with_common(self, in_common: InCommon) -> Whitening:
        """The same rows with errors in common that are taken out before."""
        return Whitening(self.rho, self.lag, self.back, in_common)

    @property
    def log_determinant(self) -> float:
        """Logarithm of the filter's determinant."""
        return float(np.log(self.here).sum()) + (0.0 if self.in_common is None else self.in_common.log_determinant)

    def __call__(self, values: Floats) -> Floats:
        """Values (n, …) filtered."""
        return self.in_time(values if self.in_common is None else self.in_common(values))

    def in_time(self, values: Floats) -> Floats:
        """Values (n, …) that have nothing in common, filtered in time."""
        if self.rho == 0.0:
            return values
        shape = (-1,) + (1,) * (values.ndim - 1)
        out = values * self.here.reshape(shape)
        out[self.late] += values[self.early] * self.before[self.late].reshape(shape)
        return out

    def transposed(self, values: Floats) -> Floats:
        """The transpose of the filter on values (n, …): products with filtered columns are products with these."""
        out = values
        if self.rho != 0.0:
            shape = (-1,) + (1,) * (values.ndim - 1)
            out = values * self.here.reshape(shape)
            out[self.early] += values[self.late] * self.before[self.late].reshape(shape)
        return out if self.in_common is None else self.in_common(out)


def whiten(values: Floats, rho: float, back: Ints | None = None) -> Floats:
    """Values (n, …) under :class:`Whitening`, each row following at once."""
    return Whitening(rho, np.ones(len(values), dtype=np.int64), back)(values)


def orthonormal(columns: Floats, tolerance: float = 1e-9) -> Floats:
    """An orthonormal basis (n·m, rank) of columns (n, m, p) or (N, p), scaled to unit length first."""
    flat = columns.reshape(math.prod(columns.shape[:-1]), columns.shape[-1])
    norm = np.linalg.norm(flat, axis=0)
    flat = flat[:, norm > 0] / norm[norm > 0]
    if flat.shape[1] == 0:
        return flat
    # the small Gram matrix decides on rank, a second pass restores orthogonality
    for _ in range(2):
        value, vector = linalg.eigh(flat.T @ flat)
        keep = value > max(tolerance**2, 1e-14) * value[-1]
        flat = flat @ (vector[:, keep] / np.sqrt(value[keep]))
    return flat


def independent(columns: Floats, tolerance: float = DIFFERENCES) -> Floats:
    """An orthonormal basis (N, rank) of columns (N, p), whichever their order and units.

    Rank is decided by the singular values of the triangle, which keeps every length to the last digits: a Gram matrix
    keeps half of them, and which of two columns that are nearly one it drops then hangs on which came first.
    """
    length = np.linalg.norm(columns, axis=0)
    flat = columns[:, length > 0] / length[length > 0]
    if not flat.shape[1]:
        return flat
    _, value, turn = linalg.svd(linalg.triangle(flat) if len(flat) > flat.shape[1] else flat, full_matrices=False)
    keep = value > tolerance * value[0]
    q = flat @ (turn[keep].T / value[keep])
    # a direction that was divided by a small number is orthonormal to few digits only
    return linalg.qr(q)[0] if len(q) >= q.shape[1] else q


def correlation_in_time(residual: Floats, basis: Floats, back: Ints | None = None) -> float:
    """ρ of AR(1) noise, from residuals (n, m) in the order of time after an orthonormal ``basis`` (n·m, k) was
    projected out; ``back`` as :class:`Whitening` has it.

    The rows must be all of a run. What projection alone does to neighbours is taken out (restricted estimate), and the
    estimate is repeated on filtered rows. Zero where it is within two standard errors of it.
    """
    n, m = residual.shape
    order = Whitening(0.0, np.ones(n, dtype=np.int64), back)
    pairs = len(residual[order.late])
    if not pairs:
        return 0.0
    # what is read in turn at one place may err together: of several targets no more is known than of one
    in_turn = 1.0 if back is None else float(back[back > 0].mean())
    rho, least = 0.0, 2.0 * np.sqrt(in_turn / (n * m))
    for _ in range(4):
        e = whiten(residual, rho, back)
        q = basis if rho == 0.0 or not basis.shape[1] else orthonormal(whiten(basis.reshape(n, m, -1), rho, back))
        flat = e.reshape(-1)
        flat = flat - q @ (q.T @ flat)
        left = flat.reshape(n, m)
        free = n * m - q.shape[1]
        if free <= 10 or not left.any():
            return 0.0
        variance = float((left**2).sum()) / free
        # winsorised, so that single outliers do not decide
        limit = 4.0 * np.sqrt(variance)
        left = np.clip(left, -limit, limit)
        variance = float((left**2).sum()) / free
        qq = q.reshape(n, m, -1)
        bias = -float((qq[order.late] * qq[order.early]).sum())
        lagged = float((left[order.late] * left[order.early]).sum()) / variance - bias
        step = lagged / (pairs * m * max(free / (n * m), 0.05))
        # filters in a row: their first-order terms add
        first = rho == 0.0
        rho = float(np.clip(rho + step * (1 - rho * rho), -0.95, 0.95))
        # what is less than one standard error at first will not be two in the end
        if abs(step) < 1e-3 or (first and abs(rho) < least / 2):
            break
    return rho if abs(rho) > least else 0.0
