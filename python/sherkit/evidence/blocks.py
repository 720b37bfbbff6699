"""Blocks of columns, each a statement on what may be missing, and the columns that they are made of.

A column is a function of the row times what carries it to the readings: an axis, how the readings answer to a joint, an
effect. It is stored as these two, so a product of all columns with vectors is two small products of matrices; rows that
were read at one pose are summed first where functions know nothing but the pose.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np

from ..base.types import Floats, Ints
from ..model.effect import Effect, Setting
from .linearised import Linearised
from .run import Run
from .thresholds import FEW_VISITS, ROUNDING

# -- Columns and blocks ------------------------------------------------------------------------------------------------

#: Numbers that are made at a time: as many as a processor keeps near.
_TOGETHER = 250_000


@dataclass(frozen=True, eq=False)
class Block:
    """Columns that say one thing together: an ``effect`` at a ``setting`` (a moment, a lag, a period), or a ``shape``
    (smooth, periodic, step, kink, bump, hysteretic, interaction, alternating) of the variables it ``depends_on``.

    ``at`` (k,) are the numbers of its columns in the family. Of a shape ``axis`` is the reading it is on, None for all;
    ``pattern`` the joint as whose error it arrives, and of an effect the part that it is of alone; ``order`` that of a
    polynomial and ``period`` that of a wave. Where runs of one machine are joined, ``since`` is the number of the
    course in which it changes over them; of a check so many of its last columns, ``zeros``, say where the effect has
    its zero. ``ways`` is the logarithm of how many others it was chosen from, beside those that are blocks.
    """

    shape: str
    depends_on: tuple[str, ...] = ()
    at: Ints = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    effect: Effect | None = None
    setting: Setting | None = None
    axis: int | None = None
    pattern: str | None = None
    order: int | None = None
    period: float | None = None
    since: int = 0
    zeros: int = 0
    ways: float = 0.0

    @property
    def name(self) -> str:
        """That of the effect; empty for a shape."""
        return self.effect.name if self.effect is not None else ""

    def has(self, other: Block) -> bool:
        """Whether another of the same effect is all that it is, or a part of it."""
        return self.name == other.name and self.pattern in (None, other.pattern)

    @property
    def cause(self) -> tuple[object, ...]:
        """What all its settings, axes and periods have in common."""
        return (self.name,) if self.effect is not None else (self.depends_on, self.shape)


def apart(one: Setting | None, other: Setting | None) -> float:
    """How far two settings lie apart: further than any two of one sort where only one has a period for each joint."""
    if isinstance(one, tuple) != isinstance(other, tuple):
        return float("inf")
    return float(np.abs(np.subtract(0.0 if one is None else one, 0.0 if other is None else other)).sum())


@dataclass(frozen=True, eq=False)
class Visits:
    """Which rows were read at one pose: ``first`` (p,) row of each, ``pose`` (n,) of each row, ``count`` (p,)."""

    first: Ints
    pose: Ints
    count: Floats

    @classmethod
    def of(cls, run: Run) -> Visits:
        """Of a run, or each row by itself where few were repeated or poses were not the same to the last digit."""
        n = len(run)
        _, first, pose = np.unique(run.view.group, return_index=True, return_inverse=True)
        pose = pose.ravel()
        stood = np.stack([np.zeros(n), *run.view.inputs.values(), *run.view.others.values()], axis=1)
        if len(first) > FEW_VISITS * n or not np.array_equal(stood[first][pose], stood):
            first = pose = np.arange(n)
        return cls(first, pose, np.bincount(pose).astype(float))

    def __len__(self) -> int:
        return len(self.first)

    def same(self, values: Floats) -> bool:
        """Whether values (n, …) are equal at all visits of each pose."""
        size = np.abs(values).max(initial=0.0)
        return len(self) < len(self.pose) and bool(
            (np.abs(values[self.first][self.pose] - values) <= 1e-13 * size).all()
        )

    def summed(self, values: Floats) -> Floats:
        """Sums (p, …) of values (n, …) over the visits of each pose."""
        order = np.argsort(self.pose, kind="stable")
        starts = np.concatenate([[0], np.cumsum(self.count[:-1])]).astype(np.int64)
        return np.asarray(np.add.reduceat(values[order], starts, axis=0))


@dataclass(frozen=True, eq=False)
class ColumnPart:
    """Columns: each of ``functions`` (r, f) times each of the ``carriers``, of r rows, or poses where it is ``posed``.

    Carriers are (r, c), each on every one of ``axes`` axes alone, or (r, m, c), on all axes at once. Numbers run over
    functions, then carriers, then axes. Both are kept column by column.
    """

    functions: Floats
    carriers: Floats
    axes: int
    posed: bool

    @property
    def alone(self) -> bool:
        """Whether a column is on one axis."""
        return self.carriers.ndim == 2

    def __post_init__(self) -> None:
        object.__setattr__(self, "functions", np.asfortranarray(self.functions))
        object.__setattr__(self, "carriers", np.asfortranarray(self.carriers))

    def __len__(self) -> int:
        return self.functions.shape[1] * self.carriers.shape[-1] * (self.axes if self.alone else 1)

    def products(self, x: Floats) -> Floats:
        """Products (columns, k) with vectors (r, m, k)."""
        r, m, k = x.shape
        if self.alone:
            carried = self.carriers[:, :, None] * x.reshape(r, 1, m * k)
        elif self.functions.shape[1] == 1:
            # one function is a weight of the rows: many carriers are one product of matrices
            weighed = (x * self.functions[:, :, None]).transpose(1, 0, 2).reshape(m * r, k)
            return np.asarray(self.carriers.T.reshape(-1, m * r) @ weighed)
        else:
            carried = np.einsum("rmc,rmk->rck", self.carriers, x)
        return np.asarray((self.functions.T @ carried.reshape(r, -1)).reshape(len(self), k))

    def split(self, number: Ints) -> tuple[Ints, Ints, Ints]:
        """Function, carrier and axis of columns by number; axis 0 where they are on all."""
        whole, axis = np.divmod(number, self.axes) if self.alone else (number, np.zeros_like(number))
        function, carrier = np.divmod(whole, self.carriers.shape[-1])
        return function, carrier, axis

    def values(self, number: Ints) -> Floats:
        """Columns (…, 1, r), on their own axis, or (…, m, r) on all, of these numbers (…)."""
        function, carrier, _ = self.split(number)
        carried = self.carriers.T[carrier]
        return np.asarray(self.functions.T[function][..., None, :] * (carried[..., None, :] if self.alone else carried))


class Columns:
    """Columns of a run by number, under its filter and of unit length; those that are nothing are zero.

    ``length`` (K,) is what they were divided by.
    """

    def __init__(self, run: Run, visits: Visits, parts: Iterable[ColumnPart]) -> None:
        self.run, self.visits = run, visits
        self.parts = tuple(parts)
        self.starts = np.concatenate([[0], np.cumsum([len(part) for part in self.parts])]).astype(np.int64)
        self.length = np.concatenate([np.ones(0), *(self._lengths(part) for part in self.parts)])

    def __len__(self) -> int:
        return int(self.starts[-1])

    def products(self, vectors: Floats) -> Floats:
        """Products (K, k) of all columns with vectors (N, k)."""
        x = self.run.white.transposed(vectors.reshape(len(self.run), self.run.axes, -1))
        summed = self.visits.summed(x) if any(part.posed for part in self.parts) else x
        each = [part.products(summed if part.posed else x) for part in self.parts]
        return np.asarray(np.concatenate([np.zeros((0, x.shape[2])), *each]) * self._per_length[:, None])

    def of(self, numbers: Ints) -> Floats:
        """Columns (N, k) by number (k,)."""
        return np.asarray(self.run.flat(self.raw(numbers)) * self._per_length[numbers])

    def raw(self, numbers: Ints) -> Floats:
        """Columns (n, m, k) by number (k,), as they were made."""
        out = np.zeros((len(numbers), self.run.axes, len(self.run)))
        of = self._part_of(numbers)
        for p in np.unique(of):
            self._fill(out, np.flatnonzero(of == p), numbers[of == p], p, posed=False)
        return out.T

    def grams(self, numbers: Ints) -> Floats:
        """Products (b, k, k) within blocks of columns, by number (b, k)."""
        out = np.empty((*numbers.shape, numbers.shape[1]))
        sorts, which = np.unique(self._part_of(numbers), axis=0, return_inverse=True)
        for s, parts in enumerate(sorts):
            some = np.flatnonzero(which.ravel() == s)
            out[some] = self._grams(numbers[some], parts)
        per = self._per_length[numbers]
        out *= per[:, :, None] * per[:, None, :]
        return out

    # -- within ---------------------------------------------------------------------------------------------------

    @property
    def _per_length(self) -> Floats:
        return np.where(self.length > 0, 1.0 / np.where(self.length > 0, self.length, 1.0), 0.0)

    def _part_of(self, numbers: Ints) -> Ints:
        return np.searchsorted(self.starts, numbers, side="right") - 1

    def _grams(self, numbers: Ints, parts: Ints) -> Floats:
        """The same of columns as they were made, the k-th of each block in the k-th of these ``parts`` (k,)."""
        blocks, k = numbers.shape
        own, m = [self.parts[p] for p in parts], self.run.axes
        posed, alone = self.run.white.is_plain and all(p.posed for p in own), all(p.alone for p in own)
        out, each = np.zeros((blocks, k, k)), 1
        if alone:
            axis = (numbers - self.starts[parts]) % m
            if k % m == 0 and (axis.reshape(blocks, -1, m) == np.arange(m)).all():
                # each column on all axes: one says what the others do
                numbers, parts, each = numbers[:, ::m], parts[::m], m
        wide, rows = numbers.shape[1], (len(self.visits) if posed else len(self.run)) * (1 if alone else m)
        for few in np.array_split(np.arange(blocks), max(-(-blocks * wide * rows // _TOGETHER), 1)):
            x = np.zeros((len(few) * wide, 1 if alone else m, rows // (1 if alone else m)))
            for p in np.unique(parts):
                at = np.flatnonzero(np.tile(parts == p, len(few)))
                self._fill(x, at, numbers[few][:, parts == p].ravel(), p, posed=posed)
            x = x * np.sqrt(self.visits.count) if posed else self.run.white(x.T).T
            x = x.reshape(len(few), wide, rows)
            small = x @ x.transpose(0, 2, 1)
            if each > 1:
                for a in range(m):
                    out[few[:, None, None], np.arange(a, k, m)[:, None], np.arange(a, k, m)] = small
            else:
                out[few] = small * (axis[few, :, None] == axis[few, None, :]) if alone else small
        return out

    def _fill(self, out: Floats, at: Ints, numbers: Ints, p: int, *, posed: bool) -> None:
        """Puts columns of a part at their places (k,) of ``out`` (…, m, r), or (…, 1, r) where all are on one axis."""
        part, local = self.parts[p], numbers - self.starts[p]
        values = part.values(local) if posed else self._at_rows(part, local)
        if part.alone:
            out[at, part.split(local)[2] if out.shape[1] > 1 else 0] = values[:, 0]
        else:
            out[at] = values

    def _at_rows(self, part: ColumnPart, numbers: Ints) -> Floats:
        """Columns of a part, by their numbers in it, as :meth:`ColumnPart.values` has them, at every row."""
        values = part.values(numbers)
        return values[..., self.visits.pose] if part.posed else values

    def _lengths(self, part: ColumnPart) -> Floats:
        """Lengths of a part's columns, zero where they are rounding."""
        weights = self.visits.count if part.posed else np.ones(len(self.run))
        carried = np.square(part.carriers) if part.alone else np.square(part.carriers).sum(axis=1)
        repeated = self.run.axes if part.alone else 1
        power = np.tile(np.repeat(weights @ carried, repeated), part.functions.shape[1])
        if self.run.white.is_plain:
            squares = np.repeat((np.square(part.functions).T @ (weights[:, None] * carried)).ravel(), repeated)
        else:
            squares, rows = np.empty(len(part)), len(self.run) * (1 if part.alone else part.axes)
            for few in np.array_split(np.arange(len(part)), max(-(-len(part) * rows // _TOGETHER), 1)):
                squares[few] = np.square(self.run.white(self._at_rows(part, few).T)).sum(axis=(0, 1))
        return np.sqrt(np.where(squares > ROUNDING * power, squares, 0.0))


# -- What is fixed before a run is read --------------------------------------------------------------------------------
# What is fixed before a run is read, so that it may be looked at as often as one likes.
#
# Shapes are functions of variables brought to the range that these have in a reference: rows over all of where and
# when the machine is to be judged. A coefficient of one leaves there, beside what the model fits, a root mean
# square of one unit of the readings; its prior is normal, in noises of that size. Scales, settings and weights do
# not hang on the rows read so far: the Bayes factor of a block is then the ratio of two densities of the same
# maximal invariant, its mean over looks never rises, and by Ville's inequality a weighted mean of them exceeds 1/α
# at any look with a chance of α at most (Grünwald, de Heide and Koolen, "Safe testing", J. R. Stat. Soc. B 2024;
# Pérez-Ortiz, Lardy, de Heide and Grünwald, "E-statistics, group invariance and anytime-valid testing", Ann. Stat.
# 2024). No number of looks and no budget is in it.

#: All that blocks have in common which say the same: at one setting, or at any.
Sort = tuple[object, ...] | None


@dataclass(frozen=True, eq=False)
class ReferenceRows:
    """A ``view`` of rows over the whole region and span, with rows ``cuts`` (c,) from which on a step is tried.

    ``scale`` is that of each sort of block, ``log_weight`` the logarithm of the prior weight of each of its settings;
    ``squares`` (k, k) are mean squares of each sort's columns, so scaled, over the reference, beside what the model
    fits. What none of them has is in no family of a run.
    """

    view: Linearised
    cuts: Ints
    scale: Mapping[Sort, float] = field(default_factory=dict)
    log_weight: Mapping[Sort, float] = field(default_factory=dict)
    squares: Mapping[Sort, Floats] = field(default_factory=dict)

    @property
    def names(self) -> set[object]:
        """Those of its effects."""
        return {sort[0][0] for sort in self.scale if sort is not None and isinstance(sort[0], tuple)}

    def sort_of(self, block: Block) -> Sort:
        """Of what sort a block is: at its setting where that was tried in the reference, else at any; None for one that
        is not there."""
        return next((one for one in sorts_of(block) if one in self.scale), None)


def sorts_of(block: Block) -> tuple[Sort, Sort]:
    """A block at its setting, and at any."""
    any_ = (block.cause, block.axis, block.pattern, block.order, len(block.at))
    return (*any_, block.setting, block.period), any_


def block_sizes(block: Block) -> Floats:
    """By what its columns (k,) are multiplied to be of plausible sizes; a step of each reading has one for each."""
    parameters = () if block.effect is None else block.effect.parameters
    return np.array([p.size for p in parameters]) if len(parameters) == len(block.at) else np.ones(len(block.at))
