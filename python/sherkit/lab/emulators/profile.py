"""Trapezoids of speed: where an axis is at a time, as motion controllers plan it (SP, AC, DC)."""

from __future__ import annotations

import math
from dataclasses import dataclass


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
