"""The worlds of ``standing_worlds`` with physics that no catalogue has in them, and the same machine at other poses:
what was promised of a run is asked there.

A world is told in one line, ``delta/1234/backlash@2+bumps@5``: which robot, which number, and what is hidden at how
many noises. Its physics is that of the second simulators, whatever adds to it a function of NumPy alone.
"""

from __future__ import annotations

import warnings
import zlib
from collections.abc import Mapping
from copy import copy
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import sherkit as sk
from second_machines import Hidden, scara, seen_from, stand_of, zeros_of
from second_simulator import make_plan, truth
from second_simulator.more_unnamed import MORE_KINDS
from second_simulator.plans import smooth_wander
from second_simulator.spherical import spherical_plan
from second_simulator.unnamed import (
    DELTA_KINDS,
    LEAST_LEFT,
    SPHERICAL_KINDS,
    STEP_MM,
    STEP_RAD,
    TRIALS,
    Kind,
    Scene,
    bowed_rails,
    humidity,
)
from sherkit.model.kinds import model_of
from standing_worlds import WORLDS, Arm, Columns, Delta, Scara, Sphere, Standing
from test_arm_counted import OwnArm
from test_serial import left_by_geometry

Floats = NDArray[np.float64]

SUITES = {"delta": "delta", "sphere": "sphere", "arm": "arm", "machine": "planar machine"}
#: Kinds that an arm or a machine can have: neither rails nor a column of the humidity.
_OF_ANY = tuple(kind for kind in DELTA_KINDS if kind not in (bowed_rails, humidity))
KNOWN: dict[str, tuple[Kind, ...]] = {
    "delta": tuple(DELTA_KINDS), "sphere": tuple(SPHERICAL_KINDS), "arm": _OF_ANY, "machine": _OF_ANY,
}  # fmt: skip
BY_NAME: dict[str, Kind] = {kind.__name__: kind for some in (*KNOWN.values(), MORE_KINDS) for kind in some}


def written(hidden: Mapping[str, float]) -> str:
    """What is hidden, in one word."""
    return "+".join(f"{name}@{ratio:g}" for name, ratio in hidden.items()) or "nothing"


def read(word: str) -> dict[str, float]:
    """The reverse."""
    return {name: float(at) for name, _, at in (one.partition("@") for one in word.split("+"))} if "@" in word else {}


class Fresh:
    """One world with something hidden: ``hidden`` holds effects of the robot and kinds of no catalogue by name, each at
    so many noises beside geometry and instrument."""

    def __init__(self, suite: str, number: int, hidden: Mapping[str, float]) -> None:
        self.suite, self.number, self.hidden = suite, number, dict(hidden)
        self.standing: Any = WORLDS[SUITES[suite]](number)
        self.effects = {name: at for name, at in hidden.items() if name not in BY_NAME}
        self.kinds = {name: at for name, at in hidden.items() if name in BY_NAME}

    @property
    def robot(self) -> Any:
        """As its file has it."""
        return self.standing.robot

    @property
    def noise(self) -> float:
        """Of one reading."""
        return float(self.standing.noise)

    @property
    def true_names(self) -> dict[str, set[str]]:
        """Of each effect that is hidden, the names under which it is found."""
        return {name: set(self.standing.effects[name]) for name in self.effects}

    @cached_property
    def _changes(self) -> tuple[Floats, Floats]:
        """What the kinds add to the readings (n, m) of this run and of the other one."""
        here, lever = scene_of(self.standing)
        there, _ = scene_of(self._other, lever)
        added = np.zeros_like(here.readings), np.zeros_like(there.readings)
        for name, ratio in self.kinds.items():
            one, other = self._sized(BY_NAME[name], ratio, here, there)
            added = added[0] + one, added[1] + other
        return added

    def _sized(self, kind: Kind, ratio: float, here: Scene, there: Scene) -> tuple[Floats, Floats]:
        """One kind, drawn again where the geometry takes it up whole."""
        for trial in range(TRIALS):
            seed = [self.number, 541, zlib.crc32(kind.__name__.encode()), trial]
            one, other = (kind(replace(scene, rng=np.random.default_rng(seed))) for scene in (here, there))
            if not np.any(np.abs(one) > 0):
                continue
            # in linear approximation: as small as a noise
            one, other = (
                change * self.noise / np.sqrt(np.mean(one**2)) for change in (one.astype(float), other.astype(float))
            )
            left = self._left(one)
            if left / self.noise > LEAST_LEFT:
                return one * ratio * self.noise / left, other * ratio * self.noise / left
        raise ValueError(f"{kind.__name__} is absorbed by the geometry")

    def _left(self, change: Floats) -> float:
        """The root mean square that geometry and instrument leave of it; nothing where they take all."""
        if isinstance(self.standing, Sphere):
            left = self.standing.left_of(change)
        else:
            left = left_by_geometry(model_of(self.robot), self.standing.exact_run(), change)
            if np.linalg.norm(left - change.ravel()) < 1e-9 * np.linalg.norm(left):
                return 0.0
        return float(np.sqrt(np.sum(left**2) / change.size))

    @cached_property
    def _other(self) -> Any:
        """The same machine, room and clock at other poses; those at the ends of each range are the same."""
        self.standing.exact(self.effects)  # how large effects are is told by the run
        return elsewhere(self.standing)

    def _exact(self, standing: Standing, added: Floats) -> Columns:
        """Columns without noise."""
        out = dict(standing.exact(self.effects))
        out |= {name: out[name] + added[:, k] for k, name in enumerate(standing.readings)}
        if "humidity_unrecorded" in self.kinds:
            out.pop("humidity_pct", None)
        return out

    def run(self) -> sk.Measurements:
        """As a laboratory writes it, read again."""
        columns = self._exact(self.standing, self._changes[0])
        rng = np.random.default_rng([self.number, 542, zlib.crc32(written(self.hidden).encode())])
        noisy = {name: columns[name] + self.noise * rng.normal(size=len(columns[name])) for name in self._readings}
        return self.standing._as_read(self.robot, columns | noisy)

    def error(self, fit: sk.fit.Fit) -> float:
        """By how many noises a fit is off at the other poses: root mean square of one reading, which has no noise."""
        run = self.standing._as_read(self.robot, self._exact(self._other, self._changes[1]))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            off = (run.readings - fit.model.predict(run, fit.values))[run.taken]
        return float(np.sqrt(np.mean(off**2)) / self.noise)

    @property
    def _readings(self) -> tuple[str, ...]:
        return tuple(self.standing.readings)

    def as_well(self, d: sk.diagnosis.Diagnosis) -> float:
        """The length, in noises of one reading, of what the columns of a diagnosis' fit leave of this run without its
        noise: below what can be seen in any run, nobody can tell."""
        exact = self.standing._as_read(self.robot, self._exact(self.standing, self._changes[0]))
        missed = (exact.readings - d.fit.model.predict(exact, d.fit.values))[exact.taken]
        columns = d.fit.model.derivatives(exact, d.fit.values)[exact.taken]
        columns = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
        left = missed - columns @ np.linalg.lstsq(columns, missed, rcond=1e-10)[0]
        return float(np.linalg.norm(left) / self.noise)


def elsewhere(world: Any) -> Any:
    """The same machine, instrument, room and clock, at other poses within the ranges of the first."""
    out = copy(world)
    out._made = {key: value for key, value in world._made.items() if not (isinstance(key, tuple) and key[-1] == "run")}
    rng = np.random.default_rng([world.number, 540])
    frame = world.exact({})
    first = np.unique(frame["pose"], return_index=True)[1]
    joints = np.stack([frame[name] for name in _joints_of(world)], axis=1)[first]
    seen = np.stack([frame[name] for name in world.readings], axis=1)[first]
    ends = np.unique([f(side) for side in (*joints.T, *seen.T) for f in (np.argmin, np.argmax)])
    if isinstance(world, Sphere | Delta):  # joints there go together: between any two poses of the run
        one, other = rng.integers(0, len(joints), (2, len(joints)))
        part = rng.uniform(0.2, 0.8, (len(joints), 1))
        drawn = part * joints[one] + (1.0 - part) * joints[other]
    else:
        drawn = rng.uniform(joints.min(axis=0), joints.max(axis=0), joints.shape)
    places = np.concatenate([joints[ends], drawn])[: len(joints)]
    if isinstance(world, Delta):
        # the plan's own places are not asked for: it holds the joints
        plan = make_plan(world.real, np.tile(world.real.target_offset, (len(places), 1)), 2, "shuffled", world.number)
        plan |= {f"q{i + 1}_mm": places[plan["pose"] - 1, i] for i in range(3)}
        plan |= {"temperature_c": world.plan["temperature_c"]}
        out.plan = plan
    elif isinstance(world, Sphere):
        out.plan = spherical_plan(places, 2, "shuffled", world.number) | {"temperature_c": world.plan["temperature_c"]}
    elif isinstance(world, Arm):
        out.poses = places
    else:
        out.places = places
    return out


def _joints_of(world: Any) -> list[str]:
    """Names of the columns of the joints."""
    return {
        Delta: [f"q{i}_mm" for i in (1, 2, 3)], Sphere: ["theta1_rad", "theta2_rad"],
        Scara: ["shoulder_rad", "elbow_rad", "quill_mm"],
    }.get(type(world)) or list(world.robot.layout.joints)  # fmt: skip


def scene_of(world: Any, lever: Floats | None = None) -> tuple[Scene, Floats]:
    """A world with nothing hidden, row by row in time; joints in mm that each moves the readings by, so that one that
    slides weighs as much as one that turns: by the ``lever`` (k,) of each, which is returned, by default that of these
    poses."""
    frame = world.exact({})
    time_s = np.asarray(frame["time_s"], dtype=float)
    assert np.all(np.diff(time_s) > 0), "rows are in the order of time"
    joints = np.stack([frame[name] for name in _joints_of(world)], axis=1)
    readings = np.stack([frame[name] for name in world.readings], axis=1)
    point, by_joint, by_point, by_radius = _MOVED[type(world)](world, joints, readings)
    if lever is None:
        lever = np.sqrt(np.mean(np.sum(by_joint**2, axis=1), axis=0))
    velocity = None
    if isinstance(world, Sphere):
        velocity = np.stack([world.plan[f"theta{i}_rad_per_s"] for i in (1, 2)], axis=1) * lever
    damp = frame.get("humidity_pct")
    if damp is None:
        damp = 45.0 + 5.0 * np.tanh(smooth_wander(np.random.default_rng([world.number, 543]), time_s - time_s[0]))
    scene = Scene(
        np.random.default_rng(0), time_s - time_s[0], np.asarray(frame["temperature_c"]), np.asarray(damp),
        joints * lever, point, readings, by_joint / lever, by_point, by_radius, velocity,
    )  # fmt: skip
    return scene, lever


_Moved = tuple[Floats, Floats, Floats, Floats | None]


def _differences(seen: Any, count: int, step: float) -> Floats:
    """Derivatives (n, m, count) of what is seen by the vector that it is given."""
    return np.stack([(seen(step * one) - seen(-step * one)) / (2 * step) for one in np.eye(count)], axis=2)


def _of_delta(world: Delta, joints: Floats, readings: Floats) -> _Moved:
    stands: dict[str, Any] = {"sensor_pose": world.stands}
    turn, shift = Rotation.from_rotvec(world.stands[:3]), world.stands[3:]

    def moved(by: Floats) -> Floats:
        plan = world.plan | {f"q{i + 1}_mm": joints[:, i] + by[i] for i in range(3)}
        return truth(world.real, plan, world.errors, stands)

    def wider(by: Floats) -> Floats:
        more = {f"base_radius_{i + 1}": world.errors[f"base_radius_{i + 1}"] + by[i] for i in range(3)}
        return truth(world.real, world.plan, world.errors | more, stands)

    by_point = np.broadcast_to(turn.as_matrix(), (len(joints), 3, 3))
    point = turn.inv().apply(readings - shift)
    return point, _differences(moved, 3, STEP_MM), by_point, _differences(wider, 3, STEP_MM)


def _of_arm(world: Arm, joints: Floats, readings: Floats) -> _Moved:
    stand, drawn = np.asarray(world.real.stand), OwnArm.drawn()
    turn, zeros = Rotation.from_rotvec(stand[:3]), np.asarray(world.real.offset)
    by_joint = _differences(lambda by: turn.apply(drawn.places(joints + zeros + by)), 6, STEP_RAD)
    by_point = np.broadcast_to(turn.as_matrix(), (len(joints), 3, 3))
    return turn.inv().apply(readings - stand[3:]), by_joint, by_point, None


def _of_scara(world: Scara, joints: Floats, readings: Floats) -> _Moved:
    stand, zeros = stand_of(world.number), zeros_of("scara", world.number)

    def moved(by: Floats) -> Floats:
        places = [scara(q + zeros, np.zeros(3), 0.0, 0.0, Hidden()) for q in joints + by]
        return seen_from(stand, np.array(places))

    point = (readings - stand[:3, 3]) @ stand[:3, :3]
    by_joint = _differences(moved, 3, STEP_RAD)
    return point, by_joint, np.broadcast_to(stand[:3, :3], (len(joints), 3, 3)), None


def _of_sphere(world: Sphere, joints: Floats, readings: Floats) -> _Moved:
    robot = world.real.changed(effects={"sensor_pose": world.stands})
    point = robot.markers(joints)
    by_joint = _differences(lambda by: robot.pixels(joints + by), 2, STEP_RAD)
    return point, by_joint, _differences(lambda by: robot.image(point + by), 3, STEP_MM), None


_MOVED: dict[type, Any] = {Delta: _of_delta, Arm: _of_arm, Scara: _of_scara, Sphere: _of_sphere}
