"""What an effect alone leaves on a delta once the geometry has had its say: where, and how much."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...base import linalg
from ...base.types import Floats
from ...data import Measurements
from ...data.columns import TEMPERATURE, TIME
from ...errors import SherkitError
from ...model.effect import Effect
from .columns import DELTA, JOINTS, POSITION
from .model import DeltaModel
from .poses import grid
from .robot import Delta

_PER_SIDE = 9
_SECONDS_PER_POSE = 3.0
_WARMING_C = 2.0


def signature(effect: Effect, robot: Delta) -> tuple[Floats, Floats]:
    """Places (n, 3) and what is left of the effect there (n, 3), mm.

    All parameters at their plausible size, signs alternating, projected off the fitted geometry and datum. The poses
    are walked plane by plane while it grows warmer by two degrees; a period that nobody gave is a tenth of their width.
    Raises :class:`~sherkit.errors.SherkitError` where the robot reaches no pose.
    """
    half = 0.7 * (robot.workspace_radius_mm or 20.0)
    low, high = robot.workspace_z_mm or (-half, half)
    poses = grid(half, _PER_SIDE, tuple(np.linspace(low, high, 3) * 0.9))
    batch = robot.inverse_batch(poses)
    if not batch.reached.any():
        raise SherkitError("the robot reaches no pose of its workspace; check [workspace] and the geometry")
    joints, poses = batch.values[batch.reached], poses[batch.reached]
    n = len(joints)
    columns: dict[str, NDArray[Any]] = dict(zip((*JOINTS, *POSITION), (*joints.T, *poses.T), strict=True))
    columns |= {TIME: np.arange(n) * _SECONDS_PER_POSE, TEMPERATURE: 20.0 + _WARMING_C * np.arange(n) / n}
    data = Measurements.from_columns(columns, "signature", layout=DELTA)
    plain = DeltaModel(robot)
    fitted = plain.derivatives(data, np.zeros(len(plain.parameters)))[:, :3].reshape(3 * n, -1)
    at = n * _SECONDS_PER_POSE / 2 if effect.search == "time_s" else None
    if effect.is_periodic and plain.setting_of(effect) is None:
        at = half / 5.0
    with_it = plain.with_effect(effect, at=at)
    size = np.array([p.size for p in effect.parameters])
    values = np.zeros(len(with_it.parameters))
    values[with_it.owns(effect)] = size * np.where(np.arange(len(size)) % 2 == 0, 1.0, -1.0)
    change = (with_it.predict(data, values) - with_it.predict(data, np.zeros(len(values))))[:, :3].ravel()
    scale = np.linalg.norm(fitted, axis=0)
    left = change - fitted @ (linalg.lstsq(fitted / scale, change, rcond=1e-10)[0] / scale)
    return poses, left.reshape(n, 3)
