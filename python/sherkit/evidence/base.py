"""What is in the model, and by how much the readings favour each block beside it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
import scipy.stats

from ..base import linalg
from ..base.types import Floats, Ints
from .blocks import Block
from .family import Family
from .run import Run
from .thresholds import HELD_EFFECT, HELD_SHAPE, SCALES
from .whitening import orthonormal

#: What an error of its own at each pose may be, in noises of a reading, and degrees of freedom that tell it.
_OWN, _FREE = np.array([0.35, 0.7, 2.0, 6.0]), 5
#: No more of a sum of squares is taken than all of it.
_ALL = 1.0 - 1e-12


def log_bayes(part: Floats, rank: Floats, free: int | Floats, count: int, scales: Floats = SCALES) -> Floats:
    """Logarithm of the Bayes factor (…) of columns of ``rank`` (…) that take this ``part`` (…) of what is left of
    ``count`` numbers, ``free`` of them not used up; -inf for columns of no rank.

    Coefficients are normal about zero and so large that they change a reading by ``scales`` (s,) noises, of which the
    mean counts; the noise has Jeffreys' prior (Liang et al., "Mixtures of g priors", JASA 2008).
    """
    part, k = np.atleast_1d(part), np.atleast_1d(np.asarray(rank, dtype=float))
    g = np.square(scales)[:, None] * count / np.maximum(k, 1.0)
    each = -0.5 * k * np.log1p(g) - 0.5 * free * np.log1p(-np.clip(part, 0.0, _ALL) * g / (1.0 + g))
    return np.where(k < 1, -np.inf, np.logaddexp.reduce(each, axis=0) - np.log(len(scales)))


def taken(grams: Floats, right: Floats, least: Floats) -> tuple[Floats, Floats]:
    """Sum of squares (b,) that blocks take, by the products (b, k, k) within each and those with what is left (b, k),
    and the rank (b,) of each: columns of whose square no more is left than ``least`` (b,) are none."""
    there, ridge = np.einsum("bkk->bk", grams) > least[:, None], least[:, None, None] * np.eye(right.shape[1])
    inside = np.where(there[:, :, None] & there[:, None, :], grams, 0.0) + ridge
    mine = np.where(there, right, 0.0)
    return np.einsum("bk,bk->b", mine, linalg.solve(inside, mine[:, :, None])[:, :, 0]), there.sum(axis=1)


def total(logs: Floats) -> float:
    """Logarithm of a sum, given those of its terms."""
    return float(np.logaddexp.reduce(logs)) if len(logs) else -np.inf


@dataclass(frozen=True, eq=False)
class Base:
    """What is in the model of a run: an orthonormal ``basis`` (N, p) and the ``residual`` (N,) that it leaves.

    ``left`` are, as the family's groups are, products within each block of what the basis leaves of it; ``right`` (K,)
    those of all columns with the residual.
    """

    family: Family
    basis: Floats
    residual: Floats
    left: tuple[Floats, ...]
    right: Floats

    @classmethod
    def of(cls, family: Family, run: Run) -> Self:
        """What a fit of the family's rows has in its model."""
        q = run.basis
        residual = run.residual - q @ (q.T @ run.residual)
        products = family.columns.products(np.concatenate([q, residual[:, None]], axis=1))
        left = _down(family, [gram for _, _, gram in family.groups], products[:, :-1])
        return cls(family, q, residual, left, products[:, -1])

    def beside(self, *blocks: Block) -> Self:
        """The same with these blocks in the model, at any size."""
        out = self
        for block in blocks:
            least = np.sqrt(HELD_SHAPE if block.effect is None else HELD_EFFECT)
            out = out.with_columns(self.family.columns.of(block.at), float(least))
        return out

    def with_columns(self, columns: Floats, least: float = HELD_EFFECT**0.5) -> Self:
        """The same with these columns (N, k), of unit length, in the model: what is ``least`` of them is none."""
        q = self._beyond(columns, least)
        size = q.T @ self.residual
        products = self.family.columns.products(q)
        return replace(
            self,
            basis=np.concatenate([self.basis, q], axis=1),
            residual=self.residual - q @ size,
            left=_down(self.family, self.left, products),
            right=self.right - products @ size,
        )

    @cached_property
    def rss(self) -> float:
        """Sum of squares that is left."""
        return float(self.residual @ self.residual)

    @property
    def free(self) -> int:
        """Numbers that are read and not used up."""
        return len(self.residual) - self.basis.shape[1]

    # -- questions ------------------------------------------------------------------------------------------------

    @cached_property
    def gains(self) -> tuple[Floats, Floats]:
        """Sum of squares that each block would take (B,), and its rank beside what is in the model (B,)."""
        gain, rank = np.zeros(len(self.family)), np.zeros(len(self.family))
        for (which, at, _), gram in zip(self.family.groups, self.left, strict=True):
            gain[which], rank[which] = taken(gram, self.right[at], self.family.least[which])
        return np.minimum(gain, self.rss * _ALL), rank

    @cached_property
    def log_bf(self) -> Floats:
        """Logarithm of the Bayes factor of each block (B,) against none."""
        gain, rank = self.gains
        return log_bayes(gain / max(self.rss, 1e-300), rank, self.free, len(self.residual))

    @cached_property
    def each(self) -> Floats:
        """The same with its prior weight (B,)."""
        return self.family.log_weight + self.log_bf

    @cached_property
    def shapes(self) -> Floats:
        """The same of shapes alone (B,), -inf for effects."""
        return np.where(self.family.is_effect, -np.inf, self.each)

    @property
    def evidence(self) -> float:
        """By how much the readings favour that something is missing: the weighted mean of all Bayes factors."""
        return total(self.each)

    def takes(self, columns: Floats) -> float:
        """Sum of squares that these columns (N, k) would take."""
        return float(np.square(self._beyond(columns, HELD_EFFECT**0.5).T @ self.residual).sum())

    @cached_property
    def of_its_own(self) -> tuple[float, float]:
        """Logarithm of the Bayes factor of an error of its own at each pose, and how large that is, in noises of a
        reading: nothing where poses were not repeated.

        What lies between the visits of a pose is noise; where the means of poses vary by more, each has an error.
        """
        m = self.family.run.axes
        pose = np.unique(self.family.run.poses, return_inverse=True)[1].ravel()
        count = np.bincount(pose)
        residual = self.residual.reshape(-1, m)
        mean = np.stack([np.bincount(pose, residual[:, a]) / count for a in range(m)], axis=1)
        within = float(np.square(residual - mean[pose]).sum())
        between = self.rss - within
        free_within = (len(pose) - len(count)) * m
        free_between = self.free - free_within
        if min(free_within, free_between) < _FREE or within <= 0 or between <= 0:
            return 0.0, 0.0
        times = len(pose) / len(count)
        grown = 1.0 + np.square(_OWN) * times
        each = -0.5 * free_between * np.log(grown)
        each += 0.5 * (free_between + free_within) * np.log((between + within) / (between / grown + within))
        size = np.sqrt(max(between / free_between / (within / free_within) - 1.0, 0.0) / times)
        return total(each) - float(np.log(len(_OWN))), float(size)

    def power(self, block: int, size: float, level: float) -> float:
        """Chance that a test of this block at this ``level`` finds it where its columns, each of unit length, add up to
        ``size`` noises beside what is in the model: by the non-central χ² of its rank."""
        rank = max(float(self.gains[1][block]), 1.0)
        limit = scipy.stats.chi2.isf(level, rank)
        return float(scipy.stats.ncx2.sf(limit, rank, max(size, 1e-12) ** 2))

    def held_out(self, folds: Sequence[Ints]) -> Floats:
        """Squared errors (repetitions, N), in squared noises, of rows that a fit to the others predicts: ``folds``
        (n,) each say of each row with which others it is held out."""
        return np.stack([self._held_out(np.repeat(fold, self.family.run.axes)) for fold in folds])

    # -- within ---------------------------------------------------------------------------------------------------

    def _held_out(self, fold: Ints) -> Floats:
        out = np.empty(len(self.residual))
        for k in np.unique(fold):
            some = fold == k
            q, r = self.basis[some], self.residual[some]
            # what the others leave of the model is I - q'q: a Schur step, no other fit
            value, turn = linalg.eigh(np.eye(q.shape[1]) - q.T @ q)
            keep = value > 1e-9
            root = (q @ turn[:, keep]) / np.sqrt(value[keep])
            out[some] = np.square(r + root @ (root.T @ r))
        return out

    def _beyond(self, columns: Floats, least: float) -> Floats:
        """What the model leaves of columns (N, k), orthonormal (N, rank)."""
        over = columns - self.basis @ (self.basis.T @ columns)
        q = orthonormal(over[:, np.linalg.norm(over, axis=0) > least], least)
        return np.asarray(q - self.basis @ (self.basis.T @ q))


def _down(family: Family, grams: Sequence[Floats], products: Floats) -> tuple[Floats, ...]:
    """Products within blocks without what new orthonormal columns have of them, ``products`` (K, k) of all columns."""
    out = []
    for (_, at, _), gram in zip(family.groups, grams, strict=True):
        inside = products[at]
        out.append(gram - inside @ inside.transpose(0, 2, 1))
    return tuple(out)
