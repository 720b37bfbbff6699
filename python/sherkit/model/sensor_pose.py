"""The sensor's pose: where an instrument stands, seen from the base of the robot (the *robot–world* transform).

What the instrument sees of a point x of the base frame is ``R x + origin``: the base turned by roll, pitch and yaw,
then shifted. Each of its six numbers is *free*, *known* within a standard deviation, or *held*: a deviation that is
infinite, a number, or zero. A tracker may stand anywhere, so the rows themselves tell where to start: the rigid
transform of predicted to measured points (Kabsch, 1976), rows that are wrong left out.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

import sherkit._core as _core

from ..base import linalg
from ..base.types import Floats
from ..data.declared import key, keys_from, keys_of
from ..data.toml import Table
from ..errors import RobotError

# -- The pose ----------------------------------------------------------------------------------------------------------

Triple = tuple[float, float, float]

#: The parameters of every robot's table, in the order of the core: turns about the sensor's own axes, then shifts.
TURNS = ("sensor_turn_x", "sensor_turn_y", "sensor_turn_z")
SHIFTS = ("sensor_shift_x", "sensor_shift_y", "sensor_shift_z")
POSE = (*TURNS, *SHIFTS)
#: The effect that says how the pose changed in the course of a run; its parameters are called as those are.
SLIP = "sensor_slip"
#: And the one that says how fast it changes.
DRIFT = "sensor_drift"
#: The coordinates of an instrument that reads places in space; of one in a plane the first two.
SPACE = ("x_mm", "y_mm", "z_mm")
#: The numbers that readings of a plane show.
IN_PLANE = ("sensor_turn_z", "sensor_shift_x", "sensor_shift_y")

#: Rows that tell where a sensor stands.
_FEWEST = 4


def slip_of(name: str) -> str:
    """The parameter of :data:`SLIP` by which one of :data:`POSE` changes, as it is called in a model."""
    return f"{SLIP}.{name.removeprefix('sensor_')}"


FREE: Triple = (np.inf, np.inf, np.inf)
HELD: Triple = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class SensorPose:
    """Where a sensor sees the base of its robot: the origin at ``origin_mm``, the axes turned by ``rpy_deg`` (URDF's
    roll, pitch, yaw). ``shift_sd_mm`` and ``turn_sd_deg`` are how well that is known along and about each of its axes,
    one number for all or three: infinite where it is free, zero where it is held; None leaves it to the kind of robot.

    Raises :class:`~sherkit.errors.RobotError` for numbers that are none of these.
    """

    origin_mm: Triple = (0.0, 0.0, 0.0)
    rpy_deg: Triple = (0.0, 0.0, 0.0)
    shift_sd_mm: Triple | None = None
    turn_sd_deg: Triple | None = None

    KEYS: ClassVar[dict[str, Any]] = {"origin_mm": key(Table.numbers, 3).quiet, "rpy_deg": key(Table.numbers, 3).quiet}

    def __post_init__(self) -> None:
        for name in ("shift_sd_mm", "turn_sd_deg"):
            given = getattr(self, name)
            if given is not None:
                object.__setattr__(self, name, _deviations(name, given))
        for name in ("origin_mm", "rpy_deg"):
            given = np.asarray(getattr(self, name), dtype=float)
            if given.shape != (3,) or not np.isfinite(given).all():
                raise RobotError(f"sensor_pose: {name}: expected three numbers, got {getattr(self, name)!r}")
            object.__setattr__(self, name, tuple(given.tolist()))

    @cached_property
    def turn(self) -> Floats:
        """From the axes of the base to those of the sensor (3, 3)."""
        made: Floats = scipy.spatial.transform.Rotation.from_euler("xyz", self.rpy_deg, degrees=True).as_matrix()
        return made

    @cached_property
    def numbers(self) -> Floats:
        """As the core takes it (12,): the turn row by row, then the shift, mm."""
        return np.array([*self.turn.ravel(), *self.origin_mm])

    def sd(self, usual_shift_mm: Triple, usual_turn_deg: Triple) -> Floats:
        """How well each of :data:`POSE` is known (6,), rad and mm, where the file leaves it to the kind of robot."""
        shift = usual_shift_mm if self.shift_sd_mm is None else self.shift_sd_mm
        turn = usual_turn_deg if self.turn_sd_deg is None else self.turn_sd_deg
        return np.array([*np.deg2rad(turn), *shift])

    @classmethod
    def from_targets(cls, base_mm: ArrayLike, read_mm: ArrayLike, sigma_mm: float | None = None) -> SensorPose:
        """Where a sensor stands that read points fixed to the base at ``read_mm`` (n, 3), whose places in its frame are
        ``base_mm`` (n, 3), and how well these tell it: by the noise ``sigma_mm`` of a reading, or by what they leave.

        Raises :class:`~sherkit.errors.RobotError` for fewer than three points, and for points on a line.

            pose = sk.SensorPose.from_targets(
                [[100, 0, 0], [0, 100, 0], [0, 0, 0]], [[100, 5, 0], [0, 105, 0], [0, 5, 0]], 0.01
            )
            print(pose.origin_mm, pose.turn_sd_deg)
        """
        base, read = (np.asarray(one, dtype=float) for one in (base_mm, read_mm))
        if base.ndim != 2 or base.shape[1:] != (3,) or base.shape != read.shape or len(base) < 3:
            raise RobotError(
                f"sensor_pose: three points fixed to the base or more tell where the sensor stands, (n, 3) each, got "
                f"{base.shape} and {read.shape}"
            )
        if not (np.isfinite(base).all() and np.isfinite(read).all()):
            raise RobotError("sensor_pose: targets: expected finite numbers, mm")
        found = registered(base, read, fewest=3)
        if found is None:
            raise RobotError(
                "sensor_pose: the points fixed to the base lie on a line: the turn about it is not told; read one aside"
            )
        left, free = read - base @ found.turn.T - found.shift_mm, 3 * len(base) - len(POSE)
        # of few readings their own spread is a guess
        squares = float(np.square(left).sum()) / max(free - 2, 1) if sigma_mm is None else sigma_mm**2
        by_turn = np.cross(np.eye(3)[None], (base @ found.turn.T)[:, None, :]).transpose(0, 2, 1)
        columns = np.concatenate([by_turn, np.broadcast_to(np.eye(3), (len(base), 3, 3))], axis=2).reshape(-1, 6)
        sd = np.sqrt(squares * np.diag(linalg.inv(columns.T @ columns)))
        angles = scipy.spatial.transform.Rotation.from_matrix(found.turn).as_euler("xyz", degrees=True)
        triples = (found.shift_mm, angles, sd[3:], np.rad2deg(sd[:3]))
        return cls(*(tuple(one.tolist()) for one in triples))

    @classmethod
    def from_table(cls, table: Table) -> SensorPose:
        """Reads the table ``[sensor_pose]``: ``origin_mm``, ``rpy_deg``; ``free = true`` or ``false`` for all six
        numbers, ``shift_sd_mm`` and ``turn_sd_deg`` (a number for all three axes, or three) for those that are
        known."""
        usual = {True: FREE, False: HELD, None: None}[table.choice("free")]
        spread: dict[str, Any] = {name: table.deviations(name, 3) or usual for name in ("shift_sd_mm", "turn_sd_deg")}
        return cls(**keys_from(table, cls.KEYS, cls), **spread)

    def to_table(self) -> dict[str, Any]:
        """What :meth:`from_table` reads, without loss."""
        out, spread = keys_of(self, self.KEYS), {"shift_sd_mm": self.shift_sd_mm, "turn_sd_deg": self.turn_sd_deg}
        if FREE in spread.values():
            out["free"] = True
            spread = {name: None if sd == FREE else sd for name, sd in spread.items()}
        return out | {name: list(sd) for name, sd in spread.items() if sd is not None}


def _deviations(name: str, given: Any) -> Triple:
    try:
        x, y, z = np.broadcast_to(np.asarray(given, dtype=float), 3).tolist()
    except (TypeError, ValueError):
        x = y = z = np.nan
    if not min(x, y, z) >= 0 or np.isnan([x, y, z]).any():
        raise RobotError(
            f"sensor_pose: {name}: expected a number for all axes, or three, none below zero (0 holds an axis, inf "
            f"frees it), got {given!r}"
        )
    return (x, y, z)


#: In the robot's own axes, or wherever its kind leaves it open.
OPEN = SensorPose()
#: Read in the robot's own axes, exactly.
OWN_AXES = SensorPose(shift_sd_mm=HELD, turn_sd_deg=HELD)


class KnownPose(SensorPose):
    """How well the pose of a sensor is known whose place stands elsewhere in the file, as a camera's does with it."""

    KEYS: ClassVar[dict[str, Any]] = {}


#: One of which nothing is said, and one of which nothing is said but where it stands.
ANYWHERE, WITH_ITS_FILE = SensorPose(), KnownPose()


@dataclass(frozen=True, eq=False)
class Registered:
    """The rigid transform of points to where they were read: ``read = turn @ point + shift``; half of all are off by
    ``missed_mm`` or less."""

    turn: Floats
    shift_mm: Floats
    missed_mm: float


def as_places(places: Floats) -> Floats:
    """Places (n, 3); of those in a plane (n, 2) the third coordinate is zero."""
    if places.shape[1] == 3:
        return places
    out = np.zeros((len(places), 3))
    out[:, : places.shape[1]] = places
    return out


def registered(
    points_mm: Floats, read_mm: Floats, *, mirrored: bool = False, fewest: int = _FEWEST
) -> Registered | None:
    """The turn and shift that bring most points (n, 3) to where they were read (n, 3); None where they are too few, or
    stand in a line. Rows with an empty cell (NaN) and rows far off do not count. ``mirrored`` is the best turn with a
    mirror."""
    points, read = (np.ascontiguousarray(one, dtype=float) for one in (points_mm, read_mm))
    found = _core.register_most(points, read, mirrored=mirrored, fewest=fewest)
    return None if found is None else Registered(*found)


# -- As a link of a chain in NumPy -------------------------------------------------------------------------------------
# The sensor's pose as a link of a chain in NumPy, where a robot has no compiled chain: its rows of the table, what
# the sensor sees, and how that changes. It is the same as ``rust/core/src/chain/sensor_pose.rs``.
#
#     seen = seen_from(pose, off, points)
#
# ``off`` are the six numbers of sherkit.model.sensor_pose.POSE, for all rows or for each of them: the picture of
# the robot is turned about the sensor's own axes, then shifted. Complex numbers pass, so that a
# sherkit.fit.numpy_chain.ComplexChain has exact derivatives without more.

Numbers = NDArray[Any]

#: Plausible sizes of where an instrument stands, rad and mm: people put trackers anywhere.
_TURN_RAD, _SHIFT_MM = 1.0, 1000.0
#: And of how far one is knocked.
_KNOCKED_RAD, _KNOCKED_MM = 5e-4, 0.2
#: Squared angles (rad²) below which series are better than sines.
_SMALL = 1e-2


# -- Rows of a table ----------------------------------------------------------------------------------------------


def pose_row(names: Collection[str] = POSE) -> dict[str, Any]:
    """The row of what every model has: these numbers of the pose. How far a turn moves the point is asked of the
    model."""
    own = [
        {"name": name, "symbol": name, **_of(name, _TURN_RAD, _SHIFT_MM), "lever_mm": None if name in TURNS else 1.0}
        for name in POSE
        if name in names
    ]
    return {"name": "sensor_pose", "link": "sensor", "base": True, "parameters": own, "needs": [], "search": None}


def slip_row(lever_mm: float, names: Collection[str] = POSE) -> dict[str, Any]:
    """The row of the effect: by how much these numbers change at the moment at which the instrument is knocked; a turn
    moves what is seen by ``lever_mm`` per radian."""
    own = [
        {"name": name.removeprefix("sensor_"), "symbol": name.removeprefix("sensor_"),
         **_of(name, _KNOCKED_RAD, _KNOCKED_MM), "lever_mm": lever_mm if name in TURNS else 1.0}
        for name in POSE if name in names
    ]  # fmt: skip
    return {"name": SLIP, "link": "sensor", "base": False, "parameters": own, "needs": ["time_s"],
            "search": "time_s"}  # fmt: skip


def drift_row(lever_mm: float, names: Collection[str] = POSE) -> dict[str, Any]:
    """The row of the effect: how fast these numbers change from the beginning of the run; a turn moves what is seen by
    ``lever_mm`` per radian."""
    own = []
    for row in slip_row(lever_mm, names)["parameters"]:
        word, axis = row["name"].split("_")
        name = f"{word}_rate_{axis}"
        own.append({**row, "name": name, "symbol": name, "unit": f"{row['unit']}/h"})
    return {"name": DRIFT, "link": "sensor", "base": False, "parameters": own, "needs": ["time_s"], "search": None}


def _of(name: str, turn: float, shift: float) -> dict[str, Any]:
    return {"unit": "rad", "size": turn} if name in TURNS else {"unit": "mm", "size": shift}


# -- What it sees ---------------------------------------------------------------------------------------------------


def seen_from(pose: SensorPose, off: Numbers, points_mm: Numbers) -> Numbers:
    """What the sensor sees (n, 3) of points (n, 3) of the base frame, mm, where its pose is ``off`` (6,) or (n, 6), rad
    and mm, from that of the robot's file."""
    return turned(pose, off, points_mm) + (pose.origin_mm + off[..., 3:])


def seen_in_plane(pose: SensorPose, off: Numbers, points_mm: Numbers) -> Numbers:
    """The same of x and y (n, 2) in a plane that is square to the sensor's z, with the three numbers of
    :data:`~sherkit.model.sensor_pose.IN_PLANE`, (3,) or (n, 3)."""
    whole = np.zeros((*off.shape[:-1], len(POSE)), dtype=off.dtype)
    whole[..., [POSE.index(name) for name in IN_PLANE]] = off
    points = np.concatenate([points_mm, np.zeros_like(points_mm[:, :1])], axis=1)
    return seen_from(pose, whole, points)[:, :2]


def turned(pose: SensorPose, off: Numbers, points_mm: Numbers) -> Numbers:
    """The same before it is shifted."""
    return np.asarray((turn_of(pose, off) @ points_mm[:, :, None])[:, :, 0])


def turn_of(pose: SensorPose, off: Numbers) -> Numbers:
    """From the axes of the base to those of the sensor (3, 3), or (n, 3, 3)."""
    return np.asarray(rotation_matrix(off[..., :3]) @ pose.turn)


def by_pose(pose: SensorPose, off: Numbers, points_mm: Numbers) -> Numbers:
    """Derivatives (n, 3, 6) of what is seen by the six numbers."""
    by_turn = -_cross(turned(pose, off, points_mm)) @ left_jacobian(off[..., :3])
    return np.concatenate([by_turn, np.broadcast_to(np.eye(3), by_turn.shape)], axis=2)


# -- Turns ----------------------------------------------------------------------------------------------------------


def rotation_matrix(turn_rad: Numbers) -> Numbers:
    """exp of rotation vectors (…, 3): matrices (…, 3, 3), exact for any turn; complex numbers pass."""
    square, is_small = _square(turn_rad)
    angle = np.sqrt(np.where(is_small, 1.0, square))
    sine = np.where(is_small, _series(square, 6, 20, 42, 72), np.sin(angle) / angle)
    return _rotated(turn_rad, sine, _versed(square, is_small, angle))


def left_jacobian(turn_rad: Floats) -> Floats:
    """By which vectors a small change of each component of turns (…, 3) turns what is seen (…, 3, 3)."""
    square, is_small = _square(turn_rad)
    angle = np.sqrt(np.where(is_small, 1.0, square))
    rest = np.where(is_small, _series(square, 20, 42, 72, 110) / 6, (angle - np.sin(angle)) / angle**3)
    return _rotated(turn_rad, _versed(square, is_small, angle), rest)


def _square(turn: Numbers) -> tuple[Numbers, NDArray[np.bool_]]:
    """The squared angles, and which are small: of none the root is taken, whose derivative has no end."""
    square = (turn * turn).sum(axis=-1)
    return square, np.abs(square) < _SMALL


def _series(square: Numbers, *divisors: int) -> Numbers:
    """1 - s/a (1 - s/b (1 - …)) of a squared angle s."""
    out = np.ones_like(square)
    for one in reversed(divisors):
        out = 1 - square / one * out
    return out


def _versed(square: Numbers, is_small: NDArray[np.bool_], angle: Numbers) -> Numbers:
    """(1 - cos a)/a² without a difference, which would lose digits."""
    return np.where(is_small, _series(square, 12, 30, 56, 90) / 2, 2 * np.sin(angle / 2) ** 2 / angle**2)


def _rotated(turn: Numbers, once: Numbers, twice: Numbers) -> Numbers:
    cross = _cross(turn)
    return np.asarray(np.eye(3) + once[..., None, None] * cross + twice[..., None, None] * (cross @ cross))


def _cross(v: Numbers) -> Numbers:
    """The matrices (…, 3, 3) that take w to v × w."""
    x, y, z = np.moveaxis(v, -1, 0)
    zero = np.zeros_like(x)
    return np.stack([np.stack(row, axis=-1) for row in ((zero, -z, y), (z, zero, -x), (-y, x, zero))], axis=-2)
