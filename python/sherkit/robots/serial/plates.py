"""Targets that belong together: of one plate, whose spacing is known, all are one rigid body.

Three nests on a plate are nine numbers by themselves and six as a body: where the first of them sits, and three turns
of the plate about it. The chain is the compiled one; here its numbers for each target follow from those six.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

import sherkit._core as _core

from ...base.types import Bools, Floats, Ints
from ...data import Measurements
from ...fit.numpy_chain import NumpyChain
from ...model.chain import Block, ChainModel
from ...model.effect import Parameter
from ...model.sensor_pose import OWN_AXES, left_jacobian, rotation_matrix
from .robot import Serial

# -- Sockets -----------------------------------------------------------------------------------------------------------
# A ball in its socket: a distance of nothing is a place that is known in three directions.
#
# The distance itself, the length of a vector, has no derivative where it is zero, and one direction of three beside
# it; its square is the same as that of the vector. A fit of the vector ends in the minimum of a fit of the lengths,
# in a few steps (J. Nocedal and S. Wright, *Numerical Optimization*, 10.3: Gauss–Newton needs residuals that are
# nearly straight).

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
        model, names = self.model, np.array([p.name for p in self.model.parameters])
        of_sensor = np.char.startswith(names, "sensor_")
        still = np.where(of_sensor, 0.0, values)
        places = self.of_base.predict(self.as_places, still)[:, :3]
        columns = self.of_base.derivatives(self.as_places, still)[:, :3] * ~of_sensor
        # which parameter each of these coordinates of a socket is
        own = [[[f"centre_{number + 1}_{axis}"] == names for axis in "xyz"] for number in self.sockets]
        by_centres = np.array(own, dtype=float)
        off = places - np.array(model.robot.centres_mm)[self.sockets] - by_centres @ values
        return off, columns - by_centres


def sockets_of(model: ChainModel, data: Measurements) -> Sockets | None:
    """The rows of a run in which the ball was in a socket; None where there are none, and where what acts at the
    instrument lengthens distances."""
    if not data.is_distance.any() or any(effect.link == "sensor" for effect in model.effects):
        return None
    rows = np.flatnonzero(np.isfinite(data.to_joints[:, 0]) & (np.abs(data.readings[:, -1]) <= _IN_SOCKET_MM))
    if len(rows) == 0:
        return None
    made, sockets = data.select(rows), data.to_joints[rows, 0].astype(np.int64) - 1
    taken = np.tile([name != data.layout.distance for name in data.layout.readings], (len(rows), 1))
    none = np.full(made.to_joints.shape, np.nan)
    made = replace(made, taken=taken, to_joints=none, readings=np.zeros(made.readings.shape))
    robot = replace(model.robot, sensor_pose=OWN_AXES, has_tracker=True)
    of_base = replace(model, robot=robot, free=tuple(p.name for p in model.bare))
    return Sockets(model, rows, sockets, made, of_base)


# -- Plates ------------------------------------------------------------------------------------------------------------

#: How far a plate may be turned on its flange, rad.
_TURN = 0.05


@dataclass(frozen=True)
class Plate:
    """Targets of one group: its name, and their numbers from 0, the first of them first."""

    name: str
    targets: tuple[int, ...]

    @property
    def turns(self) -> tuple[str, ...]:
        """The names of its three turns, about the axes of the last joint's frame."""
        return tuple(f"{self.name}_turn_{axis}" for axis in "xyz")


def plates_of(robot: Serial) -> tuple[Plate, ...]:
    """The groups of an arm's targets, in the order of the file."""
    groups = robot.groups
    names = dict.fromkeys(name for name in groups if name)
    return tuple(Plate(name, tuple(k for k, one in enumerate(groups) if one == name)) for name in names)


def of_target(number: int) -> tuple[str, ...]:
    """The chain's own names for where a target sits, its number counted from 0."""
    return tuple(f"{'tool' if number == 0 else f'target_{number + 1}'}_{axis}" for axis in "xyz")


def renamed(robot: Serial) -> Mapping[str, str]:
    """What the turns of plates are called, by the names in the chain whose places they take: those of the second of its
    targets."""
    return {old: new for one in plates_of(robot) for old, new in zip(of_target(one.targets[1]), one.turns, strict=True)}


def as_plates(robot: Serial, base: Sequence[Parameter]) -> tuple[Parameter, ...]:
    """The parameters of an arm whose plates are bodies: turns in the place of the second target, none for more."""
    called, turns, gone = renamed(robot), dict[str, Parameter](), set[str]()
    for one in plates_of(robot):
        reach = float(np.linalg.norm(_apart(robot, one), axis=1).max())
        turns |= {name: Parameter(name, name, "rad", _TURN, reach) for name in one.turns}
        gone |= {name for k in one.targets[2:] for name in of_target(k)}
    return tuple(turns.get(called.get(p.name, ""), p) for p in base if p.name not in gone)


def offsets(robot: Serial, values: Mapping[str, float]) -> Floats:
    """By how much each target (t, 3) is off, mm, in the frame of the last joint whose z is its axis, by ``values`` of
    parameters by name."""
    out = np.array([[values.get(name, 0.0) for name in of_target(k)] for k in range(len(robot.targets))])
    for one in plates_of(robot):
        turn = rotation_matrix(np.array([values.get(name, 0.0) for name in one.turns]))
        first, others = one.targets[0], list(one.targets[1:])
        out[others] = out[first] + _apart(robot, one) @ (turn - np.eye(3)).T
    return out


def _apart(robot: Serial, plate: Plate) -> Floats:
    """From the first target of a plate to its others (k, 3), mm."""
    return np.asarray(robot.targets[list(plate.targets[1:])] - robot.targets[plate.targets[0]])


@dataclass(frozen=True, eq=False)
class PlateChain(NumpyChain):
    """The compiled chain of an arm with plates. Its numbers stand where the chain has them; the turns of a plate in the
    places of its second target."""

    core: _core.SerialModel
    robot: Serial
    names: tuple[str, ...]

    def own(self, values: Floats) -> Floats:
        """The chain's own values for those of the plates."""
        called = renamed(self.robot)
        known = {called.get(name, name): float(v) for name, v in zip(self.names, values, strict=True)}
        out = values.copy()
        for k, off in enumerate(offsets(self.robot, known)):
            out[self._places(k)] = off
        return out

    def _places(self, target: int) -> Ints:
        return np.array([self.names.index(name) for name in of_target(target)])

    def predict(self, values: Floats, block: Block) -> tuple[Floats, Bools]:
        """Readings (n, m), and which rows could be computed."""
        return self.core.predict(self.own(values), block)

    def parts(self, values: Floats, block: Block) -> tuple[Floats, Bools]:
        """As the compiled chain."""
        return self.core.parts(self.own(values), block)

    def derivatives(self, values: Floats, block: Block, free: Sequence[int]) -> tuple[Floats, Floats, Floats, Bools]:
        """By the parameters ``free``, the joints and a displacement of the point (n, m, ·), and which rows could be
        computed."""
        by_own = np.eye(len(self.names))
        for one in plates_of(self.robot):
            first, second = (self._places(k) for k in one.targets[:2])
            turn = values[second]
            by_own[:, second] = 0.0
            for k, apart in zip(one.targets[1:], _apart(self.robot, one), strict=True):
                mine = self._places(k)
                by_own[np.ix_(mine, first)] = np.eye(3)
                # of a turned vector by the rotation vector of its turn
                by_own[np.ix_(mine, second)] = np.cross(left_jacobian(turn).T, rotation_matrix(turn) @ apart).T
        columns = np.flatnonzero(by_own[:, list(free)].any(axis=1))
        found: tuple[Any, ...] = self.core.derivatives(self.own(values), block, columns.tolist())
        return found[0] @ by_own[columns][:, list(free)], found[1], found[2], found[3]
