"""An emulated Galil DMC-41x3: the commands a measuring program needs, with profiles, limits and its codes."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

from .server import LineEmulator
from .world import Braking, CutShort, InjectedFault, Profile, World

_LETTERS = "ABCDEFGH"
_TEXTS = {
    1: "Unrecognized command",
    5: "Input buffer full",
    6: "Number out of range",
    7: "Command not valid while running",
    20: "Begin not valid with motor off",
    21: "Begin not valid while running",
    22: "Begin not possible due to Limit Switch",
}
_BIGGEST = (1 << 31) - 1
_SETTINGS = {"SP": 25000, "AC": 256000, "DC": 256000, "FL": _BIGGEST, "BL": -_BIGGEST - 1}
_NOT_MOVING = ("PA", "PR", "SH", "MO", "DP", "DE")
_UNSOLICITED = b"INPUT 1 CHANGED: ?\r\n"


class _Error(Exception):
    def __init__(self, code: int) -> None:
        super().__init__(code)
        self.code = code


class _GalilAxis:
    def __init__(self, joint: int, counts_per_unit: float, zero_counts: int, position: float) -> None:
        self.joint = joint
        self.counts_per_unit = counts_per_unit
        self.zero_counts = zero_counts
        counts = position * counts_per_unit + zero_counts
        self.motion: Profile | CutShort | Braking = Braking(counts, 0.0, 1.0, 0.0)
        self.target = round(counts)
        self.settings = dict(_SETTINGS)
        self.motor = True
        #: HM was said: the next BG goes to the home switch
        self.homing = False
        self.code = 1
        #: the switches: the way is free
        self.forward = True
        self.reverse = True


class GalilEmulator(LineEmulator):
    """A controller whose axes A, B, … are the joints of the world, in order.

    ``travel`` (low, high) of each is where its limit switches sit; ``lag_s`` is how far, in the world's time, the
    motor runs behind its profile; ``noise_counts`` the encoder's standard deviation. ``echo`` is on at power-up on a
    pseudo-terminal, as on a serial port. ``chatty`` is the probability of unsolicited text within an answer. ``home``
    is where each home switch sits, for HM. ``variables`` are those of the controller's own programs; it begins as one
    that was zeroed by somebody who noted that in one of them.

    Without power (:meth:`switch_off`) the body stays where it is; counts, variables and settings are lost.
    """

    links = ("pty", "tcp")
    ending = b"\r"
    #: Of the board, _BN.
    serial_number = 4183

    def __init__(
        self,
        world: World,
        counts_per_unit: Sequence[float] | float = 10000.0,
        *,
        zero_counts: Sequence[int] | int = 0,
        travel: Sequence[tuple[float, float]] | None = None,
        lag_s: float = 0.0,
        noise_counts: float = 0.0,
        chatty: float = 0.0,
        home: Sequence[float] | None = None,
        variables: Mapping[str, float] | None = None,
        **line: Any,
    ) -> None:
        super().__init__(world, **line)
        self.home = home
        self.variables = {"zeroed": 1.0} if variables is None else dict(variables)
        n = len(world)
        scales = [counts_per_unit] * n if isinstance(counts_per_unit, int | float) else list(counts_per_unit)
        zeros = [zero_counts] * n if isinstance(zero_counts, int) else list(zero_counts)
        here = world.joints()
        self.axes = {_LETTERS[k]: _GalilAxis(k, scales[k], zeros[k], float(here[k])) for k in range(n)}
        self.travel = travel
        self.lag_s = lag_s
        self.noise_counts = noise_counts
        self.chatty = chatty
        self.echo = self.link == "pty"
        self.high_bit = True
        self.last_error = 0

    def answer(self, command: bytes, fault: InjectedFault | None) -> bytes:
        """One ``:`` or ``?`` for each command of the line."""
        self.tick()
        if fault is not None and fault.kind in ("limit_switch", "over_range"):
            self._hit_limit()
        echoed = command if self.echo else b""
        line = command.rstrip(b"\r").lstrip(b"\n")
        if len(line) > 80:
            self.last_error = 5
            return echoed + b"?"
        out = b""
        for part in line.split(b";"):
            try:
                data = self._do(part.decode("latin-1"))
                out += f"{data}\r\n:".encode("latin-1") if data is not None else b":"
            except _Error as error:
                self.last_error = error.code
                out += b"?"
        return echoed + out

    def interjection(self) -> bytes:
        """Text of the controller's own program, its high bit set after ``CW 1``."""
        if self.random.random() >= self.chatty:
            return b""
        return bytes(b | 0x80 for b in _UNSOLICITED) if self.high_bit else _UNSOLICITED

    def forget(self) -> None:
        """Counts are 0 where the body stands, motors off, settings and variables as when it left the works."""
        now = self.world.now_s()
        for axis in self.axes.values():
            stands = axis.motion.at(now - self.lag_s) - axis.zero_counts
            axis.zero_counts = round(-stands)
            axis.settings = dict(_SETTINGS)
            axis.motor, axis.homing, axis.code, axis.target = False, False, 1, 0
            # what is less than a count is lost, too
            self._set_motion(axis, Braking(stands + axis.zero_counts, 0.0, 1.0, now))
        self.variables.clear()
        self.echo = self.link == "pty"
        self.high_bit = True

    def slip(self, joint: int, by: float) -> None:
        """The encoder of a joint loses ``by``, mm or rad: from now on it says so much more than is true."""

        def lose() -> None:
            axis = self.axes[_LETTERS[joint]]
            axis.zero_counts += round(by * axis.counts_per_unit)
            self._set_motion(axis, Braking(axis.motion.at(self.world.now_s()) + round(by * axis.counts_per_unit),
                                           0.0, 1.0, self.world.now_s()))  # fmt: skip

        self._between(lose)

    # --- motion

    def tick(self) -> None:
        """Writes the stop code of an axis whose profile has ended by itself."""
        now = self.world.now_s()
        for axis in self.axes.values():
            if axis.code != 0:
                continue
            if isinstance(axis.motion, CutShort) and now >= axis.motion.cut_s:
                axis.code = 2 if axis.motion.profile.end > axis.motion.profile.start else 3
                axis.target = round(axis.motion.end)
            elif not self._runs(axis, now):
                axis.code = 1
                if axis.homing:
                    axis.homing, axis.code, axis.target = False, 10, 0
                    axis.zero_counts -= round(axis.motion.at(now))
                    self._set_motion(axis, Braking(0.0, 0.0, 1.0, now))

    def _ends(self, axis: _GalilAxis) -> tuple[float, float]:
        if self.travel is None:
            return -math.inf, math.inf
        ends = sorted(mm * axis.counts_per_unit + axis.zero_counts for mm in self.travel[axis.joint])
        return ends[0], ends[1]

    def _runs(self, axis: _GalilAxis, now: float) -> bool:
        return now < axis.motion.end_s

    def _brake(self, axis: _GalilAxis, now: float, code: int) -> None:
        if self._runs(axis, now) and not isinstance(axis.motion, Braking):
            self._set_motion(axis, axis.motion.stopped(now))
            axis.target = round(axis.motion.end)
            axis.code = code
            axis.homing = False

    def _hit_limit(self) -> None:
        now = self.world.now_s()
        for axis in self.axes.values():
            if self._runs(axis, now):
                self._brake(axis, now, 2 if axis.motion.speed_at(now) >= 0 else 3)

    def _planned(self, axis: _GalilAxis, now: float) -> Profile | CutShort:
        """The way to the target, cut short where a switch or soft limit lies on it."""
        s = axis.settings
        profile = Profile(axis.motion.at(now), axis.target, s["SP"], s["AC"], s["DC"], now)
        low, high = self._ends(axis)
        if axis.homing:
            return profile
        if profile.end > profile.start and profile.end > (limit := min(high, s["FL"])):
            return CutShort(profile, profile.passes_s(limit))
        if profile.end < profile.start and profile.end < (limit := max(low, s["BL"])):
            return CutShort(profile, profile.passes_s(limit))
        return profile

    def _set_motion(self, axis: _GalilAxis, motion: Profile | CutShort | Braking) -> None:
        axis.motion = motion
        scale, zero, lag = axis.counts_per_unit, axis.zero_counts, self.lag_s
        self.world.set_joint(axis.joint, lambda t: (motion.at(t - lag) - zero) / scale)

    def _encoder(self, axis: _GalilAxis) -> int:
        at = axis.motion.at(self.world.now_s() - self.lag_s)
        if self.noise_counts:
            at += self.random.gauss(0.0, self.noise_counts)
        return round(at)

    # --- commands

    def _do(self, text: str) -> str | None:
        text = text.strip(" ")
        if text in ("", "\n"):
            return None
        if text == "\x12\x16":
            return "DMC4183 Rev 1.3a (sherkit emulator)"
        head, rest = text[:2], text[2:].strip(" ")
        if head == "MG":
            return self._message(rest)
        if head == "TC":
            code, self.last_error = self.last_error, 0
            if rest == "1":
                return f"{code} {_TEXTS.get(code, '')}".rstrip() if code else "0"
            return str(code)
        if head in ("EO", "CW"):
            if rest not in ("0", "1", "2"):
                raise _Error(6)
            if head == "EO":
                self.echo = rest == "1"
            else:
                self.high_bit = rest == "1"
            return None
        if (assigned := re.fullmatch(r"([a-z][a-zA-Z0-9]{0,7})=(-?\d{1,10}(?:\.\d{1,4})?)", text)) is not None:
            self.variables[assigned[1]] = float(assigned[2])
            return None
        if head in ("BG", "ST", "SH", "MO", "AB", "HM"):
            self._act(head, rest)
            return None
        if head in ("PA", "PR", "DP", *_SETTINGS):
            return self._values(head, rest)
        if head in ("TP", "RP", "TE", "TD", "TS", "SC") and all(c in self.axes for c in rest):
            return ",".join(f" {self._operand(head, self.axes[x])}" for x in rest or self.axes)
        raise _Error(1)

    def _act(self, head: str, mask: str) -> None:
        if not all(c in self.axes for c in mask):
            raise _Error(1)
        chosen = [self.axes[c] for c in mask or self.axes]
        now = self.world.now_s()
        if head == "HM":
            if self.home is None or any(self._runs(a, now) for a in chosen):
                raise _Error(1 if self.home is None else 7)
            for axis in chosen:
                axis.homing = True
            return
        if head in ("ST", "AB"):
            for axis in chosen:
                self._brake(axis, now, 4 if head == "ST" else 7)
            return
        if head in ("SH", "MO"):
            if any(self._runs(a, now) for a in chosen):
                raise _Error(7)
            for axis in chosen:
                axis.motor = head == "SH"
            return
        for axis in chosen:
            at = axis.motion.at(now)
            if axis.homing:
                axis.target = round(self.home[axis.joint] * axis.counts_per_unit + axis.zero_counts)  # type: ignore[index]
            if not axis.motor:
                raise _Error(20)
            if self._runs(axis, now):
                raise _Error(21)
            low, high = self._ends(axis)
            way = axis.target - at
            if (way > 0 and at >= high) or (way < 0 and at <= low):
                raise _Error(22)
            if (way > 0 and at >= axis.settings["FL"]) or (way < 0 and at <= axis.settings["BL"]):
                raise _Error(22)
        for axis in chosen:
            self._set_motion(axis, self._planned(axis, now))
            axis.code = 0

    def _values(self, head: str, rest: str) -> str | None:
        single = re.fullmatch(r"([A-H])\s*=\s*(\S+)", rest)
        if single:
            words = [""] * _LETTERS.index(single[1]) + [single[2]]
        else:
            words = [w.strip() for w in rest.split(",")]
        asked = [w == "?" for w in words]
        letters = list(self.axes)
        if len(words) > len(letters):
            raise _Error(6)
        if any(asked):
            return ",".join(f" {self._setting(head, self.axes[x])}" for x, a in zip(letters, asked, strict=False) if a)
        chosen: list[tuple[_GalilAxis, int]] = []
        for letter, word in zip(letters, words, strict=False):
            if not word:
                continue
            if not re.fullmatch(r"[+-]?\d{1,12}(\.\d+)?", word):
                raise _Error(1)
            number = int(float(word))
            low = 0 if head in ("SP", "AC", "DC") else -_BIGGEST - 1
            if not low <= number <= _BIGGEST:
                raise _Error(6)
            chosen.append((self.axes[letter], number))
        if not chosen:
            raise _Error(6)
        now = self.world.now_s()
        if head in _NOT_MOVING and any(self._runs(a, now) for a, _ in chosen):
            raise _Error(7)
        for axis, number in chosen:
            if head == "PA":
                axis.target = number
            elif head == "PR":
                axis.target = round(axis.motion.at(now)) + number
            elif head == "DP":
                axis.zero_counts += number - round(axis.motion.at(now))
                self._set_motion(axis, Braking(number, 0.0, 1.0, now))
                axis.target = number
            else:
                step = {"SP": 2, "AC": 1024, "DC": 1024}.get(head, 1)
                axis.settings[head] = max(number // step * step, step if step > 1 else number)
        return None

    def _setting(self, head: str, axis: _GalilAxis) -> int:
        if head in ("PA", "PR"):
            return axis.target
        if head == "DP":
            return self._encoder(axis)
        return axis.settings[head]

    def _message(self, rest: str) -> str:
        words = [w.strip() for w in rest.split(",")]
        out: list[str] = []
        for word in words:
            if re.fullmatch(r"-?\d{1,10}(\.\d+)?", word):
                value = float(word)
            elif re.fullmatch(r'"[^"]*"', word):
                out.append(word[1:-1])
                continue
            elif (m := re.fullmatch(r"_(BG|TP|RP|TE|TD|TS|SC|LF|LR|PA|SP|AC|DC|FL|BL|MO)([A-H])", word)) and (
                m[2] in self.axes
            ):
                value = float(self._operand(m[1], self.axes[m[2]]))
            elif word == "_BN":
                value = float(self.serial_number)
            elif word in self.variables:
                value = self.variables[word]
            else:
                raise _Error(1)
            out.append(f" {value:.4f}")
        return "".join(out)

    def _operand(self, head: str, axis: _GalilAxis) -> int:
        now = self.world.now_s()
        self.tick()
        at = axis.motion.at(now)
        low, high = self._ends(axis)
        running = self._runs(axis, now)
        if head == "BG":
            return int(running)
        if head == "TP":
            return self._encoder(axis)
        if head == "RP":
            return round(at)
        if head == "TE":
            return round(at) - self._encoder(axis)
        if head == "TD":
            return 0
        if head == "SC":
            return axis.code
        if head == "MO":
            return int(not axis.motor)
        if head == "LF":
            return int(at < high)
        if head == "LR":
            return int(at > low)
        if head == "TS":
            bits = (running << 7) | ((not axis.motor) << 5) | ((at < high) << 3) | ((at > low) << 2)
            return bits | 2
        return self._setting(head, axis)
