"""A clamped rod that a rough edge pushes: the exact elastica with friction at the contact, and its balance with tissue.

The edge pushes with N across the shaft at the contact and drags it with T = m N along it (m > 0: towards the tip, as
while the tool is drawn out). Both are the same everywhere between contact and clamp. With sigma the arc from the
contact back to the clamp, phi the angle turned on it, and x, y the place in the frame of the contact,

    M = N x + T y,    EI phi'' = N cos(phi) + T sin(phi),    phi(0) = phi'(0) = 0.

In tau = sigma sqrt(N / EI) only m is left. The curve is integrated for a few m and is a polynomial between them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

Array = NDArray[np.float64]

_FARTHEST = 1.5  # of tau: an angle of a radian
_ROUGHEST = 0.2
_NODES = _ROUGHEST * np.cos(np.pi * (2 * np.arange(7) + 1) / 14)
#: Of a polynomial through the nodes, by barycentric weights.
_WEIGHTS = 1.0 / np.array([np.prod(a - np.delete(_NODES, k)) for k, a in enumerate(_NODES)])


@cache
def _curves() -> tuple[CubicSpline, CubicSpline]:
    """By p = a² N / EI for each node: axial and lateral place per arc, and angle of the contact seen from the clamp,
    (nodes, 3). By tau for each node: phi', (nodes,)."""
    p, tau = np.linspace(0.0, _FARTHEST**2, 1501), np.linspace(0.0, _FARTHEST, 1501)
    seen, curvature = [], []
    for m in _NODES:
        made = solve_ivp(
            lambda _, y, m=m: [y[1], np.cos(y[0]) + m * np.sin(y[0]), np.cos(y[0]), np.sin(y[0])],
            (0.0, _FARTHEST), [0.0] * 4, rtol=1e-12, atol=1e-14, method="DOP853", dense_output=True,
        )  # fmt: skip
        phi, _, x, y = made.sol(np.sqrt(p))
        arc = np.where(p > 0.0, np.sqrt(p), 1.0)
        axial, lateral = (x * np.cos(phi) + y * np.sin(phi)) / arc, (x * np.sin(phi) - y * np.cos(phi)) / arc
        axial[0] = 1.0
        seen.append(np.column_stack([axial, lateral, phi]))
        curvature.append(made.sol(tau)[1])
    return CubicSpline(p, np.stack(seen, axis=1)), CubicSpline(tau, np.stack(curvature, axis=1))


def _shares(m: Array) -> Array:
    """How much of each node (n, nodes) is in the curve of a friction (n,)."""
    off = m[:, None] - _NODES
    off = np.where(np.abs(off) < 1e-14, 1e-14, off)
    shares = _WEIGHTS / off
    return np.asarray(shares / shares.sum(axis=1, keepdims=True))


@dataclass(frozen=True)
class Tissue:
    """What holds the edge: gives way across the shaft by ``F0 / k asinh(F / F0)``, along it by F / (ratio k).

    ``lateral_mn_mm`` k, ``axial_ratio``, ``hardens_at_mn`` F0: beyond it the tissue is much stiffer than at rest."""

    lateral_mn_mm: float
    axial_ratio: float = 7.0
    hardens_at_mn: float = 1e9

    def give(self, force_mn: Array) -> Array:
        """Across the shaft, mm, under a force (n,)."""
        return np.asarray(self.hardens_at_mn / self.lateral_mn_mm * np.arcsinh(force_mn / self.hardens_at_mn))

    @property
    def axial_mn_mm(self) -> float:
        return self.axial_ratio * self.lateral_mn_mm


@dataclass(frozen=True)
class Touch:
    """A rod under a rough edge, rows (n,). Force ``normal_mn`` N across the shaft at the contact, ``friction`` T / N
    (positive: drags the shaft to the tip); ``reach_mm`` arc from the clamp to the contact; the contact's place
    ``across_mm`` and ``along_mm`` the clamp's axis, and the shaft's ``angle_rad`` there."""

    rod: RoughRod
    normal_mn: Array
    friction: Array
    reach_mm: Array
    across_mm: Array
    along_mm: Array
    angle_rad: Array

    @property
    def arc_mm(self) -> Array:
        """Length of the shaft beyond the contact."""
        return self.rod.length_mm - self.reach_mm

    @property
    def pushed_mn(self) -> Array:
        """Force on the shaft across the clamp's axis."""
        return np.asarray(self.normal_mn * (np.cos(self.angle_rad) + self.friction * np.sin(self.angle_rad)))

    @property
    def dragged_mn(self) -> Array:
        """Force on the shaft along the clamp's axis, positive to the tip."""
        return np.asarray(self.normal_mn * (self.friction * np.cos(self.angle_rad) - np.sin(self.angle_rad)))

    def moment(self, from_tip_mm: float) -> Array:
        """Bending moment (n,), mN mm, at a place this far from the tip along the shaft; zero beyond the contact."""
        rate = np.sqrt(self.normal_mn / self.rod.stiffness_mn_mm2)
        curvature = _curves()[1](rate * (from_tip_mm - self.arc_mm).clip(0.0))
        return np.asarray(self.rod.stiffness_mn_mm2 * rate * (curvature * _shares(self.friction)).sum(axis=1))

    def tip(self) -> tuple[Array, Array]:
        """Place of the tip across the clamp's axis and along it, from the unbent tip, mm."""
        across = self.across_mm + self.arc_mm * np.sin(self.angle_rad)
        return across, self.along_mm + self.arc_mm * np.cos(self.angle_rad) - self.rod.length_mm


@dataclass(frozen=True)
class RoughRod:
    """A straight rod: free length, mm, and bending stiffness EI, mN mm²."""

    length_mm: float
    stiffness_mn_mm2: float

    def under(self, normal_mn: Array, reach_mm: Array, friction: Array) -> Touch:
        """Under an edge that pushes with N (n,) at an arc (n,) from the clamp and drags with ``friction`` N (n,)."""
        p = normal_mn * reach_mm**2 / self.stiffness_mn_mm2
        if not (p <= _FARTHEST**2).all():
            raise ValueError("a rod bent by more than a radian")
        axial, lateral, angle = self._seen(p, _shares(friction))
        return Touch(self, normal_mn, friction, reach_mm, reach_mm * lateral, reach_mm * axial, angle)

    def in_hole(self, depth_mm: Array, push_mm: Array, tissue: Tissue, friction: Array) -> Touch:
        """In a hole that at rest stands ``depth_mm`` (n,) from the unbent tip along the unbent axis, and whose edge
        would push the shaft ``push_mm`` (n,) off its axis were the tissue stiff (0 or less: untouched)."""
        on = np.flatnonzero(push_mm > 0.0)
        reach, normal = self.length_mm - depth_mm, np.zeros(len(depth_mm))
        reach[on], normal[on] = self._balanced(reach[on], push_mm[on], tissue, friction[on])
        return self.under(normal, reach, friction)

    def at_axis(self, normal_mn: Array, depth_mm: Array, friction: Array, axial_mn_mm: float = np.inf) -> Touch:
        """Under N at a place this far from the unbent tip along the unbent axis, which gives along it as said."""
        touch = self.under(normal_mn, self.length_mm - depth_mm, friction)
        for _ in range(60):
            along = self.length_mm - depth_mm - touch.dragged_mn / axial_mn_mm
            touch = self.under(normal_mn, touch.reach_mm + along - touch.along_mm, friction)
        return touch

    def _seen(self, p: Array, shares: Array) -> Array:
        """Axial and lateral place per arc and angle (3, n) of the contact."""
        return np.asarray(np.einsum("nkj,nk->jn", _curves()[0](p), shares))

    def _balanced(self, along: Array, push: Array, tissue: Tissue, friction: Array) -> tuple[Array, Array]:
        """Arc of the contact and N where rod and tissue give the same force: Newton's steps in p."""
        shares, ei = _shares(friction), self.stiffness_mn_mm2

        def left(p: Array, reach: Array) -> tuple[Array, Array, Array]:
            axial, lateral, angle = self._seen(p, shares)
            cos, sin = np.cos(angle), np.sin(angle)
            for _ in range(6):
                dragged = p * ei / reach**2 * (friction * cos - sin)
                reach = (along - dragged / tissue.axial_mn_mm) / axial
            normal = p * ei / reach**2
            return reach * lateral + tissue.give(normal * (cos + friction * sin)) - push, reach, normal

        p = push * along**2 / ei / (1.0 / tissue.lateral_mn_mm + along**3 / (3.0 * ei))
        p, reach = p.clip(0.0, 0.9 * _FARTHEST**2), along
        miss, reach, normal = left(p, reach)
        for _ in range(40):
            if (np.abs(miss) < 1e-11).all():
                break
            slope = (left(p + 1e-6, reach)[0] - miss) / 1e-6
            p = (p - miss / slope).clip(0.0, _FARTHEST**2 - 1e-5)
            miss, reach, normal = left(p, reach)
        if not (np.abs(miss) < 1e-9).all():
            raise ValueError(f"no balance of rod and tissue: {np.abs(miss).max():.2g} mm left")
        return reach, normal
