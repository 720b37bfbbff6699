"""How far each row of a fit is from what the others predict there: by pose, by row, by a stretch of time.

The start believes no row more than another (Huber, *Robust Statistics*, 1981, 7.8: a convex problem, so that where it
starts does not matter); then the inliers grow or shrink until they stay (blocks of rows by their predicted error:
Billor, Hadi and Velleman, "BACON", *Computational Statistics & Data Analysis* 34, 2000). What is an outlier is decided
by the expected share of false ones (Benjamini and Hochberg, *J. R. Statist. Soc. B* 57, 1995).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cached_property

import numpy as np
import scipy

from ..base import linalg
from ..base.types import Bools, Floats, Ints
from ..data.noise import MAD
from ..evidence.fitted_run import DIGITS
from ..evidence.linearised import Linearised, step_gains, within
from ..evidence.shapes import Smooth, smooth_shapes
from ..evidence.whitening import orthonormal
from ..fit.folds import BLOCK
from .robust_start import CUT, ROUNDS, apart_from_pose, huber

#: Chance that a run without gross errors has anything listed; of several that are listed, the expected part of false
#: ones.
_LEVEL = 0.005
#: Chance that a column takes part in describing a run of pure noise.
_DESCRIBED = 0.01
#: Columns are described by no more than this part of the poses' readings.
_MOST_COLUMNS = 0.15
#: Directions that the rows tell less than this part of the best one are none; what is fitted is told by the means of
#: the poses where so much of it is between them.
_TOLD, _BY_MEANS = 1e-12, 0.5
#: A column of which the fitted ones leave less than this is one of theirs.
_ABSORBED = 1e-3
#: What is left counts as noise up to this many times the noise.
_LIKE_NOISE = 1.5
#: What is an outlier without a column, and alone tells so much of it with it, is no witness for it.
_ALONE = 0.25
#: Where more than noise is left, a pose that is wrong is so many times as far off as any that is none.
_CLEAR = 2.0
#: Chance of a reading that is judged without the others of its pose; variance of readings about the median of three.
_ALONE_OFF = 1e-2
_ABOUT_A_MEDIAN = 1.5
#: Chance of the nearer of two readings of a pose that is wrong in both: heavy tails have one that is wild.
_BOTH_OFF = 1e-3
#: Efficiency of a median absolute deviation.
_MAD_EFFICIENCY = 0.37
#: A prediction is never taken for better than this part of the reading's own variance.
_LEAST_FREE = 0.1
#: Rows of which a stretch of time has at least so many; part of the run, at most, that something was bumped for before
#: it was put back, and cuts at which it is looked for.
_FEWEST_OF_A_STRETCH = 4
_MOST_BUMPED = 0.2
_CUTS = 48
#: Bytes of columns that are kept rather than made again.
_KEPT = 64e6


class OutlierFit:
    """Rows of a fit and how far each is from what the others predict there.

    ``e`` (n, m) are residuals, over noise that is ``declared`` or not; an item is what is judged as one: the readings
    of a pose that agree, or a row that stands apart from them. What is fitted is taken for the same in all rows of an
    item: ``basis`` (items · m, k) is orthonormal where each item weighs as much as it has rows. The rows of a
    ``stretch`` (n,) are items of their own, which are never inliers but share one error; rows that stand ``alone`` (n,)
    are judged without the others of their pose.
    """

    def __init__(
        self, view: Linearised, *, declared: bool, stretch: Bools | None = None, alone: Bools | None = None
    ) -> None:
        self.view = view
        self.declared = declared
        self.e = view.residual
        self.floor = np.maximum(DIGITS * np.ptp(self.e, axis=0), 1e-12)
        self.within, apart = apart_from_pose(self.e, view.repeated, self.floor, _LEVEL)
        if alone is not None:
            apart = apart | alone
        first, size = np.arange(len(view)), len(view)
        group = np.unique(view.repeated, return_inverse=True)[1].ravel()
        group = np.where(apart, size + first, group)
        if stretch is not None:
            group = np.where(stretch, 2 * size + group, group)
        self.item = np.unique(group, return_inverse=True)[1].ravel()
        self.count = np.bincount(self.item).astype(float)
        self.order = np.argsort(self.item, kind="stable")
        self.starts = np.concatenate([[0], np.cumsum(self.count[:-1])]).astype(np.int64)
        self.moved = np.zeros(len(self.count), dtype=bool) if stretch is None else stretch[self.order[self.starts]]
        # of the mean of an item; nothing where it is not known
        variance = self.within**2 if self.within.any() else np.full(self.e.shape[1], float(declared))
        self.noise = variance / self.count[:, None]
        self.basis = self._fitted_columns()

    def _fitted_columns(self) -> Floats:
        """What is fitted as the basis has it. What differs within poses more than between them, as a slip between two
        rounds of the same poses does, is left as the fit of the rows has it: of their means, only readings that stand
        apart would tell it."""
        columns = self._summed(self.view.fitted)
        flat = columns.reshape(-1, columns.shape[2])
        every = np.zeros((flat.shape[1], flat.shape[1]))
        for rows in self.view.blocks:
            part = self.view.fitted(rows).reshape(-1, flat.shape[1])
            every += part.T @ part
        scale = np.sqrt(np.maximum(np.diag(every), 1e-300))
        value, vector = linalg.eigh(every / np.multiply.outer(scale, scale))
        told = value > _TOLD * value.max(initial=0.0)
        known = vector[:, told] / np.sqrt(value[told]) / scale[:, None]
        between, turn = linalg.eigh(known.T @ (flat.T @ flat) @ known)
        by_means = between >= _BY_MEANS
        return orthonormal(flat if by_means.all() else flat @ known @ turn[:, by_means])

    def outliers(self) -> Bools:
        """Rows (n,) that are gross errors.

        One reading may take all of its pose with it: what is off most is judged alone, and the pose is wrong as a whole
        only where its other readings still are.
        """
        out = self._outlying()
        alone = self._furthest_of_each(out) | self._further_of_pairs(out)
        if not alone.any():
            return out
        again = OutlierFit(self.view, declared=self.declared, alone=alone)._outlying()
        others = np.bincount(self.item, again & ~alone) > 0
        return again | (out & others[self.item])

    def _furthest_of_each(self, outliers: Bools) -> Bools:
        """Of each pose of three readings at least, all listed, the one (n,) that is off most from the others, where it
        is by more than noise."""
        out = np.zeros(len(outliers), dtype=bool)
        for k in np.flatnonzero((np.bincount(self.item, outliers) == self.count) & (self.count >= 3) & ~self.moved):
            rows = self.order[self.starts[k] : self.starts[k] + int(self.count[k])]
            off = (self.e[rows] - np.median(self.e[rows], axis=0)) / np.maximum(self.within, self.floor)
            square = (off**2).sum(axis=1) / _ABOUT_A_MEDIAN
            out[rows[np.argmax(square)]] = _chi2_tail(float(square.max()), self.e.shape[1]) < _ALONE_OFF
        return out

    def _further_of_pairs(self, outliers: Bools) -> Bools:
        """Of each pose of two readings, both listed, the one (n,) that is further off, where the other is off by no
        more than noise: which of two is wrong no median tells. Only noise of heavy tails has a reading so wild that it
        takes its pose with it, and none that stands apart."""
        out = np.zeros(len(outliers), dtype=bool)
        both = (np.bincount(self.item, outliers) == 2) & (self.count == 2) & ~self.moved
        if not both.any() or not self._has_tails:
            return out
        rows = self.order[self.starts[both][:, None] + np.arange(2)]
        square = ((self.e[rows] / np.maximum(self.within, self.floor)) ** 2).sum(axis=2)
        near = scipy.special.chdtrc(self.e.shape[1], square.min(axis=1)) >= _BOTH_OFF
        out[rows[near, square[near].argmax(axis=1)]] = True
        return out

    @property
    def _has_tails(self) -> bool:
        """Whether readings of one pose differ with heavier tails than normal noise, by the fourth moment: of that it is
        3, give or take √(96 / n)."""
        steps = np.diff(self.e[self.order], axis=0)[np.diff(self.item[self.order]) == 0]
        square = np.square(steps) / np.maximum(np.square(steps).mean(axis=0), 1e-300)
        return bool(np.square(square).mean() > 3.0 + np.sqrt(96.0 / square.size))

    def _outlying(self) -> Bools:
        """As :meth:`outliers`, each item as a whole.

        Columns may describe a run in which much is wrong, wrong poses one to which columns belong, and either one in
        which something was bumped and put back: the simplest is believed.
        """
        n, m = self.e.shape
        items = len(self.count)
        if items * m - self.basis.shape[1] < 10:
            return np.zeros(n, dtype=bool)
        left = huber(self.e, self._taken)
        inliers, criterion, left_over = self._concentrated(left)
        bumped = self._bumped(left)
        columns = self.basis.shape[1]
        for _ in range(int(_MOST_COLUMNS * items * m)):
            more = self._describing(left)
            if more is None:
                break
            self.basis = np.concatenate([self.basis, more], axis=1)
            left = huber(self.e, self._taken)
        if self.basis.shape[1] > columns:
            described, lower, beside = self._concentrated(left)
            described = described & (inliers | (self._fitted(described)[1] <= _ALONE).all(axis=1))
            if lower < criterion:
                # where more than noise is left no column describes a structure, and its extremes look like outliers
                inliers = described if beside <= _LIKE_NOISE else described | inliers
                criterion, left_over = lower, beside
        if left_over > _LIKE_NOISE:
            inliers = inliers | self._ending_a_tail(inliers)
        if bumped is not None and bumped[1] < criterion:
            return bumped[0]
        return ~inliers[self.item]

    def _ending_a_tail(self, inliers: Bools) -> Bools:
        """Poses (items,) of several readings that are further off than chance takes them, and not clear of those that
        are none: a structure that no column describes has tails, of a shape that nobody knows."""
        mean, hat = self._fitted(inliers)
        square = mean**2 / np.where(inliers[:, None], np.maximum(1.0 - hat, _LEAST_FREE), 1.0 + hat)
        spread = np.maximum(square[inliers].mean(axis=0), self.floor**2)
        distance = np.sqrt((square / spread).sum(axis=1))
        far = np.flatnonzero(~inliers & (self.count > 1) & ~self.moved)
        far = far[np.argsort(distance[far])]
        at = np.concatenate([[distance[inliers].max(initial=0.0)], distance[far]])
        clear = np.flatnonzero(at[1:] >= _CLEAR * at[:-1])
        out = np.zeros(len(inliers), dtype=bool)
        out[far[: clear[0] if len(clear) else None]] = True
        return out

    def _bumped(self, left: Floats) -> tuple[Bools, float] | None:
        """Rows (n,) of a stretch of time that is off by one vector and comes back, with all other outliers, and
        Schwarz's criterion; None where there is none that stands out as a single reading would have to."""
        n, m = self.e.shape
        if self.view.time is None or n < 5 * _FEWEST_OF_A_STRETCH:
            return None
        spread = np.maximum(MAD * np.median(np.abs(left), axis=0), self.floor)
        tame = np.clip(left / spread, -CUT, CUT)
        sums = np.concatenate([np.zeros((1, m)), np.cumsum(tame, axis=0)])
        first, last, apart = 0, 0, max(n // _CUTS, 1)
        starts = ends = np.arange(apart, n + 1, apart)
        while True:
            a, b = (v.ravel() for v in np.meshgrid(starts, ends, indexing="ij"))
            keep = (b - a >= _FEWEST_OF_A_STRETCH) & (b - a <= _MOST_BUMPED * n) & (a > 0) & (b < n)
            if not keep.any():
                return None
            a, b = a[keep], b[keep]
            best = int(np.argmax(((sums[b] - sums[a]) ** 2).sum(axis=1) / ((b - a) * (1.0 - (b - a) / n))))
            first, last = int(a[best]), int(b[best])
            if apart == 1:
                break
            near, apart = apart, max(apart // _CUTS, 1)
            starts, ends = (np.arange(v - near, v + near + 1, apart) for v in (first, last))
        stretch = np.zeros(n, dtype=bool)
        stretch[first:last] = True
        if np.linalg.norm(tame[stretch].mean(axis=0)) < 0.5 * CUT:
            return None
        other = OutlierFit(self.view, declared=self.declared, stretch=stretch)
        inliers, criterion, _ = other._concentrated(left)
        return (~inliers[other.item], criterion) if np.isfinite(criterion) else None

    def _concentrated(self, left: Floats) -> tuple[Bools, float, float]:
        """Inliers, from a start that leaves ``left`` (n, m); Schwarz's criterion of the fit to them,
        whatever is none having parameters of its own; and what it leaves of them over their noise."""
        inliers = self._nearer_half(self.mean(left)) & ~self.moved
        for robust in (True, False):
            # the spread of the inliers is known better than a median, but only once the outliers are out
            for _ in range(ROUNDS):
                mean, hat = self._fitted(inliers)
                now = ~self._far(mean, hat, inliers, robust=robust) & ~self.moved
                if np.array_equal(now, inliers):
                    break
                inliers = now
        items, m = mean.shape
        squares, freedom = (mean[now] ** 2).sum(axis=0), (self.noise[now] * (1.0 - hat[now])).sum(axis=0)
        # where the fit leaves no freedom, whatever is left is infinitely more than that
        none = np.where(squares > 0, np.inf, 0.0)
        ratio = np.divide(squares, freedom, out=none, where=freedom > 1e-300 * squares)
        count = self.basis.shape[1] + m * (items - (now | self.moved).sum())
        if self.moved.any():
            # one vector for all of them, its beginning and its end
            by, own = mean[self.moved].mean(axis=0), mean[now].std(axis=0)
            squares += ((mean[self.moved] - by) ** 2).sum(axis=0)
            count += m + 2
            if _chi2_tail(float(((by / np.maximum(own, self.floor)) ** 2).sum()), m) > _LEVEL / items:
                return now, np.inf, np.inf
        squares = np.maximum(squares / items, self.floor**2)
        criterion = float(items * np.log(squares).sum() + count * np.log(items * m))
        return now, criterion, float(np.sqrt(ratio.max()))

    # -- what describes the run ----------------------------------------------------------------------------

    @cached_property
    def _seen(self) -> Ints:
        """Rows among which columns are chosen: more would choose none that matters for a gross error."""
        return np.unique(np.linspace(0, len(self.e) - 1, min(len(self.e), BLOCK)).astype(np.int64))

    @cached_property
    def _smooth(self) -> tuple[list[Smooth], list[Smooth]]:
        """Smooth shapes on an axis alone, and those that arrive as errors of joints."""
        every = smooth_shapes(self.view)
        return [one for one in every if one.joint is None], [one for one in every if one.joint is not None]

    @cached_property
    def _columns(self) -> tuple[Floats, Floats]:
        """What may describe the rows that are seen: functions (b, f), each of which counts on every axis by itself, and
        full columns (b·m, d) of smooth shapes and effects."""
        single, dense = self._smooth
        seen, m = self._seen, self.e.shape[1]
        last = self.view.effects[-1][1].stop if self.view.effects else 0
        functions = [one.values[seen] for one in single]
        along = [self.view.patterns[one.joint or ""][seen] * one.values[seen, None] for one in dense]
        effects = []
        for rows in self.view.blocks:
            here = seen[(seen >= rows.start) & (seen < rows.stop)] - rows.start
            effects.append(self.view.effects_in(rows)[here, :, :last])
        full = np.concatenate(effects)
        full = np.concatenate([np.stack(along, axis=2), full], axis=2) if along else full
        none = np.zeros((len(seen), 0))
        return np.stack(functions, axis=1) if functions else none, full.reshape(len(seen) * m, -1)

    def _products(self, values: Floats) -> Floats:
        """Columns times others (b, m, k) where they are seen: (K, k); functions axis by axis before full ones."""
        functions, full = self._columns
        parts = [functions.T @ values[:, a] for a in range(values.shape[1])]
        return np.concatenate([*parts, full.T @ values.reshape(-1, values.shape[2])])

    def _describing(self, left: Floats) -> Floats | None:
        """The column, or the step in time on all axes, that describes most of what is left; None where chance does."""
        n, m = self.e.shape
        spread = np.maximum(MAD * np.median(np.abs(left), axis=0), self.floor)
        tame = np.clip(left, -CUT * spread, CUT * spread) / spread
        tame = tame - self._taken(tame)
        variance = float((tame**2).sum()) / (n * m - self.basis.shape[1])
        # readings of a pose that share an error are no witnesses of their own
        means = self.mean(tame)
        shared = float(np.average(means**2 * self.count[:, None], weights=np.repeat(self.count[:, None], m, axis=1)))
        variance = max(variance, shared)
        gain, tried = self._gains(tame[self._seen])
        best = int(np.argmax(gain)) if len(gain) else -1
        chance = _chi2_log_tail(gain[best] / variance, 1) + np.log(tried) if tried else np.inf
        stepped = self._step(tame, variance)
        if stepped is not None and stepped[0] < min(chance, np.log(_DESCRIBED)):
            self.has_step = True
            return self._new(self._down(self._after(stepped[1])))
        if chance >= np.log(_DESCRIBED):
            return None
        # what differs within a pose is not in its mean: such a column would be the best again and again
        self._free[best] = 0.0
        return self._new(self._one(best))

    def _new(self, columns: Floats) -> Floats:
        """What columns (items, m, k) add to the basis."""
        new = columns.reshape(-1, columns.shape[2])
        left = np.linalg.norm(new - self.basis @ (self.basis.T @ new), axis=0)
        new = new[:, left > _ABSORBED * np.linalg.norm(new, axis=0)]
        # once more, since of a new column little may be left, and what is left must stand across the others
        for _ in range(2):
            new = orthonormal(new - self.basis @ (self.basis.T @ new))
        return new

    def _one(self, number: int) -> Floats:
        """One column as the basis has it (items, m, 1)."""
        m = self.e.shape[1]
        single, dense = self._smooth
        if number < m * len(single):
            axis, k = divmod(number, len(single))
            return self._down(np.multiply.outer(single[k].values, np.eye(m)[axis]))[:, :, None]
        number -= m * len(single)
        if number < len(dense):
            pattern = self.view.patterns[dense[number].joint or ""]
            return self._down(pattern * dense[number].values[:, None])[:, :, None]
        which = slice(number - len(dense), number - len(dense) + 1)
        if self._effects.nbytes:
            return self._effects[:, :, which]
        return self._summed(lambda rows: self.view.effects_in(rows)[:, :, which])

    @cached_property
    def _effects(self) -> Floats:
        """Columns of all effects as the basis has them (items, m, e); none where they are too large to be kept."""
        width = self.view.effects[-1][1].stop if self.view.effects else 0
        shape = (len(self.count), self.e.shape[1], width)
        if 8 * math.prod(shape) > _KEPT:
            return np.zeros((0, 0, 0))
        return self._summed(lambda rows: self.view.effects_in(rows)[:, :, :width])

    def _gains(self, tame: Floats) -> tuple[Floats, int]:
        """What each column takes (k,) of residuals (b, m) where they are seen, beyond the basis; nothing where it lies
        within it; and how many do not."""
        seen = self._basis_seen
        of_items = self.basis[:, seen.shape[1] :].reshape(len(self.count), tame.shape[1], -1)
        new = self._up(of_items, self._seen).reshape(tame.size, -1)
        if new.shape[1]:
            # once more, since of a new column little may be left
            for _ in range(2):
                new = orthonormal(new - seen @ (seen.T @ new))
            now = self._free - (self._products(new.reshape(*tame.shape, -1)) ** 2).sum(axis=1)
            # lengths are parts of what was left before
            self._free = np.where(now > _ABSORBED**2 * self._free, now, 0.0)
            self._basis_seen = seen = np.concatenate([seen, new], axis=1)
        flat = tame.reshape(-1)
        along = self._products((flat - seen @ (seen.T @ flat)).reshape(*tame.shape, 1))[:, 0]
        free = self._free > 0
        return np.where(free, along**2 / np.where(free, self._free, 1.0), 0.0), int(free.sum())

    @cached_property
    def _free(self) -> Floats:
        """Squared lengths (k,) of what the basis leaves of the columns; zero for those that lie within it."""
        functions, full = ((one**2).sum(axis=0) for one in self._columns)
        return np.concatenate([np.tile(functions, self.e.shape[1]), full])

    @cached_property
    def _basis_seen(self) -> Floats:
        """The basis, orthonormal where it is seen."""
        return np.zeros((len(self._seen) * self.e.shape[1], 0))

    has_step = False
    #: Of how many columns of the basis it is known what they have of every step, and what: the basis but grows.
    _within: tuple[int, Floats | float] = (0, 0.0)

    def _step(self, tame: Floats, variance: float) -> tuple[float, int] | None:
        """The step in time that takes most: log of its chance, and its first row. One only: what is bumped and put back
        is no step."""
        n, m = self.e.shape
        if self.view.time is None or self.has_step or n < 10:
            return None
        cuts = np.arange(3, n - 2)
        cuts = cuts[self.view.time[cuts] > self.view.time[cuts - 1]]
        if not len(cuts):
            return None
        known, inside = self._within
        new = (self._up(column.reshape(-1, m)) for column in self.basis[:, known:].T)
        self._within = self.basis.shape[1], inside + within(new, cuts)
        gain = step_gains(tame, self._within[1], cuts, _ABSORBED) / variance
        best = int(np.argmax(gain))
        return float(_chi2_log_tail(gain[best], m) + np.log(len(cuts))), int(cuts[best])

    def _after(self, cut: int) -> Floats:
        """A step (n, m, m) of each axis from this row on."""
        n, m = self.e.shape
        return (np.arange(n) >= cut)[:, None, None] * np.eye(m)

    # -- judging -------------------------------------------------------------------------------------------

    def mean(self, values: Floats) -> Floats:
        """Means (items, …) of values (n, …)."""
        total = np.add.reduceat(values[self.order], self.starts, axis=0)
        return total / self.count.reshape((-1,) + (1,) * (values.ndim - 1))

    def _summed(self, columns: Callable[[slice], Floats]) -> Floats:
        """Columns that are given (b, m, p) for stretches of rows, as the basis has items (items, m, p)."""
        first = columns(self.view.blocks[0])
        out = np.zeros((len(self.count), *first.shape[1:]))
        for rows in self.view.blocks:
            order = np.argsort(self.item[rows], kind="stable")
            items, starts = np.unique(self.item[rows][order], return_index=True)
            out[items] += np.add.reduceat(columns(rows)[order], starts, axis=0)
        return out / np.sqrt(self.count)[:, None, None]

    def _down(self, values: Floats) -> Floats:
        """Values of rows (n, …) as the basis has items (items, …)."""
        return self.mean(values) * np.sqrt(self.count).reshape((-1,) + (1,) * (values.ndim - 1))

    def _up(self, values: Floats, rows: Ints | slice = slice(None)) -> Floats:
        """Values of items, as the basis has them (items, …), in some rows (b, …)."""
        item = self.item[rows]
        return values[item] / np.sqrt(self.count[item]).reshape((-1,) + (1,) * (values.ndim - 1))

    def _taken(self, values: Floats) -> Floats:
        """What the basis takes of values (n, m)."""
        along = self.basis.T @ self._down(values).reshape(-1)
        return self._up((self.basis @ along).reshape(-1, values.shape[1]))

    @cached_property
    def _mean_residual(self) -> Floats:
        return self.mean(self.e)

    def _nearer_half(self, mean: Floats) -> Bools:
        """Items that are nearer than their median, each axis by its own spread."""
        square = mean**2 * self.count[:, None]
        distance = (square / np.maximum(np.median(square, axis=0), self.floor**2)).sum(axis=1)
        return distance <= np.median(distance)

    def _fitted(self, inliers: Bools) -> tuple[Floats, Floats]:
        """What a fit to the inliers leaves of each one's mean (items, m), and the variance of its predictions
        (items, m) over that of such a mean."""
        m = self.e.shape[1]
        q = self.basis.reshape(len(self.count), m, -1)
        part = q[inliers].reshape(-1, q.shape[2])
        root_count = np.sqrt(self.count)[:, None]
        value, vector = linalg.eigh(part.T @ part)
        # what the inliers do not tell is not held against the others
        root = vector / np.sqrt(np.maximum(value, 1e-9))
        x = root @ (root.T @ (part.T @ (root_count * self._mean_residual)[inliers].reshape(-1)))
        hat = ((self.basis @ root) ** 2).sum(axis=1).reshape(-1, m)
        return self._mean_residual - (self.basis @ x).reshape(-1, m) / root_count, hat

    def _far(self, mean: Floats, hat: Floats, inliers: Bools, *, robust: bool) -> Bools:
        """Items that are further off than chance takes them, given the spread of the inliers."""
        m = mean.shape[1]
        free = np.where(inliers[:, None], np.maximum(1.0 - hat, _LEAST_FREE), 1.0 + hat)
        square = mean**2 / free
        # an item of more readings is known better, as far as its readings differ among themselves
        each = self.within**2 / self.count[:, None]
        if robust:
            spread, usual = MAD**2 * np.median(square, axis=0), np.median(each, axis=0)
            freedom = _MAD_EFFICIENCY * len(mean)
        else:
            # of each item, that of the others: an outlier would hide in its own
            others = inliers.sum() - inliers[:, None]
            spread = (square[inliers].sum(axis=0) - np.where(inliers[:, None], square, 0.0)) / others
            usual = each[inliers].mean(axis=0)
            freedom = float((1.0 - hat[inliers]).sum(axis=0).clip(2.0).mean()) - 1.0
        variance = np.maximum(spread + each - usual, 0.5 * each)
        distance = (square / np.maximum(variance, self.floor**2)).sum(axis=1)
        p = scipy.special.fdtrc(m, max(freedom, 1.0), np.maximum(distance / m, 0.0))
        out = np.zeros(len(p), dtype=bool)
        # readings that stand apart from their pose are witnesses of each other, and of no pose that is wrong
        for alone in (True, False):
            those = np.flatnonzero((self.count == 1) == alone)
            order = those[np.argsort(p[those])]
            below = np.flatnonzero(p[order] <= _LEVEL * np.arange(1, len(order) + 1) / len(p))
            out[order[: min(int(below[-1]) + 1, len(p) // 2)] if len(below) else []] = True
        return out


def _chi2_tail(x: float, freedom: int) -> float:
    """Chance that χ² with ``freedom`` is beyond ``x``."""
    return float(scipy.special.chdtrc(freedom, max(x, 0.0)))


def _chi2_log_tail(x: float, freedom: int) -> float:
    """Its logarithm; -inf where the chance is no number any more."""
    p = _chi2_tail(x, freedom)
    return math.log(p) if p > 0 else -math.inf
