"""Machines that are driven row by row: the second simulators, as a loop that chooses its own poses meets them.

A world has a clock: a reading takes some seconds, and no row is read before the moment that it asks for. What is hidden
is as large as a fit of the geometry, and of the pose of an instrument that stands anywhere, leaves so many noises of
it, on poses over the whole workspace and half an hour.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import sherkit as sk
from second_arms import SecondArm
from second_simulator.effects import draw_pose
from second_simulator.geometry import NOMINAL_CONFIG, Robot, draw_geometric_errors
from second_simulator.plans import grid, make_plan
from second_simulator.simulate import fitted_directions, scaled_effect, truth
from second_simulator.spherical import GEOMETRY, SPHERICAL_EFFECTS, spherical_plan
from sherkit.model.kinds import robot_from_tables
from test_arm_counted import arm_in
from test_serial import NOISE_MM, PLAIN, hidden_at, left_by_geometry, model_of, postures
from test_spherical_discovery import NOISE_PX, PLANS, ROBOT, real_robot

Floats = NDArray[np.float64]
Row = dict[str, Any]
Rows = list[Row]

#: Over which time what lives in it is sized, s, and how long a reading takes.
SPAN_S, PACE_S = 1800.0, 4.0
#: What of the spherical robot is its camera's or its marker's: where the tool points, it does not show.
_SEEN = {"marker_offset", "thermal_growth", "drift", "slip", "thermal_shift", "sensor_pose", "sensor_slip",
         "sensor_drift",
         "focal_length", "lens_distortion", "camera_delay"}  # fmt: skip
#: How many times as much a hall warms as a room.
_HALL = 5.0


class World(ABC):
    """What all worlds share: the clock, the room, the noise."""

    joints: tuple[str, ...]
    readings: tuple[str, ...]
    robot: Any

    def __init__(self, seed: int, noise: float, pace_s: float = PACE_S) -> None:
        self.rng = np.random.default_rng([seed, 77])
        self.noise, self.pace_s = noise, pace_s
        self.phases = self.rng.uniform(0.0, 2.0 * np.pi, 4)
        self.clock_s = 0.0
        self.told: dict[str, Floats] | None = None

    def room(self, time_s: Floats) -> dict[str, Floats]:
        """Temperature and humidity at these moments."""
        a, b, c, _ = self.phases
        warming = 2.0 * (1.0 - np.exp(-time_s / 3600.0))
        return {
            "temperature_c": 20.0 + warming + 0.4 * np.sin(time_s / 900.0 + a) + 0.2 * np.sin(time_s / 310.0 + b),
            "humidity_pct": 45.0 + 4.0 * np.sin(time_s / 1300.0 + c),
        }

    @abstractmethod
    def exact(self, columns: Mapping[str, Floats]) -> Floats:
        """Readings (n, m) without noise, of all rows so far."""

    def read(self, asked: Rows) -> Rows:
        """Drives to the rows asked for and reads."""
        moments = []
        for row in asked:
            self.clock_s = max(self.clock_s + self.pace_s, float(row.get("not_before_s", 0.0)))
            moments.append(self.clock_s)
        time_s = np.array(moments)
        new = {name: np.array([float(row[name]) for row in asked]) for name in ("pose", "repeat", *self.joints)}
        new |= {"time_s": time_s, **self.room(time_s)}
        old = self.told
        self.told = new if old is None else {name: np.concatenate([old[name], new[name]]) for name in new}
        seen = self.exact(self.told)[-len(asked) :]
        seen = seen + self.noise * self.rng.normal(size=seen.shape)
        whole = ("pose", "repeat")
        return [
            {name: int(v[k]) if name in whole else float(v[k]) for name, v in new.items()}
            | dict(zip(self.readings, seen[k].tolist(), strict=True))
            for k in range(len(asked))
        ]

    def missed(self, fit: sk.fit.Fit, joints: Floats) -> Floats:
        """How far (n,) a fit is off at new joints, read at once and without noise, mm."""
        assert self.told is not None, "something was read"
        n = len(joints)
        columns = dict(zip(self.joints, joints.T, strict=True))
        columns |= {"pose": np.arange(n) + 1e6, "repeat": np.ones(n), "time_s": self.clock_s + np.arange(n)}
        columns |= self.room(columns["time_s"])
        whole = {name: np.concatenate([self.told[name], columns[name]]) for name in self.told}
        true = self.exact(whole)[-n:]
        filled = whole | dict(zip(self.readings, self.exact(whole).T, strict=True))
        data = fit.model.as_declared(sk.from_frame(filled))
        return self.apart_mm(true, fit.model.predict(data, fit.values)[-n:, : true.shape[1]])

    def off(self, calibration: Any, joints: Floats) -> Floats:
        """How far (n,) places of a calibration are from where the robot really is at joints (n, j), mm: at the
        temperature and the moment that its promise is for, and of stands as cold as the drawing."""
        time_s, temperature_c = calibration.whole.now[:2]
        return self.apart_at(calibration, joints, {"time_s": time_s, "temperature_c": temperature_c})

    @abstractmethod
    def apart_at(self, calibration: Any, joints: Floats, now: Mapping[str, float]) -> Floats:
        """:meth:`off` at a moment and a temperature of the room."""

    def apart_mm(self, seen: Floats, told: Floats) -> Floats:
        """How far apart (n,) two sets of readings (n, m) are, mm."""
        return np.linalg.norm(seen - told, axis=1)


#: Of a row as it was read, its number, and what was read before it: what is told of it.
Change = Callable[[Any, Row, int, Rows], Row]


def driven(world: World, change: Change = lambda _, row, k, before: row, **settings: Any) -> sk.Adaptive:
    """A loop from its first row to its end, whose rows are changed before they are told."""
    loop = sk.Adaptive(world.robot, **settings)
    before: Rows = []
    while not loop.done:
        rows = []
        for row in world.read(loop.ask()):
            rows.append(change(world, row, len(before), before))
            before.append(row)
        loop.tell(rows)
    return loop


class DrivenDelta(World):
    """The linear delta of the second simulator."""

    joints, readings = ("q1_mm", "q2_mm", "q3_mm"), ("x_mm", "y_mm", "z_mm")

    def __init__(
        self, seed: int, hidden: Sequence[str] = (), ratio: float = 2.0, *, noise_um: float = 2.0, unknown: str = "",
        pace_s: float = PACE_S,
    ) -> None:  # fmt: skip
        super().__init__(seed, 1e-3 * noise_um, pace_s)
        self.robot = robot_from_tables(deepcopy(NOMINAL_CONFIG), "nominal")
        self.real, self.errors = (
            Robot.from_dict(NOMINAL_CONFIG),
            draw_geometric_errors(np.random.default_rng([seed, 1])),
        )
        plan = make_plan(self.real, grid(20.0, 6, (-15.0, 0.0, 15.0)), 1, "shuffled", seed, dwell_s=SPAN_S / 108 - 1.0)
        plan |= self.room(plan["time_s"])
        stands: dict[str, Any] = {"sensor_pose": draw_pose(np.random.default_rng([seed, 8]))}
        self.effects = dict(stands)
        for k, name in enumerate(hidden):
            rng = np.random.default_rng([seed, 2, k])
            drawn = scaled_effect(self.real, plan, name, rng, ratio * self.noise, errors=self.errors, beside=stands)
            self.effects |= drawn
        self.unknown: Callable[[Mapping[str, Floats], Floats], Floats] | None = None
        if unknown:
            own, turned = (
                UNKNOWN[unknown](np.random.default_rng([seed, 3])),
                Rotation.from_rotvec(self.effects["sensor_pose"][:3]),
            )

            def kind(columns: Mapping[str, Floats], point: Floats) -> Floats:
                """What moves the robot in the axes of its base, as the instrument sees it."""
                base = turned.inv().apply(point - self.effects["sensor_pose"][3:])
                return turned.apply(own(columns, base))

            at = truth(self.real, plan, self.errors, self.effects)
            basis, change = fitted_directions(self.real, plan, self.errors, stands), kind(plan, at).ravel()
            left = change - basis @ (basis.T @ change)
            size = ratio * self.noise / float(np.sqrt(np.mean(left**2)))
            self.unknown = lambda columns, point: size * kind(columns, point)

    def exact(self, columns: Mapping[str, Floats]) -> Floats:
        """As :class:`World` has it."""
        out = truth(self.real, columns, self.errors, self.effects)
        return out if self.unknown is None else out + self.unknown(columns, out)

    def apart_at(self, calibration: Any, joints: Floats, now: Mapping[str, float]) -> Floats:
        """Where the instrument sees it; lost motion is in its middle for nobody, and counts."""
        rows = {**dict(zip(self.joints, joints.T, strict=True)), **{n: np.full(len(joints), v) for n, v in now.items()}}
        rows |= {"humidity_pct": np.full(len(joints), 45.0)}
        stays = {name: value for name, value in self.effects.items() if name != "thermal_shift"}
        really = truth(self.real, rows, self.errors, stays)
        return self.apart_mm(really, calibration.forward_batch(joints, frame="sensor").require())


class DrivenSpherical(World):
    """The spherical robot before its camera, of the second simulator; it stands while it is read."""

    joints, readings = ("theta1_rad", "theta2_rad"), ("u_px", "v_px")

    def __init__(self, seed: int, hidden: Sequence[str] = (), ratio: float = 2.0, *, pace_s: float = PACE_S) -> None:
        super().__init__(seed, NOISE_PX, pace_s)
        self.robot, self.real = replace(ROBOT, phi_deg=(33.0, 147.0), gamma_deg=(19.0, 71.0)), real_robot(seed)
        plan = spherical_plan(PLANS["whole"][::5], 1, "shuffled", seed, SPAN_S / len(PLANS["whole"][::5]))
        plan |= self.room(plan["time_s"]) | {f"theta{i}_rad_per_s": 0.0 * plan["time_s"] for i in (1, 2)}
        # a camera that is part of the robot's file stands within what is known of it
        stands = np.random.default_rng([seed, 8]).normal(size=6) * ([np.deg2rad(0.1)] * 3 + [1.0] * 3)
        planted: dict[str, Any] = {"sensor_pose": stands}
        for name in hidden:
            rng = np.random.default_rng([seed, 2, tuple(SPHERICAL_EFFECTS).index(name)])
            planted |= self.real.at_ratio(name, ratio, NOISE_PX, plan, rng, (*GEOMETRY, "sensor_pose"))
        self.real.effects = planted

    def exact(self, columns: Mapping[str, Floats]) -> Floats:
        """As :class:`World` has it."""
        return self.real.truth({**columns, **{f"theta{i}_rad_per_s": 0.0 * columns["time_s"] for i in (1, 2)}})

    def apart_at(self, calibration: Any, joints: Floats, now: Mapping[str, float]) -> Floats:
        """Where the tool points, whatever camera and marker make of it."""
        rows = {n: np.full(len(joints), v) for n, v in now.items()}
        points = self.real.changed(effects={n: v for n, v in self.real.effects.items() if n not in _SEEN})
        points_at = points.angles(joints, direction=np.zeros_like(joints), velocity=np.zeros_like(joints), **rows)
        (phi, gamma), (told, slope) = points_at.T, calibration.forward_batch(joints).require().T
        turned = np.angle(np.exp(1j * (phi - told))) * np.sin(gamma)
        return np.asarray(calibration.radius_mm * np.hypot(turned, gamma - slope))

    def apart_mm(self, seen: Floats, told: Floats) -> Floats:
        """On the sphere, as the drawing's camera sees pixels."""
        radius_mm = self.real.radius_mm
        (phi, gamma), (phi_told, gamma_told) = (
            self.robot.seen.core.angles_batch(np.ascontiguousarray(px), radius_mm)[0].T for px in (seen, told)
        )
        return radius_mm * np.hypot((phi - phi_told) * np.sin(gamma), gamma - gamma_told)


class DrivenArm(World):
    """A UR5 before a laser tracker, by the simulator of arms that is written apart from the core."""

    readings = ("x_mm", "y_mm", "z_mm")

    def __init__(self, seed: int, hidden: Sequence[str] = (), ratio: float = 2.0, *, pace_s: float = PACE_S) -> None:
        super().__init__(seed, NOISE_MM, pace_s)
        with TemporaryDirectory() as folder:
            self.robot = arm_in(Path(folder))
        self.joints = self.robot.layout.joints
        stand = draw_pose(np.random.default_rng([seed, 8]))
        self.real = replace(SecondArm.simulated(self.robot, seed, 1.0, PLAIN), stand=stand)
        self._known: list[Floats] = []
        plan, plain = self._plan(seed), self.real
        for name in hidden:
            planted = hidden_at(self.robot, name, ratio, seed)
            # as large as asked for over this room and this half hour
            left = self._left(plan, plain, plain.with_hidden(**planted))
            by = ratio * NOISE_MM / float(np.sqrt(np.mean(left**2)))
            self.real = self.real.with_hidden(**{f: v if f == "per_turn" else by * v for f, v in planted.items()})

    def room(self, time_s: Floats) -> dict[str, Floats]:
        """A hall: of what a room does to an arm no tracker sees anything."""
        inside = super().room(time_s)
        return inside | {"temperature_c": 20.0 + _HALL * (inside["temperature_c"] - 20.0)}

    def _plan(self, seed: int) -> dict[str, Floats]:
        """Poses over the whole workspace and half an hour."""
        poses = postures(self.robot, 108, 0.9, seed)
        time_s = np.linspace(0.0, SPAN_S, len(poses))
        return dict(zip(self.joints, poses.T, strict=True)) | {"time_s": time_s} | self.room(time_s)

    def _left(self, plan: Mapping[str, Floats], plain: SecondArm, planted: SecondArm) -> Floats:
        """What the geometry leaves (n·m,) of that by which two arms differ; all, of what it takes whole."""
        seen = np.array(self._seen_by(plain, plan))
        rows = {"pose": np.arange(len(seen)), "repeat": np.ones(len(seen))} | dict(plan)
        model = model_of(self.robot)
        data = model.as_declared(sk.from_frame(rows | dict(zip(self.readings, seen.T, strict=True))))
        return left_by_geometry(model, data, np.array(self._seen_by(planted, plan)) - seen)

    def _seen_by(self, real: SecondArm, columns: Mapping[str, Floats], first: int = 0) -> list[Floats]:
        """What is seen of an arm at these rows, from the ``first`` on."""
        read = np.column_stack([columns[name] for name in self.joints])
        step = np.sign(np.diff(read, axis=0, prepend=read[:1] - 0.1))
        hidden, out = real.effects, []
        for k in range(first, len(read)):
            warm = float(columns["temperature_c"][k] - 20.0)
            late = bool(columns["time_s"][k] > SPAN_S / 2)
            point = real.true_target(read[k], step[k], 0.0 * read[k], 0, warm, 0.0, late)
            point = point * (1.0 + hidden.warmth_per_c * warm)
            point = point + np.asarray(hidden.rate_mm_h) * columns["time_s"][k] / 3600.0
            point = point + np.asarray(hidden.stand_mm_per_c) * warm
            out.append(real.seen(point, late, columns["time_s"][k] / 3600.0))
        return out

    def apart_at(self, calibration: Any, joints: Floats, now: Mapping[str, float]) -> Floats:
        """Where the tracker sees the target: an arm's base is where its own first axis is, of which its drawing says
        no more than a reading does."""
        warm, time_s = now["temperature_c"] - 20.0, now["time_s"]
        late, still, hidden = time_s > SPAN_S / 2, np.zeros_like(joints[0]), self.real.effects
        at = np.array([self.real.true_target(q, still, still, 0, warm, 0.0, late) for q in joints])
        at = at * (1.0 + hidden.warmth_per_c * warm) + np.asarray(hidden.rate_mm_h) * time_s / 3600.0
        seen = np.array([self.real.seen(point, late) for point in at])
        return self.apart_mm(seen, calibration.forward_batch(joints, frame="sensor").require())

    def exact(self, columns: Mapping[str, Floats]) -> Floats:
        """As :class:`World` has it; rows that were read once are remembered."""
        self._known += self._seen_by(self.real, columns, len(self._known))
        out = np.array(self._known)
        # places that are only looked at are no rows
        del self._known[0 if self.told is None else len(self.told["time_s"]) :]
        return out


# -- physics in no catalogue ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Unknown:
    """One of its kind, drawn: what it moves (n, 3) in rows with these columns and readings."""

    of: Callable[[Mapping[str, Floats], Floats], Floats]

    def __call__(self, columns: Mapping[str, Floats], point: Floats) -> Floats:
        """The displacement."""
        return self.of(columns, point)


def _direction(rng: np.random.Generator) -> Floats:
    drawn = rng.normal(size=3)
    return np.asarray(drawn / np.linalg.norm(drawn))


def _saddle(rng: np.random.Generator) -> Unknown:
    """A warped plate."""
    turn = rng.uniform(0.0, np.pi)

    def of(columns: Mapping[str, Floats], point: Floats) -> Floats:
        x, y, _ = point.T
        along, across = x * np.cos(turn) + y * np.sin(turn), y * np.cos(turn) - x * np.sin(turn)
        return np.outer(along * across, [0.0, 0.0, 1.0])

    return Unknown(of)


def _cycle(rng: np.random.Generator) -> Unknown:
    """The air conditioning, which nobody recorded."""
    way, period_s, phase = _direction(rng), rng.uniform(400.0, 1500.0), rng.uniform(0.0, 6.28)
    return Unknown(lambda columns, _: np.outer(np.sin(2.0 * np.pi * columns["time_s"] / period_s + phase), way))


def _humidity(rng: np.random.Generator) -> Unknown:
    """A plate that swells."""
    way = _direction(rng)
    return Unknown(lambda columns, _: np.outer(columns["humidity_pct"] - 45.0, way))


def _ripple(rng: np.random.Generator) -> Unknown:
    """A straightedge that is not straight."""
    axis, period_mm, phase, way = rng.integers(0, 2), rng.uniform(7.0, 20.0), rng.uniform(0.0, 6.28), _direction(rng)
    return Unknown(lambda _, point: np.outer(np.sin(2.0 * np.pi * point[:, axis] / period_mm + phase), way))


def _bow(rng: np.random.Generator) -> Unknown:
    """A guide that is bent along x, and pushes across."""
    share = rng.uniform(-1.0, 1.0, 2)
    return Unknown(lambda _, point: np.outer((point[:, 0] / 20.0) ** 3, [0.0, share[0], share[1]]))


def _cable(rng: np.random.Generator) -> Unknown:
    """A cable that hangs loose near its anchor and pulls beyond."""
    anchor = 30.0 * _direction(rng)

    def of(columns: Mapping[str, Floats], point: Floats) -> Floats:
        away = point - anchor
        far = np.linalg.norm(away, axis=1)
        return -away / far[:, None] * np.maximum(far - 25.0, 0.0)[:, None]

    return Unknown(of)


UNKNOWN: dict[str, Callable[[np.random.Generator], Unknown]] = {
    "saddle": _saddle, "cycle": _cycle, "humidity": _humidity, "ripple": _ripple, "bow": _bow, "cable": _cable,
}  # fmt: skip
