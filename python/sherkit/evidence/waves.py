"""Waves over the range of a variable: tables of their sines and cosines, and which of them poses can tell."""

from __future__ import annotations

import numpy as np

from ..base.types import Bools, Floats
from .whitening import orthonormal

#: A turn, rad.
TURN = 2.0 * np.pi
#: Waves over the range: along a joint, a half wave apart; in time; over a place, which a grid tells less well.
_JOINT, _TIME, _PLACE = (1.0, 60.0), (1.0, 61.0), (2.0, 12.0)
#: Of a gear.
_GEAR = (3.0, 321.0)
#: Waves slower than this part of a frequency, and the part of a wave from which on they stand in for it, where values
#: are too far apart to tell.
_SLOWER, _STANDS_IN = 0.8, 0.8
#: Part of a range within which values are the same.
_SAME = 1e-3
#: Values that tell whether they do.
_LOOKED_AT = 2000


def waves_along(values: Floats) -> Floats:
    """How many waves over a joint's range are tried: no more than it has values, since further up there are more waves
    than readings to tell them by."""
    counts = np.arange(*_JOINT, 0.5)
    distinct = len(np.unique(np.round(values / (_SAME * max(float(np.ptp(values)), 1e-300)))))
    return np.asarray(counts[counts <= max(distinct, 2)])


def waves_of_gear(values: Floats, axes: int) -> Floats:
    """The same of a joint by itself that is read by so many ``axes``: a gear has more waves than what all joints share,
    and slow ones are not told from what else a joint does."""
    counts = np.arange(*_GEAR, 0.5)
    distinct = len(np.unique(np.round(values / (_SAME * max(float(np.ptp(values)), 1e-300)))))
    return np.asarray(counts[counts <= max(0.5 * axes * distinct, 2)])


def waves_in_time() -> Floats:
    """How many waves over a run are tried."""
    return np.arange(*_TIME, 0.5)


def waves_over_place() -> Floats:
    """How many waves over a coordinate are tried."""
    return np.arange(*_PLACE, 0.5)


def table_of(angle: Floats, counts: Floats) -> Floats:
    """Sines, then cosines (n, 2 w) of so many times the ``angle`` (n,) each; ``counts`` (w,) are evenly apart, so that
    all are products of a few (angle addition)."""
    few = max(int(np.sqrt(len(counts))), 1)
    apart = counts[1] - counts[0] if len(counts) > 1 else 0.0
    first = np.exp(1j * np.multiply.outer(angle, counts[:few]))
    on = np.exp(1j * np.multiply.outer(angle, apart * few * np.arange(-(-len(counts) // few))))
    waves = (on[:, :, None] * first[:, None, :]).reshape(len(angle), -1)[:, : len(counts)]
    return np.concatenate([waves.imag, waves.real], axis=1)


def told(values: Floats, counts: Floats) -> Bools:
    """Which waves (w,) the ``values`` that a variable has can tell: on the lines of a grid one as short as their
    distance is next to nothing, or what any slow bend is."""
    some = np.sort(values)[:: max(len(values) // _LOOKED_AT, 1)]
    u = (some - some[0]) / (some[-1] - some[0])
    out = np.ones(len(counts), dtype=bool)
    for k, count in enumerate(counts.tolist()):
        half = np.arange(0, 2.0 * _SLOWER * count + 1e-9)
        if 2 * len(half) < len(some):
            basis = orthonormal(np.cos(np.pi * np.outer(u, half)), 1e-6)
            waves = np.stack([np.sin(2 * np.pi * count * u), np.cos(2 * np.pi * count * u)], axis=1)
            left = waves - basis @ (basis.T @ waves)
            out[k] = (left**2).sum() >= (1.0 - _STANDS_IN) * (waves**2).sum()
    return out
