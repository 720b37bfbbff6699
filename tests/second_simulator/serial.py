"""Serial arms with hidden errors and effects, by formulas that share no code with sherkit's.

Frames are 4 x 4 matrices multiplied as the drawing has them, and what a joint carries is the slope of the energy of its
weights by a difference. :class:`ArmPhysics` is what an arm and its instruments do, row by row; what is hidden in it is
said by the class that it is mixed into (``second_arms.py``).
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

Floats = NDArray[np.float64]
Triple = tuple[float, float, float]

STEP_RAD = 1e-4
GRAVITY = 9.80665


class ArmPhysics:
    """What a virtual arm does: its ``robot`` as drawn, the errors of its geometry, and its ``effects``."""

    robot: Any
    effects: Any
    offset: ArrayLike
    shift_mm: ArrayLike
    tilt_rad: ArrayLike
    tool_mm: ArrayLike
    stand: ArrayLike
    centres_mm: ArrayLike
    planes: ArrayLike

    def shown(self, slips_s: float, block: Any) -> Floats:
        """What instruments without noise show (n, 4), mm: three coordinates, and a distance or height."""
        joints, ends, known, _ = block
        k, hidden = joints.shape[1], self.effects
        out = np.zeros((len(joints), 4))
        for row, (read, covariates) in enumerate(zip(joints, known, strict=True)):
            time, warmth, number, payload, stand = (covariates[j] for j in (0, 1, -3, -2, -1))
            late, came, velocity = time >= slips_s, covariates[2 : 2 + k], covariates[2 + k : 2 + 2 * k]
            point = self.true_target(read, came, velocity, int(number) - 1, warmth - 20.0, payload, late)
            point = point * (1.0 + hidden.warmth_per_c * (warmth - 20.0))
            point = point + np.asarray(hidden.rate_mm_h) * time / 3600.0
            point = point + np.asarray(hidden.stand_mm_per_c) * (stand - 20.0)
            out[row, :3] = self.seen(point, late, time / 3600.0)
            centre, plane = (np.nan, np.nan) if ends is None else ends[row]
            if np.isfinite(centre):
                out[row, 3] = self.distance(point, int(centre) - 1)
            elif np.isfinite(plane):
                out[row, 3] = self.height(point, int(plane) - 1)
        return out

    def _frames(self, joints: Floats, *, as_drawn: bool = False, grown: Floats | None = None) -> list[Floats]:
        """Frames (4, 4) behind each joint for what the joints really are (k,), turned back to those of the drawing;
        with the parts (k + 1,) by which base and links are longer."""
        k, turns = len(joints), Rotation
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
            step = np.where(np.arange(len(joints)) == i, STEP_RAD, 0.0)
            slope = (self._energy(joints + step) - self._energy(joints - step)) / (2 * STEP_RAD)
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
            step = np.where(np.arange(len(joints)) == i, STEP_RAD, 0.0)
            falls = (height(joints - step) - height(joints + step)) / (2 * STEP_RAD)
            out[i] = payload_kg * GRAVITY * falls / (1.0 if joint.slides else 1000.0)
        return out

    def true_target(
        self, read: Floats, came: Floats, velocity: Floats, number: int = 0, warmer_c: float = 0.0,
        payload_kg: float = 0.0, late: bool = False,
    ) -> Floats:  # fmt: skip
        """A target (3,), mm, base frame, for joints that are read (k,), with the direction from which they came, the
        links warmer than the drawing, and what hangs at the first target; ``late`` once joints and targets have
        slipped."""
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
        moved = tools[number] + np.asarray(hidden.step_mm) * late
        moved = _aligning(tuple(self.robot.joints[-1].axis)).as_matrix() @ moved
        return (self._frames(real, grown=grown)[-1] @ [*((target + moved) * (1.0 + grown[-1])), 1.0])[:3]

    def seen(self, point: Floats, late: bool, hours: float = 0.0) -> Floats:
        """What the tracker shows (3,), mm."""
        stand = np.broadcast_to(np.asarray(self.stand, dtype=float), 6).copy()
        if late:
            stand = stand + np.broadcast_to(np.asarray(self.effects.knock, dtype=float), 6)
        stand = stand + hours * np.broadcast_to(np.asarray(self.effects.settles, dtype=float), 6)
        turns = Rotation
        nominal = turns.from_euler("xyz", self.robot.sensor_pose.rpy_deg, degrees=True)
        there = turns.from_rotvec(stand[:3]).apply(nominal.apply(point))
        there = there + np.asarray(self.robot.sensor_pose.origin_mm) + stand[3:]
        bend = np.asarray(self.effects.bend_mm, dtype=float)
        return there * (1.0 + self.effects.zoom) + bend * (there / 1000.0) ** 3

    def distance(self, point: Floats, number: int) -> float:
        """How far a point is from a centre, mm."""
        off = np.broadcast_to(np.asarray(self.centres_mm, dtype=float), (len(self.robot.centres_mm), 3))[number]
        centre = np.asarray(self.robot.centres_mm[number]) + off
        return float(np.sqrt(np.sum((point - centre) ** 2))) + self.effects.bar_mm

    def height(self, point: Floats, number: int) -> float:
        """How far a point is above a plane, mm."""
        drawn = self.robot.planes[number]
        *turn, lift = np.broadcast_to(np.asarray(self.planes, dtype=float), (len(self.robot.planes), 4))[number]
        up = Rotation.from_rotvec(turn).apply(np.asarray(drawn.normal, dtype=float))
        above = up @ (point - np.asarray(drawn.at_mm)) / float(np.sqrt(np.sum(up**2)))
        return float(above) - lift


def _matrix(turn: Rotation, shift_mm: ArrayLike = (0.0, 0.0, 0.0)) -> Floats:
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = turn.as_matrix(), shift_mm
    return out


@lru_cache(maxsize=256)
def _mount(rpy_deg: Triple, origin_mm: Triple, axis: Triple) -> tuple[Floats, Floats]:
    """A joint as drawn (4, 4), its z along its axis, and the turn back (4, 4)."""
    turn = Rotation.from_euler("xyz", rpy_deg, degrees=True)
    aligned = _matrix(_aligning(axis))
    return _matrix(turn, origin_mm) @ aligned, np.linalg.inv(aligned)


@lru_cache(maxsize=256)
def _aligning(axis: Triple) -> Rotation:
    """The turn of least angle that brings z onto an axis; where that is -z, about x."""
    turns = Rotation
    u = np.asarray(axis, dtype=float) / np.linalg.norm(axis)
    across = np.cross([0.0, 0.0, 1.0], u)
    sine = float(np.linalg.norm(across))
    if sine < 1e-12:
        return turns.identity() if u[2] > 0 else turns.from_rotvec([np.pi, 0.0, 0.0])
    return turns.from_rotvec(across / sine * np.arctan2(sine, u[2]))
