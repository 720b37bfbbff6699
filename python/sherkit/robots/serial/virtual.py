"""A virtual serial arm: planted errors, noise, and a tracker that looks at it.

It is the compiled chain with values put in. What judges that, by formulas of its own, is
``tests/second_simulator/serial.py``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Self

import numpy as np
import scipy
from numpy.typing import ArrayLike

import sherkit._core as _core

from ...base.types import Floats
from ...data import Measurements
from ...data.toml import Table
from ...model.chain import Block
from ...model.kinds import Option, walked
from .points import Plane
from .robot import CENTRE, MOST_JOINTS, PAYLOAD, PLANE, TARGET, Serial

# -- Sets of postures ---------------------------------------------------------------------------------------------

#: Postures of each, and the part of the limits that a local set keeps to.
_WHOLE, _LOCAL, _PART = 60, 40, 0.2


def postures(robot: Serial, count: int, share: float = 1.0, seed: int = 0) -> Floats:
    """Joint readings (count, k), at random within ``share`` of the limits about home."""
    low, high = robot.ranges
    middle = np.clip(robot.home, low, high)
    at = np.random.default_rng(seed).uniform(size=(count, len(low)))
    return middle + share * (low + at * (high - low) - middle)


#: All that the joints can reach, and the middle of it.
AREAS: Mapping[str, Callable[[Serial], Floats]] = {
    "whole": lambda robot: postures(robot, _WHOLE),
    "local": lambda robot: postures(robot, _LOCAL, _PART),
}


# -- The arm ------------------------------------------------------------------------------------------------------

_SECONDS_PER_POSE = 4.0
#: Plausible geometric errors of an arm: zeros of joints, rad; places of axes and target, mm; leans, rad; where the
#: tracker stands, mm and rad.
_SIZES = {"offset": 3e-3, "shift": 0.5, "tilt": 1e-3, "tool": 2.0, "stand": 20.0, "turn": 0.02}
#: A sliding joint errs by as many mm as a turning one by a radian.
_SLIDE_MM = 100.0
#: By how much the room of a run warms, and how quickly, by the run.
_WARMS_C, _QUICK = 3.0, 2.0
#: The row of the chain's table that each error is; of each joint one number or two come first, the joints one after
#: the other.
_ROWS = {
    "offset": "joint_offset", "shift_mm": "joint_shift", "tilt_rad": "joint_tilt", "stand": "sensor_pose",
    "centres_mm": "centres", "scale": "joint_scale", "gives": "joint_compliance", "sags": "payload_compliance",
    "play": "backlash", "ring": "encoder_eccentricity", "lines": "encoder_cyclic", "twice": "encoder_second",
    "warmth_per_c": "thermal_growth", "growth_per_c": "link_growth", "rate_mm_h": "drift", "step_mm": "slip",
    "lost": "joint_slip", "stand_mm_per_c": "thermal_shift", "knock": "sensor_slip",
    "settles": "sensor_drift", "zoom": "sensor_scale",
    "bend_mm": "sensor_linearity", "late_s": "reading_delay", "bar_mm": "bar_zero",
    "follows": "joint_coupling",
}  # fmt: skip
#: How many numbers each row of the table has, for all the joints that an arm may have.
_COUNTS = {row["name"]: len(row["parameters"]) for row in _core.SerialModel.CATALOGUE}


def _behind(part: Floats, lag: float) -> Floats:
    """How far something has warmed (n,), of one, at these parts of a run whose room warms as ``1 - exp(-2 part)``: it
    comes behind with a lag, in parts of the run, ``lag dS/dpart + S`` being the room."""
    if lag <= 0.0:
        return np.asarray(1.0 - np.exp(-_QUICK * part))
    if abs(_QUICK * lag - 1.0) < 1e-6:
        lag *= 1.0 + 1e-5
    led = 1.0 / (1.0 - _QUICK * lag)
    return np.asarray(1.0 - led * np.exp(-_QUICK * part) + (led - 1.0) * np.exp(-part / lag))


@dataclass(frozen=True)
class Hidden:
    """What is hidden in an arm besides its geometry, each zero where it is not at work; rad, or mm of joints that
    slide.

    ``scale`` (k,) are parts of the readings; ``follows`` (k,) by how much each joint follows the one before it;
    ``gives`` (k,) how far it gives way under the greatest moment its weight makes in any posture stretched out;
    ``sags`` (k,) how far by the moment that a payload makes about it, rad/(N m), or by its force, mm/N;
    ``play`` (k,) its lost motion; ``ring`` (k, 2) sine and cosine of its encoder once per turn, ``lines`` (k, 2) those
    at ``per_turn`` per radian, ``twice`` (k, 2) at twice that; ``warmth_per_c`` of the whole, ``growth_per_c``
    (k + 1,) of the base and of the link behind each joint, ``rate_mm_h`` (3,), ``step_mm`` (3,) of the
    targets in the frame of the last joint, half way through,
    ``lost`` (k,) what joints slipped by then;
    ``stand_mm_per_c`` (3,) what the stand does, ``stand_lag_s`` behind the room; ``knock`` (6,) turn and shift of the
    tracker half way through, ``settles`` (6,) those in an hour;
    ``zoom`` and ``bend_mm`` (3,) at a metre what the tracker misreads; ``late_s``
    its delay; ``bar_mm`` what is added to every distance.
    """

    scale: ArrayLike = 0.0
    follows: ArrayLike = 0.0
    gives: ArrayLike = 0.0
    sags: ArrayLike = 0.0
    play: ArrayLike = 0.0
    ring: ArrayLike = 0.0
    lines: ArrayLike = 0.0
    twice: ArrayLike = 0.0
    per_turn: float = 2.0
    warmth_per_c: float = 0.0
    growth_per_c: ArrayLike = 0.0
    rate_mm_h: ArrayLike = 0.0
    step_mm: ArrayLike = 0.0
    lost: ArrayLike = 0.0
    stand_mm_per_c: ArrayLike = 0.0
    stand_lag_s: float = 0.0
    knock: ArrayLike = 0.0
    settles: ArrayLike = 0.0
    zoom: float = 0.0
    bend_mm: ArrayLike = 0.0
    late_s: float = 0.0
    bar_mm: float = 0.0


@dataclass(frozen=True)
class VirtualSerial:
    """An arm that is not as drawn.

    ``offset`` (k,) are errors of the joints' zeros, ``shift_mm`` (k, 2) and ``tilt_rad`` (k, 2) how far each axis lies
    beside its place and leans, in its frame; ``tool_mm`` (3,) or (t, 3) moves the targets, ``centres_mm`` (c, 3) the
    centres of distances, ``planes`` (p, 4) turns planes about the base's axes, rad, and lifts them, mm; ``stand`` (6,)
    is a turn and a shift of what the tracker sees, rad and mm. ``noise_mm`` is the standard deviation of a reading,
    ``distance_noise_mm`` that of a distance, the same unless it is given.
    """

    robot: Serial
    offset: ArrayLike = 0.0
    shift_mm: ArrayLike = 0.0
    tilt_rad: ArrayLike = 0.0
    tool_mm: ArrayLike = 0.0
    stand: ArrayLike = 0.0
    effects: Hidden = field(default_factory=Hidden)
    noise_mm: float = 0.0
    centres_mm: ArrayLike = 0.0
    distance_noise_mm: float | None = None
    planes: ArrayLike = 0.0

    OPTIONS: ClassVar[Mapping[str, Option]] = {
        "noise_um": Option(50.0, "of a reading"),
        "yield_mrad": Option(0.0, "joints that give way by this much under their weight"),
        "play_mrad": Option(0.0, "lost motion of each joint"),
        "ring_mrad": Option(0.0, "encoders off the axis of their joints"),
    }

    @classmethod
    def simulated(cls, robot: Serial, seed: int, errors: float, sizes: Mapping[str, float]) -> Self:
        """One with geometric errors of ``errors`` times a plausible size, and ``sizes`` of each of :attr:`OPTIONS`."""
        rng, k = np.random.default_rng(seed), len(robot.joints)
        slide = np.where([joint.slides for joint in robot.joints], _SLIDE_MM, 1.0)
        drawn = {name: errors * size * rng.normal(size=(k, 3)) for name, size in _SIZES.items()}
        hidden = Hidden(
            gives=1e-3 * sizes["yield_mrad"] * slide * rng.uniform(0.5, 1.5, k),
            play=1e-3 * sizes["play_mrad"] * slide * rng.uniform(0.5, 1.5, k),
            ring=1e-3 * sizes["ring_mrad"] * (slide == 1.0)[:, None] * rng.normal(size=(k, 2)),
        )
        tools, centres = drawn["tool"][0], np.zeros((len(robot.centres_mm), 3))
        if more := len(robot.more_targets_mm):
            tools = np.vstack([tools, errors * _SIZES["tool"] * rng.normal(size=(more, 3))])
        if len(centres):
            centres = errors * _SIZES["tool"] * rng.normal(size=centres.shape)
        return cls(
            robot,
            drawn["offset"][:, 0] * slide,
            drawn["shift"][:, :2],
            drawn["tilt"][:, :2],
            tools,
            np.concatenate([drawn["turn"][0], drawn["stand"][0]]),
            hidden,
            1e-3 * sizes["noise_um"],
            centres,
            planes=errors * np.array([*3 * [_SIZES["turn"]], _SIZES["tool"]]) * rng.normal(size=(len(robot.planes), 4)),
        )

    @classmethod
    def hidden(cls, robot: Serial, seed: int, table: Table) -> Self:
        """One without noise, as a laboratory describes it."""
        sizes = {name: table.number(name, 0.0) for name in cls.OPTIONS if name != "noise_um"}
        return cls.simulated(robot, seed, table.number("errors", 0.0), {"noise_um": 0.0, **sizes})

    def with_hidden(self, **effects: Any) -> Self:
        """The same with more hidden in it."""
        return replace(self, effects=replace(self.effects, **effects))

    def truth(self) -> dict[str, Any]:
        """The hidden errors, for TOML: mm and rad."""
        names = ["offset", "shift_mm", "tilt_rad", "stand", "tool_mm"]
        names += [name for name in ("centres_mm", "planes") if getattr(self.robot, name)]
        own = {name: self._as(name).tolist() for name in names}
        if not self.robot.more_targets_mm:
            own["tool_mm"] = own["tool_mm"][0]
        more = {name: np.asarray(value, dtype=float).tolist() for name, value in vars(self.effects).items()}
        return {**own, "effects": more}

    # -- what it does ------------------------------------------------------------------------------------------

    def _as(self, name: str) -> Floats:
        """A field of this class or of :class:`Hidden` as an array of its shape."""
        robot, k = self.robot, len(self.robot.joints)
        many: dict[str, tuple[int, ...]] = {
            "tool_mm": (len(robot.targets_mm), 3), "centres_mm": (len(robot.centres_mm), 3),
            "planes": (len(robot.planes), 4),
        }  # fmt: skip
        by_count = {1: (), 3: (3,), 6: (6,), MOST_JOINTS + 1: (k + 1,), 2 * MOST_JOINTS: (k, 2)}
        shape = many[name] if name in many else by_count.get(_COUNTS[_ROWS[name]], (k,))
        given = getattr(self if hasattr(self, name) else self.effects, name)
        return np.broadcast_to(np.asarray(given, dtype=float), shape)

    def shown(self, slips_s: float, block: Block) -> Floats:
        """What instruments without noise show (n, 4): x, y, z, distance, mm, at rows as the chain takes them, once all
        that slips has done so at a moment."""
        tools, follows = self._as("tool_mm"), self._as("follows")
        given = {row: self._as(name) for name, row in _ROWS.items()}
        given |= {"tool": tools[0], "targets": tools[1:], "joint_coupling": follows[1:]}
        values = {name: np.zeros(count) for name, count in _COUNTS.items()}
        for name, numbers in given.items():
            values[name][: numbers.size] = numbers.ravel()
        lifted = []
        for drawn, (*turn, lift) in zip(self.robot.planes, self._as("planes"), strict=True):
            up = scipy.spatial.transform.Rotation.from_rotvec(turn).apply(drawn.normal)
            at_mm = np.array(drawn.at_mm) + lift * up / np.linalg.norm(up)
            lifted.append(Plane(tuple(at_mm.tolist()), tuple(up.tolist())))
        core = replace(self.robot, planes=tuple(lifted)).core(
            (2.0 * np.pi / self.effects.per_turn, 0.0, slips_s, slips_s, slips_s)
        )
        return core.predict(np.concatenate([*values.values()]), block)[0]

    def noise_free(self, joints: ArrayLike) -> Floats:
        """What a run without noise, time and motion would hold (n, 3), mm."""
        rows = np.atleast_2d(np.asarray(joints, dtype=float))
        still = np.tile([0.0, 20.0, *np.zeros(2 * rows.shape[1]), 1.0, 0.0, 20.0], (len(rows), 1))
        return np.ascontiguousarray(self.shown(1.0, (np.ascontiguousarray(rows), None, still, None))[:, :3])

    def measure(
        self, joints: ArrayLike, *, repeats: int = 1, order: str = "shuffled", seed: int = 0,
        payload_kg: ArrayLike | None = None,
    ) -> Measurements:  # fmt: skip
        """Drives to joint readings (n, k) and reads the target at each; half way through, what lets go lets go.

        An arm is sent to joints, not to places: a place leaves open how it stands there. It warms by three degrees.
        ``payload_kg``, one or (n,) for the poses, hangs at the first target; left out, nothing does, and no such
        column is written.
        """
        rng, robot, layout, hidden = np.random.default_rng(seed), self.robot, self.robot.layout, self.effects
        poses = np.atleast_2d(np.asarray(joints, dtype=float))
        pose, said = walked(len(poses), repeats, order, rng)
        n, read = len(pose), poses[pose]
        time, part = _SECONDS_PER_POSE * np.arange(n), np.arange(n) / max(n - 1, 1)
        payload = np.broadcast_to(np.asarray(0.0 if payload_kg is None else payload_kg, dtype=float), len(poses))[pose]
        came = np.sign(np.diff(read, axis=0, prepend=read[:1] - 0.1))
        velocity = rng.normal(size=read.shape) * np.ptp(read, axis=0) / 10.0 if hidden.late_s else np.zeros_like(read)
        warmth = 20.0 + _WARMS_C * _behind(part, 0.0)
        stand = 20.0 + _WARMS_C * _behind(part, hidden.stand_lag_s / max(time[-1], 1.0))
        each = np.repeat(np.arange(n), len(robot.reads))
        target, *ends = np.tile(robot.reads, (n, 1)).T
        is_place = np.isnan(ends[0]) & np.isnan(ends[1])
        known = np.column_stack(
            [*(v[each] for v in (time, warmth, came, velocity)), target, payload[each], stand[each]]
        )
        block = (np.ascontiguousarray(read[each]), np.column_stack(ends), known, None)
        exact = self.shown(float(time[n // 2]), block)
        places = exact[:, :3] + self.noise_mm * rng.normal(size=(len(each), 3))
        columns: dict[str, Any] = {"time_s": time, "temperature_c": warmth, **said}
        if payload_kg is not None:
            columns[PAYLOAD] = payload
        columns |= dict(zip(layout.joints, read.T, strict=True))
        if hidden.late_s:
            columns |= dict(zip(layout.velocities, velocity.T, strict=True))
        columns = {name: values[each] for name, values in columns.items()}
        if robot.more_targets_mm:
            columns[TARGET] = target.astype(int)
        if not is_place.all():
            noise = self.noise_mm if self.distance_noise_mm is None else self.distance_noise_mm
            far = exact[:, 3] + noise * rng.normal(size=len(each))
            columns |= dict(zip((CENTRE, PLANE), ends, strict=True))
            columns["distance_mm"] = np.where(is_place, np.nan, far)
            places = np.where(is_place[:, None], places, np.nan)
        columns |= dict(zip(layout.coordinates, places.T, strict=True))
        return Measurements.from_columns(columns, "simulation", layout=layout)
