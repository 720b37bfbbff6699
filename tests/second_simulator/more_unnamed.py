"""More physics that no catalogue has, of any robot: six kinds, each a function of a :class:`~.unnamed.Scene`.

Play, straightness and heat have cousins in catalogues; none of these is one of them. Their makers have set them right
at both ends of their travel, or warm: no scale and no lean is a part of what they do. How large it is follows from what
a fit of the geometry leaves of it.
"""

from __future__ import annotations

import numpy as np

from .geometry import Array
from .unnamed import Kind, Scene

#: Thresholds along each side of the triangle of Preisach's relays.
THRESHOLDS = 14


def _moves(s: Scene) -> Array:
    """Way of each joint (n, k) from the row before; none before the first."""
    return np.concatenate([np.zeros((1, s.joints.shape[1])), np.diff(s.joints, axis=0)])


def _one(s: Scene) -> int:
    """One of the joints that move."""
    return int(s.rng.choice(np.flatnonzero(np.ptp(s.joints, axis=0) > 0)))


def _from_end_to_end(course: Array, unit: Array, last: float) -> Array:
    """A course along -1 … 1 that begins at nothing and ends at ``last``, counted from the line between the two."""
    return np.asarray(course - 0.5 * last * (unit + 1.0))


def bumps(s: Scene) -> Array:
    """A few places of the workspace where all is off, each with a width and a direction of its own."""
    out, size = np.zeros_like(s.point), np.maximum(s.point.std(axis=0), 1e-9)
    for _ in range(int(s.rng.integers(3, 7))):
        middle = s.point.mean(axis=0) + s.rng.uniform(-1.4, 1.4, 3) * size
        away = np.linalg.norm((s.point - middle) / size, axis=1) / s.rng.uniform(0.5, 1.1)
        out += np.outer(s.rng.uniform(0.5, 1.5) * np.exp(-0.5 * away**2), s.vector())
    return s.of_point(out)


def preisach(s: Scene) -> Array:
    """Joints with magnetic or elastic memory: each is a sum of relays, which a rising value switches on at one
    threshold, a falling one off at a lower one. All are off at first; the joint goes straight from row to row. Where
    all are on, and where all are off, it is right."""
    unit, error = s.unit_joints, np.zeros_like(s.joints)
    grid = np.linspace(-1.0, 1.0, THRESHOLDS)
    on, off = (side.ravel() for side in np.meshgrid(grid, grid))
    on, off = on[on >= off], off[on >= off]
    for joint in range(unit.shape[1]):
        # narrow relays are the more frequent ones, as of a material that is soft
        weight = s.rng.lognormal(0.0, 1.0, len(on)) * np.exp(-(on - off) / s.rng.uniform(0.4, 1.5))
        state = -np.ones(len(on))
        for row, value in enumerate(unit[:, joint]):
            state = np.where(value >= on, 1.0, np.where(value <= off, -1.0, state))
            error[row, joint] = weight @ state - weight.sum() * value
    return s.of_joints(error)


def stops_short(s: Scene) -> Array:
    """Joints that stick before they are there: how much is missing grows with the length of the move, up to a length,
    and is another part of it either way."""
    moves, error = _moves(s), np.zeros_like(s.joints)
    usual = np.median(np.abs(moves), axis=0) + 1e-12
    for joint in range(moves.shape[1]):
        up, down = s.rng.uniform(0.2, 1.0, 2)
        length = np.abs(moves[:, joint]) / (usual[joint] * s.rng.uniform(0.5, 2.0))
        part = np.where(moves[:, joint] > 0, up, -down) * (moves[:, joint] != 0)
        error[:, joint] = -part * (1.0 - np.exp(-length))
    return s.of_joints(error)


def heat_of_motors(s: Scene) -> Array:
    """Motors warm with the pace at which they turn and cool with a lag, of which no column tells; what each carries is
    longer by its warmth, and right when it is as warm as it becomes in the mean."""
    pace = np.abs(_moves(s)) / np.diff(s.time_s, prepend=s.time_s[0] - 1.0)[:, None]
    pace /= pace.mean(axis=0) + 1e-12
    lag = s.duration_s * float(np.exp(s.rng.uniform(np.log(1 / 30), np.log(1 / 4))))
    warmth = np.zeros_like(pace)
    for k in range(1, len(pace)):
        kept = np.exp(-(s.time_s[k] - s.time_s[k - 1]) / lag)
        warmth[k] = kept * warmth[k - 1] + (1.0 - kept) * pace[k]
    longer = s.rng.uniform(0.3, 1.0, pace.shape[1]) * (warmth - 1.0) * (np.ptp(s.joints, axis=0) > 0)
    return s.of_joints(longer * (s.unit_joints + s.rng.uniform(-2.0, 2.0, pace.shape[1])))


def kinked_rail(s: Scene) -> Array:
    """Two pieces of a guide meet at an angle: beyond the joint what runs on it is led aside, straight. Where there are
    no guides, the other joints are led."""
    joint, kink = _one(s), s.rng.uniform(-0.5, 0.5)
    unit = s.unit_joints[:, joint]
    beyond = _from_end_to_end(np.maximum(unit - kink, 0.0), unit, 1.0 - kink)
    if s.by_radius is not None:
        return np.asarray(s.by_radius[:, :, joint] * beyond[:, None])
    led = s.rng.normal(size=s.joints.shape[1]) * (np.arange(s.joints.shape[1]) != joint)
    return s.of_joints(np.outer(beyond, led))


def bad_stretch(s: Scene) -> Array:
    """A stretch of one joint's scale has another pitch than the rest."""
    joint, error = _one(s), np.zeros_like(s.joints)
    unit = s.unit_joints[:, joint]
    begin = s.rng.uniform(-0.7, 0.3)
    end = begin + s.rng.uniform(0.2, 0.6)
    error[:, joint] = _from_end_to_end(np.clip(unit - begin, 0.0, end - begin), unit, end - begin)
    return s.of_joints(error)


MORE_KINDS: tuple[Kind, ...] = (bumps, preisach, stops_short, heat_of_motors, kinked_rail, bad_stretch)
