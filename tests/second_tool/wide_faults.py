"""What goes wrong with fibres, from a time on: which readings change, and which gratings are truly bad.

Gratings count from 0: section I 0 to 2, II 3 to 5, III 6 to 8; a fibre is k, k + 3, k + 6. Light comes from the clamp,
so it passes II, then I, then III.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .wide_fibres import Fibres
from .wide_hand import ease

Array = NDArray[np.float64]

FAULTS = ("grating", "fibre", "slip", "warm_all", "warm_II", "warm_III", "cut")
_FROM_CLAMP = (1, 0, 2)
_OFF_NM, _SLIPPED, _WARMER_K, _WARMS_IN_S = 0.5, 0.3, 5.0, 10.0


@dataclass(frozen=True)
class Signals:
    """True shifts (n, 9) by the bend and by warmth, nm, and the interrogator's noise (n, 9), standard normal."""

    bending_nm: Array
    warmth_nm: Array
    noise: Array

    def read(self, fibres: Fibres) -> Array:
        """Wavelengths (n, 9)."""
        return fibres.read(self.bending_nm + self.warmth_nm, self.noise)


@dataclass(frozen=True)
class Spoilt:
    """Wavelengths (n, 9) with a fault. ``bad``: gratings whose readings tell another bend than there is (a section that
    is warm is none: its fibres' differences are sound but for their unlike answers); ``changed``: all whose readings
    are not those of a sound tool."""

    wavelengths_nm: Array
    bad: frozenset[int]
    changed: frozenset[int]


def spoil(fault: str, fibres: Fibres, signals: Signals, t: Array, since_s: float, rng: np.random.Generator) -> Spoilt:
    """A fault by name from a time on; grating, fibre, section and sign are drawn."""
    late, section, fibre = t >= since_s, int(rng.integers(3)), int(rng.integers(3))
    sign = float(rng.choice([-1.0, 1.0]))
    waves = signals.read(fibres)
    strand = frozenset(fibre + 3 * s for s in range(3))
    if fault in ("grating", "fibre"):
        bad = strand if fault == "fibre" else frozenset({3 * section + fibre})
        waves[np.ix_(late, np.array(sorted(bad)))] += sign * _OFF_NM
        return Spoilt(waves, bad, bad)
    if fault == "slip":
        bending = signals.bending_nm.copy()
        bending[np.ix_(late, np.array(sorted(strand)))] *= 1.0 - _SLIPPED
        return Spoilt(Signals(bending, signals.warmth_nm, signals.noise).read(fibres), strand, strand)
    if fault == "cut":
        lost = _FROM_CLAMP[_FROM_CLAMP.index(section) :]
        bad = frozenset(fibre + 3 * s for s in lost)
        waves[np.ix_(late, np.array(sorted(bad)))] = np.nan
        return Spoilt(waves, bad, bad)
    warm = {"warm_all": (0, 1, 2), "warm_II": (1,), "warm_III": (2,)}.get(fault)
    if warm is None:
        raise ValueError(f"fault: '{fault}' is none of {FAULTS}")
    warmer = np.zeros((len(t), 3))
    warmer[:, list(warm)] = (_WARMER_K * ease((t - since_s) / _WARMS_IN_S))[:, None]
    hot = Signals(signals.bending_nm, signals.warmth_nm + fibres.warmed(warmer), signals.noise)
    return Spoilt(hot.read(fibres), frozenset(), frozenset(3 * s + k for s in warm for k in range(3)))
