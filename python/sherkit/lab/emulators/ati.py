"""An emulated ATI Net F/T: records over UDP, and its configuration over HTTP."""

from __future__ import annotations

import struct
import time
from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass
from typing import Self

from .server import Emulator, Page
from .world import InjectedFault

_SATURATED = 0x8000_0002
_FULL = (1 << 31) - 1


@dataclass(eq=False, repr=False)
class NetFtEmulator(Emulator):
    """Answers requests for records with the wrench of the world, ``rate_hz`` of them a second.

    ``noise`` is the standard deviation of forces, N, and of torques, Nmm. Of the faults, ``drop``, ``garble``,
    ``stall`` (the record comes after those behind it) and ``over_range`` are those of single records; ``disconnect``
    ends the stream. While it runs, ``page`` is the address of its configuration.
    """

    links = ("udp",)

    _: KW_ONLY
    counts_per_force: float = 1e6
    counts_per_torque: float = 1e6
    rate_hz: float = 1000.0
    noise: float = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        self.sample = 0
        self.offset: Sequence[float] = [0.0] * 6
        self._served: NetFtPage | None = None
        self._whom: tuple[str, int] | None = None
        self._left = self._sequence = 0
        self._due = 0.0
        self._late: list[tuple[float, bytes, tuple[str, int]]] = []

    def start(self) -> Self:
        """Opens the port, and serves the page that says how records are to be read."""
        super().start()
        self._served = NetFtPage(self.world, emulator=self).start()
        self.page = self._served.address
        return self

    def stop(self) -> None:
        """Closes both."""
        if self._served is not None:
            self._served.stop()
            self._served = None
        super().stop()

    def take_command(self, received: bytearray) -> bytes | None:
        """Datagrams are whole."""
        return None

    def answer(self, command: bytes, fault: InjectedFault | None) -> bytes:
        """One record, with the next numbers."""
        self.sample += 1
        self._sequence += 1
        felt = zip(self.world.wrench(), self.offset, strict=True)
        wrench = [w - o + self.random.gauss(0.0, self.noise) for w, o in felt]
        per = [self.counts_per_force] * 3 + [self.counts_per_torque] * 3
        counts = [max(min(round(w * p), _FULL), -_FULL) for w, p in zip(wrench, per, strict=True)]
        over = fault is not None and fault.kind == "over_range"
        if over:
            counts[2] = _FULL
        return struct.pack(">III6i", self._sequence, self.sample, _SATURATED if over else 0, *counts)

    def _datagram(self, data: bytes, where: tuple[str, int]) -> None:
        magic, command, count = struct.unpack(">HHI", data) if len(data) == 8 else (0, 0, 0)
        if magic != 0x1234:
            return
        if command == 0:
            self._whom = None
        elif command in (2, 3):
            self._whom, self._sequence, self._due = where, 0, time.monotonic()
            self._left = count or -1
        elif command == 0x42:
            self.offset = self.world.wrench()

    def tick(self) -> None:
        """Sends the records that are due."""
        assert self._listener is not None
        now = time.monotonic()
        for item in [x for x in self._late if x[0] <= now]:
            self._late.remove(item)
            self._listener.sendto(item[1], item[2])
        while self._whom is not None and self._left and self._due <= now:
            fault = self.faults.take()
            record = self.answer(b"", fault)
            self.log.append((b"", record, fault))
            self._due += 1.0 / self.rate_hz
            self._left -= 1
            kind = fault.kind if fault is not None else ""
            if kind == "disconnect":
                self._whom = None
            elif kind == "stall" and fault is not None:
                self._late.append((now + fault.seconds, record, self._whom))
            elif kind != "drop":
                self._listener.sendto(self.faults.garbled(record) if kind == "garble" else record, self._whom)


@dataclass(eq=False, repr=False)
class NetFtPage(Page):
    """The device's configuration, on this machine alone."""

    path = "/netftapi2.xml"
    content_type = "text/xml"

    _: KW_ONLY
    emulator: NetFtEmulator

    def shown(self) -> bytes:
        """How its counts are to be read."""
        return (
            '<?xml version="1.0" encoding="ISO-8859-1"?>\n<netft>'
            f"<cfgcpf>{self.emulator.counts_per_force:g}</cfgcpf><cfgcpt>{self.emulator.counts_per_torque:g}</cfgcpt>"
            "<scfgfu>N</scfgfu><scfgtu>Nmm</scfgtu></netft>"
        ).encode()
