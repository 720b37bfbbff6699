"""Arms in the field, written apart: one part of the workspace is measured, others are asked; gears ripple, loads bend
joints, and the drawing is off by what makers state or by more.

Nothing of sherkit makes the readings; frames and gears are those of :mod:`gear_worlds`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import polars as pl

import sherkit as sk
from gear_worlds import AXES, HIGH, LOW, SHIFTS, TOOL, TURN, turned
from sherkit.model.kinds import robot_from_tables

#: Rows of a run, and poses that are asked in each other region.
ROWS, ASKED = 200, 25
#: One size of what a drawing is off by: places of frames mm, directions of axes rad, zeros rad, tool mm.
SIZES = (1.0, 5e-3, 1e-2, 5.0)
#: What makers state of an arm: half a millimetre or a millimetre at its tip.
STATED = (0.2, 3e-4, 5e-4, 1.0)
#: Names of the other regions.
REGIONS = ("near", "far", "above")
#: So many sides of the box that was measured another one is away that is beside it or above.
_NEAR = 1.5
#: Middles of regions are so far (rad) inside the limits.
_INSIDE = 0.3


@dataclass(frozen=True)
class Arm:
    """An arm as it is beside its drawing: what is drawn, by how much it is off, what gears and loads do to it."""

    shifts: np.ndarray
    off: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
    ripple: np.ndarray
    per_turn: np.ndarray
    phase: np.ndarray
    bends: np.ndarray
    noise_mm: float
    tracker: tuple[np.ndarray, np.ndarray]

    def drawn(self, q: np.ndarray) -> np.ndarray:
        """Where the drawing has the target (n, 3), base frame."""
        return _tips(q, self.shifts, AXES, TOOL)[0]

    def base(self, q: np.ndarray) -> np.ndarray:
        """Where the target is (n, 3), base frame."""
        shifts, tilts, zeros, tool = self.off
        axes = AXES + tilts
        axes = axes / np.linalg.norm(axes, axis=1)[:, None]
        q = q + zeros + self.ripple * np.sin(self.per_turn * q + self.phase)
        tip, at, along = _tips(q, self.shifts + shifts, axes, TOOL + tool)
        # a weight at the tip turns each joint by its moment about that joint's axis
        moment = np.einsum("kni,kni->nk", along, np.cross(tip - at, [0.0, 0.0, -1.0]))
        return _tips(q + self.bends * moment, self.shifts + shifts, axes, TOOL + tool)[0]

    def seen(self, q: np.ndarray) -> np.ndarray:
        """The same as the tracker sees it, without noise."""
        turn, place = self.tracker
        return self.base(q) @ turn.T + place

    def tables(self) -> dict[str, Any]:
        """The arm's file, as it is drawn, before a tracker that stands anywhere."""
        low, high = np.rad2deg([LOW, HIGH])
        joints = [
            {"name": f"J{k + 1}", "type": "revolute", "origin_mm": self.shifts[k].tolist(), "rpy_deg": [0.0] * 3,
             "axis": AXES[k].tolist(), "limits_deg": [float(low[k]) - 20, float(high[k]) + 20]}
            for k in range(6)
        ]  # fmt: skip
        tool = {"target_mm": TOOL.tolist(), "rpy_deg": [0.0] * 3}
        tracker = {"origin_mm": [0.0] * 3, "rpy_deg": [0.0] * 3}
        return {"kind": "serial", "joint": joints, "tool": tool, "tracker": tracker}

    def robot(self, *, spread: tuple[float, ...] = ()) -> Any:
        """As sherkit reads it; with the ``spread`` by which it was drawn, as :data:`SIZES`, stated in its file."""
        tables = self.tables()
        if spread:
            sorts = zip(("shift", "tilt", "offset", "tool"), spread, ("mm", "rad", "rad", "mm"), strict=True)
            tables["tolerances"] = {name: f"{size:.12g} {unit}" for name, size, unit in sorts}
        return robot_from_tables(tables, "arm.toml")


@dataclass(frozen=True)
class Field:
    """An arm, the run of one part of its workspace, and postures in each other region by its name."""

    arm: Arm
    joints: np.ndarray
    read: np.ndarray
    asked: dict[str, np.ndarray]
    inside: np.ndarray

    def run(self, *, declared: bool = False) -> sk.Measurements:
        """As sherkit reads it; with the tracker's noise ``declared``, as its data sheet has it."""
        layout = self.arm.robot().layout
        columns = dict(zip(layout.joints, self.joints.T, strict=True))
        columns |= dict(zip(("x_mm", "y_mm", "z_mm"), self.read.T, strict=True))
        if declared:
            columns |= dict.fromkeys(layout.sigmas[:3], np.full(len(self.read), self.arm.noise_mm))
        return sk.from_frame(pl.DataFrame(columns))


def _tips(joints: np.ndarray, shifts: np.ndarray, axes: np.ndarray, tool: np.ndarray) -> tuple[np.ndarray, ...]:
    """Where the tool is (n, 3), and where the joints are (6, n, 3) and point to (6, n, 3)."""
    turn, at, places, along = np.tile(np.eye(3), (len(joints), 1, 1)), np.zeros((len(joints), 3)), [], []
    for k in range(6):
        at = at + turn @ shifts[k]
        places.append(at)
        along.append(turn @ axes[k])
        turn = turn @ turned(axes[k], joints[:, k])
    return at + turn @ tool, np.array(places), np.array(along)


def spread_of(sizes: float | None) -> tuple[float, ...]:
    """Standard deviations by which a drawing is off that is so by so many :data:`SIZES`, or as makers state."""
    return STATED if sizes is None else tuple(sizes * one for one in SIZES)


def field(seed: int, *, sizes: float | None = None, rows: int = ROWS, bare: bool = False) -> Field:
    """A world by its seed. The drawing is off by so many ``sizes``, or by what makers state where that is None; left
    ``bare``, nothing ripples or bends."""
    rng = np.random.default_rng([seed, 56])
    shifts = SHIFTS * rng.uniform(0.5, 1.4) * rng.uniform(0.85, 1.15, SHIFTS.shape)
    by = spread_of(sizes)
    off = (by[0] * rng.normal(size=(6, 3)), by[1] * rng.normal(size=(6, 3)), by[2] * rng.normal(size=6),
           by[3] * rng.normal(size=3))  # fmt: skip
    # the base is that of the first joint: nothing of that is off in it, nor how high the second stands along its axis
    # and to where its axis points about that
    off[0][0], off[1][0], off[2][0], off[0][1, 2], off[1][1, 0] = 0.0, 0.0, 0.0, 0.0, 0.0
    noise = float(rng.uniform(0.01, 0.05))
    reach = float(np.abs(shifts).sum()) / 2.0
    # at full reach gears ripple by up to a tenth of a millimetre, and a weight bends shoulder and elbow by up to half
    rippling = rng.permutation(6) < rng.integers(0, 4)
    ripple = np.where(rippling, rng.uniform(0.02, 0.1, 6) / reach, 0.0) * (0.0 if bare else 1.0)
    bends = np.array([0.0, *rng.uniform(0.05, 0.5, 2), 0.0, 0.05, 0.0]) / reach**2 * (0.0 if bare else 1.0)
    axis = rng.normal(size=3)
    turn = turned(axis / np.linalg.norm(axis), np.array([rng.uniform(0.0, np.pi)]))[0]
    arm = Arm(shifts, off, ripple, rng.integers(30, 251, 6).astype(float), rng.uniform(0, TURN, 6), bends, noise,
              (turn, rng.normal(0, 1500.0, 3)))  # fmt: skip
    # a box of places, with the tool always as it was or turned about: half its side, and half the angle
    size, turned_by = rng.uniform(0.08, 0.25) * reach / 2.0, float(np.exp(rng.uniform(*np.log([2e-3, 0.4]))))
    while True:
        middle = rng.uniform(LOW + _INSIDE, HIGH - _INSIDE)
        joints = _over(rng, arm, middle, np.zeros(3), size, turned_by, rows)
        inside = _over(rng, arm, middle, np.zeros(3), size, turned_by, 2 * ASKED)
        asked = {name: _somewhere(rng, name, arm, middle, size, turned_by) for name in REGIONS}
        if len(joints) == rows and all(len(q) >= ASKED for q in (inside, *asked.values())):
            break
    read = arm.seen(joints)
    return Field(arm, joints, read + rng.normal(0, noise, read.shape), asked, inside)


def _somewhere(
    rng: np.random.Generator, name: str, arm: Arm, middle: np.ndarray, size: float, turned_by: float
) -> np.ndarray:
    """Postures (n, 6) of another region: beside the one that was measured, above it, or anywhere else and turned."""
    if name == "far":
        return _over(rng, arm, rng.uniform(LOW + _INSIDE, HIGH - _INSIDE), np.zeros(3), size, turned_by, ASKED)
    way = np.array([0.0, 0.0, 1.0]) if name == "above" else np.append(rng.normal(size=2), 0.0)
    return _over(rng, arm, middle, 2.0 * _NEAR * size * way / np.linalg.norm(way), size, turned_by, ASKED)


def _over(
    rng: np.random.Generator, arm: Arm, middle: np.ndarray, shift: np.ndarray, size: float, turned_by: float, count: int
) -> np.ndarray:
    """Postures (count, 6), or fewer where too many are out of reach, with the tool in a box about a posture's place
    (``shift``ed, half a side in mm) and turned from how it is there by up to an angle: damped Newton steps."""
    tool, n = np.array(TOOL), 3 * count
    (tip,), (turn,) = _tips(middle[None], arm.shifts, AXES, tool)[0], _turns(middle[None])
    places = tip + shift + rng.uniform(-size, size, (n, 3))
    axis = rng.normal(size=(n, 3))
    by = rng.uniform(0, turned_by, n)
    turns = np.array([turned(a / np.linalg.norm(a), np.array([b]))[0] for a, b in zip(axis, by, strict=True)]) @ turn
    q = np.tile(middle, (n, 1)) + rng.normal(0, 1e-3, (n, 6))
    reach = float(np.abs(arm.shifts).sum())
    for _ in range(60):
        at, joints, along = _tips(q, arm.shifts, AXES, tool)
        wrong = turns @ _turns(q).transpose(0, 2, 1)
        spin = 0.5 * np.stack([wrong[:, 2, 1] - wrong[:, 1, 2], wrong[:, 0, 2] - wrong[:, 2, 0],
                               wrong[:, 1, 0] - wrong[:, 0, 1]], axis=1)  # fmt: skip
        off = np.concatenate([(places - at) / reach, spin], axis=1)
        columns = np.concatenate([np.cross(along, at - joints) / reach, along], axis=2).transpose(1, 2, 0)
        step = np.linalg.solve(columns.transpose(0, 2, 1) @ columns + 1e-6 * np.eye(6),
                               np.einsum("nik,ni->nk", columns, off)[:, :, None])[:, :, 0]  # fmt: skip
        q = q + np.clip(step, -0.2, 0.2)
    there = (np.abs(off).max(axis=1) < 1e-6) & ((q >= LOW - 0.3) & (q <= HIGH + 0.3)).all(axis=1)
    return q[there][:count]


def _turns(joints: np.ndarray) -> np.ndarray:
    """How the tool is turned (n, 3, 3) by the drawing."""
    turn = np.tile(np.eye(3), (len(joints), 1, 1))
    for k in range(6):
        turn = turn @ turned(AXES[k], joints[:, k])
    return turn


def best_frame(made: np.ndarray, real: np.ndarray) -> float:
    """Root of the mean squared distance (mm) of places (n, 3) in the best rigid frame (Kabsch)."""
    a, b = made - made.mean(axis=0), real - real.mean(axis=0)
    left, _, right = np.linalg.svd(a.T @ b)
    turn = left @ np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right))]) @ right
    return float(np.sqrt(np.square(a @ turn - b).sum(axis=1).mean()))
