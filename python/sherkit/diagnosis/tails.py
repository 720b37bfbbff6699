"""Tails of distributions and what goes with them, by SciPy's special functions: its statistics and optimisation take
longer to load than a diagnosis takes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import scipy

from ..base.types import Floats, Ints

#: Halvings of an interval: to the last bit of what lies in it.
_HALVINGS = 60


def chi2_tail(x: Any, freedom: Any) -> Any:
    """Chance that χ² with ``freedom`` is beyond ``x``."""
    return scipy.special.chdtrc(freedom, np.maximum(x, 0.0))


def chi2_log_tail(x: Any, freedom: Any) -> Any:
    """Its logarithm; -inf where the chance is no number any more."""
    with np.errstate(divide="ignore"):
        return np.log(chi2_tail(x, freedom))


def f_tail(x: Any, over: Any, under: Any) -> Any:
    """Chance that F with these degrees of freedom is beyond ``x``."""
    return scipy.special.fdtrc(over, under, np.maximum(x, 0.0))


def normal_beyond(p: float) -> float:
    """What a standard Gaussian passes with the chance ``p``."""
    return float(-scipy.special.ndtri(p))


def pearson3_tail(x: float, skew: float, mean: float, std: float) -> float:
    """Chance that Pearson's type III variable with these moments is beyond ``x``: a gamma variable, moved."""
    z = (x - mean) / std
    if abs(skew) < 1e-6:
        return float(scipy.special.ndtr(-z))
    shape = 4.0 / skew**2
    at = max(shape + 2.0 * z / skew, 0.0)
    return float(scipy.special.gammaincc(shape, at) if skew > 0 else scipy.special.gammainc(shape, at))


def ranks(values: Floats) -> Floats:
    """Ranks from 1, equal values at their mean rank."""
    _, place, count = np.unique(values, return_inverse=True, return_counts=True)
    return (np.cumsum(count) - 0.5 * (count - 1.0))[place]


def rising_root(function: Callable[[float], float], low: float, high: float) -> float:
    """Where a function that rises from below zero at ``low`` to above at ``high`` passes it, by halving."""
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if function(middle) > 0 else (middle, high)
    return 0.5 * (low + high)


def z_score(gain: Floats, rank: Ints | np.integer[Any], total: float | Floats, free: int) -> Floats:
    """Wilson and Hilferty's z score of an F ratio with (rank, free - rank) degrees of freedom."""
    k = np.maximum(rank, 1)
    left = np.maximum(free - k, 1)
    ratio = (gain / k) / np.maximum((total - gain) / left, 1e-300)
    cube = np.cbrt(np.maximum(ratio, 0.0))
    a, b = 2.0 / (9.0 * k), 2.0 / (9.0 * left)
    z = ((1.0 - b) * cube - (1.0 - a)) / np.sqrt(a + b * cube * cube)
    return np.where(rank > 0, z, -np.inf)
