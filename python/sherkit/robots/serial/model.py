"""The serial arm as a model for identification: where the tracker stands, target, joints and effects."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import ClassVar

import numpy as np
from scipy.spatial.transform import Rotation

import sherkit._core as _core

from ...data import Measurements
from ...data.columns import Layout
from ...model.base import Reachable
from ...model.chain import ChainModel
from ...model.effect import Effect, parameters_of_core
from ...model.parameter import Parameter
from ...types import Floats
from .columns import POSITION
from .effects import SERIAL_CATALOGUE, effects_of, joint_of, parameter_of
from .frames import of_rpy
from .robot import Serial

#: Poses by which the drawing tells what can be identified.
_POSES = 200
#: A parameter that moves the target by less than this part of its own beyond what others do is one of theirs: axes that
#: are drawn parallel are so to fewer digits than numbers have.
_BEYOND = 1e-3
#: What every arm is measured with comes first.
_FIRST = ("frame", "tool")
#: Poses from which the next ones are chosen.
_NEXT = 500
_JOINT_DIGITS = 5
_FRAME = ("frame_turn_x", "frame_turn_y", "frame_turn_z", "frame_x", "frame_y", "frame_z")
#: Rows that tell where a tracker stands; in so many rounds, in each of which rows count that are off by no more than
#: this many times the median; and how thin a cloud of places is a line.
_FEWEST, _ROUNDS, _FAR, _LINE = 6, 5, 5.0, 1e-3


@dataclass(frozen=True)
class SerialModel(ChainModel):
    """A nominal serial arm with named errors and effects to identify. Readings are x, y, z of the target, mm, as a
    tracker shows them.

    ``free`` names what is identified of where the tracker sees the base frame (``frame_x``, ``frame_turn_x``, …), of
    the target (``tool_x`` …), of each joint's zero (``offset_2``), and of where its axis lies (``shift_x_2``,
    ``shift_y_2``) and leans (``tilt_x_2``, ``tilt_y_2``), in its own frame, whose z is the axis. Left out, it is
    :attr:`default`. ``period_rad``, or ``period_mm`` where every joint slides, is that of the encoders' cyclic error.
    """

    robot: Serial
    slip_time_s: float = 0.0
    tracker_slip_time_s: float = 0.0
    time_origin_s: float = 0.0
    period_rad: float | None = None
    period_mm: float | None = None

    catalogue: ClassVar = SERIAL_CATALOGUE
    table: ClassVar = _core.SerialModel.CATALOGUE
    targets: ClassVar = POSITION

    @property
    def layouts(self) -> tuple[Layout, ...]:  # type: ignore[override]
        """The runs of this arm."""
        return (self.robot.layout,)

    @cached_property
    def known_effects(self) -> Mapping[str, Effect]:
        """Those of its own joints."""
        return effects_of(self.robot)

    @cached_property
    def base(self) -> tuple[Parameter, ...]:
        """What the table has for every arm, of the joints that it has."""
        every = (p for row in self.table if row["base"] for p in parameters_of_core(row, self.lever_mm))
        return tuple(one for p in every if (one := parameter_of(p, self.robot.joints)) is not None)

    @cached_property
    def core_parameters(self) -> tuple[Parameter, ...]:
        """Every parameter of the compiled chain, in its order; those of joints that it has not among them."""
        out: list[Parameter] = []
        for row in self.table:
            base = parameters_of_core(row, self.lever_mm)
            out += base if row["base"] else self.catalogue[row["name"]].qualified()
        return tuple(out)

    def lever_mm(self, name: str) -> float:
        """An angle moves what stands behind its joint; a turn of the tracker all of the arm, as far as that is away."""
        k, reach = joint_of(name), self.robot.reach_mm
        if k is not None:
            return float(reach[min(k, len(reach) - 1)])
        return float(reach[0] + np.linalg.norm(self.robot.tracker_mm) + np.linalg.norm(self.robot.joints[0].origin_mm))

    @property
    def default(self) -> tuple[str, ...]:
        """As many as the drawing lets any plan of poses tell apart: where the tracker and the target are, then one
        after the other that of the joints which, at its plausible size, does most that those before cannot do instead.

        What is left out only says the same once more, as the height of a first axis says that of the tracker. All of
        them can be named in ``free``: the combinations that nobody sees are then held as small as they can be.
        """
        return _told_apart(self.robot)

    def settings(self) -> dict[str, float | None]:
        """Moments at which target and tracker slip, origin of time, period of the encoders."""
        unit = self.robot.joint_unit
        return {
            "slip_time_s": self.slip_time_s,
            "tracker_slip_time_s": self.tracker_slip_time_s,
            "time_origin_s": self.time_origin_s,
            f"period_{unit}": self.period_mm if unit == "mm" else self.period_rad,
        }

    @cached_property
    def core(self) -> _core.SerialModel:
        """The compiled model."""
        # without a cyclic error the period does not matter
        period = self.period_rad or self.period_mm or np.pi
        return self.robot.core((period, self.time_origin_s, self.slip_time_s, self.tracker_slip_time_s))

    def start(self, data: Measurements) -> Floats:
        """The drawing, seen from where the tracker must stand for most of these rows to be as they are: a tracker may
        stand anywhere, and a turn of half a circle is too far for steps from none."""
        self.require_own(data)
        out, names = super().start(data), [p.name for p in self.parameters]
        rows = np.flatnonzero(data.taken.all(axis=1) & ~data.outlier)
        if not set(_FRAME) <= set(names) or len(rows) < _FEWEST:
            return out
        drawn, read = self.robot.forward_batch(data.joints[rows]).values, data.readings[rows]
        near = np.ones(len(rows), dtype=bool)
        for _ in range(_ROUNDS):
            a, b = drawn - drawn[near].mean(axis=0), read - read[near].mean(axis=0)
            if np.linalg.matrix_rank(a[near], tol=_LINE * float(np.abs(a[near]).max())) < 2:
                return out
            # the best turn of one cloud onto the other (Kabsch, 1976), no mirror
            u, _, v = np.linalg.svd(b[near].T @ a[near])
            rotation = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ v))]) @ v
            missed = np.linalg.norm(b - a @ rotation.T, axis=1)
            near = missed <= _FAR * np.median(missed)
        shift = read[near].mean(axis=0) - rotation @ drawn[near].mean(axis=0) - np.array(self.robot.tracker_mm)
        nominal = of_rpy(np.deg2rad(self.robot.tracker_rpy_deg).tolist())
        error = Rotation.from_matrix(rotation @ nominal.T).as_rotvec()
        out[[names.index(name) for name in _FRAME]] = [*error, *shift]
        return out

    def reachable(self, data: Measurements, values: Floats) -> Reachable:
        """Postures between those of the run: a place alone would leave open how the arm stands there."""
        del values
        low, high = data.joints.min(axis=0), data.joints.max(axis=0)
        joints = np.random.default_rng(0).uniform(low, high, (_NEXT, len(low))).round(_JOINT_DIGITS)
        targets = self.robot.forward_batch(joints).require("pose")
        return Reachable(dict(zip(self.targets, targets.T, strict=True)), data.unmeasured(joints))

    def reason(self, data: Measurements, row: int, values: Floats) -> str:
        """Joints reach everywhere: it is a column."""
        del data, row, values
        return "an effect that is at work needs a column that these rows lack"


@lru_cache(maxsize=32)
def _told_apart(robot: Serial) -> tuple[str, ...]:
    """The parameters of the default, see :attr:`SerialModel.default`."""
    every = SerialModel(robot, free=("tool_x",))
    names = [p.name for p in every.base]
    whole = replace(every, free=tuple(names))
    joints = np.random.default_rng(0).uniform(robot.ranges[0], robot.ranges[1], (_POSES, len(robot.joints)))
    rows = Measurements.planned(joints, robot.layout)
    columns = whole.derivatives(rows, np.zeros(len(names))).reshape(-1, len(names))
    left = columns * [p.size for p in every.base]
    whole_size = np.linalg.norm(left, axis=0)
    first = [name.startswith(_FIRST) for name in names]
    chosen: list[int] = []
    while True:
        size = np.linalg.norm(left, axis=0)
        able = size > _BEYOND * whole_size
        able[chosen] = False
        if not able.any():
            return tuple(names[k] for k in sorted(chosen))
        among = able & first if (able & first).any() else able
        best = int(np.argmax(np.where(among, size, 0.0)))
        chosen.append(best)
        along = left[:, best] / size[best]
        left = left - np.outer(along, along @ left)
