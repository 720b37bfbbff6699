"""What is known of a machine that its owner describes: a function, columns with units and ranges, parameters."""

from __future__ import annotations

import inspect
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from ...base import linalg
from ...base.figures import in_small_units, listed
from ...base.notebook import Saved, Shown
from ...base.types import Bools, Floats
from ...data.columns import TEMPERATURE, TIME, Layout, know_unit, unit_in
from ...data.toml import Table
from ...errors import FitError, NotConverged, RobotError
from ...model.batch import Batch, matrix, vector
from ...model.effect import Parameter
from ...model.sensor_pose import FREE, OWN_AXES, POSE, SensorPose
from .core import MachineCore
from .function import Derivative, Forward, UserFunction, settled, starts
from .generic_effects import Generic, generic_effects, home_of, is_point_in_space, sensor_pose

#: Where joints range whose limits nobody gives, by unit: so far from zero on both sides.
_RANGE = {"mm": 100.0, "um": 1e5, "m": 0.1, "rad": 1.0, "mrad": 1e3, "deg": 60.0}
#: What a machine says of where its instrument stands, in one word.
_POSES = {"free": SensorPose(shift_sd_mm=FREE, turn_sd_deg=FREE), "held": OWN_AXES}
_RESERVED = (TIME, TEMPERATURE, "pose", "repeat", "outlier")

#: The range over which a joint goes; or another that it goes with, and how far it may be from that.
Range = tuple[float, float] | tuple[str, float, float]
#: Names, or names with ranges.
Joints = Sequence[str] | Mapping[str, Range]
#: Names with unit and plausible size.
Parameters = Mapping[str, tuple[str, float]]


@dataclass(frozen=True, eq=False, repr=False)
class MachineDescription(Saved, Shown):
    """A machine as a function of its joints and parameters, with their names; see :class:`sherkit.Machine`."""

    function: Forward
    joints: Joints
    readings: Sequence[str]
    parameters: Parameters
    derivative: Derivative | None = None
    name: str = ""
    columns: Mapping[str, str] = field(default_factory=dict)
    sensor_pose: SensorPose | str | None = None
    kind: str = field(init=False)

    def __post_init__(self) -> None:
        if not callable(self.function):
            raise RobotError("forward: expected a function of joints and parameters")
        object.__setattr__(self, "name", self.name or _called(self.function))
        object.__setattr__(self, "kind", self.name)
        for what, names in (("joints", self.joint_names), ("readings", tuple(self.readings))):
            # nothing moves of a spindle that warms, of a mast in the wind: it has readings alone
            if isinstance(self.joints, str) or isinstance(self.readings, str) or not (names or what == "joints"):
                raise RobotError(f"{what}: expected a tuple of column names, got {getattr(self, what)!r}")
        doubled = [*self.joint_names, *self.readings]
        if wrong := [n for n in doubled if doubled.count(n) > 1 or n in _RESERVED]:
            raise RobotError(f"the column '{wrong[0]}' is named twice, or has a meaning of its own")
        if wrong := [n for n in doubled if not unit_in(n) and not know_unit(n)]:
            raise RobotError(
                f"the column '{wrong[0]}' names no unit: expected an end such as _mm, _rad, _deg, _px, _V or _counts"
            )
        units = {unit_in(name) for name in self.readings}
        if len(units) > 1:
            raise RobotError(f"readings: expected one unit for all, got {listed(sorted(units))}")
        for parameter, told in self.parameters.items():
            if not parameter.isidentifier() or not _is_unit_and_size(told):
                raise RobotError(
                    f"parameter '{parameter}': expected a name for Python code, with unit and plausible size such as "
                    f'("mm", 0.5), got {told!r}'
                )
        if not isinstance(self.columns, Mapping) or not all(isinstance(one, str) for one in self.columns.values()):
            raise RobotError(f"columns: expected names of the file by those of the machine, got {self.columns!r}")
        object.__setattr__(self, "sensor_pose", self._stands(self.sensor_pose))
        for name, other in self._others.items():
            if other not in self.joint_names or other in self._others:
                raise RobotError(f"joints: {name} goes with '{other}', which is no joint with a range of its own")
        if (self.ends[:, 0] >= self.ends[:, 1]).any() or not np.isfinite(self.ends).all():
            raise RobotError(f"joints: expected a range with its lower end first for each, got {self.joints}")

    def _stands(self, told: object) -> SensorPose:
        """Where its instrument stands, by what its owner told of that."""
        places = is_point_in_space(self.readings)
        if told is None:
            return _POSES["free" if places else "held"]
        pose = _POSES.get(told) if isinstance(told, str) else told
        if not isinstance(pose, SensorPose):
            raise RobotError(f'sensor_pose: expected "free", "held" or a sk.SensorPose(...), got {told!r}')
        if pose != OWN_AXES and not (len(self.readings) == 3 and {unit_in(name) for name in self.readings} == {"mm"}):
            raise RobotError(
                f"sensor_pose: it is that of an instrument which reads x, y and z of one point, mm; this machine's "
                f"readings "
                f"are {listed(self.readings)}: leave it out"
            )
        return pose

    # -- what is known of it -------------------------------------------------------------------------------

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Columns of the joints."""
        return tuple(self.joints)

    @property
    def _others(self) -> dict[str, str]:
        """With which other joint one goes, by name."""
        ranges = self.joints.items() if isinstance(self.joints, Mapping) else ()
        return {name: str(one[0]) for name, one in ranges if len(one) == 3}

    @cached_property
    def ends(self) -> Floats:
        """Where each joint may stand (k, 2), in its unit: of one that goes with another, how far from that."""
        if isinstance(self.joints, Mapping):
            ranges = [tuple(map(float, one[-2:])) for one in self.joints.values()]
        else:
            ranges = [(-_RANGE.get(unit_in(n), 1.0), _RANGE.get(unit_in(n), 1.0)) for n in self.joints]
        return np.array(ranges, dtype=float).reshape(-1, 2)

    @cached_property
    def box(self) -> Floats:
        """Where each joint may stand (k, 2), in its unit, wherever the others are."""
        return self.ends + self._of_others(self.ends)

    def joints_at(self, part: Floats) -> Floats:
        """Joints (n, k) at these parts, 0 … 1, of their ranges, those that go together together."""
        low, high = self.ends.T
        joints = low + part * (high - low)
        return np.asarray(joints + self._of_others(joints.T).T)

    def may_stand(self, joints: Floats, slack: float = 1e-6) -> Bools:
        """Which joints (n, k) are within their ranges, give or take a part of these."""
        own = joints - self._of_others(joints.T).T
        low, high = self.ends.T
        beyond = slack * (high - low)
        return np.asarray(((own >= low - beyond) & (own <= high + beyond)).all(axis=1))

    def _of_others(self, values: Floats) -> Floats:
        """Of values (k, …) of joints, those of the joint that each goes with; zero for one that goes by itself."""
        out, names = np.zeros(values.shape), self.joint_names
        for name, other in self._others.items():
            out[names.index(name)] = values[names.index(other)]
        return out

    @cached_property
    def layout(self) -> Layout:
        """The columns of its runs."""
        unit = unit_in(self.readings[0])
        shown, per_unit = in_small_units(unit)
        velocities = tuple(f"{name}_per_s" for name in self.joint_names)
        return Layout(self.joint_names, tuple(self.readings), shown, per_unit, velocities=velocities, by_time=True)

    @property
    def pose(self) -> SensorPose | None:
        """Where its instrument stands; None where its readings are no place in space."""
        made = self.sensor_pose
        assert isinstance(made, SensorPose)
        return made if is_point_in_space(self.readings) or made != OWN_AXES else None

    @cached_property
    def links(self) -> tuple[Generic, ...]:
        """What its chain has beside its function: the numbers of the sensor's pose that are open, and the effects that
        every machine can have, for these joints and readings, but for what its function has already."""
        spans, pose = np.ptp(self.box, axis=1).tolist(), self.pose
        every = generic_effects(self.joint_names, tuple(self.readings), spans, self._shown, pose is not None)
        sd = np.zeros(len(POSE)) if pose is None else pose.sd(FREE, FREE)
        return not_in(self.asked, pose, [name for name, one in zip(POSE, sd, strict=True) if one > 0], every)

    @property
    def _shown(self) -> list[float]:
        """How far each reading goes over the ranges of the joints; zero where that cannot be told."""
        try:
            shown = self.asked(self.asked.somewhere, np.zeros(len(self.own)))
        except FitError:  # who asks next says it
            return [0.0] * len(self.readings)
        known = shown[np.isfinite(shown).all(axis=1)]
        return np.ptp(known, axis=0).tolist() if len(known) else [0.0] * len(self.readings)

    @property
    def effects(self) -> tuple[Generic, ...]:
        """The effects among :attr:`links`."""
        return tuple(one for one in self.links if not one.is_base)

    @cached_property
    def own(self) -> tuple[Parameter, ...]:
        """The parameters of the function."""
        return tuple(Parameter(name, name, unit, float(size)) for name, (unit, size) in self.parameters.items())

    @cached_property
    def asked(self) -> UserFunction:
        """Its function, asked with care."""
        return UserFunction(
            self.name, self.function, self.derivative, self.joint_names, tuple(self.readings), self.own, self.box,
            self.joints_at,
        )  # fmt: skip

    # -- as a robot ------------------------------------------------------------------------------------------

    @property
    def joint_unit(self) -> str:
        """Unit of the first joint; empty where there is none."""
        return unit_in(self.joint_names[0]) if self.joint_names else ""

    @property
    def joint_limits(self) -> tuple[float, float] | None:
        """Each joint has its own (:attr:`box`)."""
        return None

    @property
    def middle(self) -> tuple[float, ...]:
        """Readings in the middle of its joints."""
        return tuple(self.forward(self.box.mean(axis=1)).tolist())

    def forward(self, joints: ArrayLike) -> Floats:
        """Readings (m,) of the machine as drawn for joints (k,). Raises :class:`~sherkit.errors.FitError`."""
        q = vector(joints, "joint readings", len(self.joint_names))
        return self.asked(q[None, :], np.zeros(len(self.own)))[0]

    def inverse(self, readings: ArrayLike) -> Floats:
        """Joints (k,) at which the machine as drawn shows these readings (m,), within their ranges.

        Raises :class:`~sherkit.errors.NotConverged`.
        """
        made = self.inverse_batch(np.atleast_2d(vector(readings, "readings", len(self.readings))))
        if not made.reached[0]:
            raise NotConverged("the machine shows this nowhere within the ranges of its joints")
        return made.values[0]

    def inverse_batch(self, readings: ArrayLike) -> Batch:
        """:meth:`inverse` of rows (n, m); those that cannot be reached are marked."""
        x = matrix(readings, "readings", len(self.readings))
        zero = np.zeros(len(self.own))

        def forward(joints: Floats) -> tuple[Floats, Floats]:
            return self.asked(joints, zero), self.asked.derivatives(joints, zero, ())[0]

        joints, reached = settled(forward, x, starts(lambda q: self.asked(q, zero), x, self.box), self.box)
        told = "shown nowhere within the ranges of the joints"
        return Batch(joints, reached, tuple(f"row {row}: {told}" for row in np.flatnonzero(~reached)[:3]))

    # -- files -----------------------------------------------------------------------------------------------

    def to_tables(self) -> dict[str, Any]:
        """What a file says of it: its name, columns and parameters, and where its instrument stands. No code is kept in
        files, nor run from them."""
        known = {"joints": self.joint_names, "readings": self.readings, "parameters": self.parameters}
        out: dict[str, Any] = {"kind": self.kind, "machine": {key: list(names) for key, names in known.items()}}
        return out if self.pose is None else out | {"sensor_pose": self.pose.to_table()}

    def from_table(self, table: Table) -> Self:
        """This machine, where the file is of it. Raises :class:`~sherkit.errors.RobotError` where it was another."""
        with table.table("machine") as m:
            mine = {"joints": self.joint_names, "readings": self.readings, "parameters": self.parameters}
            for key, now in ((key, tuple(names)) for key, names in mine.items()):
                if (then := m.texts(key)) != now:
                    raise m.fail(
                        key, f"those of the machine '{self.name}' as it is now, {listed(now)}, not {listed(then)}"
                    )
        if table.has("sensor_pose"):
            with table.table("sensor_pose") as p:
                told = SensorPose.from_table(p)
            if self.pose is None or told != self.pose:
                stands = "none, since it reads no place in space" if self.pose is None else f"{self.pose.to_table()}"
                raise table.fail("sensor_pose", f"that of the machine '{self.name}' as it is now, {stands}")
        return self

    def __repr__(self) -> str:
        return f"Machine({self.name}: {listed(self.joint_names)} → {listed(self.readings)})"


def _is_unit_and_size(told: object) -> bool:
    """Whether this is ("mm", 0.5) or the like."""
    if not isinstance(told, tuple) or len(told) != 2:
        return False
    unit, size = told
    return isinstance(unit, str) and isinstance(size, int | float | np.number) and bool(0 < size < np.inf)


def _called(function: Forward) -> str:
    """The file in which a function stands, or its own name."""
    try:
        stem = Path(inspect.getfile(function)).stem
    except TypeError:
        stem = ""
    own = getattr(function, "__name__", "machine")
    return stem if stem.isidentifier() else own.strip("<>") or "machine"


# -- Two names for one thing: which effects a function, or where the instrument stands, has already ------------------

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
    basis, spread, _ = linalg.svd(columns[:, : places[0].stop], full_matrices=False)
    taken = basis[:, spread > _SAME * spread.max(initial=0.0)]
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
    home = home_of(function.box)
    core = MachineCore(function, tuple(effects), pose, (1.0,) * k, home, 0.0, late, late, late)
    total = count + sum(len(one.parameters) for one in effects)
    values = np.zeros(total)
    anyhow = dict(zip(POSE, _ANYHOW * np.isinf(pose.sd(FREE, FREE)), strict=True)) if pose is not None else {}
    values[core.places[0]] = [anyhow[name] for name, *_ in effects[0].parameters]
    columns = core.derivatives(values, (joints, None, known, None), range(total))[0]
    whole = np.asarray(np.isfinite(columns).all(axis=(1, 2)))
    columns = columns[whole].reshape(-1, total)
    length = np.sqrt((columns**2).sum(axis=0))
    return columns / np.where(length > 0, length, 1.0), core.places
