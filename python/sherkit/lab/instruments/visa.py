"""Ports by VISA: ``visa://RESOURCE``, as ``visa://TCPIP0::10.0.0.5::inst0::INSTR``, for any driver (pyvisa).

After an ``@`` stands the library of pyvisa where it is not the vendor's: ``visa://ASRL/dev/ttyUSB0::INSTR@py``
(pyvisa-py), ``visa://USB::0x1111::0x2222::0x1234::INSTR@devices@sim`` (pyvisa-sim).
"""

from __future__ import annotations

import contextlib
from typing import Any

from ...errors import Disconnected, InstrumentError
from .transport import Transport

SCHEME = "visa://"


class VisaPort(Transport):
    """Bytes to and from a VISA resource. Raises :class:`~sherkit.errors.Disconnected` where it cannot be opened."""

    def __init__(self, address: str, baud: int = 115200, timeout_s: float = 5.0) -> None:
        super().__init__(address)
        try:
            import pyvisa
        except ImportError:
            raise InstrumentError('visa:// needs pyvisa: pip install "sherkit[visa]"', port=address) from None
        resource, _, library = address.removeprefix(SCHEME).partition("@")
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
