"""Micron Optics' interrogators of fibre gratings: sm130 and x30 (TCP 1852), and Hyperion, their successor (51971).

Layouts from the makers' guides. What is uncertain, the token of streaming data, is not used: peaks are asked for.
"""

from __future__ import annotations

import struct
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from ...base.types import Floats
from ...errors import Garbled, InstrumentError, OutOfRange, Refused
from .base import Identity, Instrument, Reading
from .transport import Transport

_LENGTH_DIGITS = 10
#: Of the x30: peaks on each of four channels; serial number of the sample, µs and s; its own size; units of a nm; the
#: shortest and the longest wavelength.
_X30 = struct.Struct("<16x4H4x3I10xH20xI4x2I")
#: More peaks than any of them finds; a longer answer is garbled.
_MOST_BYTES = 1 << 20
_HYPERION = struct.Struct("<BBHI")
_HYPERION_PEAKS = struct.Struct("<HBBIQII")
#: Gratings reflect in the near infrared; wavelengths far from it are no wavelengths, nm.
_SHORTEST_NM = 100.0
_LONGEST_NM = 10_000.0


@dataclass(frozen=True)
class Peaks:
    """Wavelengths by channel, nm; the instrument's serial number of the sample, and its own clock, s."""

    channels_nm: tuple[tuple[float, ...], ...]
    serial: int
    device_time_s: float


def parse_length(raw: bytes) -> int:
    """Bytes of the payload that follow ten ASCII characters. Raises :class:`~sherkit.errors.Garbled`."""
    text = raw.strip(b" \0")
    if len(raw) != _LENGTH_DIGITS or not text.isdigit() or int(text) > _MOST_BYTES:
        raise Garbled(f"expected ten characters with a length of at most {_MOST_BYTES}", received=raw)
    return int(text)


def parse_peaks(payload: bytes) -> Peaks:
    """The answer to ``#GET_DATA``: 88 bytes of header, then the peaks. Raises :class:`~sherkit.errors.Garbled`."""
    if len(payload) < _X30.size:
        raise Garbled(f"{len(payload)} bytes; expected a header of {_X30.size}", received=payload)
    *counts, serial, micros, seconds, header, granularity, start, end = _X30.unpack_from(payload)
    if header != _X30.size or granularity == 0 or micros >= 1_000_000:
        raise Garbled(
            f"a header of {header} bytes, granularity {granularity}, {micros} µs; expected {_X30.size}, above 0, "
            "below 1000000",
            received=payload,
        )
    if len(payload) != _X30.size + 4 * sum(counts):
        raise Garbled(
            f"{len(payload) - _X30.size} bytes of peaks; expected {4 * sum(counts)} for {sum(counts)} peaks",
            received=payload,
        )
    raw = np.frombuffer(payload, "<u4", offset=_X30.size)
    low, high = (start, end) if start < end else (_SHORTEST_NM * granularity, _LONGEST_NM * granularity)
    nm = raw / granularity
    if not ((raw >= low) & (raw <= high)).all():
        raise Garbled(
            f"wavelengths {nm.tolist()} nm; expected {low / granularity:g} to {high / granularity:g}", received=payload
        )
    return Peaks(_by_channel(nm, counts), serial, seconds + micros * 1e-6)


def _by_channel(nm: Floats, counts: Sequence[int]) -> tuple[tuple[float, ...], ...]:
    parts = np.split(nm, np.cumsum(counts, dtype=int))
    return tuple(tuple(part.tolist()) for part in parts[: len(counts)])


def parse_hyperion_header(raw: bytes) -> tuple[int, int, int]:
    """Status, and the lengths of message and content that follow. Raises :class:`~sherkit.errors.Garbled`."""
    if len(raw) != _HYPERION.size:
        raise Garbled(f"{len(raw)} bytes; expected a header of {_HYPERION.size}", received=raw)
    status, _, message, content = _HYPERION.unpack(raw)
    if content > _MOST_BYTES:
        raise Garbled(f"{content} bytes of content were announced; expected at most {_MOST_BYTES}", received=raw)
    return int(status), int(message), int(content)


def parse_hyperion_peaks(content: bytes) -> Peaks:
    """The answer to ``#GetPeaks``: header with the channels' counts, then float64 nm.

    Raises :class:`~sherkit.errors.Garbled`.
    """
    size = _HYPERION_PEAKS.size
    if len(content) < size:
        raise Garbled(f"{len(content)} bytes; expected a header of {size}", received=content)
    header, _, _, _, serial, seconds, nanos = _HYPERION_PEAKS.unpack_from(content)
    if not size <= header <= len(content) or (header - size) % 2 or nanos >= 1_000_000_000:
        raise Garbled(f"a header of {header} bytes and {nanos} ns make no sense", received=content)
    counts = struct.unpack_from(f"<{(header - size) // 2}h", content, size)
    if min(counts, default=0) < 0 or len(content) != header + 8 * sum(counts):
        raise Garbled(
            f"{len(content) - header} bytes of peaks; expected 8 for each of {sum(counts)} peaks", received=content
        )
    nm = np.frombuffer(content, "<f8", offset=header)
    # NaN fails this comparison, too
    if not ((nm >= _SHORTEST_NM) & (nm <= _LONGEST_NM)).all():
        raise Garbled(f"wavelengths {nm.tolist()} nm; expected {_SHORTEST_NM:g} to {_LONGEST_NM:g}", received=content)
    return Peaks(_by_channel(nm, counts), int(serial), seconds + nanos * 1e-9)


@dataclass(eq=False, repr=False)
class _Interrogator(Instrument):
    """What both have in common: gratings counted by channel, read as nm."""

    gratings: Sequence[int]

    def __post_init__(self) -> None:
        super().__post_init__()
        self.gratings = tuple(self.gratings)
        if not self.gratings or min(self.gratings) < 0 or not sum(self.gratings):
            raise InstrumentError(f"{self.name}: gratings are {self.gratings}; expected their number on each channel")
        self.names = tuple(f"ch{c}_fbg{k}" for c, n in enumerate(self.gratings, 1) for k in range(1, n + 1))

    def read(self) -> Reading:
        """Wavelengths of all gratings, nm, by channel and rising.

        Raises :class:`~sherkit.errors.OutOfRange` where a channel shows another number of peaks than it has gratings:
        which of them is missing cannot be told.
        """
        peaks, time_s = self._repeat(self._peaks)
        channels = [*peaks.channels_nm, *((),) * len(self.gratings)][: len(self.gratings)]
        for c, (expected, found) in enumerate(zip(self.gratings, map(len, channels), strict=True), 1):
            if found != expected:
                raise self.fail(
                    OutOfRange,
                    f"channel {c} shows {found} peaks; expected {expected}; check fibre, connectors and threshold",
                )
        values = tuple(v for channel in channels for v in channel)
        details = {"serial": float(peaks.serial), "device_time_s": peaks.device_time_s}
        return Reading(self.name, self.names, values, ("nm",) * len(values), time_s, details)

    @abstractmethod
    def _peaks(self) -> tuple[Peaks, float]:
        """Peaks of all channels, and the host's time when they arrived, s."""


class Sm130(_Interrogator):
    """An sm130 or another x30; ``gratings`` is their number on each of up to four channels."""

    kind = "Micron Optics x30"
    default_port = 1852

    def identify(self) -> Identity:
        """What it answers to ``#IDN?``."""
        raw, _ = self._repeat(lambda: self._ask(b"#IDN?\n"))
        return Identity(self.kind, raw.decode("ascii", "replace").strip(), self.address)

    def _peaks(self) -> tuple[Peaks, float]:
        sent = b"#GET_DATA\n"
        with self._explained(sent):
            payload, time_s = self._ask(sent)
            return parse_peaks(payload), time_s

    def _ask(self, sent: bytes) -> tuple[bytes, float]:
        return self._exchange(
            sent,
            lambda port, end: port.read_exactly(parse_length(port.read_exactly(_LENGTH_DIGITS, end)), end),
        )


class Hyperion(_Interrogator):
    """A Hyperion (si155, si255); ``gratings`` is their number on each channel."""

    kind = "Micron Optics Hyperion"
    default_port = 51971

    def identify(self) -> Identity:
        """Its name and serial number."""
        asked = [partial(self._ask, command) for command in ("#GetInstrumentName", "#GetSerialNumber")]
        words = [self._repeat(ask)[0].decode("ascii", "replace").strip() for ask in asked]
        return Identity(self.kind, " ".join(words), self.address)

    def _peaks(self) -> tuple[Peaks, float]:
        command = "#GetPeaks"
        with self._explained(command.encode()):
            content, time_s = self._ask(command)
            return parse_hyperion_peaks(content), time_s

    def _ask(self, command: str) -> tuple[bytes, float]:
        text = command.encode()

        def receive(port: Transport, deadline: float) -> bytes:
            raw = port.read_exactly(_HYPERION.size, deadline)
            status, message_bytes, content_bytes = parse_hyperion_header(raw)
            message = port.read_exactly(message_bytes, deadline)
            content = port.read_exactly(content_bytes, deadline)
            if status:
                why = message.decode("ascii", "replace")
                raise Refused(f"refused {command}: {status} {why}", status, why, received=raw + message)
            return content

        return self._exchange(_HYPERION.pack(0, 0, len(text), 0) + text, receive)
