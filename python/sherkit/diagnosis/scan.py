"""Scores of many candidates at once, and their common null distribution by flipping signs of whole poses.

A candidate is a set of columns. Its score is the sum of squares of the residual that its columns explain beyond
the fitted parameters, turned into a normal deviate (Wilson and Hilferty) so that candidates of different size can be
compared. The largest deviate of the family is the test; flipping the signs of whole poses of the residual gives its
null distribution whatever the shape and size of the noise, as long as poses are independent and symmetric
(Winkler et al., "Permutation inference for the general linear model", NeuroImage 2014).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ..types import Floats, Ints
from .linearised import orthonormal

#: Directions of a shape with less than this part left after projection cannot be told from the fit.
_LEFT = 0.02
#: The same for physical effects, whose derivatives are exact.
_LEFT_EXACT = 1e-4
#: Candidates whose products are taken at once: as many as fit into a processor's cache.
_AT_ONCE = 32


@dataclass(frozen=True)
class Columns:
    """Columns of one candidate: functions on one axis (or all, ``axis`` None), or full columns."""

    functions: tuple[int, ...] = ()
    axis: int | None = None
    dense: tuple[int, ...] = ()
    exact: bool = False


class Scan:
    """A residual, what was fitted, and a family of candidates.

    ``residual`` (n, m) and every column are whitened. ``functions`` (n, f) act on single axes, ``dense``
    (n, m, d) on all.
    """

    def __init__(
        self,
        residual: Floats,
        fitted: Floats,
        functions: Floats,
        dense: Floats,
        candidates: Sequence[Columns],
        group: Ints,
    ) -> None:
        self.n, self.m = residual.shape
        order = np.argsort(group, kind="stable")
        self.starts = np.flatnonzero(np.diff(group[order], prepend=group[order[0]] - 1))
        self.functions = np.ascontiguousarray(functions[order])
        # column by column, since candidates take single ones
        self.dense = np.asfortranarray(dense[order].reshape(self.n * self.m, -1))
        self.basis = orthonormal(fitted[order])
        self.candidates = tuple(candidates)
        flat = residual[order].reshape(-1)
        self.residual = flat - self.basis @ (self.basis.T @ flat)
        self.f = self.functions.shape[1]

    # every column has a number: functions axis by axis, then the dense ones
    def numbers(self, columns: Columns) -> list[int]:
        """Numbers of a candidate's columns."""
        axes = range(self.m) if columns.axis is None else (columns.axis,)
        first = self.f * self.m
        return [a * self.f + k for a in axes for k in columns.functions] + [first + k for k in columns.dense]

    def times(self, matrix: Floats) -> Floats:
        """All columns times a matrix (N, k): (K, k)."""
        by_axis = matrix.reshape(self.n, self.m, -1)
        parts = [self.functions.T @ by_axis[:, a] for a in range(self.m)]
        return np.concatenate([*parts, self.dense.T @ matrix])

    @cached_property
    def by_basis(self) -> Floats:
        """All columns times the fitted basis, (K, p)."""
        return self.times(self.basis)

    @cached_property
    def squared(self) -> Floats:
        """Squared length of every column."""
        f = (self.functions**2).sum(axis=0)
        return np.concatenate([np.tile(f, self.m), np.einsum("ij,ij->j", self.dense, self.dense)])

    @cached_property
    def _sizes(self) -> dict[int, tuple[Ints, Ints]]:
        """Candidates by number of columns: which candidates, and their columns (c, k)."""
        by_size: dict[int, list[int]] = {}
        lists = [self.numbers(c) for c in self.candidates]
        for i, numbers in enumerate(lists):
            by_size.setdefault(len(numbers), []).append(i)
        return {
            k: (np.array(which), np.array([lists[i] for i in which], dtype=np.int64))
            for k, which in by_size.items()
            if k > 0
        }

    @cached_property
    def _gram(self) -> dict[int, Floats]:
        """Gram matrices (c, k, k) of the candidates, nothing projected."""
        ff = self.functions.T @ self.functions
        out = {}
        limit = self.f * self.m
        for k, (_, columns) in self._sizes.items():
            gram = np.zeros((len(columns), k, k))
            # a candidate's columns are all of one sort
            separable = columns[:, 0] < limit
            axis, function = columns[separable] // self.f, columns[separable] % self.f
            same = axis[:, :, None] == axis[:, None, :]
            gram[separable] = np.where(same, ff[function[:, :, None], function[:, None, :]], 0.0)
            full = np.flatnonzero(~separable)
            for some in np.array_split(full, max(len(full) // _AT_ONCE, 1)):
                blocks = self.dense.T[columns[some] - limit]
                gram[some] = blocks @ blocks.transpose(0, 2, 1)
            out[k] = gram
        return out

    def condition(self, columns: Floats) -> ConditionalScan:
        """The family once ``columns`` (N, k), in the order of :attr:`residual`, are part of the model too."""
        return ConditionalScan(self, columns)

    def take(self, columns: Columns) -> Floats:
        """A candidate's columns in full, (N, k)."""
        numbers = self.numbers(columns)
        limit = self.f * self.m
        out = np.zeros((self.n, self.m, len(numbers)))
        for j, number in enumerate(numbers):
            if number < limit:
                out[:, number // self.f, j] = self.functions[:, number % self.f]
            else:
                out[:, :, j] = self.dense[:, number - limit].reshape(self.n, self.m)
        return out.reshape(self.n * self.m, -1)


class ConditionalScan:
    """The family given the fitted parameters and some more columns."""

    def __init__(self, scan: Scan, columns: Floats) -> None:
        self.scan = scan
        added = columns - scan.basis @ (scan.basis.T @ columns)
        self.added = orthonormal(added) if added.shape[1] else added
        # a second projection, since an added column may have almost nothing left
        self.added = self.added - scan.basis @ (scan.basis.T @ self.added)
        self.residual = scan.residual - self.added @ (self.added.T @ scan.residual)
        self.free = scan.n * scan.m - scan.basis.shape[1] - self.added.shape[1]
        self.sum_of_squares = float(self.residual @ self.residual)

    @cached_property
    def _by_model(self) -> Floats:
        return np.concatenate([self.scan.by_basis, self.scan.times(self.added)], axis=1)

    @cached_property
    def _roots(self) -> dict[int, tuple[Floats, Ints]]:
        """Per size: inverse square roots (c, k, k) of the projected Gram matrices, and directions left (c,)."""
        out = {}
        for k, (which, columns) in self.scan._sizes.items():
            by_model = self._by_model[columns]
            gram = self.scan._gram[k] - by_model @ by_model.transpose(0, 2, 1)
            length = np.sqrt(np.maximum(self.scan.squared[columns], 1e-300))
            value, vector = np.linalg.eigh(gram / (length[:, :, None] * length[:, None, :]))
            exact = np.array([self.scan.candidates[i].exact for i in which])
            limit = np.where(exact, _LEFT_EXACT, _LEFT) ** 2
            keep = value > limit[:, None]
            root = vector * np.where(keep, 1.0 / np.sqrt(np.where(keep, value, 1.0)), 0.0)[:, None, :]
            out[k] = ((root / length[:, :, None]).transpose(0, 2, 1), keep.sum(axis=1))
        return out

    def gains(self) -> tuple[Floats, Ints]:
        """Sum of squares that each candidate explains, and in how many directions."""
        gain = np.zeros(len(self.scan.candidates))
        rank = np.zeros(len(self.scan.candidates), dtype=np.int64)
        b = self.scan.times(self.residual[:, None])[:, 0]
        for k, (which, columns) in self.scan._sizes.items():
            root, left = self._roots[k]
            gain[which] = ((root @ b[columns][:, :, None])[:, :, 0] ** 2).sum(axis=1)
            rank[which] = left
        return gain, rank

    def deviates(self) -> Floats:
        """The score of each candidate as a normal deviate; minus infinity where nothing of it is left."""
        gain, rank = self.gains()
        return deviate(gain, rank, self.sum_of_squares, self.free)

    def null(self, flips: int, seed: int) -> Floats:
        """Largest deviate of the family under ``flips`` random signs of whole poses, (flips,)."""
        scan = self.scan
        sums = self._grouped()
        signs = np.random.default_rng(seed).integers(0, 2, (len(scan.starts), flips)) * 2.0 - 1.0
        model = np.concatenate([scan.basis, self.added], axis=1)
        of_model = np.add.reduceat(
            (model.reshape(scan.n, scan.m, -1) * self.residual.reshape(scan.n, scan.m, 1)).sum(axis=1), scan.starts
        ).T
        sums -= self._by_model @ of_model
        lost = ((of_model @ signs) ** 2).sum(axis=0)
        total = self.sum_of_squares - lost
        best = np.full(flips, -np.inf)
        for k, (_, columns) in scan._sizes.items():
            root, left = self._roots[k]
            rows = (root @ sums[columns]).reshape(-1, sums.shape[1])
            gain = rows @ signs
            np.square(gain, out=gain)
            gain = gain.reshape(len(columns), k, flips).sum(axis=1)
            # of as many directions the largest gain has the largest deviate
            for rank in np.unique(left):
                most = gain[left == rank].max(axis=0)
                best = np.maximum(best, deviate(most, rank, total, self.free))
        return best

    def _grouped(self) -> Floats:
        """Products of columns and residual, summed within each pose: (K, groups)."""
        scan = self.scan
        e = self.residual.reshape(scan.n, scan.m)
        parts = [np.add.reduceat(scan.functions * e[:, a : a + 1], scan.starts).T for a in range(scan.m)]
        dense = scan.dense.reshape(scan.n, scan.m, -1)
        parts.append(np.add.reduceat(np.einsum("nmd,nm->nd", dense, e), scan.starts).T)
        return np.concatenate(parts)

    def p_value(self, largest: float, *, seed: int = 0, decisive: float = 0.01) -> float:
        """Familywise p of a largest deviate: few flips where the answer is plain, 1,999 where it is close."""
        p = 1.0
        for flips in (199, 1999):
            exceed = int((self.null(flips, seed + flips) >= largest).sum())
            p = (1 + exceed) / (flips + 1)
            # with 199 flips: none above it and far beyond, or so many that more would not change the answer
            if flips == 199 and (p > 10 * decisive or (exceed == 0 and largest > 12.0)):
                break
        return p


def deviate(gain: Floats, rank: Ints | np.integer[Any], total: float | Floats, free: int) -> Floats:
    """Wilson and Hilferty's normal deviate of an F ratio with (rank, free - rank) degrees of freedom."""
    k = np.maximum(rank, 1)
    left = np.maximum(free - k, 1)
    ratio = (gain / k) / np.maximum((total - gain) / left, 1e-300)
    cube = np.cbrt(np.maximum(ratio, 0.0))
    a, b = 2.0 / (9.0 * k), 2.0 / (9.0 * left)
    z = ((1.0 - b) * cube - (1.0 - a)) / np.sqrt(a + b * cube * cube)
    return np.where(rank > 0, z, -np.inf)
