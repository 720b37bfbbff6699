"""Nominal linear delta robot, planted geometric errors and closed-form inverse kinematics.

Lengths are in mm and angles in rad, except in the configuration, whose keys carry their unit.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Errors = Mapping[str, float | Array]

NOMINAL_CONFIG: dict[str, Any] = {
    "kind": "delta",
    "geometry": {
        "base_radius_mm": [90.0, 90.0, 90.0],
        "base_angle_deg": [90.0, 210.0, 330.0],
        "platform_radius_mm": [30.0, 30.0, 30.0],
        "platform_angle_deg": [90.0, 210.0, 330.0],
        "rod_length_mm": [120.0, 120.0, 120.0],
        "rod_spacing_mm": 40.0,
        "target_offset_mm": [0.0, 0.0, -25.0],
    },
    "joints": {"pole_pitch_mm": 2.0},
    "workspace": {"radius_mm": 30.0, "z_mm": [-22.0, 22.0]},
    "region_of_interest": {"half_width_mm": 10.0},
}

# A laboratory may count heights and readings from anywhere on its table.
ZEROS_MM = 50.0
# The four groups a geometric calibration fits, with the default sd of a drawn error (mm, rad).
FITTED_SIZES: dict[str, float] = {
    "base_radius": 1.0, "base_angle": float(np.deg2rad(0.5)), "joint_offset": 0.5, "rod_length": 0.5,
}  # fmt: skip
ERROR_GROUPS = (*FITTED_SIZES, "platform_radius", "platform_angle")


@dataclass(frozen=True)
class Robot:
    """Three vertical rails; limb i runs from carriage i down to the hanging platform.

    Arrays hold one value per limb, except ``target_offset``: the measured point relative to the
    platform centre, in the platform frame.
    """

    base_radius: Array
    base_angle: Array
    platform_radius: Array
    platform_angle: Array
    rod_length: Array
    rod_spacing: float
    target_offset: Array
    pole_pitch: float
    workspace_radius: float
    # Direction of each limb's rod-pair axes, alike at carriage and platform: a rail planted elsewhere
    # keeps its limb a parallelogram, so that only unequal rods tilt the platform.
    pair_angle: Array
    joint_offset: Array = field(default_factory=lambda: np.zeros(3))

    @classmethod
    def from_dict(cls, config: Mapping[str, Any] = NOMINAL_CONFIG) -> Robot:
        """Robot described by a configuration laid out as ``NOMINAL_CONFIG``."""
        geometry = config["geometry"]
        return cls(
            base_radius=np.array(geometry["base_radius_mm"], float),
            base_angle=np.deg2rad(geometry["base_angle_deg"]),
            platform_radius=np.array(geometry["platform_radius_mm"], float),
            platform_angle=np.deg2rad(geometry["platform_angle_deg"]),
            rod_length=np.array(geometry["rod_length_mm"], float),
            rod_spacing=float(geometry["rod_spacing_mm"]),
            target_offset=np.array(geometry["target_offset_mm"], float),
            pole_pitch=float(config["joints"]["pole_pitch_mm"]),
            workspace_radius=float(config["workspace"]["radius_mm"]),
            pair_angle=np.deg2rad(geometry["platform_angle_deg"]),
        )

    def platform_joints(self) -> Array:
        """Limb attachment points p_i in the platform frame, (3, 3), mm."""
        return self.platform_radius[:, None] * radial(self.platform_angle)


def radial(angle: Array) -> Array:
    """Horizontal unit vectors pointing outwards at ``angle`` (rad), (n, 3)."""
    return np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=-1)


def tangential(angle: Array) -> Array:
    """Horizontal unit vectors e_t, a quarter turn ahead of ``radial``, (n, 3)."""
    return np.stack([-np.sin(angle), np.cos(angle), np.zeros_like(angle)], axis=-1)


def with_errors(robot: Robot, errors: Errors | None) -> Robot:
    """Real robot: nominal plus errors named ``base_radius_1`` (scalar) or ``base_radius`` (3)."""
    changes: dict[str, Any] = {}
    for name, value in (errors or {}).items():
        stem, _, limb = name.rpartition("_")
        if name in ERROR_GROUPS:
            group, where = name, np.ones(3)
        elif stem in ERROR_GROUPS and limb in ("1", "2", "3"):
            group, where = stem, np.eye(3)[int(limb) - 1]
        else:
            raise ValueError(f"unknown geometric error {name!r}")
        changes[group] = changes.get(group, getattr(robot, group)) + where * value
    return replace(robot, **changes)


def draw_geometric_errors(rng: np.random.Generator, sizes: Mapping[str, float] | None = None) -> dict[str, float]:
    """Gaussian errors keyed ``group_i``; ``sizes`` (sd in mm, rad) overrides or adds groups.

    The twelve fitted errors are always drawn; platform groups only when ``sizes`` names them.
    """
    sizes = FITTED_SIZES | dict(sizes or {})
    if unknown := set(sizes) - set(ERROR_GROUPS):
        raise ValueError(f"unknown error groups {sorted(unknown)}")
    return {f"{group}_{i}": sd * rng.normal() for group, sd in sizes.items() for i in (1, 2, 3)}


def inverse_kinematics(robot: Robot, points: Array) -> Array:
    """Carriage heights (n, 3) putting the measured point of an untilted platform at ``points``.

    Each limb needs |C_i - (c + p_i)| = l_i; its carriage is above the platform, so the higher of
    the two heights on the rail is the assembled one.
    """
    centre = np.atleast_2d(points) - robot.target_offset
    rails = robot.base_radius[:, None] * radial(robot.base_angle)
    reach = (centre[:, None, :] + robot.platform_joints() - rails)[..., :2]
    drop_squared = robot.rod_length**2 - np.sum(reach**2, axis=-1)
    if np.any(drop_squared <= 0):
        raise ValueError("a point is out of reach of the rods")
    return centre[:, 2:] + np.sqrt(drop_squared) - robot.joint_offset


def draw_zeros(rng: np.random.Generator, robot: Robot, points: Array) -> tuple[Robot, Array]:
    """Where things are counted from, mm, each within 50 mm at random: the robot with another measured point, the
    points (n, 3) at which that is when the platform is where ``points`` had it."""
    while True:
        target_offset = rng.uniform(-ZEROS_MM, ZEROS_MM, 3)
        try:
            # joints are counted from where the measured point is at the origin: that place must be there
            inverse_kinematics(replace(robot, target_offset=target_offset), np.zeros(3))
            break
        except ValueError:
            continue
    moved = points + target_offset - robot.target_offset
    return replace(robot, target_offset=target_offset), moved


def write_robot_toml(path: str | Path, config: Mapping[str, Any] = NOMINAL_CONFIG) -> None:
    """Write the robot description; top-level scalars come first, as TOML demands."""

    def lines(table: Mapping[str, Any]) -> list[str]:
        # The repr of a number, a list of numbers or a plain word is valid TOML as it stands.
        plain = {k: str(v).lower() if isinstance(v, bool) else repr(v) for k, v in table.items()}
        return [f"{k} = {plain[k]}" for k, v in table.items() if not isinstance(v, Mapping)]

    text = lines(config)
    for name, table in config.items():
        if isinstance(table, Mapping):
            text += ["", f"[{name}]", *lines(table)]
    Path(path).write_text("\n".join(text) + "\n", encoding="utf-8")
