"""The virtual robot's surroundings: a clock, joints that move, what instruments sense of it, and what goes wrong."""

from __future__ import annotations

import math
import random
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from ...base.types import Floats


class StillRobot:
    """What the instruments see of a robot with its joints (n,) there, mm or rad, at ``time_s`` of the world's clock.

    By itself lasers read the joints, nothing bends, the camera sees grey: a robot with chosen hidden effects overrides
    what is otherwise with it. Noise is the instruments' own.
    """

    def lasers_mm(self, joints: Floats, time_s: float) -> Sequence[float]:
        """What each laser reads, mm; NaN where its beam misses. By itself the joints."""
        return [float(q) for q in joints]

    def wrench(self, joints: Floats, time_s: float) -> Sequence[float]:
        """Forces and torques at the tool: fx, fy, fz in N, tx, ty, tz in Nmm. By itself no load."""
        return [0.0] * 6

    def wavelengths_nm(self, joints: Floats, time_s: float) -> Sequence[Sequence[float]]:
        """Peaks of the gratings on each channel, nm. By itself one, on the first of four channels."""
        return [[1550.0], [], [], []]

    def picture(self, joints: Floats, time_s: float) -> NDArray[np.uint8]:
        """What the camera sees. By itself grey."""
        return np.full((48, 64), 128, np.uint8)


class World:
    """Joints as functions of time, behind all emulators of one laboratory.

    Joints are in the robot's units, mm or rad. The clock runs ``time_scale`` times as fast as the host's and begins at
    0 s. Emulated motion controllers set what the joints do; other emulators ask ``robot`` what they sense. May be used
    from several threads.
    """

    def __init__(
        self, joints: Sequence[float] = (0.0, 0.0, 0.0), *, robot: StillRobot | None = None,
        time_scale: float = 1.0,
    ) -> None:  # fmt: skip
        self.robot = robot or StillRobot()
        self.time_scale = time_scale
        self._begin_s = time.monotonic()
        self._lock = threading.Lock()
        self._joints: list[Callable[[float], float]] = [lambda _, q=float(q): q for q in joints]  # type: ignore[misc]
        self._left = np.array(joints, dtype=float)

    def now_s(self) -> float:
        """The world's time."""
        return (time.monotonic() - self._begin_s) * self.time_scale

    def __len__(self) -> int:
        return len(self._joints)

    def set_joint(self, joint: int, position: Callable[[float], float]) -> None:
        """From now on, ``joint`` (from 0) is at ``position(time_s)``."""
        now = self.now_s()
        with self._lock:
            self._left[joint] = self._joints[joint](now)
            self._joints[joint] = position

    def left(self) -> Floats:
        """Where each joint was when its last motion began: a robot's history, as far as backlash knows it."""
        with self._lock:
            return self._left.copy()

    def joints(self) -> Floats:
        """Where all joints are now."""
        return self.now()[0]

    def now(self) -> tuple[Floats, float]:
        """Where all joints are now, and the world's time: what the robot is asked with."""
        at = self.now_s()
        with self._lock:
            return np.array([q(at) for q in self._joints]), at

    def lasers_mm(self) -> Sequence[float]:
        """What the lasers read now."""
        return self.robot.lasers_mm(*self.now())

    def wrench(self) -> Sequence[float]:
        """Forces and torques now."""
        return self.robot.wrench(*self.now())

    def wavelengths_nm(self) -> Sequence[Sequence[float]]:
        """Peaks of the gratings now."""
        return self.robot.wavelengths_nm(*self.now())

    def picture(self) -> NDArray[np.uint8]:
        """What the camera sees now."""
        return self.robot.picture(*self.now())


# -- motions: trapezoids of speed, as motion controllers plan them (SP, AC, DC) ---------------------------------------


@dataclass(frozen=True)
class Profile:
    """From ``start`` to ``target`` with top ``speed``, ``acceleration`` and ``deceleration``, all positive; begins at
    ``begin_s``, and brakes from ``cut_s`` on wherever it is then. Any unit of length."""

    start: float
    target: float
    speed: float
    acceleration: float
    deceleration: float
    begin_s: float
    cut_s: float = math.inf

    @classmethod
    def standing(cls, at: float) -> Self:
        """No motion."""
        return cls(at, at, 1.0, 1.0, 1.0, 0.0)

    @cached_property
    def top(self) -> float:
        """The speed that is reached: less than ``speed`` on a short way."""
        a, d = self.acceleration, self.deceleration
        return min(self.speed, math.sqrt(2.0 * abs(self.target - self.start) * a * d / (a + d)))

    @cached_property
    def _whole_s(self) -> float:
        """When it stands at its target, unless it is cut short."""
        top = self.top
        if top == 0.0:
            return self.begin_s
        ramps = 0.5 * top * top / self.acceleration + 0.5 * top * top / self.deceleration
        cruise = max(abs(self.target - self.start) - ramps, 0.0) / top
        return self.begin_s + top / self.acceleration + cruise + top / self.deceleration

    @property
    def end_s(self) -> float:
        """When it stands."""
        return min(self._whole_s, self.cut_s + abs(self._speed(self.cut_s)) / self.deceleration)

    @property
    def end(self) -> float:
        """Where it stands."""
        return self.at(self.end_s)

    def at(self, time_s: float) -> float:
        """Position at ``time_s``."""
        if time_s <= self.cut_s:
            return self._position(time_s)
        speed, braked = self._speed(self.cut_s), max(min(time_s, self.end_s) - self.cut_s, 0.0)
        brake = math.copysign(0.5 * self.deceleration * braked * braked, speed)
        return self._position(self.cut_s) + speed * braked - brake

    def speed_at(self, time_s: float) -> float:
        """Speed at ``time_s``, with its sign."""
        if time_s <= self.cut_s:
            return self._speed(time_s)
        return math.copysign(max(self.end_s - time_s, 0.0) * self.deceleration, self._speed(self.cut_s))

    def stopped(self, time_s: float) -> Self:
        """What becomes of it when told to stop at ``time_s``: it brakes with its deceleration."""
        return replace(self, cut_s=min(time_s, self.cut_s))

    def stopped_at(self, place: float) -> Self:
        """What becomes of it when it runs into ``place``, which lies on its way."""
        early, late = self.begin_s, self._whole_s
        for _ in range(80):
            middle = 0.5 * (early + late)
            if (self._position(middle) < place) == (self.target > self.start):
                early = middle
            else:
                late = middle
        return self.stopped(late)

    def _position(self, time_s: float) -> float:
        if time_s <= self.begin_s:
            return self.start
        if time_s >= self._whole_s:
            return self.target
        way = math.copysign(1.0, self.target - self.start)
        t, left, top = time_s - self.begin_s, self._whole_s - time_s, self.top
        up = top / self.acceleration
        if t <= up:
            return self.start + way * 0.5 * self.acceleration * t * t
        if left <= top / self.deceleration:
            return self.target - way * 0.5 * self.deceleration * left * left
        return self.start + way * (0.5 * top * up + top * (t - up))

    def _speed(self, time_s: float) -> float:
        rising, falling = self.acceleration * (time_s - self.begin_s), self.deceleration * (self._whole_s - time_s)
        return math.copysign(max(min(rising, falling, self.top), 0.0), self.target - self.start)


# -- faults on demand: which of an emulator's answers go wrong, and how -----------------------------------------------

#: Of the line: the answer is lost, damaged, late; the port is closed. Of the command: it is damaged before it arrives.
#: Of the machine: a value outside the range, a limit switch that opens.
FAULTS = ("drop", "garble", "stall", "disconnect", "misheard", "over_range", "limit_switch")


def _check_is_fault(kind: str) -> None:
    if kind not in FAULTS:
        raise ValueError(f"no fault is called {kind!r}; expected one of {', '.join(FAULTS)}")


@dataclass(frozen=True)
class InjectedFault:
    """A fault of one of the ``FAULTS`` at answer number ``at``; ``seconds`` is how long a stall lasts."""

    kind: str
    at: int
    seconds: float = 0.0


@dataclass
class Faults:
    """Counts an emulator's answers and says which of them go wrong. May be used from several threads.

    ``rates`` are probabilities of each kind for each answer, drawn from ``seed``; ``schedule`` sets single ones.
    ``happened`` is what has been done.
    """

    rates: Mapping[str, float] = field(default_factory=dict)
    seed: int = 0
    stall_s: float = 1.0
    happened: list[InjectedFault] = field(default_factory=list)

    def __post_init__(self) -> None:
        for kind in self.rates:
            _check_is_fault(kind)
        self._random = random.Random(self.seed)
        self._planned: dict[int, InjectedFault] = {}
        self._count = 0
        self._lock = threading.Lock()

    def schedule(self, kind: str, after: int = 0, seconds: float | None = None) -> None:
        """Lets ``kind`` happen at the answer that comes after the next ``after`` ones."""
        _check_is_fault(kind)
        with self._lock:
            at = self._count + after
            self._planned[at] = InjectedFault(kind, at, self.stall_s if seconds is None else seconds)

    def clear(self) -> None:
        """Lets nothing more go wrong."""
        with self._lock:
            self._planned.clear()
            self.rates = {}

    def take(self) -> InjectedFault | None:
        """The fault of the next answer."""
        with self._lock:
            at = self._count
            self._count += 1
            fault = self._planned.pop(at, None)
            if fault is None and self.rates:
                draw = self._random.random()
                for kind, rate in self.rates.items():
                    if draw < rate:
                        fault = InjectedFault(kind, at, self.stall_s)
                        break
                    draw -= rate
            if fault is not None:
                self.happened.append(fault)
            return fault

    def garbled(self, data: bytes) -> bytes:
        """``data`` as a bad line hands it on: a few bytes changed, lost or added."""
        with self._lock:
            noisy = bytearray(data)
            for _ in range(self._random.randint(1, 3)):
                at = self._random.randrange(len(noisy) + 1)
                how = self._random.random()
                if how < 0.6 and at < len(noisy):
                    noisy[at] ^= 1 << self._random.randrange(8)
                elif how < 0.8:
                    noisy.insert(at, self._random.randrange(256))
                elif at < len(noisy):
                    del noisy[at]
            return bytes(noisy)
