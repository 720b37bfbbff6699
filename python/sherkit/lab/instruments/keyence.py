"""Keyence LK-G5000 controllers with LK-H laser heads, on RS-232C or TCP (the controller's manual, and one driver).

One command at a time, a carriage return both ways, and the reply repeats the command's header. What only one source
says, or only about the older LK-G, is a setting or accepted in every form: ``MM`` and ``MA``, the codes of ``ER``,
``XXXXXXXX`` for "no value", the Ethernet port (24687 or 24685).
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

from ...errors import Disconnected, Garbled, InstrumentError, OutOfRange, Refused, Timeout
from .base import Identity, Instrument, Reading
from .transport import deadline_in, now_s

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


class Keyence(Instrument):
    """Laser heads on a controller: ``outputs`` (1 to 12) called ``names``, in ``unit`` (as set at the controller).

    ``method``: ``MS`` asks for one output after the other (certain), ``MM`` for all at one moment, ``MA`` for all of
    the controller. ``empty`` makes a head out of range an empty cell (NaN) instead of an error.
    """

    kind = "Keyence"
    default_port = 24687

    def __init__(
        self,
        address: str,
        outputs: Sequence[int] = (1, 2, 3),
        *,
        names: Sequence[str] = (),
        unit: str = "mm",
        method: str = "MS",
        empty: bool = False,
        name: str = "",
        timeout_s: float = 1.0,
        retries: int = 2,
        baud: int = 115200,
    ) -> None:
        super().__init__(address, name=name, timeout_s=timeout_s, retries=retries, baud=baud)
        if not outputs or not all(1 <= k <= _OUTPUTS for k in outputs) or sorted(set(outputs)) != list(outputs):
            raise InstrumentError(f"{self.name}: outputs are {list(outputs)}; expected numbers of 1 to 12, rising")
        if names and len(names) != len(outputs):
            raise InstrumentError(f"{self.name}: {len(names)} names for {len(outputs)} outputs; expected one each")
        if method not in _METHODS:
            raise InstrumentError(f"{self.name}: method is '{method}'; expected one of {', '.join(_METHODS)}")
        self.outputs = tuple(outputs)
        self.names = tuple(names) or tuple(f"out{k}" for k in outputs)
        self.unit = unit
        self.method = method
        self.empty = empty
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
        for output, name, text in zip(self.outputs, self.names, texts, strict=True):
            try:
                value = parse_value(text)
                if math.isnan(value) and not self.empty:
                    raise OutOfRange("the controller has no value", received=text.encode())
            except OutOfRange as error:
                if not self.empty:
                    error.message = f"{name}: {error.message}; check the target and that nothing is in the beam"
                    sent = f"MS,{output:02d}" if self.method == "MS" else self._command()
                    error.complete(instrument=self.name, port=self.address, sent=sent.encode() + b"\r")
                    raise
                value = math.nan
            values.append(value)
        return Reading(self.name, self.names, tuple(values), (self.unit,) * len(values), time_s)

    def read_text(self) -> tuple[tuple[str, ...], float]:
        """The outputs' values as the controller wrote them, and the host's time of the last of them."""
        return self._repeat(self._read_text)

    def set_communication_mode(self) -> None:
        """``Q0``: the controller takes settings and does not measure."""
        self._repeat(lambda: self._ask("Q0"))

    def set_measuring_mode(self) -> None:
        """``R0``: the controller measures."""
        self._repeat(lambda: self._ask("R0"))

    def _command(self) -> str:
        if self.method == "MM":
            return "MM," + "".join("1" if k in self.outputs else "0" for k in range(1, _OUTPUTS + 1))
        return "MA" if self.method == "MA" else f"MS,{self.outputs[0]:02d}"

    def _read_text(self) -> tuple[tuple[str, ...], float]:
        texts: tuple[str, ...]
        if self.method == "MS":
            texts = tuple(self._checked(f"MS,{k:02d}", 1)[0] for k in self.outputs)
        elif self.method == "MM":
            texts = self._checked(self._command(), len(self.outputs))
        else:
            every = self._checked("MA", None)
            texts = tuple(every[k - 1] for k in self.outputs)
        return texts, self._transport.arrived_s if self._transport is not None else now_s()

    def _checked(self, command: str, count: int | None) -> tuple[str, ...]:
        fields = self._ask(command)
        fault = ""
        if (len(fields) != count) if count is not None else not self.outputs[-1] <= len(fields) <= _OUTPUTS:
            fault = f"{len(fields)} values; expected {count if count is not None else f'{self.outputs[-1]} to 12'}"
        else:
            for text in fields:
                try:
                    parse_value(text)
                except OutOfRange:
                    continue
                except Garbled as error:
                    fault = error.message
        if fault:
            self._owed.append(command)
            received = ",".join((command, *fields)).encode() + b"\r"
            raise self.fail(Garbled, fault, sent=command.encode() + b"\r", received=received)
        return fields

    def _ask(self, command: str) -> tuple[str, ...]:
        sent = command.encode() + b"\r"
        with self._exchanging(sent) as port:
            if self._owed:
                self._synchronise()
            port.drain()
            deadline = deadline_in(self.timeout_s)
            # owed until it has come: also where an interrupt ends the waiting
            self._owed.append(command)
            port.write(sent, deadline)
            try:
                fields = parse_reply(port.read_until(b"\r", deadline), command)
            except Refused:
                self._owed.remove(command)
                raise
            self._owed.remove(command)
            return fields

    def _synchronise(self) -> None:
        """Asks for something else than what is owed: once its reply is there, nothing older can still come."""
        candidates = [f"MS,{k:02d}" for k in (*self.outputs, *range(1, _OUTPUTS + 1))] + ["MA"]
        command = next((c for c in candidates if c not in self._owed), None)
        if command is None:
            # so much is owed that only silence helps
            with self._exchanging(b"") as port:
                port.drain(self.timeout_s)
            self._owed.clear()
            return
        sent = command.encode() + b"\r"
        with self._exchanging(sent) as port:
            port.drain()
            deadline = deadline_in(self.timeout_s)
            self._owed.append(command)
            port.write(sent, deadline)
            while True:
                try:
                    parse_reply(port.read_until(b"\r", deadline), command)
                except (Garbled, Refused):
                    continue
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
        else:
            assert isinstance(error, Timeout | Garbled)
