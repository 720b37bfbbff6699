"""Where the sensor stands: what may differ from run to run and is no change of the robot.

A tracker or a stage of lasers that was stationed anew shows every place turned and shifted: found by the best turn of
one cloud of points onto the other (Kabsch, 1976). A camera that was moved is found by its pose. Of other readings the
zero is free.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from ..base import linalg
from ..base.types import Bools, Floats, Ints
from ..data import Measurements
from ..data.columns import bare, unit_in
from ..errors import FitError, SherkitError
from ..model.base import ModelWithEffects
from ..model.sensor_pose import POSE

#: Rounds in which rows that are wrong are left out of the turn, and from which multiple of the median.
_ROUNDS, _FAR = 4, 5.0


@dataclass(frozen=True, eq=False)
class RunPose:
    """How a run is seen: its ``residual`` (n, m) to the model once the sensor is where it stands, the ``columns``
    (n, m, s) of what is left to move it by, and how far it was moved, by name with its unit."""

    residual: Floats
    columns: Floats
    moved: dict[str, float]


def stand_of(
    model: ModelWithEffects, data: Measurements, values: Floats, axes: tuple[int, ...], used: Bools
) -> RunPose:
    """The stand from which these rows were read, of a model at these values. Raises
    :class:`~sherkit.errors.FitError` for rows that are too few to tell it."""
    if len(parts := _set_ups(data)) > 1:
        return _each(parts, [stand_of(model, data.select(rows), values, axes, used[rows]) for rows in parts], used)
    chosen = list(axes)
    predicted = model.predict(data, values)[:, chosen]
    seen = np.where(used, data.readings[:, chosen], predicted)
    names = [data.layout.readings[a] for a in axes]
    whole: Bools = np.asarray(used.all(axis=1))
    if len(axes) == 3 and all(unit_in(name) == "mm" for name in names):
        if whole.sum() < 4:
            raise FitError(f"{data.source}: expected four rows or more with all of {', '.join(names)}")
        return _rigid(predicted, seen, whole)
    at = [k for k, p in enumerate(model.parameters) if p.name in POSE]
    if at:
        return _camera(model, data, values, chosen, seen, used, at)
    zero = np.array(
        [np.median((seen - predicted)[used[:, k], k]) if used[:, k].any() else 0.0 for k in range(len(axes))]
    )
    columns = np.broadcast_to(np.eye(len(axes)), (len(seen), len(axes), len(axes))).copy()
    moved = {f"zero_{bare(name)}_{unit_in(name)}": float(v) for name, v in zip(names, zero, strict=True)}
    return RunPose(np.where(used, seen - predicted - zero, 0.0), columns, moved)


def _set_ups(data: Measurements) -> list[Ints]:
    """The rows of each set-up of the instrument, the last in the end; all of them where there is one."""
    if data.set_up is None:
        return [np.arange(len(data))]
    every = [str(one) for one in dict.fromkeys(data.set_up.tolist()) if one != data.last_set_up]
    return [np.flatnonzero(data.set_up == name) for name in (*every, data.last_set_up)]


def _each(parts: Sequence[Ints], stands: Sequence[RunPose], used: Bools) -> RunPose:
    """The stands of set-ups as one: each moves its own rows alone; how far, is said of the last."""
    residual = np.zeros(used.shape)
    columns = np.zeros((*used.shape, sum(one.columns.shape[2] for one in stands)))
    first = 0
    for rows, one in zip(parts, stands, strict=True):
        end = first + one.columns.shape[2]
        residual[rows], columns[rows, :, first:end] = one.residual, one.columns
        first = end
    return RunPose(residual, columns, stands[-1].moved)


def _rigid(predicted: Floats, seen: Floats, whole: Bools) -> RunPose:
    """Readings turned and shifted onto what is predicted."""
    from scipy.spatial.transform import Rotation

    near = whole.copy()
    for _ in range(_ROUNDS):
        middle, there = seen[near].mean(axis=0), predicted[near].mean(axis=0)
        u, _, v = linalg.svd((seen[near] - middle).T @ (predicted[near] - there))
        turn = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ v))]) @ v
        at = (seen - middle) @ turn + there
        missed = np.linalg.norm(at - predicted, axis=1)
        kept = whole & (missed <= _FAR * max(float(np.median(missed[whole])), 1e-300))
        if np.array_equal(kept, near) or kept.sum() < 4:
            break
        near = kept
    turns = np.cross(np.eye(3), (at - there)[:, None]).transpose(0, 2, 1)
    columns = np.concatenate([np.broadcast_to(np.eye(3), turns.shape), turns], axis=2)
    told = [*(middle - there), *(1e3 * Rotation.from_matrix(turn).as_rotvec())]
    names = [*(f"shift_{a}_mm" for a in "xyz"), *(f"turn_{a}_mrad" for a in "xyz")]
    return RunPose(at - predicted, columns, dict(zip(names, map(float, told), strict=True)))


def _camera(
    model: ModelWithEffects, data: Measurements, values: Floats, axes: list[int], seen: Floats, used: Bools,
    at: list[int],
) -> RunPose:  # fmt: skip
    """The pose of the camera alone, from where it stood."""
    size = np.array([model.parameters[k].size for k in at])

    def now(by: Floats) -> Floats:
        then = np.array(values, dtype=float)
        then[at] += by * size
        return then

    def columns(by: Floats) -> Floats:
        return np.asarray(model.derivatives(data, now(by))[:, axes][:, :, at])

    def left(by: Floats) -> Floats:
        try:
            return np.where(used, seen - model.predict(data, now(by))[:, axes], 0.0)
        except SherkitError:
            # the camera would not see the marker from there
            return np.full(used.shape, np.inf)

    by = scipy.optimize.least_squares(
        lambda by: left(by)[used], np.zeros(len(at)), lambda by: -columns(by)[used] * size, xtol=1e-10, ftol=1e-12
    ).x
    told = zip((model.parameters[k] for k in at), by * size, strict=True)
    return RunPose(left(by), columns(by), {f"{p.name.removeprefix('sensor_')}_{p.unit}": float(v) for p, v in told})
