"""Instruments that speak SCPI (IEEE 488.2): one question, and numbers parted by commas as its answer.

Multimeters, thermometers, laser interferometers and load cells often need no more. Through ``visa://`` they stand at
GPIB or USB, too.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

from ...errors import Garbled, InstrumentError, OutOfRange, ShapeError
from .base import Identity, Instrument, Reading
from .transport import deadline_in

_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?", re.ASCII)
#: SCPI 1999, volume 1, 7.2.1.4 and 5: infinity and "not a number" are numbers beyond any reading.
_INFINITE = 9.9e37
_LONGEST = 200


def parse_numbers(raw: bytes) -> tuple[float, ...]:
    """The numbers of an answer, parted by commas.

    Raises :class:`~sherkit.errors.OutOfRange` for SCPI's infinity and NaN, :class:`~sherkit.errors.Garbled` for what
    is no number.
    """
    try:
        # a space or an end of line may stand about a number, no other sign that Python takes for one
        words = [word.strip(" \t\r\n") for word in raw.decode("ascii").split(",")]
    except UnicodeDecodeError:
        raise Garbled("expected numbers parted by commas", received=raw) from None
    if not all(_NUMBER.fullmatch(word) for word in words):
        raise Garbled("expected numbers parted by commas", received=raw)
    values = tuple(float(word) for word in words)
    if any(abs(value) >= _INFINITE for value in values):
        raise OutOfRange("has no value: above or below its range, or nothing to measure", received=raw)
    if not all(math.isfinite(value) for value in values):
        raise Garbled("expected numbers parted by commas", received=raw)
    return values


class Scpi(Instrument):
    """An instrument that answers ``question`` with a number for each of ``names``, in ``unit``.

    ``question`` changes nothing that a second one would not mend: it is asked again where an answer was lost.
    """

    kind = "SCPI"
    default_port = 5025

    def __init__(
        self,
        address: str,
        question: str = "READ?",
        *,
        names: Sequence[str] = ("value",),
        unit: str = "mm",
        name: str = "",
        timeout_s: float = 2.0,
        retries: int = 2,
        baud: int = 115200,
    ) -> None:
        super().__init__(address, name=name, timeout_s=timeout_s, retries=retries, baud=baud)
        if not (question.isascii() and question.isprintable() and question.endswith("?")):
            raise InstrumentError(f"{self.name}: asks '{question}'; expected a question of SCPI, which ends in '?'")
        if not names:
            raise ShapeError(f"{self.name}: expected a name for each number of the answer")
        self.question = question
        self.names = tuple(names)
        self.unit = unit

    def identify(self) -> Identity:
        """What it answers to ``*IDN?``: maker, model, serial number, version."""
        raw, _ = self._repeat(lambda: self._ask("*IDN?"))
        text = raw.decode("ascii", "replace").strip()
        if not text or len(text) > _LONGEST or not text.isprintable():
            raise self.fail(Garbled, "expected maker, model, serial number and version", sent=b"*IDN?\n", received=raw)
        return Identity(self.kind, text, self.address)

    def read(self) -> Reading:
        """A number for each name, in ``unit``. Raises :class:`~sherkit.errors.InstrumentError` where there is none."""

        def ask() -> tuple[tuple[float, ...], float]:
            raw, time_s = self._ask(self.question)
            try:
                values = parse_numbers(raw)
                if len(values) != len(self.names):
                    raise Garbled(f"{len(values)} numbers; expected {len(self.names)}", received=raw)
            except InstrumentError as error:
                error.complete(instrument=self.name, port=self.address, sent=f"{self.question}\n".encode())
                raise
            return values, time_s

        values, time_s = self._repeat(ask)
        return Reading(self.name, self.names, values, (self.unit,) * len(values), time_s)

    def _ask(self, question: str) -> tuple[bytes, float]:
        sent = f"{question}\n".encode("ascii")
        with self._exchanging(sent) as port:
            deadline = deadline_in(self.timeout_s)
            # nothing may be waiting here: every lost or garbled answer ended with a new connection
            port.drain()
            port.write(sent, deadline)
            raw = port.read_until(b"\n", deadline)
            return raw, port.arrived_s
