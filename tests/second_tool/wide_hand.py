"""A hand that guides the needle: strokes into the hole, leaning on it, pauses in which it is not touched, and tremor.

Everything is said by the hole in the tool's frame, (u, -l): u off the unbent axis, l along it; and by how the tool is
turned. Where the tool goes in the base follows from that (:mod:`.wide`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from .motion import smooth
from .wide_rod import RoughRod, Tissue

Array = NDArray[np.float64]

#: Nobody leans further off the hole than this, mm at size 1, and at size 1 these are the largest bend and force.
LEAN_MM, BEND_MM, FORCE_MN = 10.0, 10.0, 300.0
_MARGIN = 0.97
_SHALLOWEST_MM = 0.3


def _nothing(deep_mm: Array) -> Array:
    return np.zeros(len(deep_mm))


@dataclass(frozen=True)
class Led:
    """Rows (n,) of a plan. ``off_mm`` (n, 2) and ``deep_mm``: the hole in the tool's frame as the hand means it;
    ``trembling_mm`` (n, 3): the tool's own place by its tremor, in its frame; ``turn_rad`` (n, 3) with tremor.
    ``there``: rows with something to touch. A tool that ``enters`` turns about a hole; one that does not goes its own
    way, ``shift_mm`` (n, 3) in the base, and a needle comes from ``side`` (n, 2). What is touched: ``clearance_mm``,
    ``tissue``, and ``most_mm``, how far it may push at a depth."""

    off_mm: Array
    deep_mm: Array
    trembling_mm: Array
    turn_rad: Array
    there: NDArray[np.bool_]
    shift_mm: Array
    side: Array
    enters: bool
    clearance_mm: float = 0.0
    tissue: Tissue = field(default_factory=lambda: Tissue(1000.0))
    most_mm: Callable[[Array], Array] = _nothing

    def within(self, clearance_mm: float, tissue: Tissue, most_mm: Callable[[Array], Array]) -> Led:
        """With leans in mm, that stood as shares of the largest."""
        lean = self.off_mm * (clearance_mm + most_mm(self.deep_mm))[:, None]
        return replace(self, off_mm=lean, clearance_mm=clearance_mm, tissue=tissue, most_mm=most_mm)


@dataclass(frozen=True)
class Hand:
    """``pivot_rad`` and ``roll_rad``: largest turn about the hole across the shaft and on it; ``tremor_mm`` and
    ``shake_rad``: rms of its place and turn."""

    pivot_rad: float
    roll_rad: float
    tremor_mm: float
    shake_rad: float

    def enters(self, t: Array, rng: np.random.Generator, start_mm: float, clearance_mm: float, *, wide: bool) -> Led:
        """Into a hole, from ``start_mm``. ``off_mm`` is yet a share (n, 2) of the largest lean, at most 1 long."""
        if wide:
            deep = _strokes(t, rng, start_mm, (14.0, 25.0), (3.0, 6.0), first_s=5.0)
            share = _swings(t, rng, 0.8) * ease(t / 6.0)[:, None]
        else:
            deep = _strokes(t, rng, start_mm, (1.0, 25.0), (4.0, 9.0), first_s=6.0)
            share = _swings(t, rng, 0.7)
        firm = _pauses(t, rng)
        trembling = tremor(t, rng, self.tremor_mm / np.sqrt(3.0))
        # a hand that rests keeps the shaft off the edge
        quiet = min(1.0, 0.2 * clearance_mm / (self.tremor_mm / np.sqrt(3.0)))
        trembling[:, :2] *= (firm + (1.0 - firm) * quiet)[:, None]
        turn = self._turned(t, rng)
        everywhere, still = np.ones(len(t), dtype=bool), np.zeros((len(t), 3))
        return Led(share * firm[:, None], deep, trembling, turn, everywhere, still, still[:, :2], enters=True)

    def bends(self, t: Array, rng: np.random.Generator) -> Led:
        """Led in free space, stopped and bent by a needle at random places. ``off_mm`` is yet a share, as above."""
        n, times = len(t), 6
        share, side, deep, shift = np.zeros((n, 2)), np.zeros((n, 2)), np.full(n, 10.0), np.zeros((n, 3))
        there, calm = np.zeros(n, dtype=bool), np.ones(n)
        turn, here, turned = np.zeros((n, 3)), np.zeros(3), np.zeros(3)
        # each bend: some way, then a stop of a drawn length
        parts = rng.uniform(0.7, 1.3, 2 * times)
        ends = np.concatenate([[0.0], np.cumsum(parts) / parts.sum() * t[-1]])
        for k in range(times):
            start, stop, end = ends[2 * k : 2 * k + 3]
            go, stay = (t >= start) & (t <= stop), (t > stop) & (t <= end)
            to, aim = rng.uniform(-12.0, 12.0, 3), rng.uniform(-self.pivot_rad, self.pivot_rad, 3)
            moved = ease((t[go] - start) / (stop - start))[:, None]
            shift[go], turn[go] = here + moved * (to - here), turned + moved * (aim - turned)
            shift[stay], turn[stay], here, turned = to, aim, to, aim
            way, strength = rng.uniform(0.0, 2 * np.pi), rng.uniform(0.4, 1.0)
            part = ((t[stay] - stop) / (end - stop) - 0.12) / 0.76
            bump = strength * ease(4.0 * part) * ease(4.0 * (1.0 - part))
            bump *= 1.0 + 0.15 * np.sin(2 * np.pi * rng.uniform(1.0, 3.0) * part + rng.uniform(0.0, 6.0))
            side[stay] = np.cos(way), np.sin(way)
            share[stay] = bump.clip(0.0, 1.0)[:, None] * side[stay]
            deep[stay] = rng.uniform(2.0, 25.0) + rng.uniform(-0.7, 0.7) * ease(part)
            there[stay] = (part > 0.0) & (part < 1.0)
            calm[stay] = 0.2 + 0.8 * np.maximum(ease(1.0 - 10.0 * (part + 0.158)), ease(10.0 * (part - 1.058)))
        trembling = tremor(t, rng, self.tremor_mm / np.sqrt(3.0)) * calm[:, None]
        turn = turn + tremor(t, rng, self.shake_rad / np.sqrt(3.0)) * calm[:, None]
        return Led(share, deep, trembling, turn, there, shift, side, enters=False)

    def free(self, t: Array, rng: np.random.Generator) -> Led:
        """Led around in front of a camera; nothing is touched."""
        n = len(t)
        shift = 12.0 * smooth(t, rng, 1.0, 1.0, 1.0)
        turn = self._turned(t, rng) * 1.5
        nothing = np.zeros(n, dtype=bool)
        trembling, none = tremor(t, rng, self.tremor_mm / np.sqrt(3.0)), np.zeros((n, 2))
        return Led(none, np.zeros(n), trembling, turn, nothing, shift, none, enters=False)

    def _turned(self, t: Array, rng: np.random.Generator) -> Array:
        wave = smooth(t, rng, 1.0, 1.0, 1.0)
        largest = np.array([self.pivot_rad, self.pivot_rad, self.roll_rad])
        return largest * wave / np.abs(wave).max(axis=0) + tremor(t, rng, self.shake_rad / np.sqrt(3.0))


def largest_push(rod: RoughRod, tissue: Tissue, friction: float, size: float, deep_mm: Array) -> Array:
    """How far (n,) the edge may push at depths (n,) along the unbent axis until the bend at the tip, force, lean
    or the length of shaft left beyond the contact is at its limit, with friction either way."""
    deep, most = _limits(rod, tissue, friction, size)
    return np.asarray(_MARGIN * np.minimum(np.interp(deep_mm, deep, most), LEAN_MM * size))


@cache
def _limits(rod: RoughRod, tissue: Tissue, friction: float, size: float) -> tuple[Array, Array]:
    deep = np.linspace(_SHALLOWEST_MM, 30.0, 61)
    force = np.linspace(0.0, FORCE_MN * size, 61)
    at, normal = (v.ravel() for v in np.meshgrid(deep, force, indexing="ij"))
    # more than this bends the rod beyond any limit here
    safe = np.minimum(normal, 0.8 * rod.stiffness_mn_mm2 / (rod.length_mm - at) ** 2)
    most = np.full(len(deep), np.inf)
    for sign in (-1.0, 0.0, 1.0):
        touch = rod.at_axis(safe, at, np.full(len(at), sign * friction), tissue.axial_mn_mm)
        within = (normal == safe) & (np.hypot(*touch.tip()) <= BEND_MM * size)
        within &= np.hypot(touch.pushed_mn, touch.dragged_mn) <= FORCE_MN * size
        within &= touch.arc_mm >= 0.5 * np.minimum(at, _SHALLOWEST_MM)
        within = np.logical_and.accumulate(within.reshape(61, 61), axis=1)
        push = (touch.across_mm + tissue.give(touch.pushed_mn)).reshape(61, 61)
        most = np.minimum(most, np.where(within, push, 0.0).max(axis=1))
    return deep, most


def tremor(t: Array, rng: np.random.Generator, rms: float) -> Array:
    """Of a hand: three axes (n, 3) of 8 to 12 Hz that swell and fade, each of that rms, from rest on."""
    waves = []
    for _ in range(3):
        rate, phase = rng.uniform(8.0, 12.0, 10), rng.uniform(0.0, 2 * np.pi, 10)
        waves.append(np.sin(2 * np.pi * rate * t[:, None] + phase).sum(axis=1) * np.sqrt(2.0 / 10.0) * rms)
    return np.column_stack(waves) * ease(t / 0.5)[:, None]


def ease(part: Array) -> Array:
    """From 0 to 1 without a jerk."""
    s = np.clip(part, 0.0, 1.0)
    return np.asarray(s**3 * (10.0 + s * (6.0 * s - 15.0)))


def _strokes(
    t: Array, rng: np.random.Generator, start_mm: float, range_mm: tuple[float, float], every_s: tuple[float, float],
    first_s: float,
) -> Array:  # fmt: skip
    """Depths from stroke to stroke, with rests between, and a slow unsteadiness."""
    deep, here, at = np.full(len(t), start_mm), start_mm, 0.8
    while at < t[-1]:
        took = first_s if at == 0.8 else rng.uniform(*every_s)
        to = rng.uniform(*range_mm)
        deep += ease((t - at) / (took * rng.uniform(0.6, 1.0))) * (to - here)
        here, at = to, at + took
    unsteady = smooth(t, rng, 0.3)[:, 0]
    low = min(start_mm, 1.0)
    return np.asarray((deep + unsteady).clip(low, 25.0))


def _swings(t: Array, rng: np.random.Generator, size: float) -> Array:
    """A share (n, 2) of the largest lean that changes sides, less than 1 long."""
    wave = smooth(t, rng, size, size)
    length = np.linalg.norm(wave, axis=1, keepdims=True)
    return np.asarray(wave * np.tanh(length) / np.where(length > 0.0, length, 1.0))


def _pauses(t: Array, rng: np.random.Generator) -> Array:
    """1 while the hand leans, 0 in three to five rests of 1 to 4 s, eased within 0.4 s (n,)."""
    count = int(rng.integers(3, 6))
    slot = t[-1] / count
    firm = np.ones(len(t))
    for k in range(count):
        rest = min(rng.uniform(1.0, 4.0), 0.5 * slot)
        at = k * slot + rng.uniform(0.4, max(0.41, slot - rest - 0.4))
        firm = np.minimum(firm, 1.0 - ease((t - at + 0.4) / 0.4) * ease((at + rest + 0.4 - t) / 0.4))
    return firm
