"""A virtual serial arm: planted errors, noise, and a tracker that looks at it.

Written apart from the core on purpose: frames are 4 x 4 matrices multiplied as the drawing has them, and what a joint
carries is the slope of the energy of its weights by a difference, never the code that is to be tested with them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import scipy
from numpy.typing import ArrayLike

from ...base import linalg
from ...base.types import Floats
from ...data import Measurements
from ...data.toml import Table
from ...model.kinds import Option, walked
from .frames import Triple
from .robot import CENTRE, PAYLOAD, PLANE, TARGET, Serial

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

# -- Sets of postures ---------------------------------------------------------------------------------------------

#: Postures of each, and the part of the limits that a local set keeps to.
_WHOLE, _LOCAL, _PART = 60, 40, 0.2


def postures(robot: Serial, count: int, share: float = 1.0, seed: int = 0) -> Floats:
    """Joint readings (count, k), at random within ``share`` of the limits about home."""
    low, high = robot.ranges
    middle = np.clip(robot.home, low, high)
    at = np.random.default_rng(seed).uniform(size=(count, len(low)))
    return middle + share * (low + at * (high - low) - middle)


#: All that the joints can reach, and the middle of it.
AREAS: Mapping[str, Callable[[Serial], Floats]] = {
    "whole": lambda robot: postures(robot, _WHOLE),
    "local": lambda robot: postures(robot, _LOCAL, _PART),
}


# -- The arm ------------------------------------------------------------------------------------------------------

_SECONDS_PER_POSE = 4.0
_STEP_RAD = 1e-4
_GRAVITY = 9.80665
#: Plausible geometric errors of an arm: zeros of joints, rad; places of axes and target, mm; leans, rad; where the
#: tracker stands, mm and rad.
_SIZES = {"offset": 3e-3, "shift": 0.5, "tilt": 1e-3, "tool": 2.0, "stand": 20.0, "turn": 0.02}
#: A sliding joint errs by as many mm as a turning one by a radian.
_SLIDE_MM = 100.0


#: By how much the room of a run warms, and how quickly, by the run.
_WARMS_C, _QUICK = 3.0, 2.0


def _behind(part: Floats, lag: float) -> Floats:
    """How far something has warmed (n,), of one, at these parts of a run whose room warms as ``1 - exp(-2 part)``: it
    comes behind with a lag, in parts of the run, ``lag dS/dpart + S`` being the room."""
    if lag <= 0.0:
        return np.asarray(1.0 - np.exp(-_QUICK * part))
    if abs(_QUICK * lag - 1.0) < 1e-6:
        lag *= 1.0 + 1e-5
    led = 1.0 / (1.0 - _QUICK * lag)
    return np.asarray(1.0 - led * np.exp(-_QUICK * part) + (led - 1.0) * np.exp(-part / lag))


@dataclass(frozen=True)
class Hidden:
    """What is hidden in an arm besides its geometry, each zero where it is not at work; rad, or mm of joints that
    slide.

    ``scale`` (k,) are parts of the readings; ``follows`` (k,) by how much each joint follows the one before it;
    ``gives`` (k,) how far it gives way under the greatest moment its weight makes in any posture stretched out;
    ``sags`` (k,) how far by the moment that a payload makes about it, rad/(N m), or by its force, mm/N;
    ``play`` (k,) its lost motion; ``ring`` (k, 2) sine and cosine of its encoder once per turn, ``lines`` (k, 2) those
    at ``per_turn`` per radian, ``twice`` (k, 2) at twice that; ``warmth_per_c`` of the whole, ``growth_per_c``
    (k + 1,) of the base and of the link behind each joint, ``rate_mm_h`` (3,), ``step_mm`` (3,) half way through,
    ``lost`` (k,) what joints slipped by then;
    ``stand_mm_per_c`` (3,) what the stand does, ``stand_lag_s`` behind the room; ``knock`` (6,) turn and shift of the
    tracker half way through; ``zoom`` and ``bend_mm`` (3,) at a metre what the tracker misreads; ``late_s``
    its delay; ``bar_mm`` what is added to every distance.
    """

    scale: ArrayLike = 0.0
    follows: ArrayLike = 0.0
    gives: ArrayLike = 0.0
    sags: ArrayLike = 0.0
    play: ArrayLike = 0.0
    ring: ArrayLike = 0.0
    lines: ArrayLike = 0.0
    twice: ArrayLike = 0.0
    per_turn: float = 2.0
    warmth_per_c: float = 0.0
    growth_per_c: ArrayLike = 0.0
    rate_mm_h: ArrayLike = 0.0
    step_mm: ArrayLike = 0.0
    lost: ArrayLike = 0.0
    stand_mm_per_c: ArrayLike = 0.0
    stand_lag_s: float = 0.0
    knock: ArrayLike = 0.0
    zoom: float = 0.0
    bend_mm: ArrayLike = 0.0
    late_s: float = 0.0
    bar_mm: float = 0.0


@dataclass(frozen=True)
class VirtualSerial:
    """An arm that is not as drawn.

    ``offset`` (k,) are errors of the joints' zeros, ``shift_mm`` (k, 2) and ``tilt_rad`` (k, 2) how far each axis lies
    beside its place and leans, in its frame; ``tool_mm`` (3,) or (t, 3) moves the targets, ``centres_mm`` (c, 3) the
    centres of distances, ``planes`` (p, 4) turns planes about the base's axes, rad, and lifts them, mm; ``stand`` (6,)
    is a turn and a shift of what the tracker sees, rad and mm. ``noise_mm`` is the standard deviation of a reading,
    ``distance_noise_mm`` that of a distance, the same unless it is given.
    """

    robot: Serial
    offset: ArrayLike = 0.0
    shift_mm: ArrayLike = 0.0
    tilt_rad: ArrayLike = 0.0
    tool_mm: ArrayLike = 0.0
    stand: ArrayLike = 0.0
    effects: Hidden = field(default_factory=Hidden)
    noise_mm: float = 0.0
    centres_mm: ArrayLike = 0.0
    distance_noise_mm: float | None = None
    planes: ArrayLike = 0.0

    OPTIONS: ClassVar[Mapping[str, Option]] = {
        "noise_um": Option(50.0, "of a reading"),
        "yield_mrad": Option(0.0, "joints that give way by this much under their weight"),
        "play_mrad": Option(0.0, "lost motion of each joint"),
        "ring_mrad": Option(0.0, "encoders off the axis of their joints"),
    }

    @classmethod
    def simulated(cls, robot: Serial, seed: int, errors: float, sizes: Mapping[str, float]) -> VirtualSerial:
        """One with geometric errors of ``errors`` times a plausible size, and ``sizes`` of each of :attr:`OPTIONS`."""
        rng, k = np.random.default_rng(seed), len(robot.joints)
        slide = np.where([joint.slides for joint in robot.joints], _SLIDE_MM, 1.0)
        drawn = {name: errors * size * rng.normal(size=(k, 3)) for name, size in _SIZES.items()}
        hidden = Hidden(
            gives=1e-3 * sizes["yield_mrad"] * slide * rng.uniform(0.5, 1.5, k),
            play=1e-3 * sizes["play_mrad"] * slide * rng.uniform(0.5, 1.5, k),
            ring=1e-3 * sizes["ring_mrad"] * (slide == 1.0)[:, None] * rng.normal(size=(k, 2)),
        )
        tools, centres = drawn["tool"][0], np.zeros((len(robot.centres_mm), 3))
        if more := len(robot.more_targets_mm):
            tools = np.vstack([tools, errors * _SIZES["tool"] * rng.normal(size=(more, 3))])
        if len(centres):
            centres = errors * _SIZES["tool"] * rng.normal(size=centres.shape)
        return cls(
            robot,
            drawn["offset"][:, 0] * slide,
            drawn["shift"][:, :2],
            drawn["tilt"][:, :2],
            tools,
            np.concatenate([drawn["turn"][0], drawn["stand"][0]]),
            hidden,
            1e-3 * sizes["noise_um"],
            centres,
            planes=errors * np.array([*3 * [_SIZES["turn"]], _SIZES["tool"]]) * rng.normal(size=(len(robot.planes), 4)),
        )

    @classmethod
    def hidden(cls, robot: Serial, seed: int, table: Table) -> VirtualSerial:
        """One without noise, as a laboratory describes it."""
        sizes = {name: table.number(name, 0.0) for name in cls.OPTIONS if name != "noise_um"}
        return cls.simulated(robot, seed, table.number("errors", 0.0), {"noise_um": 0.0, **sizes})

    def with_hidden(self, **effects: Any) -> VirtualSerial:
        """The same with more hidden in it."""
        return replace(self, effects=replace(self.effects, **effects))

    def truth(self) -> dict[str, Any]:
        """The hidden errors, for TOML: mm and rad."""
        k = len(self.robot.joints)
        shapes = {"offset": (k,), "shift_mm": (k, 2), "tilt_rad": (k, 2), "stand": (6,)}
        shapes["tool_mm"] = (1 + len(self.robot.more_targets_mm), 3) if self.robot.more_targets_mm else (3,)
        if self.robot.centres_mm:
            shapes["centres_mm"] = (len(self.robot.centres_mm), 3)
        if self.robot.planes:
            shapes["planes"] = (len(self.robot.planes), 4)
        own = {name: np.broadcast_to(getattr(self, name), shape).tolist() for name, shape in shapes.items()}
        more = {name: np.asarray(value, dtype=float).tolist() for name, value in vars(self.effects).items()}
        return {**own, "effects": more}

    # -- what it does ------------------------------------------------------------------------------------------

    def _frames(self, joints: Floats, *, as_drawn: bool = False, grown: Floats | None = None) -> list[Floats]:
        """Frames (4, 4) behind each joint for what the joints really are (k,), turned back to those of the drawing;
        with the parts (k + 1,) by which base and links are longer."""
        k, turns = len(joints), scipy.spatial.transform.Rotation
        shift, tilt = (np.broadcast_to(np.asarray(v, dtype=float), (k, 2)) for v in (self.shift_mm, self.tilt_rad))
        longer = np.ones(k) if grown is None else 1.0 + grown[:k]
        now, out = np.eye(4), []
        for joint, q, s, t, longer_by in zip(self.robot.joints, joints, shift, tilt, longer, strict=True):
            mount, back = _mount(tuple(joint.rpy_deg), tuple(joint.origin_mm), tuple(joint.axis))
            there = mount.copy()
            if not as_drawn:
                lean = turns.from_rotvec([t[0], 0, 0]) * turns.from_rotvec([0, t[1], 0])
                there = there @ _matrix(turns.identity(), (s[0], s[1], 0.0)) @ _matrix(lean)
            there[:3, 3] *= longer_by
            now = now @ there
            moved = _matrix(turns.identity(), (0, 0, q)) if joint.slides else _matrix(turns.from_rotvec([0, 0, q]))
            now = now @ moved @ back
            out.append(now)
        return out

    def _energy(self, joints: Floats) -> float:
        """Of the weights as drawn, over one unit of gravity: kg mm."""
        masses, centres = self.robot.weights
        pull = np.asarray(self.robot.gravity, dtype=float) / np.linalg.norm(self.robot.gravity)
        out = 0.0
        frames = self._frames(joints, as_drawn=True)
        for joint, frame, mass, centre in zip(self.robot.joints, frames, masses, centres, strict=True):
            where = frame @ _matrix(_aligning(tuple(joint.axis))) @ [*centre, 1.0]
            out -= float(mass * (pull @ where[:3]))
        return out

    def _carried(self, joints: Floats) -> Floats:
        """The moment or force (k,) that the weights put on each joint, over the greatest they could."""
        masses, centres = self.robot.weights
        out = np.zeros(len(joints))
        for i, joint in enumerate(self.robot.joints):
            step = np.where(np.arange(len(joints)) == i, _STEP_RAD, 0.0)
            slope = (self._energy(joints + step) - self._energy(joints - step)) / (2 * _STEP_RAD)
            arms = np.cumsum([0.0, *(float(np.linalg.norm(one.origin_mm)) for one in self.robot.joints[i + 1 :])])
            sensitivities = np.ones(len(arms)) if joint.slides else arms + np.linalg.norm(centres[i:], axis=1)
            most = float(masses[i:] @ sensitivities)
            out[i] = -slope / most if most > 0 else 0.0
        return out

    def _hung(self, joints: Floats, payload_kg: float) -> Floats:
        """The moment, N m, or force, N, (k,) that a weight at the first target as drawn puts on each joint."""
        pull = np.asarray(self.robot.gravity, dtype=float) / np.linalg.norm(self.robot.gravity)
        out = np.zeros(len(joints))

        def height(q: Floats) -> float:
            frame = self._frames(q, as_drawn=True)[-1]
            return -float(pull @ (frame @ [*self.robot.target_mm, 1.0])[:3])

        for i, joint in enumerate(self.robot.joints):
            step = np.where(np.arange(len(joints)) == i, _STEP_RAD, 0.0)
            falls = (height(joints - step) - height(joints + step)) / (2 * _STEP_RAD)
            out[i] = payload_kg * _GRAVITY * falls / (1.0 if joint.slides else 1000.0)
        return out

    def true_target(
        self, read: Floats, came: Floats, velocity: Floats, number: int = 0, warmer_c: float = 0.0,
        payload_kg: float = 0.0, late: bool = False,
    ) -> Floats:  # fmt: skip
        """A target (3,), mm, base frame, for joints that are read (k,), with the direction from which they came, the
        links warmer than the drawing, and what hangs at the first target; ``late`` once joints have slipped."""
        k, hidden = len(read), self.effects
        home = np.array([np.deg2rad(j.home) if not j.slides else j.home for j in self.robot.joints])

        def each(value: ArrayLike, *more: int) -> Floats:
            return np.broadcast_to(np.asarray(value, dtype=float), (k, *more))

        ring, lines, twice = each(hidden.ring, 2), each(hidden.lines, 2), each(hidden.twice, 2)
        real = read + each(self.offset) + each(hidden.scale) * (read - home)
        real = real + ring[:, 0] * np.sin(read) + ring[:, 1] * np.cos(read)
        angle = hidden.per_turn * read
        real = real + lines[:, 0] * np.sin(angle) + lines[:, 1] * np.cos(angle)
        real = real + twice[:, 0] * np.sin(2 * angle) + twice[:, 1] * np.cos(2 * angle)
        real = real + each(hidden.play) * came / 2 - hidden.late_s * velocity
        real = real + each(hidden.lost) * late
        drawn = np.array([joint.follows for joint in self.robot.joints])
        before = np.concatenate([[0.0], (real - home)[:-1]])
        led = np.concatenate([[0.0], real[:-1]])
        real = real + drawn * led + each(hidden.follows) * before
        bent = np.zeros(k)
        if np.any(each(hidden.gives)):
            bent = each(hidden.gives) * self._carried(real)
        if np.any(each(hidden.sags)):
            bent = bent + each(hidden.sags) * self._hung(real, payload_kg)
        real = real + bent
        grown = warmer_c * np.broadcast_to(np.asarray(hidden.growth_per_c, dtype=float), (k + 1,))
        target = np.asarray(self.robot.targets_mm[number], dtype=float)
        tools = np.broadcast_to(np.asarray(self.tool_mm, dtype=float), (len(self.robot.targets_mm), 3))
        moved = _aligning(tuple(self.robot.joints[-1].axis)).as_matrix() @ tools[number]
        return (self._frames(real, grown=grown)[-1] @ [*((target + moved) * (1.0 + grown[-1])), 1.0])[:3]

    def seen(self, point: Floats, late: bool) -> Floats:
        """What the tracker shows (3,), mm."""
        stand = np.broadcast_to(np.asarray(self.stand, dtype=float), 6).copy()
        if late:
            stand = stand + np.broadcast_to(np.asarray(self.effects.knock, dtype=float), 6)
        turns = scipy.spatial.transform.Rotation
        nominal = turns.from_euler("xyz", self.robot.sensor_pose.rpy_deg, degrees=True)
        there = turns.from_rotvec(stand[:3]).apply(nominal.apply(point))
        there = there + np.asarray(self.robot.sensor_pose.origin_mm) + stand[3:]
        bend = np.asarray(self.effects.bend_mm, dtype=float)
        return there * (1.0 + self.effects.zoom) + bend * (there / 1000.0) ** 3

    def distance(self, point: Floats, number: int) -> Floats:
        """How far a point is from a centre, mm, as the first of three numbers."""
        off = np.broadcast_to(np.asarray(self.centres_mm, dtype=float), (len(self.robot.centres_mm), 3))[number]
        centre = np.asarray(self.robot.centres_mm[number]) + off
        return np.array([float(np.sqrt(np.sum((point - centre) ** 2))) + self.effects.bar_mm, 0.0, 0.0])

    def height(self, point: Floats, number: int) -> Floats:
        """How far a point is above a plane, mm, as the first of three numbers."""
        drawn = self.robot.planes[number]
        *turn, lift = np.broadcast_to(np.asarray(self.planes, dtype=float), (len(self.robot.planes), 4))[number]
        up = scipy.spatial.transform.Rotation.from_rotvec(turn).apply(np.asarray(drawn.normal, dtype=float))
        above = up @ (point - np.asarray(drawn.at_mm)) / float(np.sqrt(np.sum(up**2)))
        return np.array([float(above) - lift, 0.0, 0.0])

    def noise_free(self, joints: ArrayLike) -> Floats:
        """What a run without noise, time and motion would hold (n, 3), mm."""
        rows = np.atleast_2d(np.asarray(joints, dtype=float))
        still = np.zeros(rows.shape[1])
        return np.array([self.seen(self.true_target(q, still, still), False) for q in rows])

    def measure(
        self, joints: ArrayLike, *, repeats: int = 1, order: str = "shuffled", seed: int = 0,
        payload_kg: ArrayLike | None = None,
    ) -> Measurements:  # fmt: skip
        """Drives to joint readings (n, k) and reads the target at each; half way through, what lets go lets go.

        An arm is sent to joints, not to places: a place leaves open how it stands there. It warms by three degrees.
        ``payload_kg``, one or (n,) for the poses, hangs at the first target; left out, nothing does, and no such
        column is written.
        """
        rng = np.random.default_rng(seed)
        poses = np.atleast_2d(np.asarray(joints, dtype=float))
        pose, said = walked(len(poses), repeats, order, rng)
        n, read, hidden = len(pose), poses[pose], self.effects
        time = _SECONDS_PER_POSE * np.arange(n)
        payload = np.broadcast_to(np.asarray(0.0 if payload_kg is None else payload_kg, dtype=float), len(poses))[pose]
        came = np.sign(np.diff(read, axis=0, prepend=read[:1] - 0.1))
        velocity = rng.normal(size=read.shape) * np.ptp(read, axis=0) / 10.0 if hidden.late_s else np.zeros_like(read)
        warmth = 20.0 + _WARMS_C * _behind(np.arange(n) / max(n - 1, 1), 0.0)
        stand = _WARMS_C * _behind(np.arange(n) / max(n - 1, 1), hidden.stand_lag_s / max(time[-1], 1.0))
        targets, centres = range(len(self.robot.targets_mm)), range(len(self.robot.centres_mm))
        planes = range(len(self.robot.planes))
        reads: list[tuple[int, int | None, int | None]] = (
            [(t, None, None) for t in targets] if self.robot.has_tracker else []
        )
        reads += [(t, c, None) for t in targets for c in centres]
        reads += [(t, None, p) for t in targets for p in planes]
        shown = []
        for k in range(n):
            late = k >= n // 2
            for target, centre, plane in reads:
                warmer = float(warmth[k] - 20.0)
                point = self.true_target(read[k], came[k], velocity[k], target, warmer, float(payload[k]), late)
                point = point * (1.0 + hidden.warmth_per_c * (warmth[k] - 20.0))
                point = point + np.asarray(hidden.rate_mm_h) * time[k] / 3600.0 + np.asarray(hidden.step_mm) * late
                point = point + np.asarray(hidden.stand_mm_per_c) * stand[k]
                if centre is not None:
                    shown.append(self.distance(point, centre))
                else:
                    shown.append(self.seen(point, late) if plane is None else self.height(point, plane))
        reading = np.array(shown) + self.noise_mm * rng.normal(size=(len(shown), 3))
        layout = self.robot.layout
        columns: dict[str, Any] = {"time_s": time, "temperature_c": warmth, **said}
        if payload_kg is not None:
            columns[PAYLOAD] = payload
        columns |= dict(zip(layout.joints, read.T, strict=True))
        if hidden.late_s:
            columns |= dict(zip(layout.velocities, velocity.T, strict=True))
        columns = {name: np.repeat(values, len(reads), axis=0) for name, values in columns.items()}
        if len(targets) > 1:
            columns[TARGET] = np.tile([target + 1 for target, _, _ in reads], n)
        if centres or planes:
            ends = np.array([[np.nan if one is None else one + 1.0 for one in end] for _, *end in reads])
            noise = self.noise_mm if self.distance_noise_mm is None else self.distance_noise_mm
            far = np.array(shown)[:, 0] + noise * rng.normal(size=len(shown))
            is_place = np.tile(np.isnan(ends).all(axis=1), n)
            columns |= dict(zip((CENTRE, PLANE), np.tile(ends, (n, 1)).T, strict=True))
            columns["distance_mm"] = np.where(is_place, np.nan, far)
            reading = np.where(is_place[:, None], reading, np.nan)
        columns |= dict(zip(layout.coordinates, reading.T, strict=True))
        return Measurements.from_columns(columns, "simulation", layout=layout)


def _matrix(turn: Rotation, shift_mm: ArrayLike = (0.0, 0.0, 0.0)) -> Floats:
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = turn.as_matrix(), shift_mm
    return out


@lru_cache(maxsize=256)
def _mount(rpy_deg: Triple, origin_mm: Triple, axis: Triple) -> tuple[Floats, Floats]:
    """A joint as drawn (4, 4), its z along its axis, and the turn back (4, 4)."""
    turn = scipy.spatial.transform.Rotation.from_euler("xyz", rpy_deg, degrees=True)
    aligned = _matrix(_aligning(axis))
    return _matrix(turn, origin_mm) @ aligned, linalg.inv(aligned)


@lru_cache(maxsize=256)
def _aligning(axis: Triple) -> Rotation:
    """The turn of least angle that brings z onto an axis; where that is -z, about x."""
    turns = scipy.spatial.transform.Rotation
    u = np.asarray(axis, dtype=float) / np.linalg.norm(axis)
    across = np.cross([0.0, 0.0, 1.0], u)
    sine = float(np.linalg.norm(across))
    if sine < 1e-12:
        return turns.identity() if u[2] > 0 else turns.from_rotvec([np.pi, 0.0, 0.0])
    return turns.from_rotvec(across / sine * np.arctan2(sine, u[2]))
