"""A flexible tool in an eye, written apart: where the robot, the hole and the shaft truly are, and what is recorded.

Kinematics. The hole stands at E(t), the unbent tip at S(t), the tool is turned by R(t), with z along the shaft to the
tip. The hole in the tool's frame is (u, -l): u off the unbent axis, l = (S - E) z. So l changes by S' z and by
(S - E) z', the tool's turning about the hole; nothing is done to make the second part zero. The shaft bends under the
hole (:mod:`.rod`); the insertion depth is the length of the shaft beyond it.

Gratings. Strain of a fibre is curvature times its distance from the axis; a strain e at a wavelength L shifts it by
0.78 L e, each fibre by its own gain, and warmth by its own coefficient.
"""

from __future__ import annotations

import csv
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from .faults import Fault
from .motion import Motion, path_of
from .rod import Bent, Rod

Array = NDArray[np.float64]
Path3 = Callable[[Array], Array]

ROBOT_HZ, CAMERA_HZ = 200.0, 15.0
_STRAIN_OPTIC = 0.78
_RADIUS_MM = 0.196
_REST_NM = np.array([1531.0, 1531.2, 1530.9, 1545.1, 1545.0, 1544.8, 1559.0, 1559.1, 1558.9])
_WITHOUT_MEAN = np.eye(3) - 1.0 / 3.0


@dataclass(frozen=True)
class Gratings:
    """``from_tip_mm`` (3,) of sections I, II, III; ``side_rad`` (3, 3) that bends stretch; ``gains`` (3, 3) relative;
    ``warmth_nm_c`` (3, 3); wavelengths at rest ``rest_nm`` (9,)."""

    from_tip_mm: tuple[float, float, float] = (40.0, 50.0, 5.0)
    side_rad: Array = field(default_factory=lambda: 2 * np.pi / 3 * np.arange(3) + np.array([[0.0], [0.02], [-0.1]]))
    gains: Array = field(default_factory=lambda: np.ones((3, 3)))
    warmth_nm_c: Array = field(default_factory=lambda: np.full((3, 3), 0.010))
    rest_nm: Array = field(default_factory=_REST_NM.copy)

    def answers(self, stiffness_mn_mm2: float) -> Array:
        """Shifts (3, 3, 2) of the fibres of each section by the moment's x and y, nm per mN mm."""
        side = np.stack([np.cos(self.side_rad), np.sin(self.side_rad)], axis=2)
        per_moment = _STRAIN_OPTIC * self.rest_nm.reshape(3, 3) * _RADIUS_MM / stiffness_mn_mm2
        return np.asarray((per_moment * self.gains)[:, :, None] * side)


@dataclass(frozen=True)
class World:
    """The tool and its surroundings, and how far the tool's file is off (``gain_error``, ``reference_error_nm``: drawn
    for each fibre). ``warmth_unlike`` is how unlike warmth moves the fibres, drawn for each by a run's seed.
    ``pivot_rad`` is how far the tool turns about the hole, ``eye_mm_s`` how fast the eye moves, ``wander_mm2_s`` how
    the hole strays along the shaft. Wavelengths are those of ``fibre_delay_s`` earlier, at ``fibre_hz`` (None: each
    row); where ``stamped`` the run says so (``fbg_time_s``)."""

    rod: Rod = field(default_factory=Rod)
    gratings: Gratings = field(default_factory=Gratings)
    noise_nm: float = 1e-3
    pivot_rad: float = 0.0
    hole_mn_mm: float = 150.0
    wander_mm2_s: float = 0.004
    eye_mm_s: float = 0.0
    temperature_c: float = 0.0
    warmth_unlike: float = 0.0
    gain_error: float = 0.0
    reference_error_nm: float = 0.0
    fibre_delay_s: float = 0.0
    fibre_hz: float | None = None
    stamped: bool = True
    faults: tuple[Fault, ...] = ()
    camera_rotation_rad: tuple[float, float, float] = (0.3, -0.2, 1.0)
    camera_translation_mm: tuple[float, float, float] = (50.0, -20.0, 300.0)
    camera_delay_s: float = 0.031
    camera_mm: float = 0.2
    camera_warp_mm: float = 0.0

    def run(self, experiment: str, *, seconds: float = 60.0, seed: int = 0) -> Recorded:
        """``"phantom"``: in and out of a tight hole, the force comes and goes. ``"vessels"``: a wide hole, the shaft
        leans on changing sides. ``"bends"``: in free space, stopped and bent six times. ``"free"``: led around, never
        touched. ``"warm_up"``: still and untouched."""
        if self.warmth_unlike > 0.0:
            warmth = np.random.default_rng([seed, 8]).standard_normal((3, 3)) * self.warmth_unlike + 1.0
            gratings = replace(self.gratings, warmth_nm_c=self.gratings.warmth_nm_c * warmth)
            return replace(self, gratings=gratings, warmth_unlike=0.0).run(experiment, seconds=seconds, seed=seed)
        rng = np.random.default_rng([seed, *experiment.encode()])
        t = np.arange(round(seconds * ROBOT_HZ) + 1) / ROBOT_HZ
        m = path_of(experiment, t, rng, self.pivot_rad)
        rotation = Rotation.from_rotvec(m.turn_rad)
        if m.touched and not m.held:
            hole = self._eye(t, rng)
            seen = m.hole_mm + rotation.inv().apply(hole)  # the hole in the tool's frame, wherever it has gone
        else:
            seen = m.hole_mm
        bent, way = self._bent(seen, m)
        across, along = bent.tip()
        tip = m.place_mm + rotation.apply(np.column_stack([across[:, None] * way, along]))
        now = t - self.fibre_delay_s
        waves = self._wavelengths(bent, way, t, now, rng)
        stamps = self._stamps(t, waves, now)
        for fault in self.faults:
            waves = fault(t, waves)
        camera_t, camera = self._seen(t, tip, rng)
        known = self.rod.length_mm - bent.along_mm if m.touched and not m.held else None
        force = bent.force_mn[:, None] * way
        return Recorded(t, m.place_mm, m.turn_rad, waves, stamps, camera_t, camera, known, tip, force, bent)

    def bench(
        self, *, loads: int = 80, unloaded: int = 20, force_std_mn: float = 0.0, deflection_std_mm: float = 0.01,
        largest_mn: float = 250.0, seed: int = 0,
    ) -> dict[str, Array]:  # fmt: skip
        """Rows of a bench of known loads, by column: their force across the clamp's axis with the load cell's noise,
        and
        how far each stands from the unbent tip along that axis."""
        rng = np.random.default_rng([seed, 5])
        depth = rng.uniform(0.0, 25.0, loads + unloaded)
        size = np.concatenate([rng.uniform(20.0, largest_mn, loads), np.zeros(unloaded)])
        angle = rng.uniform(0.0, 2 * np.pi, len(size))
        way = np.column_stack([np.cos(angle), np.sin(angle)])
        bent = self.rod.loaded(size, depth)
        waves = self._shifted(bent, way, np.zeros(len(size)))
        waves += self.noise_nm * rng.standard_normal(waves.shape)
        force = size[:, None] * way
        force[:loads] += force_std_mn * rng.standard_normal((loads, 2))
        deflection = bent.across_mm + deflection_std_mm * rng.standard_normal(len(size))
        stands = self.rod.length_mm - bent.along_mm
        return {"force_x_mn": force[:, 0], "force_y_mn": force[:, 1], "depth_mm": stands, "deflection_mm": deflection,
                **fibre_columns(waves)}  # fmt: skip

    def file(self, seed: int = 0) -> dict[str, Any]:
        """Tables of a tool file for this world: exact but for ``gain_error`` and ``reference_error_nm``, which a draw
        by ``seed`` puts in. What the filters trust is the hole's own wander, and no floor."""
        rng = np.random.default_rng([seed, 6])
        answers = self.gratings.answers(self.rod.stiffness_mn_mm2)
        gains = np.array([np.linalg.pinv(_WITHOUT_MEAN @ answers[s]) for s in range(2)])
        gains *= 1.0 + self.gain_error * rng.standard_normal(gains.shape)
        sections = ("I", "II")
        rest = self.gratings.rest_nm + self.reference_error_nm * rng.standard_normal(9)
        return {
            "kind": "flexible_tool",
            "shaft": {"length_mm": self.rod.length_mm, "stiffness_mn_mm2": self.rod.stiffness_mn_mm2},
            "gratings": {
                "distances_mm": list(self.gratings.from_tip_mm[:2]),
                **{f"gain_{n}_{a}": gains[s, k].tolist() for s, n in enumerate(sections) for k, a in enumerate("xy")},
                "reference_nm": rest.tolist(),
                "noise_nm": self.noise_nm,
            },
            "camera": {
                "rotation_rad": list(self.camera_rotation_rad),
                "translation_mm": list(self.camera_translation_mm),
                "delay_s": self.camera_delay_s,
                "std_mm": self.camera_mm,
            },
            "filter": {
                "noise": "propagated",
                "per_second_mm2": [self.wander_mm2_s, 1.0],
                "floor_mm2": [0.0, 0.0],
                "start_depth_mm": 1.0,
                "start_std_mm": 0.5,
            },
        }  # fmt: skip

    # -- what happens -------------------------------------------------------------------------------------

    def _eye(self, t: Array, rng: np.random.Generator) -> Array:
        """Where the hole is gone (n, 3), base frame: its wander along the shaft, and the eye's own turning."""
        wander = np.cumsum(np.sqrt(self.wander_mm2_s * np.diff(t, prepend=t[0])) * rng.standard_normal(len(t)))
        rate, phase = 2 * np.pi / 8.0, rng.uniform(0, 2 * np.pi, 3)
        eye = self.eye_mm_s / rate * (np.sin(rate * t[:, None] + phase) - np.sin(phase)) * np.array([0.5, 0.5, 1.0])
        return np.asarray(eye + wander[:, None] * np.array([0.0, 0.0, 1.0]))

    def _bent(self, hole: Array, m: Motion) -> tuple[Bent, Array]:
        """The shaft in a hole that the tool sees at (n, 3), and the way (n, 2) it is pushed."""
        size = np.linalg.norm(hole[:, :2], axis=1)
        inside = hole[:, 2] < 0.0
        push = np.where(inside & m.touched, size - m.clearance_mm, 0.0)
        way = hole[:, :2] / np.where(size > 0, size, 1.0)[:, None]
        return self.rod.pressed(self.rod.length_mm + np.minimum(hole[:, 2], 0.0), push, self.hole_mn_mm), way

    def _shifted(self, bent: Bent, way: Array, warmer_c: Array) -> Array:
        """Wavelengths (n, 9) without noise."""
        g = self.gratings
        answers = g.answers(self.rod.stiffness_mn_mm2)
        moments = [bent.moment(at)[:, None] * way for at in g.from_tip_mm]
        return np.asarray(
            g.rest_nm + np.hstack([m @ answers[s].T for s, m in enumerate(moments)])
            + warmer_c[:, None] * g.warmth_nm_c.ravel()
        )  # fmt: skip

    def _wavelengths(self, bent: Bent, way: Array, t: Array, now: Array, rng: np.random.Generator) -> Array:
        """What the interrogator gives in each row (n, 9): the fibres as they were at ``now``."""
        warmer = self.temperature_c * (1.0 - np.exp(-t / 20.0)) + 0.1 * np.sin(t / 7.0) * (self.temperature_c != 0)
        waves = self._shifted(bent, way, warmer)
        waves = np.column_stack([np.interp(now, t, w) for w in waves.T])
        return np.asarray(waves + self.noise_nm * rng.standard_normal(waves.shape))

    def _stamps(self, t: Array, waves: Array, now: Array) -> Array | None:
        """Loses the rows between the readings of a slow interrogator; the time each was taken, where it is told."""
        if self.fibre_hz is not None:
            tick = np.floor(t * self.fibre_hz + 1e-9)
            waves[np.diff(tick, prepend=-1.0) == 0] = np.nan
        late = self.fibre_delay_s != 0.0 and self.stamped
        return np.where(np.isfinite(waves).any(axis=1), now, np.nan) if late else None

    def _seen(self, t: Array, tip: Array, rng: np.random.Generator) -> tuple[Array, Array]:
        """Times (m,) by the camera's clock and places (m, 3) in its frame."""
        moment = np.arange(t[0] + 0.013, t[-1], 1.0 / CAMERA_HZ)
        place = np.column_stack([np.interp(moment, t, x) for x in tip.T])
        place = Rotation.from_rotvec(self.camera_rotation_rad).inv().apply(place - np.array(self.camera_translation_mm))
        middle = place - place.mean(axis=0)
        warp = self.camera_warp_mm * np.sin(middle[:, [1, 2, 0]] / 9.0 + rng.uniform(0, 2 * np.pi, 3))
        noise = self.camera_mm / np.sqrt(3.0) * rng.standard_normal(place.shape)
        return moment + self.camera_delay_s, np.asarray(place + warp + noise)


@dataclass(frozen=True)
class Recorded:
    """A run as recorded, with the truth: ``depth_mm`` (n,; along the unbent axis; None where no hole is entered),
    ``tip_mm`` (n, 3) in the
    base, ``force_mn`` (n, 2) across the shaft in the tool's frame."""

    time_s: Array
    place_mm: Array
    turn_rad: Array
    wavelengths_nm: Array
    fibre_time_s: Array | None
    camera_time_s: Array
    camera_mm: Array
    depth_mm: Array | None
    tip_mm: Array
    force_mn: Array
    bent: Bent

    def columns(self) -> dict[str, Array]:
        """Rows of robot and camera by time, as in a file; NaN where a row has no such value."""
        own = {} if self.fibre_time_s is None else {"fbg_time_s": self.fibre_time_s}
        return rows_by_time(self, own if self.depth_mm is None else own | {"depth_mm": self.depth_mm})


def rows_by_time(run: Any, own: dict[str, Array]) -> dict[str, Array]:
    """Rows of robot and camera by time, NaN where a row has no such value; ``own`` are further columns of the robot."""
    robot = {"time_s": run.time_s}
    robot |= {f"robot_{a}_mm": run.place_mm[:, k] for k, a in enumerate("xyz")}
    robot |= {f"robot_r{a}_rad": run.turn_rad[:, k] for k, a in enumerate("xyz")}
    robot |= fibre_columns(run.wavelengths_nm) | own
    camera = {"time_s": run.camera_time_s} | {f"camera_{a}_mm": run.camera_mm[:, k] for k, a in enumerate("xyz")}
    order = np.argsort(np.concatenate([run.time_s, run.camera_time_s]), kind="stable")

    def both(name: str) -> Array:
        halves = [half.get(name, np.full(len(half["time_s"]), np.nan)) for half in (robot, camera)]
        return np.concatenate(halves)[order]

    return {name: both(name) for name in {**robot, **camera}}


def fibre_columns(waves: Array) -> dict[str, Array]:
    """Wavelengths (n, 9) by column."""
    return {f"fbg{k + 1}_nm": waves[:, k] for k in range(9)}


def write_csv(columns: dict[str, Array], path: str | Path) -> None:
    """Writes columns as CSV; NaN is an empty cell."""
    with open(path, "w", newline="", encoding="utf-8") as file:
        rows = csv.writer(file)
        rows.writerow(columns)
        for row in zip(*columns.values(), strict=True):
            rows.writerow("" if np.isnan(v) else repr(float(v)) for v in row)
