"""ROS bags: joint states and poses of a recording as a run (the ``rosbags`` package; no ROS is needed)."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np

from ..base.arguments import validate_arguments
from ..base.figures import brief, listed, nearest
from ..base.types import Floats
from ..errors import MeasurementError, SherkitWarning
from .called import factor
from .columns import TIME, unit_in
from .frames import from_frame
from .rows import Measurements

#: REP 103: metres and radians, for what slides and what turns.
_JOINT_UNITS = {"mm": "m", "rad": "rad"}
_NANOSECONDS = 1e9


@validate_arguments
def from_rosbag(
    path: str | Path,
    joints: Mapping[str, str],
    poses: str,
    *,
    joint_states: str = "/joint_states",
    coordinates: Sequence[str] = ("x_mm", "y_mm", "z_mm"),
    longest_gap_s: float = 0.05,
    still_per_s: float | None = None,
) -> Measurements:
    """Measurements from a ROS 2 bag (or ROS 1), a row for each pose that was recorded.

    ``joints`` gives the names in ``sensor_msgs/JointState`` by our columns, ``{"q1_rad": "shoulder_pan_joint"}``;
    ``joint_states`` is their topic. ``poses`` is the topic of what a tracker saw: PoseStamped, PointStamped,
    TransformStamped, PoseWithCovarianceStamped or Odometry, whose position is read as ``coordinates``. ROS has metres
    and radians; columns have their own units.

    Joints are interpolated at the pose's own time (its header). A pose without joint states within ``longest_gap_s``
    on both sides is left out, and one at which a joint was faster than ``still_per_s`` (its unit per s), where that is
    given; how many, is said in a :class:`~sherkit.errors.SherkitWarning`.

    Raises :class:`~sherkit.errors.MeasurementError` for a bag that is none, and for a topic, message or joint that is
    not there.

        joints = {"q1_mm": "rail_1", "q2_mm": "rail_2", "q3_mm": "rail_3"}
        run = sk.from_rosbag("bag", joints, "/tracker")
    """
    path = Path(path)
    if not joints:
        raise MeasurementError(f"{path}: joints is empty; expected the names in {joint_states} by our columns")
    times, readings = _read(path, joint_states, _joints_in(path, joint_states, joints))
    seen_at, places = _read(path, poses, _position_in(path, poses))
    order = np.argsort(times, kind="stable")
    times, readings = times[order], readings[order]
    after = np.searchsorted(times, seen_at)
    inside = (after > 0) & (after < len(times))
    # a pose at the very time of the first joint state has it
    after = np.clip(np.where((after == 0) & (seen_at == times[0]), 1, after), 1, max(len(times) - 1, 1))
    if len(times) < 2:
        raise MeasurementError(
            f"{path}: {joint_states} holds {len(times)} message; expected joints before and after each pose"
        )
    inside |= seen_at == times[0]
    gap = times[after] - times[after - 1]
    moved = np.abs(readings[after] - readings[after - 1]).max(axis=1) / np.maximum(gap, 1e-9)
    taken = inside & (gap <= longest_gap_s)
    still = np.ones_like(taken) if still_per_s is None else moved <= still_per_s
    _say(path, len(seen_at), int((~taken).sum()), int((taken & ~still).sum()), longest_gap_s)
    taken &= still
    if not taken.any():
        raise MeasurementError(f"{path}: no pose of {poses} has joint states within {longest_gap_s:g} s at both sides")
    table: dict[str, Floats] = {name: np.interp(seen_at[taken], times, readings[:, k]) for k, name in enumerate(joints)}
    for k, name in enumerate(coordinates):
        table[name] = _scaled(places[taken, k], "m", name, path)
    table[TIME] = seen_at[taken] - seen_at.min()
    return from_frame(table, str(path))


def _scaled(values: Floats, unit: str, column: str, path: Path) -> Floats:
    by = factor(unit, unit_in(column))
    if by is None:
        raise MeasurementError(f"{path}: column '{column}' cannot be read from a number in {unit}")
    return values * by


def _say(path: Path, count: int, alone: int, fast: int, longest_gap_s: float) -> None:
    said = [f"{alone} without joint states within {longest_gap_s:g} s"] if alone else []
    said += [f"{fast} while a joint moved"] if fast else []
    if said:
        warnings.warn(f"{path}: of {count} poses were left out: {', '.join(said)}", SherkitWarning, stacklevel=3)


def _joints_in(path: Path, topic: str, joints: Mapping[str, str]) -> Any:
    units = []
    for column in joints:
        unit = unit_in(column)
        if unit not in _JOINT_UNITS:
            raise MeasurementError(f"{path}: column '{column}': expected a joint in mm or rad")
        units.append(factor(_JOINT_UNITS[unit], unit) or 1.0)

    def positions(message: Any) -> list[float]:
        names = list(getattr(message, "name", []))
        absent = [name for name in joints.values() if name not in names]
        if absent:
            hint = nearest(absent[0], names) or f"; it has {listed(names, 12)}"
            raise MeasurementError(f"{path}: {topic} has no joint '{absent[0]}'{hint}")
        return [float(message.position[names.index(n)]) * by for n, by in zip(joints.values(), units, strict=True)]

    return positions


def _position_in(path: Path, topic: str) -> Any:
    def position(message: Any) -> list[float]:
        for where in (("pose", "pose", "position"), ("pose", "position"), ("point",), ("transform", "translation")):
            found = message
            for part in where:
                found = getattr(found, part, None)
            if found is not None:
                return [float(found.x), float(found.y), float(found.z)]
        raise MeasurementError(
            f"{path}: {topic} holds {getattr(message, '__msgtype__', type(message).__name__)}; expected a pose, point, "
            "transform or odometry with a header"
        )

    return position


def _whole(database: Path) -> None:
    """Raises where a database is not whole: SQLite reads on from a damaged page for minutes, or until memory ends."""
    # some Pythons are built without it, and nobody else needs it
    import sqlite3

    try:
        with closing(sqlite3.connect(f"{database.resolve().as_uri()}?immutable=1", uri=True)) as opened:
            # what is damaged may be the very name that is told
            opened.text_factory = lambda told: told.decode("utf-8", "replace")
            found = opened.execute("PRAGMA quick_check(1)").fetchone()[0]
    except (sqlite3.Error, UnicodeDecodeError) as error:
        found = str(error)
    if found != "ok":
        raise MeasurementError(
            f"{database}: is damaged ({found.splitlines()[-1]}); record it anew, or save what is left by "
            f"`sqlite3 {database.name} .recover`"
        )


def _read(path: Path, topic: str, values: Any) -> tuple[Floats, Floats]:
    """Times of the headers (n,), s, and values (n, k) of every message of a topic."""
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise MeasurementError("bags of ROS need the extra 'ros': pip install \"sherkit[ros]\"") from None
    if not path.exists():
        raise MeasurementError(f"{path}: there is no such bag")
    for database in sorted(path.glob("*.db3")):
        _whole(database)
    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.LATEST)) as reader:
            chosen = [one for one in reader.connections if one.topic == topic]
            if not chosen:
                topics = sorted({one.topic for one in reader.connections})
                raise MeasurementError(
                    f"{path}: has no topic '{topic}'{nearest(topic, topics)}; it has {listed(topics, 12)}"
                )
            times, found = [], []
            for connection, _, raw in reader.messages(connections=chosen):
                message: Any = reader.deserialize(raw, connection.msgtype)
                stamp = getattr(getattr(message, "header", None), "stamp", None)
                if stamp is None:
                    raise MeasurementError(
                        f"{path}: {topic} holds {connection.msgtype}, which has no header with a time"
                    )
                times.append(stamp.sec + stamp.nanosec / _NANOSECONDS)
                found.append(values(message))
    except MeasurementError:
        raise
    # rosbags raises errors of its own, of SQLite, of decompression and of YAML
    except Exception as error:
        why = f"{type(error).__name__}: {brief(error, 200)}"
        raise MeasurementError(f"{path}: is no bag that can be read: {why}") from None
    if not found:
        raise MeasurementError(f"{path}: {topic} holds no message")
    finite = np.isfinite(found).all(axis=1)
    if not finite.all():
        raise MeasurementError(f"{path}: {topic}, message {int(np.argmin(finite))} is not finite")
    return np.array(times), np.array(found)
