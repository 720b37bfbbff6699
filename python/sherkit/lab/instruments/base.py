"""What all instruments have in common: connect, identify, read with unit and time, close; and what all axes have."""

from __future__ import annotations

import math
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import KW_ONLY, dataclass, field
from operator import sub
from statistics import median
from types import TracebackType
from typing import Any, ClassVar, Self, TypeVar

import numpy as np

from ...base.figures import listed, nearest
from ...errors import Disconnected, Garbled, InstrumentError, NotReferenced, OutOfRange, ShapeError, Timeout
from .transport import Transport, deadline_in, open_port

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


def middle_of(*three: Reading) -> Reading:
    """That of readings of what stands still which is nearest to their middle, name by name: of three one may be
    wrong."""
    middle = [median(each) for each in zip(*(one.values for one in three), strict=True)]
    return min(three, key=lambda one: max(map(abs, map(sub, one.values, middle))))


@dataclass(frozen=True)
class Identity:
    """Which instrument stands at a port: its ``kind`` here, what it says of itself, and the ``port``."""

    kind: str
    text: str
    port: str


@dataclass(eq=False, repr=False)
class Instrument(ABC):
    """An instrument at a port. Making one opens nothing; ``connect`` or ``with`` does. Opening never moves anything.

    ``address`` is as in :func:`~sherkit.lab.instruments.transport.open_port`. ``timeout_s`` bounds each exchange;
    ``retries`` says how often a question that changes nothing is asked again after a lost or garbled answer.
    Exchanges are locked, so that threads can share an instrument.
    """

    kind: ClassVar[str] = "instrument"
    default_port: ClassVar[int | None] = None

    address: str
    _: KW_ONLY
    name: str = ""
    timeout_s: float = 2.0
    retries: int = 2
    baud: int = 115200

    def __post_init__(self) -> None:
        self.name = self.name or self.kind
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
            # an empty cell agrees with an empty cell
            if now.names == before.names and np.allclose(now.values, before.values, 0.0, within, equal_nan=True):
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
        with self._explained():
            self._transport = self._open()

    def _shut(self) -> None:
        if self._transport is not None:
            self._transport.close()
            self._transport = None

    @contextmanager
    def _explained(self, sent: bytes = b"") -> Iterator[None]:
        """Errors learn which instrument it was and what was sent."""
        try:
            yield
        except InstrumentError as error:
            error.complete(instrument=self.name, port=self.address, sent=sent)
            raise

    @contextmanager
    def _exchanging(self, sent: bytes) -> Iterator[Transport]:
        """The port, for one exchange; errors as :meth:`_explained`."""
        with self._lock, self._explained(sent):
            if self._transport is None:
                raise Disconnected("is not connected; call connect() first")
            yield self._transport

    def _exchange(self, sent: bytes, receive: Callable[[Transport, float], T]) -> tuple[T, float]:
        """What ``receive`` takes from the port, until a deadline, after this was sent; and the host's time of it.

        What waited there before is thrown away: every lost or garbled answer ended with a new connection.
        """
        with self._exchanging(sent) as port:
            port.drain()
            deadline = deadline_in(self.timeout_s)
            port.write(sent, deadline)
            return receive(port, deadline), port.arrived_s

    def _repeat(self, ask: Callable[[], T]) -> T:
        """Asks, and asks again where an answer was lost: only for questions that change nothing."""
        with self._lock:
            for _ in range(self.retries):
                try:
                    return ask()
                except (Timeout, Garbled, Disconnected) as error:
                    if not self.connected:
                        raise
                    self._recover(error)
            return ask()

    def _recover(self, error: InstrumentError) -> None:
        """Makes sure that a late answer is not taken for the next one: here, by a new connection."""
        self._reopen()
        self._greet()


# -- axes -------------------------------------------------------------------------------------------------------------

#: Where axes are to go: by their letters or names, or all in order.
Target = Mapping[str, float] | Sequence[float]
#: The letters that axes of a controller have.
LETTERS = "ABCDEFGH"
#: An axis that stands may be read so many times further from where it was left than an axis that arrives.
_STAYS = 5.0


@dataclass(frozen=True)
class Axis:
    """One motor: its ``letter`` A to H, encoder ``counts_per_unit`` (negative: counts the other way), soft limits.

    A joint stands at ``(counts - zero_counts) / counts_per_unit``, in ``unit``: mm, or rad for one that turns. No
    target outside ``limits`` (low, high), in the same unit, is ever sent. ``name`` is that of the joint, the letter if
    left out.
    """

    letter: str
    counts_per_unit: float
    limits: tuple[float, float]
    zero_counts: int = 0
    name: str = ""
    unit: str = "mm"

    def __post_init__(self) -> None:
        if self.letter not in LETTERS or len(self.letter) != 1:
            raise InstrumentError(f"axis '{self.letter}': expected one letter of {LETTERS}")
        if not (math.isfinite(self.counts_per_unit) and self.counts_per_unit != 0):
            raise InstrumentError(
                f"axis {self.letter}: counts_per_unit is {self.counts_per_unit}; expected a number not 0"
            )
        low, high = self.limits
        if not (math.isfinite(low) and math.isfinite(high) and low < high):
            raise InstrumentError(f"axis {self.letter}: limits are {low}, {high}; expected low, then high")

    @property
    def label(self) -> str:
        """What its values are called."""
        return self.name or self.letter

    def to_counts(self, position: float) -> int:
        """Encoder counts at ``position``."""
        return round(position * self.counts_per_unit) + self.zero_counts

    def to_position(self, counts: float) -> float:
        """Joint position, in its unit, at ``counts``."""
        return (counts - self.zero_counts) / self.counts_per_unit


@dataclass(frozen=True)
class AxisReference:
    """What a controller says of its axes before they move, in the order of their letters.

    ``said`` is whether it can tell at all that it was homed or zeroed since it was switched on. If so, ``mark`` is the
    number that tells one zeroing from the next, None where the zero is lost or was never set. ``positions`` are in the
    axes' unit; ``drives_on`` is for each axis, ``limits_set`` for each whether the controller's own limits are ours.
    """

    said: bool
    mark: int | None
    positions: tuple[float, ...]
    drives_on: tuple[bool, ...]
    limits_set: tuple[bool, ...]


class AxisController(Instrument):
    """The base of all drivers that move axes: nothing moves until where they stand is proven.

    A driver says how its controller is asked (:meth:`reference`) and how a zero is set (:meth:`set_reference`); it
    calls :meth:`require_reference` before each motion, and notes in ``left_at`` where the axes stood after it.
    """

    axes: Sequence[Axis]
    unit: str
    speed: float
    acceleration: float
    arrived_within: float

    #: The mark of the zero with which this program moves; None until it has asked.
    mark: int | None = None
    #: Where each axis stood after its last motion, by letter; without one that was stopped on its way.
    left_at: Mapping[str, float]
    #: Where the home switches are, one joint position for each axis; None where the controller cannot home by itself.
    home_at: Sequence[float] | None = None

    @abstractmethod
    def reference(self) -> AxisReference:
        """Asks the controller. Raises :class:`~sherkit.errors.InstrumentError`."""

    @abstractmethod
    def set_reference(self, positions: Sequence[float]) -> AxisReference:
        """Tells the controller that the axes, which stand, are at ``positions``, and marks the zero as set.

        Moves nothing. Raises :class:`~sherkit.errors.InstrumentError`.
        """

    @abstractmethod
    def home(self) -> AxisReference:
        """Drives all axes to their home switches and sets the reference there. Raises where it cannot."""

    def check(self, target: Target) -> dict[str, float]:
        """The target by letters, in their unit. Raises :class:`~sherkit.errors.OutOfRange` outside the soft limits."""
        if not isinstance(target, Mapping):
            if len(target) != len(self.axes):
                raise self.fail(
                    InstrumentError,
                    f"a target of {len(target)} numbers; expected {len(self.axes)}, one for each axis",
                )
            target = {a.letter: v for a, v in zip(self.axes, target, strict=True)}
        named = {a.label: a for a in self.axes} | {a.letter: a for a in self.axes}
        if unknown := [word for word in target if word not in named]:
            raise self.fail(
                InstrumentError, f"has no axis {listed(unknown)}; it has {listed(a.label for a in self.axes)}"
            )
        targets = {named[word].letter: float(value) for word, value in target.items()}
        for axis in self.axes:
            low, high = axis.limits
            value = targets.get(axis.letter, low)
            if not low <= value <= high:
                raise self.fail(
                    OutOfRange,
                    f"axis {axis.label} was to go to {value:g} {self.unit}; its soft limits are {low:g} to {high:g}",
                )
        return targets

    @abstractmethod
    def move(self, target: Target) -> Reading:
        """Moves there and returns where the encoders then are. Nothing moves without :meth:`require_reference`."""

    @abstractmethod
    def is_moving(self) -> bool:
        """Whether any axis is on its way."""

    @abstractmethod
    def stop(self) -> None:
        """Stops all axes, and returns when they stand."""

    @abstractmethod
    def enable(self) -> None:
        """Switches the drives on, where they stand."""

    @property
    def braking(self) -> float:
        """How far an axis goes on at most after it was told to stop, in its unit."""
        return 0.5 * self.speed**2 / self.acceleration

    def require_reference(self, *, limits: bool) -> AxisReference:
        """Raises :class:`~sherkit.errors.NotReferenced` unless where the axes stand is proven; asked twice.

        It is, where the controller was zeroed since it was switched on and not by somebody else since this program
        began, its drives are on, every axis stands within its soft limits (give or take a way to brake) and where its
        last motion left it, and, with ``limits``, the controller's limits are ours.
        """
        found = self.reference()
        if self._doubts(found, limits):
            # a digit that the line has damaged is no doubt about the axes
            found = self.reference()
        if doubts := self._doubts(found, limits):
            raise self.not_referenced("; ".join(doubts))
        if off := [a.label for a, on in zip(self.axes, found.drives_on, strict=True) if not on]:
            raise self.fail(
                NotReferenced,
                f"the drive of {listed(off)} is off. Nothing was moved: look at the emergency stop and the amplifier, "
                "and switch the drives on",
            )
        self.mark = found.mark
        return found

    def not_referenced(self, why: str) -> NotReferenced:
        """The error for that reason, with what to do."""
        return self.fail(
            NotReferenced,
            f"{why}. Nothing was moved: its encoders may not say where the robot is. Run 'sherkit home' with the "
            "experiment's file, then go on with 'sherkit measure --resume'",
        )

    def _doubts(self, found: AxisReference, limits: bool) -> list[str]:
        said: list[str] = []
        if found.said and found.mark is None:
            said.append("has lost its zero, or was not zeroed since it was switched on")
        elif self.mark is not None and found.mark != self.mark:
            said.append("was zeroed anew while this program ran")
        for axis, at, ours in zip(self.axes, found.positions, found.limits_set, strict=True):
            low, high = axis.limits
            more = self.braking + self.arrived_within
            left = self.left_at.get(axis.letter)
            if not low - more <= at <= high + more:
                said.append(
                    f"{axis.label} stands at {at:.3f} {self.unit} by its encoder, and its limits are {low:g}, {high:g}"
                )
            elif left is not None and abs(at - left) > _STAYS * self.arrived_within + 2.0 / abs(axis.counts_per_unit):
                said.append(f"{axis.label} stands at {at:.3f} {self.unit} by its encoder; it was left at {left:.3f}")
            if limits and not ours:
                said.append(f"the controller's limits of {axis.label} are no longer those that were set")
        return said
