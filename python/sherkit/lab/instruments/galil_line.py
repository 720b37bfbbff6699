"""The line to a Galil motion controller: what it is told, what its answers mean, and what it says of its axes.

A command ends in a carriage return and is answered by ``:``, with data ``…\\r\\n:``, or by a bare ``?``; ``TC1`` then
gives code and text (the makers' command references).

The controller has no word for "homed". A variable of its own (``zeroed``) does as well: it is set with the zero, and is
gone with it when the power goes, since variables live in the same memory as the positions and are kept only by ``BV``.
A program of the controller that homes by itself can set it, too: ``zeroed=1`` at its end.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Mapping, Sequence

from ...base.figures import listed
from ...errors import Disconnected, Garbled, InstrumentError, Refused
from .base import LETTERS, Axis, AxisController, AxisReference, Identity, Reading
from .transport import deadline_in, now_s

#: The controller's variable that says that its zero was set.
ZEROED = "zeroed"

#: A line that the controller takes.
_LONGEST_LINE = 80
LARGEST_COUNT = (1 << 31) - 1
_NUMBER = re.compile(r"-?\d{1,10}(\.\d{1,4})?", re.ASCII)
_REFUSAL = re.compile(r" ?(\d{1,3}) ?(.*)", re.ASCII)
_PROMPTS = (b":", b"?")
#: Numbers that mark where answers are in step again; any controller can print them.
_MARKS = itertools.cycle(range(100_000, 999_983, 7))
#: By how many counts the controller may round a setting downwards: speeds and accelerations have steps of their own.
_ROUNDED = {"AC": 2048, "DC": 2048, "SP": 2}


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


def parse_galil_numbers(data: str, count: int) -> tuple[float, ...]:
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
    numbers = parse_galil_numbers(data, count)
    if not all(n == int(n) and abs(n) <= LARGEST_COUNT + 1 for n in numbers):
        raise Garbled("expected whole numbers of 32 bits", received=data.encode("ascii", "replace"))
    return tuple(int(n) for n in numbers)


def parse_refusal(data: str) -> tuple[int, str]:
    """Code and text of ``TC1``, as ``6 Number out of range``. Raises :class:`~sherkit.errors.Garbled`."""
    match = _REFUSAL.fullmatch(data)
    if match is None:
        raise Garbled("expected a code and its text", received=data.encode("ascii", "replace"))
    return int(match[1]), match[2].strip()


class GalilLine(AxisController):
    """Commands, operands and settings of a controller, and what it says of its axes. Nothing here begins a motion."""

    default_port = 23
    #: Whether the next answer belongs to the next command.
    _in_step = False

    def identify(self) -> Identity:
        """Model, firmware and serial number, as far as the controller tells; "unknown" where it tells nothing."""

        def answer(command: str, *, is_number: bool) -> str:
            data = self.command(command).strip()
            # a late answer of the other question would make it another instrument
            if data and bool(_NUMBER.fullmatch(data)) is not is_number:
                raise self._garbled(f"expected {'a number' if is_number else 'a name'}", command, data)
            return data

        def asked(command: str, *, is_number: bool) -> str:
            try:
                return self._repeat(lambda: answer(command, is_number=is_number))
            except Refused:
                return ""

        text, number = asked("\x12\x16", is_number=False), asked("MG _BN", is_number=True)
        serial = f"serial number {number.partition('.')[0]}" if number else ""
        return Identity(self.kind, ", ".join(filter(None, (text, serial))) or "unknown", self.address)

    def read(self) -> Reading:
        """Encoder positions of all axes, in their unit, in the order of their letters. Also while moving."""
        return self._reading("_TP")

    def read_commanded(self) -> Reading:
        """Where the profiles of all axes are, in their unit (``RP``)."""
        return self._reading("_RP")

    def reference(self) -> AxisReference:
        """The variable ``zeroed``, encoders, motors, and ``FL`` and ``BL``. Raises as every question."""
        n = len(self.axes)
        values = self._repeat(
            lambda: self._operands([f"_{o}{a.letter}" for o in ("TP", "MO", "FL", "BL") for a in self.axes],
                                   self.timeout_s)
        )  # fmt: skip
        counts, off, forward, reverse = (values[k * n : (k + 1) * n] for k in range(4))
        ours = [(low, high) == self._limits(a) for a, low, high in zip(self.axes, reverse, forward, strict=True)]
        return AxisReference(
            True,
            self._repeat(self._mark),
            tuple(a.to_position(c) for a, c in zip(self.axes, counts, strict=True)),
            tuple(not o for o in off),
            tuple(ours),
        )

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
        """Sends what has no data for an answer."""
        data = self.command(text, timeout_s)
        if data:
            raise self._garbled("expected a bare ':'", text, data)

    def _garbled(self, message: str, sent: str, received: str) -> Garbled:
        """The error, after which answers have to be brought into step again."""
        self._in_step = False
        return self.fail(Garbled, message, sent=sent.encode() + b"\r", received=received.encode())

    def _parsed(self, data: str, count: int, sent: str) -> tuple[int, ...]:
        """The counts of an answer; one that holds none may be that of another command."""
        try:
            return parse_counts(data, count)
        except Garbled as error:
            raise self._garbled(error.message, sent, data) from None

    def _operands(self, names: Sequence[str], timeout_s: float) -> tuple[int, ...]:
        """Values of operands, asked for in as few lines as they fit in."""
        values: list[int] = []
        while rest := names[len(values) :]:
            count = len(rest)
            while len(line := "MG " + ",".join(rest[:count])) >= _LONGEST_LINE:
                count -= 1
            values += self._parsed(self.command(line, timeout_s), count, line)
        return tuple(values)

    def _set(self, command: str, values: Mapping[str, int]) -> None:
        """Sets ``values`` by letter and asks back. Both change nothing when repeated, so both may be."""
        # ``400,,500``: left out means unchanged
        letters = LETTERS[: max(LETTERS.index(x) for x in values) + 1]
        query = f"{command} {','.join('?' if x in values else '' for x in letters)}"

        def ask() -> None:
            self._acknowledged(f"{command} {','.join(str(values.get(x, '')) for x in letters)}")
            data = self.command(query)
            found = self._parsed(data, len(values), query)
            for (letter, wanted), got in zip(sorted(values.items()), found, strict=True):
                if not wanted - _ROUNDED.get(command, 0) <= got <= wanted:
                    raise self._garbled(f"{command}{letter} was set to {wanted} but is {got}", query, data)

        self._repeat(ask)

    def _greet(self) -> None:
        # the echo is on at power-up on serial ports and would look like data
        self._in_step = False
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
                    if parse_galil_numbers(data, 1)[0] == mark:
                        break
                except (Garbled, Refused):
                    continue
            self._in_step = True

    def _recover(self, error: InstrumentError) -> None:
        # a controller that went away may have lost its zero: only connect() may take it up again
        if isinstance(error, Disconnected):
            raise error
        self._in_step = False

    def _mark(self) -> int | None:
        """The variable's value; None where there is none."""
        try:
            data = self.command(f"MG {ZEROED}")
        except Refused:
            return None
        (mark,) = self._parsed(data, 1, f"MG {ZEROED}")
        return mark or None

    def _limits(self, axis: Axis) -> tuple[int, int]:
        """``BL`` and ``FL``, in counts."""
        low, high = sorted(axis.to_counts(v) for v in axis.limits)
        return max(low, -LARGEST_COUNT), min(high, LARGEST_COUNT)

    def _axis(self, letter: str) -> Axis:
        return next(a for a in self.axes if a.letter == letter)

    def _reading(self, operand: str) -> Reading:
        def ask() -> Reading:
            counts = self._operands([operand + a.letter for a in self.axes], self.timeout_s)
            port = self._transport
            return Reading(
                self.name,
                tuple(a.label for a in self.axes),
                tuple(a.to_position(c) for a, c in zip(self.axes, counts, strict=True)),
                (self.unit,) * len(self.axes),
                port.arrived_s if port is not None else now_s(),
                {f"counts_{a.letter}": float(c) for a, c in zip(self.axes, counts, strict=True)},
            )

        return self._repeat(ask)

    def _running(self, letters: Sequence[str], timeout_s: float) -> list[bool]:
        flags = self._operands([f"_BG{x}" for x in letters], timeout_s)
        if not all(f in (0, 1) for f in flags):
            asked = f"MG {','.join(f'_BG{x}' for x in letters)}"
            raise self._garbled(
                f"_BG of {listed(letters)} is {flags}; expected 0 or 1", asked, " ".join(map(str, flags))
            )
        return [f == 1 for f in flags]
