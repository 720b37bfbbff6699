"""Lines that define effects, run in a process of their own: whatever they do, it can be ended, and the page lives; and
the one worker of the page, whose work a person can cancel.

The process holds the functions; here stand effects of the same names, whose functions ask it. It is sent the rows once
and then only parameters, and answers arrays.
"""

from __future__ import annotations

import itertools
import multiprocessing
import os
import signal
import tempfile
import threading
import time
import uuid
import weakref
from collections import OrderedDict
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import partial
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection
from pathlib import Path
from threading import Lock
from types import SimpleNamespace
from typing import Any, TypeVar

from ..base.types import Floats
from ..data import Measurements
from ..data.files import write_whole
from ..errors import EffectError, SherkitError
from ..model.effect import Effect, load_effects
from ..model.rows import EffectRows, handed_on_run

# -- Processes as Linux tells of them -------------------------------------------------------------------------------

_NAME = "SHERKIT_LINES"
_ONE_AT_A_TIME = Lock()


def waited_s(pid: int | None) -> float:
    """How long a process that could run had to wait for a processor; 0 where the system does not tell."""
    try:
        return int(Path(f"/proc/{pid}/schedstat").read_text(encoding="ascii").split()[1]) * 1e-9
    except (OSError, ValueError, IndexError):
        return 0.0


@contextmanager
def marked(mark: str) -> Iterator[None]:
    """Gives the mark to the processes that are begun meanwhile, and so to all that these begin."""
    with _ONE_AT_A_TIME:
        os.environ[_NAME] = mark
        try:
            yield
        finally:
            del os.environ[_NAME]


def end_marked(mark: str) -> None:
    """Ends every process that has the mark, but this one: stopped first, so that none begins another one meanwhile."""
    stopped: set[int] = set()
    while new := set(_with_mark(mark)) - stopped:
        for pid in new:
            _send(pid, "SIGSTOP")
        stopped |= new
    for pid in stopped:
        _send(pid, "SIGKILL")


def _with_mark(mark: str) -> Iterator[int]:
    wanted = f"{_NAME}={mark}\0".encode()
    for one in Path("/proc").glob("[0-9]*"):
        if int(one.name) != os.getpid():
            with suppress(OSError):
                if wanted in (one / "environ").read_bytes() + b"\0":
                    yield int(one.name)


def _send(pid: int, name: str) -> None:
    with suppress(OSError, AttributeError):
        os.kill(pid, getattr(signal, name))


# -- Seen from the page ----------------------------------------------------------------------------------------------

#: How long one look at all rows may take, by the clock but for the time in which other work has the machine, and how
#: often a person's wish to end it is looked for, s.
PATIENCE_S, _LOOK_S = 20.0, 0.05
#: What the lines may ask for beside what Python needs for itself, bytes.
_MEMORY = 2 * 2**30
#: Runs that the process keeps: every fold of a cross-validation is one.
_KEPT = 12


class Sandbox:
    """The effects of some lines. ``look`` is called while their process works; what it raises ends the process.

    ``effects`` are what the lines define; an effect that is asked after the end of the process begins another one.
    Raises :class:`~sherkit.errors.EffectError` where the lines fail, define no effect, or do not end.
    """

    def __init__(self, source: str, look: Callable[[], None], patience_s: float = PATIENCE_S) -> None:
        self._source, self._look, self._patience_s = source, look, patience_s
        #: Why the lines are not asked again.
        self._broken = ""
        try:
            self._process: _Process | None = self._begun()
        except _Ended as ended:
            raise EffectError(f"your lines were not run: {ended}") from None
        self.effects = tuple(self._effect(one) for one in self._process.effects)

    def end(self) -> None:
        """Ends the process, whatever it does."""
        if self._process is not None:
            self._process.end()
            self._process = None

    def forgive(self) -> None:
        """Asks the lines again, though they were ended: where they fail at a size that nobody has says nothing else."""
        self._broken = ""

    def _begun(self) -> _Process:
        return _Process(self._source, self._look, self._patience_s)

    def _effect(self, described: _Described) -> Effect:
        name = described.effect.name
        derivative = partial(self.ask, name, "derivative") if described.has_derivative else None
        return replace(described.effect, function=partial(self.ask, name, "function"), derivative=derivative)

    def ask(self, name: str, which: str, rows: EffectRows, p: SimpleNamespace) -> Floats:
        """What a function of the lines gives. Raises :class:`~sherkit.errors.EffectError` where it gives nothing."""
        if self._broken:
            raise EffectError(self._broken)
        try:
            self._process = self._process or self._begun()
            return self._process.ask(name, which, rows, p)
        except _Ended as ended:
            self.end()
            self._broken = f"effect '{name}': its lines {ended}; take it out of the model and mend them"
            raise EffectError(self._broken) from None
        except EffectError:
            raise
        except BaseException:  # a person no longer wants it
            self.end()
            raise


@dataclass(frozen=True)
class _Described:
    """An effect without its functions, as it travels."""

    effect: Effect
    has_derivative: bool


class _Ended(Exception):
    """The process is gone, or had to be ended."""


class _Process:
    """The process, from its beginning to its end."""

    def __init__(self, source: str, look: Callable[[], None], patience_s: float) -> None:
        self._look, self._patience_s = look, patience_s
        self._sent: OrderedDict[int, weakref.ref[Measurements]] = OrderedDict()
        self._number = itertools.count()
        self._mark = uuid.uuid4().hex
        context = multiprocessing.get_context("spawn")
        self._line, far = context.Pipe()
        self._process = context.Process(target=_serve, args=(far, source, self._mark), daemon=True)
        resource_tracker.ensure_running()  # Python's own, which serves every process: it must not have the mark
        with marked(self._mark):
            self._process.start()
        far.close()
        try:
            self.effects: tuple[_Described, ...] = self._answer()
        except BaseException:
            self.end()
            raise

    def ask(self, name: str, which: str, rows: EffectRows, p: SimpleNamespace) -> Floats:
        self._send(("call", name, which, self._key(handed_on_run(rows)), vars(p)))
        out: Floats = self._answer(rows)
        return out

    def _key(self, data: Measurements) -> int:
        for key, known in self._sent.items():
            if known() is data:
                return key
        key = next(self._number)
        if len(self._sent) >= _KEPT:
            self._send(("forget", self._sent.popitem(last=False)[0]))
        self._send(("rows", key, data))
        self._sent[key] = weakref.ref(data)
        return key

    def _send(self, message: tuple[Any, ...]) -> None:
        try:
            self._line.send(message)
        except OSError:
            raise self._gone() from None

    def _answer(self, rows: EffectRows | None = None) -> Any:
        begun, refused = self._clock_s(), None
        while True:
            try:
                if not self._line.poll(_LOOK_S):
                    self._look()
                    if self._clock_s() - begun > self._patience_s:
                        raise _Ended(f"did not end within {self._patience_s:g} s, and were ended")
                    continue
                kind, value = self._line.recv()
            except (EOFError, OSError):
                raise self._gone() from None
            if kind == "ready":  # what Python needs to begin is not the lines' own
                begun = self._clock_s()
            elif kind == "position" and rows is not None:
                try:
                    self._send(("position", rows.position))
                except SherkitError as error:
                    # out of reach it is no fault of the lines: a fit takes a smaller step
                    refused = error
                    self._send(("failed", str(error)))
            elif kind == "failed":
                raise refused or EffectError(value)
            else:
                return value

    def _clock_s(self) -> float:
        """The clock without the time in which the process could have run and other work had the processor."""
        return time.monotonic() - waited_s(self._process.pid)

    def _gone(self) -> _Ended:
        self._process.join(10.0)
        code = self._process.exitcode
        if code is None or code >= 0:
            return _Ended(f"ended their own process (exit code {code or 0})")
        try:
            name = signal.Signals(-code).name
        except ValueError:
            name = f"signal {-code}"
        return _Ended(f"crashed their process ({name})")

    def end(self) -> None:
        end_marked(self._mark)
        self._process.kill()
        self._process.join()
        self._line.close()


# -- in the process ----------------------------------------------------------------------------------------------


def _serve(line: Connection, source: str, mark: str) -> None:
    """What the process does: runs the lines, and answers."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the page, which ends this process
    _end_with_parent(mark)
    _bound_memory()
    line.send(("ready", None))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "your_lines.py"
        write_whole(path, source)
        try:
            effects = {one.name: one for one in load_effects(path)}
        except BaseException as error:
            line.send(("failed", _said(error).replace(str(path), "your lines")))
            return
    told = tuple(
        _Described(replace(one, function=None, derivative=None), one.derivative is not None) for one in effects.values()
    )
    line.send(("effects", told))
    known: dict[int, Measurements] = {}
    while True:
        try:
            kind, *what = line.recv()
        except (EOFError, OSError):
            return
        if kind == "rows":
            known[what[0]] = what[1]
        elif kind == "forget":
            known.pop(what[0], None)
        else:
            name, which, key, values = what
            line.send(_called(line, effects[name], which, known[key], values))


def _called(line: Connection, effect: Effect, which: str, data: Measurements, values: dict[str, float]) -> Any:
    def position() -> Any:
        line.send(("position", None))
        kind, value = line.recv()
        if kind == "failed":
            raise EffectError(value)
        return value

    function = effect.function if which == "function" else effect.derivative
    assert function is not None  # only what there is was told of
    try:
        return "array", _plain(function(EffectRows(data, position), SimpleNamespace(**values)))
    except EffectError as error:
        return "failed", str(error)
    except MemoryError:
        return "failed", f"effect '{effect.name}' failed: it asked for more than {_MEMORY / 2**30:g} GB of memory"
    except BaseException as error:  # sys.exit too
        return "failed", f"effect '{effect.name}' failed: {_said(error)}"


def _plain(value: Any) -> Any:
    import numpy as np

    return np.asarray(value, dtype=float)


def _said(error: BaseException) -> str:
    return str(error) if isinstance(error, EffectError) else f"{type(error).__name__}: {error}"


def _end_with_parent(mark: str) -> None:
    """Lines that never end do not outlive the page, however that ends."""
    import threading
    from multiprocessing.connection import wait

    parent = multiprocessing.parent_process()

    def watch() -> None:
        if parent is not None:
            wait([parent.sentinel])
        end_marked(mark)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _bound_memory() -> None:
    """Memory that Python cannot have is an error in the lines; that of the whole machine would end other work."""
    try:
        import resource

        used = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[5]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_DATA, (used + _MEMORY, used + _MEMORY))
    except (ImportError, OSError, ValueError):  # not on Linux
        return


# -- The worker -------------------------------------------------------------------------------------------------------

T = TypeVar("T")


class Cancelled(SherkitError):
    """Work that a person stopped, or that gave way to what a person did."""


class Worker:
    """Runs work in order in a thread of its own. ``rest`` is called when nothing is left to do.

    Work gets a number when it is asked for; cancelling is a number too, up to which all is cancelled. So nothing that
    is asked for later is lost, and nothing that was cancelled begins.
    """

    def __init__(self, rest: Callable[[], None]) -> None:
        self._rest = rest
        self._threads = ThreadPoolExecutor(1, thread_name_prefix="study")
        self._lock = threading.Lock()
        self._asked = self._running = 0
        self._cancelled = -1
        #: Work that is not done.
        self.pending = 0
        #: Of it, work before which a diagnosis gives way.
        self.first = 0
        self._gives_way = False

    def submit(self, run: Callable[[], T], *, first: bool = False, gives_way: bool = False) -> Future[T]:
        """Queues work. What ``gives_way`` is cancelled where other work comes that goes ``first``."""
        with self._lock:
            self._asked += 1
            self.pending += 1
            self.first += first
            number = self._asked

        def work() -> T:
            self._running, self._gives_way = number, gives_way
            with self._lock:
                self.first -= first
            try:
                return run()
            finally:
                with self._lock:
                    self.pending -= 1
                    last = not self.pending
                if last:
                    self._rest()

        return self._threads.submit(work)

    def look(self) -> None:
        """Asked often by the work that runs. Raises :class:`Cancelled` where nobody wants it any more."""
        if self.unwanted:
            raise Cancelled("stopped")

    @property
    def unwanted(self) -> bool:
        """Whether the work that runs was cancelled, or gives way."""
        return self.cancelled or (self._gives_way and self.first > 0)

    @property
    def cancelled(self) -> bool:
        """Whether a person cancelled the work that runs."""
        return self._running <= self._cancelled

    def cancel(self) -> None:
        """Cancels all that was asked for so far; it ends where it looks next."""
        with self._lock:
            self._cancelled = self._asked

    def close(self) -> None:
        """Cancels everything and waits for its end."""
        self.cancel()
        self._threads.shutdown(wait=True)
