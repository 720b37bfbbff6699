"""An emulated SCPI instrument: answers ``*IDN?``, and its question with the lasers of the world."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass

from .server import LineEmulator
from .world import InjectedFault


@dataclass(eq=False, repr=False)
class ScpiEmulator(LineEmulator):
    """Reads ``outputs`` of the world's lasers, mm, with a standard deviation of ``noise_mm``, where asked ``question``.

    Whatever it does not know it does not answer, as SCPI wants it.
    """

    links = ("tcp", "pty")
    ending = b"\n"

    _: KW_ONLY
    question: str = "READ?"
    outputs: tuple[int, ...] = (1, 2, 3)
    noise_mm: float = 0.0

    def answer(self, command: bytes, fault: InjectedFault | None) -> bytes:
        """Numbers in the form of a multimeter, or nothing."""
        asked = command.decode("latin-1").strip()
        if asked == "*IDN?":
            return b"SHERKIT,EMULATED,0,1.0\n"
        if asked != self.question:
            return b""
        true = self.world.lasers_mm()
        if fault is not None and fault.kind == "over_range":
            return b",".join([b"+9.90000000E+37"] * len(self.outputs)) + b"\n"
        values = [true[k - 1] + self.random.gauss(0.0, self.noise_mm) for k in self.outputs]
        # NaN where the robot cannot be: SCPI has a number for it
        words = ["+9.91000000E+37" if value != value else f"{value:+.8E}" for value in values]
        return ",".join(words).encode("ascii") + b"\n"
