"""Worlds that nobody who wrote the filter had in mind: each family does one thing otherwise than :mod:`.wide`.

What is drawn besides comes from the seed. The bench is that of a sound tool, unless a family says that it is not.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from .wide import Hole, Led, Wide
from .wide_hand import ease
from .wide_rod import RoughRod, Touch

Array = NDArray[np.float64]
_HZ = 200.0
#: A bench gives a load every so many seconds.
_LOAD_S = 5.0


def creeping(bending: Array, share: Array, per_step: float) -> Array:
    """Fibres (n, 9) of which a share (9,) follows late: by this part of what is left in each step."""
    keeps = 1.0 - per_step
    late = lfilter([per_step], [1.0, -keeps], bending, axis=0, zi=(keeps * bending[:1]))[0]
    return np.asarray(bending + share * (late - bending))


def sticking(bending: Array, share: Array) -> Array:
    """Fibres (n, 9) in glue with play: the ways up and down lie a share (9,) of the largest bend apart (Prandtl)."""
    width = 0.5 * share * np.abs(bending).max()
    shown, out = bending[0].copy(), np.empty_like(bending)
    for i, row in enumerate(bending):
        shown = np.clip(shown, row - width, row + width)
        out[i] = shown
    return out


@dataclass(frozen=True)
class Family(Wide):
    """``along``: the share of its motion by which the shaft takes the hole along, which comes back within
    ``comes_back_s``. ``lag``: how much fibres lag, over the bend (each grating by 0.4 to 1.6 times that), by creeping
    glue in even seeds, by play in odd ones; ``bench_lags``: on the bench too. ``second_mn``: largest force of a touch
    at the tip. ``drifts``: kelvin a minute, and how far gratings differ, K. ``late_s`` (two, between which is drawn):
    the robot's rows show where it was so long ago. ``outwards``: how much softer the tissue is on one side.
    ``softer``: by how much the tool bends more than on the bench for the same moment. ``missing``: share of the rows
    without wavelengths. ``aside_mm``: how far (RMS, a coordinate) the eye drifts across the shaft, in 7 to 24 s."""

    along: float = 0.0
    lag: float = 0.0
    bench_lags: bool = False
    second_mn: float = 0.0
    drifts: tuple[float, float] = (0.0, 0.0)
    late_s: tuple[float, float] = (0.0, 0.0)
    outwards: float = 1.0
    softer: float = 0.0
    missing: float = 0.0
    aside_mm: float = 0.0

    def bench(self, *, loads: int = 80, unloaded: int = 20) -> dict[str, Array]:
        """As the sound tool's; where it lags as well, by what stood on it before each row."""
        table = super().bench(loads=loads, unloaded=unloaded)
        if not self.bench_lags:
            return table
        names = [f"fbg{k + 1}_nm" for k in range(9)]
        bent = np.column_stack([table[n] for n in names]) - self.drawn.glass.rest_nm
        shown = self._lag(bent, _LOAD_S)
        return table | {n: table[n] + shown[:, k] - bent[:, k] for k, n in enumerate(names)}

    def _lag(self, bending: Array, step_s: float) -> Array:
        rng = self._rng("lag")
        share, within_s = self.lag * rng.uniform(0.4, 1.6, 9), rng.uniform(2.0, 8.0)
        if self.seed % 2:
            return sticking(bending, share)
        return creeping(bending, share, 1.0 - float(np.exp(-step_s / within_s)))

    def _lagged(self, t: Array, bending_nm: Array) -> Array:
        return self._lag(bending_nm, 1.0 / _HZ) if self.lag else bending_nm

    def _strayed(self, t: Array, turn: Rotation, led: Led, rng: np.random.Generator) -> tuple[Array, Array]:
        strayed, slack = super()._strayed(t, turn, led, rng)
        if self.along and led.enters:
            drawn = self._rng("along")
            share, within_s = self.along * drawn.uniform(0.5, 1.0), drawn.uniform(2.0, 6.0)
            deep = gaussian_filter1d(led.deep_mm, 0.05 * _HZ, mode="nearest")
            gone = share * (deep - creeping(deep[:, None], np.ones(1), 1.0 / within_s / _HZ)[:, 0])
            strayed, slack = strayed + gone[:, None] * turn.as_matrix()[:, :, 2], slack + gone
        if self.aside_mm and led.enters:
            drawn, shaft = self._rng("aside"), turn.as_matrix()[:, :, 2]
            waves = np.sin(2 * np.pi * (t[:, None, None] / drawn.uniform(7.0, 24.0, (3, 4)) + drawn.random((3, 4))))
            gone = self.aside_mm * (waves * drawn.standard_normal((3, 4)) / np.sqrt(2.0)).sum(axis=2)
            gone -= (gone @ shaft[0])[:, None] * shaft[0]
            strayed, slack = strayed + gone, slack + np.einsum("ni,ni->n", gone, shaft)
        return strayed, slack

    def _second(self, t: Array, hole: Hole) -> Array:
        force = np.zeros((len(t), 2))
        rng, at = self._rng("second"), 4.0
        while self.second_mn and at < t[-1] - 3.0:
            lasts, angle, size = rng.uniform(1.0, 4.0), rng.uniform(0.0, 2 * np.pi), rng.uniform(0.4, 1.0)
            bump = ease((t - at) / 0.3) * ease((at + lasts - t) / 0.3)
            force += self.second_mn * size * bump[:, None] * np.array([np.cos(angle), np.sin(angle)])
            at += lasts + rng.uniform(1.0, 5.0)
        # what stands before the tip is met deep in the eye
        return np.asarray(force * ease((gaussian_filter1d(hole.l_mm, 20.0) - 8.0) / 2.0)[:, None])

    def _touch(self, hole: Hole, friction: Array) -> Touch:
        rod, soft = self.drawn.rod, replace(hole.tissue, lateral_mn_mm=hole.tissue.lateral_mn_mm / self.outwards)
        if self.softer:
            rod = RoughRod(rod.length_mm, rod.stiffness_mn_mm2 * (1.0 - self.softer))
        touch = rod.in_hole(hole.l_mm, hole.push_mm, hole.tissue, friction)
        if self.outwards == 1.0:
            return touch
        angle = self._rng("outwards").uniform(0.0, 2 * np.pi)
        out = hole.way @ np.array([np.cos(angle), np.sin(angle)]) > 0.0
        other = rod.in_hole(hole.l_mm, hole.push_mm, soft, friction)
        both = {
            k: np.where(out, getattr(other, k), getattr(touch, k)) for k in touch.__dataclass_fields__ if k != "rod"
        }
        return Touch(rod, **both)

    def _warmed(self, t: Array) -> Array:
        per_minute, unlike = self.drifts
        rng = self._rng("drifts")
        rate, phase = rng.uniform(1 / 80.0, 1 / 20.0, 9), rng.uniform(0.0, 2 * np.pi, 9)
        own = unlike * np.sqrt(2.0) * np.sin(2 * np.pi * rate * t[:, None] + phase)
        return np.asarray((per_minute / 60.0 * t[:, None] + own) * self.drawn.glass.warmth_nm_k)

    def _told(self, t: Array, place: Array, turn: Rotation) -> tuple[Array, Array]:
        rows = np.column_stack([place, turn.as_rotvec()])
        then = t - self._rng("late").uniform(*self.late_s)
        rows = np.column_stack([np.interp(then, t, row) for row in rows.T])
        return rows[:, :3], rows[:, 3:]

    def _kept(self, t: Array, waves: Array) -> Array:
        lost = self._rng("missing").random(len(t)) < self.missing
        return np.where(lost[:, None], np.nan, waves)


#: A world of each by its seed.
FAMILIES: dict[str, Callable[[int], Wide]] = {
    "sound": Wide,
    "strays": lambda seed: Wide(seed, wander_mm2_s=0.02),
    "goes along": lambda seed: Family(seed, along=0.12),
    "lags 0.5 %": lambda seed: Family(seed, lag=0.005),
    "lags 1 %": lambda seed: Family(seed, lag=0.01),
    "lags 2 %": lambda seed: Family(seed, lag=0.02),
    "lags 4 %": lambda seed: Family(seed, lag=0.04),
    "lags 2 %, bench too": lambda seed: Family(seed, lag=0.02, bench_lags=True),
    "lags 4 %, bench too": lambda seed: Family(seed, lag=0.04, bench_lags=True),
    "second touch": lambda seed: Family(seed, second_mn=8.0),
    "drifts": lambda seed: Family(seed, drifts=(0.5, 0.1)),
    "robot late": lambda seed: Family(seed, late_s=(0.02, 0.08)),
    "softer outwards": lambda seed: Family(seed, outwards=5.0),
    "softer tool": lambda seed: Family(seed, softer=0.08),
    "drifts across": lambda seed: Family(seed, aside_mm=0.3),
    "rows missing": lambda seed: Family(seed, missing=0.05),
}
