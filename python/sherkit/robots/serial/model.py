"""The serial arm as a model for identification: where the tracker stands, target, joints and effects.

The table of the effects, for all the joints that an arm may have, is `rust/core/src/serial/effects.rs`, the sentences
on them are in `sentences.py`; here is which of them an arm has.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any, ClassVar

import numpy as np

import sherkit._core as _core

from ...base.figures import listed
from ...base.types import Floats
from ...data import Measurements
from ...data.columns import Layout, unit_in
from ...errors import FitError
from ...model.base import Reachable
from ...model.chain import Block, ChainModel
from ...model.effect import Effect, Parameter, Setting, effects_of_row, parameters_of_core
from ...model.sentences import catalogue_of
from ...model.tolerances import Apart
from .plates import PlateChain, Sockets, as_plates, plates_of, renamed, sockets_of
from .robot import CENTRE, PAYLOAD, PLANE, POSITION, TARGET, Joint, Serial
from .sentences import OWN

# -- Effects ------------------------------------------------------------------------------------------------------

#: The effects by name, in the order of the chain, for all the joints that an arm may have.
SERIAL_CATALOGUE: dict[str, Effect] = catalogue_of(_core.SerialModel.CATALOGUE, OWN)

#: Postures by which the drawing tells what weight does, and the part of what a joint moves that counts as nothing.
_POSTURES, _NOTHING = 50, 1e-9
#: Millimetres of a sliding joint that are as plausible as a radian of a turning one.
_SLIDE_MM = 100.0
#: What a payload does to joints that turn; to one that slides so much is plausible, under a common weight of one.
_BY_MOMENT, _SLIDE_MM_BY_N, _PAYLOAD_N = "rad/(N·m)", 1e-3, 40.0
#: Effects of which the drawing leaves some parameters nothing to do: no weight turns an upright joint, no link grows
#: that has no length.
_BY_DRAWING = ("joint_compliance", "payload_compliance", "link_growth")
#: What the weights of the links do.
_BY_WEIGHT = "joint_compliance"


def joint_of(name: str) -> int | None:
    """The joint, from zero, that a parameter of the table belongs to by its number; None for one of the whole arm."""
    number = name.rpartition("_")[2]
    return int(number) - 1 if number.isdigit() else None


def has(robot: Serial, name: str) -> bool:
    """Whether an arm has the instrument or target that a parameter or effect of the table belongs to by its name."""
    kind, _, rest = name.partition("_")
    there = {"target": robot.targets_mm, "centre": robot.centres_mm, "plane": robot.planes}
    if kind in there:
        return int(rest[0]) <= len(there[kind])
    if name == "bar_zero":
        return bool(robot.centres_mm)
    return robot.has_tracker or kind != "sensor"


def parameter_of(parameter: Parameter, joints: Sequence[Joint]) -> Parameter | None:
    """A parameter of the table as an arm has it: in the unit of its joint; None where it has no such joint."""
    k = joint_of(parameter.name)
    if k is None or "rad" not in parameter.unit:
        return parameter if k is None or k < len(joints) else None
    if k >= len(joints):
        return None
    if parameter.unit == _BY_MOMENT:
        if not joints[k].slides:
            return parameter
        return replace(parameter, unit="mm/N", size=_SLIDE_MM_BY_N, lever_mm=_PAYLOAD_N)
    # shares and scales count what one joint does by what another reads, or itself
    over = [k - 1 if parameter.name.startswith("share") else k] if "/" in parameter.unit else []
    unit = "/".join(joints[i].unit for i in (k, *over))
    size = parameter.size * (_SLIDE_MM if joints[k].slides else 1.0)
    for i in over:
        size /= _SLIDE_MM if joints[i].slides else 1.0
    lever = 1.0 if joints[k].slides and not over else parameter.lever_mm
    return replace(parameter, unit=unit, size=size, lever_mm=lever)


@lru_cache(maxsize=32)
def effects_of(robot: Serial) -> Mapping[str, Effect]:
    """The effects that an arm can have, with the parameters of its own joints."""
    joints, out = robot.joints, {}
    idle = _idle(robot)
    for name, effect in SERIAL_CATALOGUE.items():
        if not has(robot, name):
            continue
        mine = [p for p in effect.parameters if p.name not in idle.get(name, ())]
        own = [one for p in mine if (one := parameter_of(p, joints)) is not None]
        if name == "encoder_eccentricity":
            # once per turn: what slides has none
            own = [p for p in own if p.unit == "rad"]
        elif effect.is_periodic or effect.goes_with:
            # joints of one unit: that of most of them
            own = [p for p in own if p.unit == robot.joint_unit]
            effect = replace(effect, search=f"period_{robot.joint_unit}" if effect.search else None)
        elif name == "reading_delay":
            effect = replace(effect, needs=robot.layout.velocities)
        if own:
            out[name] = replace(effect, parameters=tuple(own))
    return out


def _idle(robot: Serial) -> Mapping[str, Collection[str]]:
    """Of each effect that the drawing has to do with, the parameters that can move no target."""
    low, high = robot.ranges
    joints = np.random.default_rng(0).uniform(low, high, (_POSTURES, len(low)))
    # one degree warmer, first target, one kilogramme
    known = np.tile([np.nan, 21.0, *np.zeros(2 * len(low)), 1.0, 1.0, 21.0], (_POSTURES, 1))
    names = [(row["name"], p["name"]) for row in _core.SerialModel.CATALOGUE for p in row["parameters"]]
    asked = [k for k, (effect, _) in enumerate(names) if effect in _BY_DRAWING]
    columns, _, _, _ = robot.core().derivatives(np.zeros(len(names)), (joints, None, known, None), asked)
    moved, out = np.abs(columns).max(axis=(0, 1)), {}
    for effect in _BY_DRAWING:
        own = [(moved[i], names[k][1]) for i, k in enumerate(asked) if names[k][0] == effect]
        most = max(size for size, _ in own)
        out[effect] = {name for size, name in own if size <= _NOTHING * most}
    return out


# -- The model ----------------------------------------------------------------------------------------------------

#: Poses by which the drawing tells what can be identified.
_POSES = 200
#: How far beside its axis a target is held that was drawn on it, mm.
_BESIDE_MM = 50.0
#: A parameter that moves the target by less than this part of its own beyond what others do is one of theirs: axes that
#: are drawn parallel are so to fewer digits than numbers have.
_BEYOND = 1e-3
#: What every arm is measured with comes first.
_FIRST = ("sensor", "tool", "target", "centre", "plane")
#: Poses from which the next ones are chosen.
_NEXT = 500
_JOINT_DIGITS = 5


@dataclass(frozen=True)
class SerialModel(ChainModel):
    """A nominal serial arm with named errors and effects to identify. Readings are x, y, z of a target, mm, as a
    tracker shows them, or how far it is from a fixed centre or above a plane; the columns ``target``, ``centre`` and
    ``plane`` hold their numbers.

    ``free`` names what is identified of the sensor's pose (``sensor_turn_x``, ``sensor_shift_x``, …), of
    the targets (``tool_x`` … of the first, ``target_2_x`` …), of the centres (``centre_1_x`` …) and planes
    (``plane_1_lean_u``, ``plane_1_height`` …), of each joint's zero (``offset_2``), and of where its axis lies
    (``shift_x_2``, ``shift_y_2``) and leans (``tilt_x_2``, ``tilt_y_2``), in its own frame, whose z is the axis. Left
    out, it is :attr:`default`. ``period_rad``, or ``period_mm``
    where every joint slides, is that of the cyclic error of encoders and gears, one for all or one for each joint.
    """

    robot: Serial
    slip_time_s: float = 0.0
    joint_slip_time_s: float = 0.0
    thermal_shift_lag_s: float = 0.0
    sensor_slip_time_s: float = 0.0
    time_origin_s: float = 0.0
    period_rad: Setting | None = None
    period_mm: Setting | None = None

    catalogue: ClassVar = SERIAL_CATALOGUE
    table: ClassVar = _core.SerialModel.CATALOGUE
    targets: ClassVar = POSITION
    one_posture: ClassVar = False
    waves_are: ClassVar = "gear ripple"
    period_in_file: ClassVar = "gear_ratio of each [[joint]]"

    def __post_init__(self) -> None:
        mine = [name for name in self.robot.layout.joints if unit_in(name) == self.robot.joint_unit]
        if self.period_rad is None and len(self.given_periods) == len(mine):
            object.__setattr__(self, "period_rad", tuple(self.given_periods[name] for name in mine))
        super().__post_init__()

    @property
    def given_periods(self) -> Mapping[str, float]:
        """Those of gears whose ratio the file says."""
        named = zip(self.robot.layout.joints, self.robot.joints, strict=True)
        return {name: 2.0 * np.pi / joint.gear_ratio for name, joint in named if joint.gear_ratio}

    @property
    def layouts(self) -> tuple[Layout, ...]:  # type: ignore[override]
        """The runs of this arm."""
        return (self.robot.layout,)

    def joint_ranges(self) -> dict[str, tuple[float, float]]:
        """Of joints whose limits the file says."""
        named = zip(self.robot.layout.joints, self.robot.joints, strict=True)
        return {name: joint.range for name, joint in named if joint.limits}

    @cached_property
    def targets_anywhere(self) -> tuple[str, ...]:
        """As of any model: x, y, z of each target."""
        begins = ("tool_", "target_", *(f"{one.name}_turn" for one in plates_of(self.robot)))
        return tuple(p.name for p in self.parameters if p.name.startswith(begins) and not p.known)

    def in_sockets(self, data: Measurements) -> Sockets | None:
        """As of any model: a ball in the socket that is its centre."""
        return sockets_of(self, data)

    def supposed(self, *, left: bool) -> str | None:
        """As of any model: without masses links are sticks, and what follows the poses at the joints that give way may
        be what these leave."""
        names = {effect.name for effect in self.effects} - set(self.within)
        if _BY_WEIGHT not in names or self.robot.knows_masses:
            return None
        at_joints = (effect for effect in self.effects if effect.name in names and effect.link == "joints")
        those = [effect.name for effect in at_joints if effect.name != _BY_WEIGHT and not effect.needs]
        those += ["what is left"] if left else []
        if not those:
            return None
        return (
            f"the robot file has no masses, so that {_BY_WEIGHT} takes links for sticks: {listed(those)} may be what "
            "that makes up for; add mass_kg and centre_mm of each [[joint]]"
        )

    @property
    def relations(self) -> tuple[Apart, ...]:
        """As of any model: distances that the robot's file knows."""
        return self.robot.relations

    @cached_property
    def known_effects(self) -> Mapping[str, Effect]:
        """Those of its own joints."""
        return effects_of(self.robot)

    @property
    def base(self) -> tuple[Parameter, ...]:
        """What the table has for every arm, of the joints that it has."""
        return tuple(self.as_known(p) for p in self.unstated_base())

    def unstated_base(self) -> tuple[Parameter, ...]:
        """Of the joints that it has."""
        return _base_of(self.robot)

    @cached_property
    def core_parameters(self) -> tuple[Parameter, ...]:
        """Every parameter of the compiled chain, in its order; those of joints that it has not among them."""
        out: list[Parameter] = []
        for row in self.table:
            if row["base"]:
                out += parameters_of_core(row, self.lever_mm)
            else:
                out += (p for effect in effects_of_row(self.catalogue, row["name"]) for p in effect.qualified())
        called = renamed(self.robot)
        return tuple(replace(p, name=called[p.name], unit="rad") if p.name in called else p for p in out)

    def core_for(self, data: Measurements) -> Any:
        """The compiled chain, with plates of targets as bodies where it has any."""
        del data
        return self.plates or self.core

    @cached_property
    def plates(self) -> PlateChain | None:
        """The chain of an arm with targets that belong together; None for any other."""
        if not plates_of(self.robot):
            return None
        names = tuple(p["name"] if row["base"] else f"{row['name']}.{p['name']}" for row in self.table
                      for p in row["parameters"])  # fmt: skip
        return PlateChain(self.core, self.robot, names)

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

    def settings(self) -> dict[str, Setting | None]:
        """Moments of the slips (target, joints, tracker), lag of the stands, origin of time, period of the encoders."""
        unit = self.robot.joint_unit
        return {
            "slip_time_s": self.slip_time_s,
            "joint_slip_time_s": self.joint_slip_time_s,
            "thermal_shift_lag_s": self.thermal_shift_lag_s,
            "sensor_slip_time_s": self.sensor_slip_time_s,
            "time_origin_s": self.time_origin_s,
            f"period_{unit}": self.period_mm if unit == "mm" else self.period_rad,
        }

    @cached_property
    def core(self) -> _core.SerialModel:
        """The compiled model."""
        # without a cyclic error the period does not matter
        periods = self.periods(self.robot.layout.joints, np.pi)
        slips = (self.slip_time_s, self.joint_slip_time_s, self.sensor_slip_time_s)
        return self.robot.core((np.pi, self.time_origin_s, *slips), periods)

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
    return float(reach[0] + np.linalg.norm(robot.sensor_pose.origin_mm) + np.linalg.norm(robot.joints[0].origin_mm))


@lru_cache(maxsize=32)
def _base_of(robot: Serial) -> tuple[Parameter, ...]:
    rows = (row for row in SerialModel.table if row["base"])
    every = (p for row in rows for p in parameters_of_core(row, lambda name: _lever_mm(robot, name)))
    mine = (p for p in every if has(robot, p.name))
    return as_plates(robot, [one for p in mine if (one := parameter_of(p, robot.joints)) is not None])


def _every_reading(robot: Serial, joints: Floats) -> Measurements:
    """Rows at these joints (n, k) of all that can be read of an arm: each target by the tracker, and its distances."""
    target, centre, plane = np.tile(robot.reads, (len(joints), 1)).T
    is_place = np.isnan(centre) & np.isnan(plane)
    columns: dict[str, Any] = dict.fromkeys(robot.layout.coordinates, np.where(is_place, 0.0, np.nan))
    columns |= {"distance_mm": np.where(is_place, np.nan, 0.0), CENTRE: centre, PLANE: plane, TARGET: target}
    return Measurements.planned(np.repeat(joints, len(robot.reads), axis=0), robot.layout, **columns)


@lru_cache(maxsize=32)
def _told_apart(robot: Serial) -> tuple[str, ...]:
    """The parameters of the default, see :attr:`SerialModel.default`."""
    if not np.any(np.array(robot.targets_mm)[:, :2]) and not any(joint.slides for joint in robot.joints[-1:]):
        # drawn on the last axis, as of a flange, no target is: what only one beside it tells apart would be missing
        robot = replace(robot, target_mm=(_BESIDE_MM, _BESIDE_MM, robot.target_mm[2]))
    every = SerialModel(robot, free=("tool_x",))
    low, high = robot.ranges
    rows = _every_reading(robot, np.random.default_rng(0).uniform(low, high, (_POSES, len(low))))
    names = [p.name for p in every.base]
    whole = replace(every, free=tuple(names))
    columns = whole.derivatives(rows, np.zeros(len(names))).reshape(-1, len(names))
    left = columns * [p.size for p in every.base]
    whole_size = np.linalg.norm(left, axis=0)
    begins = (*_FIRST, *(one.name for one in plates_of(robot)))
    first = [name.startswith(begins) for name in names]
    held = [whole.held_of_pose(name) for name in names]
    chosen: list[int] = []
    while True:
        size = np.linalg.norm(left, axis=0)
        able = size > _BEYOND * whole_size
        able[chosen] = False
        able[held] = False
        if not able.any():
            return tuple(names[k] for k in sorted(chosen))
        among = able & first if (able & first).any() else able
        best = int(np.argmax(np.where(among, size, 0.0)))
        chosen.append(best)
        along = left[:, best] / size[best]
        left = left - np.outer(along, along @ left)
