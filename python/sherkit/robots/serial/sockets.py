"""A ball in its socket: a distance of nothing is a place that is known in three directions.

The distance itself, the length of a vector, has no derivative where it is zero, and one direction of three beside it;
its square is the same as that of the vector. A fit of the vector ends in the minimum of a fit of the lengths, in a few
steps (J. Nocedal and S. Wright, *Numerical Optimization*, 10.3: Gauss–Newton needs residuals that are nearly straight).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...base.types import Floats, Ints
from ...data import Measurements
from ...model.chain import ChainModel
from ...model.sensor_pose import OWN_AXES

#: A distance from a centre that is no longer is a ball in its socket, mm.
_IN_SOCKET_MM = 0.01


@dataclass(frozen=True, eq=False)
class Sockets:
    """``rows`` (k,) of a run, the sockets (k,) that they were in, from 0, and these rows as places of a model whose
    tracker stands in the base."""

    model: ChainModel
    rows: Ints
    sockets: Ints
    as_places: Measurements
    of_base: ChainModel

    def at(self, values: Floats) -> tuple[Floats, Floats]:
        """How far the ball is from its socket (k, 3), mm, with derivatives (k, 3, p). Raises as ``predict``."""
        model, names = self.model, [p.name for p in self.model.parameters]
        of_sensor = np.array([name.startswith("sensor_") for name in names])
        still = np.where(of_sensor, 0.0, values)
        places = self.of_base.predict(self.as_places, still)[:, :3]
        columns = self.of_base.derivatives(self.as_places, still)[:, :3] * ~of_sensor
        off = places - np.array(model.robot.centres_mm)[self.sockets]
        for number in np.unique(self.sockets):
            for axis, letter in enumerate("xyz"):
                if (name := f"centre_{number + 1}_{letter}") in names:
                    k, here = names.index(name), self.sockets == number
                    off[here, axis] -= values[k]
                    columns[here, axis, k] -= 1.0
        return off, columns


def sockets_of(model: ChainModel, data: Measurements) -> Sockets | None:
    """The rows of a run in which the ball was in a socket; None where there are none, and where what acts at the
    instrument lengthens distances."""
    if not data.is_distance.any() or any(effect.link == "sensor" for effect in model.effects):
        return None
    rows = np.flatnonzero(np.isfinite(data.to_joints[:, 0]) & (np.abs(data.readings[:, -1]) <= _IN_SOCKET_MM))
    if len(rows) == 0:
        return None
    made = data.select(rows)
    taken = np.tile([name != data.layout.distance for name in data.layout.readings], (len(rows), 1))
    none = np.full(made.to_joints.shape, np.nan)
    made = replace(made, taken=taken, to_joints=none, readings=np.zeros(made.readings.shape))
    free = tuple(p.name for p in model.bare)
    robot = replace(model.robot, sensor_pose=OWN_AXES, has_tracker=True)
    # a frozen dataclass, as each model of a robot is
    changed: Any = replace
    of_base = changed(model, robot=robot, free=free)
    return Sockets(model, rows, data.to_joints[rows, 0].astype(np.int64) - 1, made, of_base)
