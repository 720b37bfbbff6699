"""Two names for one thing: which effects a machine's own function, or where its instrument stands, has already."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from ...base import linalg
from ...base.types import Floats
from ...model.sensor_pose import FREE, POSE, SensorPose
from .core import Generic, MachineCore, sensor_pose
from .function import UserFunction

#: Part of a parameter's columns that must be left where those of others are taken out, for it to be another thing.
_SAME = 1e-3
#: Turns of an instrument about its axes, rad, and its shifts: as good as any.
_ANYHOW = np.array([0.5, 0.7, 0.9, 0.0, 0.0, 0.0])


def not_in(
    function: UserFunction, pose: SensorPose | None, open_of_pose: Collection[str], effects: Sequence[Generic]
) -> tuple[Generic, ...]:
    """The sensor's pose, first, where any of its numbers is open, and the effects without those parameters that do what
    the function's own, or those of the pose, do already.

    Where parameters of the function turn or shift the machine, as a zero of a lift or base points do, the pose is what
    does: it may be anywhere, and no reading tells them, so that they stay as drawn. Of an effect whose own parameters
    say one thing twice once the pose is out (a rail that leans to its neighbour, and the neighbour to it), the first is
    kept. Found at places over the joints' ranges.
    """
    every = (sensor_pose(open_of_pose), *effects)
    columns, places = _columns(function, pose, every)
    taken = _basis(columns[:, : places[0].stop])
    out = [every[0]] if every[0].parameters else []
    for one, place in zip(every[1:], places[1:], strict=True):
        if one.search:
            out.append(one)
            continue
        kept, mine = [], taken
        for k in range(len(one.parameters)):
            left = columns[:, place.start + k]
            left = left - mine @ (mine.T @ left)
            size = float(np.linalg.norm(left))
            if size > _SAME:
                kept.append(k)
                mine = np.column_stack([mine, left / size])
        if kept:
            out.append(one.only(kept) if len(kept) < len(one.parameters) else one)
    return tuple(out)


def _columns(
    function: UserFunction, pose: SensorPose | None, effects: Sequence[Generic]
) -> tuple[Floats, Sequence[slice]]:
    """What each parameter moves, to length 1, where all others are zero; and where those of each effect stand. An
    instrument that may stand anywhere is turned: what it has along its own axes is not what the machine has along
    those of the base."""
    joints = function.somewhere
    k, count = joints.shape[1], len(function.parameters)
    n, rng = len(joints), np.random.default_rng(1)
    known = np.column_stack([60.0 * np.arange(n), 20.0 + rng.normal(size=n), rng.choice([-1.0, 1.0], (n, k)),
                             rng.normal(size=(n, k)), 20.0 + rng.normal(size=n)])  # fmt: skip
    late = 30.0 * n
    core = MachineCore(function, tuple(effects), pose, (1.0,) * k, 0.0, late, late, late)
    total = count + sum(len(one.parameters) for one in effects)
    values = np.zeros(total)
    anyhow = dict(zip(POSE, _ANYHOW * np.isinf(pose.sd(FREE, FREE)), strict=True)) if pose is not None else {}
    values[core.places[0]] = [anyhow[name] for name, *_ in effects[0].parameters]
    columns = core.derivatives(values, (joints, None, known, None), range(total))[0]
    whole = np.asarray(np.isfinite(columns).all(axis=(1, 2)))
    columns = columns[whole].reshape(-1, total)
    length = np.sqrt((columns**2).sum(axis=0))
    return columns / np.where(length > 0, length, 1.0), core.places


def _basis(columns: Floats) -> Floats:
    basis, size, _ = linalg.svd(columns, full_matrices=False)
    return np.asarray(basis[:, size > _SAME * size.max(initial=0.0)])
