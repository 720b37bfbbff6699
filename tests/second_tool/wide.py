"""Worlds drawn from a seed: every convention, size and error of the flexible tool that nobody tells an estimator.

The hole at rest stands at E(t), the unbent tip at S(t), the tool is turned by R(t), z along its shaft to the tip. In
the tool's frame the hole is (u, -l) with l = (S - E) z, the paper's depth. The hand does not know how E wanders along
the shaft, but feels the hole sideways. The shaft bends against the tissue (:mod:`.wide_rod`); the edge gives way mostly
across, a little along, so that the contact stands at -l only nearly, and less shaft than l is beyond it where it bends.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from . import wide_bench
from .wide_faults import FAULTS, Signals, Spoilt, spoil
from .wide_fibres import Fibres, fibres
from .wide_hand import Hand, Led, ease, largest_push
from .wide_rod import RoughRod, Tissue, Touch
from .world import rows_by_time

Array = NDArray[np.float64]

EXPERIMENTS = ("phantom", "vessels", "bends")
TISSUES = {"soft": 40.0, "middle": 150.0, "stiff": 600.0}
_ROBOT_HZ, _CAMERA_HZ = 200.0, 15.0
_POSE_MM, _CAMERA_MM, _WARP_MM = 2e-3, 0.2, 0.1
_NEEDLE = Tissue(1000.0)
_SLIDES_MM_S = 0.2

__all__ = ["EXPERIMENTS", "FAULTS", "TISSUES", "Wide", "WideRun"]


@dataclass(frozen=True)
class WideRun:
    """A run as recorded, and the truth of its rows (n,).

    Recorded: ``place_mm`` (n, 3) with its noise, ``turn_rad`` (n, 3), ``wavelengths_nm`` (n, 9), the camera's own times
    and places (m, 3). True: ``l_mm`` from the unbent tip to the hole at rest along the unbent axis, (S - E) z, and
    ``arc_mm`` of shaft beyond the contact (beyond the hole, where untouched; both NaN where there is none);
    ``tip_mm`` (n, 3) in the base; ``force_mn`` (n, 2) on the shaft across the unbent axis, in the tool's frame, and
    ``along_mn`` along it, to the tip; ``touched``; ``bend_mm``: the tip off the unbent tip. ``bad`` and ``changed``:
    gratings, 0 to 8, that a fault has spoilt or touched (:mod:`.wide_faults`)."""

    time_s: Array
    place_mm: Array
    turn_rad: Array
    wavelengths_nm: Array
    camera_time_s: Array
    camera_mm: Array
    l_mm: Array
    arc_mm: Array
    tip_mm: Array
    force_mn: Array
    along_mn: Array
    touched: NDArray[np.bool_]
    bend_mm: Array
    signals: Signals
    touch: Touch
    tells_depth: bool
    bad: frozenset[int] = frozenset()
    changed: frozenset[int] = frozenset()

    def columns(self) -> dict[str, Array]:
        """Rows of robot and camera by time, as in a file; NaN where a row has no such value."""
        return rows_by_time(self, {"depth_mm": self.l_mm} if self.tells_depth else {})


@dataclass(frozen=True)
class Drawn:
    """What a seed has drawn: the tool, what it is led through and by whom, and where everything stands."""

    rod: RoughRod
    glass: Fibres
    friction: float
    tissue: Tissue
    clearance_mm: dict[str, float]
    sticks: bool
    hand: Hand
    upright: Rotation
    middle_mm: Array
    camera: Rotation
    camera_mm: Array
    warp_phase: Array
    delay_s: float
    start_mm: float
    reading: tuple[str, str]


class Hole(NamedTuple):
    """As the tool sees it, rows (n,): ``off_mm`` (n, 2) and ``l_mm``, how far its edge would push, which way (n, 2)."""

    off_mm: Array
    l_mm: Array
    push_mm: Array
    way: Array
    tissue: Tissue


@dataclass(frozen=True)
class Wide:
    """A world by its seed. ``size`` scales bends and forces (1: 10 mm at the tip, 300 mN). What is None is drawn:
    ``tissue`` (a key of ``TISSUES``), the bench's ``depth`` ("axis", "arc") and ``force`` ("across", "normal"),
    ``friction``, 0 to 0.15, and ``sticks``: whether the edge goes along with tremor, so that only the meant motion
    turns the friction. ``wander_mm2_s``: how the hole strays along the shaft."""

    seed: int
    size: float = 1.0
    tissue: str | None = None
    depth: str | None = None
    force: str | None = None
    friction: float | None = None
    sticks: bool | None = None
    wander_mm2_s: float = 0.004

    @cached_property
    def drawn(self) -> Drawn:
        """The truth. A choice of the caller changes nothing else that is drawn."""
        rng = self._rng("tool")
        rod = RoughRod(float(rng.uniform(50.0, 70.0)), float(rng.uniform(0.8e6, 1.5e6)))
        glass = fibres(self._rng("fibres"), rod.length_mm)
        rng = self._rng("eye")
        kind, ratio, hard = str(rng.choice(list(TISSUES))), rng.uniform(5.0, 10.0), rng.uniform(80.0, 250.0)
        tight, wide = rng.uniform(0.02, 0.1), rng.uniform(1.5, 2.5)
        friction, sticks = rng.uniform(0.0, 0.15), bool(rng.integers(2))
        start = rng.uniform(0.5, 3.0)
        rng = self._rng("hand")
        hand = Hand(
            float(rng.uniform(0.1, 0.2)), float(rng.uniform(0.1, 0.5)), float(rng.uniform(0.03, 0.1)),
            float(rng.uniform(2e-4, 1e-3)),
        )  # fmt: skip
        axis = rng.standard_normal(3)
        upright = Rotation.from_rotvec(axis / np.linalg.norm(axis) * rng.uniform(0.0, 2.3))
        middle = rng.uniform(-100.0, 100.0, 3)
        rng = self._rng("camera")
        camera = Rotation.from_quat(rng.standard_normal(4))
        rng_bench = self._rng("convention")
        reading = str(rng_bench.choice(wide_bench.DEPTHS)), str(rng_bench.choice(wide_bench.FORCES))
        return Drawn(
            rod=rod,
            glass=glass,
            friction=float(friction if self.friction is None else self.friction),
            tissue=Tissue(TISSUES[self.tissue or kind], float(ratio), float(hard)),
            clearance_mm={"phantom": float(tight), "vessels": float(wide), "bends": 0.0},
            sticks=sticks if self.sticks is None else self.sticks,
            hand=hand,
            upright=upright,
            middle_mm=middle,
            camera=camera,
            camera_mm=middle - camera.apply(rng.uniform(-30.0, 30.0, 3) + np.array([0.0, 0.0, 300.0])),
            warp_phase=rng.uniform(0.0, 2 * np.pi, 3),
            delay_s=float(rng.uniform(0.0, 0.06)),
            start_mm=float(start),
            reading=(self.depth or reading[0], self.force or reading[1]),
        )

    def drawing(self) -> dict[str, Any]:
        """Tables of a tool file as a drawing knows the tool: off by what a workshop is off."""
        d, rng = self.drawn, self._rng("drawing")

        def off(most: float) -> float:
            return float(rng.choice([-1.0, 1.0]) * most * rng.uniform(0.5, 1.0))

        gains = d.glass.drawn_gains(d.rod.stiffness_mn_mm2)
        gains = gains * np.array([1.0 + off(0.1), 1.0 + off(0.1)])[:, None, None]
        sections = ("I", "II")
        return {
            "kind": "flexible_tool",
            "shaft": {
                "length_mm": d.rod.length_mm + off(0.5),
                "stiffness_mn_mm2": d.rod.stiffness_mn_mm2 * (1.0 + off(0.1)),
            },
            "gratings": {
                "distances_mm": d.glass.drawn_mm[:2].tolist(),
                **{f"gain_{n}_{a}": gains[s, k].tolist() for s, n in enumerate(sections) for k, a in enumerate("xy")},
                "reference_nm": (d.glass.rest_nm + 0.05 * rng.standard_normal(9)).tolist(),
                "noise_nm": 1e-3,
            },
            "camera": {
                "rotation_rad": [0.0, 0.0, 0.0],
                "translation_mm": [0.0, 0.0, 0.0],
                "delay_s": 0.0,
                "std_mm": _CAMERA_MM,
            },
            "filter": {
                "noise": "propagated",
                "per_second_mm2": [0.004, 1.0],
                "floor_mm2": [0.0, 0.0],
                "start_depth_mm": max(0.0, d.start_mm + 0.5 * float(rng.standard_normal())),
                "start_std_mm": 0.5,
            },
        }

    def bench(self, *, loads: int = 80, unloaded: int = 20) -> dict[str, Array]:
        """Known loads by column, by the bench's own convention (``drawn.reading``)."""
        d = self.drawn
        depth, force = d.reading
        return wide_bench.rows(self._rng("bench"), d.rod, d.glass, depth=depth, force=force, size=self.size,
                               loads=loads, unloaded=unloaded)  # fmt: skip

    def free(self, *, seconds: float = 40.0) -> dict[str, Array]:
        """The untouched tool led before the camera, by column."""
        return self.run("free", seconds=seconds).columns()

    def run(
        self, experiment: str, *, seconds: float = 60.0, fault: str | None = None, since_s: float = 30.0
    ) -> WideRun:
        """``"phantom"``: in and out of a tight hole. ``"vessels"``: deep in a wide one, leaning on changing sides.
        ``"bends"``: in free space, stopped and bent by a needle. (``"free"``: never touched.) With a fault of
        ``FAULTS`` from a time on everything else is as without."""
        d, rng = self.drawn, self._rng(experiment)
        t = np.arange(round(seconds * _ROBOT_HZ) + 1) / _ROBOT_HZ
        led = self._led(experiment, t, rng)
        turn = d.upright * Rotation.from_rotvec(led.turn_rad)
        strayed, slack = self._strayed(t, turn, led, rng)
        hole = self._hole(t, led, slack)
        second_mn = self._second(t, hole)
        leant = self._leant(hole, second_mn)
        touch = self._touch(leant, self._friction(t, led, slack, hole))

        if led.enters:  # the hand feels the hole sideways and goes with it
            seen = np.column_stack([hole.off_mm, -(hole.l_mm + slack)])
            place = d.middle_mm + strayed - slack[:, None] * turn.as_matrix()[:, :, 2] - turn.apply(seen)
        else:
            place = d.middle_mm + led.shift_mm + turn.apply(led.trembling_mm)
        across, along = touch.tip()
        bent = across[:, None] * leant.way + second_mn * touch.rod.length_mm**3 / (3.0 * touch.rod.stiffness_mn_mm2)
        tip = place + turn.apply(np.column_stack([bent, along]))
        signals = self._signals(t, touch, leant.way, rng, second_mn)
        recorded, turn_told = self._told(t, place, turn)
        recorded = recorded + _POSE_MM * rng.standard_normal(place.shape)
        camera_t, camera = self._seen(t, tip, rng)
        spoilt = Spoilt(signals.read(d.glass), frozenset(), frozenset())
        if fault is not None:
            spoilt = spoil(fault, d.glass, signals, t, since_s, self._rng(f"{experiment} {fault}"))
        return WideRun(
            time_s=t, place_mm=recorded, turn_rad=turn_told, wavelengths_nm=self._kept(t, spoilt.wavelengths_nm),
            camera_time_s=camera_t, camera_mm=camera, l_mm=np.where(led.there, hole.l_mm, np.nan),
            arc_mm=np.where(led.there, touch.arc_mm, np.nan), tip_mm=tip,
            force_mn=touch.pushed_mn[:, None] * leant.way, along_mn=touch.dragged_mn, touched=touch.normal_mn > 0.0,
            bend_mm=np.hypot(across, along), signals=signals, touch=touch, tells_depth=led.enters, bad=spoilt.bad,
            changed=spoilt.changed,
        )  # fmt: skip

    # -- what happens -------------------------------------------------------------------------------------

    def _rng(self, topic: str) -> np.random.Generator:
        return np.random.default_rng([self.seed, *topic.encode()])

    def _led(self, experiment: str, t: Array, rng: np.random.Generator) -> Led:
        """The plan, with leans in mm: the share of the largest lean that the depth, the tissue and the size allow."""
        d = self.drawn
        if experiment == "free":
            return d.hand.free(t, rng)
        if experiment not in EXPERIMENTS:
            raise ValueError(f"experiment: '{experiment}' is none of {(*EXPERIMENTS, 'free')}")
        if experiment == "bends":
            led = d.hand.bends(t, rng)
            tissue, clearance = _NEEDLE, 0.0
        else:
            clearance, tissue = d.clearance_mm[experiment], d.tissue
            led = d.hand.enters(t, rng, d.start_mm, clearance, wide=experiment == "vessels")
        return led.within(clearance, tissue, lambda deep: largest_push(d.rod, tissue, d.friction, self.size, deep))

    def _strayed(self, t: Array, turn: Rotation, led: Led, rng: np.random.Generator) -> tuple[Array, Array]:
        """How far the hole has strayed (n, 3) in the base, and of that along the shaft (n,)."""
        shaft = turn.as_matrix()[:, :, 2]
        steps = np.sqrt(self.wander_mm2_s * np.diff(t, prepend=t[0])) * rng.standard_normal(len(t)) * led.enters
        strayed = np.cumsum(steps[:, None] * shaft, axis=0)
        return strayed, np.einsum("ni,ni->n", strayed, shaft)

    def _hole(self, t: Array, led: Led, slack: Array, *, calm: bool = False) -> Hole:
        """The hole as the tool sees it; ``calm``: without tremor, and had it not strayed."""
        trembling = np.zeros((len(t), 3)) if calm else led.trembling_mm
        # nobody leaves the eye unawares: the hand follows slowly where the hole has strayed beyond the tip
        followed = gaussian_filter1d(slack, 0.5 * _ROBOT_HZ, mode="nearest")
        deep = led.deep_mm + (followed + 0.5 - led.deep_mm).clip(0.0) * ease(t) * led.enters
        l_mm = deep + trembling[:, 2] - (0.0 if calm else slack)
        off = led.off_mm - trembling[:, :2]
        if not led.enters:  # a needle pushes from one side
            off = led.side * np.einsum("ni,ni->n", off, led.side).clip(0.0)[:, None]
        size = np.linalg.norm(off, axis=1)
        most = led.clearance_mm + led.most_mm(l_mm)
        way = off / np.where(size > 0.0, size, 1.0)[:, None]
        size = np.minimum(size, most)
        push = np.where(led.there & (l_mm > 0.1), size - led.clearance_mm, 0.0)
        return Hole(size[:, None] * way, l_mm, push, way, led.tissue)

    def _friction(self, t: Array, led: Led, slack: Array, hole: Hole) -> Array:
        """T / N (n,), positive to the tip: while the shaft slides in through the hole it is dragged to the clamp. How
        fast it slides is told by the shaft without friction, in a hole that does not stray."""
        d = self.drawn
        seen = self._hole(t, led, slack, calm=True) if d.sticks else hole
        l_mm = seen.l_mm if d.sticks else seen.l_mm + slack
        none = np.zeros(len(t))
        speed = np.gradient(d.rod.in_hole(l_mm, seen.push_mm, seen.tissue, none).arc_mm, t)
        return -d.friction * np.tanh(speed / _SLIDES_MM_S)

    def _signals(self, t: Array, touch: Touch, way: Array, rng: np.random.Generator, second_mn: Array) -> Signals:
        glass = self.drawn.glass
        warmer = 0.3 * np.sin(2 * np.pi * (t / rng.uniform(60.0, 200.0) + rng.random()))
        answers = glass.answers(self.drawn.rod.stiffness_mn_mm2)
        by_tip = [(second_mn * at) @ answers[s].T for s, at in enumerate(glass.from_tip_mm)]
        bending = glass.bending(touch, way) + np.hstack(by_tip)
        return Signals(
            self._lagged(t, bending), glass.warmed(warmer) + self._warmed(t), rng.standard_normal((len(t), 9))
        )

    # -- what families of worlds do otherwise (:mod:`.wide_families`) -----------------------------------------

    def _second(self, t: Array, hole: Hole) -> Array:
        """A second force, at the tip across the shaft (n, 2), mN."""
        return np.zeros((len(t), 2))

    def _leant(self, hole: Hole, second_mn: Array) -> Hole:
        """The hole as a shaft presses on it that a force at its tip bends."""
        if not second_mn.any():
            return hole
        rod = self.drawn.rod
        reach = rod.length_mm - hole.l_mm.clip(0.0)
        moved = second_mn * (reach**2 * (3.0 * rod.length_mm - reach) / (6.0 * rod.stiffness_mn_mm2))[:, None]
        off = hole.off_mm - moved
        size = np.linalg.norm(off, axis=1)
        clear = np.linalg.norm(hole.off_mm, axis=1) - hole.push_mm
        push = np.where(hole.push_mm > 0.0, (size - clear).clip(0.0), 0.0)
        return hole._replace(push_mm=push, way=off / np.where(size > 0.0, size, 1.0)[:, None])

    def _touch(self, hole: Hole, friction: Array) -> Touch:
        return self.drawn.rod.in_hole(hole.l_mm, hole.push_mm, hole.tissue, friction)

    def _lagged(self, t: Array, bending_nm: Array) -> Array:
        """What fibres show (n, 9) of their bends."""
        return bending_nm

    def _warmed(self, t: Array) -> Array:
        """Further warmth of the gratings, as shifts (n, 9) or nothing."""
        return np.zeros((len(t), 9))

    def _told(self, t: Array, place: Array, turn: Rotation) -> tuple[Array, Array]:
        """Where the robot says that it is, and its turn."""
        return place, turn.as_rotvec()

    def _kept(self, t: Array, waves: Array) -> Array:
        """Wavelengths without the rows that are lost."""
        return waves

    def _seen(self, t: Array, tip: Array, rng: np.random.Generator) -> tuple[Array, Array]:
        """Times (m,) by the camera's clock and places (m, 3) in its frame; its field is bent, the same in every run."""
        d = self.drawn
        moment = np.arange(t[0] + rng.uniform(0.0, 1.0 / _CAMERA_HZ), t[-1], 1.0 / _CAMERA_HZ)
        true = np.column_stack([np.interp(moment, t, x) for x in tip.T])
        place = d.camera.inv().apply(true - d.camera_mm)
        from_middle = place - d.camera.inv().apply(d.middle_mm - d.camera_mm)
        warp = _WARP_MM * np.sqrt(2.0 / 3.0) * np.sin(from_middle[:, [1, 2, 0]] / 9.0 + d.warp_phase)
        noise = _CAMERA_MM / np.sqrt(3.0) * rng.standard_normal(place.shape)
        return moment + d.delay_s, np.asarray(place + warp + noise)
