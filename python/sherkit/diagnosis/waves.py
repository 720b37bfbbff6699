"""Waves along the inputs: at which frequencies they are looked for, and their columns.

The columns are how the readings answer to an input, times a sine or cosine of it: hundreds for each input, of which all
that a search asks, products and Gram matrices, are Fourier sums over the rows. They are never written out.

Evenly spaced readings cannot tell a frequency from one that is a wave per spacing away; uneven ones can, as far as
their largest common spacing allows (Eyer and Bartholdi, "Variable stars: which Nyquist frequency?", A&A Suppl. 1999).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from functools import cache, cached_property
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from .._core import spread_rows, wave_sums
from ..base.types import Bools, Floats, Ints
from ..evidence.linearised import Linearised
from ..evidence.whitening import Whitening

# -- Fourier sums over rows that stand anywhere along a variable ----------------------------------------------------

Complexes = NDArray[np.complex128]

#: Cells that a row is laid over, as the core has them.
_WIDTH = 14
_HALF = _WIDTH // 2
#: How steep the kernel is: as its authors advise for cells of which four fall on the shortest wave.
_STEEP = 2.30 * _WIDTH
_CELLS_PER_WAVE = 4
_POWERS = 17


def _kernel(cells: Floats) -> Floats:
    """The kernel at a distance in cells."""
    return np.exp(_STEEP * (np.sqrt(np.maximum(1.0 - (cells / _HALF) ** 2, 0.0)) - 1.0))


@cache
def _polynomials() -> Floats:
    """The kernel in each cell (powers, cells), highest power first, of where a row is in its own: -1 to 1."""
    at = np.cos(np.pi * (np.arange(_POWERS) + 0.5) / _POWERS)
    from_row = np.arange(_WIDTH) - 0.5 * (at[:, None] + 1.0) - (_HALF - 1)
    fitted = [np.polynomial.Chebyshev.fit(at, column, _POWERS - 1, domain=[-1, 1]) for column in _kernel(from_row).T]
    powers = np.stack([np.polynomial.chebyshev.cheb2poly(one.coef) for one in fitted], axis=1)
    return np.ascontiguousarray(powers[::-1])


def _transform(waves_per_cell: Floats) -> Floats:
    """The kernel's Fourier transform."""
    at, weight = _quadrature()
    return np.cos(np.multiply.outer(waves_per_cell, 2.0 * np.pi * at)) @ weight


@cache
def _quadrature() -> tuple[Floats, Floats]:
    at, weight = np.polynomial.legendre.leggauss(80)
    return _HALF * at, _HALF * weight * _kernel(_HALF * at)


class Gridded:
    """Sums over rows of ``count`` weights times waves of a variable, for frequencies that are whole multiples of
    ``unit`` up to the ``highest``, and any between.

    The variable lies between ``low`` and ``high``; the waves start where it is ``origin``, one for all weights or one
    for each.
    """

    def __init__(self, low: float, high: float, unit: float, highest: int, count: int, origin: float | Floats) -> None:
        self.unit, self.low, self.origin = unit, low, np.asarray(origin)
        self.round = int(scipy.fft.next_fast_len(_CELLS_PER_WAVE * max(highest, 1)))
        self.step = 1.0 / (unit * self.round)
        self.cells = np.zeros((int((high - low) / self.step) + 1 + _WIDTH, count))

    def add(self, values: Floats, weights: Floats) -> None:
        """More rows: where they are (n,) and their weights (n, count)."""
        spread_rows((values - self.low) / self.step, np.ascontiguousarray(weights), _polynomials(), self.cells)

    @classmethod
    def joined(cls, several: Sequence[Gridded]) -> Gridded:
        """The weights of several, which lie between the same ends, beside one another."""
        out = copy(several[0])
        out.cells = np.concatenate([one.cells for one in several], axis=1)
        out.origin = np.concatenate([np.broadcast_to(one.origin, one.cells.shape[1]) for one in several])
        return out

    def multiples(self, turns: Ints) -> Complexes:
        """Sums (k, count) of weight times exp(2πi · turns · unit · (value - origin))."""
        short = -len(self.cells) % self.round
        folded = np.concatenate([self.cells, np.zeros((short, self.cells.shape[1]))])
        folded = folded.reshape(-1, self.round, self.cells.shape[1]).sum(axis=0)
        return self._as_of_rows(np.conj(np.fft.rfft(folded, axis=0))[turns], turns / self.round)

    def at(self, frequency: float) -> Complexes:
        """Sums (count,) at any frequency up to the highest."""
        waves = np.array([frequency * self.step])
        angle = 2.0 * np.pi * waves * np.arange(len(self.cells))
        return self._as_of_rows((np.cos(angle) @ self.cells + 1j * (np.sin(angle) @ self.cells))[None], waves)[0]

    def _as_of_rows(self, of_cells: Any, waves_per_cell: Floats) -> Complexes:
        """Without the kernel, whose middle lies some cells on, and counted from the origin."""
        off = np.atleast_1d((self.low - self.origin) / self.step - (_HALF - 1))
        return of_cells * (
            np.exp(2j * np.pi * np.multiply.outer(waves_per_cell, off)) / _transform(waves_per_cell)[:, None]
        )


# -- Frequencies, and the columns of their waves ---------------------------------------------------------------------

TURN = 2.0 * np.pi
#: Frequencies per width of a peak: halfway between two of them a wave still takes four fifths of what it would.
OVERSAMPLING = 2.0
#: Fewest and most waves over the range of a joint: fewer are any bend, and each more makes a false alarm likelier and
#: the test dearer.
_FEWEST_WAVES, _MOST_WAVES = 2, 150
#: Mean of the waves at poses that stand at multiples of a distance: they are off it by up to a fifth of it.
_AT_MULTIPLES = 0.5
#: Readings that are closer than this part of the range are one: no wave is so short that it would tell them apart.
_SAME = 1e-3
#: Waves over the range up to which a period that the model has is looked at, however few the readings are.
_FINEST = 100_000


def frequencies(view: Linearised) -> Floats:
    """The frequencies (k,) at which waves of the inputs are looked for, waves per unit, the same for every input that
    has that unit.

    From two waves over the range, since what comes but once may be any bend, to as many as there are distinct readings:
    their mean distance is the shortest period, since further up there are more waves than readings to tell them by.
    Never more than 150. Where an effect has a period in rad, a joint has a ring: its error closes in a turn, so the
    periods are whole parts of one, from the half turn on, which two reading heads leave; once per turn is an effect of
    its own.
    """
    waving = [view.inputs[name] for name in view.waving]
    spans = [float(np.ptp(v)) for v in waving]
    if max(spans, default=0.0) <= 0.0:
        return np.zeros(0)
    span = max(spans)
    distinct = max(len(np.unique(np.round(v / (_SAME * span)))) for v in waving)
    waves = min(distinct, _MOST_WAVES)
    if rings(view):
        step = max(TURN / (OVERSAMPLING * span), 1.0)
        return np.unique(np.round(np.arange(2.0, waves * TURN / span + 1.0, step))) * _unit(view)
    return np.arange(_FEWEST_WAVES * OVERSAMPLING, OVERSAMPLING * waves + 1.0) * _unit(view)


def bends(turns: Ints, window: Floats) -> Bools:
    """Which frequencies (F,), half waves over the range, are none at these poses but a bend: the ``window`` (F,), how
    long the mean of the waves is of one, says that the poses stand at whole multiples of a distance. A wave as long as
    that is a constant there, and one that is longer or shorter by less than two waves over the range is no more than
    the bend of which it is the alias."""
    beside = np.concatenate([[-np.inf], window, [-np.inf]])
    top = (window >= beside[:-2]) & (window >= beside[2:])
    apart = turns[top & (window > _AT_MULTIPLES)]
    return np.asarray((np.abs(turns[:, None] - apart) < _FEWEST_WAVES * OVERSAMPLING).any(axis=1))


def _unit(view: Linearised) -> float:
    """The frequency of which all that are looked for are whole multiples."""
    return 1.0 / (TURN if rings(view) else OVERSAMPLING * max(float(np.ptp(view.inputs[n])) for n in view.waving))


def rings(view: Linearised) -> bool:
    """Whether the inputs are angles whose encoders close in a turn."""
    return any(effect.search == "period_rad" for effect, _ in view.periodic)


def waves_of(view: Linearised, frequency: float, rows: slice | None = None) -> Floats:
    """Columns (n, m, 2 k) of sine and cosine of each of k inputs, for amplitudes in their unit, over the noise; of a
    stretch of rows where one is given."""
    rows = view.whole if rows is None else rows
    columns = []
    for name in view.waving:
        pattern, angle = view.patterns[name], TURN * frequency * view.inputs[name][rows]
        columns += [pattern[rows] * np.sin(angle)[:, None], pattern[rows] * np.cos(angle)[:, None]]
    return np.stack(columns, axis=2)


class Waves:
    """Columns of every input with a known pattern at every frequency ``at`` (F,), before any filter in time.

    Column ``(2 j + s) F + f`` is the sine (s = 0) or cosine (s = 1) at frequency f of input j of ``names``; waves start
    where an input is lowest. How readings answer to an input is that of this view: what a fit changes in it is of
    second order, so that the waves of one fit do for all to the same rows.
    """

    def __init__(self, view: Linearised) -> None:
        # one that stood still has waves that are none: an effect has a place for each input
        self.names: Sequence[str] = view.waving if view.pattern_of else ()
        self.at = frequencies(view)
        self._whitening: Whitening | None = None
        if not len(self.at):
            self.names = ()
        self.unit = _unit(view) if len(self.at) else 1.0
        self.turns = np.round(self.at / self.unit).astype(np.int64)
        had = [1.0 / (period * self.unit) for _, period in view.periodic if period]
        #: Up to which multiple of the unit any frequency can be asked for: few readings have few waves to look for, but
        #: the model may have a period that is shorter than all of them.
        self.highest = max([int(self.turns.max(initial=1)), *(int(np.ceil(k)) for k in had if k <= _FINEST)]) + 1
        self.patterns = [view.patterns[name] for name in self.names]
        self.values = [view.inputs[name] for name in self.names]
        self.low = [float(v.min()) for v in self.values]
        self.high = [float(v.max()) for v in self.values]
        #: What is made of the waves of an input once.
        self.shapes: dict[str, list[Any]] = {}

    def __len__(self) -> int:
        return 2 * len(self.names) * len(self.at)

    def bends(self, name: str) -> Bools:
        """Which of the frequencies (F,) are none at these readings of an input."""
        j = self.names.index(name)
        sums = self.sums_along(j, 1)
        sums.add(self.values[j], np.full((len(self.values[j]), 1), 1.0 / len(self.values[j])))
        # half waves over the range of this input
        half = np.round(OVERSAMPLING * (self.high[j] - self.low[j]) * self.at).astype(np.int64)
        return bends(half, np.abs(sums.multiples(self.turns)[:, 0]))

    def numbers(self, name: str, f: int) -> tuple[int, int]:
        """The columns of an input at a frequency."""
        first = 2 * self.names.index(name) * len(self.at) + f
        return first, first + len(self.at)

    @cached_property
    def on_all_inputs(self) -> list[tuple[tuple[int, ...], float]]:
        """The columns of all inputs at a frequency, and its period."""
        count = len(self.at)
        every = np.arange(2 * len(self.names) * count).reshape(-1, count).T.tolist() if self.names else []
        return [(tuple(numbers), period) for numbers, period in zip(every, (1.0 / self.at).tolist(), strict=False)]

    def column(self, number: int, rows: slice) -> Floats:
        """Of one column these rows (b, m)."""
        which, f = divmod(number, len(self.at))
        angle = TURN * self.at[f] * (self.values[which // 2][rows] - self.low[which // 2])
        return self.patterns[which // 2][rows] * (np.cos(angle) if which % 2 else np.sin(angle))[:, None]

    def sums_along(self, j: int, count: int) -> Gridded:
        """Sums of ``count`` weights times waves of input j."""
        return Gridded(min(self.low), max(self.high), self.unit, self.highest, count, self.low[j])

    def filtered(self, whitening: Whitening) -> FilteredWaves:
        """The same under a filter in time; what was asked for last is remembered."""
        if self._whitening is None or self._whitening != whitening:
            self._whitening, self._filtered = whitening, FilteredWaves(self, whitening)
        return self._filtered


class FilteredWaves:
    """The columns of :class:`Waves` under a filter in time: all products are with the filter's transpose."""

    def __init__(self, waves: Waves, whitening: Whitening) -> None:
        self.waves, self.whitening = waves, whitening

    def __len__(self) -> int:
        return len(self.waves)

    def products(self, count: int) -> Products:
        """Products with ``count`` columns, whose rows are still to come."""
        return Products(self, count)

    def column(self, number: int, rows: slice) -> Floats:
        """Of one column these rows (b, m)."""
        return self.whitening.on(lambda part: self.waves.column(number, part), rows)

    def gram(self, columns: Ints) -> Floats:
        """Gram matrices (c, k, k) of sets (c, k) of columns, those of a set at one frequency."""
        which, f = np.divmod(columns, len(self.waves.at))
        return self._grams[f[:, :1, None], which[:, :, None], which[:, None, :]]

    @cached_property
    def squared(self) -> Floats:
        """Squared length of every column (K,)."""
        return np.ascontiguousarray(np.diagonal(self._grams, axis1=1, axis2=2).T).reshape(-1)

    @cached_property
    def _grams(self) -> Floats:
        return self._grams_of(lambda one: one.multiples(self.waves.turns))

    def gram_at(self, frequency: float) -> Floats:
        """Gram matrix (2 j, 2 j) of sine and cosine of all inputs at any frequency up to the highest."""
        return self._grams_of(lambda one: one.at(frequency)[None])[0]

    def _grams_of(self, evaluated: Callable[[Gridded], Complexes]) -> Floats:
        """Gram matrices (F, 2 j, 2 j): a product of waves is half the wave of the difference and half that of the
        sum."""
        pairs, apart, together = self._pairs
        minus, plus = evaluated(apart), evaluated(together)
        count = len(self.waves.names)
        made = np.zeros((len(minus), count, 2, count, 2))
        i, j = np.array(pairs).T
        made[:, i, 0, j, 0] = 0.5 * (minus.real - plus.real)
        made[:, i, 0, j, 1] = 0.5 * (plus.imag + minus.imag)
        made[:, i, 1, j, 0] = 0.5 * (plus.imag - minus.imag)
        made[:, i, 1, j, 1] = 0.5 * (minus.real + plus.real)
        out = made.reshape(len(minus), 2 * count, 2 * count)
        # a pair that was not looked at is the other way round one that was
        return 0.5 * (out + out.transpose(0, 2, 1))

    @cached_property
    def _pairs(self) -> tuple[list[tuple[int, int]], Gridded, Gridded]:
        """Pairs of inputs, and their sums over difference and sum: all that Gram matrices are made of."""
        waves, now = self.waves, self.whitening
        low, high = np.array(waves.low), np.array(waves.high)
        highest = waves.highest
        pairs, apart, together = [], [], []
        for i in range(len(low)):
            for j in range(0 if now.rho else i, len(low)):
                minus = Gridded(low.min() - high.max(), high.max() - low.min(), waves.unit, highest, 1, low[i] - low[j])
                plus = Gridded(2 * low.min(), 2 * high.max(), waves.unit, highest, 1, low[i] + low[j])

                def add(
                    one: Floats, other: Floats, weight: Floats, to: tuple[Gridded, Gridded] = (minus, plus)
                ) -> None:
                    to[0].add(one - other, weight[:, None])
                    to[1].add(one + other, weight[:, None])

                if i <= j:
                    weight = now.diagonal * np.einsum("na,na->n", waves.patterns[i], waves.patterns[j])
                    add(waves.values[i], waves.values[j], weight * (1.0 if i == j else 2.0))
                if now.rho:
                    late, early = now.late, now.early
                    later = np.einsum("na,na->n", waves.patterns[i][late], waves.patterns[j][early])
                    add(waves.values[i][late], waves.values[j][early], 2.0 * now.beside[late] * later)
                pairs.append((i, j))
                apart.append(minus)
                together.append(plus)
        return pairs, Gridded.joined(apart), Gridded.joined(together)

    def add_sums(self, rows: slice, residual: Floats, codes: Ints, sums: Floats) -> None:
        """Adds to ``sums`` (K, codes) the products of these rows of the columns and a residual (b, m), by the codes
        (b,) of the rows."""
        waves, now = self.waves, self.whitening
        of_input = 2 * len(waves.at)
        for late, part, factor in now.parts(rows):
            order = np.argsort(codes[late], kind="stable")
            sorted_codes = codes[late][order]
            for j, (pattern, values) in enumerate(zip(waves.patterns, waves.values, strict=True)):
                weight = factor * np.einsum("na,na->n", pattern[part], residual[late])
                angle = TURN * waves.unit * (values[part] - waves.low[j])
                wave_sums(
                    angle[order], weight[order], sorted_codes, waves.turns,
                    sums[j * of_input : (j + 1) * of_input],
                )  # fmt: skip


class Products:
    """Products of the columns of :class:`FilteredWaves` with others, whose rows come block by block."""

    def __init__(self, filtered: FilteredWaves, count: int) -> None:
        self.filtered = filtered
        self.sums = [filtered.waves.sums_along(j, count) for j in range(len(filtered.waves.names))]
        self.count = count

    def add(self, rows: slice, columns: Floats) -> None:
        """These rows of the others (b, m, count)."""
        waves, now = self.filtered.waves, self.filtered.whitening
        for late, part, factor in now.parts(rows):
            for pattern, values, sums in zip(waves.patterns, waves.values, self.sums, strict=True):
                weighted = (factor[:, None] * pattern[part])[:, None, :] @ columns[late]
                sums.add(values[part], weighted[:, 0])

    def all(self) -> Floats:
        """Every column times the others (K, count)."""
        out = [np.zeros((0, self.count))]
        for sums in self.sums:
            of = sums.multiples(self.filtered.waves.turns)
            out += [of.imag, of.real]
        return np.concatenate(out)

    def at(self, frequency: float) -> Floats:
        """Sine and cosine of all inputs at any frequency up to the highest, times the others (2 j, count)."""
        of = self._joined.at(frequency).reshape(len(self.sums), self.count)
        return np.stack([of.imag, of.real], axis=1).reshape(-1, self.count)

    @cached_property
    def _joined(self) -> Gridded:
        return Gridded.joined(self.sums)
