"""An emulated Keyence LK-G5000: outputs 1, 2, … are the lasers of the world."""

from __future__ import annotations

import math
import random
from dataclasses import KW_ONLY, dataclass, field

from .server import LineEmulator
from .world import InjectedFault

_OUTPUTS = 12
#: Decimals, mm, to which a place of the joints is the same place.
_SAME_PLACE = 6


@dataclass(eq=False, repr=False)
class KeyenceEmulator(LineEmulator):
    """Answers MS, MM, MA, Q0 and R0.

    ``noise_mm`` is the standard deviation of a value, ``decimals`` the places after its point (eight characters in
    all), ``range_mm`` what a head can see to either side; an output without a laser has no value. With
    ``noise_of_place`` the noise is drawn anew not for each value, but for each place of the joints and the place that
    they came from: a run that was interrupted, and goes on by the same ways, then reads the same.
    """

    links = ("pty", "tcp")
    ending = b"\r"

    _: KW_ONLY
    noise_mm: float = 0.0
    decimals: int = 4
    range_mm: float = 1000.0
    noise_of_place: bool = False
    measuring: bool = field(default=True, init=False)

    def answer(self, command: bytes, fault: InjectedFault | None) -> bytes:
        """The reply, or ER with the command and a code."""
        text = command[:-1].decode("latin-1")
        head, *rest = text.split(",")
        if head in ("Q0", "R0") and not rest:
            self.measuring = head == "R0"
            return command
        if head not in ("MS", "MM", "MA"):
            return self._error(head, 1)
        if not self.measuring:
            return self._error(head, 2)
        values = self._values(fault is not None and fault.kind == "over_range")
        if head == "MA" and not rest:
            return ("MA," + ",".join(values)).encode() + b"\r"
        if len(rest) != 1:
            return self._error(head, 3)
        if head == "MS":
            if len(rest[0]) != 2 or not rest[0].isdigit() or not 1 <= int(rest[0]) <= _OUTPUTS:
                return self._error(head, 4)
            return f"MS,{rest[0]},{values[int(rest[0]) - 1]}\r".encode()
        if len(rest[0]) != _OUTPUTS or set(rest[0]) - {"0", "1"} or "1" not in rest[0]:
            return self._error(head, 4)
        chosen = [v for v, bit in zip(values, rest[0], strict=True) if bit == "1"]
        return f"MM,{rest[0]},{','.join(chosen)}\r".encode()

    def _error(self, head: str, code: int) -> bytes:
        return f"ER,{head[:2]},{code:02d}\r".encode("latin-1", "replace")

    def _values(self, over: bool) -> list[str]:
        true = self.world.lasers_mm()[:_OUTPUTS]
        words: list[str] = []
        for value, noise in zip(true, self._noise(len(true)), strict=True):
            noisy = value + noise
            if over or math.isnan(noisy) or abs(noisy) > self.range_mm:
                words.append("-FFFFFFF" if noisy < 0 else "+FFFFFFF")
            else:
                words.append(self._shown(noisy))
        return words + ["XXXXXXXX"] * (_OUTPUTS - len(words))

    def _noise(self, count: int) -> list[float]:
        source = self.random
        if self.noise_of_place:
            places = [round(float(q), _SAME_PLACE) for q in (*self.world.joints(), *self.world.left())]
            source = random.Random(f"{self.seed} {places}")
        return [source.gauss(0.0, self.noise_mm) for _ in range(count)]

    def _shown(self, value: float) -> str:
        # the point moves where the digits before it need the room
        for decimals in range(self.decimals, -1, -1):
            text = f"{value:+08.{decimals}f}"
            if len(text) == 8:
                return text if "." in text else "+FFFFFFF"
        return "+FFFFFFF" if value > 0 else "-FFFFFFF"
