"""The runner: step by step through a plan, each point stored before the next begins; and what a model makes of them."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import cycle, pairwise

import numpy as np
import polars as pl

from ...base.types import Floats
from ...data import Measurements, from_frame
from ...data.columns import POSE, REPEAT, TIME
from ...errors import Disconnected, FitError, Garbled, Implausible, OutOfRange, SherkitError, Timeout
from ...fit.identify import Fit, identify
from ...model.kinds import Robot, kind_of, model_of
from ..instruments.transport import now_s
from .bench import Bench
from .plan import Plan, Point
from .run_file import RunFile
from .watch import RunWarning

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
    more: Callable[[Plan], Plan | None] | None = None,
) -> str:
    """Takes the steps that the file lacks, in order, and says why it ended: "complete", or "ended" by ``control``.

    ``report`` hears of every step once its point is on the disk. ``warm_up_s`` drives through the plan for so long
    before the first of them, without reading. A step may take ``attempts``: what went wrong on a line (no answer, one
    that is not understood, a lost connection) may be better with new connections, while a limit switch or a lost beam
    is not. ``more`` is asked when all steps are taken: it gives a plan that goes on, or None where it is enough. After
    a pause and in a run that was interrupted, the first step is approached as the plan has it.

    Nothing moves before it is proven where the axes stand (:meth:`~sherkit.lab.experiment.Bench.prove`): in a run that
    goes on, where the last row was taken, on the way from there to the next step, or where the plan begins. Each row is
    held against those before (:class:`~sherkit.lab.experiment.watch.Watch`); where it cannot be, it is marked and the
    run ends. Raises :class:`~sherkit.errors.InstrumentError` where an instrument fails: the motors then stand, the
    file's diary says why, and the run can be resumed.
    """
    bench.check(plan.places())
    return _Run(plan, bench, file, control or Control(), warm_up_s, attempts, report, more).whole()


@dataclass
class _Run:
    """A run, as :func:`run` was asked for it; its plan may grow."""

    plan: Plan
    bench: Bench
    file: RunFile
    control: Control
    warm_up_s: float
    attempts: int
    report: Callable[[RunProgress], None] | None
    more: Callable[[Plan], Plan | None] | None

    def whole(self) -> str:
        """From beginning to end."""
        done = self.file.done()
        missing = [n for n in range(len(self.plan)) if n not in done] or self._grown()
        if not missing:
            return "complete"
        self.file.begin(self.bench.identities())
        self._watch = self.bench.watch()
        why = "killed"
        try:
            self._prove(missing[0], self.warm_up_s)
            self._watch.learn(self.file.points())
            self._look()
            self._warm_up()
            why = self._take(missing, -2)
            while why == "complete" and (further := self._grown()):
                missing = further
                # it is approached from where the batch before ended
                why = self._take(missing, missing[0] - 1)
        except BaseException as error:
            said = str(error) if isinstance(error, SherkitError) else type(error).__name__
            why = f"failed: {said}"
            done = self.file.done()
            self.file.note(said, next((n for n in missing if n not in done), missing[0]))
            raise
        finally:
            self.file.end(why)
        return why

    def _grown(self) -> list[int]:
        """The new steps of the plan that goes on, once it is on the disk; none where there is none."""
        plan, grown = self.plan, None if self.more is None else self.more(self.plan)
        if grown is None or len(grown) == len(plan):
            return []
        self.bench.check(grown.places()[len(plan.places()) :])
        self.file.grow(grown)
        self.plan = grown
        return list(range(len(plan), len(grown)))

    def _take(self, missing: list[int], last: int) -> str:
        """Takes steps; the robot stands where step ``last`` was taken."""
        plan, file, control = self.plan, self.file, self.control
        seconds = 0.0
        for k, number in enumerate(missing):
            if control.paused:
                file.note("paused", number)
                control.wait()
                file.note("resumed", number)
                last = -2
            # not before the host's clock shows so much, or the run is to end; the motors stand
            while not control.ended and (early_s := plan.steps[number].not_before_s - now_s()) > 0:
                time.sleep(min(_PAUSE_POLL_S, early_s))
            if control.ended:
                return "ended"
            began = time.monotonic()
            point = self._measured(number, number == last + 1)
            # the side from which each joint came: rows that are sorted anew would no longer show it
            directions = {f"direction_{j + 1}": float(d) for j, d in enumerate(plan.directions[number])}
            point = file.store(number, replace(point, values={**point.values, **directions}))
            last = number
            if (doubt := self._watch.take(number, point)) is not None:
                file.doubt(doubt.steps, doubt.instrument, doubt.why)
                steps = ", ".join(map(str, doubt.steps))
                raise self._implausible(doubt, f"rows of the steps {steps} are marked, and are taken again by --resume")
            took = time.monotonic() - began
            seconds = took if not k else seconds + max(_NEWEST, 1.0 / (k + 1)) * (took - seconds)
            if self.report is not None:
                left, total = len(missing) - k - 1, len(plan)
                self.report(RunProgress(number, total - left, total, seconds * left, point))
        return "complete"

    def _measured(self, number: int, follows: bool) -> Point:
        """The step's point. After a fault of a line all ports are opened anew; the step is approached as planned."""
        for left in range(self.attempts - 1, -1, -1):
            try:
                if not follows:
                    for place in self.plan.lead_in(number):
                        self.bench.drive(place)
                return self.bench.measure(self.plan.steps[number])
            except (Timeout, Garbled, Disconnected) as error:
                if not left:
                    raise
                self.file.note(f"tried again after: {error}", number)
                follows = False
                self.bench.close()
                self.bench.connect()
                self._prove(number, 0.0)
        raise AssertionError("unreachable")

    def _prove(self, number: int, warm_up_s: float) -> None:
        """Refuses to move where the axes do not stand where they can be, as far as the run's file tells."""
        plan, file = self.plan, self.file
        last = file.last()
        legs: list[tuple[Sequence[float], Sequence[float]]] = []
        if last is not None:
            at = tuple(last.values[name] for name in kind_of(self.bench.robot).layout.joints)
            way = (at, *plan.lead_in(number), *plan.steps[number].via, plan.steps[number].joints)
            legs = [*pairwise(way), (plan.start, plan.start), (plan.start, way[1])]
            if warm_up_s > 0:
                legs += pairwise([plan.start, *(s.joints for s in plan), plan.start])
        elif not self.bench.motion.reference().said:
            # it cannot tell whether it was zeroed: then only where a person has brought it
            legs = [(plan.start, plan.start)]
        mark = self.bench.prove(legs)
        if file.reference not in (None, mark):
            file.note("the reference of the axes was set anew", number)
        file.reference = mark

    def _look(self) -> None:
        """Before anything moves: whether the sensors, where they see the robot, see it where the joints say."""
        try:
            seen = self.bench.look()
        except (OutOfRange, Garbled):
            # nothing is to be seen from here, or it still swings; each step will tell
            return
        if (doubt := self._watch.judge(self.file.dated(seen))) is not None:
            raise self._implausible(doubt, "nothing was moved. Look at the instrument, or run 'sherkit home'")

    def _implausible(self, doubt: RunWarning, what: str) -> Implausible:
        port = next((i.address for i in self.bench.instruments if i.name == doubt.instrument), "")
        return Implausible(f"{doubt.why}; {what}", instrument=doubt.instrument, port=port)

    def _warm_up(self) -> None:
        """Drives through the plan without reading."""
        end = time.monotonic() + self.warm_up_s
        for step in cycle(self.plan):
            if time.monotonic() >= end or self.control.ended:
                return
            self.bench.drive(step.joints)


# -- identification while the rows come in ----------------------------------------------------------------------------

#: A fit is taken anew when the rows have grown by this share: the work stays proportional to the rows.
_GROWTH = 0.02


#: What a goal can be set for: where the model puts the robot, or each of its parameters.
GOALS = ("position", "parameters")


@dataclass(frozen=True)
class Goal:
    """How well the model is to be known: the largest standard deviation ``std``, in the unit that people read.

    ``of`` "position": of any coordinate that the model predicts at any pose of the plan, measured yet or not. Of
    "parameters": of any of them, angles at their lever, µm, from the readings alone: directions that no pose can
    observe do not count. Neither says what physics is missing. With ``stop`` the run ends where the goal is reached.
    """

    std: float
    of: str = "position"
    stop: bool = False


class Live:
    """Takes points, and says what the model makes of them: the fit of the rows so far, or else the drawing.

    ``residual`` is that of the newest point, before it was fitted: root of the sum over its readings squared, in
    ``unit``. ``worst`` is the name and standard deviation, in ``goal_unit``, of what is known worst (coordinate or
    parameter, see :class:`Goal`), None while too few rows are there. Without ``fitting`` there is no fit, and
    residuals are those of the drawing.
    """

    def __init__(self, robot: Robot, plan: Plan, goal: Goal | None = None, *, fitting: bool = True) -> None:
        self.model = model_of(robot)
        self.goal = goal
        self.fitting = fitting
        self.unit = kind_of(robot).layout.unit
        self.goal_unit = "µm" if goal is not None and goal.of == "parameters" else self.unit
        self._joints = np.unique(np.array([s.joints for s in plan]), axis=0)
        self.fit: Fit | None = None
        self.residual: float | None = None
        self.worst: tuple[str, float] | None = None
        self._points: list[Point] = []
        self._fitted = 0

    @property
    def rows(self) -> int:
        """Points that were taken in."""
        return len(self._points)

    @property
    def enough(self) -> bool:
        """Whether the goal is reached: further poses no longer help."""
        return self.goal is not None and self.worst is not None and self.worst[1] <= self.goal.std

    @property
    def rows_to_go(self) -> int | None:
        """Rows that are still needed if standard deviations go on falling with the root of their number."""
        if self.goal is None or self.worst is None:
            return None
        needed = self._fitted * (self.worst[1] / self.goal.std) ** 2
        return max(int(np.ceil(needed)) - self.rows, 0)

    def sentence(self) -> str:
        """How well the model is known, and whether further poses help."""
        if self.worst is None:
            return f"{self.rows} rows are too few for a fit"
        (what, std), unit = self.worst, self.goal_unit
        known = f"after {self.rows} rows, {what} is known to {std:.3g} {unit} (standard deviation), all else better"
        if self.goal is None:
            return known
        more = "further poses no longer help" if self.enough else f"about {self.rows_to_go} more rows"
        return f"{known}; the goal is {self.goal.std:g} {unit}: {more}"

    def short(self) -> str:
        """The same in a few words, for a line that changes."""
        if self.residual is None:
            return ""
        out = f"residual {self.residual:.3g} {self.unit}"
        if self.fit is None:
            return f"{out} from the drawing"
        return out if self.worst is None else f"{out}, {self.worst[0]} ±{self.worst[1]:.3g} {self.goal_unit}"

    def take(self, point: Point) -> None:
        """Takes a point in without fitting it: call :meth:`refit` after the last one."""
        self._points.append(point)

    def add(self, point: Point) -> None:
        """Takes a point in; fits anew where enough rows have come since the last fit."""
        self.take(point)
        self.residual = self._residual(point)
        if self.fitting and len(self._points) >= max(self._fitted * (1.0 + _GROWTH), self._fitted + 1):
            self.refit()

    def refit(self) -> None:
        """Fits the rows so far."""
        if not self._points:
            return
        try:
            data = self._measurements(self._points)
            # from the drawing each time: a start elsewhere would stay in directions that no reading observes
            self.fit = identify(self.model, data)
        except FitError:
            # too few rows for the parameters: nothing can be said yet
            return
        self._fitted = len(self._points)
        free = data.taken.sum() - self.fit.rank
        if free <= 0:
            return
        names, std = self._std(self.fit)
        k = int(np.argmax(std))
        self.worst = (names[k], float(std[k]))

    def _std(self, fit: Fit) -> tuple[tuple[str, ...], Floats]:
        if self.goal is not None and self.goal.of == "parameters":
            lever = np.array([1e3 * p.lever_mm for p in fit.parameters])
            return tuple(p.name for p in fit.parameters), fit.std_from_readings * lever
        rows = fit.data.unmeasured(self._joints)
        by = self.model.derivatives(rows, fit.values)[:, : rows.coordinates]
        # what the readings do not tell counts with its plausible size where it moves a coordinate
        variance = np.einsum("nap,pq,naq->na", by, fit.covariance + fit.unobserved_covariance, by)
        std = rows.layout.per_unit * np.sqrt(variance.clip(0.0).max(axis=0))
        return rows.layout.names[: rows.coordinates], std

    def _residual(self, point: Point) -> float:
        data = self._measurements([point])
        values = np.zeros(len(self.model.parameters)) if self.fit is None else self.fit.values
        left = np.where(data.taken, data.readings - self.model.predict(data, values), 0.0)
        return float(data.layout.per_unit * np.sqrt((left**2).sum()))

    def _measurements(self, points: list[Point]) -> Measurements:
        first = self._points[0].time_s
        frame = pl.DataFrame(
            [{TIME: p.time_s - first, **p.values, POSE: p.pose, REPEAT: p.repeat} for p in points],
            infer_schema_length=None,
        )
        return from_frame(frame.with_columns(pl.col(pl.Float64).fill_nan(None)), "the run so far")
