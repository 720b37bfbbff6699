"""Blocks of poses that are held out together, and Gram matrices fold by fold: a fit to the rows outside a fold is a
subtraction.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
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


# -- Gram matrices, fold by fold -------------------------------------------------------------------------------------

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
    of a row stands, ``length`` (k,) what the columns were divided by. ``known`` (2, k) is what is known of the
    coefficients without any row: their precision, and its product with their values.
    """

    grams: Floats
    right: Floats
    squares: Floats
    counts: Ints
    place: Ints
    length: Floats
    known: Floats

    @classmethod
    def of(cls, columns: Callable[[slice], Floats], residual: Floats, fold: Ints, known: Floats | None = None) -> Folds:
        """``columns`` gives those (b, m, k) of a stretch of rows; ``fold`` (repetitions, n) is the fold of each row."""
        (grams,), place = summed(columns, residual, fold, lambda part: [part.T @ part])
        length = _lengths(np.diagonal(grams, axis1=1, axis2=2)[: len(grams) // len(fold), :-1], known)
        counts = residual.shape[1] * np.bincount(place.ravel(), minlength=len(grams))
        return cls(
            grams[:, :-1, :-1] / np.multiply.outer(length, length), grams[:, :-1, -1] / length, grams[:, -1, -1],
            counts, place, length, _known(known, length),
        )  # fmt: skip

    def __len__(self) -> int:
        return len(self.grams)

    def some(self, which: Sequence[int]) -> Folds:
        """With these of the columns only."""
        w = list(which)
        return Folds(
            self.grams[:, w][:, :, w],
            self.right[:, w],
            self.squares,
            self.counts,
            self.place,
            self.length[w],
            self.known[:, w],
        )

    def repetition(self, k: int) -> Folds:
        """Those of one repetition."""
        count = len(self) // len(self.place)
        own = slice(k * count, (k + 1) * count)
        place = self.place[k : k + 1] - own.start
        return Folds(
            self.grams[own], self.right[own], self.squares[own], self.counts[own], place, self.length, self.known
        )

    @property
    def outside(self) -> tuple[Floats, Floats, Floats, Floats]:
        """Gram matrices, right sides, sums of squares and counts of all rows outside each fold; what is known without
        any row is in each."""
        inside = (self.grams, self.right, self.squares, self.counts)
        gram, right, squares, counts = (_outside(one, len(self.place)) for one in inside)
        return gram + np.diag(self.known[0]), right + self.known[1], squares, counts

    @property
    def solutions(self) -> Floats:
        """Least squares of the rows outside each fold (f, k), of columns of unit length."""
        gram, right, _, _ = self.outside
        turn = _turn(self.grams, len(self.place))
        turned = turn.T @ gram @ turn
        if len(turn.T) and linalg.eigvalsh(turned).min() > _BEYOND:
            return linalg.solve(turned, turn.T @ right[:, :, None])[:, :, 0] @ turn.T
        root = roots_of(gram)
        return (root @ (root.transpose(0, 2, 1) @ right[:, :, None]))[:, :, 0]

    @property
    def held_out(self) -> Floats:
        """Sums of squared errors of the rows of each fold (f,) under the fit to the others."""
        x = self.solutions
        return self.squares - 2.0 * (x * self.right).sum(axis=1) + np.einsum("fk,fkl,fl->f", x, self.grams, x)

    def errors(self, columns: Floats, residual: Floats, rows: slice) -> Floats:
        """Errors (repetitions, b, m) of a stretch of rows, each under the fit to the rows outside its fold. ``columns``
        (b, m, k) and ``residual`` (b, m) are as given to :meth:`of`."""
        x = self.solutions / self.length
        return residual - np.stack([np.einsum("nmk,nk->nm", columns, x[of[rows]]) for of in self.place])


class Beside:
    """What sets of further columns bring beside fitted ones, fold by fold: these are solved for once, and each set is a
    small matrix (the Schur complement of its own). No set is multiplied with another.

    ``columns`` gives those (b, m, k) of a stretch of rows, the fitted ones and behind them sets of so many as
    ``counts`` says; all else is as in :class:`Folds`. Of every set the errors of the rows of
    each fold are known under the fit to the others (:attr:`held_out`).
    """

    def __init__(
        self,
        columns: Callable[[slice], Floats],
        counts: Sequence[int],
        residual: Floats,
        fold: Ints,
        known: Floats | None = None,
    ) -> None:
        more, times, count = sum(counts), len(fold), np.array(counts, dtype=np.int64)
        first = np.cumsum(count) - count
        #: Sets of one size together: which, and their columns (s, k).
        self.sets = [
            (which := np.flatnonzero(count == k), first[which, None] + np.arange(k)) for k in np.unique(count).tolist()
        ]

        def products(part: Floats) -> list[Floats]:
            fitted, others, left = part[:, : -1 - more], part[:, -1 - more : -1], part[:, -1]
            each = [others.T[at] for _, at in self.sets]
            return [left @ part, fitted.T @ part[:, :-1], *(one @ one.transpose(0, 2, 1) for one in each)]

        (by_residual, by_fitted, *own), self.place = summed(columns, residual, fold, products)
        p, one_time = by_fitted.shape[1], len(by_fitted) // times
        length = np.ones(p + more)
        length[:p] = _lengths(np.diagonal(by_fitted[:one_time, :, :p], axis1=1, axis2=2), known)
        for (_, at), gram in zip(self.sets, own, strict=True):
            length[p + at] = _lengths(np.diagonal(gram[:one_time], axis1=2, axis2=3))
        by_fitted = by_fitted / (length[:p, None] * length)
        right, self.all_squares = by_residual[:, :-1] / length, by_residual[:, -1]
        self.counts = residual.shape[1] * np.bincount(self.place.ravel(), minlength=len(right))
        #: Inside each fold: products of the others with the residual, and of each set (f, s, k, k) with itself.
        self.right = right[:, p:]
        self.grams = [
            gram / (length[p + at][:, :, None] * length[p + at][:, None, :])
            for (_, at), gram in zip(self.sets, own, strict=True)
        ]
        turn = _turn(by_fitted[:, :, :p], times)
        #: The same of the fitted ones, turned, with themselves, the others and the residual.
        self.own = turn.T @ by_fitted[:, :, :p] @ turn
        self.across = turn.T @ by_fitted[:, :, p:]
        self.along = right[:, :p] @ turn
        given = _known(known, length[:p])
        roots = roots_of(_outside(self.own, times) + turn.T @ (given[0][:, None] * turn))
        #: Outside each fold: products of the fitted ones with the others, and what they say of these and, last, of the
        #: residual; what they leave of the products with the residual.
        cross = _outside(np.concatenate([self.across, self.along[:, :, None]], axis=2), times)
        cross[:, :, -1] += given[1] @ turn
        self.says = roots @ (roots.transpose(0, 2, 1) @ cross)
        self.cross = cross[:, :, :-1]
        self.left = _outside(self.right, times) - (self.cross.transpose(0, 2, 1) @ self.says[:, :, -1:])[:, :, 0]

    def __len__(self) -> int:
        return len(self.counts)

    def _each(self) -> Iterator[tuple[Ints, Ints, Floats, Floats]]:
        """Sets of one size: which, their columns (s, k), their Gram matrices (f, s, k, k), and the roots of what the
        fitted ones leave of them outside each fold."""
        for (which, at), gram in zip(self.sets, self.grams, strict=True):
            cross, says = (one[:, :, at].transpose(0, 2, 1, 3) for one in (self.cross, self.says))
            left = _outside(gram, len(self.place)) - cross.transpose(0, 1, 3, 2) @ says
            yield which, at, gram, roots_of(left, _LEFT)

    @property
    def held_out(self) -> Floats:
        """Of each set sums of squared errors (sets, f) of the rows of each fold under that fit."""
        out = np.zeros((sum(len(which) for which, _ in self.sets), len(self)))
        for which, at, gram, root in self._each():
            says, across = (one[:, :, at].transpose(0, 2, 1, 3) for one in (self.says, self.across))
            y = root @ (root.transpose(0, 1, 3, 2) @ self.left[:, at, None])
            x = self.says[:, None, :, -1:] - says @ y
            along = (x[..., 0] * self.along[:, None]).sum(axis=2) + (y[..., 0] * self.right[:, at]).sum(axis=2)
            both = x.transpose(0, 1, 3, 2) @ (self.own[:, None] @ x + 2.0 * across @ y)
            both += y.transpose(0, 1, 3, 2) @ gram @ y
            out[which] = (self.all_squares[:, None] - 2.0 * along + both[..., 0, 0]).T
        return out


def summed(
    columns: Callable[[slice], Floats], residual: Floats, fold: Ints, products: Callable[[Floats], list[Floats]]
) -> tuple[list[Floats], Ints]:
    """What ``products`` gives of some rows of the columns and, last, the residual (b · m, k + 1), each summed over the
    rows of each fold of each repetition (f, …); and where the fold of each row stands (repetitions, n)."""
    times, n = fold.shape
    per_repetition = int(fold.max()) + 1
    place = fold + per_repetition * np.arange(times)[:, None]
    # rows that are in the same fold in every repetition are summed once
    code = (per_repetition ** np.arange(times)) @ fold
    _, first_of, cell = np.unique(code, return_index=True, return_inverse=True)
    cells = place[:, first_of]
    sums: list[Floats] = []
    for rows in blocks(n):
        order = np.argsort(cell[rows], kind="stable")
        both = np.concatenate([columns(rows), residual[rows][:, :, None]], axis=2)
        here = cell[rows][order]
        edges = [0, *(np.flatnonzero(np.diff(here)) + 1).tolist(), len(here)]
        parts, of = list(pairwise(edges)), cells[:, here[edges[:-1]]]
        # a few at a time: adding each by itself would take longer than to make it
        for some in blocks(len(parts), max(_TOGETHER // both.shape[2] ** 2, 1)):
            made = [products(both[order[a:b]].reshape(-1, both.shape[2])) for a, b in parts[some]]
            in_fold = np.zeros((times * per_repetition, len(made)))
            in_fold[of[:, some], np.arange(len(made))] = 1.0
            more = [np.tensordot(in_fold, np.stack(one), 1) for one in zip(*made, strict=True)]
            sums = [a + b for a, b in zip(sums, more, strict=True)] if sums else more
    return sums, place


def _outside(inside: Floats | Ints, times: int) -> Floats:
    """Of something summed over each fold, what is outside it, within its repetition of so many."""
    repetitions = inside.reshape(times, len(inside) // times, *inside.shape[1:])
    return (repetitions.sum(axis=1, keepdims=True) - repetitions).reshape(inside.shape)


def _known(known: Floats | None, length: Floats) -> Floats:
    """What is known of coefficients (2, k), of columns of unit length."""
    return np.zeros((2, len(length))) if known is None else known / np.stack([length**2, length])


def _lengths(squares: Floats, known: Floats | None = None) -> Floats:
    """What columns (k,) are divided by, of their squares in each fold (f, k) of one repetition, and what is known of
    their coefficients: of a column that is next to nothing that is all."""
    length = np.sqrt(squares.sum(axis=0) + (0.0 if known is None else known[0]))
    return np.where(length > 0, length, 1.0)


def _turn(grams: Floats, times: int) -> Floats:
    """What makes columns with these Gram matrices (f, k, k) in each fold orthonormal over all rows (k, rank)."""
    root = roots_of(grams[: len(grams) // times].sum(axis=0))
    return root[:, (root != 0.0).any(axis=0)]


def roots_of(grams: Floats, least: float = 0.0) -> Floats:
    """Matrices (…, k, k) whose products with their transposes are the pseudo-inverses; eigenvalues below ``least``
    count as none, and leave a column of zeros."""
    value, vector = linalg.eigh(grams)
    highest = np.max(value, axis=-1, initial=0.0, keepdims=True)
    keep = value > np.maximum(np.maximum(1e-11 * highest, least), 1e-300)
    return vector * np.where(keep, 1.0 / np.sqrt(np.where(keep, value, 1.0)), 0.0)[..., None, :]
