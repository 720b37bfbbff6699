"""Robots of all kinds before an instrument that somebody has put somewhere: where it stands, what joints and readings
are counted from, which joint stands still, the room and the clock are drawn.

Each world is one robot, its plan and its instrument, asked with this or that hidden in it; what is hidden is as large
as the geometry and a free pose of the instrument leave so many noises of it. Its physics is that of the second
simulators.
"""

from __future__ import annotations

import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, ClassVar

import numpy as np
import polars as pl
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import sherkit as sk
from conventions import written_otherwise
from second_arms import SecondArm
from second_machines import MACHINES, run_of, shift, stand_of, turn, zeros_of
from second_simulator import (
    CATALOGUE,
    Robot,
    draw_geometric_errors,
    draw_pose,
    draw_zeros,
    make_plan,
    room_temperature,
    scaled_effect,
    simulate,
)
from second_simulator.spherical import GEOMETRY, SPHERICAL_EFFECTS, draw_spherical_effect, spherical_plan
from sherkit.model.kinds import kind_of, model_of
from sherkit.model.robot_file import run_for
from sherkit.model.sensor_pose import HELD, POSE, KnownPose, SensorPose
from sherkit.robots.machine import load_machine
from sherkit.robots.serial import postures
from strategies import EXAMPLE
from test_arm_counted import arm_in
from test_machine import HIDDEN as OF_MACHINES
from test_serial import EFFECTS as OF_ARMS
from test_serial import NOISE_MM, PLAIN, left_by_geometry, payloads
from test_spherical_discovery import EFFECTS as OF_SPHERES
from test_spherical_discovery import NOISE_PX, PLANS, VIEW, real_robot
from test_spherical_discovery import ROBOT as SPHERE

Floats = NDArray[np.float64]
Columns = dict[str, Any]

SCARA = Path(__file__).parents[1] / "examples" / "machines" / "scara.py"
#: Poses of a run, each read twice.
POSES = 100
#: In every fourth world a joint stands still.
STILL = 4
#: How well a camera is known that is part of the robot's file, rad and mm.
OF_CAMERA = np.array([np.deg2rad(0.1)] * 3 + [1.0] * 3)


class Standing(ABC):
    """What all worlds share: ``number`` draws it."""

    #: Effects that can be hidden, each with the names under which it is found.
    effects: ClassVar[Mapping[str, set[str]]]
    robot: Any
    noise: float

    def __init__(self, number: int) -> None:
        self.number, self.rng = number, np.random.default_rng([number, 530])
        self._made: dict[Any, Any] = {}

    def still_of(self, joints: int) -> int | None:
        """Which joint stands still, if one does."""
        return self.number // (4 * STILL) % joints if self.stands_still else None

    @property
    def stands_still(self) -> bool:
        """Whether a joint does."""
        return self.number // 4 % STILL == STILL - 1

    @property
    def askable(self) -> list[str]:
        """What can be hidden: nothing where a joint stands still, since an effect of that is the constant of its zero,
        and what moves with the others is nearly a change of the geometry."""
        return [] if self.stands_still else list(self.effects)

    @abstractmethod
    def exact(self, hidden: Mapping[str, float]) -> Columns:
        """The run without noise, by our names; ``hidden`` at so many noises."""

    @property
    @abstractmethod
    def held(self) -> Any:
        """The robot whose instrument is known to stand where it does."""

    def where_it_stands(self) -> Mapping[str, float] | None:
        """By how much the sensor's pose is off that of the file, rad and mm; None where only what the readings tell of
        it, which is asked of a run without noise, can be compared."""
        return None

    @property
    def readings(self) -> tuple[str, ...]:
        """Names of what is read."""
        names: tuple[str, ...] = kind_of(self.robot).layout.coordinates
        return names

    def columns(self, hidden: Mapping[str, float] | None = None, ask: int = 0) -> Columns:
        """The run with the noise of this ``ask``."""
        out, rng = dict(self.exact(hidden or {})), np.random.default_rng([self.number, 531, ask])
        return out | {name: out[name] + self.noise * rng.normal(size=len(out[name])) for name in self.readings}

    def run(self, hidden: Mapping[str, float] | None = None, ask: int = 0) -> sk.Measurements:
        """The same as a laboratory writes it, read again."""
        return self._as_read(self.robot, self.columns(hidden, ask))

    def run_of(self, robot: Any) -> sk.Measurements:
        """The run with nothing hidden, read as one of another robot with the same columns."""
        return self._as_read(robot, self.columns())

    def _as_read(self, robot: Any, columns: Columns) -> sk.Measurements:
        table, names = written_otherwise(columns, self.number)
        with warnings.catch_warnings():
            # that units were converted is said, and asked for here
            warnings.simplefilter("ignore", sk.SherkitWarning)
            return run_for(robot, sk.from_frame(table, columns=names))

    def exact_run(self, hidden: Mapping[str, float] | None = None) -> sk.Measurements:
        """What would be read without noise, by our names."""
        return run_for(self.robot, sk.from_frame(pl.DataFrame(self.exact(hidden or {}))))

    def once(self, what: Any, make: Callable[[], Any]) -> Any:
        """What is made once."""
        if what not in self._made:
            self._made[what] = make()
        return self._made[what]

    def left(self, changed: Floats, plain: Floats) -> float:
        """The root mean square that geometry and pose leave of a change of readings (n, m)."""
        still = self.exact_run()
        return float(np.sqrt(np.mean(left_by_geometry(model_of(self.robot), still, changed - plain) ** 2)))


class Delta(Standing):
    """The linear delta: what hangs from its platform, joints and readings are counted from anywhere."""

    effects: ClassVar = {name: {name} for name in CATALOGUE if name != "sensor_pose"}
    noise = 5e-3

    def __init__(self, number: int) -> None:
        super().__init__(number)
        x, y, z = np.moveaxis(self.rng.uniform([-17, -17, -18], [17, 17, 18], (POSES, 3)), -1, 0)
        self.real, at = draw_zeros(self.rng, Robot.from_dict(), np.column_stack([x, y, z]))
        self.robot = replace(
            EXAMPLE, target_offset_mm=tuple(self.real.target_offset.tolist()), region_half_width_mm=None,
            workspace_radius_mm=float(np.hypot(x, y).max()), workspace_z_mm=(float(z.min()), float(z.max())),
        )  # fmt: skip
        self.plan = make_plan(self.real, at, 2, "shuffled", number)
        self.plan["temperature_c"] = room_temperature(self.rng, self.plan["time_s"], least_c=1.0)
        if (joint := self.still_of(3)) is not None:
            # no further away than all the others are from their middle
            name = f"q{joint + 1}_mm"
            self.plan[name] = np.full(len(self.plan[name]), self.plan[name].mean())
        self.errors = draw_geometric_errors(self.rng)
        self.stands = draw_pose(self.rng)

    def exact(self, hidden: Mapping[str, float]) -> Columns:
        """As :class:`Standing` has it."""
        stands: dict[str, Any] = {"sensor_pose": self.stands}
        planted = dict(stands)
        for name, ratio in hidden.items():
            rng = np.random.default_rng([self.number, 2, CATALOGUE.index(name)])
            planted |= self.once(
                (name, ratio), lambda name=name, ratio=ratio, rng=rng: scaled_effect(
                    self.real, self.plan, name, rng, ratio * self.noise, errors=self.errors, beside=stands
                )
            )  # fmt: skip
        return simulate(self.real, self.plan, self.errors, planted)

    @property
    def held(self) -> Any:
        """As :class:`Standing` has it."""
        return replace(self.robot, sensor_pose=_held(Rotation.from_rotvec(self.stands[:3]), self.stands[3:]))


class Arm(Standing):
    """A UR5 before a laser tracker; its first joint is counted from anywhere."""

    effects: ClassVar = {name: {name} for name in OF_ARMS}
    noise = NOISE_MM

    def __init__(self, number: int) -> None:
        super().__init__(number)
        with TemporaryDirectory() as folder:
            self.robot = arm_in(Path(folder))
        made = SecondArm.simulated(self.robot, number, 1.0, PLAIN)
        offset = np.array(made.offset)
        offset[0] = self.rng.uniform(-np.pi, np.pi)
        self.real = replace(made, noise_mm=0.0, stand=draw_pose(self.rng), offset=offset)
        self.poses = postures(self.robot, POSES, 0.9, number)
        if (joint := self.still_of(6)) is not None:
            self.poses[:, joint] = self.poses[0, joint]

    def _measured(self, effects: Mapping[str, Any]) -> sk.Measurements:
        hung = payloads(POSES, self.number)
        real = self.real.with_hidden(**effects)
        return real.measure(self.poses, repeats=2, seed=self.number, payload_kg=hung)

    def _unit(self, name: str) -> dict[str, Any]:
        """An effect as large as leaves one noise; what the geometry takes up whole, as large as that beside the
        drawing."""
        rng = np.random.default_rng([self.number, 2, list(OF_ARMS).index(name)])
        made: dict[str, Any] = {}
        for field, shape in OF_ARMS[name].items():
            made[field] = 1e-4 * rng.choice([-1.0, 1.0], shape) * rng.uniform(0.7, 1.3, shape)
            if field in ("knock", "settles"):
                made[field] *= [1e-3, 1e-3, 1e-3, 1.0, 1.0, 1.0]
        changed, plain = self._measured({"per_turn": 3.0, **made}), self.exact_run()
        by = self.noise / self.left(changed.readings[:, :3], plain.readings[:, :3])
        return {field: by * value for field, value in made.items()}

    def exact(self, hidden: Mapping[str, float]) -> Columns:
        """As :class:`Standing` has it."""
        effects: dict[str, Any] = {"per_turn": 3.0}
        for name, ratio in hidden.items():
            unit = self.once(name, lambda name=name: self._unit(name))
            effects |= {field: ratio * value for field, value in unit.items()}
        made = self.once((*hidden.items(), "run"), lambda: self._measured(effects))
        frame = made.to_frame()
        return {name: frame[name].to_numpy() for name in frame.columns}

    @property
    def held(self) -> Any:
        """As :class:`Standing` has it; the zero of the first joint is a turn of what it sees."""
        stand = np.asarray(self.real.stand)
        turned = Rotation.from_rotvec(stand[:3]) * Rotation.from_rotvec([0.0, 0.0, np.asarray(self.real.offset)[0]])
        return replace(self.robot, sensor_pose=_held(turned, stand[3:]))


class Scara(Standing):
    """A machine by one function: two arms in a plane and a quill, which stands still in every fourth world, so that all
    that is read lies in a plane; the zeros of its joints are off."""

    effects: ClassVar = {next(iter(sizes)): causes for sizes, causes in OF_MACHINES["scara"]}
    noise = MACHINES["scara"][3]
    #: Poses (n, 3), where they are not those drawn.
    places: Floats | None = None

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.robot = load_machine(SCARA)
        self._plain = {name: sizes for sizes, _ in OF_MACHINES["scara"] for name in list(sizes)[:1]}

    @property
    def askable(self) -> list[str]:
        """The arms move in every world: all but what a quill that stands still does."""
        return [name for name in self.effects if name != "quill_lean" or not self.stands_still]

    def _seen(self, sizes: Mapping[str, float]) -> pl.DataFrame:
        still = 2 if self.stands_still else None
        return run_of(
            "scara", self.number, sizes, poses=POSES, in_order=True, exact=True, still=still, places=self.places
        )

    def _unit(self, name: str) -> dict[str, float]:
        small = {one: 0.1 * size for one, size in self._plain[name].items()}
        changed, plain = (self._seen(sizes).select(self.readings).to_numpy() for sizes in (small, {}))
        by = self.rng.choice([-1.0, 1.0]) * self.noise / self.left(changed, plain)
        return {one: by * size for one, size in small.items()}

    def exact(self, hidden: Mapping[str, float]) -> Columns:
        """As :class:`Standing` has it."""
        sizes: dict[str, float] = {}
        for name, ratio in hidden.items():
            unit = self.once(name, lambda name=name: self._unit(name))
            sizes |= {one: ratio * size for one, size in unit.items()}
        frame = self._seen(sizes)
        return {name: frame[name].to_numpy() for name in frame.columns}

    @cached_property
    def held(self) -> Any:
        """As :class:`Standing` has it; zeros of shoulder and quill are where it stands."""
        zeros = zeros_of("scara", self.number)
        there = stand_of(self.number) @ turn(2, zeros[0]) @ shift(0.0, 0.0, -zeros[2])
        pose = _held(Rotation.from_matrix(there[:3, :3]), there[:3, 3])
        one = self.robot
        return sk.Machine(
            one.function, joints=one.joints, readings=one.readings, parameters=one.parameters, name="held",
            sensor_pose=pose,
        )  # fmt: skip


class Sphere(Standing):
    """The spherical robot before its camera, which is part of its file and stands within what is known of it."""

    effects: ClassVar = {name: {name} for name in OF_SPHERES}
    noise = NOISE_PX
    robot = SPHERE

    def __init__(self, number: int) -> None:
        super().__init__(number)
        where = PLANS[("whole", "local")[number % 2]]
        at = where[self.rng.choice(len(where), POSES, replace=False)]
        if (joint := self.still_of(2)) is not None:
            at = at.copy()
            at[:, joint] = at[:, joint].mean()
        self.plan = spherical_plan(at, 2, "shuffled", number)
        self.plan["temperature_c"] = room_temperature(self.rng, self.plan["time_s"], least_c=1.0)
        self.real = real_robot(number)
        self.stands = self.rng.normal(size=6) * OF_CAMERA

    def exact(self, hidden: Mapping[str, float]) -> Columns:
        """As :class:`Standing` has it."""
        planted: dict[str, Any] = {"sensor_pose": self.stands}
        for name, ratio in hidden.items():
            unit = self.once(name, lambda name=name: self._unit(name))
            fixed = SPHERICAL_EFFECTS[name].fixed
            scaled = ratio * unit
            scaled[len(unit) - fixed :] = unit[len(unit) - fixed :]
            planted[name] = scaled
        return self.real.changed(effects=planted).run(self.plan, seed=self.number)

    def _unit(self, name: str) -> Floats:
        """An effect as large as leaves one noise beside α, β, R and a camera that stands no further off than is known
        of it: what that would take up by standing elsewhere shows."""
        drawn = draw_spherical_effect(name, np.random.default_rng([self.number, 2, OF_SPHERES.index(name)]))
        amplitudes = len(drawn) - SPHERICAL_EFFECTS[name].fixed
        drawn[:amplitudes] *= 0.05
        plain = self.real.changed(effects={"sensor_pose": self.stands})
        change = self.real.changed(effects={"sensor_pose": self.stands, name: drawn}).truth(self.plan) - plain.truth(
            self.plan
        )
        drawn[:amplitudes] *= self.noise / np.sqrt(np.sum(self.left_of(change) ** 2) / change.size)
        return drawn

    def left_of(self, change: Floats) -> Floats:
        """What α, β, R and the camera, no further off than is known of it, leave of a change (n, 2) of the pixels:
        (2 n + 6,), the last six by how much the camera would contradict what is known."""
        geometry, camera = (
            np.stack([(self._moved(one, 1e-3) - self._moved(one, -1e-3)).ravel() / 2e-3 for one in names], axis=1)
            for names in (tuple(GEOMETRY), POSE)
        )
        known = np.hstack([np.zeros((6, 3)), np.diag(self.noise / OF_CAMERA)])
        columns = np.vstack([np.hstack([geometry, camera]), known])
        wanted = np.concatenate([change.ravel(), np.zeros(6)])
        scale = np.linalg.norm(columns, axis=0)
        return wanted - columns @ (np.linalg.lstsq(columns / scale, wanted, rcond=1e-12)[0] / scale)

    def _moved(self, name: str, by: float) -> Floats:
        """Pixels of the robot of which one number is larger, rad or mm."""
        stands = self.stands + by * (np.array(POSE) == name)
        more = {name: getattr(self.real, name) + by} if name in GEOMETRY else {}
        return self.real.changed(effects={"sensor_pose": stands}, **more).truth(self.plan)

    @property
    def held(self) -> Any:
        """As :class:`Standing` has it: the file has the camera's true place."""
        camera = VIEW.parameters
        turned = Rotation.from_rotvec(self.stands[:3]) * Rotation.from_rotvec(camera[9:12])
        moved = (camera[12:] + self.stands[3:]).tolist()
        view = replace(VIEW, rotation_rad=tuple(turned.as_rotvec().tolist()), translation_mm=tuple(moved))
        return replace(self.robot, camera=view, sensor_pose=KnownPose(shift_sd_mm=HELD, turn_sd_deg=HELD))

    def where_it_stands(self) -> Mapping[str, float]:
        """As :class:`Standing` has it."""
        return dict(zip(POSE, self.stands, strict=True))


def _held(turned: Rotation, origin: Floats) -> SensorPose:
    """Known, all of it."""
    rpy = tuple(turned.as_euler("xyz", degrees=True).tolist())
    return SensorPose(tuple(np.asarray(origin).tolist()), rpy, HELD, HELD)


#: By name.
WORLDS: dict[str, type[Standing]] = {"delta": Delta, "arm": Arm, "planar machine": Scara, "sphere": Sphere}
