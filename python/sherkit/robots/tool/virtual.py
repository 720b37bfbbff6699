"""A virtual tool in the paper's three experiments: true beam mechanics under a contact that comes and goes.

Written apart from the core on purpose: the contact's force comes from the balance of shaft, hole and clearance, bending
from the cantilever's formulas written out here, wavelengths from the curvature at each fibre. Nothing of the filters is
used.

Where the hole's centre stands u off the unbent shaft (tool frame, across it), the clearance is c and the hole gives way
with stiffness k, the shaft bends by w at the contact with F = k (|u| - c - w) = 3EI w / a³: so F = (|u| - c) / (1/k +
a³/3EI) along u where |u| > c, and nothing otherwise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...base import linalg
from ...base.types import Floats
from ...errors import ShapeError
from .calibration import Loads
from .runs import ToolRun
from .tool import FlexibleTool, rotation_of

EXPERIMENTS = ("phantom", "bends", "vessels")
_ROBOT_HZ, _CAMERA_HZ = 200.0, 15.0


@dataclass(frozen=True)
class VirtualTool:
    """A tool that may be another than its file says.

    ``tool`` is what the file says; ``true`` the tool in the world (the same if left out). ``noise_nm`` is that of a
    wavelength, ``camera_mm`` of a place, ``camera_warp_mm`` the size of the camera's smooth errors over its field,
    ``temperature_c`` the slow drift of the eye's warmth (all fibres alike, 10 pm/°C), ``wander_mm2_s`` how fast the
    hole strays along the shaft, as an eye does, ``hole_mn_mm`` its stiffness. ``bias_nm`` (6,) is how far the
    wavelengths of sections I and II have crept, ``leak`` (6,) how much more each fibre answers to warmth,
    ``hysteresis_mn`` how far what the gratings feel lags behind the force, ``shaft_bend_mm`` (2,) the tip of the
    unloaded tool, ``lost`` the share of wavelengths lost on the way.
    """

    tool: FlexibleTool
    true: FlexibleTool | None = None
    noise_nm: float = 1e-3
    camera_mm: float = 0.2
    camera_warp_mm: float = 0.25
    temperature_c: float = 1.0
    wander_mm2_s: float = 0.004
    hole_mn_mm: float = 150.0
    bias_nm: tuple[float, ...] = (0.0,) * 6
    leak: tuple[float, ...] = (0.0,) * 6
    hysteresis_mn: float = 0.0
    shaft_bend_mm: tuple[float, float] = (0.0, 0.0)
    lost: float = 0.0

    def run(self, experiment: str, *, seconds: float = 60.0, seed: int = 0) -> ToolRun:
        """One of the paper's experiments, 200 Hz and 15 Hz: ``"phantom"`` (depth, a hole in rubber), ``"bends"`` (free
        space, a needle bends the stopped tool six times), ``"vessels"`` (a 5 mm hole, the tip follows vessels).

        Raises :class:`~sherkit.errors.ShapeError` for another name or no time.
        """
        if experiment not in EXPERIMENTS:
            raise ShapeError(f"experiment: '{experiment}' is not known; choose {', '.join(EXPERIMENTS)}")
        if not seconds >= 2.0:
            raise ShapeError(f"seconds: expected 2 or more, got {seconds:g}")
        rng = np.random.default_rng([seed, EXPERIMENTS.index(experiment)])
        t = np.arange(round(seconds * _ROBOT_HZ) + 1) / _ROBOT_HZ
        make = {"phantom": self._phantom, "bends": self._bends, "vessels": self._vessels}[experiment]
        position, turn, depth, offset, clearance = make(t, rng)
        force, arc = self._pressed(depth, offset, clearance)
        # where the tool is bent in free space there is no insertion whose depth could be off
        known = None if experiment == "bends" else depth
        waves = self._wavelengths(force, arc, t, rng)
        if late := self._there.fibre_delay_s:
            # what was read before the run began nobody has; a reading that is held would be one that froze
            waves = np.column_stack([np.interp(t - late, t, w, left=np.nan) for w in waves.T])
        if self.lost > 0:
            waves[rng.random(len(t)) < self.lost] = np.nan
        seen = self._seen(t, position, turn, self._tip(force, arc), rng)
        return ToolRun(t, position, turn, waves, *seen, known, f"simulated {experiment}")

    def free_motion(self, *, seconds: float = 20.0, seed: int = 0) -> ToolRun:
        """The unbent tool led around the workspace, as for the registration of the camera (section V.B)."""
        rng = np.random.default_rng([seed, 9])
        t = np.arange(round(seconds * _ROBOT_HZ) + 1) / _ROBOT_HZ
        position = _smooth(t, rng, 15.0, 15.0, 15.0)
        turn = _smooth(t, rng, 0.3, 0.3, 0.05)
        waves = self._wavelengths(np.zeros((len(t), 2)), np.zeros(len(t)), t, rng)
        seen = self._seen(t, position, turn, np.zeros((len(t), 3)), rng)
        return ToolRun(t, position, turn, waves, *seen, None, "simulated free motion")

    def bench(self, *, loads: int = 80, unloaded: int = 20, deflection_std_mm: float = 0.01, seed: int = 0) -> Loads:
        """Known loads on a bench, from 20 to 250 mN across the clamp's axis, all around the shaft and 0 to 25 mm from
        the
        tip; ``depth_mm`` is how far each stands from the unbent tip along the unbent axis."""
        rng = np.random.default_rng([seed, 5])
        depth = rng.uniform(0.0, 25.0, loads + unloaded)
        size = np.concatenate([rng.uniform(20.0, 250.0, loads), np.zeros(unloaded)])
        way = rng.uniform(0.0, 2 * np.pi, len(size))
        force = size[:, None] * np.column_stack([np.cos(way), np.sin(way)])
        a = self._there.length_mm - depth
        # the load cell has the part across the clamp's axis; the edge pushes across the bent rod
        pushed = size
        for _ in range(8):
            pushed = size / np.cos(self._angle(pushed, a))
        along = pushed / np.where(size > 0, size, 1.0)
        waves = self._wavelengths(force * along[:, None], depth, np.zeros(len(size)), rng)
        bent = pushed * self._softness(pushed, a)
        depth = depth + a * self._bent(pushed, a) ** 2 / 15.0
        return Loads(force, depth, waves, bent + deflection_std_mm * rng.standard_normal(len(size)), "simulated loads")

    def pressed(self, offset_mm: Floats, depth_mm: Floats, clearance_mm: float) -> tuple[Floats, Floats]:
        """Force (n, 2), mN, tool frame, and wavelengths (n, 9), nm, where the hole stands ``offset_mm`` (n, 2) off the
        unbent shaft, ``depth_mm`` (n,) from the tip. Without noise and at the reference's warmth."""
        force, arc = self._pressed(depth_mm, offset_mm, clearance_mm)
        still = replace(self, noise_nm=0.0)
        return force, still._wavelengths(force, arc, np.zeros(len(force)), np.random.default_rng(0))

    # -- what the robot does: pose (n, 3), (n, 3), depth (n,), the hole off the shaft (n, 2), clearance --------

    def _phantom(self, t: Floats, rng: np.random.Generator) -> tuple[Floats, Floats, Floats, Floats, float]:
        """In and out of a tight hole, swaying so that the force comes and goes."""
        span = t[-1]
        led = 11.0 * (1 - np.cos(2 * np.pi * t / (span / 3)))
        sway = _smooth(t, rng, 2.0, 2.0)
        # pauses in which the shaft stands free in its hole
        sway *= np.clip(1.6 * np.sin(2 * np.pi * t / (span / 7.3)) + 0.35, 0.0, 1.0)[:, None]
        turn = _smooth(t, rng, 0.08, 0.08, 0.02)
        position, depth, sway = _about(t, turn, led, sway, self._wander(t, rng, led > 1.0))
        return position, turn, depth, sway, 0.05

    def _bends(self, t: Floats, rng: np.random.Generator) -> tuple[Floats, Floats, Floats, Floats, float]:
        """Led in free space, stopped, and bent six times from random places of the shaft."""
        span, bends = t[-1], 6
        turn = np.zeros((len(t), 3))
        position = np.zeros((len(t), 3))
        offset, depth = np.zeros((len(t), 2)), np.full(len(t), 12.0)
        ends = np.linspace(0.0, span, 2 * bends + 1)
        here, there = np.zeros(3), np.zeros(3)
        for k in range(bends):
            go = (t >= ends[2 * k]) & (t <= ends[2 * k + 1])
            stay = (t > ends[2 * k + 1]) & (t <= ends[2 * k + 2])
            there = rng.uniform(-12.0, 12.0, 3)
            share = _ease((t[go] - ends[2 * k]) / (ends[2 * k + 1] - ends[2 * k]))
            position[go] = here + share[:, None] * (there - here)
            position[stay] = there
            here = there
            where, way = rng.uniform(6.0, 26.0), rng.uniform(0.0, 2 * np.pi)
            compliance = (60.0 - where) ** 3 / (3.0 * self.tool.stiffness_mn_mm2)
            push = rng.uniform(120.0, 300.0) * (compliance + 1.0 / self.hole_mn_mm)
            inside = np.sin(np.pi * _between(t[stay], 0.12, 0.88)) ** 2
            offset[stay] = push * inside[:, None] * np.array([np.cos(way), np.sin(way)])
            depth[go | stay] = where
        return position, turn, depth, offset, 0.0

    def _vessels(self, t: Floats, rng: np.random.Generator) -> tuple[Floats, Floats, Floats, Floats, float]:
        """The tip follows vessels while the shaft leans on the edge of a wide hole from changing sides."""
        span = t[-1]
        inside = (19.0 + _smooth(t, rng, 2.0)[:, 0]) * _ease(t / (0.12 * span))
        lean = _smooth(t, rng, 3.5, 3.5) * _ease(t / (0.15 * span))[:, None]
        turn = _smooth(t, rng, 0.12, 0.12, 0.03)
        position, depth, lean = _about(t, turn, inside, lean, self._wander(t, rng, inside > 1.0))
        return position, turn, depth, lean, 2.2

    def _wander(self, t: Floats, rng: np.random.Generator, there: NDArray[np.bool_]) -> Floats:
        """A random walk of the hole along the shaft (n,), mm, while the tool is ``there`` (n,)."""
        step = np.sqrt(self.wander_mm2_s * np.diff(t, prepend=t[0])) * there
        return np.cumsum(step * rng.standard_normal(len(t)))

    # -- the bent rod, by the first terms of its series beyond the cantilever (Antman, Nonlinear Problems of Elasticity,
    # -- IV.3; 0.1 % of the bend is left at 300 mN): nothing of it is left where the tool's bending is "small"

    def _bent(self, force: Floats, arc: Floats) -> Floats:
        """F a² / EI (n,), twice the angle."""
        return np.asarray(force * arc**2 / self._there.stiffness_mn_mm2) * (self._there.bending == "exact")

    def _softness(self, force: Floats, arc: Floats) -> Floats:
        """Deflection at the contact per force (n,), mm/mN."""
        exact = 1.0 - 11.0 / 280.0 * self._bent(force, arc) ** 2
        return np.asarray(arc**3 / (3.0 * self._there.stiffness_mn_mm2) * exact)

    def _angle(self, force: Floats, arc: Floats) -> Floats:
        """Angle at the contact (n,), rad."""
        exact = 1.0 - self._bent(force, arc) ** 2 / 120.0
        return np.asarray(force * arc**2 / (2.0 * self._there.stiffness_mn_mm2) * exact)

    def _shortening(self, force: Floats, depth: Floats) -> Floats:
        """How much longer than along the axis the rod is from the clamp to a contact at these depths (n,), mm."""
        along = arc = self._there.length_mm - depth
        for _ in range(4):
            arc = along + arc * self._bent(force, arc) ** 2 / 15.0
        return np.asarray(arc - along)

    # -- mechanics, gratings, camera ----------------------------------------------------------------------

    @property
    def _there(self) -> FlexibleTool:
        """The tool in the world."""
        return self.true or self.tool

    def _pressed(self, depth: Floats, offset: Floats, clearance: float) -> tuple[Floats, Floats]:
        """Sclera force (n, 2), mN, tool frame, and the length of shaft beyond the hole (n,), mm."""
        size = np.linalg.norm(offset, axis=1)
        pressed = (size - clearance).clip(0.0) * (depth > 0)
        force = np.zeros(len(depth))
        for _ in range(12 if self._there.bending == "exact" else 1):
            a = self._there.length_mm - depth + self._shortening(force, depth)
            force = pressed / (np.cos(self._angle(force, a)) / self.hole_mn_mm + self._softness(force, a))
        pushed = force[:, None] * (offset / np.where(size > 0, size, 1.0)[:, None])
        return pushed, depth - self._shortening(np.linalg.norm(pushed, axis=1), depth)

    def _tip(self, force: Floats, depth: Floats) -> Floats:
        """Where the bent tip is (n, 3), mm, tool frame: the contact and the straight rest beyond it, which points along
        the angle there."""
        a, size = self._there.length_mm - depth, np.linalg.norm(force, axis=1)
        angle = self._angle(size, a)
        way = force / np.where(size > 0, size, 1.0)[:, None]
        if self._there.bending == "small":
            return np.column_stack([way * (size * self._softness(size, a) + angle * depth)[:, None], 0.0 * size])
        across = size * self._softness(size, a) + depth * np.sin(angle)
        # here the rod is as long as it is: what the bend takes is counted on the arc
        taken = a * self._bent(size, a) ** 2 / 15.0 + depth * (1.0 - np.cos(angle))
        return np.column_stack([way * across[:, None], -taken])

    def _wavelengths(self, force: Floats, depth: Floats, t: Floats, rng: np.random.Generator) -> Floats:
        """Nine wavelengths (n, 9), nm: the moment at each section bends the fibres, warmth shifts all alike."""
        warm = 0.010 * self.temperature_c * (1 - np.exp(-t / 20.0)) + 0.001 * np.sin(t / 7.0)
        waves = np.array(self._there.reference_nm) + warm[:, None]
        waves[:, :6] += np.array(self.bias_nm) + warm[:, None] * np.array(self.leak)
        force = self._felt(force)
        for section in range(2):
            lever = (self._there.distances_mm[section] - depth).clip(0.0)
            moment = force * (lever * (1.0 - self._bent(np.linalg.norm(force, axis=1), lever) ** 2 / 40.0))[:, None]
            # the shifts without a common part that this moment makes: the inverse of the calibration on that plane
            gains = np.array(self._there.gains[section])
            shifts = linalg.pinv(gains)
            shifts -= shifts.mean(axis=0)
            back = linalg.inv(gains @ shifts)
            waves[:, 3 * section : 3 * section + 3] += moment @ (shifts @ back).T
        return np.asarray(waves + self.noise_nm * rng.standard_normal(waves.shape))

    def _felt(self, force: Floats) -> Floats:
        """The force as the glued fibres feel it (n, 2): dragged behind on a rope of the hysteresis' length."""
        if self.hysteresis_mn == 0.0:
            return force
        felt = np.empty_like(force)
        here = force[0].copy()
        for k, there in enumerate(force):
            away = there - here
            size = float(np.hypot(*away))
            if size > self.hysteresis_mn:
                here = there - away * (self.hysteresis_mn / size)
            felt[k] = here
        return felt

    def _seen(
        self, t: Floats, position: Floats, turn: Floats, bent: Floats, rng: np.random.Generator
    ) -> tuple[Floats, Floats]:
        """Times (m,) by the camera's clock, and places (m, 3) in its frame of a tip that is bent by (n, 3), mm."""
        tip = position + np.einsum("nij,nj->ni", rotation_of(turn), bent + np.array([*self.shaft_bend_mm, 0.0]))
        true = self._there
        moment = np.arange(t[0] + 0.013, t[-1], 1.0 / _CAMERA_HZ)
        place = np.column_stack([np.interp(moment, t, tip[:, k]) for k in range(3)])
        place = (place - np.array(true.camera_translation_mm)) @ true.camera_rotation
        middle = place - place.mean(axis=0)
        warp = self.camera_warp_mm * np.sin(middle[:, [1, 2, 0]] / 9.0 + rng.uniform(0, 2 * np.pi, 3))
        noise = self.camera_mm / np.sqrt(3.0) * rng.standard_normal(place.shape)
        return moment + true.camera_delay_s, place + warp + noise

    def changed(self, **true: object) -> VirtualTool:
        """The same with a true tool that differs from its file in the given fields."""
        return replace(self, true=replace(self._there, **true))  # type: ignore[arg-type]


def _smooth(t: Floats, rng: np.random.Generator, *sizes: float) -> Floats:
    """Smooth random motions (n, k) of these sizes: six sines of 0.05 to 0.5 Hz that start at zero."""
    out = []
    for size in sizes:
        rate = 2 * np.pi * rng.uniform(0.05, 0.5, 6)
        weight, phase = rng.standard_normal(6), rng.uniform(0, 2 * np.pi, 6)
        wave = (weight[:, None] * (np.sin(rate[:, None] * t + phase[:, None]) - np.sin(phase)[:, None])).sum(axis=0)
        out.append(size * wave / np.sqrt(6.0))
    return np.column_stack(out)


def _ease(share: Floats) -> Floats:
    s = np.clip(share, 0.0, 1.0)
    return np.asarray(s * s * (3.0 - 2.0 * s))


def _between(t: Floats, low: float, high: float) -> Floats:
    """0 to 1 over the middle part of an interval."""
    if not len(t):
        return t
    share = (t - t[0]) / max(t[-1] - t[0], 1e-9)
    return np.clip((share - low) / (high - low), 0.0, 1.0)


def _about(
    t: Floats, turn: Floats, inside: Floats, lean: Floats, wander: Floats
) -> tuple[Floats, Floats, Floats]:  # fmt: skip
    """Places (n, 3) of a tool that turns about a hole, which stands in the base's origin and wanders along z (n,): and
    the depth (n,) that has come of it, and how far off the unbent shaft the hole is (n, 2)."""
    turned = rotation_of(turn)
    planned = np.column_stack([lean, -inside])
    seen = planned + turned[:, 2, :] * wander[:, None]
    return -np.einsum("nij,nj->ni", turned, planned), (-seen[:, 2]).clip(0.0), seen[:, :2]
