"""A linear delta as it stands: towers that may lean, six rods, belts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Machine:
    """Three towers with a pair of rods each.

    ``foot`` (3, 2) is where each tower stands at height zero, seen from the effector's joint of its arm, mm; ``lean``
    (3, 2) how far out from the middle (radially) and sideways (anticlockwise) it goes per mm of height; ``arm`` (3, 2)
    the two rods of each; ``top`` (3,) the height of the carriages at their end stops; ``belt`` (3,) what a carriage
    moves for each mm that its motor does. ``spacing`` is the distance of the rods of an arm, ``effector`` that of their
    joints from the middle of the effector."""

    foot: Floats
    lean: Floats
    arm: Floats
    top: Floats
    belt: Floats
    slack: Floats
    spacing: float = 50.0
    effector: float = 30.0

    @classmethod
    def of(cls, radius: Floats, angle_deg: Floats, arm: Floats, top: Floats, **others: Floats) -> Machine:
        """Upright towers at these radii and angles (3,) with arms of two equal rods (3,)."""
        turn = np.deg2rad(angle_deg)
        foot = np.asarray(radius)[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=1)
        ideal = {"lean": np.zeros((3, 2)), "belt": np.ones(3), "slack": np.zeros(3)} | others
        rods = np.repeat(np.asarray(arm, dtype=float)[:, None], 2, axis=1)
        return cls(foot=foot, arm=rods, top=np.asarray(top, dtype=float), **ideal)

    def pose(self, down: Floats) -> tuple[Floats, Floats]:
        """Centre (n, 3) and rotation vector (n, 3) of the effector when the motors have gone ``down`` (n, 3) mm."""
        height = self.top - self.belt * down - self.slack
        out = self.foot / np.hypot(*self.foot.T)[:, None]
        side = np.stack([-out[:, 1], out[:, 0]], axis=1)
        way = self.lean[:, :1] * out + self.lean[:, 1:] * side
        at = self.foot + height[:, :, None] * way
        carriage = np.concatenate([at, height[:, :, None]], axis=2)
        # the joints of a carriage stand out from the effector's by its radius, so that feet are those of the arms
        edge = np.concatenate([side, np.zeros((3, 1))], axis=1) * 0.5 * self.spacing
        shift = np.concatenate([out, np.zeros((3, 1))], axis=1) * self.effector
        ends = np.stack([carriage + shift - edge, carriage + shift + edge], axis=2)
        joints = np.stack([shift - edge, shift + edge], axis=1)
        centre = np.zeros((len(down), 3))
        centre[:, 2] = height.mean(axis=1) - np.sqrt(self.arm.mean() ** 2 - np.hypot(*self.foot.T).mean() ** 2)
        turned = np.zeros((len(down), 3))
        for _ in range(7):
            spun = _spun(joints, turned)
            rod = centre[:, None, None] + spun - ends
            wrong = ((rod**2).sum(axis=3) - self.arm**2).reshape(-1, 6)
            by = np.concatenate([2 * rod, 2 * np.cross(spun, rod)], axis=3).reshape(-1, 6, 6)
            step = np.linalg.solve(by, wrong[:, :, None])[:, :, 0]
            centre, turned = centre - step[:, :3], turned - step[:, 3:]
        return centre, turned

    def tip(self, down: Floats, offset: Floats) -> Floats:
        """Where a point of the effector (3,) is (n, 3)."""
        centre, turned = self.pose(down)
        return centre + _spun(np.asarray(offset, dtype=float)[None, None], turned)[:, 0, 0]


def _spun(points: Floats, turned: Floats) -> Floats:
    """Points (a, b, 3) turned by each of small rotation vectors (n, 3): (n, a, b, 3), by Rodrigues' formula."""
    angle = np.linalg.norm(turned, axis=1)[:, None, None, None]
    axis = turned[:, None, None, :]
    first = np.cross(axis, points[None])
    sin = np.where(angle > 1e-12, np.sin(angle) / np.where(angle > 1e-12, angle, 1.0), 1.0)
    cos = np.where(angle > 1e-6, (1 - np.cos(angle)) / np.where(angle > 1e-6, angle, 1.0) ** 2, 0.5)
    return points[None] + sin * first + cos * np.cross(axis, first)
