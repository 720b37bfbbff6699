"""The serial arm as it is drawn: its links from joint to joint, the axes, the target."""

from __future__ import annotations

import numpy as np

from ...base.types import Floats
from ...data import Measurements
from ...model.drawing import Drawing, DrawnPart, line, with_target
from .model import SerialModel

#: Half the length of a drawn axis, and of the axes of the base, by the reach of the arm.
_AXIS, _BASE = 0.06, 0.12


def drawing(model: SerialModel, data: Measurements, values: Floats, readings: Floats | None = None) -> Drawing:
    """The arm at each row, or with ``readings`` (n, m) as what is read. Raises as
    :meth:`~sherkit.model.chain.ChainModel.predict`."""
    robot, points = model.robot, model.parts(data, values)
    # what the tracker shows, seen from the base
    shown = model.at_base((model.predict(data, values) if readings is None else readings)[:, :3], values)
    reach = float(robot.reach_mm[0])
    base = _BASE * reach * np.eye(3)
    parts = [DrawnPart(f"{axis} of the base", "guide", line(np.zeros(3), base[k])) for k, axis in enumerate("xyz")]
    behind = np.zeros_like(points[:, 0])
    for k in range(1, len(robot.joints) + 1):
        # of a joint the core hands over a point of its axis, a second one along it, and where what it carries is
        origin, along, carried = (points[:, 3 * (k - 1) + i] for i in range(3))
        half = _AXIS * reach * (along - origin)
        parts += [
            DrawnPart(f"link {k - 1}" if k > 1 else "base", "link", line(behind, origin)),
            DrawnPart(f"axis {k}", "axis", line(origin - half, origin + half)),
            DrawnPart(f"slide {k}", "rod", line(origin, carried)),
            DrawnPart(f"joint {k}", "joint", line(origin)),
        ]
        behind = carried
    tip, target = points[:, -2], points[:, -1]
    parts += [
        DrawnPart("tool", "platform", line(behind, tip)),
        DrawnPart("from the tool's end to the target", "ray", line(tip, target)),
    ]
    return with_target(parts, target, shown)
