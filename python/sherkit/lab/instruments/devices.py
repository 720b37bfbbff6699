"""Devices of bluesky, ophyd and ophyd-async, both ways; none of the three is imported.

Theirs as sherkit calls them: :func:`begun` and :func:`waited` call a method of a device in this thread, or in an event
loop where it answers in coroutines. Ours as bluesky's ``RunEngine`` drives them: ``set`` and ``trigger`` return at once
with a :class:`Status` and go on in a thread. ``RE.stop``, a pause and a failure of anything else in the plan end in
``stop``, which brakes the axes of this device alone.
"""

from __future__ import annotations

import asyncio
import inspect
import threading
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from typing import Any

from ...errors import Halted, InstrumentError
from .base import Axis, Instrument, Reading
from .galil import BY_COMMAND, Galil
from .keyence import Keyence

Values = dict[str, dict[str, Any]]

# -- theirs as sherkit calls them ------------------------------------------------------------------------------

_LOCK = threading.Lock()
_LOOP: asyncio.AbstractEventLoop | None = None


def _loop() -> asyncio.AbstractEventLoop:
    """An event loop in a thread of its own, which ends with the program."""
    global _LOOP
    with _LOCK:
        if _LOOP is None:
            _LOOP = asyncio.new_event_loop()
            threading.Thread(target=_LOOP.run_forever, daemon=True, name="devices").start()
        return _LOOP


def is_async(device: object) -> bool:
    """Whether a device answers in coroutines, as those of ophyd-async do."""
    return any(inspect.iscoroutinefunction(getattr(device, name, None)) for name in ("connect", "read", "set"))


def begun(device: object, function: Callable[..., Any], *arguments: Any, timeout_s: float = 10.0) -> Any:
    """Calls a method of a device, without waiting for what it began: a status, a task, or None where it is done."""
    if not is_async(device):
        return function(*arguments)

    async def begin() -> Any:
        made = function(*arguments)
        return asyncio.ensure_future(made) if inspect.iscoroutine(made) else made

    return asyncio.run_coroutine_threadsafe(begin(), _loop()).result(timeout_s)


def waited(device: object, function: Callable[..., Any], *arguments: Any, timeout_s: float) -> Any:
    """Calls a method of a device and waits for its end. Raises what the device raises, or ``TimeoutError``."""
    if is_async(device):

        async def wait() -> Any:
            made = function(*arguments)
            return await asyncio.wait_for(made, timeout_s) if inspect.isawaitable(made) else made

        return asyncio.run_coroutine_threadsafe(wait(), _loop()).result(timeout_s + 1.0)
    made = function(*arguments)
    if hasattr(made, "wait") and hasattr(made, "done"):
        made.wait(timeout_s)
        return None
    return made


def is_done(status: Any) -> bool:
    """Whether what :func:`begun` gave has ended; None always has."""
    if status is None:
        return True
    done = status.done
    return bool(done() if callable(done) else done)


def error_of(status: Any) -> BaseException | None:
    """What went wrong in what has ended, or None."""
    if status is None or not hasattr(status, "exception"):
        return None
    error: BaseException | None = status.exception()
    return error


# -- ours as bluesky drives them -------------------------------------------------------------------------------


class Status:
    """What becomes of a motion or a reading that was begun. Calls each callback once, at its end."""

    def __init__(self) -> None:
        self._end: Future[None] = Future()

    @property
    def done(self) -> bool:
        """Whether it has ended, well or not."""
        return self._end.done()

    @property
    def success(self) -> bool:
        """Whether it has ended well."""
        return self.done and self._end.exception() is None

    def add_callback(self, callback: Callable[[Status], None]) -> None:
        """Calls ``callback`` with this status at its end; at once where that has come."""
        self._end.add_done_callback(lambda _: callback(self))

    def exception(self, timeout: float | None = 0.0) -> BaseException | None:
        """What went wrong, or None. Raises ``TimeoutError`` where it has not ended within ``timeout``, s."""
        try:
            return self._end.exception(timeout)
        except TimeoutError:
            raise TimeoutError(f"has not ended within {timeout} s") from None

    def wait(self, timeout: float | None = None) -> None:
        """Waits for the end and raises what went wrong, or ``TimeoutError``."""
        if (error := self.exception(timeout)) is not None:
            raise error

    def finish(self, error: BaseException | None = None) -> None:
        """Ends it."""
        if error is None:
            self._end.set_result(None)
        else:
            self._end.set_exception(error)


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


class _Device:
    """What all devices share: a name, no parent, nothing to stage; ``columns`` are name and unit by the reading's."""

    parent = None

    def __init__(self, instrument: Instrument, name: str, columns: Mapping[str, tuple[str, str]]) -> None:
        self.instrument = instrument
        self.name = name
        self._columns = columns

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

    describe_configuration = read_configuration

    @property
    def hints(self) -> dict[str, Any]:
        """Which columns a table or picture shows."""
        return {"fields": list(self.describe())}

    def describe(self) -> Values:
        """The columns of :meth:`read`, with their units."""
        source = f"{self.instrument.kind} {self.instrument.address}"
        return {
            column: {"source": source, "dtype": "number", "shape": [], "units": unit}
            for column, unit in self._columns.values()
        }

    def read(self) -> Values:
        """A value for each column, and the host's time."""
        reading = self._reading()
        return {
            column: {"value": reading[name], "timestamp": reading.time_s} for name, (column, _) in self._columns.items()
        }

    def _reading(self) -> Reading:
        return self.instrument.read()


class _Mover(_Device):
    """What one axis and all axes share: its values are numbers, or those of all axes together."""

    instrument: Galil
    _is_one = False

    def __init__(self, galil: Galil, name: str, columns: Mapping[Axis, str]) -> None:
        super().__init__(galil, name, {a.label: (column, galil.unit) for a, column in columns.items()})
        self.axes = tuple(columns)
        self._under_way: Status | None = None
        self._stop_is_success: bool | None = None
        self._lock = threading.Lock()
        self._setpoint: dict[str, float] = {}

    def _targets(self, value: Any) -> dict[str, float]:
        """What ``set`` was given, by letters; refused outside the soft limits."""
        if self._is_one:
            value = {self.axes[0].letter: float(value)}
        return self.instrument.check(value if isinstance(value, Mapping) else [float(v) for v in value])

    def _shown(self, values: tuple[float, ...]) -> Any:
        """Values of the axes, as ``set`` takes them."""
        return values[0] if self._is_one else values

    @property
    def position(self) -> Any:
        """Where the encoders are, in the axes' unit."""
        return self._shown(self._here())

    def _here(self) -> tuple[float, ...]:
        reading = self.instrument.read()
        return tuple(reading[a.label] for a in self.axes)

    def locate(self) -> dict[str, Any]:
        """Where it was sent (where it is, before that) and where it is."""
        here = self._here()
        sent = tuple(self._setpoint.get(a.letter, h) for a, h in zip(self.axes, here, strict=True))
        return {"setpoint": self._shown(sent), "readback": self._shown(here)}

    def check_value(self, value: Any) -> None:
        """Raises :class:`~sherkit.errors.OutOfRange` outside the soft limits."""
        self._targets(value)

    def set(self, value: Any) -> Status:
        """Moves to ``value``, in the axes' unit. Raises :class:`~sherkit.errors.OutOfRange` before anything moves."""
        targets = self._targets(value)
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
                self.instrument.move(targets)
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


class GalilAxis(_Mover):
    """One axis, moved by ``set(mm)``, which is its one column. Called as its joint unless ``name`` says otherwise."""

    _is_one = True

    def __init__(self, galil: Galil, axis: str, name: str = "") -> None:
        found = [a for a in galil.axes if axis in (a.label, a.letter)]
        if not found:
            raise InstrumentError(f"{galil.name} has no axis '{axis}'")
        self.axis = found[0]
        name = name or self.axis.label
        super().__init__(galil, name, {self.axis: name})


class GalilAxes(_Mover):
    """All axes of a controller as one device, moved together by ``set((a, b, c))``, in their unit.

    Its columns are ``<name>_<axis>``.
    """

    def __init__(self, galil: Galil, name: str = "") -> None:
        name = name or galil.name
        super().__init__(galil, name, {a: f"{name}_{a.label}" for a in galil.axes})


class Detector(_Device):
    """An instrument that is read: ``trigger`` takes a reading, ``read`` hands it over once.

    ``names`` and ``units`` are those of its readings; ``name`` is put in front.
    """

    def __init__(self, instrument: Instrument, names: Sequence[str], units: Sequence[str], name: str = "") -> None:
        name = name or instrument.name
        super().__init__(instrument, name, {n: (f"{name}_{n}", u) for n, u in zip(names, units, strict=True)})
        self._taken: Reading | None = None

    def trigger(self) -> Status:
        """Takes a reading."""
        self._taken = None

        def take() -> None:
            self._taken = self.instrument.read()

        return _in_thread(take, Status())

    def _reading(self) -> Reading:
        # that of the last trigger; without one, or where it was handed over before, a new one
        reading, self._taken = self._taken or self.instrument.read(), None
        return reading


class KeyenceDetector(Detector):
    """The laser heads of a :class:`~sherkit.lab.instruments.Keyence` controller."""

    def __init__(self, keyence: Keyence, name: str = "") -> None:
        super().__init__(keyence, keyence.names, (keyence.unit,) * len(keyence.names), name)
