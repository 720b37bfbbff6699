"""What the free pose of a sensor takes up: directions of effects and of the geometry that these readings cannot tell
from where the instrument stands. A lean common to all rails is a tilt of the tracker, a turn common to all base angles
its turn; a target fixed to the base would tell them apart, no reading of the tool does."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..base import linalg
from ..base.names import listed
from ..base.types import Floats
from ..data import Measurements
from ..fit.plausible import thinned
from ..fit.table import Direction
from ..model.base import ModelWithEffects
from ..model.effect import Effect
from ..model.sensor_pose import POSE
from ..model.set_ups import SETUP_PREFIX
from .linearised import orthonormal

#: Part of a direction that is left at most where it is taken up.
_TAKEN = 0.05
#: Directions of an effect beside its strongest that count.
_COUNTS = 1e-3


def taken_by_pose(
    model: ModelWithEffects, rows: Measurements, values: Floats, effects: Sequence[Effect]
) -> dict[str, tuple[int, int]]:
    """Of each effect how many of its directions only the sensor's pose takes up, of how many that the other parameters
    leave; those of which it takes none are not there."""
    names = [p.name for p in model.parameters]
    of_pose = np.array(
        [
            name.startswith((*POSE, SETUP_PREFIX)) and not p.known
            for name, p in zip(names, model.parameters, strict=True)
        ],
        dtype=bool,
    )
    if not of_pose.any():
        return {}
    data = thinned(rows)
    fitted = _flat(data, model.derivatives(data, values))
    others, whole = orthonormal(fitted[:, ~of_pose]), orthonormal(fitted)
    # what is searched for besides is a moment, a lag or a period: no pose that stays
    asked = [one for one in model.can_be_tried(effects, data)[0] if one.search is None]
    tried = model.tried(data, values, asked)
    every = _flat(data, tried.columns(slice(None)))
    out = {}
    for effect, at in tried.effects:
        columns = every[:, at] * [p.size for p in effect.parameters]
        if not np.isfinite(columns).all():
            continue
        before, after = (columns - basis @ (basis.T @ columns) for basis in (others, whole))
        value, vector = linalg.eigh(before.T @ before)
        kept = value > _COUNTS**2 * max(float(np.square(columns).sum(axis=0).max(initial=0.0)), 1e-300)
        root = vector[:, kept] / np.sqrt(value[kept])
        if not root.shape[1]:
            continue
        left = linalg.eigvalsh(root.T @ (after.T @ after) @ root)
        if taken := int(np.count_nonzero(left < _TAKEN**2)):
            out[effect.name] = (taken, root.shape[1])
    return out


def _flat(data: Measurements, columns: Floats) -> Floats:
    return np.asarray(columns[data.used])


def pose_in_words(unobserved: Sequence[Direction], taken: dict[str, tuple[int, int]]) -> str | None:
    """What the pose takes up, in a sentence, with the combinations of parameters that no reading shows; None where it
    is told from everything."""
    named = [f"{count} of the {of} directions of {name}" for name, (count, of) in taken.items()]
    same = []
    for one in unobserved:
        mine = [name for name in one.change if name.startswith((*POSE, SETUP_PREFIX))]
        others = [name for name in one.change if name not in mine]
        if mine and others:
            same.append(f"{listed(mine)} from {listed(sorted(others))} together")
    if not named and not same:
        return None
    told = "The sensor's pose is free"
    if named:
        told += f": it takes up {listed(named, 12)}"
    if same:
        told += f"{'; nor' if named else ':'} can these readings tell {'; '.join(same)}"
    return (
        f"{told}. Three points fixed to the base that are read as well would tell where their places in its frame are "
        "known (sensor_pose of the robot's file, by SensorPose.from_targets), or a level on the base."
    )
