"""A serial arm as on its drawing: joints that turn or slide, one behind another, and a target at their end."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

import sherkit._core as _core

from ...base.figures import listed
from ...base.notebook import Saved, Shown
from ...base.types import Bools, Floats
from ...data.columns import Layout, know
from ...data.declared import Declared, Inner, key, keys_from, keys_of
from ...data.toml import Table
from ...errors import OutOfReach, ShapeError
from ...model.batch import Batch, matrix, vector, why
from ...model.sensor_pose import ANYWHERE, SensorPose
from ...model.tolerances import NOT_STATED, Apart, Stated, Stating
from .frames import Triple, frame, onto, placed
from .points import Distance, Plane, check_groups, points

# -- The columns of a run -----------------------------------------------------------------------------------------

POSITION = ("x_mm", "y_mm", "z_mm")
#: Number of the target, from 1, where an arm carries several, and of the centre or plane from which a distance counts.
TARGET, CENTRE, PLANE = "target", "centre", "plane"
#: What hangs at the first target besides the arm's own weight, kg.
PAYLOAD = "payload_kg"


def layout_of_arm(joints: Sequence[tuple[str, str]]) -> Layout:
    """For joints by name and unit, rad or mm."""
    names = tuple(f"{name}_{unit}" for name, unit in joints)
    velocities = tuple(f"{name}_per_s" for name in names)
    return Layout(
        names,
        POSITION,
        "µm",
        1e3,
        "distance_mm",
        (CENTRE, PLANE),
        velocities,
        apart=(TARGET, CENTRE, PLANE),
        from_fixed=True,
        loads=(PAYLOAD,),
        own_joints=True,
    )


# -- The arm ------------------------------------------------------------------------------------------------------

Pair = tuple[float, float]

TYPES = ("revolute", "prismatic")
#: Joints that the compiled arm has room for.
MOST_JOINTS = 9
#: Targets and planes that it has room for, and centres of distances.
MOST_POINTS = 4
MOST_CENTRES = 8
_ZERO: Triple = (0.0, 0.0, 0.0)
#: Where a joint may stand if its file does not say it: a turn either way, or half a metre.
_ANYWHERE = {"deg": 180.0, "mm": 500.0}
#: Postures from which the inverse begins where neither home nor the middle leads there.
_STARTS = 12
#: What the table of the sensor's pose was called.
_FORMER = "tracker"
_NAME = re.compile(r"[A-Za-z]\w*")


def as_name(text: str, begin: str) -> str:
    """A name that columns, URDF and Python take as one, with another ``begin`` where it has no letter there."""
    name = "".join(c if c.isascii() and (c.isalnum() or c == "_") else "_" for c in text)
    return name if name[:1].isalpha() else f"{begin}_{name}"


@dataclass(frozen=True)
class Joint:
    """One joint as drawn. ``origin_mm`` and ``rpy_deg`` are where its frame stands behind the joint before it (URDF),
    ``axis`` about or along what it moves in that frame.

    ``limits`` and ``home``, about which encoder scales are counted, are degrees, or mm where it is prismatic.
    ``follows`` is the part of the reading of the joint before it, in both their units, by which it moves besides: one
    or minus one where a parallelogram turns it. ``mass_kg`` and ``centre_mm`` are those of the link that it moves, in
    its frame. ``gear_ratio`` is how often its motor turns for one turn of it: so often an unround gear errs.
    """

    name: str
    type: str = "revolute"
    origin_mm: Triple = _ZERO
    rpy_deg: Triple = _ZERO
    axis: Triple = (0.0, 0.0, 1.0)
    limits: Pair | None = None
    home: float = 0.0
    mass_kg: float | None = None
    centre_mm: Triple = _ZERO
    follows: float = 0.0
    gear_ratio: float | None = None

    @property
    def slides(self) -> bool:
        """Whether it is prismatic."""
        return self.type == "prismatic"

    @property
    def unit(self) -> str:
        """Unit of its reading: rad or mm."""
        return "mm" if self.slides else "rad"

    @property
    def _in_file(self) -> str:
        return "mm" if self.slides else "deg"

    @cached_property
    def frame(self) -> Floats:
        """Its frame (4, 4) behind the joint before it, mm, turned so that z is its axis."""
        return placed(self.origin_mm, self.rpy_deg) @ frame(_ZERO, self.turn)

    @cached_property
    def turn(self) -> Floats:
        """From that frame, whose z is the axis, to that of the drawing (3, 3)."""
        return onto(self.axis)

    def reading(self, in_file: float) -> float:
        """A number of its file as the joint reads it."""
        return in_file if self.slides else float(np.deg2rad(in_file))

    @property
    def range(self) -> Pair:
        """Lowest and highest reading; a turn either way, or half a metre, where the file names none."""
        far = _ANYWHERE[self._in_file]
        low, high = self.limits or (self.home - far, self.home + far)
        return self.reading(low), self.reading(high)

    @classmethod
    def from_table(cls, table: Table) -> Joint:
        """Reads a table ``[[joint]]``."""
        made = cls(**keys_from(table, _KEYS[table.text("type", TYPES, "revolute")], cls))
        if not _NAME.fullmatch(made.name):
            raise table.fail("name", "a letter, then letters, digits and _: it names the column of its readings")
        if not np.linalg.norm(made.axis) > 0:
            raise table.fail("axis", "a direction, not only zeros")
        return made

    def to_table(self) -> dict[str, Any]:
        """What :meth:`from_table` reads, without loss."""
        return keys_of(self, _KEYS[self.type])


#: The keys of a joint, by its type.
_KEYS = {
    kind: {
        "name": key(Table.words),
        "type": key(Table.text, TYPES),
        "origin_mm": key(Table.numbers, 3),
        "rpy_deg": key(Table.numbers, 3),
        "axis": key(Table.numbers, 3),
        f"limits_{unit}": key(Table.heights).of("limits"),
        f"home_{unit}": key(Table.number).of("home").quiet,
        "follows": key(Table.number).quiet,
        "mass_kg": key(Table.positive, or_zero=True),
        "centre_mm": key(Table.numbers, 3).quiet,
        **({"gear_ratio": key(Table.positive)} if kind == "revolute" else {}),
    }
    for kind, unit in (("revolute", "deg"), ("prismatic", "mm"))
}


@dataclass(frozen=True)
class Serial(Declared, Stating, Saved, Shown):
    """Nominal serial arm of one to nine joints. Lengths in mm, angles in degrees as in its file, joint readings rad or
    mm.

    ``target_mm`` is the measured point in the frame of the last joint, ``tool_rpy_deg`` how the tool stands there, and
    ``more_targets_mm`` up to three other points, numbers 2 to 4 of the column ``target``; those of one ``group``
    (that of the first target) and ``more_groups`` (one name for each of the others) sit on one rigid plate, as far
    apart as drawn. ``centres_mm`` are up to eight fixed places in the base frame from which distances are read: numbers
    of the column ``centre``; ``planes`` likewise up to four above which heights are, numbers of the column ``plane``.
    ``distances`` are known between two centres.
    ``gravity`` is the direction of the weight in the base frame. ``sensor_pose`` is where the tracker stands, as far as
    that is known. ``has_tracker`` is False where distances alone are read. ``required_um`` is the accuracy that the arm
    is for.
    """

    joints: tuple[Joint, ...]
    target_mm: Triple = _ZERO
    tool_rpy_deg: Triple = _ZERO
    gravity: Triple = (0.0, 0.0, -1.0)
    sensor_pose: SensorPose = ANYWHERE
    group: str = ""
    more_targets_mm: tuple[Triple, ...] = ()
    more_groups: tuple[str, ...] = ()
    centres_mm: tuple[Triple, ...] = ()
    planes: tuple[Plane, ...] = ()
    distances: tuple[Distance, ...] = ()
    has_tracker: bool = True
    required_um: float | None = None
    tolerances: Stated = NOT_STATED
    known: Stated = NOT_STATED
    kind: str = field(default="serial", init=False)

    TABLES: ClassVar = {
        "tool": {
            "target_mm": key(Table.numbers, 3),
            "rpy_deg": key(Table.numbers, 3).of("tool_rpy_deg"),
            "group": key(Table.words).quiet,
        },
        "base": {"gravity": key(Table.numbers, 3)},
        "sensor_pose": Inner(SensorPose, "sensor_pose"),
        "tolerances": Inner(Stated, "tolerances"),
        "known": Inner(Stated, "known"),
        "workspace": {"required_um": key(Table.positive)},
    }

    def __post_init__(self) -> None:
        names = [joint.name for joint in self.joints]
        if not 1 <= len(names) <= MOST_JOINTS:
            raise ShapeError(f"an arm has one to {MOST_JOINTS} joints, got {len(names)}")
        if len(set(names)) < len(names):
            twice = sorted({name for name in names if names.count(name) > 1})
            raise ShapeError(f"joint {listed(twice)}: a name is given twice")
        if self.joints[0].follows:
            raise ShapeError(f"joint {names[0]}: follows the one before it, and there is none")
        if not np.linalg.norm(self.gravity) > 0:
            raise ShapeError("gravity: expected a direction, got only zeros")
        check_groups(self.groups)
        several = {"targets": self.targets_mm, "centres": self.centres_mm, "planes": self.planes}
        for what, there in several.items():
            most = MOST_CENTRES if what == "centres" else MOST_POINTS
            if len(there) > most:
                raise ShapeError(f"{what}: an arm has at most {most}, got {len(there)}")
        for one in self.distances:
            one.check(len(self.centres_mm))
        for k, plane in enumerate(self.planes, start=1):
            if not np.linalg.norm(plane.normal) > 0:
                raise ShapeError(f"plane {k}: normal: expected a direction, got only zeros")
        if not (self.has_tracker or self.centres_mm or self.planes):
            raise ShapeError("nothing reads this arm: it has neither a tracker nor centres or planes of distances")
        _ = self.nominal  # refuses numbers that are no arm
        know(self.layout, of_robot=True)

    # -- files -------------------------------------------------------------------------------------------

    @classmethod
    def from_table(cls, table: Table) -> Serial:
        """Reads the tables of a robot file."""
        joints = tuple(map(Joint.from_table, table.tables("joint", optional=False)))
        (targets, groups), (centres, _) = points(table, "target"), points(table, "centre")
        planes = tuple(map(Plane.from_table, table.tables("plane")))
        distances = tuple(map(Distance.from_table, table.tables("distance")))
        table.pass_over(_FORMER)
        seen = table.has(_FORMER) or table.has("sensor_pose") or not (centres or planes)
        known = cls.values_from(table)
        if table.has(_FORMER):
            if table.has("sensor_pose"):
                raise table.fail(_FORMER, "one of [tracker] and [sensor_pose], which are one thing")
            with table.table(_FORMER) as former:
                known["sensor_pose"] = SensorPose.from_table(former)
        try:
            return cls(
                joints, **known, more_targets_mm=targets, more_groups=groups if any(groups) else (),
                centres_mm=centres, planes=planes, distances=distances, has_tracker=seen,
            )  # fmt: skip
        except ShapeError as error:
            raise table.fail("joint", str(error)) from None

    def to_tables(self) -> dict[str, Any]:
        """What :meth:`from_table` reads, without loss."""
        groups = ({"group": name} if name else {} for name in self.groups[1:])
        tables: dict[str, list[Any]] = {
            "joint": [joint.to_table() for joint in self.joints],
            "target": [{"at_mm": list(at)} | group for at, group in zip(self.more_targets_mm, groups, strict=True)],
            "centre": [{"at_mm": list(at)} for at in self.centres_mm],
            "distance": [one.to_table() for one in self.distances],
            "plane": [one.to_table() for one in self.planes],
        }
        made = super().to_tables() | {name: each for name, each in tables.items() if each}
        if not self.has_tracker:
            made.pop("sensor_pose", None)
        elif self.centres_mm or self.planes:
            # that it is there says that a tracker reads places too
            made.setdefault("sensor_pose", {"origin_mm": list(self.sensor_pose.origin_mm)})
        return made

    def drawn_values(self) -> Mapping[str, float]:
        """Places of targets, in the frame of the last joint whose z is its axis, and of centres by the name of their
        parameter, mm."""
        stems = ["tool", *(f"target_{k}" for k in range(2, len(self.targets) + 1))]
        stems += [f"centre_{k}" for k in range(1, len(self.centres_mm) + 1)]
        places = [*self.targets.tolist(), *self.centres_mm]
        return {f"{stem}_{'xyz'[k]}": p[k] for stem, p in zip(stems, places, strict=True) for k in range(3)}

    # -- what runs and experiments ask ---------------------------------------------------------------------

    @cached_property
    def layout(self) -> Layout:
        """The columns of its runs."""
        return layout_of_arm([(joint.name, joint.unit) for joint in self.joints])

    @property
    def joint_unit(self) -> str:
        """Unit of the readings of most of its joints."""
        slides = sum(joint.slides for joint in self.joints)
        return "mm" if 2 * slides > len(self.joints) else "rad"

    @property
    def joint_limits(self) -> None:
        """None: each joint has limits of its own, :attr:`ranges`, which the inverse keeps."""

    @property
    def middle(self) -> Triple:
        """The target where every joint is at home, mm."""
        x, y, z = self.forward(self.home).tolist()
        return (x, y, z)

    @cached_property
    def home(self) -> Floats:
        """Readings (k,) of the home position."""
        return np.array([joint.reading(joint.home) for joint in self.joints])

    @cached_property
    def ranges(self) -> Floats:
        """Lowest and highest readings (2, k)."""
        return np.array([joint.range for joint in self.joints]).T

    @property
    def reads(self) -> list[tuple[float, float, float]]:
        """All that can be read of it at a posture, as numbers of target, centre and plane: each target by the tracker,
        how far it is from each centre and above each plane; NaN where there is none."""
        targets, none = range(1, len(self.targets_mm) + 1), np.nan
        out: list[tuple[float, float, float]] = [(t, none, none) for t in targets if self.has_tracker]
        out += [(t, c, none) for t in targets for c in range(1, len(self.centres_mm) + 1)]
        return out + [(t, none, p) for t in targets for p in range(1, len(self.planes) + 1)]

    # -- kinematics --------------------------------------------------------------------------------------

    @property
    def relations(self) -> tuple[Apart, ...]:
        """What is known of how far its centres are from one another."""
        return tuple(one.of(self.centres_mm) for one in self.distances)

    @property
    def targets_mm(self) -> tuple[Triple, ...]:
        """All its targets in the frame of the last joint, mm."""
        return (self.target_mm, *self.more_targets_mm)

    @property
    def groups(self) -> tuple[str, ...]:
        """The group of each target, empty where it sits by itself."""
        return (self.group, *(self.more_groups or ("",) * len(self.more_targets_mm)))

    @cached_property
    def targets(self) -> Floats:
        """The targets (t, 3), mm, in the frame of the last joint whose z is its axis."""
        return np.array(self.targets_mm) @ self.joints[-1].turn

    @cached_property
    def reach_mm(self) -> Floats:
        """How far from each joint (k,) the target can be at most, mm, but for the travel of joints that slide."""
        steps = [float(np.linalg.norm(joint.frame[:3, 3])) for joint in self.joints[1:]]
        behind = [*steps, float(np.linalg.norm(self.targets, axis=1).max())]
        return np.cumsum(behind[::-1])[::-1]

    @cached_property
    def steps(self) -> list[Floats]:
        """Transforms (4, 4), mm: from the base to the first axis, from each axis, whose z is it, to the next one, and
        from the last one to the tool."""
        # a frame is given behind that of the drawing, which is turned from the one before
        back = [np.eye(4), *(frame(_ZERO, joint.turn.T) for joint in self.joints)]
        ends = [*(joint.frame for joint in self.joints), placed(self.target_mm, self.tool_rpy_deg)]
        return [a @ b for a, b in zip(back, ends, strict=True)]

    @property
    def knows_masses(self) -> bool:
        """Whether a joint has a mass."""
        return any(joint.mass_kg for joint in self.joints)

    @cached_property
    def weights(self) -> tuple[Floats, Floats]:
        """Masses (k,) and their centres (k, 3), mm, in the frames of the joints whose z is their axis.

        Where no joint has a mass, links are taken for sticks that weigh as much as they are long.
        """
        if self.knows_masses:
            masses = np.array([joint.mass_kg or 0.0 for joint in self.joints])
            return masses, np.array([joint.turn.T @ np.array(joint.centre_mm) for joint in self.joints])
        ends = np.array([step[:3, 3] for step in self.steps[1:]])
        return np.linalg.norm(ends, axis=1) / 1000.0, 0.5 * ends

    def core(
        self, settings: Sequence[float] = (np.pi, 0.0, 0.0, 0.0, 0.0), periods: Floats | None = None
    ) -> _core.SerialModel:
        """The compiled chain for the period of the encoders, origin of time and moments of the slips of target,
        joints and sensor; ``periods`` (k,) where joints have their own."""
        rows = []
        for step, joint, mass, centre in zip(self.steps[:-1], self.joints, *self.weights, strict=True):
            numbers = (joint.slides, joint.follows, joint.reading(joint.home), mass)
            rows.append([*step[:3, :3].ravel(), *step[:3, 3], *numbers, *centre])
        pull = np.array(self.gravity) / np.linalg.norm(self.gravity)
        centres = np.array(self.centres_mm, dtype=float).reshape(-1, 3)
        planes = np.array([plane.numbers for plane in self.planes], dtype=float).reshape(-1, 6)
        return _core.SerialModel(
            np.array(rows, dtype=float),
            self.targets.copy(),
            centres,
            planes,
            self.sensor_pose.numbers,
            np.array([*pull, *settings]),
            periods,
        )

    @cached_property
    def nominal(self) -> _core.SerialCalibrated:
        """The compiled kinematics as drawn."""
        low, high = self.ranges
        return _core.SerialCalibrated(self.core(), np.zeros(_core.SerialModel.PARAMETERS), low.copy(), high.copy())

    @cached_property
    def _still(self) -> list[float]:
        return [0.0, 20.0, *(0.0 for _ in self.joints), 0.0]

    def forward(self, joints: ArrayLike) -> Floats:
        """The target (3,), mm, base frame, for joint readings (k,). Raises :class:`~sherkit.errors.NotFinite`."""
        return self.nominal.forward(vector(joints, "joint readings", len(self.joints)), self._still)[0]

    def jacobian(self, joints: ArrayLike) -> Floats:
        """d target / d joints (3, k). Raises as :meth:`forward`."""
        return self.nominal.forward(vector(joints, "joint readings", len(self.joints)), self._still)[1]

    def tool_frame(self, joints: ArrayLike) -> Floats:
        """The frame (4, 4) of the tool, base frame, its origin in the target. Raises as :meth:`forward`."""
        q = vector(joints, "joint readings", len(self.joints))
        turn = self.nominal.flange(q, self._still) @ self.joints[-1].turn.T
        return frame(self.forward(q).tolist(), turn) @ placed(_ZERO, self.tool_rpy_deg)

    def inverse(self, position_mm: ArrayLike, *, start: ArrayLike | None = None) -> Floats:
        """Joint readings (k,) within their limits that bring the target to ``position_mm`` (3,), to 1 nm.

        Of many postures that to which damped steps lead from ``start`` (k,); left out, from home, or where no way leads
        from there, from the first of :attr:`starts` from which one does. Raises :class:`~sherkit.errors.OutOfReach`
        with how near it comes.
        """
        return self.found_from(lambda x, q: self.nominal.inverse(x, self._still, q), position_mm, start)

    def found_from(
        self, inverse: Callable[[Floats, Floats], Floats], position_mm: ArrayLike, start: ArrayLike | None
    ) -> Floats:
        """What ``inverse`` finds for a position from a start, or from the first of :attr:`starts` that leads there."""
        x = vector(position_mm, "position")
        if start is not None:
            return inverse(x, vector(start, "start", len(self.joints)))
        reasons = []
        for begin in self.starts:
            try:
                return inverse(x, begin)
            except OutOfReach as error:
                reasons.append(error)
        raise reasons[0]

    def all_found_from(
        self, inverse: Callable[[Floats, Floats], tuple[Floats, Bools]], positions_mm: ArrayLike,
        starts: ArrayLike | None,
    ) -> tuple[Floats, Bools]:  # fmt: skip
        """The same of positions (n, 3), each from its own of ``starts`` (n, k), and which are in reach."""
        x = matrix(positions_mm, "positions")
        if starts is not None:
            return inverse(x, matrix(starts, "starts", len(self.joints)))
        out, reached = np.full((len(x), len(self.joints)), np.nan), np.zeros(len(x), dtype=bool)
        for begin in self.starts:
            rows = np.flatnonzero(~reached)
            out[rows], reached[rows] = inverse(x[rows], np.tile(begin, (len(rows), 1)))
        return out, reached

    @cached_property
    def starts(self) -> Floats:
        """Postures (s, k) from which the inverse begins: home, then others between the limits, the same each time."""
        low, high = self.ranges
        others = np.random.default_rng(0).uniform(low, high, (_STARTS, len(low)))
        return np.vstack([self.home, 0.5 * (low + high), others])

    def forward_batch(self, joints: ArrayLike) -> Batch:
        """Targets (n, 3) for joint readings (n, k)."""
        q = matrix(joints, "joint readings", len(self.joints))
        x, _, reached = self.nominal.forward_batch(q, self._still)
        return Batch(x, reached, why(self.forward, q, reached))

    def inverse_batch(self, positions_mm: ArrayLike) -> Batch:
        """Joint readings (n, k) for targets (n, 3), as :meth:`inverse` finds each; those out of reach are marked."""
        x = matrix(positions_mm, "positions")
        q, reached = self.all_found_from(lambda x, q: self.nominal.inverse_batch(x, self._still, q), x, None)
        return Batch(q, reached, why(self.inverse, x, reached))
