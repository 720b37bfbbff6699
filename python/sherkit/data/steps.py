"""Columns that stand in steps: how many digits a file has of them."""

from __future__ import annotations

import numpy as np

from ..base.types import Floats

#: Different values from which steps can be read, so many that are looked at first, and how far values may stand beside
#: a step, in steps.
_FEWEST = 8
_FIRST = 256
_BESIDE = 0.01
#: The smallest difference between values may be this many steps.
_MOST_STEPS = 100


def step_of(values: Floats) -> float:
    """The largest step of which all differences between ``values`` (n,) are multiples; zero where there is none.

    Values that are no further apart than rounding are one.
    """
    apart = _apart(values[np.unique(np.linspace(0, len(values) - 1, min(len(values), _FIRST)).astype(np.int64))])
    if len(apart) < _FEWEST - 1:
        return 0.0
    every: Floats | None = None
    for several in range(1, _MOST_STEPS + 1):
        step = _fitted(apart, apart.min() / several)
        if _are_multiples(apart, step):
            every = _apart(values) if every is None else every
            if _are_multiples(every, step := _fitted(every, step)):
                return step
    return 0.0


def _apart(values: Floats) -> Floats:
    """Differences between neighbours among different values; such as are no further apart than rounding are one."""
    u = np.unique(values)
    apart = np.diff(u)
    return apart[apart > 1e-12 * max(abs(u[0]), abs(u[-1]))]


def _fitted(apart: Floats, step: float) -> float:
    """A step from the whole range, which tells it better than two values."""
    return float(apart.sum() / np.rint(apart / step).sum())


def _are_multiples(apart: Floats, step: float) -> bool:
    count = apart / step
    return bool((np.abs(count - np.rint(count)) < _BESIDE).all())
