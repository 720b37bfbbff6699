"""The runner: step by step through a plan, each point stored before the next step begins."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

from ...errors import Disconnected, Garbled, SherkitError, Timeout
from .bench import Bench, Point
from .plan import Plan
from .run_file import RunFile

#: Weight of the newest step in the estimate of the time that a step takes.
_NEWEST = 0.1
_PAUSE_POLL_S = 0.05


class Control:
    """What a person wants of a run: to pause, to go on, to end. May be used from another thread."""

    def __init__(self) -> None:
        self._go = threading.Event()
        self._go.set()
        self._ended = threading.Event()

    @property
    def paused(self) -> bool:
        """Whether it is to wait after the present step."""
        return not self._go.is_set()

    @property
    def ended(self) -> bool:
        """Whether it is to end after the present step."""
        return self._ended.is_set()

    def pause(self) -> None:
        """Waits after the present step: the motors stand."""
        self._go.clear()

    def resume(self) -> None:
        """Goes on."""
        self._go.set()

    def end(self) -> None:
        """Ends after the present step; the run can be resumed."""
        self._ended.set()
        self._go.set()

    def wait(self) -> None:
        """Returns when it is to go on."""
        while not self._go.wait(_PAUSE_POLL_S):
            pass


@dataclass(frozen=True)
class RunProgress:
    """Where a run stands: the ``step`` that was stored last, how many are stored of how many, and seconds left."""

    step: int
    stored: int
    total: int
    seconds_left: float
    point: Point


def run(
    plan: Plan,
    bench: Bench,
    file: RunFile,
    *,
    control: Control | None = None,
    warm_up_s: float = 0.0,
    attempts: int = 1,
    report: Callable[[RunProgress], None] | None = None,
) -> str:
    """Takes the steps that the file lacks, in order, and says why it ended: "complete", or "ended" by ``control``.

    ``report`` hears of every step once its point is on the disk. ``warm_up_s`` drives through the plan for so long
    before the first of them, without reading. A step may take ``attempts``: what went wrong on a line (no answer, one
    that is not understood, a lost connection) may be better with new connections, while a limit switch or a lost beam
    is not. After a pause and in a run that was interrupted, the first step is approached as the plan has it. Raises
    :class:`~sherkit.errors.InstrumentError` where an instrument fails: the motors then stand, the file's diary says
    why, and the run can be resumed.
    """
    control = control or Control()
    bench.check(plan.places())
    done = file.done()
    missing = [n for n in range(len(plan)) if n not in done]
    if not missing:
        return "complete"
    file.begin(bench.identities())
    number = missing[0]
    why = "killed"
    try:
        _warm_up(plan, bench, warm_up_s, control)
        why = _take(plan, bench, file, missing, control, attempts, report)
    except BaseException as error:
        said = str(error) if isinstance(error, SherkitError) else type(error).__name__
        why = f"failed: {said}"
        number = next((n for n in missing if n not in file.done()), number)
        file.note(said, number)
        raise
    finally:
        file.end(why)
    return why


def _take(
    plan: Plan,
    bench: Bench,
    file: RunFile,
    missing: list[int],
    control: Control,
    attempts: int,
    report: Callable[[RunProgress], None] | None,
) -> str:
    total = len(plan)
    seconds = 0.0
    last = -2
    for k, number in enumerate(missing):
        if control.paused:
            file.note("paused", number)
            control.wait()
            file.note("resumed", number)
            last = -2
        if control.ended:
            return "ended"
        began = time.monotonic()
        point = _with_directions(_measured(plan, bench, file, number, number == last + 1, attempts), plan, number)
        file.store(number, point)
        last = number
        took = time.monotonic() - began
        seconds = took if not k else seconds + max(_NEWEST, 1.0 / (k + 1)) * (took - seconds)
        if report is not None:
            report(RunProgress(number, total - len(missing) + k + 1, total, seconds * (len(missing) - k - 1), point))
    return "complete"


def _measured(plan: Plan, bench: Bench, file: RunFile, number: int, follows: bool, attempts: int) -> Point:
    """The step's point. After a fault of a line all ports are opened anew, and the step is approached as planned."""
    for left in range(attempts - 1, -1, -1):
        try:
            if not follows:
                for place in plan.lead_in(number):
                    bench.drive(place)
            return bench.measure(plan.steps[number])
        except (Timeout, Garbled, Disconnected) as error:
            if not left:
                raise
            file.note(f"tried again after: {error}", number)
            follows = False
            bench.close()
            bench.connect()
    raise AssertionError("unreachable")


def _with_directions(point: Point, plan: Plan, number: int) -> Point:
    """The side from which each joint came: rows that are sorted anew would no longer show it."""
    directions = {f"direction_{k + 1}": float(d) for k, d in enumerate(plan.directions[number])}
    return Point(point.pose, point.repeat, point.time_s, {**point.values, **directions})


def _warm_up(plan: Plan, bench: Bench, seconds: float, control: Control) -> None:
    """Drives through the plan without reading."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        for step in plan:
            if time.monotonic() > end or control.ended:
                return
            bench.drive(step.joints)
