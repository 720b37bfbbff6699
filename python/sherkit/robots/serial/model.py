"""The serial arm as a model for identification: where the tracker stands, target, joints and effects."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache, partial
from typing import ClassVar

import numpy as np
import scipy

import sherkit._core as _core

from ...base import linalg
from ...base.types import Floats
from ...data import Measurements
from ...data.columns import Layout
from ...errors import FitError, SherkitWarning
from ...model.base import Reachable
from ...model.chain import Block, ChainModel
from ...model.effect import Effect, Parameter, parameters_of_core
from .columns import CENTRE, PAYLOAD, PLANE, POSITION, TARGET
from .effects import SERIAL_CATALOGUE, effects_of, has, joint_of, parameter_of
from .frames import of_rpy
from .robot import Serial

#: Poses by which the drawing tells what can be identified.
_POSES = 200
#: A parameter that moves the target by less than this part of its own beyond what others do is one of theirs: axes that
#: are drawn parallel are so to fewer digits than numbers have.
_BEYOND = 1e-3
#: What every arm is measured with comes first.
_FIRST = ("frame", "tool", "target", "centre", "plane")
#: Poses from which the next ones are chosen.
_NEXT = 500
_JOINT_DIGITS = 5
_FRAME = ("frame_turn_x", "frame_turn_y", "frame_turn_z", "frame_x", "frame_y", "frame_z")
#: Rows that tell where a tracker stands; in so many rounds, in each of which rows count that are off by no more than
#: this many times the median; and how thin a cloud of places is a line.
_FEWEST, _ROUNDS, _FAR, _LINE = 6, 5, 5.0, 1e-3


@dataclass(frozen=True)
class SerialModel(ChainModel):
    """A nominal serial arm with named errors and effects to identify. Readings are x, y, z of a target, mm, as a
    tracker shows them, or how far it is from a fixed centre or above a plane; the columns ``target``, ``centre`` and
    ``plane`` hold their numbers.

    ``free`` names what is identified of where the tracker sees the base frame (``frame_x``, ``frame_turn_x``, …), of
    the targets (``tool_x`` … of the first, ``target_2_x`` …), of the centres (``centre_1_x`` …) and planes
    (``plane_1_lean_u``, ``plane_1_height`` …), of each joint's zero (``offset_2``), and of where its axis lies
    (``shift_x_2``, ``shift_y_2``) and leans (``tilt_x_2``, ``tilt_y_2``), in its own frame, whose z is the axis. Left
    out, it is :attr:`default`. ``period_rad``, or ``period_mm``
    where every joint slides, is that of the encoders' cyclic error.
    """

    robot: Serial
    slip_time_s: float = 0.0
    joint_slip_time_s: float = 0.0
    thermal_shift_lag_s: float = 0.0
    tracker_slip_time_s: float = 0.0
    time_origin_s: float = 0.0
    period_rad: float | None = None
    period_mm: float | None = None

    catalogue: ClassVar = SERIAL_CATALOGUE
    table: ClassVar = _core.SerialModel.CATALOGUE
    targets: ClassVar = POSITION
    one_posture: ClassVar = False

    @property
    def layouts(self) -> tuple[Layout, ...]:  # type: ignore[override]
        """The runs of this arm."""
        return (self.robot.layout,)

    @cached_property
    def known_effects(self) -> Mapping[str, Effect]:
        """Those of its own joints."""
        return effects_of(self.robot)

    @property
    def base(self) -> tuple[Parameter, ...]:
        """What the table has for every arm, of the joints that it has."""
        return _base_of(self.robot)

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
        return _lever_mm(self.robot, name)

    @property
    def default(self) -> tuple[str, ...]:
        """As many as the drawing lets any plan of poses tell apart: where the tracker and the target are, then one
        after the other that of the joints which, at its plausible size, does most that those before cannot do instead.

        What is left out only says the same once more, as the height of a first axis says that of the tracker. All of
        them can be named in ``free``: the combinations that nobody sees are then held as small as they can be.
        """
        return _told_apart(self.robot)

    def settings(self) -> dict[str, float | None]:
        """Moments of the slips (target, joints, tracker), lag of the stands, origin of time, period of the encoders."""
        unit = self.robot.joint_unit
        return {
            "slip_time_s": self.slip_time_s,
            "joint_slip_time_s": self.joint_slip_time_s,
            "thermal_shift_lag_s": self.thermal_shift_lag_s,
            "tracker_slip_time_s": self.tracker_slip_time_s,
            "time_origin_s": self.time_origin_s,
            f"period_{unit}": self.period_mm if unit == "mm" else self.period_rad,
        }

    @cached_property
    def core(self) -> _core.SerialModel:
        """The compiled model."""
        # without a cyclic error the period does not matter
        period = self.period_rad or self.period_mm or np.pi
        slips = (self.slip_time_s, self.joint_slip_time_s, self.tracker_slip_time_s)
        return self.robot.core((period, self.time_origin_s, *slips))

    def block(self, data: Measurements, joints: Floats | None = None, push: Floats | None = None) -> Block:
        """With the numbers of the targets and what hangs there, where the rows have them."""
        q, ends, covariates, push = super().block(data, joints, push)
        target, payload = data.covariates.get(TARGET), data.covariates.get(PAYLOAD)
        if target is not None or (payload is not None and covariates is not None):
            n, k = data.joints.shape
            known = np.full((n, 3 + 2 * k), np.nan) if covariates is None else covariates
            first, nothing = np.ones(n), np.full(n, np.nan)
            more = [first if target is None else target, nothing if payload is None else payload]
            covariates = np.ascontiguousarray(np.column_stack([known[:, :-1], *more, known[:, -1]]))
        return q, ends, covariates, push

    def require_own(self, data: Measurements) -> None:
        """Also refuses numbers of targets, centres and planes that the arm has not."""
        super().require_own(data)
        robot, ends = self.robot, data.to_joints.T if data.is_distance.any() else (None, None)
        for name, numbers, there in (
            (TARGET, data.covariates.get(TARGET), robot.targets_mm),
            (CENTRE, ends[0], robot.centres_mm),
            (PLANE, ends[1], robot.planes),
        ):
            if name in data.labels:
                raise FitError(f"{data.source}: column '{name}': expected numbers, 1 for the first in the robot file")
            if numbers is None:
                continue
            wrong = np.isfinite(numbers) & ~np.isin(numbers, np.arange(1, len(there) + 1))
            if wrong.any():
                has_them = f"a number from 1 to {len(there)}" if there else f"none: the robot file has no [[{name}]]"
                raise FitError(f"{data.place(wrong)}: {name}: expected {has_them}, found {numbers[wrong][0]:g}")

    def start(self, data: Measurements) -> Floats:
        """The drawing, seen from where the tracker must stand for most of these rows to be as they are: a tracker may
        stand anywhere, and a turn of half a circle is too far for steps from none."""
        self.require_own(data)
        out, names = super().start(data), [p.name for p in self.parameters]
        rows = np.flatnonzero(data.taken[:, : data.coordinates].all(axis=1) & ~data.outlier)
        if not set(_FRAME) <= set(names) or len(rows) < _FEWEST:
            return out
        seen, nominal = data.select(rows), of_rpy(np.deg2rad(self.robot.tracker_rpy_deg).tolist())
        shown, _ = self.core.predict(np.zeros(len(self.core_parameters)), self.block(seen))
        drawn, read = (shown[:, :3] - self.robot.tracker_mm) @ nominal, seen.readings[:, :3]
        near = np.ones(len(rows), dtype=bool)
        for _ in range(_ROUNDS):
            a, b = drawn - drawn[near].mean(axis=0), read - read[near].mean(axis=0)
            if linalg.matrix_rank(a[near], tol=_LINE * float(np.abs(a[near]).max())) < 2:
                return out
            # the best turn of one cloud onto the other (Kabsch, 1976), no mirror
            u, _, v = linalg.svd(b[near].T @ a[near])
            rotation = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ v))]) @ v
            missed = np.linalg.norm(b - a @ rotation.T, axis=1)
            near = missed <= _FAR * np.median(missed)
        shift = read[near].mean(axis=0) - rotation @ drawn[near].mean(axis=0) - np.array(self.robot.tracker_mm)
        error = scipy.spatial.transform.Rotation.from_matrix(rotation @ nominal.T).as_rotvec()
        out[[names.index(name) for name in _FRAME]] = [*error, *shift]
        return out

    def reachable(self, data: Measurements, values: Floats) -> Reachable:
        """Postures between those of the run: a place alone would leave open how the arm stands there."""
        del values
        low, high = data.joints.min(axis=0), data.joints.max(axis=0)
        joints = np.random.default_rng(0).uniform(low, high, (_NEXT, len(low))).round(_JOINT_DIGITS)
        targets = self.robot.forward_batch(joints).require("pose")
        rows = data.unmeasured(joints)
        if not self.robot.has_tracker:
            taken = np.tile([name == rows.layout.distance for name in rows.layout.readings], (len(rows), 1))
            first = (1.0, np.nan) if self.robot.centres_mm else (np.nan, 1.0)
            rows = replace(rows, taken=taken, to_joints=np.tile(first, (len(rows), 1)))
        return Reachable(dict(zip(self.targets, targets.T, strict=True)), rows)

    def reason(self, data: Measurements, row: int, values: Floats) -> str:
        """Joints reach everywhere: it is a column."""
        del data, row, values
        return "an effect that is at work needs a column that these rows lack"


def _lever_mm(robot: Serial, name: str) -> float:
    k, reach = joint_of(name), robot.reach_mm
    if k is not None:
        return float(reach[min(k, len(reach) - 1)])
    return float(reach[0] + np.linalg.norm(robot.tracker_mm) + np.linalg.norm(robot.joints[0].origin_mm))


@lru_cache(maxsize=32)
def _base_of(robot: Serial) -> tuple[Parameter, ...]:
    rows = (row for row in SerialModel.table if row["base"])
    every = (p for row in rows for p in parameters_of_core(row, partial(_lever_mm, robot)))
    mine = (p for p in every if has(robot, p.name))
    return tuple(one for p in mine if (one := parameter_of(p, robot.joints)) is not None)


def _every_reading(robot: Serial, joints: Floats) -> Measurements:
    """Rows at these joints (n, k) of all that can be read of an arm: each target by the tracker, and its distances."""
    seen = range(1, len(robot.targets_mm) + 1)
    none = np.nan
    read = [(target, none, none) for target in seen] if robot.has_tracker else []
    read += [(target, centre, none) for target in seen for centre in range(1, len(robot.centres_mm) + 1)]
    read += [(target, none, plane) for target in seen for plane in range(1, len(robot.planes) + 1)]
    target, centre, plane = np.tile(read, (len(joints), 1)).T
    is_place = np.isnan(centre) & np.isnan(plane)
    layout, places = robot.layout, np.where(is_place, 0.0, np.nan)
    columns = dict(zip(layout.joints, np.repeat(joints, len(read), axis=0).T, strict=True))
    columns |= dict.fromkeys(layout.coordinates, places)
    columns |= {"distance_mm": np.where(is_place, np.nan, 0.0), CENTRE: centre, PLANE: plane, TARGET: target}
    with warnings.catch_warnings():
        # readings that are all zero look as if they were in another unit
        warnings.simplefilter("ignore", SherkitWarning)
        return Measurements.from_columns(columns, "plan", layout=layout)


@lru_cache(maxsize=32)
def _told_apart(robot: Serial) -> tuple[str, ...]:
    """The parameters of the default, see :attr:`SerialModel.default`."""
    every = SerialModel(robot, free=("tool_x",))
    low, high = robot.ranges
    rows = _every_reading(robot, np.random.default_rng(0).uniform(low, high, (_POSES, len(low))))
    names = [p.name for p in every.base]
    whole = replace(every, free=tuple(names))
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
