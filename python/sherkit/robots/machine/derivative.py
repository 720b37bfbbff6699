"""Derivatives of a user's function: by complex steps where it allows them, else by differences whose step suits it.

A complex step is exact to rounding (Squire and Trapp, "Using complex variables to estimate derivatives of real
functions", SIAM Review 1998); what a function does with `abs`, `hypot` or `arctan2` loses it, which a difference beside
it shows. Differences are central ones of fourth order; their step is where two steps agree best.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ...base.types import Floats
from ...errors import FitError

#: Readings (n, m) for inputs (n, i): joints and parameters beside each other, each row with its own.
Function = Callable[[NDArray[np.inexact]], NDArray[np.inexact]]

_TINY = 1e-30
#: Steps of differences, in parts of the size of an input.
_STEPS = 10.0 ** np.arange(0.0, -4.0, -0.5)
#: Part of the largest change by which two ways to a derivative may differ.
AGREE = 1e-5
#: The same where a function is called not smooth.
_SMOOTH = 1e-2
#: Digits of readings that a difference over a size can see.
_ROUNDING = 1e-11


@dataclass(frozen=True, eq=False)
class Steps:
    """How each input (i,) is stepped: zero by a complex step, else the step of its difference."""

    real: Floats

    def columns(self, function: Function, at: Floats, which: Sequence[int]) -> Floats:
        """Derivatives (n, m, len(which)) by these inputs at the rows ``at`` (n, i)."""
        return np.stack([self._column(function, at, k) for k in which], axis=2)

    def _column(self, function: Function, at: Floats, k: int) -> Floats:
        if self.real[k] > 0:
            return difference(function, at, k, float(self.real[k]))
        return complex_step(function, at, k)


def complex_step(function: Function, at: Floats, k: int) -> Floats:
    """Derivative (n, m) by input ``k`` at the rows ``at`` (n, i)."""
    moved = at.astype(complex)
    moved[:, k] += 1j * _TINY
    return np.asarray(np.imag(function(moved)) / _TINY, dtype=float)


def difference(function: Function, at: Floats, k: int, step: float) -> Floats:
    """The same by a central difference of fourth order."""
    values = []
    for by in (-2, -1, 1, 2):
        moved = at.copy()
        moved[:, k] += by * step
        values.append(np.asarray(function(moved), dtype=float))
    return (values[0] - 8 * values[1] + 8 * values[2] - values[3]) / (12 * step)


def steps_for(function: Function, at: Floats, sizes: Floats, names: Sequence[str]) -> Steps:
    """The way to step each input, tried at the rows ``at`` (n, i); ``sizes`` (i,) are what each may move by.

    Raises :class:`~sherkit.errors.FitError` where no two steps agree: the function is not smooth.
    """
    real = np.zeros(len(sizes))
    with np.errstate(all="ignore"):
        rounding = _ROUNDING * float(np.nanmax(np.abs(np.asarray(function(at), dtype=float)), initial=0.0))
        for k, size in enumerate(sizes):
            tried = [difference(function, at, k, float(step * size)) for step in _STEPS]
            # rows that one side of a step takes out of reach tell nothing
            known = np.asarray(np.isfinite(tried).all(axis=0))
            if not known.any():
                continue
            # a slope that is lost in the rounding of the readings is none
            scale = max(float(np.abs(tried[0])[known].max()), rounding / size, np.finfo(float).tiny)
            apart = [np.abs(a - b)[known].max() / scale for a, b in pairwise(tried)]
            best = int(np.argmin(apart))
            if apart[best] > _SMOOTH:
                row = int(np.argmax(np.where(known, np.abs(tried[best] - tried[best + 1]), 0.0).max(axis=1)))
                raise FitError(
                    f"the model's function is not smooth in '{names[k]}': at row {row} its slope depends on the step "
                    "(does it round, branch, or stop an iteration early?)"
                )
            if not _allows_complex(function, at, k, tried[best + 1], known, max(AGREE * scale, apart[best] * scale)):
                real[k] = _STEPS[best + 1] * size
    return Steps(real)


def _allows_complex(
    function: Function, at: Floats, k: int, slope: Floats, known: NDArray[np.bool_], off: float
) -> bool:
    """Whether complex steps come through a function."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # NumPy warns where it casts the imaginary part away
            found = complex_step(function, at, k)
    except Exception:
        return False
    return bool(np.isfinite(found[known]).all() and np.abs(found - slope)[known].max() <= 10 * off)
