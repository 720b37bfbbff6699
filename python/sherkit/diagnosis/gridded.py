"""Fourier sums over rows that stand anywhere along a variable: spread over even cells first, then transformed.

Each row is laid over the few cells about it with a kernel whose transform is known; that of the cells is then the one
of the rows, to twelve digits, at the price of a dozen numbers for each row instead of one for each frequency (Barnett,
Magland and af Klinteberg, "A parallel nonuniform fast Fourier transform library based on an exponential of semicircle
kernel", SIAM J. Sci. Comput. 2019).
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from functools import cache
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from .._core import spread_rows
from ..base.types import Floats, Ints

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
