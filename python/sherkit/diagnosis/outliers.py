"""Gross errors: rows and poses that neither noise, nor any effect, nor a smooth shape explains.

Repeats that agree vouch for each other and not for their pose: a wrong index, or a cube that was knocked, is wrong in
all of them. So a row is judged together with the other readings of its pose, and by itself only where it stands apart
from them; and each is judged by what the rows that are believed predict there, however many the others are.

The start believes no row more than another (Huber, *Robust Statistics*, 1981, 7.8: a convex problem, so that where it
starts does not matter); then the believed ones grow or shrink until they stay (blocks of rows by their predicted error:
Billor, Hadi and Velleman, "BACON", *Computational Statistics & Data Analysis* 34, 2000). What is listed is
decided by the expected share of false ones (Benjamini and Hochberg, *J. R. Statist. Soc. B* 57, 1995).
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np
from scipy import stats

from ..data import Measurements
from ..data.noise import MAD
from ..errors import SherkitError
from ..fit.identify import Fit
from ..fit.set_up import set_up_mistakes
from ..model.effect import Effect
from ..names import listed
from ..types import Bools, Floats, Ints
from .fitted_run import FittedRun
from .linearised import Linearised, orthonormal
from .shapes import build
from .stage import testable

#: Chance that a run without gross errors has anything listed; of several that are listed, the expected part of false
#: ones.
_LEVEL = 0.005
#: Chance that a column takes part in describing a run of pure noise.
_DESCRIBED = 0.01
#: Residuals are cut to this many spreads at the start.
_CUT = 1.5
_ROUNDS = 20
#: Fits, each without what the one before it listed.
_FITS = 8
#: Columns are described by no more than this part of the poses' readings.
_MOST_COLUMNS = 0.15
#: A column of which the fitted ones leave less than this is one of theirs.
_ABSORBED = 1e-3
#: What is left counts as noise up to this many times the noise.
_LIKE_NOISE = 1.5
#: Efficiency of a median absolute deviation, and the median of a square of normal numbers.
_MAD_EFFICIENCY = 0.37
#: A prediction is never taken for better than this part of the reading's own variance.
_LEAST_FREE = 0.1
#: No residual is told from zero below this part of the range of the readings.
_DIGITS = 1e-9
#: A pause between two visits, in usual steps of time; and what part of a visit, of how many rows at least, is wild
#: where it is taken for news.
_PAUSE = 20.0
_WILD_VISIT = 0.5
_FEWEST_OF_A_VISIT = 4
#: Part of the run, at most, that something was bumped for before it was put back, and cuts at which it is looked for.
_MOST_BUMPED = 0.2
_CUTS = 48


def without_outliers(run: FittedRun, effects: Sequence[Effect]) -> tuple[FittedRun, Ints]:
    """The fit without gross errors, and their rows (k,), indices of the data.

    Every row is judged anew by each fit, those that an earlier one listed as well: what one gross error hid comes to
    light, and what was listed in its shadow comes back. Raises :class:`FitError` for too few rows.
    """
    rows = testable(run, np.flatnonzero(run.whole))
    first, run = run, _believable(run, rows)
    wild = np.flatnonzero(run.data.outlier & ~first.data.outlier)
    for _ in range(_FITS):
        again = gross_errors(run, effects, rows)
        if np.array_equal(again, wild):
            break
        wild = again
        run = first.without(wild) if len(wild) else first
    return run, wild


def gross_errors_marked(fit: Fit, effects: Sequence[Effect] = ()) -> Measurements:
    """The rows of a fit with those marked that a diagnosis lists as gross errors; ``effects`` are tried beside the
    catalogue. Beside a mistake of the set-up every row may look wrong, and none is marked."""
    if set_up_mistakes(fit.model, fit.data, fit.values):
        return fit.data
    run = FittedRun(fit)
    return fit.data.mark_outliers(without_outliers(run, (*run.catalogue, *effects))[1])


def gross_errors(run: FittedRun, effects: Sequence[Effect], rows: Ints) -> Ints:
    """Those of these rows, sorted, that are gross errors as seen from this fit.

    All that is read after a pause is no accident, it is news: a visit to the machine that is wild as a whole stays.
    """
    view = run.linearised(rows, effects, run.noise[0][list(run.axes)])
    wild = _Judged(view, declared=run.noise[1] == "declared").wild()
    return np.sort(rows[wild & ~_visits(view.time, wild)])


def sentences(data: Measurements, rows: Ints) -> tuple[str, ...]:
    """What is said of gross errors (indices of ``data``): poses that are wrong in all their readings, and single rows
    apart; each by its line in the file."""
    if not len(rows):
        return ()
    wild = np.zeros(len(data), dtype=bool)
    wild[rows] = True
    judged = wild | ~data.outlier
    group = data.groups
    size = np.bincount(group, judged)
    whole = (np.bincount(group, wild) == size) & (size > 1)
    out = []
    poses = np.flatnonzero(wild & whole[group])
    if len(poses) and data.pose is not None:
        numbers = np.unique(data.pose[poses])
        many = len(numbers) > 1
        out.append(
            f"{f'{len(numbers)} poses are' if many else 'one pose is'} wrong in all {'their' if many else 'its'} "
            f"repeats (pose {_spans(numbers)}; {data.counted}s {_spans(data.line[poses])}): "
            "no noise, no effect and no smooth shape explains it; all figures here are without them. "
            "Look for a wrong index, a target that was knocked, a stage that was bumped"
        )
    single = np.flatnonzero(wild & ~whole[group])
    if len(single):
        what, are = (f"{len(single)} {data.counted}s", "are suspected outliers") if len(single) > 1 else (
            f"one {data.counted}", "is a suspected outlier"
        )  # fmt: skip
        where = f"{data.counted}{'s' if len(single) > 1 else ''} {_spans(data.line[single])}"
        out.append(f"{what} {are} ({where}); all figures here are without {'them' if len(single) > 1 else 'it'}")
    return tuple(out)


def _spans(numbers: Ints) -> str:
    """Sorted numbers for a sentence, neighbours as one span: 12-14, 40."""
    numbers = np.unique(numbers)
    parts = np.split(numbers, np.flatnonzero(np.diff(numbers) > 1) + 1)
    return listed((f"{p[0]}-{p[-1]}" if len(p) > 1 else f"{p[0]}" for p in parts), 20)


def _believable(run: FittedRun, rows: Ints) -> FittedRun:
    """The fit, or where gross errors have ruined it another one, from the drawing and without what stands apart there.

    It is ruined where it did not end, or where the median row is further off than before the fit.
    """
    axes = list(run.axes)
    data = run.data.select(rows)
    model = run.model

    def typical(values: Floats) -> float:
        try:
            left = (data.readings - model.predict(data, values))[:, axes] / run.noise[0][axes]
        except SherkitError:  # not every step ends at a robot that could be built
            return np.inf
        return float(np.median(np.linalg.norm(left, axis=1)))

    drawn = model.starting_at(None)
    now = typical(run.fit.values)
    if run.fit.converged and now <= typical(drawn):
        return run
    values, best = drawn, typical(drawn)
    for _ in range(_ROUNDS):
        # the step that the bulk of the rows asks for, until it gains no more
        residual = (data.readings - model.predict(data, values))[:, axes]
        columns = model.derivatives(data, values)[:, axes]
        step = _robust_step(residual, columns)
        while typical(values + step) > best and np.abs(step).max() > 0:
            step = 0.5 * step
            if np.abs(step).max() < 1e-9 * np.abs(values).max(initial=1e-9):
                break
        else:
            values = values + step
            gained, best = best - typical(values), typical(values)
            if gained > 1e-6 * best:
                continue
        break
    left = (data.readings - model.predict(data, values))[:, axes]
    spread = MAD * np.median(np.abs(left), axis=0)
    far = (np.abs(left) > 10.0 * np.maximum(spread, _DIGITS * np.ptp(data.readings[:, axes], axis=0))).any(axis=1)
    return run.without(rows[far])


def _robust_step(residual: Floats, columns: Floats) -> Floats:
    """The linear step (p,) that residuals (n, m) ask for, wild ones cut to size."""
    spread = np.maximum(MAD * np.median(np.abs(residual), axis=0), 1e-300)
    e = residual / spread
    a = (columns / spread[:, None]).reshape(e.size, -1)
    scale = np.maximum(np.linalg.norm(a, axis=0), 1e-300)
    left = _huber(e, orthonormal(a))
    return np.linalg.lstsq(a / scale, (e - left).reshape(-1), rcond=1e-9)[0] / scale


def _huber(e: Floats, q: Floats) -> Floats:
    """What a fit of orthonormal columns (n·m, k) leaves of residuals (n, m) when wild ones are cut to size."""
    left = e
    before = np.inf
    for _ in range(5 * _ROUNDS):
        limit = _CUT * MAD * np.median(np.abs(left), axis=0)
        tame = e - left + np.clip(left, -limit, limit)
        left = e - (q @ (q.T @ tame.reshape(-1))).reshape(e.shape)
        now = float(limit.sum())
        if abs(before - now) <= 1e-3 * now:
            break
        before = now
    return left


class _Judged:
    """Rows of a fit and how far each is from what the others predict there.

    ``e`` (n, m) are residuals, over noise that is ``declared`` or not; an item is what is judged as one: the readings
    of a pose that agree, or a row that stands apart from them. The rows of a ``stretch`` (n,) are items of their own,
    which are never believed but share one error.
    """

    def __init__(self, view: Linearised, *, declared: bool, stretch: Bools | None = None) -> None:
        self.view = view
        self.declared = declared
        self.e = view.residual
        self.floor = np.maximum(_DIGITS * np.ptp(self.e, axis=0), 1e-12)
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
        left = _huber(self.e, self.basis)
        believed, criterion, _ = self._concentrated(left)
        bumped = self._bumped(left)
        columns = self.basis.shape[1]
        for _ in range(int(_MOST_COLUMNS * items * m)):
            more = self._describing(left)
            if more is None:
                break
            self.basis = np.concatenate([self.basis, more], axis=1)
            left = _huber(self.e, self.basis)
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
        if self.view.time is None or n < 5 * _FEWEST_OF_A_VISIT:
            return None
        spread = np.maximum(MAD * np.median(np.abs(left), axis=0), self.floor)
        tame = np.clip(left / spread, -_CUT, _CUT)
        sums = np.concatenate([np.zeros((1, m)), np.cumsum(tame, axis=0)])
        first, last, grid = 0, 0, np.arange(0, n + 1, max(n // _CUTS, 1))
        starts, ends = grid[1:], grid[1:]
        for _ in range(2):
            a, b = (v.ravel() for v in np.meshgrid(starts, ends, indexing="ij"))
            keep = (b - a >= _FEWEST_OF_A_VISIT) & (b - a <= _MOST_BUMPED * n) & (a > 0) & (b < n)
            if not keep.any():
                return None
            a, b = a[keep], b[keep]
            best = int(np.argmax(((sums[b] - sums[a]) ** 2).sum(axis=1) / ((b - a) * (1.0 - (b - a) / n))))
            first, last = int(a[best]), int(b[best])
            starts, ends = (np.arange(v - grid[1], v + grid[1] + 1) for v in (first, last))
        stretch = np.zeros(n, dtype=bool)
        stretch[first:last] = True
        if np.linalg.norm(tame[stretch].mean(axis=0)) < 0.5 * _CUT:
            return None
        other = _Judged(self.view, declared=self.declared, stretch=stretch)
        believed, criterion, _ = other._concentrated(left)
        return (~believed[other.item], criterion) if np.isfinite(criterion) else None

    def _concentrated(self, left: Floats) -> tuple[Bools, float, float]:
        """Items that are believed, from a start that leaves ``left`` (n, m); Schwarz's criterion of the fit to them,
        whatever is not believed having parameters of its own; and what it leaves of them over their noise."""
        mean_basis = self.mean(self.basis.reshape(*self.e.shape, -1))
        believed = self._nearer_half(self.mean(left)) & ~self.moved
        for robust in (True, False):
            # the spread of all that is believed is known better than a median, but only once the wild ones are out
            for _ in range(_ROUNDS):
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
            if stats.chi2.sf(float(((by / np.maximum(own, self.floor)) ** 2).sum()), m) > _LEVEL / items:
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
        family = build(self.view, thorough=False)
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
        tame = np.clip(left, -_CUT * spread, _CUT * spread)
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
        chance = stats.chi2.logsf(gain[best], 1) + np.log(len(gain)) if best >= 0 else np.inf
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
        return float(stats.chi2.logsf(gain[best], m) + np.log(len(cuts))), columns.reshape(n * m, m)

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
        p = stats.f.sf(distance / m, m, max(freedom, 1.0))
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
        threshold = float(stats.norm.isf(0.5 * _LEVEL / (n * m)))
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


def _visits(time: Floats | None, wild: Bools) -> Bools:
    """Rows of visits to the machine (stretches of time with a long pause on either side) that are wild as a whole.

    When all that was read after a pause is off, that is no accident of single readings, it is news.
    """
    out = np.zeros(len(wild), dtype=bool)
    if time is None or len(wild) < 2:
        return out
    steps = np.diff(time)
    visit = np.concatenate([[0], np.cumsum(steps > _PAUSE * max(float(np.median(steps)), 1e-12))])
    count = np.bincount(visit)
    share = np.bincount(visit, wild) / count
    return ((share >= _WILD_VISIT) & (count >= _FEWEST_OF_A_VISIT))[visit]
