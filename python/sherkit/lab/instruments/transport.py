"""Bytes to and from an instrument: ports of pyserial, TCP, UDP and VISA behind one small interface.

Answers arrive in pieces, late, or with other text in between. Whatever arrived is kept in a bounded buffer, so that a
reader never depends on how the bytes were cut; no call outlasts its deadline, a value of ``time.monotonic()``, s.

TCP is not left to pyserial's ``socket://`` (3.5): each close sleeps for 0.3 s, in which an axis that is to be stopped
by a new connection goes on; a connection that the other end has reset is never closed; for somebody to answer, five
seconds are waited whatever the limit; and instruments at TCP would need the extra ``lab``.
"""

from __future__ import annotations

import contextlib
import select
import socket
import time
from abc import ABC, abstractmethod
from typing import Any

from ...errors import Disconnected, Garbled, InstrumentError, Timeout

#: Bytes that may wait to be read before the stream counts as garbled.
LARGEST_BUFFER = 1 << 20
_PIECE = 1 << 16
#: One look for bytes at a serial port takes no longer, s.
_LOOK_S = 0.01
#: A device that never falls silent is drained for this long, s.
_LONGEST_DRAIN_S = 2.0
_VISA = "visa://"
#: URLs that are left to pyserial. Others of it are none: an address stands in files of other people, and
#: ``spy://port?file=…`` empties any file.
_BY_PYSERIAL = ("rfc2217://", "hwgrep://")
_EXPECTED = (
    "expected tcp://host:port, udp://host:port, rfc2217://host:port, hwgrep://adapter, visa://resource or a serial port"
)
_WALL_S = time.time()
_STEADY_S = time.monotonic()


def now_s() -> float:
    """The host's time, as readings and rows carry it: seconds since 1970, by the wall clock as it was when the program
    began, counted on by the monotonic clock.

    A wall clock that is set while a run goes on does not reach the rows.
    """
    return _WALL_S + (time.monotonic() - _STEADY_S)


def wall_ahead_s() -> float:
    """By how much the wall clock has been set forward since the program began, s; negative: back."""
    return time.time() - now_s()


def deadline_in(timeout_s: float) -> float:
    """The deadline that lies ``timeout_s`` ahead, on the clock of ``time.monotonic()``."""
    return time.monotonic() + timeout_s


class Transport(ABC):
    """An open port. ``name`` is for sentences; ``arrived_s`` is the host's time (s since 1970) of the last bytes."""

    def __init__(self, name: str, largest_buffer: int = LARGEST_BUFFER) -> None:
        self.name = name
        self.arrived_s = float("nan")
        self._buffer = bytearray()
        self._largest = largest_buffer
        self._open = True

    @abstractmethod
    def _send(self, data: bytes, timeout_s: float) -> None:
        """Sends all of ``data``."""

    @abstractmethod
    def _receive(self, timeout_s: float) -> bytes:
        """What has arrived, as soon as there is anything; empty after ``timeout_s``."""

    @abstractmethod
    def _close(self) -> None:
        """Gives the port back."""

    def write(self, data: bytes, deadline: float) -> None:
        """Sends ``data``. Raises :class:`~sherkit.errors.Timeout` or :class:`~sherkit.errors.Disconnected`."""
        self._check_open()
        try:
            self._send(data, max(deadline - time.monotonic(), 0.001))
        except TimeoutError:
            raise Timeout("the port took no more bytes in time", port=self.name, sent=data) from None
        except OSError as error:
            raise self._gone(error, data) from None

    def read_until(self, terminators: bytes | tuple[bytes, ...], deadline: float) -> bytes:
        """The bytes up to and with the first of ``terminators``; what follows is kept for the next call.

        Raises :class:`~sherkit.errors.Timeout`, :class:`~sherkit.errors.Disconnected`, or
        :class:`~sherkit.errors.Garbled` where the buffer fills up without one.
        """
        ends = (terminators,) if isinstance(terminators, bytes) else terminators
        longest = max(len(t) for t in ends)
        searched = 0
        while True:
            found = [(at, len(t)) for t in ends if (at := self._buffer.find(t, searched)) >= 0]
            if found:
                at, length = min(found)
                return self._take(at + length)
            searched = max(len(self._buffer) - longest + 1, 0)
            self._more(deadline, f"expected an answer that ends in {' or '.join(repr(t) for t in ends)}")

    def read_exactly(self, count: int, deadline: float) -> bytes:
        """The next ``count`` bytes. Raises as :meth:`read_until`."""
        if count > self._largest:
            raise Garbled(f"an answer of {count} bytes was announced; expected at most {self._largest}", port=self.name)
        while len(self._buffer) < count:
            self._more(deadline, f"expected {count} bytes")
        return self._take(count)

    def drain(self, quiet_s: float = 0.0) -> bytes:
        """Throws away, and returns, what arrives until nothing came for ``quiet_s``; ends after two seconds at most."""
        self._check_open()
        dropped = self._take(len(self._buffer))
        end = deadline_in(max(_LONGEST_DRAIN_S, quiet_s))
        while time.monotonic() < end and (piece := self._arriving(quiet_s)):
            # the beginning is enough for a sentence
            dropped = (dropped + piece)[: self._largest]
        return dropped

    def close(self) -> None:
        """Gives the port back; twice does no harm."""
        if self._open:
            self._open = False
            with contextlib.suppress(OSError):
                self._close()

    def _more(self, deadline: float, expected: str) -> None:
        self._check_open()
        remaining_s = deadline - time.monotonic()
        # one last look at what has already arrived, so that a busy host does not turn answers into time-outs
        piece = self._arriving(max(remaining_s, 0.0))
        if not piece and deadline <= time.monotonic():
            raise Timeout(f"no whole answer in time; {expected}", port=self.name, received=bytes(self._buffer))
        self._buffer += piece
        if len(self._buffer) > self._largest:
            received = self._take(len(self._buffer))
            raise Garbled(f"{len(received)} bytes without an end; {expected}", port=self.name, received=received)

    def _arriving(self, timeout_s: float) -> bytes:
        try:
            piece = self._receive(timeout_s)
        except OSError as error:
            raise self._gone(error) from None
        if piece:
            self.arrived_s = now_s()
        return piece

    def _take(self, count: int) -> bytes:
        taken = bytes(self._buffer[:count])
        del self._buffer[:count]
        return taken

    def _check_open(self) -> None:
        if not self._open:
            raise Disconnected("the port was closed; connect again", port=self.name)

    def _gone(self, error: OSError, sent: bytes = b"") -> Disconnected:
        why = error.strerror or str(error) or "closed by the other end"
        return Disconnected(
            f"the connection was lost ({why}); check cable, power and whether another program uses the port",
            port=self.name,
            sent=sent,
            received=bytes(self._buffer),
        )


class SerialPort(Transport):
    """A serial port of this machine, or by a URL of pyserial, 8N1 without flow control.

    Raises :class:`~sherkit.errors.Disconnected`.
    """

    def __init__(self, path: str, baud: int = 115200) -> None:
        super().__init__(path)
        try:
            import serial
        except ImportError:
            raise InstrumentError('serial ports need pyserial: pip install "sherkit[lab]"', port=path) from None
        try:
            # exclusive: a second program on the same motors would be worse than an error
            self._serial: Any = serial.serial_for_url(path, baud, timeout=_LOOK_S, exclusive=True)
        except (OSError, ValueError) as error:
            raise Disconnected(f"cannot be opened: {error}; check cable, name and permission", port=path) from None
        self._too_slow: type[OSError] = serial.SerialTimeoutException
        # USB adapters otherwise hold each answer back for up to 16 ms; other ports do not know the call
        with contextlib.suppress(OSError, ValueError, AttributeError, NotImplementedError):
            self._serial.set_low_latency_mode(True)

    def _send(self, data: bytes, timeout_s: float) -> None:
        # what has no such limit (rfc2217://) says so
        with contextlib.suppress(NotImplementedError):
            self._serial.write_timeout = timeout_s
        try:
            self._serial.write(data)
        except self._too_slow:
            raise TimeoutError from None

    def _receive(self, timeout_s: float) -> bytes:
        # in short looks: another limit is another setting, about which rfc2217:// asks the other end
        end, piece = deadline_in(timeout_s), b""
        while not piece and time.monotonic() < end:
            piece = bytes(self._serial.read(1))
        # the rest is there already: it must not wait for another byte
        if waiting := self._serial.in_waiting:
            piece += bytes(self._serial.read(min(waiting, _PIECE)))
        return piece

    def _close(self) -> None:
        self._serial.close()


class _SocketPort(Transport):
    """What ports of sockets share."""

    _socket: socket.socket

    def _send(self, data: bytes, timeout_s: float) -> None:
        self._socket.settimeout(timeout_s)
        self._socket.sendall(data)

    def _receive(self, timeout_s: float) -> bytes:
        if not select.select([self._socket], [], [], timeout_s)[0]:
            return b""
        return self._received()

    def _received(self) -> bytes:
        return self._socket.recv(_PIECE)

    def _close(self) -> None:
        self._socket.close()


class TcpPort(_SocketPort):
    """A TCP connection. Raises :class:`~sherkit.errors.Disconnected` where nobody answers within ``timeout_s``."""

    def __init__(self, host: str, port: int, timeout_s: float = 5.0) -> None:
        super().__init__(f"tcp://{host}:{port}")
        try:
            self._socket = socket.create_connection((host, port), timeout=timeout_s)
        except OSError as error:
            why = error.strerror or str(error) or type(error).__name__
            raise Disconnected(
                f"cannot be reached ({why}); check that it is switched on and that address and port are right",
                port=self.name,
            ) from None
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)

    def _received(self) -> bytes:
        if piece := super()._received():
            return piece
        raise ConnectionResetError("closed by the other end")


class UdpPort(_SocketPort):
    """Datagrams to and from one address. A read never joins two of them: each must be what was asked for.

    ``read_exactly`` raises :class:`~sherkit.errors.Garbled` for a datagram of another length, ``read_until`` for one
    with another end.
    """

    def __init__(self, host: str, port: int) -> None:
        super().__init__(f"udp://{host}:{port}")
        try:
            family, kind, protocol, _, where = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
            self._socket = socket.socket(family, kind, protocol)
            with contextlib.ExitStack() as failing:
                failing.callback(self._close)
                # connected: datagrams from anybody else are dropped by the system
                self._socket.connect(where)
                failing.pop_all()
        except OSError as error:
            raise Disconnected(f"cannot be reached ({error.strerror or error})", port=self.name) from None

    def read_datagram(self, deadline: float) -> bytes:
        """The next datagram, whole. Raises :class:`~sherkit.errors.Timeout` or Disconnected."""
        self._check_open()
        piece = self._arriving(max(deadline - time.monotonic(), 0.0))
        if not piece:
            raise Timeout("no datagram in time", port=self.name)
        return piece

    def read_exactly(self, count: int, deadline: float) -> bytes:
        """The next datagram, of ``count`` bytes."""
        data = self.read_datagram(deadline)
        if len(data) != count:
            raise Garbled(f"a datagram of {len(data)} bytes; expected {count}", port=self.name, received=data)
        return data

    def read_until(self, terminators: bytes | tuple[bytes, ...], deadline: float) -> bytes:
        """The next datagram, which ends in one of ``terminators``."""
        data = self.read_datagram(deadline)
        if not data.endswith(terminators):
            raise Garbled(f"a datagram that does not end in {terminators!r}", port=self.name, received=data)
        return data


class VisaPort(Transport):
    """Bytes to and from a VISA resource. Raises :class:`~sherkit.errors.Disconnected` where it cannot be opened."""

    def __init__(self, address: str, baud: int = 115200, timeout_s: float = 5.0) -> None:
        super().__init__(address)
        try:
            import pyvisa
        except ImportError:
            raise InstrumentError('visa:// needs pyvisa: pip install "sherkit[visa]"', port=address) from None
        resource, _, library = address.removeprefix(_VISA).partition("@")
        if library and "@" not in library:
            library = f"@{library}"
        self._lost: type[Exception] = pyvisa.errors.VisaIOError
        self._no_answer: int = pyvisa.constants.StatusCode.error_timeout
        try:
            manager: Any = pyvisa.ResourceManager(library)  # its resources differ in what they have
            self._manager = manager
            self._resource = self._manager.open_resource(resource, open_timeout=int(1e3 * timeout_s))
            if not hasattr(self._resource, "read_raw"):
                raise ValueError(f"{resource} is no resource that messages can be sent to")
        # VISA libraries raise what they like: their own errors, of the system, of what lacks
        except Exception as error:
            raise Disconnected(
                f"cannot be opened by VISA: {_short(error)}; check name, power and library", port=address
            ) from None
        kind = self._resource.interface_type
        #: A stream of bytes without the end of a message: byte by byte, so that none is lost where they stop.
        self._stream = kind == pyvisa.constants.InterfaceType.asrl or resource.upper().endswith("::SOCKET")
        if kind == pyvisa.constants.InterfaceType.asrl:
            self._resource.baud_rate = baud
        with contextlib.suppress(Exception):  # what ends an answer is the driver's to say
            self._resource.read_termination = None
            self._resource.write_termination = ""

    def drain(self, quiet_s: float = 0.0) -> bytes:
        """As for any port; what speaks in messages calls it an error to be read where nothing was asked."""
        return super().drain(quiet_s) if self._stream else self._take(len(self._buffer))

    def _send(self, data: bytes, timeout_s: float) -> None:
        self._resource.timeout = max(1.0, 1e3 * timeout_s)
        try:
            self._resource.write_raw(data)
        except self._lost as error:
            raise self._translated(error) from None

    def _receive(self, timeout_s: float) -> bytes:
        self._resource.timeout = max(1.0, 1e3 * timeout_s)
        try:
            found = self._resource.read_bytes(1) if self._stream else self._resource.read_raw()
        except self._lost as error:
            if getattr(error, "error_code", None) == self._no_answer:
                return b""
            raise self._translated(error) from None
        return bytes(found)

    def _translated(self, error: Exception) -> OSError:
        return TimeoutError() if getattr(error, "error_code", None) == self._no_answer else OSError(str(error))

    def _close(self) -> None:
        try:
            self._resource.close()
        except self._lost as error:
            raise OSError(str(error)) from None


def _short(error: Exception) -> str:
    """The last line of what a library says: some say a whole traceback."""
    lines = [line.strip(" '\"") for line in str(error).replace("\\n", "\n").splitlines()]
    return next((line for line in reversed(lines) if line), type(error).__name__)


def open_port(
    address: str, *, default_port: int | None = None, baud: int = 115200, timeout_s: float = 5.0
) -> Transport:
    """Opens ``tcp://host:port``, ``udp://host:port``, ``visa://RESOURCE``, or the serial port of any other name: a
    device, ``rfc2217://host:port`` of a server of serial ports, or ``hwgrep://`` and what the adapter's name holds.

    Raises :class:`~sherkit.errors.Disconnected`, or :class:`~sherkit.errors.InstrumentError` for an address that is
    none.
    """
    for scheme in ("tcp", "udp"):
        if address.startswith(f"{scheme}://"):
            host, port = _host_and_port(address, default_port)
            return TcpPort(host, port, timeout_s) if scheme == "tcp" else UdpPort(host, port)
    if address.startswith(_VISA):
        return VisaPort(address, baud, timeout_s)
    if address.startswith("rfc2217://"):
        _host_and_port(address.partition("?")[0], None)
    if not address or ("://" in address and not address.startswith(_BY_PYSERIAL)):
        raise InstrumentError(f"'{address}' is no address; {_EXPECTED}")
    return SerialPort(address, baud)


def _host_and_port(address: str, default_port: int | None) -> tuple[str, int]:
    rest = address.partition("://")[2]
    host, colon, digits = rest.rpartition(":")
    if not colon:
        host, digits = rest, "" if default_port is None else str(default_port)
    host = host.removeprefix("[").removesuffix("]")
    port = int(digits) if digits.isascii() and digits.isdigit() else 0
    if not host or not 0 < port < 1 << 16:
        raise InstrumentError(
            f"'{address}' is no address; expected host and a port of 1 to 65535, as tcp://10.0.0.5:23"
        )
    return host, port
