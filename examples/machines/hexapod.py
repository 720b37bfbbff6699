"""A hexapod driven by the lengths of its six legs: where the platform is follows from them by an equation, solved by
Newton's method for all rows at once. A tracker reads a target on the platform."""

import numpy as np

import sherkit as sk


def ring(radius, *degrees):
    """Points on a circle, mm."""
    angle = np.deg2rad(degrees)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), 0 * angle], axis=1)


BASE = ring(200.0, 10, 110, 130, 230, 250, 350)
PLATFORM = ring(120.0, 50, 70, 170, 190, 290, 310)
TARGET = np.array([40.0, -30.0, 60.0])


def turned(r, v):
    """Vectors (k, 3) turned by rotation vectors (n, 3), to second order: the platform tilts by a few degrees."""
    once = np.cross(r[:, None, :], v)
    return v + once + np.cross(r[:, None, :], once) / 2


def forward(q, p):
    """Position of the target in the base's frame, mm."""
    legs = q + np.stack([p.leg_1, p.leg_2, p.leg_3, p.leg_4, p.leg_5, p.leg_6])
    pose = np.tile([0.0, 0.0, 300.0, 0.0, 0.0, 0.0], (len(q), 1)) + 0 * legs
    for _ in range(8):
        arm = turned(pose[:, 3:], PLATFORM)
        leg = pose[:, None, :3] + arm - BASE
        length = np.sqrt((leg**2).sum(axis=2))
        along = leg / length[:, :, None]
        by_pose = np.concatenate([along, np.cross(arm, along)], axis=2)
        pose = pose + np.linalg.solve(by_pose, (legs - length)[:, :, None])[:, :, 0]
    return pose[:, :3] + turned(pose[:, 3:], TARGET[None, :])[:, 0]


machine = sk.Machine(
    forward,
    joints={f"leg_{k}_mm": (310.0, 350.0) for k in range(1, 7)},
    readings=("x_mm", "y_mm", "z_mm"),
    parameters={f"leg_{k}": ("mm", 0.5) for k in range(1, 7)},
)
