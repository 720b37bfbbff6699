"""The virtual robot's surroundings: a clock, joints that move, what instruments sense of it, and what goes wrong."""

from __future__ import annotations

import math
import random
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ...base.types import Floats


class VirtualRobot(Protocol):
    """What the instruments see of a robot with its joints (n,) there, mm or rad, at ``time_s`` of the world's clock.

    A caller plugs in a robot with chosen hidden effects. Noise is the instruments' own.
    """

    def lasers_mm(self, joints: Floats, time_s: float) -> Sequence[float]:
        """What each laser reads, mm; NaN where its beam misses."""
        ...

    def wrench(self, joints: Floats, time_s: float) -> Sequence[float]:
        """Forces and torques at the tool: fx, fy, fz in N, tx, ty, tz in Nmm."""
        ...

    def wavelengths_nm(self, joints: Floats, time_s: float) -> Sequence[Sequence[float]]:
        """Peaks of the gratings on each channel, nm."""
        ...

    def picture(self, joints: Floats, time_s: float) -> NDArray[np.uint8]:
        """What the camera sees."""
        ...


class StillRobot:
    """A stand-in: lasers read the joints, nothing bends, the camera sees grey. Override what a test needs."""

    def lasers_mm(self, joints: Floats, time_s: float) -> Sequence[float]:
        """The joints themselves."""
        return [float(q) for q in joints]

    def wrench(self, joints: Floats, time_s: float) -> Sequence[float]:
        """No load."""
        return [0.0] * 6

    def wavelengths_nm(self, joints: Floats, time_s: float) -> Sequence[Sequence[float]]:
        """One grating on the first of four channels."""
        return [[1550.0], [], [], []]

    def picture(self, joints: Floats, time_s: float) -> NDArray[np.uint8]:
        """Grey."""
        return np.full((48, 64), 128, np.uint8)


class World:
    """Joints as functions of time, behind all emulators of one laboratory.

    Joints are in the robot's units, mm or rad. The clock runs ``time_scale`` times as fast as the host's and begins at
    0 s. Emulated motion controllers set what the joints do; other emulators ask ``robot`` what they sense. May be used
    from several threads.
    """

    def __init__(
        self, joints: Sequence[float] = (0.0, 0.0, 0.0), *, robot: Any = None, time_scale: float = 1.0
    ) -> None:
        self.robot: VirtualRobot = StillRobot() if robot is None else robot
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

    def joints(self, time_s: float | None = None) -> Floats:
        """Where all joints are, now if left out."""
        at = self.now_s() if time_s is None else time_s
        with self._lock:
            return np.array([q(at) for q in self._joints])

    def lasers_mm(self) -> Sequence[float]:
        """What the lasers read now."""
        now = self.now_s()
        return self.robot.lasers_mm(self.joints(now), now)

    def wrench(self) -> Sequence[float]:
        """Forces and torques now."""
        now = self.now_s()
        return self.robot.wrench(self.joints(now), now)

    def wavelengths_nm(self) -> Sequence[Sequence[float]]:
        """Peaks of the gratings now."""
        now = self.now_s()
        return self.robot.wavelengths_nm(self.joints(now), now)

    def picture(self) -> NDArray[np.uint8]:
        """What the camera sees now."""
        now = self.now_s()
        return self.robot.picture(self.joints(now), now)


# -- motions: trapezoids of speed, as motion controllers plan them (SP, AC, DC) ---------------------------------------


@dataclass(frozen=True)
class Profile:
    """From ``start`` to ``end`` with top ``speed``, ``acceleration`` and ``deceleration``, all positive; begins at
    ``begin_s``. Any unit of length."""

    start: float
    end: float
    speed: float
    acceleration: float
    deceleration: float
    begin_s: float

    @property
    def top(self) -> float:
        """The speed that is reached: less than ``speed`` on a short way."""
        way = abs(self.end - self.start)
        a, d = self.acceleration, self.deceleration
        return min(self.speed, math.sqrt(2.0 * way * a * d / (a + d)))

    @property
    def end_s(self) -> float:
        """When it stands."""
        top = self.top
        if top == 0.0:
            return self.begin_s
        ramps = 0.5 * top * top / self.acceleration + 0.5 * top * top / self.deceleration
        cruise = max(abs(self.end - self.start) - ramps, 0.0) / top
        return self.begin_s + top / self.acceleration + cruise + top / self.deceleration

    def at(self, time_s: float) -> float:
        """Position at ``time_s``."""
        if time_s <= self.begin_s:
            return self.start
        if time_s >= self.end_s:
            return self.end
        sign = 1.0 if self.end > self.start else -1.0
        t, top = time_s - self.begin_s, self.top
        up = top / self.acceleration
        if t <= up:
            return self.start + sign * 0.5 * self.acceleration * t * t
        left = self.end_s - time_s
        if left <= top / self.deceleration:
            return self.end - sign * 0.5 * self.deceleration * left * left
        return self.start + sign * (0.5 * top * up + top * (t - up))

    def speed_at(self, time_s: float) -> float:
        """Speed at ``time_s``, with its sign."""
        if not self.begin_s < time_s < self.end_s:
            return 0.0
        sign = 1.0 if self.end > self.start else -1.0
        rising = self.acceleration * (time_s - self.begin_s)
        falling = self.deceleration * (self.end_s - time_s)
        return sign * min(rising, falling, self.top)

    def stopped(self, time_s: float) -> Braking:
        """What becomes of it when told to stop at ``time_s``: it brakes with its deceleration."""
        speed = self.speed_at(time_s)
        return Braking(self.at(time_s), speed, self.deceleration, time_s)

    def passes_s(self, place: float) -> float:
        """When it is at ``place``, which lies on its way."""
        early, late = self.begin_s, self.end_s
        rising = self.end > self.start
        for _ in range(80):
            middle = 0.5 * (early + late)
            if (self.at(middle) < place) == rising:
                early = middle
            else:
                late = middle
        return late


@dataclass(frozen=True)
class Braking:
    """From ``start`` at ``speed`` (signed) to a stop with ``deceleration``."""

    start: float
    speed: float
    deceleration: float
    begin_s: float

    @property
    def end(self) -> float:
        """Where it stands."""
        return self.start + 0.5 * self.speed * abs(self.speed) / self.deceleration

    @property
    def end_s(self) -> float:
        """When it stands."""
        return self.begin_s + abs(self.speed) / self.deceleration

    def at(self, time_s: float) -> float:
        """Position at ``time_s``."""
        t = min(max(time_s - self.begin_s, 0.0), self.end_s - self.begin_s)
        return self.start + self.speed * t - math.copysign(0.5 * self.deceleration * t * t, self.speed)

    def speed_at(self, time_s: float) -> float:
        """Speed at ``time_s``, with its sign."""
        left = self.end_s - time_s
        return math.copysign(self.deceleration * left, self.speed) if self.begin_s < time_s < self.end_s else 0.0

    def stopped(self, time_s: float) -> Braking:
        """It is braking already."""
        return self


@dataclass(frozen=True)
class CutShort:
    """A profile that runs into a limit at ``cut_s`` and brakes from there."""

    profile: Profile
    cut_s: float

    @property
    def _rest(self) -> Braking:
        return self.profile.stopped(self.cut_s)

    @property
    def end(self) -> float:
        """Where it stands."""
        return self._rest.end

    @property
    def end_s(self) -> float:
        """When it stands."""
        return self._rest.end_s

    def at(self, time_s: float) -> float:
        """Position at ``time_s``."""
        return self.profile.at(time_s) if time_s < self.cut_s else self._rest.at(time_s)

    def speed_at(self, time_s: float) -> float:
        """Speed at ``time_s``, with its sign."""
        return self.profile.speed_at(time_s) if time_s < self.cut_s else self._rest.speed_at(time_s)

    def stopped(self, time_s: float) -> Braking:
        """What becomes of it when told to stop at ``time_s``."""
        return self.profile.stopped(time_s) if time_s < self.cut_s else self._rest


# -- faults on demand: which of an emulator's answers go wrong, and how -----------------------------------------------

#: Of the line: the answer is lost, damaged, late; the port is closed. Of the command: it is damaged before it arrives.
#: Of the machine: a value outside the range, a limit switch that opens.
FAULTS = ("drop", "garble", "stall", "disconnect", "misheard", "over_range", "limit_switch")


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
        unknown = [k for k in self.rates if k not in FAULTS]
        if unknown:
            raise ValueError(f"no fault is called {unknown[0]!r}; expected one of {', '.join(FAULTS)}")
        self._random = random.Random(self.seed)
        self._planned: dict[int, InjectedFault] = {}
        self._count = 0
        self._lock = threading.Lock()

    def schedule(self, kind: str, after: int = 0, seconds: float | None = None) -> None:
        """Lets ``kind`` happen at the answer that comes after the next ``after`` ones."""
        if kind not in FAULTS:
            raise ValueError(f"no fault is called {kind!r}; expected one of {', '.join(FAULTS)}")
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
