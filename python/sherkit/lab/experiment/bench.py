"""The bench: motors and sensors of one experiment, which drive to a step and read it."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field
from typing import Any, Self

import numpy as np

from ...data.called import factor
from ...errors import ExperimentError, Garbled, Implausible, OutOfRange
from ...model.kinds import Robot, kind_of
from ..instruments import AxisController
from ..instruments.base import Identity, Instrument, Reading
from ..instruments.transport import now_s
from .plan import PlanStep, Point
from .watch import Watch

#: A reading that is to stand still is looked at again so soon, s.
_STILL_POLL_S = 0.02
#: Spellings of units that columns have, beside those of :mod:`sherkit.data.columns`.
_UNITS = {("µm", "mm"): 1e-3, ("N", "mn"): 1e3, ("mN", "mn"): 1.0}


@dataclass(frozen=True)
class Settling:
    """How long a step waits before it is read: ``seconds``, then until ``count`` successive readings of every sensor
    lie within ``within``, at most ``longest_s``. Without ``within`` the seconds are all."""

    seconds: float = 2.0
    within: float | None = None
    count: int = 3
    longest_s: float = 30.0


@dataclass(frozen=True)
class Checks:
    """What a point must pass before it is stored.

    Two successive readings of a sensor lie within ``agree_within`` (in its unit): protocols without a checksum cannot
    tell a damaged digit. The encoders before and after the sensors lie within ``moved_within``. Where sensors show the
    robot's coordinates and ``plausible`` is given, each lies so near to where the drawing puts it. With ``watched``,
    what the sensors say is held against what the joints say, row by row
    (:class:`~sherkit.lab.experiment.watch.Watch`), in which a reading has a standard deviation of ``noise``, in the
    unit of the coordinates, to begin with.
    """

    agree_within: float = 0.05
    moved_within: float = 0.002
    plausible: float | None = None
    watched: bool = True
    noise: float = 0.05


@dataclass(frozen=True)
class Sensor:
    """An instrument that is read at every step; ``columns`` are what its values are called in the run.

    The end of a column's name is its unit; values are converted where the instrument has another one.
    """

    instrument: Instrument
    columns: tuple[str, ...] = ()
    settings: Mapping[str, Any] = field(default_factory=dict)

    def named(self, reading: Reading) -> dict[str, float]:
        """The values of a reading by column. Raises :class:`~sherkit.errors.ExperimentError` where they do not fit."""
        columns = self.columns or tuple(f"{n}_{u}" for n, u in zip(reading.names, reading.units, strict=True))
        if len(columns) != len(reading.values):
            raise ExperimentError(
                f"{reading.instrument}: gave {len(reading.values)} values; [[instrument]] columns names {len(columns)}"
            )
        out = {}
        for name, value, unit in zip(columns, reading.values, reading.units, strict=True):
            wanted = name.rpartition("_")[2]
            by = _UNITS.get((unit, wanted)) or factor(unit, wanted)
            if by is None:
                raise ExperimentError(f"{reading.instrument}: gives {unit}; column '{name}' is in {wanted}")
            out[name] = value * by
        return out


def _identified(one: Instrument, attempts: int = 4) -> Identity:
    """What it says of itself twice in a row: a word that the line has damaged is no other instrument."""
    before = one.identify()
    for _ in range(attempts):
        if before == (now := one.identify()):
            return now
        before = now
    raise one.fail(Garbled, f"says each time something else of itself; at last '{before.text}'")


@dataclass(eq=False)
class Bench:
    """Motors and sensors. ``with`` connects them, and on any way out stops what moves and closes them.

    ``motion_settings`` are noted in the run file beside those of the sensors.
    """

    robot: Robot
    motion: AxisController
    sensors: Sequence[Sensor]
    _: KW_ONLY
    settling: Settling = Settling()
    checks: Checks = Checks()
    motion_settings: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        names = [one.name for one in self.instruments]
        if len(set(names)) < len(names):
            raise ExperimentError(f"two instruments have the same name: {', '.join(sorted(names))}")

    def __enter__(self) -> Self:
        self.connect()
        return self

    def connect(self) -> None:
        """Opens all ports, stops what still moves, and switches the motors on, where they stand: nothing else moves.

        Raises :class:`~sherkit.errors.InstrumentError`; nothing is then left open.
        """
        with contextlib.ExitStack() as stack:
            stack.callback(self.close)
            for one in self.instruments:
                one.connect()
            # what a program that was killed left moving; the controller went on by itself
            if self.motion.is_moving():
                self.motion.stop()
            # switching on moves nothing
            self.motion.enable()
            stack.pop_all()

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Stops what this program moves, and gives all ports back."""
        with contextlib.ExitStack() as stack:
            # last in, first out: the motors before anything else
            for one in reversed(self.instruments):
                stack.callback(one.close)

    def identities(self) -> dict[str, dict[str, Any]]:
        """Kind, identity, port and settings of every instrument by name, for the run file."""
        out = {}
        settings = (self.motion_settings, *(s.settings for s in self.sensors))
        for one, its in zip(self.instruments, settings, strict=True):
            found = _identified(one)
            out[one.name] = {"kind": found.kind, "identity": found.text, "port": found.port, "settings": dict(its)}
        return out

    @property
    def instruments(self) -> tuple[Instrument, ...]:
        """Motors and sensors."""
        return (self.motion, *(s.instrument for s in self.sensors))

    def watch(self) -> Watch:
        """What holds the sensors against the joints; it sees nothing where the checks say that nobody watches."""
        return Watch(self.robot, self.owners if self.checks.watched else {}, self.checks.noise)

    @property
    def owners(self) -> dict[str, str]:
        """Which instrument each column comes from, by name."""
        joints = dict.fromkeys(kind_of(self.robot).layout.joints, self.motion.name)
        return joints | {column: s.instrument.name for s in self.sensors for column in s.columns}

    def prove(self, legs: Sequence[tuple[Sequence[float], Sequence[float]]]) -> int | None:
        """Before anything moves: it is proven where the axes stand. Returns the mark of their zero.

        ``legs`` are the ways (from, to) on one of which the joints have to be, each between its two ends; without any
        they may be anywhere within their limits, if the controller says that it was zeroed. Raises
        :class:`~sherkit.errors.NotReferenced`.
        """
        motion = self.motion
        found = motion.require_reference(limits=False)
        if not legs:
            return found.mark
        at, more = np.array(found.positions), motion.braking + 5.0 * motion.arrived_within
        ends = np.array(legs)
        on_way = ((at >= ends.min(axis=1) - more) & (at <= ends.max(axis=1) + more)).all(axis=1)
        if not on_way.any():
            shown = [", ".join(f"{q:.3f}" for q in place) for place in (at, ends[0, 0])]
            raise motion.not_referenced(
                f"its axes stand at {shown[0]} {motion.unit} by their encoders, expected {shown[1]} or the way from "
                "there to the next step"
            )
        return found.mark

    def look(self) -> Point:
        """Reads everything where the robot stands; nothing moves. Raises as :meth:`measure`."""
        return self._point(None)

    def check(self, places: Sequence[Sequence[float]] | np.ndarray[Any, Any]) -> None:
        """Raises :class:`~sherkit.errors.OutOfRange` where one of the places (n, k) is outside the soft limits."""
        for place in places:
            self.motion.check([float(q) for q in place])

    def drive(self, joints: Sequence[float]) -> None:
        """Moves the joints there and returns when they stand. Any error stops them first."""
        self.motion.move([float(q) for q in joints])

    def measure(self, step: PlanStep) -> Point:
        """Drives to the step, waits until it is still, reads everything, and checks it.

        Raises :class:`~sherkit.errors.InstrumentError`; the motors then stand.
        """
        for place in (*step.via, step.joints):
            self.drive(place)
        self._settle()
        return self._point(step)

    def _point(self, step: PlanStep | None) -> Point:
        before = self._joints()
        values: dict[str, float] = {}
        for sensor in self.sensors:
            reading = sensor.instrument.read_confirmed(self.checks.agree_within)
            if not before.time_s <= reading.time_s <= now_s():
                raise sensor.instrument.fail(
                    Implausible,
                    f"its reading was taken {now_s() - reading.time_s:+.3f} s ago by its time, and it was asked for "
                    f"{now_s() - before.time_s:.3f} s ago; it is an old one, or its clock was set",
                )
            values |= sensor.named(reading)
        after = self._joints()
        self._check_still(step, before, after)
        values = {**dict(zip(kind_of(self.robot).layout.joints, after.values, strict=True)), **values}
        self._check_plausible(values)
        return Point(step.pose if step else 0, step.repeat if step else 0, after.time_s, values)

    def _joints(self) -> Reading:
        return self.motion.read_confirmed(self.checks.moved_within)

    def _settle(self) -> None:
        rule = self.settling
        if rule.seconds > 0:
            time.sleep(rule.seconds)
        if rule.within is None:
            return
        end = time.monotonic() + rule.longest_s
        for sensor in self.sensors:
            last: list[tuple[float, ...]] = []
            while True:
                last = [*last, sensor.instrument.read().values][-rule.count :]
                spread = np.ptp(np.array(last), axis=0).max()
                if len(last) == rule.count and spread <= rule.within:
                    break
                if time.monotonic() > end:
                    raise sensor.instrument.fail(
                        Garbled,
                        f"does not stand still: its last {len(last)} readings differ by {spread:g} after "
                        f"{rule.longest_s:g} s; expected at most {rule.within:g}",
                    )
                time.sleep(_STILL_POLL_S)

    def _check_still(self, step: PlanStep | None, before: Reading, after: Reading) -> None:
        # the encoders' own resolution is no motion
        count = 1.5 / min(abs(a.counts_per_unit) for a in self.motion.axes)
        # where no row is taken, they were sent nowhere
        targets = after.values if step is None else step.joints
        for name, old, new, target in zip(after.names, before.values, after.values, targets, strict=True):
            if abs(new - old) > self.checks.moved_within + count:
                raise self.motion.fail(
                    Garbled,
                    f"{name} moved by {new - old:+.5f} {self.motion.unit} while the sensors were read; expected at "
                    f"most {self.checks.moved_within:g}",
                )
            if abs(new - target) > self.motion.arrived_within + count:
                raise self.motion.fail(
                    Garbled, f"{name} stands at {new:.5f} {self.motion.unit}; it was sent to {target:.5f}"
                )

    def _check_plausible(self, values: Mapping[str, float]) -> None:
        limit, kind = self.checks.plausible, kind_of(self.robot)
        names = kind.layout.coordinates
        if limit is None or not kind.shows_coordinates or not all(name in values for name in names):
            return
        drawn, unit = self.robot.forward([values[name] for name in kind.layout.joints]), kind.place_unit
        for name, place in zip(names, drawn, strict=True):
            if abs(values[name] - place) > limit:
                who = next(s.instrument for s in self.sensors if name in s.columns)
                raise who.fail(
                    OutOfRange,
                    f"{name} is {values[name]:.3f} {unit}; by the drawing {place:.3f} {unit}, and at most {limit:g} "
                    f"{unit} apart",
                )
