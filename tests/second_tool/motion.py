"""How the robot leads the tool in each experiment."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]

EXPERIMENTS = ("phantom", "vessels", "bends", "free", "warm_up")
#: How deep the tool stands at the start of a run that enters the eye, mm.
START_MM = 1.0


@dataclass(frozen=True)
class Motion:
    """Unbent tip ``place_mm`` (n, 3) and ``turn_rad`` (n, 3); the hole as planned in the tool's frame, ``hole_mm``
    (n, 3). ``touched``: there is a hole; ``held``: it goes with the tool, as a needle that bends the stopped one."""

    place_mm: Array
    turn_rad: Array
    hole_mm: Array
    clearance_mm: float
    touched: bool = True
    held: bool = False


def path_of(experiment: str, t: Array, rng: np.random.Generator, pivot_rad: float) -> Motion:
    """Of an experiment by name."""
    if experiment == "phantom":
        inside = START_MM + 11.0 * (1 - np.cos(2 * np.pi * t / (t[-1] / 3)))
        lean = _lean(t, rng, 2.0)
        # pauses in which the shaft stands free in its hole
        lean *= np.clip(1.6 * np.sin(2 * np.pi * t / (t[-1] / 7.3)) + 0.35, 0.0, 1.0)[:, None]
        return _about_the_hole(t, rng, inside, lean, pivot_rad, 0.05)
    if experiment == "vessels":
        inside = START_MM + (18.0 + smooth(t, rng, 2.0)[:, 0]) * _ease(t / (0.12 * t[-1]))
        lean = _lean(t, rng, 3.5) * _ease(t / (0.15 * t[-1]))[:, None]
        return _about_the_hole(t, rng, inside, lean, pivot_rad, 2.2)
    if experiment == "bends":
        return _bends(t, rng)
    still = np.zeros((len(t), 3))
    if experiment == "free":
        return Motion(smooth(t, rng, 15.0, 15.0, 15.0), smooth(t, rng, 0.3, 0.3, 0.06), still, 0.0, touched=False)
    if experiment == "warm_up":
        return Motion(still, still, still, 0.0, touched=False)
    raise ValueError(f"experiment: '{experiment}' is none of {EXPERIMENTS}")


def smooth(t: Array, rng: np.random.Generator, *sizes: float) -> Array:
    """Smooth random motions (n, k) of these sizes: six sines of 0.05 to 0.5 Hz that start at zero."""
    out = []
    for size in sizes:
        rate, weight = 2 * np.pi * rng.uniform(0.05, 0.5, 6), rng.standard_normal(6)
        phase = rng.uniform(0, 2 * np.pi, 6)
        wave = (weight[:, None] * (np.sin(rate[:, None] * t + phase[:, None]) - np.sin(phase)[:, None])).sum(axis=0)
        out.append(size * wave / np.sqrt(6.0))
    return np.column_stack(out)


def _lean(t: Array, rng: np.random.Generator, size: float) -> Array:
    """Off the hole (n, 2), held to 5 mm: nobody leans harder on an eye."""
    lean = smooth(t, rng, size, size)
    length = np.linalg.norm(lean, axis=1, keepdims=True)
    return np.asarray(lean * np.tanh(length / 5.0) * 5.0 / np.where(length > 0, length, 1.0))


def _about_the_hole(
    t: Array, rng: np.random.Generator, inside: Array, lean: Array, pivot_rad: float, clearance_mm: float
) -> Motion:  # fmt: skip
    """The tool turns about the hole, which stands in the base's origin where nothing moves it."""
    turn = smooth(t, rng, pivot_rad, pivot_rad, pivot_rad / 5.0)
    hole = np.column_stack([lean, -inside])
    return Motion(-Rotation.from_rotvec(turn).apply(hole), turn, hole, clearance_mm)


def _bends(t: Array, rng: np.random.Generator) -> Motion:
    """Led in free space, stopped, and bent six times from random places of the shaft."""
    bends = 6
    place, hole = np.zeros((len(t), 3)), np.zeros((len(t), 3))
    ends = np.linspace(0.0, t[-1], 2 * bends + 1)
    here = np.zeros(3)
    for k in range(bends):
        go = (t >= ends[2 * k]) & (t <= ends[2 * k + 1])
        stay = (t > ends[2 * k + 1]) & (t <= ends[2 * k + 2])
        there = rng.uniform(-12.0, 12.0, 3)
        place[go] = here + _ease((t[go] - ends[2 * k]) / (ends[2 * k + 1] - ends[2 * k]))[:, None] * (there - here)
        place[stay], here = there, there
        way, push = rng.uniform(0.0, 2 * np.pi), rng.uniform(3.0, 7.0)
        hole[go | stay, 2] = -rng.uniform(6.0, 26.0)
        share = ((t[stay] - ends[2 * k + 1]) / (ends[1] - ends[0]) - 0.12) / 0.76
        bump = push * np.sin(np.pi * share.clip(0.0, 1.0)) ** 2
        hole[stay, :2] = bump[:, None] * np.array([np.cos(way), np.sin(way)])
    return Motion(place, np.zeros((len(t), 3)), hole, 0.0, held=True)


def _ease(share: Array) -> Array:
    s = np.clip(share, 0.0, 1.0)
    return np.asarray(s * s * (3.0 - 2.0 * s))
