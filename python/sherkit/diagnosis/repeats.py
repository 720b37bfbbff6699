"""What repeats of a pose hold, before it is called noise.

Within a pose the place is the same: how its readings differ from their mean can follow only the time, the way the
machine came there, or a column. These are searched as poses are, by the largest score of a family under flips of whole
poses, one shape after the other; the noise is what is left.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy

from .. import linalg
from ..data import Measurements
from ..data.columns import bare
from ..data.noise import MAD
from ..names import listed
from ..types import Floats, Ints
from .fitted_run import FittedRun
from .linearised import Whitening, orthonormal
from .scan import Block, Columns, Scan
from .shapes import wave
from .template import course

#: Chance that repeats of pure noise are said to hold something.
LEVEL = 1e-3
#: Deviations below which nothing is looked for, and rows above which more would show nothing that matters.
_LEAST, _MOST = 30, 3000
_MOST_SHAPES = 6
#: Most swings of a cycle in the course of a run, of how many moments each at least, and how finely they are looked for.
_SWINGS, _MOMENTS, _FINELY = 60, 6, 2.0
#: The same of a cycle in proportion to the place.
_SWINGS_BY_PLACE = 12
_STEPS = 24
#: Declared noise and what repeats show may differ by this factor.
_CONTRADICTS = 3.0
#: Deviations are cut to so many spreads: what wild rows hold is not searched.
_CUT = 4.0
#: A largest z score below this is chance without a flip.
_CHANCE = 3.7
#: The most that an instrument's readings have in common from row to row; rounds in which it settles; slow is what takes
#: more rows than this for one swing, of at most so many.
_COMMON, _ROUNDS, _ROWS, _LINES = 0.8, 5, 30, 30


@dataclass(frozen=True)
class Held:
    """One shape of what repeats hold: ``name`` of the variable, ``shape`` as :class:`~.shapes.Shape` calls it with its
    ``order``, ``period`` or moment ``at``; the ``axes`` it is on, and its RMS ``size`` there in the unit of the run;
    ``by_place`` where it is in proportion to the place, or to a column, as a picture that grows is."""

    name: str
    shape: str
    order: int | None = None
    period: float | None = None
    at: float | None = None
    axes: tuple[str, ...] = ()
    size: float = 0.0
    by_place: bool = False

    def __str__(self) -> str:
        told = course({
            "depends_on": [self.name], "axis": self.axes, "shape": self.shape, "order": self.order,
            "period": self.period, "at": self.at,
        })  # fmt: skip
        return f"{told}, from place to place in its own way" if self.by_place else told


@dataclass(frozen=True, eq=False)
class Repeats:
    """What repeats hold: shapes in the order found, the ``p`` of the first, and the noise (columns,) that is left."""

    held: tuple[Held, ...]
    p: float
    noise: Floats
    rows: int
    unit: str

    @property
    def periods(self) -> tuple[tuple[str, float], ...]:
        """Variables with the periods at which they are in it."""
        return tuple((one.name, one.period) for one in self.held if one.period is not None and not one.by_place)

    def signature(self, run: FittedRun) -> dict[str, Any]:
        """The first shape as a diagnosis describes what no effect explains."""
        first, rows = self.held[0], np.flatnonzero(run.whole)
        known = _variables(run, rows[np.argsort(run.data.order[rows], kind="stable")])
        values = known[first.name] if first.name in known else run.data[first.name][rows]
        low, high = float(values.min()), float(values.max())
        by_axis = {bare(run.names[a]): run.per_unit * float(self.noise[a]) for a in run.axes}
        rest = float(np.sqrt(np.mean([by_axis[name] ** 2 for name in first.axes])))
        others = sum(one.size**2 for one in self.held[1:])
        return {
            "depends_on": [first.name], "shape": first.shape, "order": first.order, "period": first.period,
            "axis": list(first.axes), "share_explained": first.size**2 / (first.size**2 + others + rest**2),
            "at": first.at, "joint": None, "ranges": {first.name: (0.5 * (low + high), 0.5 * (high - low) or 1.0)},
            "indistinguishable": [], "apart": "",
        }  # fmt: skip

    def __str__(self) -> str:
        each = [f"{one} by {one.size:.3g} {self.unit}" for one in self.held]
        return listed(each) if each else "nothing that follows time, the way there, or a column"


def in_repeats(run: FittedRun, *, seed: int) -> Repeats | None:
    """Searches the deviations of repeats from their pose. None where too few poses were repeated."""
    rows = np.flatnonzero(run.whole)
    rows = rows[np.argsort(run.data.order[rows], kind="stable")]
    variables = _variables(run, rows)
    pose = np.unique(run.data.groups[rows], return_inverse=True)[1].ravel()
    repeated = np.bincount(pose)[pose] > 1
    if repeated.sum() - len(np.unique(pose[repeated])) < _LEAST:
        return None
    rows, variables = rows[repeated], {name: values[repeated] for name, values in variables.items()}
    pose = np.unique(pose[repeated], return_inverse=True)[1].ravel()
    search = _Search(run, rows, pose, variables, seed)
    held, p = search.find()
    return Repeats(tuple(held), p, search.noise(), len(rows), run.unit)


def by_repeats(
    run: FittedRun, sigma: Floats, repeats: Repeats, *, declared: bool
) -> tuple[Floats, dict[str, tuple[float, float]]]:
    """The noise (columns,) of what repeats leave, where they tell it; and where they contradict what was ``declared``,
    by axis what was declared and what they show, in the unit of the run."""
    out, contradicted = sigma.copy(), {}
    for a in run.axes:
        shown, pose = float(repeats.noise[a]), run.data.pose_sigma[run.used[:, a], a]
        if declared:
            each = run.data.sigma[run.used[:, a], a]
            if not np.isfinite(each).all() or not each.any():
                continue
            said = float(np.sqrt(np.mean(each**2)))
            if 1.0 / _CONTRADICTS <= shown / said <= _CONTRADICTS:
                continue
            contradicted[bare(run.names[a])] = (run.per_unit * said, run.per_unit * shown)
        elif not repeats.held:
            continue
        out[a] = np.hypot(shown, float(np.sqrt(np.mean(pose**2))))
    return out, contradicted


def with_the_way(data: Measurements, held: Sequence[Held], run: FittedRun) -> Measurements:
    """The rows with the columns of the way there that repeats have shown to matter: suspects as any other column."""
    rows = np.arange(len(data))
    order = np.argsort(data.order, kind="stable")
    known = _way(run, rows[order])
    more = {}
    for one in held:
        if one.name in known and one.name not in data.covariates:
            values = np.empty(len(data))
            values[order] = known[one.name]
            more[one.name] = values
    return replace(data, covariates={**data.covariates, **more}) if more else data


def _way(run: FittedRun, rows: Ints) -> dict[str, Floats]:
    """How the machine came to these rows, in the order of time: the inputs of the row before, and the direction of the
    last motion of the point, a unit vector."""
    part = run.data.select(rows)
    out = {f"before_{name}": part.joints[np.maximum(np.arange(len(rows)) - 1, 0), k]
           for k, name in enumerate(part.layout.joints)}  # fmt: skip
    place = run.model.place(part, run.fit.predicted[rows])
    if place:
        # the place of the pose, not of the reading: what is predicted moves with time and direction as well
        group = np.unique(part.groups, return_inverse=True)[1].ravel()
        count = np.bincount(group)
        points = np.column_stack([(np.bincount(group, values) / count)[group] for values in place.values()])
        steps = np.diff(points, axis=0, prepend=points[:1])
        moved = np.linalg.norm(steps, axis=1)
        # where nothing moved, the motion before still holds
        last = np.maximum.accumulate(np.where(moved > 0, np.arange(len(rows)), 0))
        way = (steps / np.where(moved > 0, moved, 1.0)[:, None])[last]
        out |= {f"came_{bare(name)}": way[:, k] for k, name in enumerate(place)}
    return out


def _variables(run: FittedRun, rows: Ints) -> dict[str, Floats]:
    """What readings at one pose may differ by (rows,), all of them in the order of time."""
    part = run.data.select(rows)
    out = dict(run.model.covariates(part))
    if part.time_s is None:
        out["order"] = np.asarray(part.order, dtype=float)
    for k, name in enumerate(part.layout.joints):
        out[f"direction of {name}"] = part.direction[:, k]
    out = {name: values for name, values in _way(run, rows).items() if name not in out} | out
    return {name: np.asarray(v, dtype=float) for name, v in out.items() if np.isfinite(v).all() and np.ptp(v) > 0}


def _beside(run: FittedRun, rows: Ints) -> list[Floats]:
    """What a course in time may be in proportion to (rows,), from -1 to 1: the place, and every other column, as how
    fast the machine moved."""
    part = run.data.select(rows)
    if part.apart:
        # of several targets of one pose its turn makes errors in proportion to the place, of noise alone as well
        return []
    columns = {name: v for name, v in run.model.covariates(part).items() if name != "time_s"}
    known = [*run.model.place(part, run.fit.predicted[rows]).values(), *columns.values()]
    spans = [(np.asarray(v, dtype=float), float(np.ptp(v))) for v in known if np.isfinite(v).all()]
    return [2.0 * (v - v.min()) / span - 1.0 for v, span in spans if span > 0]


class _Search:
    """Deviations of rows (n, m) in the order of time, and the functions of a family, all without the mean of each
    pose."""

    def __init__(self, run: FittedRun, rows: Ints, pose: Ints, variables: dict[str, Floats], seed: int) -> None:
        self.run, self.rows, self.seed = run, rows, seed
        self.pose, self.count = pose, np.bincount(pose)
        self.axes = list(run.axes)
        self.raw = run.residuals[rows][:, self.axes]
        self.raw = self.raw - _means_of(self.raw, pose)
        spread = MAD * np.median(np.abs(self.raw), axis=0)
        self.spread = np.where(spread > 0, spread, np.maximum(self.raw.std(axis=0), 1e-300))
        self.tame = np.clip(self.raw / self.spread, -_CUT, _CUT)
        self.free = len(rows) - len(self.count)
        self.variables = variables
        self.beside = _beside(run, rows)
        self.held: list[Held] = []
        self.accepted: list[Floats] = []

    def find(self) -> tuple[list[Held], float]:
        """Shapes one after the other, while chance has less than :data:`LEVEL` of the largest; the p of the first."""
        family, functions = self._family()
        if not family:
            return [], 1.0
        seen = self._seen()
        first = 1.0
        for k in range(_MOST_SHAPES):
            scan = self._scan(family, functions, seen)
            largest = float(scan.z_scores.max(initial=-np.inf))
            p = scan.p_value(largest, seed=self.seed) if largest > _CHANCE else 1.0
            first = p if k == 0 else first
            if p > LEVEL:
                break
            self._accept(*self._simplest(scan, family, functions))
        return self.held, first

    def noise(self) -> Floats:
        """What is left within poses (columns,), of all rows."""
        out = np.ones(len(self.run.names))
        left, taken = self.raw, 0
        if self.accepted:
            basis = orthonormal(np.column_stack(self.accepted), 1e-6)
            # what describes the tame ones describes the others
            left, taken = self.raw - basis @ (basis.T @ self.raw), basis.shape[1]
        out[self.axes] = np.sqrt((left**2).sum(axis=0) / max(self.free - taken, 1))
        # repeats of a column that holds another one do not differ at all
        return np.maximum(out, self.run.digits)

    def _seen(self) -> Ints:
        """Rows that are searched: those of as many poses as are enough."""
        if len(self.pose) <= _MOST:
            return np.arange(len(self.pose))
        chosen = np.random.default_rng(self.seed).permutation(len(self.count))
        chosen = chosen[np.cumsum(self.count[chosen]) <= _MOST]
        return np.flatnonzero(np.isin(self.pose, chosen))

    # -- the family ----------------------------------------------------------------------------------------

    def _family(self) -> tuple[list[tuple[Held, tuple[int, ...]]], Floats]:
        """Shapes with the numbers of their functions, and these (n, f)."""
        columns: list[Floats] = []
        family: list[tuple[Held, tuple[int, ...]]] = []

        def add(held: Held, *functions: Floats) -> None:
            first = len(columns)
            columns.extend(functions)
            family.append((held, tuple(range(first, first + len(functions)))))

        for name, values in self.variables.items():
            low, high = float(values.min()), float(values.max())
            t = 2.0 * (values - low) / (high - low) - 1.0
            if name.startswith("direction of "):
                add(Held(name.removeprefix("direction of "), "hysteretic", at=0.0), t)
                continue
            add(Held(name, "smooth", order=1), t)
            if len(np.unique(values)) > 3:
                add(Held(name, "smooth", order=3), t, 1.5 * t**2 - 0.5, (2.5 * t**2 - 1.5) * t)
            if name in ("time_s", "order"):
                for k in range(1, _STEPS):
                    cut = k * len(values) // _STEPS
                    if values[cut] > values[cut - 1]:
                        at = float(values[cut])
                        add(Held(name, "step", at=at), (values >= at).astype(float))
                most = min(_SWINGS, len(np.unique(values)) // _MOMENTS)
                if self.beside:
                    add(Held(name, "smooth", order=1, by_place=True), *self._by_place((t,)))
                for swings in np.arange(_FINELY, _FINELY * most + 1) / _FINELY:
                    period = (high - low) / float(swings)
                    add(Held(name, "periodic", period=period), *wave(values, period))
                    if self.beside and swings <= _SWINGS_BY_PLACE:
                        by_place = Held(name, "periodic", period=period, by_place=True)
                        add(by_place, *self._by_place(wave(values, period)))
        made = self._columns(np.column_stack(columns)) if columns else np.zeros((len(self.pose), 0))
        # what is the same in all readings of each pose is no candidate
        there = np.linalg.norm(made, axis=0) > 0.0
        return [(held, numbers) for held, numbers in family if there[list(numbers)].all()], made

    def _by_place(self, functions: Sequence[Floats]) -> list[Floats]:
        """Functions (n,) times each of what they may be in proportion to."""
        return [one * beside for one in functions for beside in self.beside]

    def _columns(self, functions: Floats) -> Floats:
        """Functions (n, f) without the mean of each pose, of unit length; nothing where only rounding is left."""
        out = functions - _means_of(functions, self.pose)
        length, before = np.linalg.norm(out, axis=0), np.linalg.norm(functions, axis=0)
        there = length > 1e-6 * before
        return np.where(there, out / np.where(there, length, 1.0), 0.0)

    # -- one look ------------------------------------------------------------------------------------------

    def _scan(self, family: list[tuple[Held, tuple[int, ...]]], functions: Floats, seen: Ints) -> Scan:
        """The family under the filter in time, the mean of each pose out of everything."""
        m = self.tame.shape[1]
        pose = np.unique(self.pose[seen], return_inverse=True)[1].ravel()
        lag = np.maximum(np.diff(self.run.data.order[self.rows[seen]], prepend=-1), 1)
        accepted = np.concatenate([np.zeros((len(seen), 1)), *(a[seen] for a in self.accepted)], axis=1)
        filtered = _common(self.tame[seen], accepted, pose, lag)
        without = _Means(pose, filtered)
        fitted = np.einsum("nk,ab->nakb", without(accepted), np.eye(m)).reshape(len(seen), m, -1)
        block = Block(without(self.tame[seen]), fitted, without(functions[seen]), np.zeros((len(seen), m, 0)))
        candidates = [Columns(functions=numbers, axis=axis) for _, numbers in family for axis in (*range(m), None)]
        # the targets of one pose are one witness
        standing = self.run.data.standing[self.rows[seen]]
        return Scan(_OneBlock(block), candidates, np.unique(standing, return_inverse=True)[1].ravel())

    def _simplest(
        self, scan: Scan, family: list[tuple[Held, tuple[int, ...]]], functions: Floats
    ) -> tuple[Held, int | None, Floats]:
        """The shape with the lowest criterion of Schwarz, its axis and its functions (n, k); a cycle between those that
        were looked for."""
        gain, rank = scan.gains
        n, m = self.free * scan.m, scan.m
        score = n * np.log(np.maximum(1.0 - gain / scan.sum_of_squares, 1e-12)) + rank * np.log(n)
        best = int(np.argmin(np.where(rank > 0, score, np.inf)))
        held, numbers = family[best // (m + 1)]
        axis = best % (m + 1)
        where = None if axis == m else axis
        columns = functions[:, list(numbers)]
        if held.period is not None:
            held, columns = self._finer(held, where)
        return held, where, columns

    def _finer(self, held: Held, axis: int | None) -> tuple[Held, Floats]:
        """A cycle at the period that takes most."""
        assert held.period is not None
        values = self.variables[held.name]
        spacing = 1.0 / (_FINELY * float(np.ptp(values)))
        on = self.tame if axis is None else self.tame[:, [axis]]
        if self.accepted:
            basis = orthonormal(np.column_stack(self.accepted), 1e-6)
            on = on - basis @ (basis.T @ on)
        best, at = -1.0, 1.0 / held.period

        def functions(period: float) -> Floats:
            waves = wave(values, period)
            return self._columns(np.column_stack(self._by_place(waves) if held.by_place else waves))

        for frequency in at + spacing * np.linspace(-1.0, 1.0, 33):
            if frequency <= 0:
                continue
            basis = orthonormal(functions(1.0 / frequency), 1e-6)
            taken = float(((basis.T @ on) ** 2).sum())
            if taken > best:
                best, at = taken, float(frequency)
        return replace(held, period=1.0 / at), functions(1.0 / at)

    def _accept(self, held: Held, axis: int | None, columns: Floats) -> None:
        basis = orthonormal(columns, 1e-6)
        on = range(len(self.axes)) if axis is None else [axis]
        along = (basis.T @ self.raw) ** 2
        noise = (self.raw**2).sum(axis=0) / max(self.free, 1)
        axes = [k for k in on if along[:, k].sum() > 4.0 * basis.shape[1] * noise[k]] or list(on)
        size = self.run.per_unit * float(np.sqrt(along[:, axes].sum() / (self.free * len(axes))))
        self.accepted.append(columns)
        self.held.append(replace(held, axes=tuple(bare(self.run.names[self.axes[k]]) for k in axes), size=size))


def _common(left: Floats, accepted: Floats, pose: Ints, lag: Ints) -> Whitening:
    """The filter in time: what neighbours of (n, m) have in common beside the means of poses and all that is slow, by
    restricted likelihood to first order as :func:`~.linearised.correlation_in_time` has it."""
    n, m = left.shape
    lines = np.cos(np.pi * np.linspace(0.0, 1.0, n)[:, None] * np.arange(1, min(n // _ROWS, _LINES) + 1))
    slow = orthonormal(np.concatenate([lines, accepted], axis=1), 1e-6)
    next_to = np.flatnonzero(lag[1:] == 1)
    rho = 0.0
    for _ in range(_ROUNDS if len(next_to) > _LEAST else 0):
        without = _Means(pose, Whitening(rho, lag))
        basis = orthonormal(without(slow), 1e-6)
        e = without(left)
        e = e - basis @ (basis.T @ e)
        free = n - without.count - basis.shape[1]
        variance = float((e**2).sum()) / max(free * m, 1)
        if free <= 10 or variance <= 0:
            return Whitening(0.0, lag)
        taken = without.neighbours(next_to) + float((basis[next_to] * basis[next_to + 1]).sum())
        lagged = float((e[next_to] * e[next_to + 1]).sum()) / variance + m * taken
        step = lagged / (len(next_to) * m * max(free / n, 0.05))
        before, rho = rho, float(np.clip(rho + step * (1.0 - rho * rho), -_COMMON, _COMMON))
        # within two standard errors there is none
        if abs(rho - before) < 1e-3 or abs(rho) < 2.0 / np.sqrt(free * m):
            break
    return Whitening(rho if abs(rho) > 2.0 / np.sqrt(n * m) else 0.0, lag)


class _Means:
    """Takes the mean of each pose out of columns (n, k) and filters them in time: what the means leave there."""

    def __init__(self, pose: Ints, filtered: Whitening) -> None:
        self.pose, self.filtered = pose, filtered
        self.size = np.bincount(pose)
        self.count = len(self.size)
        if filtered.rho != 0.0:
            n = len(pose)
            here = scipy.sparse.csr_matrix((filtered.here, (np.arange(n), pose)), (n, self.count))
            before = scipy.sparse.csr_matrix((filtered.before[1:], (np.arange(1, n), pose[:-1])), (n, self.count))
            self.means = (here + before).tocsr()
            gram = (self.means.T @ self.means).toarray()
            # poses whose rows the filter makes alike share a mean
            gram[np.diag_indices(self.count)] *= 1.0 + 1e-10
            self.inverse = linalg.inv(gram)

    def __call__(self, columns: Floats) -> Floats:
        """Columns (n, k) filtered, without the means."""
        out = self.filtered(columns)
        if self.filtered.rho == 0.0:
            return out - _means_of(out, self.pose)
        return np.asarray(out - self.means @ (self.inverse @ (self.means.T @ out)))

    def neighbours(self, rows: Ints) -> float:
        """Sum of the projection on the means between these rows and those after them."""
        if self.filtered.rho == 0.0:
            return float((1.0 / self.size[self.pose[rows]])[self.pose[rows] == self.pose[rows + 1]].sum())
        first, second = self.means[rows], self.means[rows + 1]
        return float((first @ self.inverse * second.toarray()).sum())


def _means_of(values: Floats, pose: Ints) -> Floats:
    """The mean of each row's pose, of values (n, k)."""
    order = np.argsort(pose, kind="stable")
    starts = np.searchsorted(pose[order], np.arange(int(pose.max()) + 1))
    mean = np.add.reduceat(values[order], starts, axis=0) / np.bincount(pose)[:, None]
    return np.asarray(mean[pose])


@dataclass(frozen=True, eq=False)
class _OneBlock:
    """All rows of a scan at once."""

    only: Block

    @property
    def blocks(self) -> Sequence[slice]:
        """One stretch."""
        return [slice(0, len(self.only.residual))]

    def block(self, rows: slice) -> Block:
        """All of it."""
        del rows
        return self.only
