"""The sensor's pose as a link of a chain in NumPy, where a robot has no compiled chain: its rows of the table, what the
sensor sees, and how that changes. It is the same as ``rust/core/src/chain/sensor_pose.rs``.

    seen = seen_from(pose, off, points)

``off`` are the six numbers of :data:`~sherkit.model.sensor_pose.POSE`, for all rows or for each of them: the picture of
the robot is turned about the sensor's own axes, then shifted. Complex numbers pass, so that a
:class:`~sherkit.fit.numpy_chain.ComplexChain` has exact derivatives without more.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base.types import Floats
from .sensor_pose import IN_PLANE, POSE, TURNS, SensorPose

Numbers = NDArray[Any]

#: Plausible sizes of where an instrument stands, rad and mm: people put trackers anywhere.
_TURN_RAD, _SHIFT_MM = 1.0, 1000.0
#: And of how far one is knocked.
_KNOCKED_RAD, _KNOCKED_MM = 5e-4, 0.2
#: Squared angles (rad²) below which series are better than sines.
_SMALL = 1e-2


# -- Rows of a table ----------------------------------------------------------------------------------------------


def pose_row(names: Collection[str] = POSE) -> dict[str, Any]:
    """The row of what every model has: these numbers of the pose. How far a turn moves the point is asked of the
    model."""
    own = [
        {"name": name, "symbol": name, **_of(name, _TURN_RAD, _SHIFT_MM), "lever_mm": None if name in TURNS else 1.0}
        for name in POSE
        if name in names
    ]
    return {"name": "sensor_pose", "link": "sensor", "base": True, "parameters": own, "needs": [], "search": None}


def slip_row(lever_mm: float, names: Collection[str] = POSE) -> dict[str, Any]:
    """The row of the effect: by how much these numbers change at the moment at which the instrument is knocked; a turn
    moves what is seen by ``lever_mm`` per radian."""
    own = [
        {"name": name.removeprefix("sensor_"), "symbol": name.removeprefix("sensor_"),
         **_of(name, _KNOCKED_RAD, _KNOCKED_MM), "lever_mm": lever_mm if name in TURNS else 1.0}
        for name in POSE if name in names
    ]  # fmt: skip
    return {"name": "sensor_slip", "link": "sensor", "base": False, "parameters": own, "needs": ["time_s"],
            "search": "time_s"}  # fmt: skip


def _of(name: str, turn: float, shift: float) -> dict[str, Any]:
    return {"unit": "rad", "size": turn} if name in TURNS else {"unit": "mm", "size": shift}


# -- What it sees ---------------------------------------------------------------------------------------------------


def seen_from(pose: SensorPose, off: Numbers, points_mm: Numbers) -> Numbers:
    """What the sensor sees (n, 3) of points (n, 3) of the base frame, mm, where its pose is ``off`` (6,) or (n, 6), rad
    and mm, from that of the robot's file."""
    return turned(pose, off, points_mm) + (pose.origin_mm + off[..., 3:])


def seen_in_plane(pose: SensorPose, off: Numbers, points_mm: Numbers) -> Numbers:
    """The same of x and y (n, 2) in a plane that is square to the sensor's z, with the three numbers of
    :data:`~sherkit.model.sensor_pose.IN_PLANE`, (3,) or (n, 3)."""
    whole = np.zeros((*off.shape[:-1], len(POSE)), dtype=off.dtype)
    whole[..., [POSE.index(name) for name in IN_PLANE]] = off
    points = np.concatenate([points_mm, np.zeros_like(points_mm[:, :1])], axis=1)
    return seen_from(pose, whole, points)[:, :2]


def turned(pose: SensorPose, off: Numbers, points_mm: Numbers) -> Numbers:
    """The same before it is shifted."""
    return np.asarray((turn_of(pose, off) @ points_mm[:, :, None])[:, :, 0])


def turn_of(pose: SensorPose, off: Numbers) -> Numbers:
    """From the axes of the base to those of the sensor (3, 3), or (n, 3, 3)."""
    return np.asarray(rotation_matrix(off[..., :3]) @ pose.turn)


def by_pose(pose: SensorPose, off: Numbers, points_mm: Numbers) -> Numbers:
    """Derivatives (n, 3, 6) of what is seen by the six numbers."""
    by_turn = -_cross(turned(pose, off, points_mm)) @ left_jacobian(off[..., :3])
    return np.concatenate([by_turn, np.broadcast_to(np.eye(3), by_turn.shape)], axis=2)


# -- Turns ----------------------------------------------------------------------------------------------------------


def rotation_matrix(turn_rad: Numbers) -> Numbers:
    """exp of rotation vectors (…, 3): matrices (…, 3, 3), exact for any turn; complex numbers pass."""
    square, is_small = _square(turn_rad)
    angle = np.sqrt(np.where(is_small, 1.0, square))
    sine = np.where(is_small, _series(square, 6, 20, 42, 72), np.sin(angle) / angle)
    return _rotated(turn_rad, sine, _versed(square, is_small, angle))


def left_jacobian(turn_rad: Floats) -> Floats:
    """By which vectors a small change of each component of turns (…, 3) turns what is seen (…, 3, 3)."""
    square, is_small = _square(turn_rad)
    angle = np.sqrt(np.where(is_small, 1.0, square))
    rest = np.where(is_small, _series(square, 20, 42, 72, 110) / 6, (angle - np.sin(angle)) / angle**3)
    return _rotated(turn_rad, _versed(square, is_small, angle), rest)


def _square(turn: Numbers) -> tuple[Numbers, NDArray[np.bool_]]:
    """The squared angles, and which are small: of none the root is taken, whose derivative has no end."""
    square = (turn * turn).sum(axis=-1)
    return square, np.abs(square) < _SMALL


def _series(square: Numbers, *divisors: int) -> Numbers:
    """1 - s/a (1 - s/b (1 - …)) of a squared angle s."""
    out = np.ones_like(square)
    for one in reversed(divisors):
        out = 1 - square / one * out
    return out


def _versed(square: Numbers, is_small: NDArray[np.bool_], angle: Numbers) -> Numbers:
    """(1 - cos a)/a² without a difference, which would lose digits."""
    return np.where(is_small, _series(square, 12, 30, 56, 90) / 2, 2 * np.sin(angle / 2) ** 2 / angle**2)


def _rotated(turn: Numbers, once: Numbers, twice: Numbers) -> Numbers:
    cross = _cross(turn)
    return np.asarray(np.eye(3) + once[..., None, None] * cross + twice[..., None, None] * (cross @ cross))


def _cross(v: Numbers) -> Numbers:
    """The matrices (…, 3, 3) that take w to v × w."""
    x, y, z = np.moveaxis(v, -1, 0)
    zero = np.zeros_like(x)
    return np.stack([np.stack(row, axis=-1) for row in ((zero, -z, y), (z, zero, -x), (-y, x, zero))], axis=-2)
