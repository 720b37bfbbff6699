"""The column names of a table of measurements, and what they mean."""

from __future__ import annotations

import warnings
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

from ..base import built_in
from ..base.figures import closest, listed
from ..errors import MeasurementError, SherkitWarning

TIME = "time_s"
TEMPERATURE = "temperature_c"
POSE = "pose"
REPEAT = "repeat"
OUTLIER = "outlier"
#: Numbers or names that say which rows were read from one and the same place of the instrument.
SETUP = "setup"
#: Why a row was driven, where a loop has chosen it.
REASON = "reason"


@dataclass(frozen=True)
class Layout:
    """The columns of the runs of one kind of robot, beside those that every run may have.

    ``joints`` name the readings of the joints, ``coordinates`` what instruments show of where it is; ``distance`` is a
    reading between two places, whose other end is at ``to_joints``. People read coordinates in ``unit``, of which one
    unit of the file has ``per_unit``. ``velocities`` are covariates by joint; ``apart`` are columns of numbers by which
    readings at one pose are no repeats of each other, as those of several targets. ``from_fixed``: the other end of a
    distance is no pose but something that stands fixed, a place or a plane, which one of ``to_joints`` names by its
    number.
    ``loads`` are covariates that are zero for a robot that carries nothing. ``own_joints``: each robot names its joints
    itself, so that its columns are known no sooner than it is.
    ``joints_tell_pose``: rows with the same joint readings stand at the same pose. ``follows``: readings move with the
    joints; heights above a plate that is probed do not, and how little they vary says nothing of a mistake.
    ``by_time``: rows of a run in which no joint moves are no repeats of one pose, but a course in time.
    """

    joints: tuple[str, ...]
    coordinates: tuple[str, ...]
    unit: str
    per_unit: float
    distance: str | None = None
    to_joints: tuple[str, ...] = ()
    velocities: tuple[str, ...] = ()
    joints_tell_pose: bool = True
    follows: bool = True
    apart: tuple[str, ...] = ()
    from_fixed: bool = False
    loads: tuple[str, ...] = ()
    own_joints: bool = False
    by_time: bool = False

    @cached_property
    def readings(self) -> tuple[str, ...]:
        """Every reading column: the coordinates, then the distance."""
        return (*self.coordinates, self.distance) if self.distance else self.coordinates

    @cached_property
    def sigmas(self) -> tuple[str, ...]:
        """Columns that declare the noise of each reading."""
        return tuple(f"sigma_{name}" for name in self.readings)

    @cached_property
    def pose_sigmas(self) -> tuple[str, ...]:
        """Columns that declare an error of each reading which all repeats of a pose share, as a marker's centre has."""
        return tuple(f"pose_{name}" for name in self.sigmas)

    @cached_property
    def directions(self) -> tuple[str, ...]:
        """Columns with the sign of the last motion of each joint."""
        return tuple(f"direction_{k + 1}" for k in range(len(self.joints)))

    @cached_property
    def known(self) -> tuple[str, ...]:
        """Every column that means something by its name."""
        noise = (*self.sigmas, *self.pose_sigmas)
        own = (*self.joints, *self.to_joints, *self.readings, *noise, *self.directions)
        return (*own, TIME, POSE, REPEAT, OUTLIER)

    @cached_property
    def may_be_empty(self) -> tuple[str, ...]:
        """Columns where an empty cell means "not taken here"."""
        return (*self.to_joints, *self.readings, *self.sigmas, *self.pose_sigmas)

    @cached_property
    def all_in_mm(self) -> bool:
        """Whether joints and coordinates are all millimetres, and so of like size."""
        return self.follows and all(name.endswith("_mm") for name in (*self.joints, *self.coordinates))

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Readings without their units, for people."""
        return tuple(bare(name) for name in self.readings)


#: The kinds of run that kinds of robot have, as they were made known so far.
LAYOUTS: list[Layout] = []
#: Those of robots whose joints have names of their own. A robot may be there before its kind is known, and must not be
#: what messages speak of where columns fit nothing.
_OF_ROBOTS: list[Layout] = []


def known_layouts() -> list[Layout]:
    """Every kind of run that a file can hold, those of the built-in robots first."""
    built_in.load()
    return [*LAYOUTS, *(one for one in _OF_ROBOTS if one not in LAYOUTS)]


def know(*layouts: Layout, of_robot: bool = False) -> None:
    """Makes kinds of run known to the readers of files; those of one robot come after those of all kinds."""
    known = _OF_ROBOTS if of_robot else LAYOUTS
    known.extend(one for one in layouts if one not in known)


def layout_of(names: Collection[str], own: Sequence[Layout] = ()) -> Layout:
    """The kind of run that these columns belong to: whose joints and coordinates they name most of; of several, that
    with the fewest joints that they do not name. Where they name no joint of any robot, the first of its ``own``."""

    def named(one: Layout) -> tuple[float, int]:
        joints = sum(n in names for n in one.joints)
        # where none is named, the first kind is as good as any
        missing = len(one.joints) - joints if joints else len(names)
        return joints + 0.5 * sum(n in names for n in one.readings), -missing

    nearest = max(_read_in(names), key=named)
    return nearest if not own or any(name in names for name in nearest.joints) else own[0]


def _read_in(names: Collection[str]) -> list[Layout]:
    """The kinds of run of which a reading is there, in whatever unit; all where there is none. A joint of somebody's
    machine may be named as the reading of another, ``x_mm``."""
    bares = {bare(name) for name in names}
    return [one for one in known_layouts() if any(bare(r) in bares for r in one.readings)] or known_layouts()


def layout_to_come(names: Collection[str]) -> Layout | None:
    """The kind of run of a robot that is not known yet, whose joints have names of their own: what is left of the
    columns that are angles or lengths are its joints, until it is there (:func:`is_known`). None where some robot that
    is known has such a joint, in whatever unit, or where none is an angle."""
    known, bares = _read_in(names), {bare(name) for name in names}
    if any(bare(joint) in bares for one in known for joint in one.joints):
        return None
    for one in known:
        if one.own_joints and set(one.coordinates) <= set(names):
            taken = {*one.known, *one.apart, *one.loads} - {*one.joints}
            angles = [n for n in names if n not in taken and unit_in(n) in ("rad", "mm")]
            joints = tuple(n for n in angles if not n.startswith(("sigma_", "pose_sigma_")))
            if any(unit_in(name) == "rad" for name in joints):
                return replace(one, joints=joints, velocities=tuple(f"{name}_per_s" for name in joints))
    return None


def is_known(layout: Layout) -> bool:
    """Whether it is that of a robot that is there, not of one to come."""
    return not layout.own_joints or layout in known_layouts()


#: Units that end the name of a column.
_ENDINGS = ("mm", "um", "rad", "mrad", "deg", "px", "mN", "mn", "nm", "kg", "s")


#: Columns whose owner says that they end in their unit, whatever it is.
_OF_OWNERS: set[str] = set()


def know_unit(name: str) -> bool:
    """Makes known that a column's name ends in its unit, whatever text that is (``lamp_V``, ``scale_counts``); false
    where it has no such end, or one that is a number or an axis."""
    stem, _, unit = name.rpartition("_")
    if not stem or not unit or unit.isdigit() or unit.lower() in ("x", "y", "z"):
        return False
    _OF_OWNERS.update((name, f"sigma_{name}", f"pose_sigma_{name}"))
    return True


def bare(name: str) -> str:
    """A column's name without its unit."""
    stem, _, unit = name.rpartition("_")
    return stem if stem and (unit in _ENDINGS or name in _OF_OWNERS) else name


def unit_in(name: str) -> str:
    """The unit that a column's name ends in; empty where it names none."""
    return name.removeprefix(bare(name)).removeprefix("_")


#: A covariate whose name is as alike as this to a column that is not there may be a slip of the finger.
_MISSPELT = 0.8
#: Units of length that a column may have been written in by mistake.
LENGTHS = ("_m", "_um", "_µm", "_cm", "_in", "_mm")
ANGLES = ("_deg", "_mrad", "_urad", "_rad")
#: What ends our columns, what they may end in by mistake, and what it is to be converted to.
_WRITTEN_IN = (("_mm", LENGTHS, "millimetres"), ("_rad", ANGLES, "radians"))


def check_unique(names: list[str], where: str) -> None:
    """Refuses a column name that is given twice. Raises ``MeasurementError``."""
    if len(set(names)) < len(names):
        twice = sorted({f"'{n}'" for n in names if names.count(n) > 1})
        raise MeasurementError(f"{where}: column {listed(twice)} appears more than once")


def check_columns(names: list[str], where: str, own: Sequence[Layout] = (), *, to_come: bool = True) -> Layout:
    """The layout of a table. Refuses one that lacks what every run of its kind has, or holds a reading in another unit.

    ``own`` are those of the robot whose run it is; ``to_come``: it may be read later. Raises ``MeasurementError``;
    warns of a covariate whose name looks like a misspelt column.
    """
    layout = (to_come and layout_to_come(names)) or layout_of(names, own)
    for needed in layout.joints:
        if needed not in names:
            what = "the reading of a joint"
            if not own and not any(name in names for name in layout.joints):
                what += (
                    "; which ones a robot has its file says: sherkit check RUN ROBOT; a machine of your own is "
                    "described (sk.Machine) before its rows are read"
                )
            raise MeasurementError(_missing(needed, names, where, what, layout))
    if not any(r in names for r in layout.readings):
        what = f"at least one of {' or '.join([', '.join(layout.readings[:-1]), layout.readings[-1]])}"
        raise MeasurementError(_missing(layout.readings[0], names, where, what, layout))
    if layout.distance is not None and layout.distance in names:
        lacking = [n for n in layout.to_joints if n not in names]
        if len(lacking) > (len(layout.to_joints) - 1 if layout.from_fixed else 0):
            what = "the other end of each distance"
            if layout.from_fixed:
                what += f": the number of what it counts from, or '{layout.to_joints[-1]}'"
            raise MeasurementError(_missing(lacking[0], names, where, what, layout))
    absent = [n for n in layout.known if n not in names]
    for name in (n for n in names if n not in layout.known):
        stem = name.rsplit("_", 1)[0]
        for ours, units, meant in _WRITTEN_IN:
            if stem + ours in absent and name.removeprefix(stem) in units:
                raise MeasurementError(f"{where}: column '{name}': convert it to {meant} and name it '{stem}{ours}'")
        typed = closest(name.lower(), absent, cutoff=_MISSPELT)
        # a reading in capitals is refused
        capitals = typed == name.lower() and typed in (*layout.joints, *layout.readings)
        if typed and not capitals and name not in layout.velocities:
            message = f"{where}: column '{name}' is taken as a covariate; is it meant to be '{typed}'?"
            warnings.warn(message, SherkitWarning, stacklevel=2)
    return layout


def _missing(name: str, names: list[str], where: str, what: str, layout: Layout) -> str:
    stem = name.rsplit("_", 1)[0]
    for own, units, meant in _WRITTEN_IN:
        for unit in units:
            if stem + unit not in names:
                continue
            there = f"{where}: column '{name}' is missing ({what}); the file has '{stem + unit}'"
            if name.endswith(own):
                return f"{there}: convert it to {meant} and name it '{name}'"
            if name.endswith(("_mm", "_rad")):
                return f"{there}, which is no such thing: is this the run of another robot?"
    unknown = [n for n in names if n not in layout.known]
    typed = closest(name, unknown)
    hint = f"; is '{typed}' meant to be it?" if typed else f"; the file has {listed(names, 12)}"
    return f"{where}: column '{name}' is missing ({what}){hint}"
