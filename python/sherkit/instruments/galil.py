"""Galil DMC-41x3 and DMC-40x0 motion controllers, on a serial port or TCP (the makers' command references).

A command ends in a carriage return and is answered by ``:``, with data ``…\\r\\n:``, or by a bare ``?``; ``TC1`` then
gives code and text. Baud, hand-shake and TCP port differ between sources, so they are settings.
"""

from __future__ import annotations

import atexit
import itertools
import math
import re
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from ..errors import Disconnected, Garbled, Halted, InstrumentError, OutOfRange, Refused, Timeout
from ..names import listed
from .base import Identity, Instrument, Reading
from .transport import deadline_in

LETTERS = "ABCDEFGH"
#: Meanings of ``SC``.
STOP_CODES = {
    0: "still running",
    1: "stopped at its target",
    2: "stopped by the forward limit switch or soft limit",
    3: "stopped by the reverse limit switch or soft limit",
    4: "stopped by the command ST",
    6: "aborted by an input",
    7: "aborted by the command AB",
    8: "switched off by a position error",
    9: "stopped after finding an edge",
    10: "stopped after homing",
    15: "stopped by an error of the amplifier",
    99: "timed out",
}
_DONE = 1
#: The stop code of a motion that was told to stop.
BY_COMMAND = 4
#: A line that the controller takes.
_LONGEST_LINE = 80
_LARGEST_COUNT = (1 << 31) - 1
_NUMBER = re.compile(r"-?\d{1,10}(\.\d{1,4})?", re.ASCII)
_REFUSAL = re.compile(r" ?(\d{1,3}) ?(.*)", re.ASCII)
_PROMPTS = (b":", b"?")
#: Numbers that mark where answers are in step again; any controller can print them.
_MARKS = itertools.cycle(range(100_000, 999_983, 7))
#: The profile is over, its stop code not yet written: asked again so often.
_SETTLE_POLL_S = 0.02


@dataclass(frozen=True)
class Axis:
    """One motor: its ``letter`` A to H, encoder ``counts_per_unit`` (negative: counts the other way), soft limits.

    A joint stands at ``(counts - zero_counts) / counts_per_unit``, in ``unit``: mm, or rad for one that turns. No
    target outside ``limits`` (low, high), in the same unit, is ever sent. ``name`` is that of the joint, the letter if
    left out.
    """

    letter: str
    counts_per_unit: float
    limits: tuple[float, float]
    zero_counts: int = 0
    name: str = ""
    unit: str = "mm"

    def __post_init__(self) -> None:
        if self.letter not in LETTERS or len(self.letter) != 1:
            raise InstrumentError(f"axis '{self.letter}': expected one letter of {LETTERS}")
        if not (math.isfinite(self.counts_per_unit) and self.counts_per_unit != 0):
            raise InstrumentError(
                f"axis {self.letter}: counts_per_unit is {self.counts_per_unit}; expected a number not 0"
            )
        low, high = self.limits
        if not (math.isfinite(low) and math.isfinite(high) and low < high):
            raise InstrumentError(f"axis {self.letter}: limits are {low}, {high}; expected low, then high")

    @property
    def label(self) -> str:
        """What its values are called."""
        return self.name or self.letter

    def to_counts(self, position: float) -> int:
        """Encoder counts at ``position``."""
        return round(position * self.counts_per_unit) + self.zero_counts

    def to_position(self, counts: float) -> float:
        """Joint position, in its unit, at ``counts``."""
        return (counts - self.zero_counts) / self.counts_per_unit


def parse_answer(raw: bytes) -> str:
    """The data of an answer up to and with its prompt, "" where it is a bare ``:``.

    Bytes with the high bit set are unsolicited text (``CW1``) and left out. Raises
    :class:`~sherkit.errors.Refused` (without a code: ask ``TC1``) for ``?``, :class:`~sherkit.errors.Garbled` else.
    """
    text = bytes(b for b in raw if b < 0x80)
    if text == b"?":
        raise Refused("the command was refused", received=raw)
    if text == b":":
        return ""
    if not text.endswith(b"\r\n:"):
        raise Garbled("expected ':', '?', or data before a line end and ':'", received=raw)
    data = text[:-3]
    if any(b < 0x20 or b == 0x7F for b in data.replace(b"\r\n", b"")):
        raise Garbled("control characters within an answer", received=raw)
    return data.decode("ascii")


def parse_numbers(data: str, count: int) -> tuple[float, ...]:
    """``count`` numbers parted by commas or spaces. Raises :class:`~sherkit.errors.Garbled`."""
    # a comma may have spaces around it, or none: both forms are printed by the same controller
    words = data.replace(",", " ").split(" ")
    words = [w for w in words if w]
    if len(words) != count or not all(_NUMBER.fullmatch(w) for w in words):
        received = data.encode("ascii", "replace")
        raise Garbled(f"expected {count} decimal number{'s' if count > 1 else ''}", received=received)
    return tuple(float(w) for w in words)


def parse_counts(data: str, count: int) -> tuple[int, ...]:
    """``count`` encoder positions: whole numbers of 32 bits. Raises :class:`~sherkit.errors.Garbled`."""
    numbers = parse_numbers(data, count)
    if not all(n == int(n) and abs(n) <= _LARGEST_COUNT + 1 for n in numbers):
        raise Garbled("expected whole numbers of 32 bits", received=data.encode("ascii", "replace"))
    return tuple(int(n) for n in numbers)


def parse_refusal(data: str) -> tuple[int, str]:
    """Code and text of ``TC1``, as ``6 Number out of range``. Raises :class:`~sherkit.errors.Garbled`."""
    match = _REFUSAL.fullmatch(data)
    if match is None:
        raise Garbled("expected a code and its text", received=data.encode("ascii", "replace"))
    return int(match[1]), match[2].strip()


class Galil(Instrument):
    """A motion controller with its axes. Connecting moves nothing and switches no motor on.

    Targets are bounded by each axis' soft limits here and, with ``controller_limits``, by ``FL`` and ``BL`` in the
    controller, which hold when this program dies. A motion is stopped (``ST`` with axes, so that the controller's own
    program goes on) on any error, on Ctrl-C, on ``close`` and at exit; SIGKILL leaves it to the controller's limits.

    ``speed``, per s, and ``acceleration``, per s² (also the deceleration), hold for all axes. A move has arrived when
    the profile is over, its stop code is 1 and the encoder is within ``arrived_within``, for which it has
    ``settle_s``. ``poll_s`` is the pause between two looks at a motion, each of which must be answered in
    ``poll_timeout_s``.
    """

    kind = "Galil"
    default_port = 23

    def __init__(
        self,
        address: str,
        axes: Sequence[Axis],
        *,
        name: str = "",
        speed: float = 5.0,
        acceleration: float = 50.0,
        arrived_within: float = 0.01,
        settle_s: float = 2.0,
        poll_s: float = 0.05,
        poll_timeout_s: float = 0.5,
        stop_timeout_s: float = 5.0,
        controller_limits: bool = True,
        timeout_s: float = 2.0,
        retries: int = 2,
        baud: int = 115200,
    ) -> None:
        super().__init__(address, name=name, timeout_s=timeout_s, retries=retries, baud=baud)
        letters = [a.letter for a in axes]
        if not axes or len(set(letters)) != len(letters):
            raise InstrumentError(f"{self.name}: its axes are {listed(letters) or 'none'}; expected each letter once")
        if len({a.unit for a in axes}) != 1:
            raise InstrumentError(f"{self.name}: its axes have different units; give those a controller of their own")
        for what, value in (("speed", speed), ("acceleration", acceleration)):
            if not (math.isfinite(value) and value > 0):
                raise InstrumentError(f"{self.name}: {what} is {value}; expected a number above zero")
        self.axes = tuple(sorted(axes, key=lambda a: a.letter))
        self.unit = axes[0].unit
        self.speed = speed
        self.acceleration = acceleration
        self.arrived_within = arrived_within
        self.settle_s = settle_s
        self.poll_s = poll_s
        self.poll_timeout_s = poll_timeout_s
        self.stop_timeout_s = stop_timeout_s
        self.controller_limits = controller_limits
        self._in_step = False
        self._prepared = False
        self._moving: set[str] = set()
        #: how often each axis was told to stop: a motion that sees it change was stopped by another thread
        self._stops = dict.fromkeys(letters, 0)

    # --- what every instrument does

    def identify(self) -> Identity:
        """Model and firmware, as the controller's answer to Ctrl-R Ctrl-V; "unknown" where it has none."""
        try:
            text = self._repeat(lambda: self.command("\x12\x16"))
        except Refused:
            text = ""
        return Identity(self.kind, text.strip() or "unknown", self.address)

    def read(self) -> Reading:
        """Encoder positions of all axes, in their unit, in the order of their letters. Also while moving."""
        return self._reading("_TP")

    def read_commanded(self) -> Reading:
        """Where the profiles of all axes are, in their unit (``RP``)."""
        return self._reading("_RP")

    def close(self) -> None:
        """Stops what this program moves, and gives the port back. Raises as :meth:`stop`."""
        with self._lock:
            try:
                if self._moving and self._transport is not None:
                    self.stop()
            finally:
                super().close()

    # --- moving

    def enable(self) -> None:
        """Switches the motors on (``SH``), where they stand. Raises :class:`~sherkit.errors.InstrumentError`."""
        self._repeat(lambda: self._acknowledged(f"SH{self._letters()}"))

    def disable(self) -> None:
        """Switches the motors off (``MO``). An axis that carries weight may fall."""
        self._repeat(lambda: self._acknowledged(f"MO{self._letters()}"))

    def check(self, target: Mapping[str, float] | Sequence[float]) -> dict[str, float]:
        """The target by letters, in their unit. Raises :class:`~sherkit.errors.OutOfRange` outside the soft limits."""
        if isinstance(target, Mapping):
            named = {a.label: a.letter for a in self.axes} | {a.letter: a.letter for a in self.axes}
            unknown = [k for k in target if k not in named]
            if unknown:
                raise InstrumentError(f"has no axis {listed(unknown)}", instrument=self.name, port=self.address)
            targets = {named[k]: float(v) for k, v in target.items()}
        else:
            if len(target) != len(self.axes):
                raise InstrumentError(
                    f"a target of {len(target)} numbers; expected {len(self.axes)}, one for each axis",
                    instrument=self.name,
                    port=self.address,
                )
            targets = {a.letter: float(v) for a, v in zip(self.axes, target, strict=True)}
        for axis in self.axes:
            value = targets.get(axis.letter, axis.limits[0])
            low, high = axis.limits
            if not low <= value <= high:
                raise OutOfRange(
                    f"axis {axis.label} was to go to {value:g} {self.unit}; its soft limits are {low:g} to {high:g}",
                    instrument=self.name,
                    port=self.address,
                )
            if abs(axis.to_counts(value)) > _LARGEST_COUNT:
                raise OutOfRange(
                    f"axis {axis.label}: {value:g} {self.unit} are more counts than the controller has; check "
                    "counts_per_unit",
                    instrument=self.name,
                    port=self.address,
                )
        return targets

    def move(self, target: Mapping[str, float] | Sequence[float]) -> Reading:
        """Moves the named axes (all, by a sequence) to ``target`` and returns where the encoders then are.

        Raises :class:`~sherkit.errors.OutOfRange` before anything moves; :class:`~sherkit.errors.Halted` where the
        motion ended elsewhere (limit switch, ``stop`` by another thread); other
        :class:`~sherkit.errors.InstrumentError` where the line failed. After any of them the axes stand still, or the
        sentence says that they may not.
        """
        targets = self.check(target)
        if not targets:
            return self.read()
        with self._stopping(targets):
            stops = self._start(targets)
            self._wait(targets, stops)
            return self._settled(targets)

    def is_moving(self) -> bool:
        """Whether a profile of any axis is still running."""
        return any(self._repeat(lambda: self._running([a.letter for a in self.axes], self.timeout_s)))

    def stop(self, letters: Iterable[str] | None = None) -> None:
        """Stops the axes (all if left out) with their deceleration, and returns when they stand.

        May be called from any thread. The command is sent again until the controller says that it stands; a lost
        connection is opened again for it. Raises :class:`~sherkit.errors.InstrumentError` where this failed for
        ``stop_timeout_s``: then the axes may still move.
        """
        which = sorted(set(letters)) if letters is not None else [a.letter for a in self.axes]
        if unknown := [x for x in which if x not in self._stops]:
            raise InstrumentError(f"has no axis {listed(unknown)}", instrument=self.name, port=self.address)
        self._brake(which, always=True)

    def _brake(self, which: Sequence[str], always: bool) -> None:
        """Stops the axes; without ``always``, nothing where another thread has done so and closed the port."""
        sent = f"ST{''.join(which)}\r".encode()
        was_closed = self._transport is None
        for letter in which:
            self._stops[letter] += 1
        end = deadline_in(self.stop_timeout_s)
        last: InstrumentError | None = None
        while True:
            try:
                with self._lock:
                    if self._transport is None:
                        if not always and not self._moving & set(which):
                            return
                        self._reopen()
                    with self._exchanging(sent) as port:
                        # at once: what else is on the line is sorted out afterwards
                        self._in_step = False
                        port.write(sent, deadline_in(self.poll_timeout_s))
                    running = self._running(which, self.poll_timeout_s)
                # looked at twice, since a wrong digit must not leave an axis moving
                if not any(running) and not any(self._running(which, self.poll_timeout_s)):
                    self._moving -= set(which)
                    if was_closed:
                        self._shut()
                    return
            except Disconnected as error:
                last = error
                self._shut()
            except (Timeout, Garbled, Refused) as error:
                last = error
            if time.monotonic() > end:
                why = f"; last: {last}" if last else ""
                raise Timeout(
                    f"may still move, not stopped in {self.stop_timeout_s:g} s: use the emergency stop{why}",
                    instrument=self.name,
                    port=self.address,
                    sent=sent,
                )
            time.sleep(min(self.poll_s, 0.05))

    # --- the line

    def command(self, text: str, timeout_s: float | None = None) -> str:
        """Sends one command and returns its data, "" for a bare acknowledgement.

        Nothing is repeated and nothing checked: soft limits hold for :meth:`move` alone. Raises
        :class:`~sherkit.errors.Refused` with the controller's code and text, or Timeout, Garbled, Disconnected.
        """
        if len(text) >= _LONGEST_LINE or not text.isascii() or any(c in text for c in ";\r\n"):
            raise InstrumentError(f"'{text}' is no single command of at most {_LONGEST_LINE - 1} characters")
        limit_s = self.timeout_s if timeout_s is None else timeout_s
        sent = text.encode() + b"\r"
        with self._exchanging(sent) as port:
            if not self._in_step:
                self._synchronise(limit_s)
            # set again at a good end only: an interrupt in between leaves an answer on the line
            self._in_step = False
            deadline = deadline_in(limit_s)
            port.write(sent, deadline)
            try:
                data = parse_answer(port.read_until(_PROMPTS, deadline))
            except Refused as refusal:
                self._in_step = True
                if text == "TC1":
                    raise
                code, why = parse_refusal(self.command("TC1", limit_s))
                raise Refused(f"refused: {code} {why}", code, why, received=refusal.received) from None
            self._in_step = True
            return data

    def _acknowledged(self, text: str, timeout_s: float | None = None) -> None:
        data = self.command(text, timeout_s)
        if data:
            self._in_step = False
            raise Garbled(
                "expected a bare ':'",
                instrument=self.name,
                port=self.address,
                sent=text.encode() + b"\r",
                received=data.encode(),
            )

    def _greet(self) -> None:
        # the echo is on at power-up on serial ports and would look like data
        self._in_step = False
        self._prepared = False
        port = self._transport
        assert port is not None
        with self._exchanging(b"EO 0\r"):
            port.drain()
            # ends whatever an earlier program left half said
            port.write(b"\rEO 0\r", deadline_in(self.timeout_s))
        self._repeat(lambda: self._acknowledged("CW 1"))

    def _synchronise(self, timeout_s: float) -> None:
        """Asks for a number that nothing else can be the answer to, and skips answers until it comes."""
        mark = next(_MARKS)
        sent = f"MG {mark}\r".encode()
        with self._exchanging(sent) as port:
            port.drain()
            deadline = deadline_in(timeout_s)
            port.write(sent, deadline)
            while True:
                raw = port.read_until(_PROMPTS, deadline)
                try:
                    # an echo that is still on repeats the question before its answer
                    data = parse_answer(raw).rpartition("\r\n")[2].rpartition("\r")[2]
                    if parse_numbers(data, 1)[0] == mark:
                        break
                except (Garbled, Refused):
                    continue
            self._in_step = True

    def _recover(self, error: InstrumentError) -> None:
        # a controller that went away may have lost its zero: only connect() may take it up again
        if isinstance(error, Disconnected):
            raise error
        self._in_step = False

    def _operands(self, names: Sequence[str], timeout_s: float) -> list[str]:
        """Values of operands, as printed, in as few lines as they fit in."""
        values: list[str] = []
        rest = list(names)
        while rest:
            count = len(rest)
            while len(line := "MG " + ",".join(rest[:count])) >= _LONGEST_LINE:
                count -= 1
            data = self.command(line, timeout_s)
            try:
                parse_numbers(data, count)
            except Garbled as error:
                self._in_step = False
                error.complete(instrument=self.name, port=self.address, sent=line.encode() + b"\r")
                raise
            values += data.replace(",", " ").split()
            rest = rest[count:]
        return values

    def _counts(self, names: Sequence[str], timeout_s: float) -> tuple[int, ...]:
        values = " ".join(self._operands(names, timeout_s))
        try:
            return parse_counts(values, len(names))
        except Garbled as error:
            self._in_step = False
            error.complete(instrument=self.name, port=self.address, sent=f"MG {','.join(names)}\r".encode())
            raise

    def _reading(self, operand: str) -> Reading:
        def ask() -> Reading:
            counts = self._counts([operand + a.letter for a in self.axes], self.timeout_s)
            port = self._transport
            return Reading(
                self.name,
                tuple(a.label for a in self.axes),
                tuple(a.to_position(c) for a, c in zip(self.axes, counts, strict=True)),
                (self.unit,) * len(self.axes),
                port.arrived_s if port is not None else time.time(),
                {f"counts_{a.letter}": float(c) for a, c in zip(self.axes, counts, strict=True)},
            )

        return self._repeat(ask)

    def _running(self, letters: Sequence[str], timeout_s: float) -> list[bool]:
        flags = self._counts([f"_BG{x}" for x in letters], timeout_s)
        if not all(f in (0, 1) for f in flags):
            self._in_step = False
            raise Garbled(
                f"_BG of {listed(letters)} is {flags}; expected 0 or 1",
                instrument=self.name,
                port=self.address,
                sent=f"MG {','.join(f'_BG{x}' for x in letters)}\r".encode(),
                received=" ".join(map(str, flags)).encode(),
            )
        return [f == 1 for f in flags]

    def _letters(self) -> str:
        return "".join(a.letter for a in self.axes)

    def _axis(self, letter: str) -> Axis:
        return next(a for a in self.axes if a.letter == letter)

    # --- the parts of a move

    def _stopping(self, targets: Mapping[str, float]) -> _StopOnError:
        return _StopOnError(self, frozenset(targets))

    def _listed_values(self, values: Mapping[str, int]) -> str:
        """``400,,500``: left out means unchanged."""
        last = max(LETTERS.index(x) for x in values)
        return ",".join(str(values.get(x, "")) for x in LETTERS[: last + 1])

    def _set(self, command: str, values: Mapping[str, int]) -> None:
        """Sets and asks back. Both change nothing when repeated, so both may be."""
        asked = ",".join("?" if x in values else "" for x in LETTERS[: max(LETTERS.index(x) for x in values) + 1])

        def ask() -> None:
            self._acknowledged(f"{command} {self._listed_values(values)}")
            data = self.command(f"{command} {asked}")
            found = self._parsed_query(data, len(values), f"{command} {asked}")
            # the controller rounds speeds to its own steps, downwards
            slack = 2048 if command in ("AC", "DC") else 2 if command == "SP" else 0
            for (letter, wanted), got in zip(sorted(values.items()), found, strict=True):
                if not wanted - slack <= got <= wanted:
                    self._in_step = False
                    raise Garbled(
                        f"{command}{letter} was set to {wanted} but is {got}",
                        instrument=self.name,
                        port=self.address,
                        sent=f"{command} {asked}\r".encode(),
                        received=data.encode(),
                    )

        self._repeat(ask)

    def _parsed_query(self, data: str, count: int, sent: str) -> tuple[int, ...]:
        try:
            return parse_counts(data, count)
        except Garbled as error:
            self._in_step = False
            error.complete(instrument=self.name, port=self.address, sent=sent.encode() + b"\r")
            raise

    def _prepare(self) -> None:
        if self._prepared:
            return
        speeds: dict[str, int] = {}
        accelerations: dict[str, int] = {}
        forward: dict[str, int] = {}
        reverse: dict[str, int] = {}
        for a in self.axes:
            # even numbers and multiples of 1024 are what the controller has; never faster than asked for
            speeds[a.letter] = max(int(self.speed * abs(a.counts_per_unit)) // 2 * 2, 2)
            accelerations[a.letter] = max(int(self.acceleration * abs(a.counts_per_unit)) // 1024 * 1024, 1024)
            ends = sorted(a.to_counts(v) for v in a.limits)
            reverse[a.letter], forward[a.letter] = max(ends[0], -_LARGEST_COUNT), min(ends[1], _LARGEST_COUNT)
        self._set("SP", speeds)
        self._set("AC", accelerations)
        self._set("DC", accelerations)
        if self.controller_limits:
            self._set("FL", forward)
            self._set("BL", reverse)
        self._prepared = True

    def _start(self, targets: Mapping[str, float]) -> dict[str, int]:
        """Sends and verifies the targets, then begins. Returns how often each axis had been stopped before."""
        with self._lock:
            if self._transport is None:
                raise Disconnected("is not connected; call connect() first", instrument=self.name, port=self.address)
            self._prepare()
            stops = dict(self._stops)
            # asked back before anything moves: a wrong digit must not become a motion
            self._set("PA", {x: self._axis(x).to_counts(v) for x, v in targets.items()})
            self._moving |= set(targets)
            # not repeated: a second BG during motion would be refused
            self._acknowledged(f"BG{''.join(sorted(targets))}", self.poll_timeout_s)
            return stops

    def _wait(self, targets: Mapping[str, float], stops: Mapping[str, int]) -> None:
        """Polls until the profiles are over. Any error ends it: the caller stops the axes."""
        letters = sorted(targets)
        checked: set[str] = set()
        start = time.monotonic()
        longest_s = 5.0 + 2.0 * max(
            (a.limits[1] - a.limits[0]) / self.speed + self.speed / self.acceleration for a in self.axes
        )
        while True:
            if any(self._stops[x] != stops[x] for x in letters):
                raise Halted(
                    f"the motion of {listed(letters)} was stopped from another part of the program",
                    BY_COMMAND,
                    STOP_CODES[BY_COMMAND],
                    instrument=self.name,
                    port=self.address,
                )
            running = self._running(letters, self.poll_timeout_s)
            ended = [x for x, r in zip(letters, running, strict=True) if not r and x not in checked]
            if ended:
                # looked at now, not when the last axis stands: the others must not go on without it
                self._check_ended(ended, targets)
                checked |= set(ended)
            if not any(running):
                break
            if time.monotonic() - start > longest_s:
                raise Timeout(
                    f"{listed(letters)} moved for {longest_s:.0f} s; expected less at {self.speed:g} {self.unit}/s",
                    instrument=self.name,
                    port=self.address,
                )
            time.sleep(self.poll_s)

    def _check_ended(self, letters: Sequence[str], targets: Mapping[str, float]) -> None:
        """Raises :class:`~sherkit.errors.Halted` where a profile that is over did not end at its target."""
        names = [f"_SC{x}" for x in letters] + [f"_RP{x}" for x in letters]
        values: tuple[int, ...] = ()
        for _ in range(5):
            values = self._counts(names, self.poll_timeout_s)
            if 0 not in values[: len(letters)]:
                break
            time.sleep(_SETTLE_POLL_S)
        codes = dict(zip(letters, values, strict=False))
        places = dict(zip(letters, values[len(letters) :], strict=True))
        bad = {x: f"{STOP_CODES.get(c, 'stopped')} (SC {c})" for x, c in codes.items() if c != _DONE}
        for x in letters:
            # an axis that never began has an old code, and an old place
            if x not in bad and places[x] != self._axis(x).to_counts(targets[x]):
                bad[x] = f"stands at {self._axis(x).to_position(places[x]):g} {self.unit}, as if it had not begun"
        if bad:
            where = listed(f"{self._axis(x).label} {why}" for x, why in bad.items())
            code = codes[next(iter(bad))]
            raise Halted(
                f"the motion did not reach its target: {where}",
                code,
                STOP_CODES.get(code, ""),
                instrument=self.name,
                port=self.address,
                sent=f"MG {','.join(names)}\r".encode(),
                received=" ".join(map(str, values)).encode(),
            )

    def _settled(self, targets: Mapping[str, float]) -> Reading:
        end = deadline_in(self.settle_s)
        while True:
            reading = self.read()
            miss = {x: reading[self._axis(x).label] - v for x, v in targets.items()}
            # targets are whole counts: half a count of rounding is no miss
            if all(abs(m) <= self.arrived_within + 0.5 / abs(self._axis(x).counts_per_unit) for x, m in miss.items()):
                self._moving -= set(targets)
                # the axes stand: a second reading costs little, and tells a wrong digit from a position
                return self.read_confirmed(
                    max(self.arrived_within, 2.0 / min(abs(a.counts_per_unit) for a in self.axes))
                )
            if time.monotonic() > end:
                worst = max(miss, key=lambda x: abs(miss[x]))
                axis = self._axis(worst)
                raise Halted(
                    f"axis {axis.label} stands {miss[worst]:+.4f} {self.unit} from its target {targets[worst]:g} after "
                    f"{self.settle_s:g} s; expected within {self.arrived_within:g}",
                    instrument=self.name,
                    port=self.address,
                    sent=f"MG {','.join(f'_TP{a.letter}' for a in self.axes)}\r".encode(),
                    received=" ".join(f"{reading.details[f'counts_{a.letter}']:.0f}" for a in self.axes).encode(),
                )
            time.sleep(_SETTLE_POLL_S)


class _StopOnError:
    """Stops the axes on any way out but the good one, Ctrl-C and ``SystemExit`` among them, and at exit."""

    def __init__(self, galil: Galil, letters: frozenset[str]) -> None:
        self.galil = galil
        self.letters = letters

    def __enter__(self) -> None:
        atexit.register(self._at_exit)

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        atexit.unregister(self._at_exit)
        if error is None or not self.letters & self.galil._moving:
            return
        try:
            self.galil._brake(sorted(self.letters), always=False)
        except InstrumentError as failed:
            if isinstance(error, InstrumentError):
                error.message += f" - and then {failed.message}"
            else:
                error.add_note(str(failed))
        if isinstance(error, Disconnected):
            # the controller may have lost its zero: connect() takes it up again, nothing else
            self.galil._shut()

    def _at_exit(self) -> None:
        # a motion in a thread that nobody waited for
        if self.galil.connected:
            self.galil.stop(self.letters)
