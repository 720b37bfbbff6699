"""An emulated Galil DMC-41x3: the commands a measuring program needs, with profiles, limits and its codes."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass, field

import numpy as np

from .server import LineEmulator
from .world import InjectedFault, Profile

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
#: What speeds and accelerations are multiples of.
_STEPS = {"SP": 2, "AC": 1024, "DC": 1024}
_NOT_MOVING = ("PA", "PR", "DP")
_OPERANDS = ("BG", "TP", "RP", "TE", "TD", "TS", "SC", "LF", "LR", "PA", "SP", "AC", "DC", "FL", "BL", "MO")
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
        self.motion = Profile.standing(self.to_counts(position))
        self.target = round(self.motion.end)
        self.settings = dict(_SETTINGS)
        self.motor = True
        #: HM was said: the next BG goes to the home switch
        self.homing = False
        #: why it stands; 0 while its profile goes on, or brakes at a limit
        self.code = 1

    def to_counts(self, position: float) -> float:
        return position * self.counts_per_unit + self.zero_counts


@dataclass(eq=False, repr=False)
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

    counts_per_unit: Sequence[float] | float = 10000.0
    _: KW_ONLY
    zero_counts: Sequence[int] | int = 0
    travel: Sequence[tuple[float, float]] | None = None
    lag_s: float = 0.0
    noise_counts: float = 0.0
    chatty: float = 0.0
    home: Sequence[float] | None = None
    variables: dict[str, float] = field(default_factory=lambda: {"zeroed": 1.0})

    def __post_init__(self) -> None:
        super().__post_init__()
        self.variables = dict(self.variables)
        here = self.world.joints()
        scales, zeros = (np.broadcast_to(v, len(here)).tolist() for v in (self.counts_per_unit, self.zero_counts))
        axes = zip(_LETTERS, scales, zeros, here.tolist(), strict=False)
        self.axes = {x: _GalilAxis(k, scale, zero, at) for k, (x, scale, zero, at) in enumerate(axes)}
        self.echo = self.link == "pty"
        self.high_bit = True
        self.last_error = 0

    def answer(self, command: bytes, fault: InjectedFault | None) -> bytes:
        """One ``:`` or ``?`` for each command of the line."""
        self.tick()
        if fault is not None and fault.kind in ("limit_switch", "over_range"):
            for axis in self.axes.values():
                self._brake(axis, 2 if axis.motion.speed_at(self.world.now_s()) >= 0 else 3)
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
            self._set_motion(axis, Profile.standing(stands + axis.zero_counts))
        self.variables.clear()
        self.echo = self.link == "pty"
        self.high_bit = True

    def slip(self, joint: int, by: float) -> None:
        """The encoder of a joint loses ``by``, mm or rad: from now on it says so much more than is true."""

        def lose() -> None:
            axis = self.axes[_LETTERS[joint]]
            counts = round(by * axis.counts_per_unit)
            axis.zero_counts += counts
            self._set_motion(axis, Profile.standing(axis.motion.at(self.world.now_s()) + counts))

        self._between(lose)

    # --- motion

    def tick(self) -> None:
        """Writes the stop code of an axis whose profile has ended by itself."""
        now = self.world.now_s()
        for axis in self.axes.values():
            if axis.code != 0:
                continue
            if now >= axis.motion.cut_s:
                axis.code = 2 if axis.motion.target > axis.motion.start else 3
                axis.target = round(axis.motion.end)
            elif now >= axis.motion.end_s:
                axis.code = 1
                if axis.homing:
                    axis.homing, axis.code, axis.target = False, 10, 0
                    axis.zero_counts -= round(axis.motion.end)
                    self._set_motion(axis, Profile.standing(0.0))

    def _ends(self, axis: _GalilAxis) -> tuple[float, float]:
        """Where its limit switches are, in counts."""
        low, high = sorted(map(axis.to_counts, self.travel[axis.joint] if self.travel else (-math.inf, math.inf)))
        return low, high

    def _runs(self, axis: _GalilAxis) -> bool:
        return self.world.now_s() < axis.motion.end_s

    def _brake(self, axis: _GalilAxis, code: int) -> None:
        if self._runs(axis) and axis.code == 0:
            self._set_motion(axis, axis.motion.stopped(self.world.now_s()))
            axis.target = round(axis.motion.end)
            axis.code = code
            axis.homing = False

    def _planned(self, axis: _GalilAxis) -> Profile:
        """The way to the target, cut short where a switch or soft limit lies on it."""
        s, now = axis.settings, self.world.now_s()
        profile = Profile(axis.motion.at(now), axis.target, s["SP"], s["AC"], s["DC"], now)
        low, high = self._ends(axis)
        if not axis.homing and profile.start < profile.target > (limit := min(high, s["FL"])):
            return profile.stopped_at(limit)
        if not axis.homing and profile.start > profile.target < (limit := max(low, s["BL"])):
            return profile.stopped_at(limit)
        return profile

    def _set_motion(self, axis: _GalilAxis, motion: Profile) -> None:
        axis.motion = motion
        scale, zero, lag = axis.counts_per_unit, axis.zero_counts, self.lag_s
        self.world.set_joint(axis.joint, lambda t: (motion.at(t - lag) - zero) / scale)

    def _encoder(self, axis: _GalilAxis) -> int:
        at = axis.motion.at(self.world.now_s() - self.lag_s)
        return round(at + self.random.gauss(0.0, self.noise_counts))

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
            setattr(self, "echo" if head == "EO" else "high_bit", rest == "1")
            return None
        if (assigned := re.fullmatch(r"([a-z][a-zA-Z0-9]{0,7})=(-?\d{1,10}(?:\.\d{1,4})?)", text)) is not None:
            self.variables[assigned[1]] = float(assigned[2])
            return None
        if head in ("BG", "ST", "SH", "MO", "AB", "HM"):
            if not all(c in self.axes for c in rest):
                raise _Error(1)
            self._act(head, [self.axes[c] for c in rest or self.axes])
            return None
        if head in ("PA", "PR", "DP", *_SETTINGS):
            return self._values(head, rest)
        if head in ("TP", "RP", "TE", "TD", "TS", "SC") and all(c in self.axes for c in rest):
            return ",".join(f" {self._operand(head, self.axes[x])}" for x in rest or self.axes)
        raise _Error(1)

    def _act(self, head: str, chosen: Sequence[_GalilAxis]) -> None:
        if head in ("ST", "AB"):
            for axis in chosen:
                self._brake(axis, 4 if head == "ST" else 7)
        elif head == "BG":
            for axis in chosen:
                self._check_can_begin(axis)
            for axis in chosen:
                self._set_motion(axis, self._planned(axis))
                axis.code = 0
        elif head == "HM" and self.home is None:
            raise _Error(1)
        elif any(map(self._runs, chosen)):
            raise _Error(7)
        else:
            for axis in chosen:
                if head == "HM":
                    axis.homing = True
                else:
                    axis.motor = head == "SH"

    def _check_can_begin(self, axis: _GalilAxis) -> None:
        if axis.homing and self.home is not None:
            axis.target = round(axis.to_counts(self.home[axis.joint]))
        if not axis.motor:
            raise _Error(20)
        if self._runs(axis):
            raise _Error(21)
        at, (low, high) = axis.motion.end, self._ends(axis)
        if axis.target > at >= min(high, axis.settings["FL"]) or axis.target < at <= max(low, axis.settings["BL"]):
            raise _Error(22)

    def _values(self, head: str, rest: str) -> str | None:
        single = re.fullmatch(r"([A-H])\s*=\s*(\S+)", rest)
        words = [w.strip() for w in rest.split(",")]
        if single:
            words = [""] * _LETTERS.index(single[1]) + [single[2]]
        if len(words) > len(self.axes):
            raise _Error(6)
        named = [(axis, word) for axis, word in zip(self.axes.values(), words, strict=False) if word]
        if any(word == "?" for _, word in named):
            return ",".join(f" {self._operand(head, axis)}" for axis, word in named if word == "?")
        if not all(re.fullmatch(r"[+-]?\d{1,12}(\.\d+)?", word) for _, word in named):
            raise _Error(1)
        chosen = [(axis, int(float(word))) for axis, word in named]
        low = 0 if head in _STEPS else -_BIGGEST - 1
        if not chosen or not all(low <= number <= _BIGGEST for _, number in chosen):
            raise _Error(6)
        if head in _NOT_MOVING and any(self._runs(axis) for axis, _ in chosen):
            raise _Error(7)
        for axis, number in chosen:
            if head == "PA":
                axis.target = number
            elif head == "PR":
                axis.target = round(axis.motion.end) + number
            elif head == "DP":
                axis.zero_counts += number - round(axis.motion.end)
                self._set_motion(axis, Profile.standing(number))
                axis.target = number
            else:
                step = _STEPS.get(head)
                axis.settings[head] = number if step is None else max(number // step * step, step)
        return None

    def _message(self, rest: str) -> str:
        out = ""
        for word in map(str.strip, rest.split(",")):
            if re.fullmatch(r'"[^"]*"', word):
                out += word[1:-1]
                continue
            if re.fullmatch(r"-?\d{1,10}(\.\d+)?", word):
                value = float(word)
            elif word[:1] == "_" and word[1:3] in _OPERANDS and word[3:] in self.axes:
                value = float(self._operand(word[1:3], self.axes[word[3:]]))
            elif word == "_BN":
                value = float(self.serial_number)
            elif word in self.variables:
                value = self.variables[word]
            else:
                raise _Error(1)
            out += f" {value:.4f}"
        return out

    def _operand(self, head: str, axis: _GalilAxis) -> int:
        self.tick()
        at = axis.motion.at(self.world.now_s())
        low, high = self._ends(axis)
        match head:
            case "BG":
                return int(self._runs(axis))
            case "TP" | "DP":
                return self._encoder(axis)
            case "RP":
                return round(at)
            case "TE":
                return round(at) - self._encoder(axis)
            case "TD":
                return 0
            case "SC":
                return axis.code
            case "MO":
                return int(not axis.motor)
            case "LF":
                return int(at < high)
            case "LR":
                return int(at > low)
            case "TS":
                return self._runs(axis) << 7 | (not axis.motor) << 5 | (at < high) << 3 | (at > low) << 2 | 2
            case "PA" | "PR":
                return axis.target
        return axis.settings[head]
