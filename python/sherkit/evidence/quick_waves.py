"""Waves in time quicker than those that are tried: a cooler that switches, a pump, a mount that swings.

Too many to try all: the one that takes most of what is left is found by a periodogram of all rows (Scargle, ApJ 1982),
times put on a grid much finer than they lie, and is tried beside the others as what it is, the best of so many.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from ..model.effect import Effect
from .base import Base
from .blocks import Block
from .made import Maker, waves_in_time
from .thresholds import ACCIDENT

#: Cells of the grid for each row, and how many there are at most.
_CELLS, _MOST = 8, 1 << 20


@dataclass(frozen=True, eq=False)
class QuickWave:
    """A wave in time of ``count`` waves over a run of ``length`` s, the best of exp(``ways``) that were looked at."""

    count: float
    length: float
    ways: float
    effect: Effect | None = None

    def add_to(self, made: Maker) -> None:
        """Adds its block."""
        time, m = made.view.time, made.view.axes
        assert time is not None, "a wave in time"
        angle = 2.0 * np.pi * self.count * (time - time.min()) / self.length
        part = made.waves(angle, np.ones(1), np.ones((len(time), 1)))
        both = [(part, k * m + np.arange(m)) for k in (0, 1)]
        made.on_axes("periodic", ("time_s",), both, period=self.length / self.count, ways=self.ways)

    def is_shape(self, block: Block) -> bool:
        """None of the others is one of these."""
        del block
        return False


def quick_wave_of(base: Base) -> QuickWave | None:
    """The quickest wave in time that takes more of what a base leaves than chance does; None where there is none, or
    rows have no time."""
    run = base.family.run
    time, tried = run.view.time, float(waves_in_time()[-1])
    if time is None or len(run) < 2 * tried or not np.ptp(time) > 0:
        return None
    length, steps = float(np.ptp(time)), np.diff(np.sort(time))
    # as quick as rows follow each other where many follow at once
    most = 0.5 * length / max(float(np.median(steps[steps > 0])), 1e-300)
    cells = min(int(_CELLS * most), _MOST)
    left = base.residual.reshape(len(run), run.axes)
    at = np.minimum(((time - time.min()) / length * cells).astype(np.int64), cells - 1)
    # half waves apart
    on_grid = np.stack([np.bincount(at, one, cells) for one in (left - left.mean(axis=0)).T])
    power = np.square(np.abs(np.fft.rfft(on_grid, 2 * cells))).sum(axis=0)
    counts = 0.5 * np.arange(len(power))
    asked = (counts > tried) & (counts < min(most, cells / 4))
    if not asked.any():
        return None
    best = int(np.argmax(np.where(asked, power, -np.inf)))
    takes = 2.0 * float(power[best]) / (len(run) * max(base.rss / base.free, 1e-300))
    chance = int(asked.sum()) * float(scipy.special.chdtrc(2 * run.axes, takes))
    return QuickWave(float(counts[best]), length, float(np.log(asked.sum()))) if chance < ACCIDENT else None
