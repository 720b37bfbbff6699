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
from numpy.typing import NDArray

from .._core import largest_under_flips
from ..types import Floats, Ints
from .linearised import orthonormal
from .waves import FilteredWaves

#: Directions of a shape with less than this part left after projection cannot be told from the fit.
_LEFT = 0.02
#: The same for physical effects, whose derivatives are exact.
_LEFT_EXACT = 1e-4
#: Patterns of signs under which the family is seen.
FLIPS = 2048
#: Candidates whose products are taken at once: as many as fit into a processor's cache.
_AT_ONCE = 32


@dataclass(frozen=True)
class Columns:
    """Columns of one candidate, all of one sort: functions on one axis (or all, ``axis`` None), full columns, or
    waves."""

    functions: tuple[int, ...] = ()
    axis: int | None = None
    dense: tuple[int, ...] = ()
    waves: tuple[int, ...] = ()
    exact: bool = False


class Scan:
    """A residual, what was fitted, and a family of candidates.

    ``residual`` (n, m) and every column are whitened. ``functions`` (n, f) act on single axes, ``dense``
    (n, m, d) on all, and so do ``waves``.
    """

    def __init__(
        self,
        residual: Floats,
        fitted: Floats,
        functions: Floats,
        dense: Floats,
        candidates: Sequence[Columns],
        group: Ints,
        waves: FilteredWaves | None = None,
    ) -> None:
        self.n, self.m = residual.shape
        self.waves = waves
        self.order = order = np.argsort(group, kind="stable")
        self.starts = np.flatnonzero(np.diff(group[order], prepend=group[order[0]] - 1))
        self.functions = np.ascontiguousarray(functions[order])
        # column by column, since candidates take single ones
        self.dense = np.asfortranarray(dense[order].reshape(self.n * self.m, -1))
        self.basis = orthonormal(fitted[order])
        self.candidates = tuple(candidates)
        flat = residual[order].reshape(-1)
        self.residual = flat - self.basis @ (self.basis.T @ flat)
        self.f = self.functions.shape[1]

    # every column has a number: functions axis by axis, then the dense ones, then the waves
    def numbers(self, columns: Columns) -> list[int]:
        """Numbers of a candidate's columns."""
        axes = range(self.m) if columns.axis is None else (columns.axis,)
        if columns.functions:
            return [a * self.f + k for a in axes for k in columns.functions]
        if columns.dense:
            return [self.first_dense + k for k in columns.dense]
        return [self.first_wave + k for k in columns.waves]

    @property
    def first_dense(self) -> int:
        """Number of the first full column."""
        return self.f * self.m

    @property
    def first_wave(self) -> int:
        """Number of the first wave."""
        return self.first_dense + self.dense.shape[1]

    def in_time(self, values: NDArray[Any]) -> NDArray[Any]:
        """Values (n, …) of rows as they stand here, in the order in which they came."""
        out = np.empty_like(values)
        out[self.order] = values
        return out

    def times(self, matrix: Floats) -> Floats:
        """All columns times a matrix (N, k): (K, k)."""
        by_axis = matrix.reshape(self.n, self.m, -1)
        parts = [self.functions.T @ by_axis[:, a] for a in range(self.m)]
        parts.append(self.dense.T @ matrix)
        if self.waves is not None:
            parts.append(self.waves.times(self.in_time(by_axis)))
        return np.concatenate(parts)

    @cached_property
    def by_basis(self) -> Floats:
        """All columns times the fitted basis, (K, p)."""
        return self.times(self.basis)

    @cached_property
    def squared(self) -> Floats:
        """Squared length of every column."""
        f = (self.functions**2).sum(axis=0)
        waves = self.waves.squared if self.waves is not None else np.zeros(0)
        return np.concatenate([np.tile(f, self.m), np.einsum("ij,ij->j", self.dense, self.dense), waves])

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
        for k, (_, columns) in self._sizes.items():
            gram = np.zeros((len(columns), k, k))
            # a candidate's columns are all of one sort
            separable, wave = columns[:, 0] < self.first_dense, columns[:, 0] >= self.first_wave
            axis, function = columns[separable] // self.f, columns[separable] % self.f
            same = axis[:, :, None] == axis[:, None, :]
            gram[separable] = np.where(same, ff[function[:, :, None], function[:, None, :]], 0.0)
            if self.waves is not None and wave.any():
                gram[wave] = self.waves.gram(columns[wave] - self.first_wave)
            full = np.flatnonzero(~separable & ~wave)
            for some in np.array_split(full, max(len(full) // _AT_ONCE, 1)):
                blocks = self.dense.T[columns[some] - self.first_dense]
                gram[some] = blocks @ blocks.transpose(0, 2, 1)
            out[k] = gram
        return out

    def condition(self, columns: Floats) -> ConditionalScan:
        """The family once ``columns`` (N, k), in the order of :attr:`residual`, are part of the model too."""
        return ConditionalScan(self, columns)

    def take(self, columns: Columns) -> Floats:
        """A candidate's columns in full, (N, k)."""
        numbers = self.numbers(columns)
        out = np.zeros((self.n, self.m, len(numbers)))
        for j, number in enumerate(numbers):
            if number < self.first_dense:
                out[:, number // self.f, j] = self.functions[:, number % self.f]
            elif self.waves is not None and number >= self.first_wave:
                out[:, :, j] = self.waves.column(number - self.first_wave)[self.order]
            else:
                out[:, :, j] = self.dense[:, number - self.first_dense].reshape(self.n, self.m)
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

    def null(self, seed: int) -> Floats:
        """Largest deviate of the family (FLIPS,) under each of a group of patterns of signs of whole poses.

        The group is drawn at random; its first pattern flips nothing. That they are a group makes the test exact, and
        all of them come at the price of a few (Hemerik and Goeman, "Exact testing with random permutations", 2018).
        """
        scan, sums = self.scan, self._grouped()
        codes = codes_of(len(scan.starts), seed)
        model = np.concatenate([scan.basis, self.added], axis=1)
        of_model = np.add.reduceat(
            (model.reshape(scan.n, scan.m, -1) * self.residual.reshape(scan.n, scan.m, 1)).sum(axis=1), scan.starts
        ).T
        sums -= self._by_model @ of_model
        total = self.sum_of_squares - _largest([of_model[None]], [0], 1, codes)[0]
        ranks = np.unique(np.concatenate([left for _, left in self._roots.values()] or [np.zeros(0, dtype=np.int64)]))
        sets, of = [], []
        for k, (_, columns) in scan._sizes.items():
            root, left = self._roots[k]
            for rank in np.unique(left[left > 0]):
                # eigenvalues ascend: what is left stands last
                some = left == rank
                sets.append(root[some, k - rank :] @ sums[columns[some]])
                of.append(int(np.searchsorted(ranks, rank)))
        # of as many directions the largest gain has the largest deviate
        most = _largest(sets, of, len(ranks), codes)
        return deviate(most, ranks[:, None], total, self.free).max(axis=0, initial=-np.inf)

    def _grouped(self) -> Floats:
        """Products of columns and residual, summed within each pose: (K, groups)."""
        scan = self.scan
        e = self.residual.reshape(scan.n, scan.m)
        parts = [np.add.reduceat(scan.functions * e[:, a : a + 1], scan.starts).T for a in range(scan.m)]
        dense = scan.dense.reshape(scan.n, scan.m, -1)
        parts.append(np.add.reduceat(np.einsum("nmd,nm->nd", dense, e), scan.starts).T)
        if scan.waves is not None:
            pose = np.repeat(np.arange(len(scan.starts)), np.diff(scan.starts, append=scan.n))
            parts.append(scan.waves.grouped(scan.in_time(e), scan.in_time(pose), len(scan.starts)))
        return np.concatenate(parts)

    def p_value(self, largest: float, *, seed: int = 0) -> float:
        """Familywise p of a largest deviate."""
        return (1 + int((self.null(seed)[1:] >= largest).sum())) / FLIPS


def codes_of(poses: int, seed: int) -> Ints:
    """A code for each pose (poses,): pattern t flips those whose code shares an odd number of bits with t. No two poses
    always flip together, as long as there are codes."""
    rng = np.random.default_rng(seed)
    return rng.permutation(FLIPS)[:poses] if poses <= FLIPS else rng.integers(0, FLIPS, poses)


def _largest(sets: Sequence[Floats], class_of: Sequence[int], classes: int, codes: Ints) -> Floats:
    """Largest sum of squares (classes, FLIPS) of sets of candidates (c, k, poses), each set of one class."""
    if not sets:
        return np.zeros((classes, FLIPS))
    rows = np.concatenate([one.reshape(-1, len(codes)) for one in sets])
    sizes = np.concatenate([np.full(len(one), one.shape[1], dtype=np.int64) for one in sets])
    of = np.repeat(np.array(class_of, dtype=np.int64), [len(one) for one in sets])
    return largest_under_flips(np.ascontiguousarray(rows), np.cumsum(sizes), of, classes, codes, FLIPS)


def deviate(gain: Floats, rank: Ints | np.integer[Any], total: float | Floats, free: int) -> Floats:
    """Wilson and Hilferty's normal deviate of an F ratio with (rank, free - rank) degrees of freedom."""
    k = np.maximum(rank, 1)
    left = np.maximum(free - k, 1)
    ratio = (gain / k) / np.maximum((total - gain) / left, 1e-300)
    cube = np.cbrt(np.maximum(ratio, 0.0))
    a, b = 2.0 / (9.0 * k), 2.0 / (9.0 * left)
    z = ((1.0 - b) * cube - (1.0 - a)) / np.sqrt(a + b * cube * cube)
    return np.where(rank > 0, z, -np.inf)
