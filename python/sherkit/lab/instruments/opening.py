"""Which port an address means."""

from __future__ import annotations

from ...errors import InstrumentError
from .transport import SCHEME, SerialPort, TcpPort, Transport, UdpPort, VisaPort


def open_port(
    address: str, *, default_port: int | None = None, baud: int = 115200, timeout_s: float = 5.0
) -> Transport:
    """Opens ``tcp://host:port``, ``udp://host:port``, ``visa://RESOURCE``, or the serial port of any other name.

    Raises :class:`~sherkit.errors.Disconnected`, or :class:`~sherkit.errors.InstrumentError` for an address that is
    none.
    """
    for scheme in ("tcp", "udp"):
        if address.startswith(f"{scheme}://"):
            host, port = _host_and_port(address, default_port)
            return TcpPort(host, port, timeout_s) if scheme == "tcp" else UdpPort(host, port)
    if address.startswith(SCHEME):
        return VisaPort(address, baud, timeout_s)
    if "://" in address or not address:
        raise InstrumentError(
            f"'{address}' is no address; expected tcp://host:port, udp://host:port, visa://resource or a serial port"
        )
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
