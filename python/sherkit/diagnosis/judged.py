"""How far each row of a fit is from what the others predict there: by pose, by row, by a stretch of time.

The start believes no row more than another (Huber, *Robust Statistics*, 1981, 7.8: a convex problem, so that where it
starts does not matter); then the believed ones grow or shrink until they stay (blocks of rows by their predicted error:
Billor, Hadi and Velleman, "BACON", *Computational Statistics & Data Analysis* 34, 2000). What is wild is decided by the
expected share of false ones (Benjamini and Hochberg, *J. R. Statist. Soc. B* 57, 1995).
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
import scipy

from ..data.noise import MAD
from ..types import Bools, Floats
from .believable import CUT, DIGITS, ROUNDS, huber
from .linearised import Linearised, orthonormal
from .shapes import build

#: Chance that a run without gross errors has anything listed; of several that are listed, the expected part of false
#: ones.
_LEVEL = 0.005
#: Chance that a column takes part in describing a run of pure noise.
_DESCRIBED = 0.01
#: Columns are described by no more than this part of the poses' readings.
_MOST_COLUMNS = 0.15
#: A column of which the fitted ones leave less than this is one of theirs.
_ABSORBED = 1e-3
#: What is left counts as noise up to this many times the noise.
_LIKE_NOISE = 1.5
#: Efficiency of a median absolute deviation.
_MAD_EFFICIENCY = 0.37
#: A prediction is never taken for better than this part of the reading's own variance.
_LEAST_FREE = 0.1
#: Rows of which a stretch of time has at least so many; part of the run, at most, that something was bumped for before
#: it was put back, and cuts at which it is looked for.
_FEWEST_OF_A_STRETCH = 4
_MOST_BUMPED = 0.2
_CUTS = 48


class Judged:
    """Rows of a fit and how far each is from what the others predict there.

    ``e`` (n, m) are residuals, over noise that is ``declared`` or not; an item is what is judged as one: the readings
    of a pose that agree, or a row that stands apart from them. The rows of a ``stretch`` (n,) are items of their own,
    which are never believed but share one error.
    """

    def __init__(self, view: Linearised, *, declared: bool, stretch: Bools | None = None) -> None:
        self.view = view
        self.declared = declared
        self.e = view.residual
        self.floor = np.maximum(DIGITS * np.ptp(self.e, axis=0), 1e-12)
        self.basis = orthonormal(view.fitted)
        self.within, apart = self._apart()
        first, size = np.arange(len(view)), len(view)
        group = np.unique(view.group, return_inverse=True)[1].ravel()
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

    def wild(self) -> Bools:
        """Rows (n,) that are gross errors.

        Columns may describe a run in which much is wrong, wrong poses one to which columns belong, and either one in
        which something was bumped and put back: the simplest is believed.
        """
        n, m = self.e.shape
        items = len(self.count)
        if items * m - self.basis.shape[1] < 10:
            return np.zeros(n, dtype=bool)
        left = huber(self.e, self.basis)
        believed, criterion, _ = self._concentrated(left)
        bumped = self._bumped(left)
        columns = self.basis.shape[1]
        for _ in range(int(_MOST_COLUMNS * items * m)):
            more = self._describing(left)
            if more is None:
                break
            self.basis = np.concatenate([self.basis, more], axis=1)
            left = huber(self.e, self.basis)
        if self.basis.shape[1] > columns:
            described, lower, left_over = self._concentrated(left)
            if lower < criterion:
                # where more than noise is left there is structure that no column describes, and its extremes look wild
                believed = described if left_over <= _LIKE_NOISE else described | believed
                criterion = lower
        if bumped is not None and bumped[1] < criterion:
            return bumped[0]
        return ~believed[self.item]

    def _bumped(self, left: Floats) -> tuple[Bools, float] | None:
        """Rows (n,) of a stretch of time that is off by one vector and comes back, with all else that is wild then, and
        Schwarz's criterion; None where there is none that stands out as a single reading would have to."""
        n, m = self.e.shape
        if self.view.time is None or n < 5 * _FEWEST_OF_A_STRETCH:
            return None
        spread = np.maximum(MAD * np.median(np.abs(left), axis=0), self.floor)
        tame = np.clip(left / spread, -CUT, CUT)
        sums = np.concatenate([np.zeros((1, m)), np.cumsum(tame, axis=0)])
        first, last, grid = 0, 0, np.arange(0, n + 1, max(n // _CUTS, 1))
        starts, ends = grid[1:], grid[1:]
        for _ in range(2):
            a, b = (v.ravel() for v in np.meshgrid(starts, ends, indexing="ij"))
            keep = (b - a >= _FEWEST_OF_A_STRETCH) & (b - a <= _MOST_BUMPED * n) & (a > 0) & (b < n)
            if not keep.any():
                return None
            a, b = a[keep], b[keep]
            best = int(np.argmax(((sums[b] - sums[a]) ** 2).sum(axis=1) / ((b - a) * (1.0 - (b - a) / n))))
            first, last = int(a[best]), int(b[best])
            starts, ends = (np.arange(v - grid[1], v + grid[1] + 1) for v in (first, last))
        stretch = np.zeros(n, dtype=bool)
        stretch[first:last] = True
        if np.linalg.norm(tame[stretch].mean(axis=0)) < 0.5 * CUT:
            return None
        other = Judged(self.view, declared=self.declared, stretch=stretch)
        believed, criterion, _ = other._concentrated(left)
        return (~believed[other.item], criterion) if np.isfinite(criterion) else None

    def _concentrated(self, left: Floats) -> tuple[Bools, float, float]:
        """Items that are believed, from a start that leaves ``left`` (n, m); Schwarz's criterion of the fit to them,
        whatever is not believed having parameters of its own; and what it leaves of them over their noise."""
        mean_basis = self.mean(self.basis.reshape(*self.e.shape, -1))
        believed = self._nearer_half(self.mean(left)) & ~self.moved
        for robust in (True, False):
            # the spread of all that is believed is known better than a median, but only once the wild ones are out
            for _ in range(ROUNDS):
                mean, hat = self._fitted(believed, mean_basis)
                now = ~self._far(mean, hat, believed, robust=robust) & ~self.moved
                if np.array_equal(now, believed):
                    break
                believed = now
        items, m = mean.shape
        ratio = (mean[now] ** 2).sum(axis=0) / np.maximum((self.noise[now] * (1.0 - hat[now])).sum(axis=0), 1e-300)
        squares = (mean[now] ** 2).sum(axis=0)
        count = self.basis.shape[1] + m * (items - (now | self.moved).sum())
        if self.moved.any():
            # one vector for all of them, its beginning and its end
            by, own = mean[self.moved].mean(axis=0), mean[now].std(axis=0)
            squares += ((mean[self.moved] - by) ** 2).sum(axis=0)
            count += m + 2
            if scipy.stats.chi2.sf(float(((by / np.maximum(own, self.floor)) ** 2).sum()), m) > _LEVEL / items:
                return now, np.inf, np.inf
        squares = np.maximum(squares / items, self.floor**2)
        criterion = float(items * np.log(squares).sum() + count * np.log(items * m))
        return now, criterion, float(np.sqrt(ratio.max()))

    # -- what describes the run ----------------------------------------------------------------------------

    @cached_property
    def columns(self) -> Floats:
        """Effects and smooth shapes (n·m, k) as unit columns, what is fitted taken out of them; and how many of the
        basis were taken out."""
        n, m = self.e.shape
        family = build(self.view)
        smooth = [s for s in family.shapes if s.shape in ("smooth", "interaction")]
        single = family.functions[:, sorted({k for s in smooth for k in s.functions})]
        dense = family.dense[:, :, sorted({k for s in smooth for k in s.dense})]
        on_axes = np.zeros((n, m, m, single.shape[1]))
        for a in range(m):
            on_axes[:, a, a] = single
        effects = [columns for _, columns in self.view.effects]
        out = np.concatenate([on_axes.reshape(n, m, -1), dense, *effects], axis=2).reshape(n * m, -1)
        return out / np.maximum(np.linalg.norm(out, axis=0), 1e-300)

    def _describing(self, left: Floats) -> Floats | None:
        """The column, or the step in time on all axes, that describes most of what is left; None where chance does."""
        n, m = self.e.shape
        spread = np.maximum(MAD * np.median(np.abs(left), axis=0), self.floor)
        tame = np.clip(left, -CUT * spread, CUT * spread)
        tame = (tame / spread).reshape(-1)
        tame = tame - self.basis @ (self.basis.T @ tame)
        variance = float(tame @ tame) / (n * m - self.basis.shape[1])
        # readings of a pose that share an error are no witnesses of their own
        means = self.mean(tame.reshape(n, m))
        shared = float(np.average(means**2 * self.count[:, None], weights=np.repeat(self.count[:, None], m, axis=1)))
        variance = max(variance, shared)
        columns = self._free_columns()
        gain = (columns.T @ tame) ** 2 / variance
        best = int(np.argmax(gain)) if len(gain) else -1
        chance = scipy.stats.chi2.logsf(gain[best], 1) + np.log(len(gain)) if best >= 0 else np.inf
        stepped = self._step(tame.reshape(n, m), variance)
        if stepped is not None and stepped[0] < min(chance, np.log(_DESCRIBED)):
            self.has_step = True
            return orthonormal(stepped[1] - self.basis @ (self.basis.T @ stepped[1]))
        return columns[:, best : best + 1].copy() if chance < np.log(_DESCRIBED) else None

    has_step = False
    _taken_out = 0

    def _free_columns(self) -> Floats:
        """The columns without what is in the basis by now, of unit length; none of those that lie within it."""
        if self._taken_out < self.basis.shape[1]:
            new = self.basis[:, self._taken_out :]
            columns = self.columns - new @ (new.T @ self.columns)
            length = np.linalg.norm(columns, axis=0)
            # lengths are parts of what was left before
            keep = length > _ABSORBED
            self.columns = columns[:, keep] / length[keep]
            self._taken_out = self.basis.shape[1]
        return self.columns

    def _step(self, tame: Floats, variance: float) -> tuple[float, Floats] | None:
        """The step in time that takes most: log of its chance, and its columns (n·m, m). One only: what is bumped and
        put back is no step."""
        n, m = self.e.shape
        if self.view.time is None or self.has_step or n < 10:
            return None
        cuts = np.arange(3, n - 2)
        cuts = cuts[self.view.time[cuts] > self.view.time[cuts - 1]]
        if not len(cuts):
            return None
        after = np.cumsum(tame[::-1], axis=0)[::-1][cuts]
        inside = np.cumsum(self.basis.reshape(n, m, -1)[::-1], axis=0)[::-1][cuts]
        free = (n - cuts)[:, None] - (inside**2).sum(axis=2)
        gain = np.where(free > _ABSORBED * n, after**2 / np.maximum(free, 1e-12), 0.0).sum(axis=1) / variance
        best = int(np.argmax(gain))
        columns = np.zeros((n, m, m))
        for a in range(m):
            columns[cuts[best] :, a, a] = 1.0
        return float(scipy.stats.chi2.logsf(gain[best], m) + np.log(len(cuts))), columns.reshape(n * m, m)

    # -- judging -------------------------------------------------------------------------------------------

    def mean(self, values: Floats) -> Floats:
        """Means (items, …) of values (n, …)."""
        total = np.add.reduceat(values[self.order], self.starts, axis=0)
        return total / self.count.reshape((-1,) + (1,) * (values.ndim - 1))

    @cached_property
    def _mean_residual(self) -> Floats:
        return self.mean(self.e)

    def _nearer_half(self, mean: Floats) -> Bools:
        """Items that are nearer than their median, each axis by its own spread."""
        square = mean**2 * self.count[:, None]
        distance = (square / np.maximum(np.median(square, axis=0), self.floor**2)).sum(axis=1)
        return distance <= np.median(distance)

    def _fitted(self, believed: Bools, mean_basis: Floats) -> tuple[Floats, Floats]:
        """What a fit to the believed items leaves of each one's mean (items, m), and the variance of its predictions
        (items, m) over that of such a mean. ``mean_basis`` (items, m, k) is the basis at each item."""
        n, m = self.e.shape
        q = self.basis.reshape(n, m, -1)
        inside = believed[self.item]
        part = q[inside].reshape(int(inside.sum()) * q.shape[1], q.shape[2])
        value, vector = np.linalg.eigh(part.T @ part)
        # what the believed ones do not tell is not held against the others
        root = vector / np.sqrt(np.maximum(value, 1e-9))
        x = root @ (root.T @ (part.T @ self.e[inside].reshape(-1)))
        hat = self.count[:, None] * ((mean_basis @ root) ** 2).sum(axis=2)
        return self._mean_residual - mean_basis @ x, hat

    def _far(self, mean: Floats, hat: Floats, believed: Bools, *, robust: bool) -> Bools:
        """Items that are further off than chance takes them, given the spread of those believed."""
        m = mean.shape[1]
        free = np.where(believed[:, None], np.maximum(1.0 - hat, _LEAST_FREE), 1.0 + hat)
        square = mean**2 / free
        # an item of more readings is known better, as far as its readings differ among themselves
        each = self.within**2 / self.count[:, None]
        if robust:
            spread, usual = MAD**2 * np.median(square, axis=0), np.median(each, axis=0)
            freedom = _MAD_EFFICIENCY * len(mean)
        else:
            # of each item, that of the others: a wild one would hide in its own
            others = believed.sum() - believed[:, None]
            spread = (square[believed].sum(axis=0) - np.where(believed[:, None], square, 0.0)) / others
            usual = each[believed].mean(axis=0)
            freedom = float((1.0 - hat[believed]).sum(axis=0).clip(2.0).mean()) - 1.0
        variance = np.maximum(spread + each - usual, 0.5 * each)
        distance = (square / np.maximum(variance, self.floor**2)).sum(axis=1)
        p = scipy.stats.f.sf(distance / m, m, max(freedom, 1.0))
        order = np.argsort(p)
        below = np.flatnonzero(p[order] <= _LEVEL * np.arange(1, len(p) + 1) / len(p))
        out = np.zeros(len(p), dtype=bool)
        out[order[: min(int(below[-1]) + 1, len(p) // 2)] if len(below) else []] = True
        return out

    def _apart(self) -> tuple[Floats, Bools]:
        """Noise (m,) within poses, zero where it is not known; and the rows (n,) that stand apart from the other
        readings of their pose."""
        n, m = self.e.shape
        group = np.unique(self.view.group, return_inverse=True)[1].ravel()
        order = np.argsort(group, kind="stable")
        ordered, ids = self.e[order], group[order]
        steps = np.diff(ordered, axis=0)[np.diff(ids) == 0]
        if len(steps) < 5:
            return np.zeros(m), np.zeros(n, dtype=bool)
        noise = np.maximum(MAD * np.median(np.abs(steps), axis=0) / np.sqrt(2.0), self.floor)
        threshold = float(scipy.stats.norm.isf(0.5 * _LEVEL / (n * m)))
        count = np.bincount(group)
        starts = np.concatenate([[0], np.cumsum(count)[:-1]])
        far = np.zeros(n, dtype=bool)
        for size in np.unique(count[count >= 2]):
            rows = starts[count == size][:, None] + np.arange(size)
            block = ordered[rows]
            limit = threshold * noise * (1.0 if size > 2 else np.sqrt(0.5))
            apart = np.abs(block - np.median(block, axis=1, keepdims=True)) > limit
            far[order[rows.ravel()]] = apart.any(axis=2).ravel()
        steps = np.diff(ordered, axis=0)[(np.diff(ids) == 0) & ~far[order][1:] & ~far[order][:-1]]
        return np.sqrt(0.5 * (steps**2).mean(axis=0)) if len(steps) else noise, far
