"""Before rows are read: what a test of them would find, and which of the poses that could be measured tell most.

A pose is its columns (m, p) by what is free, over the noise of its readings. Three things are asked of poses, chosen
one after another: how well all that is free becomes known (D-optimal designs: Fedorov, *Theory of Optimal Experiments*,
1972, found by exchange: Cook and Nachtsheim, Technometrics 1980), how much of one thing more they show beside it
(D_s-optimal: Atkinson, Donev and Tobias, 2007), and how far a rival that is fitted anew stays from what is true
(T-optimal: Atkinson and Fedorov, "The design of experiments for discriminating between two rival models", 1975).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy

from ..base import linalg
from ..base.types import Bools, Floats
from .thresholds import ROUNDING

#: What is so much larger than noise is found.
_LARGEST = 1e5
#: Directions in which the numbers of an effect may lie.
_DIRECTIONS = 256
#: Rounds of exchanges.
_ROUNDS = 50
#: Variance of a direction that is not observed.
_FREE = 1e8


def squares_of(left: Floats) -> Floats:
    """Squares (d,), in squared noises, that are left of an effect whose numbers have their plausible sizes in the mean
    of squares, in directions that are all as likely; ``left`` (k, k) are the products of its columns at these sizes.

    Of one number there is one. What has its numbers along what the fit takes is found at a far larger size, so that a
    size that is found in the mean of directions is no mean of squares.
    """
    k = len(left)
    if k < 2:
        return np.diag(left)
    to = np.random.default_rng(0).normal(size=(_DIRECTIONS, k))
    to *= np.sqrt(k) / np.linalg.norm(to, axis=1, keepdims=True)
    return np.asarray(np.einsum("dk,kl,dl->d", to, left, to).clip(0.0))


def power(squares: Floats | float, rank: float, level: float, free: float = np.inf) -> float:
    """Chance that a test at this ``level`` finds what changes the readings by one of these ``squares`` (d,), in squared
    noises, each as likely, along ``rank`` directions: the tail of the non-central χ², or F where ``free`` readings
    besides tell the noise."""
    if rank <= 0 or free <= 0:
        return 0.0
    some = np.minimum(np.atleast_1d(squares), _LARGEST)
    # without readings besides, and where the series does not converge since there are so many
    below = scipy.special.chndtr(float(scipy.special.chdtri(rank, level)), rank, some)
    if np.isfinite(free):
        limit = float(scipy.special.fdtri(rank, free, 1.0 - level))
        by_f = scipy.special.ncfdtr(rank, free, some, limit)
        below = np.where(np.isfinite(by_f), by_f, below)
    return float(np.mean(np.where(some >= _LARGEST, 1.0, 1.0 - below)))


def times_found(wanted: float, squares: Floats, rank: float, level: float, free: float = np.inf) -> float:
    """How many times as large as with these ``squares`` (d,) an effect is that is found with such a chance, as
    :func:`power`; infinite where it never is."""
    most = float(np.max(squares, initial=0.0))
    if rank <= 0 or free <= 0 or most <= 0.0 or not np.isfinite(most):
        return float("inf")

    def short(log_times: float) -> float:
        return power(np.exp(2.0 * log_times) * squares, rank, level, free) - wanted

    low, high = 0.5 * np.log(1e-6 / most), 0.5 * np.log(_LARGEST / most)
    # those of a direction that is hardly seen are found where the others have long been
    for _ in range(_ROUNDS):
        if short(high) > 0:
            return float(np.exp(scipy.optimize.brentq(short, low, high, xtol=1e-7)))
        high += 1.0
    return float("inf")


# -- How well all is known, and how much shows besides ---------------------------------------------------------------


def log_gain(rows: Floats, information: Floats) -> Floats:
    """By how much the logarithm of the determinant of what is known (p, p) grows with each of the rows (n, m, p)."""
    spread = np.einsum("nar,rs,nbs->nab", rows, linalg.inv(information), rows, optimize=True)
    return np.asarray(np.linalg.slogdet(np.eye(rows.shape[1]) + spread)[1])


def showing(
    x: Floats, base: Floats, parts: Sequence[tuple[Floats, Floats]], count: int, *, first: int = 0
) -> list[int]:
    """Rows (k,), one after another, each that adds most to what all ``parts`` show beside what is free.

    ``x`` (n, m, p) are the columns of what is free and ``base`` (p, p) what is known of it; each part is what is known
    of it and one thing more (q, q), and the columns (n, m, q) of these. What is free counts by itself for the ``first``
    rows, and where there are no parts. Rows that what was fitted cannot reach (NaN) are never chosen.
    """
    reached: Bools = np.logical_and.reduce([np.isfinite(z).all(axis=(1, 2)) for z in (x, *(z for _, z in parts))])
    x = np.where(reached[:, None, None], x, 0.0)
    parts = [(info, np.where(reached[:, None, None], z, 0.0)) for info, z in parts]
    infos, picked = [info for info, _ in parts], list[int]()
    for k in range(min(count, int(reached.sum()))):
        alone = log_gain(x, base)
        gained = alone.copy() if k < first or not parts else np.zeros(len(x))
        for info, (_, z) in zip(infos, parts, strict=True):
            gained += log_gain(z, info) - alone
        gained[picked] = -np.inf
        gained[~reached] = -np.inf
        best = int(np.argmax(gained))
        picked.append(best)
        base = base + x[best].T @ x[best]
        infos = [info + z[best].T @ z[best] for info, (_, z) in zip(infos, parts, strict=True)]
    return picked


def exchanged(rows: Floats, chosen: Sequence[int]) -> list[int]:
    """Exchanges each of the chosen rows (n, m, p) for a better one, until none is."""
    out = list(chosen)
    information = np.einsum("nar,nas->rs", rows[out], rows[out])
    for _ in range(_ROUNDS):
        before = list(out)
        for k, old in enumerate(before):
            rest = information - rows[old].T @ rows[old]
            value = linalg.eigvalsh(rest)
            if value[0] <= 1e-12 * value[-1]:
                # without this pose a direction is lost
                continue
            gains = log_gain(rows, rest)
            kept = gains[old]
            gains[out] = -np.inf
            best = int(np.argmax(gains))
            if gains[best] > kept + ROUNDING:
                out[k] = best
                information = rest + rows[best].T @ rows[best]
        if out == before:
            break
    return out


# -- How far a rival stays from what is true -------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Rival:
    """A model fitted to rows that follow another one: ``gram`` (p, p) of its columns, ``right`` (p,) with what lies
    between the two, and the ``square`` of that."""

    gram: Floats
    right: Floats
    square: float

    @classmethod
    def of(cls, columns: Floats, apart: Floats) -> Rival:
        """By its columns (N, p) and by how much the other is apart (N,), both over the noise."""
        return cls(columns.T @ columns, columns.T @ apart, float(apart @ apart))

    def joined(self, columns: Floats, apart: Floats) -> Rival:
        """With more rows."""
        more = Rival.of(columns, apart)
        return Rival(self.gram + more.gram, self.right + more.right, self.square + more.square)

    @property
    def separation(self) -> float:
        """How far it still is from the other once it is fitted anew, in standard deviations."""
        return float(np.sqrt(max(self._left, 0.0)))

    def separations(self, columns: Floats, apart: Floats) -> Floats:
        """The square of that, (n,), were each of these read (n, m, p), (n, m)."""
        root, unseen, x = self._fitted
        miss = apart - columns @ x
        # directions that no row observes must not count as separation: they are free to fit
        free, spread = columns @ unseen, columns @ root
        covariance = (
            np.eye(columns.shape[1]) + spread @ spread.transpose(0, 2, 1) + _FREE * free @ free.transpose(0, 2, 1)
        )
        return np.einsum("na,na->n", miss, linalg.solve(covariance, miss[:, :, None])[:, :, 0]) + self._left

    @property
    def _left(self) -> float:
        return self.square - float(self.right @ self._fitted[2])

    @cached_property
    def _fitted(self) -> tuple[Floats, Floats, Floats]:
        """The root of the inverse of its gram, directions that no row observes, and the fit."""
        value, vector = linalg.eigh(self.gram)
        keep = value > ROUNDING * value[-1]
        root = vector[:, keep] / np.sqrt(value[keep])
        return root, vector[:, ~keep], root @ (root.T @ self.right)


#: Columns (n, m, p) and what lies between (n, m) of each pose that could be measured, for each moment of a plan.
Later = Sequence[tuple[Floats, Floats]]


def telling(rivals: Sequence[tuple[Rival, Later]], most: int) -> tuple[list[tuple[int, float]], list[float]]:
    """Up to ``most`` poses, each of them once, that put most between the truth and the nearest of its rivals, with the
    separation reached with each; and that of each rival in the end."""
    now, out = [rival for rival, _ in rivals], list[tuple[int, float]]()
    for k in range(most):
        there = [later[k] for _, later in rivals]
        squares = np.min([rival.separations(*new) for rival, new in zip(now, there, strict=True)], axis=0)
        squares[[pose for pose, _ in out]] = -1.0
        best = int(np.argmax(squares))
        if not squares[best] > 0:
            break
        now = [rival.joined(c[best], a[best]) for rival, (c, a) in zip(now, there, strict=True)]
        out.append((best, min(rival.separation for rival in now)))
    return out, [rival.separation for rival in now]
