"""Rigid transforms as 4 x 4 matrices, mm, and as files have them: a shift and URDF's roll, pitch and yaw."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...base.types import Floats

Triple = tuple[float, float, float]

#: An axis that leans by less is z itself.
_ALONG = 1e-12


def about(axis: int, angle: float) -> Floats:
    """A turn (3, 3) about x, y or z, rad."""
    cos, sin = np.cos(angle), np.sin(angle)
    out = np.eye(3)
    j, k = (axis + 1) % 3, (axis + 2) % 3
    out[j, j] = out[k, k] = cos
    out[j, k], out[k, j] = -sin, sin
    return out


def frame(shift_mm: Sequence[float], turn: Floats) -> Floats:
    """The transform (4, 4) of a turn (3, 3) and a shift."""
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = turn, shift_mm
    return out


def of_rpy(rpy_rad: Sequence[float]) -> Floats:
    """The turn (3, 3) of URDF's roll, pitch and yaw: about the fixed x, then y, then z."""
    roll, pitch, yaw = rpy_rad
    return about(2, yaw) @ about(1, pitch) @ about(0, roll)


def rpy_of(turn: Floats) -> Floats:
    """Roll, pitch and yaw (3,), rad, of a turn (3, 3); exact where yaw and roll turn about one axis, too."""
    yaw = np.arctan2(turn[1, 0], turn[0, 0])
    cos, sin = np.cos(yaw), np.sin(yaw)
    roll = np.arctan2(sin * turn[0, 2] - cos * turn[1, 2], cos * turn[1, 1] - sin * turn[0, 1])
    return np.array([roll, np.arctan2(-turn[2, 0], cos * turn[0, 0] + sin * turn[1, 0]), yaw])


def onto(axis: Sequence[float]) -> Floats:
    """The smallest turn (3, 3) that brings z onto an axis; half a turn about x where that is -z."""
    x, y, z = np.asarray(axis, dtype=float) / np.linalg.norm(axis)
    across = np.hypot(x, y)
    if across < _ALONG:
        return np.eye(3) if z > 0 else about(0, np.pi)
    c, s = x / across, y / across
    h = (1.0 - z) * s * c
    return np.array([[z + (1.0 - z) * s * s, -h, x], [-h, z + (1.0 - z) * c * c, y], [-x, -y, z]])


def as_written(made: Floats) -> tuple[Triple, Triple]:
    """Shift, mm, and roll, pitch, yaw, degrees, of a transform (4, 4), as a file has them."""
    shift, rpy = (made[:3, 3] + 0.0).tolist(), (np.rad2deg(rpy_of(made[:3, :3])) + 0.0).tolist()
    return (shift[0], shift[1], shift[2]), (rpy[0], rpy[1], rpy[2])
