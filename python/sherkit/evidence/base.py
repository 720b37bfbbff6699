"""What is in the model, and by how much the readings favour each block beside it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
import scipy

import sherkit._core as _core

from ..base import linalg
from ..base.types import Floats, Ints
from ..model.effect import Effect
from .blocks import Block, ReferenceRows, Sort, sorts_of
from .family import Family, log_weights
from .run import Run
from .thresholds import HELD_EFFECT, HELD_SHAPE, ROUNDING, SCALES, TIED
from .whitening import independent, orthonormal

#: Noises by which what was fitted may change a reading beyond what is looked for.
_LARGE = np.array([60.0, 600.0, 6000.0])
#: What an error of its own at each pose may be, in noises of a reading, and degrees of freedom that tell it.
_OWN, _FREE = np.array([0.35, 0.7, 2.0, 6.0]), 10


def log_bayes(part: Floats, rank: Floats, free: float | Floats, count: int, scales: Floats = SCALES) -> Floats:
    """Logarithm of the Bayes factor (…) of columns of ``rank`` (…) that take this ``part`` (…) of what is left of
    ``count`` numbers, ``free`` of them not used up; -inf for columns of no rank.

    Coefficients are normal about zero and so large that they change a reading by ``scales`` (s,) noises, of which the
    mean counts; the noise has Jeffreys' prior (Liang et al., "Mixtures of g priors", JASA 2008).
    """
    part, k = np.atleast_1d(part), np.atleast_1d(np.asarray(rank, dtype=float))
    g = np.square(scales)[:, None] * count / np.maximum(k, 1.0)
    each = -0.5 * k * np.log1p(g) - 0.5 * free * np.log1p(-np.clip(part, 0.0, 1.0 - ROUNDING) * g / (1.0 + g))
    return np.where(k < 1, -np.inf, np.logaddexp.reduce(each, axis=0) - np.log(len(scales)))


def log_bayes_of_fit(part: Floats, rank: int, free: float, count: int) -> float:
    """The same of what was fitted in full: it may be many times as large as what is looked for, as another tool is, or
    a day's warmth."""
    ranks = np.array([rank])
    return float(max(log_bayes(part, ranks, free, count, scales)[0] for scales in (SCALES, _LARGE)))


def gain_asked(rank: float, free: int, count: int, odds: float) -> float:
    """What columns of this ``rank`` must take of what is left, in squared noises, for a :func:`log_bayes` of so many
    nats; infinite where nothing is enough."""

    def short(gain: float) -> float:
        return float(log_bayes(np.array([gain / (gain + free)]), np.array([rank]), free, count)[0]) - odds

    most = 1e3 * (odds + rank + 10.0)
    return float(scipy.optimize.brentq(short, 0.0, most)) if short(most) > 0 else float("inf")


def log_bayes_of(squares: Floats, right: Floats, rss: float, free: int, scales: Floats = SCALES) -> Floats:
    """The same (…) of columns whose coefficients are normal about zero with so many noises, whatever the rows: of their
    products with each other (…, k, k) and with what is left (…, k), whose square is ``rss``."""
    value, turn = _turned(squares)
    g = np.square(scales)[:, None] * value.clip(0.0)[..., None, :]
    along = np.square(np.einsum("...jk,...j->...k", turn, right))[..., None, :]
    taken = (along * np.square(scales)[:, None] / (1.0 + g)).sum(axis=-1) / rss
    each = -0.5 * np.log1p(g).sum(axis=-1) - 0.5 * free * np.log1p(-np.clip(taken, 0.0, 1.0 - ROUNDING))
    return np.asarray(np.logaddexp.reduce(each, axis=-1) - np.log(len(scales)))


def _turned(squares: Floats) -> tuple[Floats, Floats]:
    """Eigenvalues and vectors as :func:`~.base.linalg.eigh` gives them, of one or two columns by their formula."""
    if squares.shape[-1] > 2:
        return linalg.eigh(squares)
    if squares.shape[-1] == 1:
        return squares[..., 0], np.ones(squares.shape)
    a, b, c = squares[..., 0, 0], squares[..., 0, 1], squares[..., 1, 1]
    middle, off, angle = 0.5 * (a + c), 0.5 * np.hypot(a - c, 2.0 * b), 0.5 * np.arctan2(2.0 * b, a - c)
    x, y = np.cos(angle), np.sin(angle)
    turn = np.stack([np.stack([x, -y], axis=-1), np.stack([y, x], axis=-1)], axis=-2)
    return np.stack([middle + off, middle - off], axis=-1), turn


def total(logs: Floats) -> float:
    """Logarithm of a sum, given those of its terms."""
    return float(np.logaddexp.reduce(logs)) if len(logs) else -np.inf


def chance_of(evidence: float) -> float:
    """How often chance gives as much evidence, in nats, at most: a Bayes factor is E or more in no more than one of E
    runs of nothing but noise (Ville, 1939)."""
    # a p of zero would claim too much
    return max(float(np.exp(-max(evidence, 0.0))), 1e-300)


@dataclass(frozen=True, eq=False)
class OwnErrors:
    """What each of ``poses`` is off by its own: ``evidence`` in nats that it is, its ``size`` (m,) on each axis in
    noises, and over all axes as a ``part`` of the noise."""

    evidence: float
    size: Floats
    part: float
    poses: int


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
        return cls(family, q, run.residual - q @ (q.T @ run.residual), (), np.zeros(0)).asked(family)

    def asked(self, family: Family) -> Self:
        """The same model, asked what another ``family`` of the run says beside it."""
        products = family.columns.products(np.concatenate([self.basis, self.residual[:, None]], axis=1))
        left = _down(family, [gram for _, _, gram in family.groups], products[:, :-1])
        return replace(self, family=family, left=left, right=products[:, -1])

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
            gain[which], rank[which] = _core.blocks_taken(gram, self.right[at], self.family.least[which])
        return np.minimum(gain, self.rss * (1.0 - ROUNDING)), rank

    @cached_property
    def log_bf(self) -> Floats:
        """Logarithm of the Bayes factor of each block (B,) against none."""
        family = self.family
        if family.reference is not None:
            out = np.zeros(len(family))
            # what is no more than the digits of a reading tells nothing
            if self.free > 0 and self.rss > family.run.rounding:
                for (which, at, _), left, prior in zip(family.groups, self.left, family.priors, strict=True):
                    # what the model holds of a column tells nothing once more, however large its prior is
                    prior = np.where(np.einsum("bkk->bk", left) > family.least[which][:, None], prior, 0.0)
                    squares = left * prior[:, :, None] * prior[:, None, :]
                    out[which] = log_bayes_of(squares, self.right[at] * prior, self.rss, self.free)
            return out
        gain, rank = self.gains
        return log_bayes(gain / max(self.rss, 1e-300), rank, self.free / self.family.run.shared, len(self.residual))

    @cached_property
    def each(self) -> Floats:
        """The same with its prior weight (B,)."""
        return self.family.log_weight + self.log_bf

    @cached_property
    def effects(self) -> Floats:
        """The same of effects alone (B,), -inf for shapes."""
        return np.where(self.family.is_effect, self.each, -np.inf)

    @cached_property
    def shapes(self) -> Floats:
        """The same of shapes alone (B,), -inf for effects."""
        return np.where(self.family.is_effect, -np.inf, self.each)

    def all_or_part(self, block: Block) -> Block | None:
        """All of an effect of which a block is a part, or the likeliest part of one, in the same course; None where it
        has none."""
        blocks, part = self.family.blocks, block.pattern is not None
        same = [i for i, one in enumerate(blocks) if one.name == block.name and one.since == block.since]
        same = [i for i in same if (blocks[i].pattern is None) == part]
        return blocks[max(same, key=lambda i: self.each[i])] if same else None

    def in_common(self, block: Block) -> int:
        """How many of the last columns of a block are a nuisance beside which it is judged."""
        del block
        return 0

    def one_by_one(self, blocks: Sequence[Block]) -> float:
        """What shapes say together, each beside those before it, with their prior weights."""
        evidence, now, count = 0.0, self, len(self.residual)
        for block in blocks:
            columns, common = self.family.columns.of(block.at), self.in_common(block)
            if common:
                now = now._without(now._beyond(columns[:, -common:], HELD_SHAPE**0.5))
            q = now._beyond(columns[:, : len(block.at) - common], HELD_SHAPE**0.5)
            size = q.T @ now.residual
            part, free = float(size @ size) / max(now.rss, 1e-300), now.free / self.family.run.shared
            evidence += float(log_bayes(np.array([part]), np.array([q.shape[1]]), free, count)[0])
            evidence += float(self.family.log_weight[self.family.where(block)])
            now = now._without(q)
        return evidence

    def _without(self, q: Floats) -> Self:
        """The same without what an orthonormal basis (N, k) beside its own holds; what blocks then say is not asked."""
        basis = np.concatenate([self.basis, q], axis=1)
        return replace(self, basis=basis, residual=self.residual - q @ (q.T @ self.residual))

    @property
    def evidence(self) -> float:
        """By how much the readings favour that something is missing: the weighted mean of all Bayes factors."""
        return float(np.logaddexp(total(self.each), self.family.log_missing))

    def log_bf_of(self, after: Base, run: Run, blocks: Sequence[Block]) -> float:
        """Logarithm of the Bayes factor of effects that were fitted in full, in a ``run`` as that fit sees it, which
        leave the base ``after``."""
        family = self.family
        if family.reference is None:
            rank = max(after.basis.shape[1] - self.basis.shape[1], 1)
            part = np.array([1.0 - after.rss / self.rss])
            free = self.free / family.run.shared
            return log_bayes_of_fit(part, rank, free, len(self.residual))
        owns = [run.of.owns(block.effect) for block in blocks if block.effect is not None]
        at = np.concatenate([np.arange(own.start, own.stop) for own in owns])
        scale = np.concatenate([np.full(own.stop - own.start, family.scale_of(block))
                                for own, block in zip(owns, blocks, strict=True)])  # fmt: skip
        scale = scale * [run.of.fit.parameters[k].size for k in at]
        own = run.flat(run.view.fitted(run.view.whole))
        q = independent(np.delete(own, at, axis=1))
        mine = own[:, at] * scale
        mine = mine - q @ (q.T @ mine)
        # the readings as they are to first order about this fit, without what the rest of the model takes
        told = run.residual - q @ (q.T @ run.residual) + mine @ (run.of.fit.values[at] / scale)
        whole = float(told @ told)
        found = log_bayes_of(mine.T @ mine, mine.T @ told, whole, self.free)
        return float(found) - 0.5 * self.free * float(np.log(whole / self.rss))

    def in_place_of(self, effect: Effect) -> tuple[str, ...]:
        """Effects each of which, in the place of one that is in the model, comes as near the data; none where that one
        itself says nothing."""
        family, run = self.family, self.family.run
        at = run.of.owns(effect)
        own = run.flat(run.view.fitted(run.view.whole))
        others = independent(np.delete(own, at, axis=1))
        mine = own[:, at] - others @ (others.T @ own[:, at])
        basis = independent(mine)
        # what it explains, and of each column the part along that
        along, parts = basis.T @ (self.residual + mine @ run.of.fit.values[at]), family.columns.products(basis)
        most = self.rss * (1.0 + 2.0 * TIED / self.free)
        whole = self.rss + float(along @ along)
        if whole <= most:
            return ()
        names = []
        for (which, columns, _), gram in zip(family.groups, self.left, strict=True):
            part = parts[columns]
            right = self.right[columns] + part @ along
            gain, _ = _core.blocks_taken(gram + part @ part.transpose(0, 2, 1), right, family.least[which])
            near = [family.blocks[k] for k in which[whole - gain < most]]
            names += [one.name for one in near if one.effect is not None and one.name != effect.name]
        return tuple(dict.fromkeys(names))

    def takes(self, columns: Floats) -> float:
        """Sum of squares that these columns (N, k) would take."""
        return float(np.square(self._beyond(columns, HELD_EFFECT**0.5).T @ self.residual).sum())

    def own_errors(self, declared: Floats | None = None) -> OwnErrors | None:
        """Whether each pose has an error of its own beyond what is ``declared`` (m,), variances in noises, or beyond
        what the filter takes out already: None where too few were repeated.

        What lies between the visits of a pose is noise; where the means of poses vary by more, each has an error.
        """
        m = self.family.run.axes
        _, pose, count = np.unique(self.family.run.view.repeated, return_inverse=True, return_counts=True)
        pose = pose.ravel()
        residual, in_common = self.residual.reshape(-1, m), self.family.run.white.in_common
        if declared is None:
            declared = np.zeros(m)
        elif in_common is not None:
            residual = in_common.back(residual)
        mean = np.stack([np.bincount(pose, residual[:, a]) / count for a in range(m)], axis=1)
        within, whole = np.square(residual - mean[pose]).sum(axis=0), np.square(residual).sum(axis=0)
        between = whole - within
        free_within = float(len(pose) - len(count))
        free_between = self.free / m - free_within
        if min(free_within, free_between) < _FREE or not (within > ROUNDING**2 * whole).all():
            return None
        times, noise = len(pose) / len(count), within / free_within
        own = (between / free_between - noise) / times - declared
        # as if none had been declared
        between = between * noise / (noise + times * declared)
        grown = 1.0 + np.square(_OWN)[:, None] * times
        each = -0.5 * free_between * np.log(grown)
        each = each + 0.5 * (free_between + free_within) * np.log((between + within) / (between / grown + within))
        evidence = total(each.sum(axis=1) / self.family.run.shared) - float(np.log(len(_OWN)))
        part = float(np.sqrt(max(own.sum(), 0.0) / (noise + declared).sum()))
        return OwnErrors(evidence, np.sqrt(np.maximum(own, 0.0)), part, len(count))

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


def reference_of(run: Run, cuts: Ints) -> ReferenceRows:
    """What rows over all of a region and a span fix for those that will be read there; a step is tried from the rows
    ``cuts`` (c,) on. What the model fits anyway is not in it, nor are shapes that an effect is."""
    family = Family(run, ReferenceRows(run.view, cuts))
    base, n = Base.of(family, run), len(run) * run.axes
    there, left = np.zeros(len(family)), np.zeros(len(family))
    squares: dict[int, Floats] = {}
    for (which, _, _), grams, prior in zip(family.groups, base.left, family.priors, strict=True):
        inside = grams * prior[:, :, None] * prior[:, None, :]
        left[which], there[which] = np.einsum("bkk->b", grams), np.einsum("bkk->b", inside)
        there[which] *= there[which] > ROUNDING * np.square(prior).sum(axis=1)
        squares |= dict(zip(which.tolist(), inside, strict=True))
    family.without_twins(base.basis, left)
    kept = np.flatnonzero((there > 0) & np.isfinite(family.log_weight))
    weights = log_weights([family.blocks[i] for i in kept], family.is_effect[kept])
    sorts: dict[Sort, list[int]] = {}
    for k, i in enumerate(kept.tolist()):
        for sort in sorts_of(family.blocks[i]):
            sorts.setdefault(sort, []).append(k)
    # of several settings the middle one stands for all
    middle = {sort: some[len(some) // 2] for sort, some in sorts.items()}
    scale = {sort: float(np.sqrt(n / there[kept[k]])) for sort, k in middle.items()}
    return ReferenceRows(
        run.view, cuts, scale, {sort: float(weights[k]) for sort, k in middle.items()},
        {sort: scale[sort] ** 2 * squares[kept[k]] / n for sort, k in middle.items()},
    )  # fmt: skip
