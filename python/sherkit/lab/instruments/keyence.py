"""Keyence LK-G5000 controllers with LK-H laser heads, on RS-232C or TCP (the controller's manual, and one driver).

One command at a time, a carriage return both ways, and the reply repeats the command's header. What only one source
says, or only about the older LK-G, is a setting or accepted in every form: ``MM`` and ``MA``, the codes of ``ER``,
``XXXXXXXX`` for "no value", the Ethernet port (24687 or 24685).
"""

from __future__ import annotations

import contextlib
import math
import re
from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass

from ...errors import Disconnected, Garbled, InstrumentError, OutOfRange, Refused
from .base import Identity, Instrument, Reading
from .transport import Transport, deadline_in, now_s

_OUTPUTS = 12
_WIDTH = 8
_VALUE = re.compile(r"[+-](?=\d*\.\d*)[\d.]{7}", re.ASCII)
_FAR = ("+FFFFFFF", "-FFFFFFF")
_NONE = "XXXXXXXX"
_METHODS = ("MS", "MM", "MA")
#: Silence after which nothing of an earlier program is expected on a serial line, s.
_QUIET_S = 0.1


def parse_reply(raw: bytes, command: str) -> tuple[str, ...]:
    """The fields of a reply to ``command`` (as ``MS,01``) after what it repeats of it.

    Raises :class:`~sherkit.errors.Refused` for ``ER``, :class:`~sherkit.errors.Garbled` for anything else.
    """
    if not raw.endswith(b"\r") or not all(0x20 <= b < 0x7F for b in raw[:-1]):
        raise Garbled("expected printable characters and a carriage return", received=raw)
    fields = raw[:-1].decode("ascii").split(",")
    asked = command.split(",")
    if fields[0] == "ER":
        if len(fields) != 3 or fields[1] != asked[0] or not fields[2].isdigit():
            raise Garbled(f"expected ER,{asked[0]} and a code", received=raw)
        raise Refused(f"refused with code {fields[2]} (the manual's list of errors)", int(fields[2]), received=raw)
    if fields[: len(asked)] != asked:
        raise Garbled(f"expected a reply that repeats '{command}'", received=raw)
    return tuple(fields[len(asked) :])


def parse_value(text: str) -> float:
    """A measured value, eight characters, in the controller's unit; NaN for ``XXXXXXXX`` (no value, not yet judged).

    Raises :class:`~sherkit.errors.OutOfRange` for ``±FFFFFFF``, :class:`~sherkit.errors.Garbled` for what is no value.
    """
    received = text.encode("ascii", "replace")
    if text in _FAR:
        side = "above" if text[0] == "+" else "below"
        raise OutOfRange(f"the target is {side} the range of the laser head, or its beam is lost", received=received)
    if text == _NONE:
        return math.nan
    if len(text) != _WIDTH or text.count(".") != 1 or not _VALUE.fullmatch(text):
        raise Garbled("expected a sign and seven digits with a point", received=received)
    return float(text)


@dataclass(eq=False, repr=False)
class Keyence(Instrument):
    """Laser heads on a controller: ``outputs`` (1 to 12) called ``names``, in ``unit`` (as set at the controller).

    ``method``: ``MS`` asks for one output after the other (certain), ``MM`` for all at one moment, ``MA`` for all of
    the controller. ``empty`` makes a head out of range an empty cell (NaN) instead of an error.
    """

    kind = "Keyence"
    default_port = 24687

    outputs: Sequence[int] = (1, 2, 3)
    _: KW_ONLY
    names: Sequence[str] = ()
    unit: str = "mm"
    method: str = "MS"
    empty: bool = False
    timeout_s: float = 1.0

    def __post_init__(self) -> None:
        super().__post_init__()
        self.outputs, self.names = tuple(self.outputs), tuple(self.names)
        rising = tuple(sorted({k for k in self.outputs if 1 <= k <= _OUTPUTS}))
        if not rising or rising != self.outputs:
            raise InstrumentError(f"{self.name}: outputs are {list(self.outputs)}; expected numbers of 1 to 12, rising")
        if self.names and len(self.names) != len(rising):
            raise InstrumentError(f"{self.name}: {len(self.names)} names for {len(rising)} outputs; expected one each")
        if self.method not in _METHODS:
            raise InstrumentError(f"{self.name}: method is '{self.method}'; expected one of {', '.join(_METHODS)}")
        self.names = self.names or tuple(f"out{k}" for k in rising)
        #: Commands whose replies may still come.
        self._owed: list[str] = []

    def identify(self) -> Identity:
        """The controller has no command that names it: the port answers in its form, and how many outputs."""
        self.read_text()
        return Identity(self.kind, f"LK-G5000 series, outputs {', '.join(map(str, self.outputs))}", self.address)

    def read(self) -> Reading:
        """Values of all outputs, in ``unit``.

        Raises :class:`~sherkit.errors.OutOfRange` naming the head, or :class:`~sherkit.errors.Refused` where the
        controller is not measuring.
        """
        texts, time_s = self.read_text()
        values: list[float] = []
        for name, command, text in zip(self.names, self._commands * len(texts), texts, strict=False):
            try:
                value = parse_value(text)
                if math.isnan(value):
                    raise OutOfRange("the controller has no value", received=text.encode())
            except OutOfRange as error:
                if not self.empty:
                    error.message = f"{name}: {error.message}; check the target and that nothing is in the beam"
                    error.complete(instrument=self.name, port=self.address, sent=command.encode() + b"\r")
                    raise
                value = math.nan
            values.append(value)
        return Reading(self.name, tuple(self.names), tuple(values), (self.unit,) * len(values), time_s)

    def read_text(self) -> tuple[tuple[str, ...], float]:
        """The outputs' values as the controller wrote them, and the host's time of the last of them."""
        return self._repeat(self._read_text)

    def set_communication_mode(self) -> None:
        """``Q0``: the controller takes settings and does not measure."""
        self._repeat(lambda: self._ask("Q0"))

    def set_measuring_mode(self) -> None:
        """``R0``: the controller measures."""
        self._repeat(lambda: self._ask("R0"))

    @property
    def _commands(self) -> list[str]:
        """What asks for all outputs, one after the other."""
        if self.method == "MS":
            return [f"MS,{k:02d}" for k in self.outputs]
        chosen = "".join(str(int(k in self.outputs)) for k in range(1, _OUTPUTS + 1))
        return [f"MM,{chosen}" if self.method == "MM" else "MA"]

    def _read_text(self) -> tuple[tuple[str, ...], float]:
        texts = tuple(text for command in self._commands for text in self._checked(command))
        if self.method == "MA":
            texts = tuple(texts[k - 1] for k in self.outputs)
        return texts, self._transport.arrived_s if self._transport is not None else now_s()

    def _checked(self, command: str) -> tuple[str, ...]:
        """The texts of a reply, all of them values."""
        fields, last = self._ask(command), self.outputs[-1]
        least, most = {"MS": (1, 1), "MM": (len(self.outputs),) * 2, "MA": (last, _OUTPUTS)}[self.method]
        try:
            if not least <= len(fields) <= most:
                expected = f"{least}" if least == most else f"{least} to {most}"
                raise Garbled(f"{len(fields)} values; expected {expected}")
            for text in fields:
                with contextlib.suppress(OutOfRange):
                    parse_value(text)
        except Garbled as error:
            self._owed.append(command)
            received = ",".join((command, *fields)).encode() + b"\r"
            raise self.fail(Garbled, error.message, sent=command.encode() + b"\r", received=received) from None
        return fields

    def _ask(self, command: str) -> tuple[str, ...]:
        with self._exchanging(command.encode() + b"\r") as port:
            if self._owed:
                self._synchronise()
            deadline = self._send(port, command)
            try:
                fields = parse_reply(port.read_until(b"\r", deadline), command)
            except Refused:
                self._owed.remove(command)
                raise
            self._owed.remove(command)
            return fields

    def _send(self, port: Transport, command: str) -> float:
        """Sends a command, and returns until when its reply may come."""
        port.drain()
        deadline = deadline_in(self.timeout_s)
        # owed until it has come: also where an interrupt ends the waiting
        self._owed.append(command)
        port.write(command.encode() + b"\r", deadline)
        return deadline

    def _synchronise(self) -> None:
        """Asks for something else than what is owed: once its reply is there, nothing older can still come."""
        candidates = [f"MS,{k:02d}" for k in (*self.outputs, *range(1, _OUTPUTS + 1))] + ["MA"]
        command = next((c for c in candidates if c not in self._owed), "")
        with self._exchanging(command.encode() + b"\r" if command else b"") as port:
            if not command:
                # so much is owed that only silence helps
                port.drain(self.timeout_s)
            else:
                deadline = self._send(port, command)
                while True:
                    with contextlib.suppress(Garbled, Refused):
                        parse_reply(port.read_until(b"\r", deadline), command)
                        break
            self._owed.clear()

    def _greet(self) -> None:
        # a new TCP connection owes nothing; a serial line may, from the program before this one
        with self._exchanging(b"") as port:
            if self.address.startswith("tcp://"):
                self._owed.clear()
            else:
                port.drain(_QUIET_S)
                self._owed = self._owed or ["?"]

    def _recover(self, error: InstrumentError) -> None:
        if isinstance(error, Disconnected):
            super()._recover(error)
