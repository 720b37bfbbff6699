"""The linear delta as it is drawn: rails, carriages, rod pairs, platform."""

from __future__ import annotations

import numpy as np

from ...base.types import Floats
from ...data import Measurements
from ...model.drawing import Drawing, Part, line, with_target
from .model import DeltaModel

#: Of a limb the core hands over foot and head of its rail, the ends of its rods at the carriage, those at the platform.
_PER_LIMB = 6


def drawing(model: DeltaModel, data: Measurements, values: Floats, readings: Floats | None = None) -> Drawing:
    """The robot at each row, or with ``readings`` (n, m) as what is read. Raises as
    :meth:`~sherkit.model.chain.ChainModel.predict`."""
    points = model.parts(data, values)
    shown = (model.predict(data, values) if readings is None else readings)[:, :3]
    limbs = [points[:, _PER_LIMB * k : _PER_LIMB * (k + 1)] for k in range(3)]
    centre, tip, target = (points[:, 3 * _PER_LIMB + k] for k in range(3))
    parts = [Part(f"rail {k}", "frame", limb[:, :2]) for k, limb in enumerate(limbs, 1)]
    for k, limb in enumerate(limbs, 1):
        parts += [Part(f"rod {k}{side}", "rod", limb[:, [2 + i, 4 + i]]) for i, side in enumerate("ab")]
        parts += [
            Part(f"carriage {k}", "link", limb[:, 2:4]),
            Part(f"joint {k}", "joint", limb[:, 2:4].mean(axis=1, keepdims=True)),
        ]
    parts += [
        Part("platform", "platform", _round(limbs, centre)),
        Part("arm to the measured point", "link", line(centre, tip)),
        Part("from the platform's end to the measured point", "ray", line(tip, target)),
    ]
    return with_target(parts, target, shown)


def _round(limbs: list[Floats], centre: Floats) -> Floats:
    """Once round the platform: the axis of each limb, then on to the next one's, as they lie at the first row."""
    ends = np.concatenate([limb[:, 4:] for limb in limbs], axis=1)
    away = ends[0] - centre[0]
    # two rods that are one lie behind one another
    order = np.argsort(np.arctan2(away[:, 1], away[:, 0]), kind="stable")
    return ends[:, [*order, order[0]]]
