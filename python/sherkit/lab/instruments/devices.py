"""Instruments as devices that bluesky's ``RunEngine`` can drive. Its protocols are duck-typed: bluesky is not imported.

``set`` and ``trigger`` return at once with a :class:`Status` and go on in a thread. ``RE.stop``, a pause and a failure
of anything else in the plan end in ``stop``, which brakes the axes of this device alone.
"""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from ...errors import Halted, InstrumentError
from .axes import Axis
from .base import Instrument, Reading
from .galil import BY_COMMAND, Galil
from .keyence import Keyence

Values = dict[str, dict[str, Any]]


class Status:
    """What becomes of a motion or a reading that was begun. Calls each callback once, at its end."""

    def __init__(self) -> None:
        self._finished = threading.Event()
        self._lock = threading.Lock()
        self._callbacks: list[Callable[[Status], None]] = []
        self._error: BaseException | None = None

    @property
    def done(self) -> bool:
        """Whether it has ended, well or not."""
        return self._finished.is_set()

    @property
    def success(self) -> bool:
        """Whether it has ended well."""
        return self.done and self._error is None

    def add_callback(self, callback: Callable[[Status], None]) -> None:
        """Calls ``callback`` with this status at its end; at once where that has come."""
        with self._lock:
            if not self.done:
                self._callbacks.append(callback)
                return
        callback(self)

    def exception(self, timeout: float | None = 0.0) -> BaseException | None:
        """What went wrong, or None. Raises ``TimeoutError`` where it has not ended within ``timeout``, s."""
        if not self._finished.wait(timeout):
            raise TimeoutError(f"has not ended within {timeout:g} s" if timeout is not None else "has not ended")
        return self._error

    def wait(self, timeout: float | None = None) -> None:
        """Waits for the end and raises what went wrong, or ``TimeoutError``."""
        if (error := self.exception(timeout)) is not None:
            raise error

    def finish(self, error: BaseException | None = None) -> None:
        """Ends it."""
        with self._lock:
            self._error = error
            self._finished.set()
            callbacks, self._callbacks = self._callbacks, []
        for callback in callbacks:
            callback(self)


def _in_thread(task: Callable[[], None], status: Status) -> Status:
    def run() -> None:
        try:
            task()
        # the status carries it to who waits
        except BaseException as error:
            status.finish(error)
        else:
            status.finish()

    threading.Thread(target=run, daemon=True, name="device").start()
    return status


class _Device(ABC):
    """What all devices share: a name, no parent, nothing to stage."""

    parent = None

    def __init__(self, instrument: Instrument, name: str) -> None:
        self.instrument = instrument
        self.name = name

    def stage(self) -> list[Any]:
        """Connects where that has not been done."""
        if not self.instrument.connected:
            self.instrument.connect()
        return [self]

    def unstage(self) -> list[Any]:
        """Leaves the connection: who opened it closes it."""
        return [self]

    def read_configuration(self) -> Values:
        """Nothing that could change."""
        return {}

    def describe_configuration(self) -> Values:
        """Nothing that could change."""
        return {}

    @property
    def hints(self) -> dict[str, Any]:
        """Which columns a table or picture shows."""
        return {"fields": list(self.describe())}

    @abstractmethod
    def describe(self) -> Values:
        """The columns of :meth:`read`, with their units."""

    def _column(self, unit: str) -> dict[str, Any]:
        source = f"{self.instrument.kind} {self.instrument.address}"
        return {"source": source, "dtype": "number", "shape": [], "units": unit}


class _Mover(_Device):
    """What one axis and all axes share."""

    instrument: Galil

    def __init__(self, galil: Galil, name: str, axes: Sequence[Axis]) -> None:
        super().__init__(galil, name)
        self.axes = tuple(axes)
        self._under_way: Status | None = None
        self._stop_is_success: bool | None = None
        self._lock = threading.Lock()
        self._setpoint: dict[str, float] = {}

    def _set(self, targets: Mapping[str, float]) -> Status:
        checked = self.instrument.check(targets)
        status = Status()
        with self._lock:
            if self._under_way is not None and not self._under_way.done:
                raise InstrumentError(
                    "is still moving; wait for it, or stop it", instrument=self.name, port=self.instrument.address
                )
            self._under_way = status
            self._stop_is_success = None
            self._setpoint.update(targets)

        def move() -> None:
            try:
                self.instrument.move(checked)
            except Halted as halted:
                # a stop that was asked for, and called a good end by who asked
                if halted.code != BY_COMMAND or not self._stop_is_success:
                    raise

        return _in_thread(move, status)

    def stop(self, success: bool = True) -> None:
        """Brakes these axes and returns when they stand; called by bluesky also where nothing moves.

        ``success`` says how the status of a motion under way ends.
        """
        self._stop_is_success = success
        if self.instrument.connected:
            self.instrument.stop([a.letter for a in self.axes])

    def pause(self) -> None:
        """Brakes: a paused plan must not leave an axis moving. The plan's last ``set`` is sent again on resume."""
        # no failure: a status that fails would end the plan that is to be paused
        self.stop(success=True)

    def resume(self) -> None:
        """Nothing to do: bluesky sends the last ``set`` again."""

    def _values(self, reading: Reading) -> dict[str, float]:
        return {a.label: reading[a.label] for a in self.axes}


class GalilAxis(_Mover):
    """One axis, moved by ``set(mm)``. Called as its joint unless ``name`` says otherwise."""

    def __init__(self, galil: Galil, axis: str, name: str = "") -> None:
        found = [a for a in galil.axes if axis in (a.label, a.letter)]
        if not found:
            raise InstrumentError(f"{galil.name} has no axis '{axis}'")
        super().__init__(galil, name or found[0].label, found)
        self.axis = found[0]

    @property
    def position(self) -> float:
        """Where the encoder is, in the axis' unit."""
        return self.instrument.read()[self.axis.label]

    def check_value(self, value: float) -> None:
        """Raises :class:`~sherkit.errors.OutOfRange` outside the soft limits."""
        self.instrument.check({self.axis.letter: value})

    def set(self, value: float) -> Status:
        """Moves to ``value``, in the axis' unit. Raises :class:`~sherkit.errors.OutOfRange` before anything moves."""
        return self._set({self.axis.letter: float(value)})

    def read(self) -> Values:
        """The encoder and the host's time."""
        reading = self.instrument.read()
        return {self.name: {"value": reading[self.axis.label], "timestamp": reading.time_s}}

    def describe(self) -> Values:
        """One column."""
        return {self.name: self._column(self.instrument.unit)}

    def locate(self) -> dict[str, float]:
        """Where it was sent (where it is, before that) and where it is."""
        here = self.position
        return {"setpoint": self._setpoint.get(self.axis.letter, here), "readback": here}


class GalilAxes(_Mover):
    """All axes of a controller as one device, moved together by ``set((a, b, c))``, in their unit.

    Its columns are ``<name>_<axis>``.
    """

    def __init__(self, galil: Galil, name: str = "") -> None:
        super().__init__(galil, name or galil.name, galil.axes)

    @property
    def position(self) -> tuple[float, ...]:
        """Where the encoders are."""
        return self.instrument.read().values

    def _targets(self, value: Sequence[float] | Mapping[str, float]) -> dict[str, float]:
        if isinstance(value, Mapping):
            return self.instrument.check(value)
        return self.instrument.check([float(v) for v in value])

    def check_value(self, value: Sequence[float] | Mapping[str, float]) -> None:
        """Raises :class:`~sherkit.errors.OutOfRange` outside the soft limits."""
        self._targets(value)

    def set(self, value: Sequence[float] | Mapping[str, float]) -> Status:
        """Moves all axes together. Raises :class:`~sherkit.errors.OutOfRange` before anything moves."""
        return self._set(self._targets(value))

    def read(self) -> Values:
        """The encoders and the host's time."""
        reading = self.instrument.read()
        return {
            f"{self.name}_{label}": {"value": v, "timestamp": reading.time_s}
            for label, v in self._values(reading).items()
        }

    def describe(self) -> Values:
        """A column for each axis."""
        return {f"{self.name}_{a.label}": self._column(self.instrument.unit) for a in self.axes}

    def locate(self) -> dict[str, tuple[float, ...]]:
        """Where they were sent and where they are."""
        here = self.position
        sent = tuple(self._setpoint.get(a.letter, h) for a, h in zip(self.axes, here, strict=True))
        return {"setpoint": sent, "readback": here}


class Detector(_Device):
    """An instrument that is read: ``trigger`` takes a reading, ``read`` hands it over once.

    ``names`` and ``units`` are those of its readings; ``name`` is put in front.
    """

    def __init__(self, instrument: Instrument, names: Sequence[str], units: Sequence[str], name: str = "") -> None:
        super().__init__(instrument, name or instrument.name)
        self._names = tuple(names)
        self._units = tuple(units)
        self._taken: Reading | None = None

    def trigger(self) -> Status:
        """Takes a reading."""
        self._taken = None

        def take() -> None:
            self._taken = self.instrument.read()

        return _in_thread(take, Status())

    def read(self) -> Values:
        """The reading of the last trigger; without one, or where it was handed over before, a new one."""
        reading, self._taken = self._taken or self.instrument.read(), None
        return {f"{self.name}_{n}": {"value": reading[n], "timestamp": reading.time_s} for n in self._names}

    def describe(self) -> Values:
        """A column for each value, with its unit."""
        return {f"{self.name}_{n}": self._column(u) for n, u in zip(self._names, self._units, strict=True)}


class KeyenceDetector(Detector):
    """The laser heads of a :class:`~sherkit.lab.instruments.Keyence` controller."""

    def __init__(self, keyence: Keyence, name: str = "") -> None:
        super().__init__(keyence, keyence.names, (keyence.unit,) * len(keyence.names), name)
