"""Deviations of repeats from their pose, and the shapes that they hold."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import cast

import numpy as np
import scipy

from ..base import linalg
from ..base.types import Floats, Ints
from ..data.columns import bare
from ..data.noise import MAD
from ..evidence.fitted_run import FittedRun, enough_of
from ..evidence.whitening import Whitening, orthonormal
from .columns import Block, Columns
from .scan import Scan
from .shapes import wave
from .template import course

# -- The mean of each pose taken out of columns under a filter in time ----------------------------------------------

#: The most that an instrument's readings have in common from row to row; rounds in which it settles; slow is what takes
#: more rows than this for one swing, of at most so many.
_COMMON, _ROUNDS, _ROWS, _LINES = 0.8, 5, 30, 30
#: Pairs of rows without which nothing is estimated.
_LEAST = 30


def in_common(left: Floats, accepted: Floats, pose: Ints, lag: Ints) -> Whitening:
    """The filter in time: what neighbours of (n, m) have in common beside the means of poses and all that is slow, by
    restricted likelihood to first order as :func:`~..evidence.whitening.correlation_in_time` has it."""
    n, m = left.shape
    lines = np.cos(np.pi * np.linspace(0.0, 1.0, n)[:, None] * np.arange(1, min(n // _ROWS, _LINES) + 1))
    slow = orthonormal(np.concatenate([lines, accepted], axis=1), 1e-6)
    next_to = np.flatnonzero(lag[1:] == 1)
    rho = 0.0
    for _ in range(_ROUNDS if len(next_to) > _LEAST else 0):
        without = Means(pose, Whitening(rho, lag))
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


class Means:
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
            return out - means_of(out, self.pose)
        return np.asarray(out - self.means @ (self.inverse @ (self.means.T @ out)))

    def neighbours(self, rows: Ints) -> float:
        """Sum of the projection on the means between these rows and those after them."""
        if self.filtered.rho == 0.0:
            return float((1.0 / self.size[self.pose[rows]])[self.pose[rows] == self.pose[rows + 1]].sum())
        first, second = self.means[rows], self.means[rows + 1]
        return float((first @ self.inverse * second.toarray()).sum())


def means_of(values: Floats, pose: Ints) -> Floats:
    """The mean of each row's pose, of values (n, k)."""
    n = len(pose)
    of_pose = scipy.sparse.csr_matrix((np.ones(n), (pose, np.arange(n))), (int(pose.max()) + 1, n))
    mean = (of_pose @ values) / np.bincount(pose)[:, None]
    return np.asarray(mean[pose])


# -- What the deviations hold ----------------------------------------------------------------------------------------

#: Chance that repeats of pure noise are said to hold something.
LEVEL = 1e-3
#: Deviations below which nothing is looked for, and rows above which more would show nothing that matters.
FEWEST, _MOST = 30, 3000
_MOST_SHAPES = 6
#: Most swings of a cycle in the course of a run, of how many moments each at least, and how finely they are looked for.
_SWINGS, _MOMENTS, _FINELY = 60, 6, 2.0
#: The same of a cycle in proportion to the place.
_SWINGS_BY_PLACE = 12
_STEPS = 24
#: Deviations are cut to so many spreads: what outliers hold is not searched.
_CUT = 4.0
#: A largest z score below this is chance without a flip.
_CHANCE = 3.7
#: What the variable is called that is the direction of a joint.
DIRECTION = "direction of "


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


class Deviations:
    """Deviations of rows (n, m) from the mean of their pose, in the order of time, and a family of shapes that they may
    hold. Shapes are looked for in the rows of as many poses as are enough; what is found is taken out of all.

    ``variables`` name to values (n,) are what readings at one pose may differ by, ``beside`` what a course in time may
    be in proportion to.
    """

    def __init__(
        self, run: FittedRun, rows: Ints, pose: Ints, variables: dict[str, Floats], beside: Sequence[Floats], seed: int
    ) -> None:
        self.run, self.rows, self.seed = run, rows, seed
        self.pose, self.count = pose, np.bincount(pose)
        self.axes = list(run.axes)
        self.raw = run.residuals[rows][:, self.axes]
        self.raw = self.raw - means_of(self.raw, pose)
        spread = MAD * np.median(np.abs(self.raw), axis=0)
        self.spread = np.where(spread > 0, spread, np.maximum(self.raw.std(axis=0), 1e-300))
        self.tame = np.clip(self.raw / self.spread, -_CUT, _CUT)
        self.free = len(rows) - len(self.count)
        self.variables, self.beside = variables, beside
        self.seen = self._enough()
        self.held: list[Held] = []
        self.accepted: list[Floats] = []

    def find(self) -> tuple[list[Held], float]:
        """Shapes one after the other, while chance has less than :data:`LEVEL` of the largest; the p of the first."""
        family, functions = self._family()
        if not family:
            return [], 1.0
        first = 1.0
        for k in range(_MOST_SHAPES):
            scan = self._scan([numbers for _, numbers in family], functions)
            largest = float(scan.z_scores.max(initial=-np.inf))
            p = scan.p_value(largest, level=LEVEL, seed=self.seed) if largest > _CHANCE else 1.0
            first = p if k == 0 else first
            if p > LEVEL:
                break
            self._accept(*self._simplest(scan, [held for held, _ in family]))
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

    def _enough(self) -> Ints:
        """Rows that are searched: where there are more, of each pose as many visits as of any other."""
        place = np.empty(len(self.run.data), dtype=np.int64)
        place[self.rows] = np.arange(len(self.rows))
        return place[enough_of(self.run.data, self.rows, _MOST)]

    # -- the family ----------------------------------------------------------------------------------------

    def _shapes(self) -> Iterator[Held]:
        """All that is looked for."""
        for name, values in self.variables.items():
            if name.startswith(DIRECTION):
                yield Held(name.removeprefix(DIRECTION), "hysteretic", at=0.0)
                continue
            yield Held(name, "smooth", order=1)
            distinct = len(np.unique(values))
            if distinct > 3:
                yield Held(name, "smooth", order=3)
            if name not in ("time_s", "order"):
                continue
            for k in range(1, _STEPS):
                cut = k * len(values) // _STEPS
                if values[cut] > values[cut - 1]:
                    yield Held(name, "step", at=float(values[cut]))
            if self.beside:
                yield Held(name, "smooth", order=1, by_place=True)
            most = min(_SWINGS, distinct // _MOMENTS)
            for swings in np.arange(_FINELY, _FINELY * most + 1) / _FINELY:
                yield Held(name, "periodic", period=float(np.ptp(values)) / float(swings))
                if self.beside and swings <= _SWINGS_BY_PLACE:
                    yield Held(name, "periodic", period=float(np.ptp(values)) / float(swings), by_place=True)

    def _functions(self, held: Held, rows: Ints | slice) -> list[Floats]:
        """Functions (rows,) of a shape, whose mean over each pose is still in them."""
        every = self.variables[DIRECTION + held.name if held.shape == "hysteretic" else held.name]
        values = every[rows]
        t = 2.0 * (values - every.min()) / np.ptp(every) - 1.0
        if held.shape == "step":
            return [(values >= cast(float, held.at)).astype(float)]
        if held.period is not None:
            out = list(wave(values, held.period))
        else:
            out = [t, 1.5 * t**2 - 0.5, (2.5 * t**2 - 1.5) * t][: held.order or 1]
        return [one * beside[rows] for one in out for beside in self.beside] if held.by_place else out

    def _columns(self, shapes: Sequence[Held], rows: Ints | slice) -> Floats:
        """Functions (rows, f) of shapes without the mean of each pose, of unit length; nothing where only rounding is
        left. The rows are all of their poses."""
        functions = np.column_stack([one for held in shapes for one in self._functions(held, rows)])
        before = (functions**2).sum(axis=0)
        functions -= means_of(functions, np.unique(self.pose[rows], return_inverse=True)[1].ravel())
        squares = (functions**2).sum(axis=0)
        there = squares > 1e-12 * before
        functions *= np.where(there, 1.0 / np.sqrt(np.where(there, squares, 1.0)), 0.0)
        return functions

    def _family(self) -> tuple[list[tuple[Held, tuple[int, ...]]], Floats]:
        """Shapes with the numbers of their functions, and these (seen, f)."""
        shapes = list(self._shapes())
        if not shapes:
            return [], np.zeros((len(self.seen), 0))
        ends = np.cumsum([0, *(len(self._functions(held, slice(0, 1))) for held in shapes)]).tolist()
        made = self._columns(shapes, self.seen)
        # what is the same in all readings of each pose is no candidate
        there = np.linalg.norm(made, axis=0) > 0.0
        family = [(held, tuple(range(a, b))) for held, (a, b) in zip(shapes, pairwise(ends), strict=True)]
        return [(held, numbers) for held, numbers in family if there[list(numbers)].all()], made

    # -- one look ------------------------------------------------------------------------------------------

    def _scan(self, family: Sequence[tuple[int, ...]], functions: Floats) -> Scan:
        """The family under the filter in time, the mean of each pose out of everything."""
        m, seen = self.tame.shape[1], self.seen
        pose = np.unique(self.pose[seen], return_inverse=True)[1].ravel()
        lag = np.maximum(np.diff(self.run.data.order[self.rows[seen]], prepend=-1), 1)
        accepted = np.concatenate([np.zeros((len(seen), 1)), *(a[seen] for a in self.accepted)], axis=1)
        filtered = in_common(self.tame[seen], accepted, pose, lag)
        without = Means(pose, filtered)
        fitted = np.einsum("nk,ab->nakb", without(accepted), np.eye(m)).reshape(len(seen), m, -1)
        block = Block(without(self.tame[seen]), fitted, without(functions), np.zeros((len(seen), m, 0)))
        candidates = [Columns(functions=numbers, axis=axis) for numbers in family for axis in (*range(m), None)]
        # the targets of one pose are one witness
        standing = self.run.data.standing[self.rows[seen]]
        return Scan(_OneBlock(block), candidates, np.unique(standing, return_inverse=True)[1].ravel())

    def _simplest(self, scan: Scan, shapes: Sequence[Held]) -> tuple[Held, int | None]:
        """The shape with the lowest criterion of Schwarz, and its axis; a cycle or a step is made finer."""
        gain, rank = scan.gains
        n, m = self.free * scan.m, scan.m
        score = n * np.log(np.maximum(1.0 - gain / scan.sum_of_squares, 1e-12)) + rank * np.log(n)
        best = int(np.argmin(np.where(rank > 0, score, np.inf)))
        held, axis = shapes[best // (m + 1)], best % (m + 1)
        where = None if axis == m else axis
        finer = [held, *(self._periods(held) if held.shape == "periodic" else self._moments(held))]
        return self._taking_most(finer, where), where

    def _periods(self, held: Held) -> list[Held]:
        """A cycle at the periods about its own."""
        assert held.period is not None
        spacing = 1.0 / (_FINELY * float(np.ptp(self.variables[held.name])))
        frequencies = 1.0 / held.period + spacing * np.linspace(-1.0, 1.0, 33)
        return [replace(held, period=1.0 / frequency) for frequency in frequencies[frequencies > 0].tolist()]

    def _moments(self, held: Held) -> list[Held]:
        """A step at each row about its own."""
        if held.shape != "step":
            return []
        values = self.variables[held.name]
        near, reach = int(np.searchsorted(values, cast(float, held.at))), len(values) // _STEPS + 1
        return [replace(held, at=float(at)) for at in np.unique(values[max(near - reach, 0) : near + reach])[1:]]

    def _taking_most(self, shapes: Sequence[Held], axis: int | None) -> Held:
        """The shape that takes most of the deviations that are searched, on one axis or on all."""
        if len(shapes) == 1:
            return shapes[0]
        on = self.tame if axis is None else self.tame[:, [axis]]
        if self.accepted:
            basis = orthonormal(np.column_stack(self.accepted), 1e-6)
            on = on - basis @ (basis.T @ on)
        on = on[self.seen]
        bases = (orthonormal(self._columns([held], self.seen), 1e-6) for held in shapes)
        return shapes[int(np.argmax([float(((basis.T @ on) ** 2).sum()) for basis in bases]))]

    def _accept(self, held: Held, axis: int | None) -> None:
        columns = self._columns([held], slice(None))
        basis = orthonormal(columns, 1e-6)
        on = range(len(self.axes)) if axis is None else [axis]
        along = (basis.T @ self.raw) ** 2
        noise = (self.raw**2).sum(axis=0) / max(self.free, 1)
        axes = [k for k in on if along[:, k].sum() > 4.0 * basis.shape[1] * noise[k]] or list(on)
        size = self.run.per_unit * float(np.sqrt(along[:, axes].sum() / (self.free * len(axes))))
        self.accepted.append(columns)
        self.held.append(replace(held, axes=tuple(bare(self.run.names[self.axes[k]]) for k in axes), size=size))


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
