"""Waves along the inputs: at which frequencies they are looked for, and their columns.

The columns are how the readings answer to an input, times a sine or cosine of it: hundreds for each input, of which all
that a search asks, products and Gram matrices, comes from the waves alone. They are never written out, and made once
for all fits to the same rows: what a fit changes in how readings answer to an input is of second order.

Evenly spaced readings cannot tell a frequency from one that is a wave per spacing away; uneven ones can, as far as
their largest common spacing allows (Eyer and Bartholdi, "Variable stars: which Nyquist frequency?", A&A Suppl. 1999).
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np
import scipy

from ..types import Floats, Ints
from .linearised import Linearised, Whitening

TURN = 2.0 * np.pi
#: Frequencies per width of a peak: halfway between two of them a wave still takes four fifths of what it would.
OVERSAMPLING = 2.0
#: Most waves over the range of a joint: each more makes a false alarm likelier, and the test dearer.
_MOST_WAVES = 150
#: Readings that are closer than this part of the range are one: no wave is so short that it would tell them apart.
_SAME = 1e-3


def frequencies(view: Linearised) -> Floats:
    """The frequencies (k,) at which waves of the inputs are looked for, waves per unit, the same for every input.

    From one wave over the range to as many as there are distinct readings: their mean distance is the shortest period,
    since further up there are more waves than readings to tell them by. Never more than 150. Where an effect has a
    period in rad, a joint has a ring: its error closes in a turn, so the periods are whole parts of one, from the half
    turn on, which two reading heads leave; once per turn is an effect of its own.
    """
    spans = [float(np.ptp(v)) for v in view.inputs.values()]
    if max(spans, default=0.0) <= 0.0:
        return np.zeros(0)
    span = max(spans)
    distinct = max(len(np.unique(np.round(v / (_SAME * span)))) for v in view.inputs.values())
    waves = min(distinct, _MOST_WAVES)
    if rings(view):
        step = max(TURN / (OVERSAMPLING * span), 1.0)
        return np.unique(np.round(np.arange(2.0, waves * TURN / span + 1.0, step))) * _unit(view)
    return np.arange(OVERSAMPLING, OVERSAMPLING * waves + 1.0) * _unit(view)


def _unit(view: Linearised) -> float:
    """The frequency of which all that are looked for are whole multiples."""
    return 1.0 / (TURN if rings(view) else OVERSAMPLING * max(float(np.ptp(v)) for v in view.inputs.values()))


def rings(view: Linearised) -> bool:
    """Whether the inputs are angles whose encoders close in a turn."""
    return any(effect.search == "period_rad" for effect, _ in view.periodic)


def waves_of(view: Linearised, frequency: float) -> Floats:
    """Columns (n, m, 2 k) of sine and cosine of each of k inputs, for amplitudes in their unit, over the noise."""
    columns = []
    for name, pattern in view.patterns.items():
        angle = TURN * frequency * view.inputs[name]
        columns += [pattern * np.sin(angle)[:, None], pattern * np.cos(angle)[:, None]]
    return np.stack(columns, axis=2)


class Waves:
    """Columns of every moving input with a known pattern at every frequency ``at`` (F,), before any filter in time.

    Column ``(2 j + s) F + f`` is the sine (s = 0) or cosine (s = 1) at frequency f of input j of ``names``.
    """

    def __init__(self, view: Linearised) -> None:
        self.names: Sequence[str] = tuple(view.pattern_of)
        self.at = frequencies(view)
        self._patterns = [view.patterns[view.pattern_of[name]] for name in self.names]
        self._whitening: Whitening | None = None
        if not len(self.at):
            self.names = ()
        turns = np.round(self.at / _unit(view)).astype(np.int64) if self.names else self.at.astype(np.int64)
        #: Sines and cosines (n, F) of every input.
        self._of: list[tuple[Floats, Floats]] = []
        for name in self.names:
            once = np.exp(1j * TURN * _unit(view) * view.inputs[name])
            powers = np.multiply.accumulate(np.broadcast_to(once[:, None], (len(once), int(turns.max()))), axis=1)
            wanted = powers[:, turns - 1]
            self._of.append((np.ascontiguousarray(wanted.imag), np.ascontiguousarray(wanted.real)))

    def __len__(self) -> int:
        return 2 * len(self.names) * len(self.at)

    def numbers(self, name: str, f: int) -> tuple[int, int]:
        """The columns of an input at a frequency."""
        first = 2 * self.names.index(name) * len(self.at) + f
        return first, first + len(self.at)

    def on_all_inputs(self) -> list[tuple[tuple[int, ...], float]]:
        """The columns of all inputs at a frequency, and its period."""
        every = [[n for name in self.names for n in self.numbers(name, f)] for f in range(len(self.at))]
        return [(tuple(numbers), float(1.0 / at)) for numbers, at in zip(every, self.at, strict=True) if numbers]

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

    def times(self, matrix: Floats) -> Floats:
        """All columns times a matrix (n, m, k), rows in the order of time: (K, k)."""
        back = self.whitening.transposed(matrix)
        out = [np.zeros((0, matrix.shape[2]))]
        for pattern, both in zip(self.waves._patterns, self.waves._of, strict=False):
            along = np.einsum("na,nak->nk", pattern, back)
            out += [wave.T @ along for wave in both]
        return np.concatenate(out)

    def column(self, number: int) -> Floats:
        """One column (n, m)."""
        which, f = divmod(number, len(self.waves.at))
        wave = self.waves._of[which // 2][which % 2][:, f]
        return self.whitening(self.waves._patterns[which // 2] * wave[:, None])

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
        """Gram matrices (F, 2 j, 2 j) of all inputs at each frequency."""
        of, patterns, now = self.waves._of, self.waves._patterns, self.whitening
        count = 2 * len(of)
        out = np.zeros((len(self.waves.at), count, count))
        for i in range(count):
            for j in range(i + 1):
                by, also = patterns[i // 2], patterns[j // 2]
                one, other = of[i // 2][i % 2], of[j // 2][j % 2]
                same = now.diagonal * (by * also).sum(axis=1)
                out[:, i, j] = np.einsum("nf,nf->f", one * same[:, None], other)
                if now.rho:
                    beside = now.beside[1:]
                    later = beside * (by[1:] * also[:-1]).sum(axis=1)
                    sooner = beside * (by[:-1] * also[1:]).sum(axis=1)
                    out[:, i, j] += np.einsum("nf,nf->f", one[1:] * later[:, None], other[:-1])
                    out[:, i, j] += np.einsum("nf,nf->f", one[:-1] * sooner[:, None], other[1:])
                out[:, j, i] = out[:, i, j]
        return out

    def grouped(self, residual: Floats, group: Ints, groups: int) -> Floats:
        """Products of columns and residual (n, m), summed within each ``group`` (n,): (K, groups)."""
        n, now = len(residual), self.whitening
        rows = np.arange(n)
        here, before = residual * now.here[:, None], residual[1:] * now.before[1:, None]
        out = [np.zeros((0, groups))]
        for pattern, both in zip(self.waves._patterns, self.waves._of, strict=False):
            weight = np.concatenate([(pattern * here).sum(axis=1), (pattern[:-1] * before).sum(axis=1)])
            place = np.concatenate([group, group[1:]]), np.concatenate([rows, rows[:-1]])
            of_group = scipy.sparse.csr_matrix((weight, place), shape=(groups, n))
            out += [(of_group @ wave).T for wave in both]
        return np.concatenate(out)
