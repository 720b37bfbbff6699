"""Columns of candidates: which they are among all, those of a stretch of rows, and a few in full, whose image
beside many rows is as small as they are few."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from ..base import linalg
from ..base.types import Floats
from ..evidence.whitening import orthonormal


@dataclass(frozen=True)
class Columns:
    """Columns of one candidate, all of one sort: functions on one axis (or all, ``axis`` None), full columns, waves of
    inputs, or waves on axes."""

    functions: tuple[int, ...] = ()
    axis: int | None = None
    dense: tuple[int, ...] = ()
    waves: tuple[int, ...] = ()
    along: tuple[int, ...] = ()
    exact: bool = False


@dataclass(frozen=True, eq=False)
class Block:
    """A stretch of rows under the filter in time: ``residual`` (b, m), ``fitted`` (b, m, p), ``functions`` (b, f),
    which act on single axes, and ``dense`` (b, m, d), which act on all."""

    residual: Floats
    fitted: Floats
    functions: Floats
    dense: Floats


class Rows(Protocol):
    """All rows of a scan, in the order of time, of which a stretch at a time is looked at."""

    @property
    def blocks(self) -> Sequence[slice]:
        """The stretches."""

    def block(self, rows: slice) -> Block:
        """One of them."""


@dataclass(frozen=True, eq=False)
class Projected:
    """Columns of a candidate: their Gram matrix ``whole`` (k, k), their products with the orthonormal model (k, rank),
    and with what the model leaves of the residual (k,)."""

    whole: Floats
    by_model: Floats
    by_residual: Floats

    @property
    def gram(self) -> Floats:
        """Gram matrix (k, k) of what the model leaves of them."""
        return self.whole - self.by_model @ self.by_model.T


class Triangle:
    """Columns turned so that all their rows are few: the triangle of a QR decomposition, block by block, keeps every
    length and angle between them to the last digits, which a Gram matrix does not."""

    def __init__(self) -> None:
        self.of: Floats = np.zeros((0, 0))

    def add(self, columns: Floats) -> None:
        """More rows (b, m, k)."""
        flat = columns.reshape(columns.shape[0] * columns.shape[1], columns.shape[2])
        stacked = np.concatenate([self.of, flat]) if len(self.of) else flat
        self.of = linalg.triangle(stacked) if stacked.shape[1] else np.zeros((0, 0))

    def root(self, tolerance: float = 1e-7) -> Floats:
        """What makes the columns orthonormal (k, rank)."""
        norm = np.linalg.norm(self.of, axis=0)
        scale = np.where(norm > 0, norm, 1.0)
        _, value, vector = linalg.svd(self.of / scale)
        keep = value > tolerance * value[:1]
        return vector[: len(value)][keep].T / value[keep] / scale[:, None]


@dataclass(frozen=True, eq=False)
class Image:
    """A model, some sets of columns and a residual, turned so that their rows are few: lengths, angles, projections
    and least squares among them are those of all rows, of which there are ``count``."""

    model: Floats
    columns: Sequence[Floats]
    residual: Floats
    count: int

    @cached_property
    def basis(self) -> Floats:
        """The model as orthonormal columns."""
        return orthonormal(self.model)

    def free_of_model(self, columns: Floats) -> Floats:
        """What the model leaves of columns (r, k) or (r,)."""
        return columns - self.basis @ (self.basis.T @ columns)

    def rss_and_rank(self, count: int) -> tuple[float, int]:
        """Sum of squares that the first columns of the model leave of the residual, and their rank."""
        basis = orthonormal(self.model[:, :count])
        left = self.residual - basis @ (basis.T @ self.residual)
        return float(left @ left), basis.shape[1]

    def rss(self, *which: int) -> float:
        """Sum of squares of the residual once these sets of columns are in the model too."""
        added = self.free_of_model(np.concatenate([self.model[:, :0], *(self.columns[k] for k in which)], axis=1))
        # a second projection, since an added column may have almost nothing left
        added = self.free_of_model(orthonormal(added))
        residual = self.free_of_model(self.residual)
        residual = residual - added @ (added.T @ residual)
        return float(residual @ residual)


def stretches_of(sets: Sequence[Sequence[int]]) -> list[slice]:
    """Stretches of columns that hold each of these sets of their numbers whole."""
    out: list[slice] = []
    for first, last in sorted({(min(one), max(one)) for one in sets if one}):
        start = out.pop() if out and first < out[-1].stop else slice(first, 0)
        out.append(slice(start.start, max(start.stop, last + 1)))
    return out


def add_products(gram: Floats, columns: Floats, stretches: Sequence[slice]) -> None:
    """Adds to ``gram`` (k, k) the products of columns (n, k) within each stretch: nobody asks for the others."""
    for some in stretches:
        gram[some, some] += columns[:, some].T @ columns[:, some]
