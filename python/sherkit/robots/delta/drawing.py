"""The linear delta as it is drawn: rails, carriages, rod pairs, platform."""

from __future__ import annotations

import numpy as np

from ...base import linalg
from ...base.types import Floats
from ...data import Measurements
from ...errors import SherkitError
from ...model.drawing import Drawing, DrawnPart, line, with_target
from ...model.effect import Effect
from .model import DeltaModel
from .robot import DELTA, Delta, grid

#: Of a limb the core hands over foot and head of its rail, the ends of its rods at the carriage, those at the platform.
_PER_LIMB = 6


def drawing(model: DeltaModel, data: Measurements, values: Floats, readings: Floats | None = None) -> Drawing:
    """The robot at each row, or with ``readings`` (n, m) as what is read. Raises as
    :meth:`~sherkit.model.chain.ChainModel.predict`."""
    points = model.parts(data, values)
    shown = model.at_base((model.predict(data, values) if readings is None else readings)[:, :3], values)
    limbs = [points[:, _PER_LIMB * k : _PER_LIMB * (k + 1)] for k in range(3)]
    centre, tip, target = (points[:, 3 * _PER_LIMB + k] for k in range(3))
    parts = [DrawnPart(f"rail {k}", "frame", limb[:, :2]) for k, limb in enumerate(limbs, 1)]
    for k, limb in enumerate(limbs, 1):
        parts += [DrawnPart(f"rod {k}{side}", "rod", limb[:, [2 + i, 4 + i]]) for i, side in enumerate("ab")]
        parts += [
            DrawnPart(f"carriage {k}", "link", limb[:, 2:4]),
            DrawnPart(f"joint {k}", "joint", limb[:, 2:4].mean(axis=1, keepdims=True)),
        ]
    parts += [
        DrawnPart("platform", "platform", _round(limbs, centre)),
        DrawnPart("arm to the measured point", "link", line(centre, tip)),
        DrawnPart("from the platform's end to the measured point", "ray", line(tip, target)),
    ]
    return with_target(parts, target, shown)


def _round(limbs: list[Floats], centre: Floats) -> Floats:
    """Once round the platform: the axis of each limb, then on to the next one's, as they lie at the first row."""
    ends = np.concatenate([limb[:, 4:] for limb in limbs], axis=1)
    away = ends[0] - centre[0]
    # two rods that are one lie behind one another
    order = np.argsort(np.arctan2(away[:, 1], away[:, 0]), kind="stable")
    return ends[:, [*order, order[0]]]


# -- What an effect alone leaves on a delta once the geometry has had its say ---------------------------------------

_PER_SIDE = 9
_SECONDS_PER_POSE = 3.0
_WARMING_C = 2.0


def signature(effect: Effect, robot: Delta) -> tuple[Floats, Floats]:
    """Places (n, 3) and what is left of the effect there (n, 3), mm.

    All parameters at their plausible size, signs alternating, projected off the fitted geometry and the sensor's pose.
    The poses are walked plane by plane while it grows warmer by two degrees; a period that nobody gave is a tenth of
    their width.
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
    time, warmth = _SECONDS_PER_POSE * np.arange(n, dtype=float), 20.0 + _WARMING_C * np.arange(n) / n
    data = Measurements.planned(joints, DELTA, "signature", time_s=time, temperature_c=warmth)
    plain = DeltaModel(robot)
    fitted = plain.derivatives(data, np.zeros(len(plain.parameters)))[:, :3].reshape(3 * n, -1)
    at = n * _SECONDS_PER_POSE / 2 if effect.search == "time_s" else None
    if effect.is_periodic and plain.setting_of(effect) is None:
        at = half / 5.0
    with_it = plain.with_effect(effect, at=at)
    size = np.array([p.size for p in effect.parameters])
    values = np.zeros(len(with_it.parameters))
    values[with_it.owns(effect)] = size * np.resize([1.0, -1.0], len(size))
    change = (with_it.predict(data, values) - with_it.predict(data, np.zeros(len(values))))[:, :3].ravel()
    scale = np.linalg.norm(fitted, axis=0)
    left = change - fitted @ (linalg.lstsq(fitted / scale, change, rcond=1e-10)[0] / scale)
    return poses, left.reshape(n, 3)
