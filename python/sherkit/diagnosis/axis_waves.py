"""Waves of a variable on single axes of the readings, without their mean: what an error that repeats with a coordinate
leaves. As those along the inputs (:mod:`.waves`), they are never written out."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from .._core import wave_sums
from ..base.types import Floats, Ints
from ..evidence.whitening import Whitening
from .waves import TURN, Gridded


@dataclass(frozen=True, eq=False)
class Along:
    """Waves of one variable ``values`` (n,), ``turns`` (F,) whole multiples of the frequency ``unit``."""

    values: Floats
    unit: float
    turns: Ints

    @property
    def at(self) -> Floats:
        """Frequencies (F,)."""
        return np.asarray(self.unit * self.turns, dtype=np.float64)

    @property
    def low(self) -> float:
        """Where the waves start."""
        return float(self.values.min())

    def angle(self, rows: slice | Ints) -> Floats:
        """The angle of the unit in these rows (b,)."""
        return TURN * self.unit * (self.values[rows] - self.low)

    def sums(self, count: int) -> Gridded:
        """Sums of ``count`` weights times the waves."""
        return Gridded(self.low, float(self.values.max()), self.unit, int(self.turns.max()), count, self.low)

    @cached_property
    def mean(self) -> Floats:
        """Mean (2, F) of sines and cosines."""
        return self.over(np.full(len(self.values), 1.0 / len(self.values)))

    def over(self, weight: Floats) -> Floats:
        """Sums (2, F) of weights (n,) times sines and cosines."""
        sums = self.sums(1)
        sums.add(self.values, weight[:, None])
        of = sums.multiples(self.turns)[:, 0]
        return np.stack([of.imag, of.real])

    def products(self, values: Floats, other: Floats, weight: Floats) -> Floats:
        """Sums (F, 2, 2) of weights times sine and cosine of ``values`` times those of ``other``, (k,) each."""
        low, high = self.low, float(self.values.max())
        highest = int(self.turns.max())
        apart = Gridded(low - high, high - low, self.unit, highest, 1, 0.0)
        together = Gridded(2 * low, 2 * high, self.unit, highest, 1, 2 * low)
        apart.add(values - other, weight[:, None])
        together.add(values + other, weight[:, None])
        minus, plus = apart.multiples(self.turns)[:, 0], together.multiples(self.turns)[:, 0]
        return 0.5 * np.array([
            [minus.real - plus.real, plus.imag + minus.imag], [plus.imag - minus.imag, minus.real + plus.real],
        ]).transpose(2, 0, 1)  # fmt: skip


class AxisWaves:
    """Columns of several variables, each on every one of ``axes`` axes, under a filter in time.

    Those of variable v stand from ``first[v]`` on: ``(2 a + s) F + f`` is the sine (s = 0) or cosine (s = 1) on axis a
    at frequency f.
    """

    def __init__(self, along: tuple[Along, ...], axes: int, whitening: Whitening) -> None:
        self.along, self.axes, self.whitening = along, axes, whitening
        self.first = np.cumsum([0, *(2 * axes * len(one.turns) for one in along)])
        one = np.ones((len(whitening.here), 1))
        #: A constant under the filter, and under its transpose as well.
        self.constant = whitening.on(lambda rows: one[rows], slice(0, len(one)))[:, 0]
        self.twice = self.constant * whitening.here
        self.twice[whitening.early] += (self.constant * whitening.before)[whitening.late]

    def __len__(self) -> int:
        return int(self.first[-1])

    def _place(self, number: int) -> tuple[int, int, int, int]:
        """Variable, axis, half and frequency of a column."""
        v = int(np.searchsorted(self.first, number, side="right")) - 1
        which, f = divmod(number - int(self.first[v]), len(self.along[v].turns))
        return v, which // 2, which % 2, f

    def column(self, number: int, rows: slice) -> Floats:
        """Of one column these rows (b, m)."""
        v, axis, half, f = self._place(number)
        one = self.along[v]

        def raw(part: slice) -> Floats:
            angle = one.turns[f] * one.angle(part)
            values = np.zeros((len(angle), self.axes))
            values[:, axis] = (np.cos(angle) if half else np.sin(angle)) - one.mean[half, f]
            return values

        return self.whitening.on(raw, rows)

    def products(self, count: int) -> AxisProducts:
        """Products with ``count`` columns, whose rows are still to come."""
        return AxisProducts(self, count)

    @cached_property
    def _grams(self) -> list[Floats]:
        """Gram matrices (F, 2, 2) of sine and cosine on one axis, of each variable."""
        out = []
        for one in self.along:
            gram = one.products(one.values, one.values, self.whitening.diagonal)
            if self.whitening.rho:
                late, early = self.whitening.late, self.whitening.early
                beside = one.products(one.values[late], one.values[early], self.whitening.beside[late])
                gram += beside + beside.transpose(0, 2, 1)
            mean, under = one.mean.T, one.over(self.twice).T
            cross = mean[:, :, None] * under[:, None, :]
            out.append(gram - cross - cross.transpose(0, 2, 1)
                       + mean[:, :, None] * mean[:, None, :] * float(self.twice.sum()))  # fmt: skip
        return out

    def gram(self, columns: Ints) -> Floats:
        """Gram matrices (c, k, k) of sets (c, k) of columns, those of a set of one variable at one frequency."""
        v = np.searchsorted(self.first, columns[:, 0], side="right") - 1
        out = np.zeros((*columns.shape, columns.shape[1]))
        for k, of in enumerate(self._grams):
            which, f = np.divmod(columns[v == k] - self.first[k], len(self.along[k].turns))
            axis, half = np.divmod(which, 2)
            same = axis[:, :, None] == axis[:, None, :]
            out[v == k] = np.where(same, of[f[:, :1, None], half[:, :, None], half[:, None, :]], 0.0)
        return out

    @cached_property
    def squared(self) -> Floats:
        """Squared length of every column (K,)."""
        each = [np.tile(np.diagonal(of, axis1=1, axis2=2).T, (self.axes, 1)).ravel() for of in self._grams]
        return np.concatenate([np.zeros(0), *each])

    def add_sums(self, rows: slice, residual: Floats, codes: Ints, sums: Floats) -> None:
        """Adds to ``sums`` (K, codes) the products of these rows of the columns and a residual (b, m), by the codes
        (b,) of the rows."""
        count = sums.shape[1]
        for late, part, factor in self.whitening.parts(rows):
            order = np.argsort(codes[late], kind="stable")
            sorted_codes = codes[late][order]
            for one, first in zip(self.along, self.first.tolist(), strict=False):
                angle, width = one.angle(part)[order], 2 * len(one.turns)
                for axis in range(self.axes):
                    weight = (factor * residual[late, axis])[order]
                    wave_sums(
                        angle, weight, sorted_codes, one.turns,
                        sums[first + axis * width : first + (axis + 1) * width],
                    )  # fmt: skip
        for axis in range(self.axes):
            constant = np.bincount(codes, self.constant[rows] * residual[:, axis], count)
            for one, first in zip(self.along, self.first.tolist(), strict=False):
                width = 2 * len(one.turns)
                place = slice(first + axis * width, first + (axis + 1) * width)
                sums[place] -= np.multiply.outer(one.mean.ravel(), constant)


class AxisProducts:
    """Products of the columns of :class:`AxisWaves` with others, whose rows come block by block."""

    def __init__(self, waves: AxisWaves, count: int) -> None:
        self.waves, self.count = waves, count
        self.sums = [one.sums(waves.axes * count) for one in waves.along]
        self.constant = np.zeros((waves.axes, count))

    def add(self, rows: slice, columns: Floats) -> None:
        """These rows of the others (b, m, count)."""
        waves = self.waves
        for late, part, factor in waves.whitening.parts(rows):
            weighted = (factor[:, None, None] * columns[late]).reshape(len(factor), -1)
            for one, sums in zip(waves.along, self.sums, strict=True):
                sums.add(one.values[part], weighted)
        self.constant += np.tensordot(waves.constant[rows], columns, 1)

    def all(self) -> Floats:
        """Every column times the others (K, count)."""
        out = [np.zeros((0, self.count))]
        for one, sums in zip(self.waves.along, self.sums, strict=True):
            of = sums.multiples(one.turns).reshape(len(one.turns), self.waves.axes, self.count)
            halves = np.stack([of.imag, of.real]).transpose(2, 0, 1, 3)
            halves = halves - one.mean[None, :, :, None] * self.constant[:, None, None, :]
            out.append(halves.reshape(-1, self.count))
        return np.concatenate(out)
