"""Instruments that a user brings as Python: a function, an object, or a device of bluesky, ophyd, ophyd-async; and the
code that makes them.

``make`` gives it when the port would be opened. What it may be:

- a **sensor**: a callable without arguments that returns a number, several in the order of the columns, or a mapping
  with them; a device of bluesky (``read``, ``describe``, and ``trigger`` where it has one), synchronous or not; or
  another :class:`~sherkit.lab.instruments.base.Instrument`.
- **axes**: one object for each joint, with ``position`` (a value or a method; or ``locate`` or ``read`` as bluesky has
  them), ``set(value)`` (which returns a status, or returns when the axis stands) and ``stop()``.

``close()`` of what has one is called at the end.
"""

from __future__ import annotations

import contextlib
import importlib.util
import math
import sys
import time
from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field
from functools import partial
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any, ClassVar, Self

from ...base.extensions import INSTRUMENTS
from ...base.figures import listed, nearest
from ...errors import Disconnected, ExperimentError, Garbled, InstrumentError, OutOfRange, Timeout
from .base import Axis, AxisController, AxisReference, Identity, Instrument, Reading, Target
from .devices import begun, error_of, is_done, waited
from .transport import now_s

#: What gives an instrument: called without arguments.
Make = Callable[[], Any]
_POLL_S = 0.02
#: Spellings of units that devices use.
_SPELT = {"µm": "um", "micron": "um", "microns": "um", "millimeter": "mm", "degree": "deg", "degrees": "deg"}


@dataclass(eq=False, repr=False)
class _Own(Instrument):
    """What sensors and axes share: made by Python when they are connected. ``said`` names the code in sentences and run
    files."""

    kind = "Python"
    #: What it is, for sentences.
    it: ClassVar[str]

    address: str = field(init=False)
    make: Make
    _: KW_ONLY
    said: str = "Python"

    def __post_init__(self) -> None:
        self.address = self.said
        super().__post_init__()
        self._made: list[Any] = []

    @property
    def connected(self) -> bool:
        """Whether it was made."""
        return bool(self._made)

    def connect(self) -> Self:
        """Calls ``make``. Raises :class:`~sherkit.errors.InstrumentError`. Moves nothing."""
        with self._lock:
            self._made = self._accepted(self._called(f"what makes {self.it}", self.make))
            for one in self._made:
                if isinstance(one, Instrument):
                    one.connect()
                    continue
                if hasattr(one, "connect") and hasattr(one, "describe"):
                    self._of_device(one, "connect")
                if hasattr(one, "stage"):
                    self._of_device(one, "stage")
        return self

    def close(self) -> None:
        """Closes what has a ``close``; twice does no harm."""
        with self._lock:
            made, self._made = self._made, []
            for one in made:
                for method in ("unstage", "close"):
                    if callable(getattr(one, method, None)):
                        with contextlib.suppress(InstrumentError):  # what is left in any case
                            self._of_device(one, method)

    def identify(self) -> Identity:
        """What made it, and what it is; an instrument of sherkit's own says what it is itself."""
        made = self._present()
        if isinstance(made[0], Instrument):
            return made[0].identify()
        return Identity(self.kind, f"{self.address}, {listed(dict.fromkeys(map(_kind_of, made)))}", self.address)

    @abstractmethod
    def _accepted(self, made: Any) -> list[Any]:
        """The objects in what was made. Raises :class:`~sherkit.errors.InstrumentError` where it is something else."""

    def _present(self) -> list[Any]:
        if not self._made:
            raise self.fail(Disconnected, "is not connected; call connect() first")
        return self._made

    def _called(self, what: str, function: Callable[[], Any]) -> Any:
        """What a call of the user's code gives; whatever it raises becomes a sentence about this instrument."""
        try:
            with self._explained():
                return function()
        except InstrumentError:
            raise
        except TimeoutError:
            raise self.fail(Timeout, f"{what} did not end within {self.timeout_s:g} s") from None
        except Exception as error:
            raise self.fail(InstrumentError, f"{what} raised {type(error).__name__}: {error}") from error

    def _of_device(self, device: Any, method: str, *arguments: Any) -> Any:
        function = getattr(device, method)
        return self._called(method, lambda: waited(device, function, *arguments, timeout_s=self.timeout_s))


@dataclass(eq=False, repr=False)
class OwnSensor(_Own):
    """A sensor that ``make`` gives, whose values are called ``columns``; ``fields`` are theirs in a device's reading.

    The unit of a value is what the device describes, or else the one that its column ends in. ``said`` names the code
    in sentences and run files.
    """

    it = "it"

    columns: Sequence[str]
    _: KW_ONLY
    fields: Sequence[str] = ()

    def _accepted(self, made: Any) -> list[Any]:
        if not (callable(made) or hasattr(made, "read")):
            raise self.fail(
                InstrumentError, f"was given {_kind_of(made)}; expected a function that reads, or what has read()"
            )
        return [made]

    def read(self) -> Reading:
        """One reading. Raises :class:`~sherkit.errors.InstrumentError`, also for whatever the user's code raises."""
        with self._lock:
            (made,) = self._present()
            if isinstance(made, Instrument):
                return made.read()
            before = time.monotonic()
            found, units = self._found(made)
            time_s, took_s = now_s(), time.monotonic() - before
        # what was asked for so long ago is of another moment than its stamp
        if took_s > self.timeout_s:
            raise self.fail(Timeout, f"took {took_s:.1f} s for a reading; timeout_s is {self.timeout_s:g}")
        columns = tuple(self.columns)
        values = tuple(self._number(column, value) for column, value in zip(columns, found, strict=True))
        units = [unit or column.rpartition("_")[2] for column, unit in zip(columns, units, strict=True)]
        return Reading(self.name, columns, values, tuple(units), time_s)

    def _found(self, made: Any) -> tuple[list[Any], Sequence[str]]:
        """A value for each column and, where the device describes it, its unit."""
        if not hasattr(made, "read"):
            return self._in_order(self._called("reading it", made)), [""] * len(self.columns)
        if hasattr(made, "trigger"):
            self._of_device(made, "trigger")
        found = self._of_device(made, "read")
        if not (isinstance(found, Mapping) and all(isinstance(v, Mapping) and "value" in v for v in found.values())):
            # a class of the user's own, whose read() gives plain values
            return self._in_order(found), [""] * len(self.columns)
        described = self._of_device(made, "describe") if hasattr(made, "describe") else {}
        fields = self.fields or tuple(found)
        if absent := [field for field in fields if field not in found]:
            raise self.fail(Garbled, f"has no field {listed(absent)}; it has {listed(found, 12)}")
        if len(fields) != len(self.columns):
            raise self.fail(
                Garbled,
                f"has the fields {listed(fields, 12)} for {len(self.columns)} columns; name them with fields = […]",
            )
        stated = [str(described.get(field, {}).get("units") or "") for field in fields]
        return [found[field]["value"] for field in fields], [_SPELT.get(unit, unit) for unit in stated]

    def _in_order(self, found: Any) -> list[Any]:
        if isinstance(found, Mapping):
            names = self.fields or self.columns
            if absent := [name for name in names if name not in found]:
                raise self.fail(Garbled, f"gave no {listed(absent)}; it gave {listed(found, 12)}")
            return [found[name] for name in names]
        try:
            values = list(found)
        except TypeError:
            values = [found] * (len(self.columns) if found is None else 1)
        if len(values) != len(self.columns):
            raise self.fail(Garbled, f"gave {len(values)} values; [[instrument]] columns names {len(self.columns)}")
        return values

    def _number(self, column: str, value: Any) -> float:
        try:
            number = math.nan if value is None else float(value)
        except (TypeError, ValueError):
            raise self.fail(Garbled, f"gave {value!r} for '{column}'; expected a number") from None
        if math.isinf(number):
            raise self.fail(OutOfRange, f"gave {value!r} for '{column}'; expected a finite number, or NaN for none")
        return number


@dataclass(eq=False, repr=False)
class OwnAxes(_Own, AxisController):
    """Axes that ``make`` gives: one object for each of ``axes``, in their order.

    Whether they were zeroed cannot be told of them: where they stand is held against limits, plan and sensors. Axes
    whose ``set`` returns a status move together, others one after the other. A motion that takes more than the way at
    ``speed`` and ``settle_s`` is stopped.
    """

    it = "them"

    axes: Sequence[Axis]
    _: KW_ONLY
    speed: float
    acceleration: float
    arrived_within: float
    settle_s: float = 10.0

    def __post_init__(self) -> None:
        super().__post_init__()
        self.unit = self.axes[0].unit
        self.left_at = {}
        self._moving = False

    def _accepted(self, made: Any) -> list[Any]:
        parts = list(made) if isinstance(made, Sequence) else [made]
        if len(parts) != len(self.axes):
            raise self.fail(
                InstrumentError, f"{len(parts)} axes were given; expected {len(self.axes)}, one for each joint"
            )
        for axis, one in zip(self.axes, parts, strict=True):
            lacks = [m for m in ("set", "stop") if not callable(getattr(one, m, None))]
            if not any(hasattr(one, m) for m in ("position", "locate", "read")):
                lacks.append("position")
            if lacks:
                raise self.fail(InstrumentError, f"{axis.label}: {_kind_of(one)} has no {listed(lacks)}")
        return parts

    def close(self) -> None:
        """Stops what this program moves, and closes what has a ``close``."""
        with self._lock:
            try:
                if self._moving:
                    self.stop()
            finally:
                super().close()

    def read(self) -> Reading:
        """Where the axes stand, in their unit."""
        values = tuple(self._position(a, one) for a, one in zip(self.axes, self._present(), strict=True))
        return Reading(self.name, tuple(a.label for a in self.axes), values, (self.unit,) * len(values), now_s())

    def _position(self, axis: Axis, one: Any) -> float:
        if hasattr(one, "position"):
            found = one.position
            found = self._called("position", found) if callable(found) else found
        elif hasattr(one, "locate"):
            found = self._of_device(one, "locate")["readback"]
        else:
            found = next(iter(self._of_device(one, "read").values()))["value"]
        try:
            place = float(found)
        except (TypeError, ValueError):
            place = math.nan
        if not math.isfinite(place):
            raise self.fail(Garbled, f"{axis.label} stands at {found!r}; expected a number, in {self.unit}")
        return place

    def reference(self) -> AxisReference:
        """Where they stand; nothing is known of their zero."""
        every = (True,) * len(self.axes)
        return AxisReference(False, None, self.read().values, every, every)

    def set_reference(self, positions: Sequence[float]) -> AxisReference:
        """Calls ``set_current_position`` of each axis, as EPICS motors have it."""
        return self._each("set_current_position", "its zero be set", [[float(place)] for place in positions])

    def home(self) -> AxisReference:
        """Calls ``home`` of each axis, one after the other."""
        return self._each("home", "it be homed", [[]] * len(self.axes))

    def _each(self, method: str, what: str, arguments: Sequence[Sequence[float]]) -> AxisReference:
        """Calls a method of each axis where all have it, and says where they then stand."""
        parts = self._present()
        for axis, one in zip(self.axes, parts, strict=True):
            if not callable(getattr(one, method, None)):
                raise self.fail(
                    InstrumentError,
                    f"{axis.label} ({_kind_of(one)}) has no {method}(): nor can {what} from here; do so with its own "
                    "program",
                )
        for one, given in zip(parts, arguments, strict=True):
            self._of_device(one, method, *given)
        self.left_at = {}
        return self.reference()

    def move(self, target: Target) -> Reading:
        """Moves there, and returns where the axes then stand. Any error, also Ctrl-C, stops them first."""
        targets = self.check(target)
        self.require_reference(limits=False)
        parts = [(a, one) for a, one in zip(self.axes, self._present(), strict=True) if a.letter in targets]
        way = max(abs(targets[a.letter] - self._position(a, one)) for a, one in parts)
        longest_s = way / self.speed + self.speed / self.acceleration + self.settle_s
        self.left_at = {}
        self._moving = True
        try:
            under_way = [
                self._called("set", partial(begun, one, one.set, targets[a.letter], timeout_s=self.timeout_s))
                for a, one in parts
            ]
            end = time.monotonic() + longest_s
            while not all(is_done(status) for status in under_way):
                if time.monotonic() > end:
                    raise self.fail(Timeout, f"a motion did not end within {longest_s:.1f} s, and was stopped")
                time.sleep(_POLL_S)
            for (axis, _), status in zip(parts, under_way, strict=True):
                if (error := error_of(status)) is not None:
                    raise self.fail(InstrumentError, f"{axis.label} did not arrive: {type(error).__name__}: {error}")
        except BaseException:
            self.stop()
            raise
        self._moving = False
        found = self.read()
        self.left_at = {a.letter: q for a, q in zip(self.axes, found.values, strict=True)}
        return found

    def is_moving(self) -> bool:
        """Whether any axis says so; those that cannot say stand, unless this program moves them."""
        said = [getattr(one, "moving", False) for one in self._present()]
        return self._moving or any(bool(one() if callable(one) else one) for one in said)

    def stop(self) -> None:
        """Stops every axis, the others also where one cannot be. Raises what went wrong first."""
        wrong: list[InstrumentError] = []
        for one in self._present():
            try:
                self._of_device(one, "stop")
            except InstrumentError as error:
                wrong.append(error)
        self._moving = False
        if wrong:
            raise wrong[0]

    def enable(self) -> None:
        """Calls ``enable`` of the axes that have it."""
        for one in self._present():
            if callable(getattr(one, "enable", None)):
                self._of_device(one, "enable")


def _kind_of(made: Any) -> str:
    kind = type(made)
    name = getattr(made, "__qualname__", None) if callable(made) and not hasattr(made, "read") else None
    return f"{made.__module__}.{name}" if name else f"{kind.__module__}.{kind.__qualname__}"


# -- the code that makes them -----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class OwnCode:
    """What can be made, by name: of the files that were run, and then of installed packages.

    No experiment names a file that would be run: it names what is to be found in those that a person has given
    (``sherkit measure experiment.toml --python my_lab.py``), or in an installed package that offers it.
    """

    makers: Mapping[str, Callable[..., Any]] = field(default_factory=dict)
    files: tuple[str, ...] = ()

    def maker(self, name: str, where: str) -> tuple[Callable[..., Any], str]:
        """What makes ``name``, and the words that say where it stands.

        Raises :class:`~sherkit.errors.ExperimentError` where nobody offers it; ``where`` names the file that asks.
        """
        if name in self.makers:
            made = self.makers[name]
            return made, f"{Path(sys.modules[made.__module__].__file__ or '').name}:{name}"
        offered = {one.name: one for one in entry_points(group=INSTRUMENTS)}
        if name in offered:
            try:
                return offered[name].load(), f"{offered[name].value} (installed)"
            except Exception as error:
                raise ExperimentError(
                    f"{where}: '{name}' ({offered[name].value}) cannot be loaded: {type(error).__name__}: {error}"
                ) from error
        known = [*self.makers, *offered]
        hint = nearest(name, known) or (f"; known are {listed(known, 12)}" if known else "")
        nobody = f"{listed(self.files)} did not define it" if self.files else "no Python file was named"
        raise ExperimentError(
            f"{where}: '{name}' is made by Python code, and {nobody}{hint}. No file of data runs code: "
            "name the Python file on the command line, --python my_lab.py"
        )


def run_code(paths: Sequence[str | Path]) -> OwnCode:
    """Runs Python files, with the rights of whoever names them; what can be made are their functions and classes.

    Raises :class:`~sherkit.errors.ExperimentError` where a file is not there, fails, or defines none.
    """
    makers: dict[str, Callable[..., Any]] = {}
    for path in map(Path, paths):
        found = {k: v for k, v in _run(path).items() if not k.startswith("_") and callable(v)}
        own = {k: v for k, v in found.items() if getattr(v, "__module__", None) == _module(path)}
        if not own:
            raise ExperimentError(f"{path}: defines no function and no class that could make an instrument")
        twice = sorted(own.keys() & makers.keys())
        if twice:
            raise ExperimentError(f"{path}: '{twice[0]}' was defined by another file, too")
        makers |= own
    return OwnCode(makers, tuple(Path(path).name for path in paths))


def _module(path: Path) -> str:
    return f"sherkit_lab_{path.stem}"


def _run(path: Path) -> dict[str, Any]:
    if not path.is_file():
        raise ExperimentError(f"{path}: there is no such Python file")
    spec = importlib.util.spec_from_file_location(_module(path), path)
    if spec is None or spec.loader is None:
        raise ExperimentError(f"{path}: is not a Python file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    try:
        spec.loader.exec_module(module)
    except (Exception, SystemExit) as error:
        raise ExperimentError(f"{path}: {type(error).__name__}: {error}") from error
    return vars(module)
