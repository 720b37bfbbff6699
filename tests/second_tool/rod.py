"""A clamped rod that a frictionless edge pushes sideways: the exact elastica, and the cantilever of small bends.

The edge pushes with F across the rod at arc length a from the clamp. Inside, the force is the same everywhere, so with
the angle phi between a point and the contact, and the arc sigma from the contact back to the clamp,

    EI phi'' = F cos(phi),    phi(0) = phi'(0) = 0:

an initial value problem. In tau = sigma sqrt(F/EI) it has no parameter left: every such rod is one piece of one curve,
which is integrated once. Its first integral is phi'^2 / 2 = sin(phi). With p = a^2 F / EI all ratios are smooth in p.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

Array = NDArray[np.float64]

_FARTHEST = 1.5  # of tau: an angle of 1.04 rad, far beyond what a shaft survives


class Curve(NamedTuple):
    """The universal curve: curvature by tau; axial and lateral place and angle of the contact by p, per arc length."""

    curvature: CubicSpline
    axial: CubicSpline
    lateral: CubicSpline
    angle: CubicSpline


@cache
def curve() -> Curve:
    """Integrated once."""
    p = np.linspace(0.0, _FARTHEST**2, 1201)
    tau = np.linspace(0.0, _FARTHEST, 1201)
    made = solve_ivp(lambda _, y: [y[1], np.cos(y[0]), np.cos(y[0]), np.sin(y[0])], (0.0, _FARTHEST), [0.0] * 4,
                     rtol=1e-12, atol=1e-14, method="DOP853", dense_output=True)  # fmt: skip
    phi, _, x, y = made.sol(np.sqrt(p))
    arc = np.where(p > 0, np.sqrt(p), 1.0)
    axial, lateral = (x * np.cos(phi) + y * np.sin(phi)) / arc, (x * np.sin(phi) - y * np.cos(phi)) / arc
    axial[0] = 1.0
    return Curve(*(CubicSpline(*v) for v in ((tau, made.sol(tau)[1]), (p, axial), (p, lateral), (p, phi))))


@dataclass(frozen=True)
class Bent:
    """A rod under an edge, rows (n,): force across the rod at the contact, arc from the clamp to it, its place across
    and along the clamp's axis, the angle there."""

    rod: Rod
    force_mn: Array
    arc_mm: Array
    across_mm: Array
    along_mm: Array
    angle_rad: Array

    @property
    def depth_mm(self) -> Array:
        """Length of the rod beyond the contact."""
        return self.rod.length_mm - self.arc_mm

    def moment(self, from_tip_mm: float) -> Array:
        """Bending moment (n,), mN mm, at a distance from the tip along the rod; zero beyond the contact."""
        back = (from_tip_mm - self.depth_mm).clip(0.0)
        if not self.rod.exact:
            return self.force_mn * back
        rate = np.sqrt(self.force_mn / self.rod.stiffness_mn_mm2)
        return self.rod.stiffness_mn_mm2 * rate * curve().curvature(back * rate)

    def tip(self) -> tuple[Array, Array]:
        """Place of the tip across the clamp's axis and along it, measured from the unbent tip, mm."""
        d = self.depth_mm
        if not self.rod.exact:
            return self.across_mm + self.angle_rad * d, np.zeros(len(d))
        across = self.across_mm + d * np.sin(self.angle_rad)
        return across, self.along_mm + d * np.cos(self.angle_rad) - self.rod.length_mm


@dataclass(frozen=True)
class Rod:
    """A straight rod; ``exact`` bends as the elastica, otherwise as a cantilever by small angles."""

    length_mm: float = 60.0
    stiffness_mn_mm2: float = 1.13e6
    exact: bool = True

    def under(self, force_mn: Array, arc_mm: Array) -> Bent:
        """Under an edge that pushes with a force (n,) across the rod at an arc (n,) from the clamp."""
        if not self.exact:
            bend = force_mn * arc_mm**2 / self.stiffness_mn_mm2
            return Bent(self, force_mn, arc_mm, bend * arc_mm / 3.0, arc_mm, bend / 2.0)
        c, p = curve(), force_mn * arc_mm**2 / self.stiffness_mn_mm2
        if not (p <= _FARTHEST**2).all():
            raise ValueError(f"a rod bent by more than {float(c.angle(_FARTHEST**2)):.2f} rad")
        return Bent(self, force_mn, arc_mm, arc_mm * c.lateral(p), arc_mm * c.axial(p), c.angle(p))

    def loaded(self, lateral_mn: Array, depth_mm: Array) -> Bent:
        """Under an edge whose force has this part (n,) across the clamp's axis, this far (n,) from the tip."""
        arc = self.length_mm - depth_mm
        force = lateral_mn
        for _ in range(40 if self.exact else 0):
            force = lateral_mn / np.cos(self.under(force, arc).angle_rad)
        return self.under(force, arc)

    def pressed(self, along_mm: Array, push_mm: Array, hole_mn_mm: float) -> Bent:
        """By a hole whose edge stands ``along_mm`` (n,) from the clamp and would, were it stiff, push the shaft
        ``push_mm`` (n,) off its axis (0: none); it gives way across the axis with a stiffness."""
        push = push_mm.clip(0.0)
        arc = along_mm
        force = push / (1.0 / hole_mn_mm + arc**3 / (3.0 * self.stiffness_mn_mm2))
        if not self.exact:
            return self.under(force, arc)
        c, p = curve(), force * arc**2 / self.stiffness_mn_mm2

        def left(p: Array) -> tuple[Array, Array, Array]:
            arc = along_mm / c.axial(p)
            force = p * self.stiffness_mn_mm2 / arc**2
            return force * np.cos(c.angle(p)) / hole_mn_mm + arc * c.lateral(p) - push, force, arc

        for _ in range(30):
            here, _, _ = left(p)
            slope = (left(p + 1e-6)[0] - here) / 1e-6
            p = (p - here / slope).clip(0.0, _FARTHEST**2 - 1e-5)
        miss, force, arc = left(p)
        if not (np.abs(miss) < 1e-9).all():
            raise ValueError(f"no balance of rod and hole: {np.abs(miss).max():.2g} mm left")
        return self.under(force, arc)
