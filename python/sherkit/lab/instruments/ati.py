"""ATI Net F/T force and torque sensors over UDP (RDT, port 49152; the maker's manual of Net F/T).

What the bits of the status word mean, and the older serial box of the Nano17, are uncertain: any bit that is set and
not in ``ignored_status`` makes the record no reading.
"""

from __future__ import annotations

import contextlib
import struct
import urllib.request
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import KW_ONLY, dataclass, field

from ...errors import Disconnected, Garbled, InstrumentError, OutOfRange, Timeout
from .base import Identity, Instrument, Reading
from .transport import UdpPort, deadline_in

_REQUEST = struct.Struct(">HHI")
_RECORD = struct.Struct(">IIIiiiiii")
_MAGIC = 0x1234
_STOP, _REAL_TIME, _BIAS = 0, 2, 0x42
_NAMES = ("fx", "fy", "fz", "tx", "ty", "tz")
_LARGEST_XML = 1 << 18
#: How the page ends the names of the units of force and torque, and what they are where it does not say.
_UNITS = {"fu": "N", "tu": "Nmm"}


@dataclass(frozen=True)
class Record:
    """One record: ``sequence`` of the request, from 1; ``sample`` of the sensor; ``status``; six ``counts``."""

    sequence: int
    sample: int
    status: int
    counts: tuple[int, ...]


@dataclass(frozen=True)
class Scale:
    """Counts per unit of force and of torque, and these units."""

    counts_per_force: float
    counts_per_torque: float
    force_unit: str = "N"
    torque_unit: str = "Nmm"

    def __post_init__(self) -> None:
        for what, value in (("force", self.counts_per_force), ("torque", self.counts_per_torque)):
            # a comparison that NaN fails, too
            if not 0 < value < float("inf"):
                raise InstrumentError(f"counts per {what} are {value}; expected a number above zero (cfgcpf, cfgcpt)")


def parse_record(data: bytes) -> Record:
    """A datagram of 36 bytes. Raises :class:`~sherkit.errors.Garbled`."""
    if len(data) != _RECORD.size:
        raise Garbled(f"a datagram of {len(data)} bytes; expected {_RECORD.size}", received=data)
    sequence, sample, status, *counts = _RECORD.unpack(data)
    return Record(sequence, sample, status, tuple(counts))


def parse_scale(xml: bytes) -> Scale:
    """The scale in ``netftapi2.xml``. Raises :class:`~sherkit.errors.Garbled` where it is not in there."""
    # no document of the device declares entities: one that does is not expanded but refused
    if len(xml) > _LARGEST_XML or b"<!" in xml.replace(b"<!--", b""):
        raise Garbled("expected a short XML file without declarations", received=xml)
    try:
        found = {e.tag: (e.text or "").strip() for e in ET.fromstring(xml).iter()}
        units = [found.get(f"scfg{what}") or found.get(f"cfg{what}") or usual for what, usual in _UNITS.items()]
        return Scale(float(found["cfgcpf"]), float(found["cfgcpt"]), *units)
    except KeyError as error:
        raise Garbled(f"expected the element {error.args[0]}", received=xml) from None
    except (ET.ParseError, ValueError, LookupError, InstrumentError) as error:
        raise Garbled(f"expected numbers cfgcpf and cfgcpt in XML: {error}", received=xml) from None


def fetch_scale(url: str, timeout_s: float = 5.0) -> Scale:
    """The scale as the device shows it at ``http://<address>/netftapi2.xml``.

    Raises :class:`~sherkit.errors.Disconnected` or :class:`~sherkit.errors.Garbled`.
    """
    if not url.startswith("http://"):
        raise InstrumentError(f"'{url}': expected http://<address of the Net F/T>/netftapi2.xml")
    try:
        with urllib.request.urlopen(url, timeout=timeout_s) as answer:
            xml = answer.read(_LARGEST_XML + 1)
    except (OSError, ValueError) as error:
        raise Disconnected(f"cannot be fetched: {error}", instrument="Net F/T", port=url) from None
    try:
        return parse_scale(xml)
    except Garbled as error:
        error.complete(instrument="Net F/T", port=url)
        raise


@dataclass(eq=False, repr=False)
class NetFT(Instrument):
    """A force and torque sensor; ``scale`` from :func:`fetch_scale` or from its calibration sheet.

    ``lost`` and ``reordered`` count the records of :meth:`stream` that did not come, or came late and were left out.
    """

    kind = "Net F/T"
    default_port = 49152

    scale: Scale
    _: KW_ONLY
    ignored_status: int = 0
    timeout_s: float = 0.5
    lost: int = field(default=0, init=False)
    reordered: int = field(default=0, init=False)

    def identify(self) -> Identity:
        """UDP does not name the sensor: that a record comes, and the scale it is read with."""
        self._repeat(lambda: self._records(1))
        s = self.scale
        text = f"{s.counts_per_force:g} counts/{s.force_unit}, {s.counts_per_torque:g} counts/{s.torque_unit}"
        return Identity(self.kind, text, self.address)

    def read(self) -> Reading:
        """One record: fx, fy, fz in the unit of force, tx, ty, tz in that of torque.

        Raises :class:`~sherkit.errors.OutOfRange` where the status says that the record is no reading.
        """
        return self._repeat(lambda: self._records(1)[0])

    def stream(self, count: int) -> Iterator[Reading]:
        """Records as they come, until number ``count`` of the sensor's own counting has come or is lost.

        Raises as :meth:`read`; a record that does not come in time is :class:`~sherkit.errors.Timeout`. No retries.
        """
        # a socket of its own port: records of an older request cannot come here
        self._reopen()
        yield from self._streamed(count)

    def bias(self) -> None:
        """Takes the present load as zero, in the sensor. Not confirmed by it: read afterwards."""
        self._send(_BIAS, 0)

    def close(self) -> None:
        """Stops what is still streaming, and gives the port back."""
        with self._lock:
            if self._transport is not None:
                with contextlib.suppress(Disconnected, Timeout):
                    self._send(_STOP, 0)
            super().close()

    def _open(self) -> UdpPort:
        port = super()._open()
        if not isinstance(port, UdpPort):
            port.close()
            raise InstrumentError(f"'{self.address}': expected udp://host:port", instrument=self.name)
        return port

    def _send(self, command: int, count: int) -> bytes:
        sent = _REQUEST.pack(_MAGIC, command, count)
        with self._exchanging(sent) as port:
            port.write(sent, deadline_in(self.timeout_s))
        return sent

    def _records(self, count: int) -> list[Reading]:
        with self._lock:
            if self._transport is not None:
                self._transport.drain()
            return list(self._streamed(count))

    def _streamed(self, count: int) -> Iterator[Reading]:
        sent = self._send(_REAL_TIME, count)
        seen = 0
        while seen < count:
            with self._exchanging(sent) as port:
                record = parse_record(port.read_exactly(_RECORD.size, deadline_in(self.timeout_s)))
                if not 1 <= record.sequence <= count:
                    raise Garbled(
                        f"record {record.sequence}; expected 1 to {count}", received=record.sequence.to_bytes(4, "big")
                    )
                if record.sequence <= seen:
                    self.reordered += 1
                    # it had been counted as lost when it was overtaken
                    self.lost -= 1
                    continue
                self.lost += record.sequence - seen - 1
                seen = record.sequence
                if record.status & ~self.ignored_status:
                    raise OutOfRange(
                        f"status {record.status:#010x} (0 is a good record); the sensor may be saturated or faulty"
                    )
                arrived_s = port.arrived_s
            yield self._reading(record, arrived_s)

    def _reading(self, record: Record, time_s: float) -> Reading:
        s = self.scale
        per = (s.counts_per_force,) * 3 + (s.counts_per_torque,) * 3
        units = (s.force_unit,) * 3 + (s.torque_unit,) * 3
        details = {"sequence": record.sequence, "sample": record.sample, "lost": self.lost, "reordered": self.reordered}
        values = tuple(c / p for c, p in zip(record.counts, per, strict=True))
        return Reading(self.name, _NAMES, values, units, time_s, {k: float(v) for k, v in details.items()})
