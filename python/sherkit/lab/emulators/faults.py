"""Faults on demand: which of an emulator's answers go wrong, and how."""

from __future__ import annotations

import random
import threading
from collections.abc import Mapping
from dataclasses import dataclass, field

#: Of the line: the answer is lost, damaged, late; the port is closed. Of the command: it is damaged before it arrives.
#: Of the machine: a value outside the range, a limit switch that opens.
FAULTS = ("drop", "garble", "stall", "disconnect", "misheard", "over_range", "limit_switch")


@dataclass(frozen=True)
class Fault:
    """A fault of one of the ``FAULTS`` at answer number ``at``; ``seconds`` is how long a stall lasts."""

    kind: str
    at: int
    seconds: float = 0.0


@dataclass
class Faults:
    """Counts an emulator's answers and says which of them go wrong. May be used from several threads.

    ``rates`` are probabilities of each kind for each answer, drawn from ``seed``; ``schedule`` sets single ones.
    ``happened`` is what has been done.
    """

    rates: Mapping[str, float] = field(default_factory=dict)
    seed: int = 0
    stall_s: float = 1.0
    happened: list[Fault] = field(default_factory=list)

    def __post_init__(self) -> None:
        unknown = [k for k in self.rates if k not in FAULTS]
        if unknown:
            raise ValueError(f"no fault is called {unknown[0]!r}; expected one of {', '.join(FAULTS)}")
        self._random = random.Random(self.seed)
        self._planned: dict[int, Fault] = {}
        self._count = 0
        self._lock = threading.Lock()

    def schedule(self, kind: str, after: int = 0, seconds: float | None = None) -> None:
        """Lets ``kind`` happen at the answer that comes after the next ``after`` ones."""
        if kind not in FAULTS:
            raise ValueError(f"no fault is called {kind!r}; expected one of {', '.join(FAULTS)}")
        with self._lock:
            at = self._count + after
            self._planned[at] = Fault(kind, at, self.stall_s if seconds is None else seconds)

    def clear(self) -> None:
        """Lets nothing more go wrong."""
        with self._lock:
            self._planned.clear()
            self.rates = {}

    def take(self) -> Fault | None:
        """The fault of the next answer."""
        with self._lock:
            at = self._count
            self._count += 1
            fault = self._planned.pop(at, None)
            if fault is None and self.rates:
                draw = self._random.random()
                for kind, rate in self.rates.items():
                    if draw < rate:
                        fault = Fault(kind, at, self.stall_s)
                        break
                    draw -= rate
            if fault is not None:
                self.happened.append(fault)
            return fault

    def garbled(self, data: bytes) -> bytes:
        """``data`` as a bad line hands it on: a few bytes changed, lost or added."""
        with self._lock:
            noisy = bytearray(data)
            for _ in range(self._random.randint(1, 3)):
                at = self._random.randrange(len(noisy) + 1)
                how = self._random.random()
                if how < 0.6 and at < len(noisy):
                    noisy[at] ^= 1 << self._random.randrange(8)
                elif how < 0.8:
                    noisy.insert(at, self._random.randrange(256))
                elif at < len(noisy):
                    del noisy[at]
            return bytes(noisy)
