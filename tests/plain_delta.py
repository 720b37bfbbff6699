"""A linear delta in plain NumPy: carriages on rails, rods, platform. It shares no code with sherkit.

``Delta(seed)`` has errors of its geometry; ``run`` measures it at places of the drawing, from a tracker that stands
anywhere. What a careless day makes of such a run (encoders frozen, noise, one pose …) is in :data:`CARELESS`.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Floats = NDArray[np.float64]
Run = dict[str, Floats]

_AT = np.deg2rad([90.0, 210.0, 330.0])
_ROD, _BASE, _PLATFORM, _DOWN = 120.0, 90.0, 30.0, 25.0
_STEPS = 30
READINGS, JOINTS = ("x_mm", "y_mm", "z_mm"), ("q1_mm", "q2_mm", "q3_mm")


class Delta:
    """Lengths in mm, angles in rad, one value for each limb."""

    def __init__(self, seed: int = 0, size: float = 1.0) -> None:
        rng = np.random.default_rng([seed, 77])
        self.base_radius = _BASE + size * 0.1 * rng.normal(size=3)
        self.base_angle = _AT + size * 0.7e-3 * rng.normal(size=3)
        self.rod_length = _ROD + size * 0.1 * rng.normal(size=3)
        self.joint_offset = size * 0.1 * rng.normal(size=3)

    def with_moved(self, name: str, by: float) -> Delta:
        """The same machine with one number of its geometry another, such as ``rod_length_2``."""
        made, (what, _, limb) = deepcopy(self), name.rpartition("_")
        getattr(made, what)[int(limb) - 1] += by
        return made

    def at(self, joints: Floats) -> Floats:
        """Where it stands (n, 3) at joint readings (n, 3): the lower meeting of three spheres, by Newton's method."""
        height = joints + self.joint_offset
        centre = np.empty((len(joints), 3, 3))
        centre[:, :, 0] = self.base_radius * np.cos(self.base_angle) - _PLATFORM * np.cos(_AT)
        centre[:, :, 1] = self.base_radius * np.sin(self.base_angle) - _PLATFORM * np.sin(_AT)
        centre[:, :, 2] = height
        found = np.column_stack([np.zeros((len(joints), 2)), height.mean(axis=1) - 100.0])
        for _ in range(_STEPS):
            arm = found[:, None] - centre
            short = np.square(arm).sum(axis=2) - self.rod_length**2
            found = found - np.linalg.solve(2.0 * arm, short[..., None])[..., 0]
        return np.asarray(found - [0.0, 0.0, _DOWN])


def joints_for(places: Floats) -> Floats:
    """Joints (n, 3) of places (n, 3) by the drawing."""
    base = (_BASE - _PLATFORM) * np.stack([np.cos(_AT), np.sin(_AT)], axis=1)
    flat = np.square(places[:, None, :2] - base).sum(axis=2)
    return np.asarray(places[:, 2:] + _DOWN + np.sqrt(_ROD**2 - flat))


def places(rng: np.random.Generator, count: int) -> Floats:
    """Places (n, 3) over the workspace."""
    every = rng.uniform([-25.0, -25.0, -20.0], [25.0, 25.0, 20.0], (4 * count, 3))
    return np.asarray(every[np.hypot(every[:, 0], every[:, 1]) < 27.0][:count])


def run(
    machine: Delta, seed: int, count: int = 60, repeats: int = 2, noise_um: float = 5.0, at: Floats | None = None,
    turned: float = 1e-2,
) -> Run:  # fmt: skip
    """A run in random order, from where a tracker stands that was ``turned`` (rad) and shifted."""
    rng = np.random.default_rng([seed, 78])
    where = places(rng, count) if at is None else at
    pose = rng.permutation(np.repeat(np.arange(len(where)), repeats))
    joints = joints_for(where)[pose]
    turn, shift = Rotation.from_rotvec(turned * rng.uniform(-1.0, 1.0, 3)), rng.uniform(-1.0, 1.0, 3)
    read = turn.apply(machine.at(joints)) + shift + 1e-3 * noise_um * rng.normal(size=joints.shape)
    times = {"time_s": 4.0 * np.arange(len(pose)), "pose": pose + 1.0}
    return times | dict(zip(JOINTS, joints.T, strict=True)) | dict(zip(READINGS, read.T, strict=True))


def _frozen(machine: Delta, seed: int) -> Run:
    made = run(machine, seed)
    return made | {name: np.full(len(made[name]), made[name][0]) for name in JOINTS}


def _zeros(machine: Delta, seed: int) -> Run:
    made = run(machine, seed)
    return made | {name: 0.0 * made[name] for name in READINGS}


def _stuck(machine: Delta, seed: int) -> Run:
    made = run(machine, seed)
    return made | {"z_mm": np.full(len(made["z_mm"]), made["z_mm"][0])}


def _encoder(machine: Delta, seed: int) -> Run:
    made = run(machine, seed)
    return made | {"q2_mm": np.full(len(made["q2_mm"]), made["q2_mm"][0])}


def _corner(count: int, repeats: int) -> Callable[[Delta, int], Run]:
    """So many places, 3 mm apart on a line."""
    where = np.column_stack([-18.0 + 3.0 * np.arange(count), np.full((count, 2), [-18.0, -20.0])])
    return lambda machine, seed: run(machine, seed, repeats=repeats, at=where)


#: What a careless day makes of a run: nothing of it says that the machine is as it was.
CARELESS: dict[str, Callable[[Delta, int], Run]] = {
    "frozen": _frozen,
    "noisy": lambda machine, seed: run(machine, seed, noise_um=1000.0),
    "one pose": _corner(1, 200),
    "three poses": _corner(3, 5),
    "six poses": _corner(6, 1),
    "zeros": _zeros,
    "z stuck": _stuck,
    "one encoder stuck": _encoder,
    "another robot": lambda _, seed: run(Delta(seed + 500, 5.0), seed),
}

ROBOT: dict[str, Any] = {
    "kind": "delta",
    "geometry": {
        "base_radius_mm": [_BASE] * 3, "base_angle_deg": [90.0, 210.0, 330.0], "platform_radius_mm": [_PLATFORM] * 3,
        "platform_angle_deg": [90.0, 210.0, 330.0], "rod_length_mm": [_ROD] * 3, "rod_spacing_mm": 40.0,
        "target_offset_mm": [0.0, 0.0, -_DOWN],
    },
    "joints": {"pole_pitch_mm": 2.0},
    "workspace": {"radius_mm": 30.0, "z_mm": [-22.0, 22.0], "required_um": 20.0},
}  # fmt: skip
