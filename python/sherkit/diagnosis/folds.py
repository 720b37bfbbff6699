"""Gram matrices fold by fold: a fit to the rows outside a fold is a subtraction."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..types import Floats, Ints


@dataclass(frozen=True, eq=False)
class Folds:
    """Columns (n, m, k) of unit length against a residual (n, m), summed over the rows of each fold.

    ``grams`` (f, k, k), ``right`` (f, k) products with the residual, ``squares`` (f,) of the residual and ``counts``
    (f,) of numbers in it.
    """

    grams: Floats
    right: Floats
    squares: Floats
    counts: Ints

    @classmethod
    def of(cls, columns: Floats, residual: Floats, fold: Ints) -> Folds:
        """Over the rows of each ``fold`` (n,); ``columns`` are of :func:`unit_length`."""
        count, k, m = int(fold.max()) + 1, columns.shape[2], residual.shape[1]
        grams, right = np.zeros((count, k, k)), np.zeros((count, k))
        for f in range(count):
            part = columns[fold == f].reshape(-1, k)
            grams[f], right[f] = part.T @ part, part.T @ residual[fold == f].reshape(-1)
        squares = np.bincount(fold, (residual**2).sum(axis=1), count).astype(float)
        return cls(grams, right, squares, m * np.bincount(fold, minlength=count))

    def __len__(self) -> int:
        return len(self.grams)

    def outside(self, fold: int) -> tuple[Floats, Floats, float, int]:
        """Gram matrix, right side, sum of squares and count of all rows outside a fold."""
        return (
            self.grams.sum(axis=0) - self.grams[fold],
            self.right.sum(axis=0) - self.right[fold],
            float(self.squares.sum() - self.squares[fold]),
            int(self.counts.sum() - self.counts[fold]),
        )


def root_of(gram: Floats, least: float = 0.0) -> Floats:
    """A matrix (k, rank) whose product with its transpose is the pseudo-inverse; eigenvalues below ``least`` count as
    none."""
    value, vector = np.linalg.eigh(gram)
    keep = value > max(1e-11 * float(value.max(initial=0.0)), least, 1e-300)
    return vector[:, keep] / np.sqrt(value[keep])


def solved(gram: Floats, right: Floats) -> Floats:
    """The shortest least-squares solution (k,)."""
    root = root_of(gram)
    return root @ (root.T @ right)


def unit_length(columns: Floats) -> Floats:
    """Columns (n, m, k), each divided by its length."""
    length = np.sqrt((columns**2).sum(axis=(0, 1)))
    return columns / np.where(length > 0, length, 1.0)
