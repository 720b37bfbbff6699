"""Emulated interrogators of fibre gratings: an sm130 and a Hyperion, which see the gratings of the world."""

from __future__ import annotations

import struct
from dataclasses import KW_ONLY, dataclass, field

from .server import Emulator, LineEmulator
from .world import InjectedFault


@dataclass(eq=False, repr=False)
class _InterrogatorEmulator(Emulator):
    """``noise_nm`` is the standard deviation of a peak. ``over_range`` loses all peaks, as a broken fibre does."""

    _: KW_ONLY
    noise_nm: float = 0.0
    serial: int = field(default=0, init=False)

    def _peaks_nm(self, fault: InjectedFault | None) -> list[list[float]]:
        self.serial += 1
        channels = self.world.wavelengths_nm()
        if fault is not None and fault.kind == "over_range":
            return [[] for _ in channels]
        return [sorted(v + self.random.gauss(0.0, self.noise_nm) for v in channel) for channel in channels]


class Sm130Emulator(LineEmulator, _InterrogatorEmulator):
    """Answers ``#GET_DATA`` and ``#IDN?`` on TCP, with four channels."""

    ending = b"\n"
    granularity = 1_000_000

    def answer(self, command: bytes, fault: InjectedFault | None) -> bytes:
        """Ten characters with the length, then the payload."""
        if command == b"#GET_DATA\n":
            payload = self._payload(self._peaks_nm(fault))
        elif command == b"#IDN?\n":
            payload = b"SM130 Rev 1.0, sherkit emulator"
        else:
            payload = b"ERROR: unknown command"
        return f"{len(payload):010d}".encode() + payload

    def _payload(self, channels: list[list[float]]) -> bytes:
        channels = [*channels, [], [], [], []][:4]
        now, unit = self.world.now_s(), self.granularity
        clock = self.serial & 0xFFFFFFFF, int(now % 1 * 1e6), int(now)
        header = struct.pack("<16x4H4x3I10xH20xI4x2I", *map(len, channels), *clock, 88, unit, 1510 * unit, 1590 * unit)
        raw = [round(v * unit) for channel in channels for v in channel]
        return header + struct.pack(f"<{len(raw)}I", *raw)


class HyperionEmulator(_InterrogatorEmulator):
    """Answers ``#GetPeaks``, ``#GetInstrumentName`` and ``#GetSerialNumber`` on TCP."""

    def take_command(self, received: bytearray) -> bytes | None:
        """A header of eight bytes, then command and argument of the lengths in it."""
        if len(received) < 8:
            return None
        _, _, command, argument = struct.unpack_from("<BBHI", received)
        size = 8 + command + argument
        if size > 4096:
            received.clear()
        if len(received) < size:
            return None
        whole = bytes(received[:size])
        del received[:size]
        return whole

    def _misheard(self, command: bytes) -> bytes:
        # the lengths survive: with wrong ones the line would wait for bytes that never come
        heard = bytearray(command)
        heard[8 + self.random.randrange(len(heard) - 8)] ^= 1 << self.random.randrange(7)
        return bytes(heard)

    def answer(self, command: bytes, fault: InjectedFault | None) -> bytes:
        """A header of eight bytes, a message, the content."""
        _, _, size, _ = struct.unpack_from("<BBHI", command)
        name = command[8 : 8 + size]
        if name == b"#GetPeaks":
            return self._packed(0, b"", self._content(self._peaks_nm(fault)))
        said = {b"#GetInstrumentName": b"si255 (sherkit emulator)", b"#GetSerialNumber": b"HIA000"}
        if name in said:
            return self._packed(0, b"", said[name])
        return self._packed(1, b"Unknown command", b"")

    def _packed(self, status: int, message: bytes, content: bytes) -> bytes:
        return struct.pack("<BBHI", status, 0, len(message), len(content)) + message + content

    def _content(self, channels: list[list[float]]) -> bytes:
        now = self.world.now_s()
        size = 24 + 2 * len(channels)
        nanos = int(now % 1 * 1e9)
        header = struct.pack("<HBBIQII", size, 0, 1, 0, self.serial, int(now), nanos)
        counts = struct.pack(f"<{len(channels)}h", *(len(c) for c in channels))
        nm = [v for channel in channels for v in channel]
        return header + counts + struct.pack(f"<{len(nm)}d", *nm)
