"""Nine gratings in three grooved fibres as somebody has glued them, and the interrogator that reads them.

A fibre at distance r from the axis, at an angle, under a curvature M / EI in some direction: strain e, shift 0.78 L e.
Warmth shifts each grating by its own coefficient. The interrogator's scale has a ripple.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .wide_rod import Touch

Array = NDArray[np.float64]

_STRAIN_OPTIC = 0.78
_WARMTH_NM_K = 0.010
#: The ripple of the scale, nm.
_RIPPLE_NM = 2e-4


@dataclass(frozen=True)
class Fibres:
    """Sections I, II, III by fibres: ``from_tip_mm`` (3,) true and ``drawn_mm`` (3,) as on the drawing; ``radius_mm``
    (3, 3) and ``side_rad`` (3, 3) true, and as drawn ``drawn_radius_mm`` and ``drawn_side_rad`` (3,); ``rest_nm`` (9,);
    ``warmth_nm_k`` (9,); the scale's ``period_nm`` and ``phase`` (9,); ``noise_nm`` of a wavelength."""

    from_tip_mm: Array
    drawn_mm: Array
    radius_mm: Array
    side_rad: Array
    drawn_radius_mm: float
    drawn_side_rad: Array
    rest_nm: Array
    warmth_nm_k: Array
    period_nm: float
    phase: Array
    noise_nm: float

    def answers(self, stiffness_mn_mm2: float) -> Array:
        """Shifts (3, 3, 2) of the fibres of each section by a moment's x and y, nm per mN mm."""
        side = np.stack([np.cos(self.side_rad), np.sin(self.side_rad)], axis=2)
        return np.asarray(_STRAIN_OPTIC * (self.rest_nm.reshape(3, 3) * self.radius_mm)[:, :, None] * side
                          / stiffness_mn_mm2)  # fmt: skip

    def bending(self, touch: Touch, way: Array) -> Array:
        """Shifts (n, 9) by the bend of a shaft that is pushed towards ``way`` (n, 2)."""
        answers = self.answers(touch.rod.stiffness_mn_mm2)
        moments = [touch.moment(at)[:, None] * way for at in self.from_tip_mm]
        return np.hstack([moment @ answers[s].T for s, moment in enumerate(moments)])

    def warmed(self, warmer_k: Array) -> Array:
        """Shifts (n, 9) by warmth, (n,) for all or (n, 3) for each section."""
        each = warmer_k[:, None] if warmer_k.ndim == 1 else np.repeat(warmer_k, 3, axis=1)
        return np.asarray(each * self.warmth_nm_k)

    def read(self, shift_nm: Array, noise: Array) -> Array:
        """What the interrogator shows (n, 9) of true shifts; ``noise`` (n, 9) is standard normal."""
        ripple = _RIPPLE_NM * np.sin(2 * np.pi * shift_nm / self.period_nm + self.phase)
        return np.asarray(self.rest_nm + shift_nm + ripple + self.noise_nm * noise)

    def drawn_gains(self, stiffness_mn_mm2: float) -> Array:
        """K (2, 2, 3) of sections I and II as ideal fibres 120 degrees apart would have it, mN mm per nm."""
        side = np.stack([np.cos(self.drawn_side_rad), np.sin(self.drawn_side_rad)])
        per_moment = _STRAIN_OPTIC * self.rest_nm.reshape(3, 3).mean(axis=1) * self.drawn_radius_mm / stiffness_mn_mm2
        return np.stack([2.0 / 3.0 / per_moment[s] * side for s in range(2)])


def fibres(rng: np.random.Generator, length_mm: float) -> Fibres:
    """Draws them for a shaft of that length."""
    first = rng.uniform(30.0, min(45.0, length_mm - 16.0))
    drawn = np.array([first, first + rng.uniform(8.0, 12.0), rng.uniform(4.0, 6.0)])
    moved = np.zeros(3)
    moved[rng.integers(2)] = rng.choice([-0.3, 0.3])
    radius, base, hand = rng.uniform(0.18, 0.27), rng.uniform(0.0, 2 * np.pi), rng.choice([-1.0, 1.0])
    side = base + hand * 2 * np.pi / 3 * np.arange(3)
    bands = rng.permutation([1524.0, 1538.0, 1552.0, 1566.0])[:3]
    return Fibres(
        from_tip_mm=drawn + moved,
        drawn_mm=drawn,
        radius_mm=radius * (1.0 + 0.03 * rng.standard_normal((3, 3))),
        side_rad=side + np.deg2rad(2.0) * rng.standard_normal((3, 3)),
        drawn_radius_mm=float(radius),
        drawn_side_rad=side,
        rest_nm=np.repeat(bands, 3) + rng.uniform(-1.5, 1.5, 9),
        warmth_nm_k=_WARMTH_NM_K * (1.0 + 0.02 * rng.standard_normal(9)),
        period_nm=float(rng.uniform(0.8, 2.0)),
        phase=rng.uniform(0.0, 2 * np.pi, 9),
        noise_nm=float(rng.uniform(0.5e-3, 1.5e-3)),
    )
