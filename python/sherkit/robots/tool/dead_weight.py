"""What a weight that hangs on the shaft makes of it: a force across the unbent axis alone, wherever the shaft points.

A contact pushes across the bent shaft, and so along the unbent axis as well; a weight on a thread does not. The rod is
Euler's elastica, whose curvature vanishes at the load: ``(θ')² = 2 q (sin θc - sin θ)``, ``q = F / EI``. In lengths of
``1 / √q`` all of them are one family by the angle ``θc`` at the load; the moment at a section is the weight times how
much higher the load stands (Frisch-Fay, Flexible Bars, 1962).
"""

from __future__ import annotations

from functools import cache

import numpy as np
import scipy

from ...base.types import Floats

#: Angles at the load, rad, and places between load and clamp, for which the family is tabled.
_ANGLES, _PLACES = 60, 60
_LARGEST_RAD = 1.4
_STEPS = 20_000


class _Family:
    """Rods by the angle at the load: length to the clamp and deflection, in ``1 / √q``; and the moment in ``√(q) EI``
    at a share of that length from the load, by the share and the angle."""

    def __init__(self) -> None:
        # sin θ = sin θc (1 - w²) takes the root out of the integrals
        angles = _LARGEST_RAD * np.linspace(1e-3, 1.0, _ANGLES)
        w = np.linspace(0.0, 1.0, _STEPS + 1)
        shares = np.linspace(0.0, 1.0, _PLACES)
        lengths, bends, moments = [], [], []
        for top in np.sin(angles):
            sine = top * (1.0 - w**2)
            # dθ / √(2 (sin θc - sin θ)) = √(2 sin θc) dw / cos θ
            by_w = np.sqrt(2.0 * top) / np.sqrt(1.0 - sine**2)
            along = scipy.integrate.cumulative_simpson(by_w, x=w, initial=0.0)
            lengths.append(along[-1])
            bends.append(float(scipy.integrate.simpson(by_w * sine, x=w)))
            # θ' = √(2 sin θc) w
            moments.append(np.sqrt(2.0 * top) * np.interp(shares * along[-1], along, w))
        self.longest = lengths[-1]
        size = np.sqrt(2.0 * np.sin(angles))
        # over what small bends make of them all are smooth
        self.angle_by_length = scipy.interpolate.CubicSpline([0.0, *lengths], [0.5, *(angles / np.square(lengths))])
        self.length = scipy.interpolate.CubicSpline(angles, np.array(lengths) / size)
        self.bend = scipy.interpolate.CubicSpline(angles, np.array(bends) / size**3)
        self.moment = scipy.interpolate.RectBivariateSpline(angles, shares, np.array(moments) / size[:, None])


_family = cache(_Family)


def hung(
    length_mm: float, stiffness_mn_mm2: float, weight_mn: Floats, depth_mm: Floats, sections_mm: Floats, *,
    by_height: bool,
) -> Floats:  # fmt: skip
    """Of weights (n,) whose ``depth_mm`` (n,) is a height along the unbent axis or a length of shaft, from the tip: the
    force across the shaft where it hangs, mN, its place along the shaft from the tip, mm, the moments at the
    ``sections_mm`` (2,) from the tip, mN·mm, and the deflection there, mm (n, 5)."""
    family = _family()
    unit = np.sqrt(stiffness_mn_mm2 / weight_mn)
    reach = (length_mm - depth_mm).clip(1e-6) / unit
    if by_height:
        angle = np.arcsin((reach**2 / 2.0).clip(0.0, np.sin(_LARGEST_RAD)))
    else:
        reach = reach.clip(max=family.longest)
        angle = family.angle_by_length(reach) * reach**2
    size = np.sqrt(2.0 * np.sin(angle))
    arm = family.length(angle) * size
    arc = length_mm - arm * unit
    share = (sections_mm - arc[:, None]) / (arm * unit)[:, None]
    moments = np.where(share > 0.0, family.moment.ev(angle[:, None], share.clip(0.0, 1.0)), 0.0)
    return np.column_stack([
        weight_mn * np.cos(angle), arc, moments * (size * stiffness_mn_mm2 / unit)[:, None],
        family.bend(angle) * size**3 * unit,
    ])  # fmt: skip
