"""Gram matrices fold by fold: a fit to the rows outside a fold is a subtraction."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ..base import linalg
from ..base.types import Floats, Ints
from ..data import Measurements

# -- Blocks of neighbouring poses, held out together ----------------------------------------------------------------

_TILES = 4


def blocks_of(data: Measurements, place: Mapping[str, Floats], folds: int = 5, seed: int = 0) -> Ints:
    """A fold (0 … folds - 1) for every row: as the rows say, else tiles of the ``place`` (n,) by name."""
    if data.block is None:
        return deal_tiles(np.nan_to_num(np.stack(list(place.values()), axis=1)), data.standing, folds, seed)
    names, block = np.unique(data.block, return_inverse=True)
    return _dealt(len(names), folds, seed)[block.ravel()]


def spatial_blocks(data: Measurements, positions_mm: Floats, folds: int = 5, seed: int = 0) -> Ints:
    """A fold (0 … folds - 1) for every row; repeats of a pose and neighbours in space stay together."""
    return deal_tiles(positions_mm, data.standing, folds, seed)


def deal_tiles(places: Floats, groups: Ints, folds: int = 5, seed: int = 0) -> Ints:
    """A fold (0 … folds - 1) for every row of ``places`` (n, d); equal ``groups`` (n,) and neighbours stay together.

    The first two coordinates are cut into 4 × 4 tiles, a third one into 3 layers, and whole tiles are dealt to folds,
    so that a fold is predicted from its surroundings and never from its own repeats (Roberts et al., "Cross-validation
    strategies for data with temporal, spatial … structure", Ecography 2017).
    """
    centre = _group_means(places, groups)
    tile = np.zeros(len(centre), dtype=np.int64)
    for axis in range(min(centre.shape[1], 3)):
        rank = np.argsort(np.argsort(centre[:, axis], kind="stable"), kind="stable")
        parts = _TILES if axis < 2 else 3
        tile = tile * parts + rank * parts // len(centre)
    names, tile = np.unique(tile, return_inverse=True)
    return _dealt(len(names), folds, seed)[tile.ravel()][groups]


def _dealt(count: int, folds: int, seed: int) -> Ints:
    deal = np.arange(count, dtype=np.int64) % folds
    np.random.default_rng(seed).shuffle(deal)
    return deal


def _group_means(values: Floats, groups: Ints) -> Floats:
    count = np.bincount(groups)
    return np.stack([np.bincount(groups, v) / count for v in values.T], axis=1)


# --------------------------------------------------------------------------------------------------------------

#: Rows that are looked at together: a few megabytes of columns, however long the run is.
BLOCK = 8192
#: Part of any direction's squared length that every fold must leave to the others, or pseudo-inverses are needed.
_BEYOND = 1e-6
#: Part of a further column's squared length that the fitted ones must leave of it.
_LEFT = 1e-8
#: Numbers of Gram matrices that are kept before they are summed.
_TOGETHER = 4_000_000


def blocks(n: int, most: int = BLOCK) -> list[slice]:
    """Stretches of at most so many of ``n`` rows, alike in length."""
    edges = np.linspace(0, n, -(-n // most) + 1).round().astype(int).tolist()
    return [slice(a, b) for a, b in pairwise(edges)]


@dataclass(frozen=True, eq=False)
class Folds:
    """Columns, brought to unit length, against a residual, summed over the rows of each fold of each repetition.

    All repetitions stand one after another: ``grams`` (f, k, k), ``right`` (f, k) products with the residual,
    ``squares`` (f,) of the residual and ``counts`` (f,) of numbers in it. ``place`` (repetitions, n) is where the fold
    of a row stands, ``length`` (k,) what the columns were divided by.
    """

    grams: Floats
    right: Floats
    squares: Floats
    counts: Ints
    place: Ints
    length: Floats

    @classmethod
    def of(cls, columns: Callable[[slice], Floats], residual: Floats, fold: Ints) -> Folds:
        """``columns`` gives those (b, m, k) of a stretch of rows; ``fold`` (repetitions, n) is the fold of each row."""
        repetitions, (n, m) = len(fold), residual.shape
        per_repetition = int(fold.max()) + 1
        place = fold + per_repetition * np.arange(repetitions)[:, None]
        # rows that are in the same fold in every repetition are summed once
        code = (per_repetition ** np.arange(repetitions)) @ fold
        _, first_of, cell = np.unique(code, return_index=True, return_inverse=True)
        cells = place[:, first_of]
        count, grams = 0, np.zeros(0)
        for rows in blocks(n):
            order = np.argsort(cell[rows], kind="stable")
            both = np.concatenate([columns(rows), residual[rows][:, :, None]], axis=2)[order]
            if not len(grams):
                count = both.shape[2]
                grams = np.zeros((repetitions * per_repetition, count, count))
            here = cell[rows][order]
            edges = [0, *(np.flatnonzero(np.diff(here)) + 1).tolist(), len(here)]
            parts = [both[a:b].reshape(-1, count) for a, b in pairwise(edges)]
            of = cells[:, here[edges[:-1]]]
            # a few at a time: adding each by itself would take longer than to make it
            for some in blocks(len(parts), max(_TOGETHER // count**2, 1)):
                own = np.stack([part.T @ part for part in parts[some]])
                in_fold = np.zeros((len(grams), len(own)))
                in_fold[of[:, some], np.arange(len(own))] = 1.0
                grams += (in_fold @ own.reshape(len(own), -1)).reshape(grams.shape)
        length = np.sqrt(np.diagonal(grams[:per_repetition].sum(axis=0))[:-1])
        length = np.where(length > 0, length, 1.0)
        right = grams[:, :-1, -1] / length
        counts = m * np.bincount(place.ravel(), minlength=len(grams))
        return cls(
            grams[:, :-1, :-1] / np.multiply.outer(length, length), right, grams[:, -1, -1], counts, place, length
        )

    def __len__(self) -> int:
        return len(self.grams)

    def some(self, which: Sequence[int]) -> Folds:
        """With these of the columns only."""
        w = list(which)
        return Folds(self.grams[:, w][:, :, w], self.right[:, w], self.squares, self.counts, self.place, self.length[w])

    def repetition(self, k: int) -> Folds:
        """Those of one repetition."""
        count = len(self) // len(self.place)
        own = slice(k * count, (k + 1) * count)
        place = self.place[k : k + 1] - own.start
        return Folds(self.grams[own], self.right[own], self.squares[own], self.counts[own], place, self.length)

    def _outside(self, inside: Floats | Ints) -> Floats:
        """Of something summed over each fold, what is outside it, within its repetition."""
        repetitions = inside.reshape(len(self.place), -1, *inside.shape[1:])
        return (repetitions.sum(axis=1, keepdims=True) - repetitions).reshape(inside.shape)

    @property
    def outside(self) -> tuple[Floats, Floats, Floats, Floats]:
        """Gram matrices, right sides, sums of squares and counts of all rows outside each fold."""
        return tuple(self._outside(one) for one in (self.grams, self.right, self.squares, self.counts))  # type: ignore[return-value]

    @property
    def solutions(self) -> Floats:
        """Least squares of the rows outside each fold (f, k), of columns of unit length."""
        gram, right, _, _ = self.outside
        turn = self.turn(len(self.length))
        turned = turn.T @ gram @ turn
        if len(turn.T) and linalg.eigvalsh(turned).min() > _BEYOND:
            return linalg.solve(turned, turn.T @ right[:, :, None])[:, :, 0] @ turn.T
        root = roots_of(gram)
        return (root @ (root.transpose(0, 2, 1) @ right[:, :, None]))[:, :, 0]

    def turn(self, first: int) -> Floats:
        """What makes the ``first`` columns orthonormal over all rows (first, rank)."""
        root = roots_of(self.grams[: len(self) // len(self.place), :first, :first].sum(axis=0))
        return root[:, (root != 0.0).any(axis=0)]

    @property
    def held_out(self) -> Floats:
        """Sums of squared errors of the rows of each fold (f,) under the fit to the others."""
        x = self.solutions
        return self.squares - 2.0 * (x * self.right).sum(axis=1) + np.einsum("fk,fkl,fl->f", x, self.grams, x)

    def errors(self, columns: Floats, residual: Floats, rows: slice) -> Floats:
        """Errors (repetitions, b, m) of a stretch of rows, each under the fit to the rows outside its fold. ``columns``
        (b, m, k) and ``residual`` (b, m) are as given to :meth:`of`."""
        predicted = columns @ (self.solutions / self.length).T
        out = [np.take_along_axis(predicted, of[rows][:, None, None], axis=2)[:, :, 0] for of in self.place]
        return residual - np.stack(out)


class Beside:
    """What further columns bring beside the first ``fitted`` of some, fold by fold: these are solved for once, and a
    set of others is a small matrix (the Schur complement of theirs).

    Of each set, by its ``place`` among the further columns, the least squares are known of the rows outside each fold
    (:meth:`outside`) and the errors of those in it under that fit (:meth:`held_out`).
    """

    def __init__(self, folds: Folds, fitted: int) -> None:
        self.folds = folds
        gram, right, squares, _ = folds.outside
        first, more = slice(0, fitted), slice(fitted, None)
        turn = folds.turn(fitted)
        #: Inside each fold: products of the fitted ones, turned, with themselves, the others and the residual.
        self.own = turn.T @ folds.grams[:, first, first] @ turn
        self.across = turn.T @ folds.grams[:, first, more]
        self.along = folds.right[:, first] @ turn
        roots = roots_of(turn.T @ gram[:, first, first] @ turn)
        self.rank = ranks_of(roots)
        cross = np.concatenate([turn.T @ gram[:, first, more], (right[:, first] @ turn)[:, :, None]], axis=2)
        #: What the fitted ones say of the others and, last, of the residual.
        self.says = roots @ (roots.transpose(0, 2, 1) @ cross)
        self.cross, self.gram = cross, gram[:, more, more]
        self.right = right[:, more] - (cross[:, :, :-1].transpose(0, 2, 1) @ self.says[:, :, -1:])[:, :, 0]
        self.squares = squares - (cross[:, :, -1] * self.says[:, :, -1]).sum(axis=1)

    def _root(self, place: slice) -> Floats:
        left = self.gram[:, place, place] - self.cross[:, :, place].transpose(0, 2, 1) @ self.says[:, :, place]
        return roots_of(left, _LEFT)

    def outside(self, place: slice) -> tuple[Floats, Ints]:
        """Sums of squares (f,) that a fit to the rows outside each fold leaves there, and its rank (f,)."""
        root = self._root(place)
        taken = (root.transpose(0, 2, 1) @ self.right[:, place, None])[:, :, 0]
        return self.squares - (taken**2).sum(axis=1), self.rank + ranks_of(root)

    def held_out(self, place: slice) -> Floats:
        """Sums of squared errors (f,) of the rows of each fold under that fit."""
        root, folds = self._root(place), self.folds
        y = (root @ (root.transpose(0, 2, 1) @ self.right[:, place, None]))[:, :, 0]
        x = self.says[:, :, -1] - (self.says[:, :, place] @ y[:, :, None])[:, :, 0]
        first = len(folds.length) - self.gram.shape[1]
        others = slice(first + place.start, first + place.stop)
        along = (x * self.along).sum(axis=1) + (y * folds.right[:, others]).sum(axis=1)
        both = (x[:, None] @ (self.own @ x[:, :, None] + 2.0 * self.across[:, :, place] @ y[:, :, None]))[:, 0, 0]
        both += (y[:, None] @ folds.grams[:, others, others] @ y[:, :, None])[:, 0, 0]
        return np.asarray(folds.squares - 2.0 * along + both)


def ranks_of(roots: Floats) -> Ints:
    """Ranks (f,) of matrices with these :func:`roots_of`."""
    return np.asarray((roots != 0.0).any(axis=1).sum(axis=1))


def roots_of(grams: Floats, least: float = 0.0) -> Floats:
    """Matrices (…, k, k) whose products with their transposes are the pseudo-inverses; eigenvalues below ``least``
    count as none, and leave a column of zeros."""
    value, vector = linalg.eigh(grams)
    highest = np.max(value, axis=-1, initial=0.0, keepdims=True)
    keep = value > np.maximum(np.maximum(1e-11 * highest, least), 1e-300)
    return vector * np.where(keep, 1.0 / np.sqrt(np.where(keep, value, 1.0)), 0.0)[..., None, :]
