"""How far each row of a fit is from what the others predict there, by row and by pose.

Rows are wrong where they are further from what the others predict than chance takes them. The others are found without
believing any row more than another (Huber, *Robust Statistics*, 1981, 7.8: a convex problem, so that where it starts
does not matter), and grow or shrink until they stay (Billor, Hadi and Velleman, "BACON", *Computational Statistics &
Data Analysis* 34, 2000). What an effect or a smooth shape describes is no accident: columns join the fit as long as
one takes more of what is left, cut to size, than chance would (matching pursuit: Pati, Rezaiifar and Krishnaprasad,
1993). What was bumped for a while and put back is no witness. What is an outlier is decided by the expected share of
false ones (Benjamini and Hochberg, *J. R. Statist. Soc. B* 57, 1995).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cached_property, partial
from itertools import repeat

import numpy as np
import scipy

from ..base import linalg
from ..base.types import Bools, Floats, Ints
from ..data.noise import MAD
from ..evidence.linearised import Linearised
from ..evidence.shapes import Smooth, smooth_shapes
from ..evidence.thresholds import (
    A_FEW,
    ACCIDENT,
    HARDLY,
    HELD_EFFECT,
    HELD_SHAPE,
    LEVEL,
    LOUDER,
    ROUNDING,
    ROUNDS,
    WRONG,
)
from ..evidence.whitening import orthonormal
from ..fit.folds import BLOCK
from .robust_start import CUT, apart_from_pose, huber, median

#: Columns describe no more than this part of what is read.
_MOST_COLUMNS = 0.15
#: What is fitted is told by the means of the poses where so much of it is between them.
_BY_MEANS = 0.5
#: What is an outlier without a column, and alone tells so much of it with it, is no witness for it.
_ALONE = 0.5
#: What is more than noise has tails as of so many degrees of freedom.
_TAILS = 8.0
#: Chance of the other readings of a pose that is wrong in all of them; noise of heavy tails has one that is wild.
_OTHERS_OFF = 0.05, HARDLY
#: Efficiency of a median absolute deviation.
_MAD_EFFICIENCY = 0.37
#: A prediction is never taken for better than this part of the reading's own variance.
_LEAST_FREE = 0.1
#: Cuts at which a stretch of time is looked for.
_CUTS = 48


class OutlierFit:
    """Rows of a fit and how far each is from what the others predict there.

    ``e`` (n, m) are residuals, over noise that is ``declared`` or not; an item is what is judged as one: the readings
    of a pose that agree, or a row that stands apart from them. What is fitted is taken for the same in all rows of an
    item: ``basis`` (items · m, k) is orthonormal where each item weighs as much as it has rows. Rows that are known to
    have been ``bumped`` (n,) are items of their own. What is usual is that of the poses: the items of one have its
    ``weight`` (items,) by their rows, so that accidents in a run of many readings are not most of its items.
    """

    def __init__(self, view: Linearised, *, declared: bool, bumped: Bools | None = None) -> None:
        self.view, self.declared = view, declared
        self.e = view.residual
        self.floor = np.maximum(ROUNDING * np.ptp(self.e, axis=0), 1e-12)
        self.bumped = bumped
        self.within, apart = apart_from_pose(self.e, view.repeated, self.floor, ACCIDENT)
        if bumped is not None:
            apart = apart | bumped
        group = np.unique(view.repeated, return_inverse=True)[1].ravel()
        part = 1.0 / np.bincount(group)[group]
        group = np.where(apart, len(view) + np.arange(len(view)), group)
        self.item = np.unique(group, return_inverse=True)[1].ravel()
        self.count = np.bincount(self.item).astype(float)
        self.root = np.sqrt(self.count)[:, None]
        self.weight: Floats = np.bincount(self.item, part).astype(float)
        self.order = np.argsort(self.item, kind="stable")
        self.starts = np.concatenate([[0], np.cumsum(self.count[:-1])]).astype(np.int64)
        # of the mean of an item; nothing where it is not known
        variance = self.within**2 if self.within.any() else np.full(self.e.shape[1], float(declared))
        self.noise = variance / self.count[:, None]
        self.mean = self._down(self.e) / self.root
        self.basis = self._fitted_columns()

    def _fitted_columns(self) -> Floats:
        """What is fitted as the basis has it. What differs within poses more than between them, as a slip between two
        rounds of the same poses does, is left as the fit of the rows has it: of their means, only readings that stand
        apart would tell it."""
        flat = self._summed(self.view.fitted, np.arange(len(self.count)))
        every = sum((part.T @ part for part in map(self._flat_in, self.view.blocks)), np.zeros((flat.shape[1],) * 2))
        scale = np.sqrt(np.maximum(np.diag(every), 1e-300))
        value, vector = linalg.eigh(every / np.multiply.outer(scale, scale))
        told = value > ROUNDING * value.max(initial=0.0)
        known = vector[:, told] / np.sqrt(value[told]) / scale[:, None]
        between, turn = linalg.eigh(known.T @ (flat.T @ flat) @ known)
        by_means = between >= _BY_MEANS
        return orthonormal(flat if by_means.all() else flat @ known @ turn[:, by_means])

    def _flat_in(self, rows: slice) -> Floats:
        columns = self.view.fitted(rows)
        return columns.reshape(-1, columns.shape[2])

    def outliers(self) -> Bools:
        """Rows (n,) that are gross errors."""
        out = np.zeros(len(self.e), dtype=bool)
        if self.mean.size - self.basis.shape[1] < 10:
            return out
        everyone = np.ones(len(self.count), dtype=bool)
        plain, was_off, was = self._concentrated(self._left_by(self.basis, np.flatnonzero(everyone)), everyone)
        simple = self._criterion(plain, was_off)
        left, bumped = self._described()
        if bumped.any() and self.bumped is None:
            # readings of one pose that were taken in it and out of it are not to be told by their mean
            return OutlierFit(self.view, declared=self.declared, bumped=bumped).outliers()
        inliers, off, variance = self._concentrated(left, self._down(~bumped) > 0.5 * self.root[:, 0])
        excused = inliers & ~plain
        if excused.any() and self._fitted(inliers)[1][excused].mean() > _ALONE:
            inliers = inliers & plain
            off, variance = (np.where(plain[:, None], *one) for one in ((off, was_off), (variance, was)))
        accidents = self.count[~plain].sum() <= WRONG * len(out)
        if accidents and simple < self._criterion(inliers, off):
            inliers, off, variance = plain, was_off, was
        if np.square(off[inliers]).sum() > LOUDER**2 * self.noise[inliers].sum():
            # a structure that no column describes has extremes, which look like outliers
            inliers = inliers | plain
        for k in np.flatnonzero(~inliers):
            rows = self.order[self.starts[k] : self.starts[k] + int(self.count[k])]
            out[rows[self._wrong_of(self.e[rows] - self.mean[k] + off[k], variance[k])]] = True
        return out

    def _wrong_of(self, off: Floats, variance: Floats) -> Bools:
        """Which readings (c,) of a pose that is off as a whole are wrong, given how far they are ``off`` (c, m) and the
        ``variance`` (m,) of their mean. One reading may take all of its pose with it: the pose is wrong only where its
        other readings are off, too."""
        if len(off) == 1:
            return np.ones(1, dtype=bool)
        furthest = np.arange(len(off)) == np.argmax(
            np.square(off / np.maximum(variance, self.floor**2) ** 0.5).sum(axis=1)
        )
        spread = np.maximum(variance + self.within**2 / (len(off) * (len(off) - 1)), self.floor**2)
        square = float((off[~furthest].mean(axis=0) ** 2 / spread).sum())
        return furthest | (scipy.special.chdtrc(len(variance), square) < _OTHERS_OFF[self._has_tails])

    @cached_property
    def _has_tails(self) -> bool:
        """Whether readings of one pose differ with heavier tails than normal noise, by the fourth moment: of that it is
        3, give or take √(96 / n)."""
        steps = np.diff(self.e[self.order], axis=0)[np.diff(self.item[self.order]) == 0]
        square = np.square(steps) / np.maximum(np.square(steps).mean(axis=0), 1e-300)
        return bool(np.square(square).mean() > 3.0 + np.sqrt(96.0 / square.size))

    # -- what describes the run ----------------------------------------------------------------------------

    def _described(self) -> tuple[Floats, Bools]:
        """What is left of each item (items, m) once all that describes the run is in the basis, outliers cut to size;
        and the rows (n,) of a stretch that was bumped and put back."""
        (n, m), items = self.e.shape, len(self.count)
        # more items would choose no column that matters for a gross error
        seen = np.unique(np.linspace(0, items - 1, min(items, BLOCK)).astype(np.int64))
        q = orthonormal(self.basis.reshape(items, m, -1)[seen])
        still = self.view.effects[-1][1].stop if self.view.effects else 0
        shapes = [one for one in smooth_shapes(self.view) for _ in range(m if one.joint is None else 1)]
        effects = self._summed(lambda rows: self.view.effects_in(rows)[:, :, :still], seen)
        tried = np.concatenate([*map(self._shape, dict.fromkeys(shapes), repeat(seen)), effects], axis=1)
        free, least = tried - q @ (q.T @ tried), HELD_EFFECT * np.square(tried).sum(axis=0)
        chosen: list[int] = []
        moments: list[bool] = []
        steps, bumped = np.zeros((items * m, 0)), np.zeros(n, dtype=bool)
        # of a long run some rows tell where a stretch is
        stride = max(n // BLOCK, 1)
        within = np.zeros((self.e[::stride].size, 0))
        for _ in range(int(_MOST_COLUMNS * len(q))):
            left = self._left_by(q, seen)
            limit = CUT * self._spread(left, self.weight[seen])
            tame = (np.clip(left, -limit, limit) * self.root[seen] / limit).ravel()
            tame -= q @ (q.T @ tame)
            variance = float(tame @ tame) / (len(q) - q.shape[1])
            now = np.square(free).sum(axis=0)
            gain = np.where(now > least, np.square(tame @ free) / np.maximum(now, 1e-300), 0.0)
            chance = float(_chi2_log_tail(gain.max(initial=0.0) / variance, 1)) + math.log(max(len(gain), 1))
            stretch = self._stretch(left, seen, q, within, variance, moments)
            if min(chance, stretch[0]) >= math.log(LEVEL):
                break
            if stretch[0] < chance:
                inside = (np.arange(n) >= stretch[1]) & (np.arange(n) < stretch[2])
                moments.append(stretch[2] < n)
                if moments[-1]:
                    bumped = inside
                    columns = (self._down(inside)[:, None, None] * np.eye(m)).reshape(-1, m)
                else:
                    # what slipped turns, or moves with a joint; readings of a pose before it and after it differ
                    some: list[Floats] = []
                    steps = columns = self._summed(partial(self._later, still, inside, stride, some), np.arange(items))
                    of_items = (columns.reshape(items, m, -1) / self.root[:, :, None])[self.item[::stride]]
                    apart = (np.concatenate(some) - of_items).reshape(len(within), -1)
                    told = np.square(apart).sum(axis=0) > HELD_EFFECT * np.square(of_items).sum(axis=(0, 1))
                    within = orthonormal(apart[:, told])
                new = columns.reshape(items, m, -1)[seen].reshape(len(q), -1)
            else:
                chosen.append(int(np.argmax(gain)))
                new = tried[:, chosen[-1:]]
            # once more, since of a new column little may be left
            for _ in range(2):
                new = orthonormal(new - q @ (q.T @ new))
            free -= new @ (new.T @ free)
            q = np.concatenate([q, new], axis=1)
        every = np.arange(items)
        if len(seen) == items:
            more = [tried[:, chosen]]
        else:
            number = np.array(chosen, dtype=np.int64)
            more = [self._shape(shapes[k], every)[:, [k - shapes.index(shapes[k])]] for k in chosen if k < len(shapes)]
            which = number[number >= len(shapes)] - len(shapes)
            more.append(self._summed(lambda rows: self.view.effects_in(rows)[:, :, which], every))
        self.basis = orthonormal(np.concatenate([self.basis, steps, *more], axis=1))
        return self._left_by(self.basis, every), bumped

    def _left_by(self, q: Floats, items: Ints) -> Floats:
        """What orthonormal columns leave of the means of some items (items, m), outliers cut to size."""
        root = self.root[items]

        def taken(tame: Floats) -> Floats:
            return np.asarray((q @ (q.T @ (tame * root).ravel())).reshape(tame.shape) / root)

        return huber(self.mean[items], taken, self.weight[items])

    def _spread(self, left: Floats, weight: Floats) -> Floats:
        """Robust standard deviation (m,) of what is left (n, m), no less than digits."""
        return np.maximum(MAD * median(np.abs(left), weight), self.floor)

    def _later(self, still: int, those: Bools, stride: int, some: list[Floats], rows: slice) -> Floats:
        """Columns of what slips (b, m, k), of a stretch of rows, where it is one of ``those`` (n,), on each axis and by
        each effect; ``some`` keeps those of every so many rows."""
        effects = self.view.effects_in(rows)[:, :, still:]
        axes = np.broadcast_to(np.eye(effects.shape[1]), (len(effects), *2 * effects.shape[1:2]))
        columns = np.concatenate([axes, effects], axis=2) * those[rows, None, None]
        some.append(columns[-rows.start % stride :: stride])
        return columns

    def _shape(self, one: Smooth, items: Ints) -> Floats:
        """A smooth shape as the basis has it (items · m, k), where it is asked for: m columns on axes alone, or one."""
        if one.joint is None:
            columns = self._down(one.values)[items][:, None, None] * np.eye(self.e.shape[1])
        else:
            columns = self._down(self.view.arriving(one.joint, one.values[:, None])[:, :, 0])[items][:, :, None]
        return columns.reshape(-1, columns.shape[2])

    def _stretch(
        self, left: Floats, seen: Ints, q: Floats, within: Floats, variance: float, moments: list[bool]
    ) -> tuple[float, int, int]:
        """The stretch of time, or all from a moment on, in which rows are off by one vector most: log of its chance,
        its first row and the one after its last. Each is looked for once; ``moments`` say which were found, and columns
        ``within`` poses (orthonormal) what the one that stayed makes of their readings."""
        n, m = self.e.shape
        best = np.inf, 0, n
        if self.view.time is None:
            return best
        # of rows of items that are not seen all is zero
        every = np.zeros((len(seen) + 1, m, 2 + q.shape[1]))
        every[:-1] = np.dstack(
            [self.mean[seen] - left, np.ones(left.shape), q.reshape(*left.shape, -1) / self.root[seen, :, None]]
        )
        place = np.full(len(self.count), -1)
        place[seen] = np.arange(len(seen))
        stride = max(n // BLOCK, 1)
        rows = every[place[self.item[::stride]]]
        off = self.e[::stride] - rows[:, :, 0]
        if within.shape[1]:
            off = huber(off, lambda tame: (within @ (within.T @ tame.ravel())).reshape(tame.shape), np.ones(len(off)))
        limit = CUT * self._spread(off, np.ones(len(off)))
        tame = np.clip(off, -limit, limit) / limit * rows[:, :, 1]
        rows[:, :, 0] = tame - stride * rows[:, :, 2:] @ np.einsum("nm,nmk->k", tame, rows[:, :, 2:])
        variance = max(variance, float(np.square(rows[:, :, 0]).mean()))
        before = np.concatenate([np.zeros((1, *rows.shape[1:])), np.cumsum(rows, axis=0)])
        last = len(rows)
        starts = ends = np.linspace(0, last, min(_CUTS, last) + 1).astype(np.int64)
        while True:
            a, b = (v.ravel() for v in np.meshgrid(starts, ends, indexing="ij"))
            keep = (np.minimum(a, b - a) >= A_FEW) & ((b == last) | (b - a <= WRONG * last))
            a, b = (v[keep & ~np.isin(b < last, moments)] for v in (a, b))
            if not len(a):
                return best
            inside = before[b] - before[a]
            size = inside[:, :, 1]
            free = size - stride * np.square(inside[:, :, 2:]).sum(axis=2)
            gain = np.where(free > HELD_SHAPE * size, inside[:, :, 0] ** 2 / np.maximum(free, 1e-12), 0.0).sum(axis=1)
            ways = np.log(np.where(b == last, n, WRONG * n * n))
            chance = _chi2_log_tail(gain / variance, m) + ways
            k = int(np.argmin(chance))
            best = min(best, (float(chance[k]), int(a[k]), int(b[k])))
            apart = int(np.diff(starts).max(initial=1))
            if apart == 1:
                break
            near = np.arange(-apart, apart + 1, max(apart // _CUTS, 1))
            starts, ends = (np.unique(np.clip(one + near * (one < last), 0, last)) for one in best[1:])
        # between two of them, the row from which on all others are nearer to what is off than to what is not
        by, moment = (tame[best[1] : best[2]].mean(axis=0) * limit)[:, None], []
        for one, sign in zip(best[1:], (1.0, -1.0), strict=True):
            near = np.arange(max(one - 1, 0) * stride, min((one + 1) * stride, n))
            nearer = ((self.e[near] - every[place[self.item[near]], :, 0]) / limit**2) @ by - 0.5 * (
                by.T / limit**2
            ) @ by
            whole = one == last or stride == 1
            moment.append(min(one * stride, n) if whole else int(near[np.argmin(np.cumsum(sign * nearer))]) + 1)
        return best[0], moment[0], moment[1]

    # -- judging -------------------------------------------------------------------------------------------

    def _concentrated(self, left: Floats, witness: Bools) -> tuple[Bools, Floats, Floats]:
        """Inliers, from a start that leaves ``left`` (items, m), among those that are any ``witness``; how far each
        item is off from what they predict, and the variance of that (items, m)."""
        square = left**2 * self.count[:, None]
        distance = (square / np.maximum(median(square, self.weight), self.floor**2)).sum(axis=1)
        near = distance <= median(distance, self.weight)
        for robust in (True, False):
            # the spread of the inliers is known better than a median, but only once the outliers are out
            for _ in range(ROUNDS):
                off, hat = self._fitted(near & witness)
                far, variance = self._far(off, hat, near & witness, robust=robust)
                if np.array_equal(near, ~far):
                    break
                near = ~far
        return near, off, variance

    def _criterion(self, inliers: Bools, off: Floats) -> float:
        """Schwarz's criterion of the fit to some inliers, whatever is none having parameters of its own, and being
        chosen among all (Chen and Chen, *Biometrika* 95, 2008)."""
        items, m = off.shape
        out = items - int(inliers.sum())
        squares = np.maximum(np.square(off[inliers]).sum(axis=0) / items, self.floor**2)
        choice = -math.log(items + 1) - scipy.special.betaln(out + 1, items - out + 1)
        count = self.basis.shape[1] + m * out
        return float(items * np.log(squares).sum() + count * math.log(items * m) + 2.0 * choice)

    def _fitted(self, inliers: Bools) -> tuple[Floats, Floats]:
        """How far each mean is off from what a fit to the inliers predicts (items, m), and the variance of its
        predictions (items, m) over that of such a mean."""
        m = self.e.shape[1]
        part = self.basis.reshape(len(self.count), m, -1)[inliers].reshape(-1, self.basis.shape[1])
        value, vector = linalg.eigh(part.T @ part)
        # what the inliers do not tell is not held against the others
        root = self.basis @ (vector / np.sqrt(np.maximum(value, 1e-9)))
        of_inliers = np.where(inliers[:, None], self.root * self.mean, 0.0).ravel()
        predicted = (root @ (root.T @ of_inliers)).reshape(-1, m) / self.root
        return self.mean - predicted, np.square(root).sum(axis=1).reshape(-1, m)

    def _far(self, off: Floats, hat: Floats, inliers: Bools, *, robust: bool) -> tuple[Bools, Floats]:
        """Items that are further off than chance takes them, given the spread of the inliers; and the variance of
        each (items, m)."""
        items, m = off.shape
        free = np.where(inliers[:, None], np.maximum(1.0 - hat, _LEAST_FREE), 1.0 + hat)
        square = off**2 / free
        # an item of more readings is known better, as far as its readings differ among themselves
        each = self.within**2 / self.count[:, None]
        if robust:
            spread, usual = MAD**2 * median(square, self.weight), median(each, self.weight)
            freedom: Floats | float = _MAD_EFFICIENCY * self.weight.sum()
        else:
            # of each item, that of the others: an outlier would hide in its own
            others = inliers.sum() - inliers[:, None]
            spread = (square[inliers].sum(axis=0) - np.where(inliers[:, None], square, 0.0)) / others
            usual = each[inliers].mean(axis=0)
            freedom = float((1.0 - hat[inliers]).sum(axis=0).clip(2.0).mean()) - 1.0
            noise = (self.noise[inliers] * (1.0 - hat[inliers])).sum(axis=0)
            if (np.square(off[inliers]).sum(axis=0) > LOUDER**2 * noise).any() and noise.any():
                # a structure that nothing describes has tails, of a shape that nobody knows
                freedom = np.where(self.count > 1, min(freedom, _TAILS), freedom)
        variance = np.maximum(spread + each - usual, 0.5 * each)
        distance = (square / np.maximum(variance, self.floor**2)).sum(axis=1)
        p = scipy.special.fdtrc(m, np.maximum(freedom, 1.0), np.maximum(distance / m, 0.0))
        out = np.zeros(items, dtype=bool)
        # readings that stand apart from their pose are witnesses of each other, and of no pose that is wrong
        for alone in (True, False):
            those = np.flatnonzero((self.count == 1) == alone)
            order = those[np.argsort(p[those])]
            below = np.flatnonzero(p[order] <= ACCIDENT * np.arange(1, len(order) + 1) / items)
            those = order[: int(below[-1]) + 1 if len(below) else 0]
            out[those[np.cumsum(self.weight[those]) <= 0.5 * self.weight.sum()]] = True
        return out, variance * free

    # -- rows and items ------------------------------------------------------------------------------------

    def _down(self, values: Floats | Bools) -> Floats:
        """Values of rows (n, …) as the basis has items (items, …)."""
        total = np.add.reduceat(values[self.order], self.starts, axis=0, dtype=float)
        return total / self.root.reshape((-1,) + (1,) * (values.ndim - 1))

    def _summed(self, columns: Callable[[slice], Floats], items: Ints) -> Floats:
        """Columns that are given (b, m, p) for stretches of rows, as the basis has these items (items · m, p)."""
        place = np.full(len(self.count), -1)
        place[items] = np.arange(len(items))
        out = None
        for rows in self.view.blocks:
            given, at = columns(rows), place[self.item[rows]]
            if out is None:
                out = np.zeros((len(items), *given.shape[1:]))
            order = np.argsort(at, kind="stable")[(at < 0).sum() :]
            if len(order):
                which, starts = np.unique(at[order], return_index=True)
                out[which] += np.add.reduceat(given[order], starts, axis=0)
        assert out is not None, "a run has rows"
        return (out / self.root[items][:, :, None]).reshape(out.shape[0] * out.shape[1], out.shape[2])


def _chi2_log_tail(x: float | Floats, freedom: int) -> Floats:
    """Logarithm of the chance that χ² with ``freedom`` is beyond ``x`` (…), from its asymptote where the chance is no
    number any more."""
    p, half = scipy.special.chdtrc(freedom, x), 0.5 * np.maximum(x, 1.0)
    beyond = (0.5 * freedom - 1.0) * np.log(half) - half - math.lgamma(0.5 * freedom)
    return np.where(p > 0, np.log(np.maximum(p, 1e-320)), beyond)
