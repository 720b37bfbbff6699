"""Instruments that speak SCPI (IEEE 488.2): one question, and numbers parted by commas as its answer.

Multimeters, thermometers, laser interferometers and load cells often need no more. Through ``visa://`` they stand at
GPIB or USB, too.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass

from ...errors import Garbled, InstrumentError, OutOfRange, ShapeError
from .base import Identity, Instrument, Reading

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
        words = [""]
    if not all(map(_NUMBER.fullmatch, words)):
        raise Garbled("expected numbers parted by commas", received=raw)
    values = tuple(map(float, words))
    if any(abs(value) >= _INFINITE for value in values):
        raise OutOfRange("has no value: above or below its range, or nothing to measure", received=raw)
    return values


@dataclass(eq=False, repr=False)
class Scpi(Instrument):
    """An instrument that answers ``question`` with a number for each of ``names``, in ``unit``.

    ``question`` changes nothing that a second one would not mend: it is asked again where an answer was lost.
    """

    kind = "SCPI"
    default_port = 5025

    question: str = "READ?"
    _: KW_ONLY
    names: Sequence[str] = ("value",)
    unit: str = "mm"

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (self.question.isascii() and self.question.isprintable() and self.question.endswith("?")):
            raise InstrumentError(
                f"{self.name}: asks '{self.question}'; expected a question of SCPI, which ends in '?'"
            )
        if not self.names:
            raise ShapeError(f"{self.name}: expected a name for each number of the answer")

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
            with self._explained(f"{self.question}\n".encode()):
                values = parse_numbers(raw)
                if len(values) != len(self.names):
                    raise Garbled(f"{len(values)} numbers; expected {len(self.names)}", received=raw)
            return values, time_s

        values, time_s = self._repeat(ask)
        return Reading(self.name, tuple(self.names), values, (self.unit,) * len(values), time_s)

    def _ask(self, question: str) -> tuple[bytes, float]:
        return self._exchange(f"{question}\n".encode("ascii"), lambda port, deadline: port.read_until(b"\n", deadline))
