"""What all instruments have in common: connect, identify, read with unit and time, close."""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from types import TracebackType
from typing import Any, ClassVar, Self, TypeVar

from ...base.names import nearest
from ...errors import Disconnected, Garbled, InstrumentError, ShapeError, Timeout
from .transport import Transport, open_port

T = TypeVar("T")
E = TypeVar("E", bound=InstrumentError)


@dataclass(frozen=True)
class Reading:
    """What an instrument said: ``values`` by ``names`` in ``units`` (one each), NaN where a cell is empty.

    ``time_s`` is the host's time, seconds since 1970, at which the bytes arrived. ``details`` are the instrument's own
    counters and clocks.
    """

    instrument: str
    names: tuple[str, ...]
    values: tuple[float, ...]
    units: tuple[str, ...]
    time_s: float
    details: Mapping[str, float] = field(default_factory=dict)

    def __getitem__(self, name: str) -> float:
        """The value of that name. Raises :class:`~sherkit.errors.ShapeError` for an unknown one."""
        if name not in self.names:
            raise ShapeError(f"{self.instrument}: reads no '{name}'{nearest(name, self.names)}")
        return self.values[self.names.index(name)]

    @property
    def unit(self) -> str:
        """The unit of all values. Raises :class:`~sherkit.errors.ShapeError` where they have several."""
        if len(set(self.units)) != 1:
            raise ShapeError(f"{self.instrument}: its values have no common unit: {', '.join(self.units)}")
        return self.units[0]


@dataclass(frozen=True)
class Identity:
    """Which instrument stands at a port: its ``kind`` here, what it says of itself, and the ``port``."""

    kind: str
    text: str
    port: str


class Instrument(ABC):
    """An instrument at a port. Making one opens nothing; ``connect`` or ``with`` does. Opening never moves anything.

    ``address`` is as in :func:`~sherkit.lab.instruments.transport.open_port`. ``timeout_s`` bounds each exchange;
    ``retries`` says how often a question that changes nothing is asked again after a lost or garbled answer.
    Exchanges are locked, so that threads can share an instrument.
    """

    kind: ClassVar[str] = "instrument"
    default_port: ClassVar[int | None] = None

    def __init__(
        self, address: str, *, name: str = "", timeout_s: float = 2.0, retries: int = 2, baud: int = 115200
    ) -> None:
        self.address = address
        self.name = name or self.kind
        self.timeout_s = timeout_s
        self.retries = retries
        self.baud = baud
        self._lock = threading.RLock()
        self._transport: Transport | None = None

    def connect(self) -> Self:
        """Opens the port and brings the line into step. Raises :class:`~sherkit.errors.InstrumentError`."""
        with self._lock:
            self._reopen()
            try:
                self._greet()
            except BaseException:
                self._shut()
                raise
        return self

    @property
    def connected(self) -> bool:
        """Whether the port is open."""
        return self._transport is not None

    @abstractmethod
    def identify(self) -> Identity:
        """What the instrument says of itself. Raises :class:`~sherkit.errors.InstrumentError`."""

    @abstractmethod
    def read(self) -> Reading:
        """One reading. Raises :class:`~sherkit.errors.InstrumentError` where there is none; never an old value."""

    def read_confirmed(self, within: float, attempts: int = 3) -> Reading:
        """The second of two successive readings that agree within ``within``, in their units.

        Protocols without a checksum cannot tell a digit that noise on the line turned into another: two readings can.
        Raises :class:`~sherkit.errors.Garbled` where no two of ``attempts`` + 1 successive ones agree.
        """
        before = self.read()
        for _ in range(attempts):
            now = self.read()
            if now.names == before.names and all(
                # an empty cell agrees with an empty cell
                abs(a - b) <= within or (a != a and b != b) for a, b in zip(now.values, before.values, strict=True)
            ):  # fmt: skip
                return now
            before, last = now, before
        raise self.fail(
            Garbled,
            f"successive readings differ: {last.values} and {before.values}, expected at most {within:g} between them; "
            "it moves, or the line is disturbed",
        )

    def fail(self, kind: type[E], *said: Any, sent: bytes = b"", received: bytes = b"") -> E:
        """The error of that ``kind`` for what was ``said``: with this instrument, its port, and the bytes, if any."""
        return kind(*said, instrument=self.name, port=self.address, sent=sent, received=received)

    def close(self) -> None:
        """Gives the port back; twice does no harm."""
        with self._lock:
            self._shut()

    def __enter__(self) -> Self:
        return self if self.connected else self.connect()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _greet(self) -> None:  # noqa: B027 - most instruments need none
        """What has to be said first on a new connection."""

    def _open(self) -> Transport:
        return open_port(self.address, default_port=self.default_port, baud=self.baud, timeout_s=self.timeout_s)

    def _reopen(self) -> None:
        self._shut()
        try:
            self._transport = self._open()
        except InstrumentError as error:
            error.complete(instrument=self.name, port=self.address)
            raise

    def _shut(self) -> None:
        if self._transport is not None:
            self._transport.close()
            self._transport = None

    @contextmanager
    def _exchanging(self, sent: bytes) -> Iterator[Transport]:
        """The port, for one exchange; errors learn which instrument it was and what was sent."""
        with self._lock:
            try:
                if self._transport is None:
                    raise Disconnected("is not connected; call connect() first")
                yield self._transport
            except InstrumentError as error:
                error.complete(instrument=self.name, port=self.address, sent=sent)
                raise

    def _repeat(self, ask: Callable[[], T]) -> T:
        """Asks, and asks again where an answer was lost: only for questions that change nothing."""
        with self._lock:
            for left in range(self.retries, -1, -1):
                try:
                    return ask()
                except (Timeout, Garbled, Disconnected) as error:
                    if not left or self._transport is None:
                        raise
                    self._recover(error)
            raise AssertionError("unreachable")

    def _recover(self, error: InstrumentError) -> None:
        """Makes sure that a late answer is not taken for the next one: here, by a new connection."""
        self._reopen()
        self._greet()
