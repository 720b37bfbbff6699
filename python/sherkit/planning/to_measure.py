"""Which poses to measure where nothing is known yet: those that show most of every known effect beside what is fitted,
and as many more that fill the workspace, so that what no catalogue has is seen as well.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..base import linalg
from ..base.arguments import Count, Seed, validate_arguments
from ..base.types import Floats, Ints
from ..data import Measurements
from ..data.columns import TIME
from ..data.in_time import directions
from ..evidence.design import showing
from ..model.chain import ChainModel
from ..model.kinds import kind_of, model_of
from ..model.robot_file import RobotLike, read_robot
from .effect_power import planning_of
from .region import CANDIDATES, Region, planned

#: What is known from the outset of what is fitted is next to nothing.
_RIDGE = 1e-3


@validate_arguments
@linalg.one_thread()
def poses_to_measure(
    robot: RobotLike, count: Count = 40, *, repeats: Count = 2, seed: Seed = 0
) -> list[dict[str, float]]:
    """The rows to measure, in this order: each a pose by its number and its joint readings; all poses once, then all of
    them again in another order, so that time does not look like space and joints come from both sides.

    Raises :class:`~sherkit.errors.ExperimentError` for a robot whose file does not say how far it may go.
    """
    drawn = read_robot(robot)
    model, layout = model_of(drawn), kind_of(drawn).layout
    region = Region.of(model, layout)
    places = region.spread(max(CANDIDATES, 2 * count), seed)
    rng = np.random.default_rng(seed)
    ways = {f"direction_{k + 1}": rng.choice([-1.0, 1.0], len(places)) for k in range(places.joints.shape[1])}
    rows = planned(places.joints, layout, ways)
    chosen = _telling(model, rows, count - count // 2, rng)
    # those that come first fill the region evenly
    others = np.setdiff1d(np.arange(len(places)), chosen)[: count // 2]
    joints = places.joints[rng.permutation(np.concatenate([chosen, others]))]
    order = np.concatenate([rng.permutation(len(joints)) for _ in range(repeats)])
    return [
        {"pose": int(row) + 1, **dict(zip(layout.joints, joints[row].tolist(), strict=True))} for row in order.tolist()
    ]


def rows_at(joints: Floats, model: ChainModel, pace_s: float | None = None) -> Measurements:
    """Rows that will be read at these joints (n, k), one after another, each ``pace_s`` after the one before; each
    joint comes from where it was there."""
    came = directions(joints, np.arange(len(joints)), begins=1.0)
    ways = {f"direction_{k + 1}": column for k, column in enumerate(came.T)}
    if pace_s is not None:
        ways[TIME] = pace_s * np.arange(len(joints))
    return planned(joints, kind_of(model.robot).layout, ways)


def showing_first(free: Floats, effects: Sequence[Floats], count: int, first: int, rng: np.random.Generator) -> Ints:
    """Rows (k,) in a random order that show most of all ``effects``, columns (n, m, q) each over the noise and at their
    plausible size, beside what is ``free`` (n, m, p), which alone counts for the ``first`` of them."""
    scale = np.linalg.norm(free.reshape(-1, free.shape[2]), axis=0) / np.sqrt(len(free))
    x = free / np.where(scale > 0, scale, 1.0)
    infos = [np.diag([_RIDGE] * x.shape[2] + [1.0 + _RIDGE] * z.shape[2]) for z in effects]
    parts = [(info, np.concatenate([x, z], axis=2)) for info, z in zip(infos, effects, strict=True)]
    found = showing(x, _RIDGE * np.eye(x.shape[2]), parts, count, first=first)
    return rng.permutation(np.array(found, dtype=np.int64))


def _telling(model: ChainModel, rows: Measurements, count: int, rng: np.random.Generator) -> Ints:
    """Rows (k,) that tell the model's parameters, and every effect that these rows can show beside them."""
    planning, shape = planning_of(model, rows, 1.0), (len(rows), rows.coordinates, -1)
    free = planning.columns_of(model).reshape(shape)
    own = [columns.reshape(shape) for columns in planning.effect_columns.values()]
    # a tenth of what its plausible size moves in the mean is what an effect is looked for with
    noise = 0.1 * float(np.sqrt(np.mean([np.square(z.sum(axis=2)).mean() for z in own]))) if own else 1.0
    return showing_first(free, [z / noise for z in own], count, -(-free.shape[2] // rows.coordinates), rng)
