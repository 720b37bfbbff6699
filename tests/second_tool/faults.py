"""What an interrogator does to wavelengths (n, 9), nm, from some time on. A fault takes times and wavelengths."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Fault = Callable[[Array, Array], Array]


def stuck(fibre: int, since_s: float) -> Fault:
    """Shows the last value again and again."""

    def fault(t: Array, waves: Array) -> Array:
        held = t >= since_s
        if held.any():
            waves[held, fibre] = waves[np.argmax(held), fibre]
        return waves

    return fault


def dead(fibre: int, since_s: float, reads: float = np.nan) -> Fault:
    """Shows nothing, or a number that means nothing."""

    def fault(t: Array, waves: Array) -> Array:
        waves[t >= since_s, fibre] = reads
        return waves

    return fault


def swapped(first: int, second: int, since_s: float) -> Fault:
    """Two peaks change places: each column shows the other's."""

    def fault(t: Array, waves: Array) -> Array:
        on = t >= since_s
        waves[np.ix_(on, [first, second])] = waves[np.ix_(on, [second, first])]
        return waves

    return fault


def saturated(fibre: int, rest_nm: float, span_nm: float) -> Fault:
    """Never further than ``span_nm`` from its rest."""

    def fault(t: Array, waves: Array) -> Array:
        waves[:, fibre] = waves[:, fibre].clip(rest_nm - span_nm, rest_nm + span_nm)
        return waves

    return fault


def drifting(fibre: int, since_s: float, nm_per_s: float) -> Fault:
    """Creeps away: glue that lets go."""

    def fault(t: Array, waves: Array) -> Array:
        waves[:, fibre] += nm_per_s * (t - since_s).clip(0.0)
        return waves

    return fault


def jumps(fibre: int, since_s: float, nm: float, until_s: float) -> Fault:
    """A neighbour's peak is taken for this one's."""

    def fault(t: Array, waves: Array) -> Array:
        waves[(t >= since_s) & (t < until_s), fibre] += nm
        return waves

    return fault


def spikes(share: float, nm: float) -> Fault:
    """Single wild readings of single fibres."""

    def fault(t: Array, waves: Array) -> Array:
        rng = np.random.default_rng([0, 77])
        hit = rng.random(waves.shape) < share
        waves[hit] += nm * rng.standard_normal(int(hit.sum()))
        return waves

    return fault


def in_unit(factor: float) -> Fault:
    """Written in another unit than nm: 1e3 for pm, 1e-9 for m."""
    return lambda t, waves: waves * factor
