"""A plate that is not flat: long waves, of another family than any polynomial."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Plate:
    """Waves over a plate: ``wave`` (k, 2) rad/mm, ``phase`` (k,), ``height`` (k,) mm; ``turned_deg`` anticlockwise."""

    wave: Floats
    phase: Floats
    height: Floats
    turned_deg: float = 0.0

    @classmethod
    def flat(cls) -> Plate:
        """One without any."""
        return cls(np.zeros((1, 2)), np.zeros(1), np.zeros(1))

    @classmethod
    def bent(cls, seed: int, radius: float, valley_to_peak: float, shortest: float = 1.3) -> Plate:
        """Three waves, none of them shorter than ``shortest`` diameters."""
        rng = np.random.default_rng(seed)
        turn, length = rng.uniform(0, 2 * np.pi, 3), 2 * radius * rng.uniform(shortest, 2.5, 3)
        wave = (2 * np.pi / length)[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=1)
        made = cls(wave, rng.uniform(0, 2 * np.pi, 3), rng.uniform(0.5, 1.0, 3))
        ticks = np.linspace(-radius, radius, 41)
        grid = np.stack(np.meshgrid(ticks, ticks), axis=-1).reshape(-1, 2)
        grid = grid[np.hypot(*grid.T) <= radius]
        z = made.at(grid)
        # what a plane takes out is no bend
        plane = np.column_stack([np.ones(len(grid)), grid])
        left = z - plane @ np.linalg.lstsq(plane, z, rcond=None)[0]
        return cls(made.wave, made.phase, made.height * valley_to_peak / np.ptp(left))

    def turned(self, degrees: float) -> Plate:
        """The same plate turned."""
        return Plate(self.wave, self.phase, self.height, degrees)

    def at(self, xy: Floats) -> Floats:
        """Heights (n,) at places (n, 2) of the machine, mm."""
        t = np.deg2rad(self.turned_deg)
        own = xy @ np.array([[np.cos(t), -np.sin(t)], [np.sin(t), np.cos(t)]])
        return (self.height * np.sin(own @ self.wave.T + self.phase)).sum(axis=1)
