"""An instrument that stands otherwise than the robot's file says: its frame turned or mirrored, its picture turned or
cropped, or set up anew within a run.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy

from ..base import linalg
from ..base.types import Bools, Floats
from ..data import Measurements
from ..data.columns import unit_in
from ..model.base import ModelWithEffects
from .set_up_hypotheses import SetUpHypothesis, with_and

#: A frame that is turned anyhow is less likely from the outset than a slip: its three angles fit more.
_TURNED = 10.0
#: Two shifts fit less, and pictures are cropped often.
_SHIFTED = 2.0
#: How much a plausible size counts beside what is off, all rows together.
_HELD = 1e-3
#: A turn is half a turn as long as it is as near to one as this.
_PLANE_DEG = 3.0
#: A camera stands no farther aside than by so much of its picture, and is turned by no more than this.
_CROPPED = 0.06
_TURNED_DEG = 4.0
#: Rows on either side of the one before which an instrument was set up anew.
_A_SIDE = 8


def turned_frame(
    model: ModelWithEffects, data: Measurements, values: Floats, *, mirrored: bool
) -> SetUpHypothesis | None:
    """The readings turned, or mirrored and turned, so that they come to lie on what the model predicts for ``values``;
    those of a picture shifted as well, which is cropped where it is hardly turned. None where readings are neither
    three lengths nor two of a picture.

    Source: Kabsch, "A solution for the best rotation to relate two sets of vectors", 1976; rows far off weigh less
    (Cauchy), so that gross errors do not turn the frame. Raises as the model's ``predict``.
    """
    names = data.layout.coordinates
    n, units = len(names), {unit_in(name) for name in names}
    whole = data.used[:, :n].all(axis=1)
    is_picture = n == 2 and units == {"px"} and not mirrored
    if not (is_picture or (n == 3 and units == {"mm"})) or whole.sum() < 4:
        return None
    predicted = model.predict(data, values)[whole, :n]
    turn, middle, there = _registered(data.readings[whole, :n], predicted, mirrored=mirrored)
    readings = data.readings.copy()
    if is_picture and abs(_degrees(turn)) < _TURNED_DEG:
        # a shift alone, where a little turn would take what belongs to the robot
        turn = np.eye(n)
        there = np.asarray(middle + _shift(model, data, values, np.asarray(whole)))
    readings[:, :n] = (data.readings[:, :n] - middle) @ turn.T + (there if is_picture else middle)
    what = _turned_picture(model, data, turn, middle, there) if is_picture else _turned_space(names, turn, mirrored)
    if what is None:
        return None
    looks, advice, farther = what
    return SetUpHypothesis(looks, advice, model, replace(data, readings=np.where(data.taken, readings, 0.0)), farther)


def set_up_anew(model: ModelWithEffects, data: Measurements) -> SetUpHypothesis | None:
    """The readings as the instrument would have shown them that was set up anew at some row: those before it turned and
    shifted to where the later ones have them, by the drawing. None where readings are not three lengths, or rows are
    few. Raises as the model's ``predict``."""
    names = data.layout.coordinates
    whole = np.flatnonzero(data.used[:, : len(names)].all(axis=1))
    rows = whole[np.argsort(data.order[whole], kind="stable")]
    if len(names) != 3 or {*map(unit_in, names)} != {"mm"} or len(rows) < 2 * _A_SIDE:
        return None
    predicted = model.predict(data, np.zeros(len(model.parameters)))[rows, :3]
    seen = data.readings[rows, :3]
    off = _left_by_turns(seen, predicted) + _left_by_turns(seen[::-1], predicted[::-1])[::-1]
    off = off[_A_SIDE:-_A_SIDE]
    cut = _A_SIDE + int(np.argmin(off))
    (turn, middle, there), (turned, centre, stood) = (
        _registered(seen[some], predicted[some], mirrored=False) for some in (slice(cut), slice(cut, None))
    )
    by = turned.T @ turn
    moved = (there - stood) @ turned + centre
    before = np.flatnonzero(data.order < data.order[rows[cut]])
    readings = data.readings.copy()
    readings[before, :3] = np.where(data.taken[before, :3], (readings[before, :3] - middle) @ by.T + moved, 0.0)
    degrees = float(np.rad2deg(np.linalg.norm(scipy.spatial.transform.Rotation.from_matrix(by).as_rotvec())))
    return SetUpHypothesis(
        f"the instrument looks set up anew before {data.counted} {data.line[rows[cut]]} (turned by {degrees:.3g}°, "
        f"what is read moved by {np.linalg.norm(moved - middle):.3g} mm)",
        "give the rows before and since two words in a column 'setup', or each a file",
        model, replace(data, readings=readings), _TURNED,
    )  # fmt: skip


def _left_by_turns(measured: Floats, predicted: Floats) -> Floats:
    """Sums of squares (n + 1,) that the first points, so many of them, leave where they are turned and shifted onto the
    predicted ones (Kabsch)."""
    one, other = measured - measured.mean(axis=0), predicted - predicted.mean(axis=0)

    def summed(values: Floats) -> Floats:
        return np.concatenate([np.zeros((1, *values.shape[1:])), np.cumsum(values, axis=0)])

    count = np.maximum(np.arange(len(one) + 1), 1)
    a, b = summed(one), summed(other)
    squares = summed((one**2).sum(axis=1) + (other**2).sum(axis=1)) - ((a**2).sum(axis=1) + (b**2).sum(axis=1)) / count
    cross = summed(one[:, :, None] * other[:, None, :]) - a[:, :, None] * b[:, None, :] / count[:, None, None]
    values = np.sqrt(linalg.eigvalsh(cross.transpose(0, 2, 1) @ cross).clip(0.0))
    values[:, 0] *= np.sign(np.linalg.det(cross))
    return np.asarray(squares - 2.0 * values.sum(axis=1))


def _turned_space(names: Sequence[str], turn: Floats, mirrored: bool) -> tuple[str, str, float]:
    angle = scipy.spatial.transform.Rotation.from_matrix(turn * (-1.0 if mirrored else 1.0)).inv().as_rotvec()
    degrees = float(np.rad2deg(np.linalg.norm(angle)))
    axis = angle / max(float(np.linalg.norm(angle)), 1e-12)
    along = f"({', '.join(f'{v:.2f}' for v in np.round(axis, 2) + 0.0)})"
    what = f"turned by {degrees:.1f}° about {along}"
    if mirrored:
        # a point's mirror image turned by half a turn is that of a plane
        plane = degrees > 180.0 - _PLANE_DEG
        what = f"mirrored in the plane square to {along}" if plane else f"mirrored in a point and {what}"
    advice = "let the sensor's pose be found ([sensor_pose] free = true in the robot file), or turn the readings back"
    if mirrored:
        advice = "change the sign of one of them"
    return f"the frame of {with_and(names)} looks {what}", advice, _TURNED


def _turned_picture(
    model: ModelWithEffects, data: Measurements, turn: Floats, middle: Floats, there: Floats
) -> tuple[str, str, float] | None:
    """What the picture looks like, turned or cropped; None where a camera that stands a little aside does as much."""
    names = data.layout.coordinates
    ends = [model.ranges(data).get(name) for name in names]
    size = np.array([np.inf if e is None else e[1] - e[0] for e in ends])
    degrees, shift = _degrees(turn), there - middle
    if degrees:
        advice = "turn the pictures, or the camera, back"
        return f"the picture of {with_and(names)} looks turned by {-degrees:.1f}°", advice, _TURNED
    if (np.abs(shift) > _CROPPED * size).any():
        told = with_and([f"{v:+.0f} to {name}" for name, v in zip(names, shift, strict=True)])
        advice = f"give the pixels of the whole picture: add {told}"
        return (
            f"{with_and(names)} look cropped: counted from another corner than that of the whole picture",
            advice,
            _SHIFTED,
        )
    return None


def _shift(model: ModelWithEffects, data: Measurements, values: Floats, rows: Bools) -> Floats:
    """What is to be added to readings (k,) in these ``rows`` so that the model fits them, whose parameters may move by
    their plausible sizes: one step of Gauss and Newton for both, wild rows weighing less (Cauchy)."""
    k, sizes = data.coordinates, np.array([p.size for p in model.parameters])
    off = data.readings[rows, :k] - model.predict(data, values)[rows, :k]
    moves = model.derivatives(data, values)[rows, :k] * sizes
    columns = np.concatenate([moves, -np.broadcast_to(np.eye(k), (len(off), k, k))], axis=2)
    weight, step = np.ones(len(off)), np.zeros(len(sizes) + k)
    for _ in range(10):
        root = np.sqrt(weight)[:, None]
        flat = (columns * root[:, :, None]).reshape(-1, columns.shape[2])
        prior = np.diag([*np.full(len(sizes), _HELD * np.linalg.norm(off)), *np.zeros(k)])
        step = linalg.lstsq(np.concatenate([flat, prior]), np.append((off * root).ravel(), np.zeros(len(prior))))[0]
        left = np.linalg.norm(off - columns @ step, axis=1)
        weight = 1.0 / (1.0 + (left / max(float(np.median(left)), 1e-12)) ** 2)
    return np.asarray(step[len(sizes) :])


def _degrees(turn: Floats) -> float:
    return float(np.rad2deg(np.arctan2(turn[1, 0], turn[0, 0])))


def _registered(measured: Floats, predicted: Floats, *, mirrored: bool) -> tuple[Floats, Floats, Floats]:
    """The orthogonal matrix that turns measured points about their middle onto the predicted ones, and the middles of
    both."""
    weight = np.ones(len(measured))
    for _ in range(10):
        w = (weight / weight.sum())[:, None]
        middle, there = (w * measured).sum(axis=0), (w * predicted).sum(axis=0)
        u, _, vt = linalg.svd(((measured - middle) * w).T @ (predicted - there))
        sign = np.linalg.det(vt.T @ u.T) * (-1.0 if mirrored else 1.0)
        turn = vt.T @ np.diag([*np.ones(measured.shape[1] - 1), np.sign(sign)]) @ u.T
        off = np.linalg.norm((measured - middle) @ turn.T - (predicted - there), axis=1)
        weight = 1.0 / (1.0 + (off / max(float(np.median(off)), 1e-12)) ** 2)
    return np.asarray(turn), np.asarray(middle), np.asarray(there)
