"""An emulated ATI Net F/T: records over UDP, and its configuration over HTTP."""

from __future__ import annotations

import struct
import time
from typing import Any, Self

from .server import Emulator, Page
from .world import InjectedFault, World

_SATURATED = 0x8000_0002
_FULL = (1 << 31) - 1


class NetFtEmulator(Emulator):
    """Answers requests for records with the wrench of the world, ``rate_hz`` of them a second.

    ``noise`` is the standard deviation of forces, N, and of torques, Nmm. Of the faults, ``drop``, ``garble``,
    ``stall`` (the record comes after those behind it) and ``over_range`` are those of single records; ``disconnect``
    ends the stream. While it runs, ``page`` is the address of its configuration.
    """

    links = ("udp",)
    _served: NetFtPage | None = None

    def __init__(
        self,
        world: World,
        *,
        counts_per_force: float = 1e6,
        counts_per_torque: float = 1e6,
        rate_hz: float = 1000.0,
        noise: float = 0.0,
        **line: Any,
    ) -> None:
        super().__init__(world, **line)
        self.counts_per_force = counts_per_force
        self.counts_per_torque = counts_per_torque
        self.rate_hz = rate_hz
        self.noise = noise
        self.sample = 0
        self.offset = [0.0] * 6
        self._whom: tuple[str, int] | None = None
        self._left = 0
        self._sequence = 0
        self._due = 0.0
        self._late: list[tuple[float, bytes, tuple[str, int]]] = []

    def start(self) -> Self:
        """Opens the port, and serves the page that says how records are to be read."""
        super().start()
        self._served = NetFtPage(self).start()
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
        wrench = [
            w - o + self.random.gauss(0.0, self.noise)
            for w, o in zip(self.world.wrench(), self.offset, strict=True)
        ]  # fmt: skip
        per = [self.counts_per_force] * 3 + [self.counts_per_torque] * 3
        counts = [max(min(round(w * p), _FULL), -_FULL) for w, p in zip(wrench, per, strict=True)]
        over = fault is not None and fault.kind == "over_range"
        if over:
            counts[2] = _FULL
        return struct.pack(">III6i", self._sequence, self.sample, _SATURATED if over else 0, *counts)

    def _datagram(self, data: bytes, where: tuple[str, int]) -> None:
        if len(data) != 8:
            return
        magic, command, count = struct.unpack(">HHI", data)
        if magic != 0x1234:
            return
        if command == 0:
            self._whom = None
        elif command in (2, 3):
            self._whom, self._sequence, self._due = where, 0, time.monotonic()
            self._left = count if count else -1
        elif command == 0x42:
            self.offset = list(self.world.wrench())

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


class NetFtPage(Page):
    """The device's configuration, on this machine alone."""

    path = "/netftapi2.xml"
    content_type = "text/xml"

    def __init__(self, emulator: NetFtEmulator) -> None:
        super().__init__(emulator.world)
        self.emulator = emulator

    def shown(self) -> bytes:
        """How its counts are to be read."""
        return (
            '<?xml version="1.0" encoding="ISO-8859-1"?>\n<netft>'
            f"<cfgcpf>{self.emulator.counts_per_force:g}</cfgcpf><cfgcpt>{self.emulator.counts_per_torque:g}</cfgcpt>"
            "<scfgfu>N</scfgfu><scfgtu>Nmm</scfgtu></netft>"
        ).encode()
