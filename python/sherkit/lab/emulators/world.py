"""The virtual robot's surroundings: a clock, joints that move, and what instruments sense of it."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
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
