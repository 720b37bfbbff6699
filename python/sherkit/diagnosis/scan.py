"""Scores of many candidates at once, and their common null distribution by flipping signs of whole poses.

A candidate is a set of columns. Its score is the sum of squares of the residual that its columns explain beyond
the fitted parameters, turned into a z score (Wilson and Hilferty) so that candidates of different size can be
compared. The largest z score of the family is the test; flipping the signs of whole poses of the residual gives its
null distribution whatever the shape and size of the noise, as long as poses are independent and symmetric
(Winkler et al., "Permutation inference for the general linear model", NeuroImage 2014).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from copy import copy
from functools import cached_property, partial
from typing import Any

import numpy as np
import scipy

from .._core import largest_under_flips
from ..base import linalg
from ..base.types import Floats, Ints
from .axis_waves import AxisProducts, AxisWaves
from .columns import Block, Columns, Image, Projected, Rows, Triangle, add_products, stretches_of
from .lack_of_fit import FLIPS, codes_of, z_score
from .waves import FilteredWaves, Products

#: Directions of a shape with less than this part left after projection cannot be told from the fit.
_LEFT = 0.02
#: The same for physical effects, whose derivatives are exact.
_LEFT_EXACT = 1e-4
#: Part of a column that enters the model which the model must leave: below it is what rounding made of products.
_ADDS = 1e-5
#: Part of the readings of all poses that parameters take, from which on what they take of each pose counts.
_PULLED = 0.04
#: A pose that leaves less of a direction to the others decides it alone.
_DECIDES = 1e-6
#: Part of a z score within which two are equal.
_ROUNDING = 1e-9
#: Patterns of signs under which the family is seen at first, where a p above :data:`_FAR` needs no finer one.
_FIRST = 256
_FAR = 0.06
#: Part of a level below which a p by Gumbel's law is far from it.
_FAR_BELOW = 0.1


class Scan:
    """A residual, what was fitted, and a family of candidates: all products of them.

    What is held does not grow with the rows. ``model`` are columns taken for fitted, ``group`` (n,) a row's pose.
    """

    def __init__(
        self,
        rows: Rows,
        candidates: Sequence[Columns],
        group: Ints,
        waves: FilteredWaves | None = None,
        along: AxisWaves | None = None,
        model: Sequence[Columns] = (),
    ) -> None:
        self.rows, self.group, self.waves, self.along = rows, group, waves, along
        self.candidates, self.model = tuple(candidates), tuple(model)
        first = rows.block(rows.blocks[0])
        self.n, (_, self.m, self.d) = rows.blocks[-1].stop, first.dense.shape
        self.f, self.fitted = first.functions.shape[1], first.fitted.shape[2]
        #: Numbers of the first full column, wave of an input, and wave on an axis; and how many columns there are.
        self.first_dense = self.f * self.m
        self.first_wave = self.first_dense + self.d
        self.first_along = self.first_wave + (len(waves) if waves is not None else 0)
        self.count = self.first_along + (len(along) if along is not None else 0)
        self._ff, self._dd = self._own_products()
        self._products()

    # every column has a number: functions axis by axis, then the dense ones, waves of inputs, and waves on axes
    def numbers(self, columns: Columns) -> list[int]:
        """Numbers of a candidate's columns."""
        axes = range(self.m) if columns.axis is None else (columns.axis,)
        if columns.functions:
            return [a * self.f + k for a in axes for k in columns.functions]
        if columns.dense:
            return [self.first_dense + k for k in columns.dense]
        if columns.waves:
            return [self.first_wave + k for k in columns.waves]
        return [self.first_along + k for k in columns.along]

    def take(self, columns: Columns, rows: slice, block: Block) -> Floats:
        """A candidate's columns in a stretch of rows (b, m, k)."""
        numbers = self.numbers(columns)
        out = np.zeros((*block.residual.shape, len(numbers)))
        for j, number in enumerate(numbers):
            if number < self.first_dense:
                out[:, number // self.f, j] = block.functions[:, number % self.f]
            elif number < self.first_wave:
                out[:, :, j] = block.dense[:, :, number - self.first_dense]
            elif self.waves is not None and number < self.first_along:
                out[:, :, j] = self.waves.column(number - self.first_wave, rows)
            elif self.along is not None:
                out[:, :, j] = self.along.column(number - self.first_along, rows)
        return out

    def every_block(self) -> Iterator[tuple[slice, Block, Floats]]:
        """Stretches of rows, and there what is in the model (b, m, p)."""
        for rows in self.rows.blocks:
            block = self.rows.block(rows)
            yield rows, block, np.concatenate([block.fitted, *(self.take(c, rows, block) for c in self.model)], axis=2)

    def _own_products(self) -> tuple[Floats, Floats]:
        """Products of functions, and of full columns, with one another, where a candidate has them."""
        ff, dd = np.zeros((self.f, self.f)), np.zeros((self.d, self.d))
        functions, full = (stretches_of([getattr(c, sort) for c in self.candidates]) for sort in ("functions", "dense"))
        for rows in self.rows.blocks:
            block = self.rows.block(rows)
            add_products(ff, block.functions, functions)
            add_products(dd, block.dense.reshape(block.residual.size, self.d), full)
        return ff, dd

    def _products(self) -> None:
        """One look at all rows: the model's own triangle, and its and the residual's products with every column."""
        triangle = Triangle()
        with_e: Any = 0.0
        total = 0.0

        def model_and_residual() -> Iterator[tuple[slice, Block, Floats]]:
            nonlocal with_e, total
            for rows, block, model in self.every_block():
                triangle.add(model)
                residual = block.residual.ravel()
                total += float(residual @ residual)
                with_e = with_e + model.reshape(-1, model.shape[2]).T @ residual
                yield rows, block, np.concatenate([model, block.residual[:, :, None]], axis=2)

        # with the model and, last, the residual; then with each that entered since
        every, self._wave_products = self._times(model_and_residual())
        #: The model's columns turned so that their rows are few; what makes them orthonormal (p, rank).
        self.triangle = triangle.of
        self.root = triangle.root()
        #: All columns times the orthonormal model (K, rank), and times what the model leaves of the residual (K,).
        self.by_model = every[:, :-1] @ self.root
        self.of_residual = self.root.T @ with_e
        self.by_residual = every[:, -1] - self.by_model @ self.of_residual
        self.sum_of_squares = total - float(self.of_residual @ self.of_residual)

    def asking(self, candidates: Sequence[Columns]) -> Scan:
        """The same family with these of its candidates alone."""
        place = {one: k for k, one in enumerate(self.candidates)}
        which = np.array([place[one] for one in candidates], dtype=np.int64)
        size, row = np.zeros((2, len(self.candidates)), dtype=np.int64)
        for k, (those, _) in self._sizes.items():
            size[those], row[those] = k, np.arange(len(those))
        new = self._copy()
        new.candidates = tuple(candidates)
        new._sizes = {
            k: (at, columns[row[which[at]]])
            for k, (_, columns) in self._sizes.items()
            if len(at := np.flatnonzero(size[which] == k))
        }
        new.gains = self.gains[0][which], self.gains[1][which]
        new.z_scores = self.z_scores[which]
        return new

    def beside(self, rows: Rows) -> Scan:
        """The family beside another fit: what was fitted and what it leaves are those of ``rows``, where all other
        columns are the same."""
        new = self._copy()
        new.rows = rows
        new.fitted = rows.block(rows.blocks[0]).fitted.shape[2]
        new._products()
        return new

    def _copy(self) -> Scan:
        """Another, without what hangs on its model."""
        new = copy(self)
        for name in ("_roots", "gains", "z_scores", "_nulls"):
            new.__dict__.pop(name, None)
        return new

    def _times(self, stretches: Iterable[tuple[slice, Block, Floats]]) -> tuple[Floats, tuple[Products, ...]]:
        """Every column of the family times others (K, c), whose rows (b, m, c) come stretch by stretch; and what waves
        of inputs at any other frequency are made of."""
        ends = [part.products for part in (self.waves, self.along) if part is not None]
        parts: list[Products | AxisProducts] = []
        own: Any = 0.0
        for rows, block, others in stretches:
            count = others.shape[2]
            parts = parts or [end(count) for end in ends]
            dense, flat = block.dense.reshape(len(others) * self.m, self.d), others.reshape(-1, count)
            own = own + np.concatenate([*(block.functions.T @ others[:, a] for a in range(self.m)), dense.T @ flat])
            for part in parts:
                part.add(rows, others)
        return np.concatenate([own, *(part.all() for part in parts)]), tuple(
            part for part in parts if isinstance(part, Products)
        )

    def with_columns(self, *columns: Columns) -> Scan:
        """The family once more columns are part of the model too, at the price of one look at these alone: what the
        model leaves of them stands, orthonormal, behind what is there."""
        if not columns:
            return self
        new = self._copy()
        new.model = (*self.model, *columns)
        numbers = [number for one in columns for number in self.numbers(one)]
        every, more = self._times(
            (rows, block, np.concatenate([self.take(one, rows, block) for one in columns], axis=2))
            for rows, block in zip(self.rows.blocks, map(self.rows.block, self.rows.blocks), strict=True)
        )
        inside, gram = self.by_model[numbers], every[numbers]
        left = gram - inside @ inside.T
        length = np.sqrt(np.where(np.diag(gram) > 0.0, np.diag(gram), 1.0))
        value, vector = linalg.eigh(left / (length[:, None] * length))
        keep = value > _ADDS**2
        turn = vector[:, keep] / np.sqrt(value[keep]) / length[:, None]
        added = (every - self.by_model @ inside.T) @ turn
        of_residual = turn.T @ self.by_residual[numbers]
        p, rank = self.root.shape
        new.root = np.zeros((p + len(numbers), rank + turn.shape[1]))
        new.root[:p, :rank], new.root[:p, rank:], new.root[p:, rank:] = self.root, -self.root @ inside.T @ turn, turn
        new.triangle = np.zeros((len(self.triangle) + turn.shape[1], p + len(numbers)))
        new.triangle[: len(self.triangle), :p] = self.triangle
        new.triangle[: len(self.triangle), p:] = self.triangle @ self.root @ inside.T
        new.triangle[len(self.triangle) :, p:] = turn.T @ left
        new.by_model = np.concatenate([self.by_model, added], axis=1)
        new.of_residual = np.concatenate([self.of_residual, of_residual])
        new.by_residual = self.by_residual - added @ of_residual
        new.sum_of_squares = self.sum_of_squares - float(of_residual @ of_residual)
        new._wave_products = (*self._wave_products, *more)
        return new

    @property
    def free(self) -> int:
        """Readings less what the model takes of them."""
        return self.n * self.m - self.root.shape[1]

    def along_waves(self, frequency: float) -> tuple[Floats, Floats, Floats]:
        """Of sine and cosine of all inputs at any frequency, what the model leaves: Gram matrix (2 j, 2 j), and
        products with the residual (2 j,); and their squared lengths (2 j,) as they are."""
        assert self.waves is not None, "only a thorough stage has waves"
        first, *others = (part.at(frequency) for part in self._wave_products)
        by_model = np.concatenate([first[:, :-1], *others], axis=1) @ self.root
        gram = self.waves.gram_at(frequency)
        return gram - by_model @ by_model.T, first[:, -1] - by_model @ self.of_residual, np.diag(gram)

    @cached_property
    def squared(self) -> Floats:
        """Squared length of every column."""
        more = [part.squared for part in (self.waves, self.along) if part is not None]
        return np.concatenate([np.tile(np.diag(self._ff), self.m), np.diag(self._dd), *more])

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

    def _gram(self, columns: Ints) -> Floats:
        """Gram matrices (c, k, k) of candidates (c, k), nothing projected. All columns of one are of one sort."""
        gram = np.zeros((*columns.shape, columns.shape[1]))
        first = columns[:, 0]
        one = first < self.first_dense
        axis, function = np.divmod(columns[one], max(self.f, 1))
        same = axis[:, :, None] == axis[:, None, :]
        gram[one] = np.where(same, self._ff[function[:, :, None], function[:, None, :]], 0.0)
        full = (first >= self.first_dense) & (first < self.first_wave)
        dense = columns[full] - self.first_dense
        gram[full] = self._dd[dense[:, :, None], dense[:, None, :]]
        wave = (first >= self.first_wave) & (first < self.first_along)
        if self.waves is not None and wave.any():
            gram[wave] = self.waves.gram(columns[wave] - self.first_wave)
        on_axes = first >= self.first_along
        if self.along is not None and on_axes.any():
            gram[on_axes] = self.along.gram(columns[on_axes] - self.first_along)
        return gram

    def of(self, columns: Columns) -> Projected:
        """Products of one candidate's columns."""
        numbers = np.array(self.numbers(columns), dtype=np.int64)
        return Projected(self._gram(numbers[None])[0], self.by_model[numbers], self.by_residual[numbers])

    @cached_property
    def _roots(self) -> dict[int, tuple[Floats, Ints]]:
        """Per size: inverse square roots (c, k, k) of the projected Gram matrices, and directions left (c,)."""
        out = {}
        for k, (which, columns) in self._sizes.items():
            by_model = self.by_model[columns]
            gram = self._gram(columns) - by_model @ by_model.transpose(0, 2, 1)
            # of a column that is nothing but rounding nothing is left, whatever its length
            length = np.sqrt(np.where(self.squared[columns] > 1e-200, self.squared[columns], 1.0))
            value, vector = linalg.eigh(gram / (length[:, :, None] * length[:, None, :]))
            exact = np.array([self.candidates[i].exact for i in which])
            limit = np.where(exact, _LEFT_EXACT, _LEFT) ** 2
            keep = value > limit[:, None]
            root = vector * np.where(keep, 1.0 / np.sqrt(np.where(keep, value, 1.0)), 0.0)[:, None, :]
            out[k] = ((root / length[:, :, None]).transpose(0, 2, 1), keep.sum(axis=1))
        return out

    @cached_property
    def gains(self) -> tuple[Floats, Ints]:
        """Sum of squares that each candidate explains, and in how many directions."""
        gain = np.zeros(len(self.candidates))
        rank = np.zeros(len(self.candidates), dtype=np.int64)
        for k, (which, columns) in self._sizes.items():
            root, left = self._roots[k]
            gain[which] = ((root @ self.by_residual[columns][:, :, None])[:, :, 0] ** 2).sum(axis=1)
            rank[which] = left
        return gain, rank

    @cached_property
    def z_scores(self) -> Floats:
        """The score of each candidate as a normal z score; minus infinity where nothing of it is left."""
        gain, rank = self.gains
        return z_score(gain, rank, self.sum_of_squares, self.free)

    def null(self, seed: int, flips: int = FLIPS) -> Floats:
        """Largest z score of the family (flips,) under each of a group of patterns of signs of whole poses, which are
        remembered; ``flips`` is a power of two.

        The group is drawn at random; its first pattern flips nothing. That they are a group makes the test exact, and
        all of them come at the price of a few (Hemerik and Goeman, "Exact testing with random permutations", 2018).
        """
        if (seed, flips) not in self._nulls:
            self._nulls[seed, flips] = self._drawn(seed, flips)
        return self._nulls[seed, flips]

    @cached_property
    def _nulls(self) -> dict[tuple[int, int], Floats]:
        return {}

    def _drawn(self, seed: int, flips: int) -> Floats:
        codes, sums, of_model, total = self._by_code(seed, flips)
        size, each = np.array([len(of_model)]), np.arange(len(of_model))
        lost = largest_under_flips(
            of_model, codes, flips, each, np.eye(len(of_model)).ravel(), size, size, np.zeros(1, dtype=np.int64), 1
        )[0]
        ranks = np.unique(np.concatenate([left for _, left in self._roots.values()] or [each[:0]]))
        columns, roots, sizes, own = [], [], [], []
        for k, (_, numbers) in self._sizes.items():
            root, left = self._roots[k]
            for rank in np.unique(left[left > 0]).tolist():
                some = left == rank
                columns.append(numbers[some].ravel())
                # eigenvalues ascend: what is left stands last
                roots.append(root[some, k - rank :].ravel())
                sizes.append(np.full(some.sum(), k))
                own.append(np.full(some.sum(), rank))
        if not columns:
            return np.full(flips, -np.inf)
        rank_of = np.concatenate(own)
        # of as many directions the largest gain has the largest z score
        most = largest_under_flips(
            sums, codes, flips, np.concatenate(columns), np.concatenate(roots), np.concatenate(sizes), rank_of,
            np.searchsorted(ranks, rank_of), len(ranks),
        )  # fmt: skip
        return z_score(most, ranks[:, None], total - lost, self.free).max(axis=0, initial=-np.inf)

    def _by_code(self, seed: int, flips: int) -> tuple[Ints, Floats, Floats, float]:
        """Codes (c,) that poses have; products of what the model leaves of all columns (K, c), and of the orthonormal
        model (rank, c), with the residual whose signs are flipped, summed over the poses of each code; and the square
        of that."""
        pose = np.unique(self.group, return_inverse=True)[1].ravel()
        taken = self._taken_by_fit(pose)
        total = self.sum_of_squares if taken is None else 0.0
        used, codes = np.unique(codes_of(int(pose.max()) + 1, seed, flips)[pose], return_inverse=True)
        sums = np.zeros((self.count, len(used)))
        of_model: Any = 0.0
        for rows, block, model in self.every_block():
            orthonormal = model @ self.root
            left = block.residual - orthonormal @ self.of_residual
            if taken is not None:
                left = left + np.einsum("nmk,nk->nm", orthonormal, taken[pose[rows]])
                total += float((left**2).sum())
            here = codes[rows]
            by_code = scipy.sparse.csr_matrix(
                (np.ones(len(here)), (here, np.arange(len(here)))), (len(used), len(here))
            )
            of_model = of_model + np.ascontiguousarray((by_code @ np.einsum("nmk,nm->nk", orthonormal, left)).T)
            for a in range(self.m):
                sums[a * self.f : (a + 1) * self.f] += (by_code @ (block.functions * left[:, a : a + 1])).T
            dense = np.einsum("nmd,nm->nd", block.dense, left)
            sums[self.first_dense : self.first_wave] += (by_code @ dense).T
            if self.waves is not None:
                self.waves.add_sums(rows, left, here, sums[self.first_wave : self.first_along])
            if self.along is not None:
                self.along.add_sums(rows, left, here, sums[self.first_along :])
        # in place: it is as large as all sums
        scipy.linalg.blas.dgemm(-1.0, of_model.T, self.by_model, 1.0, sums.T, trans_b=True, overwrite_c=True)
        return used, sums, of_model, total

    def _taken_by_fit(self, pose: Ints) -> Floats | None:
        """What the fit took of the residual of each pose, as numbers (poses, rank) of the orthonormal model; None where
        that is next to nothing.

        A pose of few has pulled the fit to itself: its residual is smaller than its error, and a flip, which the model
        is taken out of once more, is smaller still. Multiplied by ``(1 - H)^(-1/2)``, H being the pose's block of the
        projection on the model, its covariance is that of independent noise again, so that what a flip leaves is as
        large as what the fit left (Bell and McCaffrey, "Bias reduction in standard errors for linear regression with
        multi-stage samples", Survey Methodology 2002).
        """
        count, rank = int(pose.max()) + 1, self.root.shape[1]
        if rank < _PULLED * count * self.m:
            return None
        own, of_residual = np.zeros((count, rank, rank)), np.zeros((count, rank))
        for rows, block, model in self.every_block():
            orthonormal = model @ self.root
            left = block.residual - orthonormal @ self.of_residual
            np.add.at(own, pose[rows], np.einsum("nmk,nml->nkl", orthonormal, orthonormal))
            np.add.at(of_residual, pose[rows], np.einsum("nmk,nm->nk", orthonormal, left))
        value, vector = linalg.eigh(own)
        # of what a pose alone decides nothing is left
        free = np.where(value < 1.0 - _DECIDES, 1.0 - value, 1.0)
        more = np.where(value > 1e-12, (1.0 / np.sqrt(free) - 1.0) / np.maximum(value, 1e-12), 0.5)
        return np.einsum("gkl,gl,gml,gm->gk", vector, more, vector, of_residual)

    def p_value(self, largest: float, *, level: float, seed: int = 0) -> float:
        """Familywise p of a largest z score: of all patterns of signs where it is near the ``level`` that decides.

        Else of the few first, whose largest scores follow a law of extremes, here by its two moments (Gumbel,
        *Statistics of Extremes*, 1958).
        """
        # of few poses many patterns are the same, which rounding must not tell from the one that flips nothing
        least = largest - _ROUNDING * abs(largest)
        first = self.null(seed, _FIRST)[1:]
        if np.isfinite(first).all() and least > first.max():
            scale = float(np.std(first)) * np.sqrt(6.0) / np.pi
            tail = -np.expm1(-np.exp(-np.euler_gamma - (least - float(first.mean())) / max(scale, 1e-300)))
            if tail < _FAR_BELOW * level:
                return max(float(tail), 1.0 / FLIPS)
        p = (1 + int((first >= least).sum())) / _FIRST
        return p if p > _FAR else (1 + int((self.null(seed)[1:] >= least).sum())) / FLIPS

    def among(self, sets: Sequence[Columns]) -> Image:
        """A few candidates in full."""
        return self.image([partial(self.take, one) for one in sets])

    def image(self, sets: Sequence[Callable[[slice, Block], Floats]]) -> Image:
        """Columns (b, m, k) that are given for a stretch of rows, in full, with model and residual."""
        triangle = Triangle()
        counts: list[int] = []
        for rows, block, model in self.every_block():
            parts = [model, *(one(rows, block) for one in sets), block.residual[:, :, None]]
            counts = counts or [part.shape[2] for part in parts]
            triangle.add(np.concatenate(parts, axis=2))
        model, *columns, residual = np.split(triangle.of, np.cumsum(counts)[:-1], axis=1)
        return Image(model, columns, residual[:, 0], self.n * self.m)
