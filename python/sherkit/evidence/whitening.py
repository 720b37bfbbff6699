"""Noise that carries over from row to row: the filter that takes it out, how much of it there is; bases of columns."""

from __future__ import annotations

import math
from typing import Self

import numpy as np

from ..base import linalg
from ..base.types import Floats, Ints


class Whitening:
    """The AR(1) filter along the first axis; every row keeps its variance.

    ``lag`` (n,) is how many rows of the run lie between a row and the one before it here (1 where it follows at once):
    across a gap the correlation is ``rho`` to that power. A row of the result is ``here`` times its own value and
    ``before`` times that of the row before it, (n,) each. ``back`` (n,) is how many rows further up that one stands, 0
    where there is none: those of several targets, read in turn, each follow their own. Left out, it is the next.
    """

    def __init__(self, rho: float, lag: Ints, back: Ints | None = None) -> None:
        self.rho, self.lag, self.back = rho, lag, back
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
        return self.rho == 0.0

    def __call__(self, values: Floats) -> Floats:
        """Values (n, …) filtered."""
        if self.rho == 0.0:
            return values
        shape = (-1,) + (1,) * (values.ndim - 1)
        out = values * self.here.reshape(shape)
        out[self.late] += values[self.early] * self.before[self.late].reshape(shape)
        return out

    def transposed(self, values: Floats) -> Floats:
        """The transpose of the filter on values (n, …): products with filtered columns are products with these."""
        if self.rho == 0.0:
            return values
        shape = (-1,) + (1,) * (values.ndim - 1)
        out = values * self.here.reshape(shape)
        out[self.early] += values[self.late] * self.before[self.late].reshape(shape)
        return out


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


#: Part of the largest singular value, of columns of unit length, below which a direction is rounding: derivatives that
#: are differences carry eight digits.
_ROUNDING = 1e-7


def independent(columns: Floats, tolerance: float = _ROUNDING) -> Floats:
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
