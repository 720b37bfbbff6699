"""The loop: asks for rows, is told what was read, and knows when it is enough."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property, partial
from os import PathLike
from typing import Any

import numpy as np
import polars as pl

from ..base import linalg
from ..base.arguments import Count, Level, NotNegative, Positive, Seed, as_annotated
from ..data import Measurements
from ..data.columns import POSE, REASON, REPEAT, TIME
from ..diagnosis import Diagnosis
from ..errors import SherkitError
from ..fit.error import axes_of
from ..model.kinds import kind_of, model_of
from ..model.kinds import required_um as stated_um
from ..model.robot_file import RobotLike, load_robot
from . import rule, told
from .batch import Batches, next_pose
from .conclusion import Conclusion, Held, Progress, conclude, progress
from .kept import Kept
from .known import Known
from .look import Look, look
from .region import Region
from .rule import State
from .unread import mistaken, unread_cells
from .vouching import against, told_of

#: Readings to begin with at least, and those beyond the parameters.
_START, _BEYOND = 12, 8
#: Readings in a batch and in all, unless it is said.
BATCH, BUDGET = 4, 400


class Adaptive(Kept):
    """Chooses poses, is told what was read there, and ends when it is known what is missing.

    ``required_um`` is the accuracy that the robot is for (its file's, if left out), ``budget`` the most readings,
    ``span_min`` over how many minutes it is to be judged, ``box`` maps joints or coordinates to (low, high) where less
    than the whole workspace is meant, ``level`` is the chance of an alarm at any look where nothing is missing,
    ``batch`` how many readings lie between two looks. Raises :class:`~sherkit.errors.ExperimentError` for a robot whose
    file does not say how far it may go.

        loop = sk.Adaptive("robot.toml", required_um=20, budget=400, span_min=30)
        while not loop.done:
            loop.tell(measure(loop.ask()))
        print(loop.verdict, loop.effects)

    The rule is in :mod:`~sherkit.adaptive.rule`, the evidence in :mod:`~sherkit.evidence.reference`. All that it holds
    follows from the rows.
    """

    @as_annotated
    def __init__(
        self,
        robot: RobotLike,
        *,
        required_um: Positive | None = None,
        budget: Count = BUDGET,
        span_min: NotNegative = 0.0,
        box: Mapping[str, Sequence[float]] | None = None,
        level: Level = 0.01,
        batch: Count = BATCH,
        seed: Seed = 0,
        minutes: Positive | None = None,
    ) -> None:
        self.robot = load_robot(robot) if isinstance(robot, str | PathLike) else robot
        self.model = model_of(self.robot)
        self.layout = kind_of(self.robot).layout
        self.required_um = required_um if required_um is not None else stated_um(self.robot)
        self.budget, self.span_min, self.level, self.batch, self.seed = budget, span_min, level, batch, seed
        self.minutes = minutes
        self.box = {name: [float(end) for end in ends] for name, ends in (box or {}).items()}
        self.region = Region.of(self.model, self.layout, self.box)
        self._batches = Batches(self.robot, self.layout, self.region, self.batch, self.span_min, self.seed)
        self._frame = pl.DataFrame()
        self._begin_anew()

    def _begin_anew(self) -> None:
        self._known: Known | None = None
        self._looks: list[tuple[Look, State]] = []
        self._progress: list[Progress] = []
        self._asked: list[dict[str, Any]] = []
        self._asked_at = -1
        self._looked = 0
        self._blind = ""
        self._against: tuple[str, ...] = ()
        self._stuck: tuple[str, ...] = ()
        self._concluded: tuple[int, Conclusion] | None = None

    # -- what it holds -----------------------------------------------------------------------------------

    @cached_property
    def start(self) -> int:
        """Readings before the first look: as many as tell the parameters, and a few more."""
        axes = max(len(self.layout.coordinates), 1)
        return min(max(_START, -(-(len(self.model.parameters) + _BEYOND) // axes)), self.budget)

    @property
    def readings(self) -> int:
        """Rows that were told."""
        return self._frame.height

    @property
    def data(self) -> Measurements:
        """What was told, in the order of time. Raises :class:`~sherkit.errors.MeasurementError` before that."""
        return told.in_time(self._frame, self.robot, self.model, self.layout)

    @property
    def last(self) -> Look | None:
        """The last look."""
        return self._looks[-1][0] if self._looks else None

    @property
    def looks(self) -> tuple[Look, ...]:
        """Every look so far."""
        return tuple(found for found, _ in self._looks)

    @property
    def progress(self) -> tuple[Progress, ...]:
        """How far off the models were, look by look, at readings that they were not fitted to yet."""
        looks = self.looks
        for k in range(len(self._progress), len(looks)):
            self._progress.append(progress(looks[k - 1] if k else None, looks[k], self.seed))
        return tuple(self._progress)

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why each of the rows was driven, in the order of time; empty where that was not told."""
        if REASON not in self._frame.columns:
            return ()
        why = [one or "" for one in self._frame[REASON].to_list()]
        order = np.argsort(self._read(self._frame).order, kind="stable")
        return tuple(why[k] for k in order)

    @property
    def state(self) -> State:
        """What is held after the last look."""
        return self._looks[-1][1] if self._looks else State()

    @property
    def done(self) -> bool:
        """Whether it is known, or cannot be, or the budget is spent."""
        return self.conclusion.done

    @property
    def verdict(self) -> str:
        """``adequate``, ``explained``, ``partly explained``, ``unexplained`` or ``undecided``; so far until it is
        done."""
        return self.conclusion.verdict

    @property
    def effects(self) -> tuple[str, ...]:
        """The effects that are missing; the leading ones where others explain as well."""
        return self.conclusion.effects

    @property
    def indistinguishable(self) -> tuple[tuple[str, ...], ...]:
        """Groups of effects that these rows cannot tell apart, the leading one first."""
        return self.conclusion.indistinguishable

    @property
    def why(self) -> str:
        """Why it ended, in a sentence; empty while it goes on."""
        return self.conclusion.why

    @property
    def notes(self) -> tuple[str, ...]:
        """What could not be seen and from which size on it would have been, and what else is to be known."""
        return self.conclusion.notes

    @property
    def accuracy_um(self) -> float | None:
        """How far off the calibrated robot may be anywhere in the region, in 95 of 100 cases; None where it is not
        known yet."""
        return self.conclusion.accuracy_um

    @property
    def diagnosis(self) -> Diagnosis:
        """The diagnosis of all rows, with the verdict of the loop. Raises :class:`~sherkit.errors.FitError` while they
        are too few."""
        return self.conclusion.diagnosis

    def __repr__(self) -> str:
        return f"Adaptive({self.sentence()})"

    def sentence(self) -> str:
        """Where it stands, in one line: readings, verdict so far, the leading three with their evidence."""
        end = self.conclusion
        leading = ", ".join(f"{name} {value / np.log(10.0):+.1f}" for name, value in end.evidence)
        known = f", within {end.accuracy_um:.3g} µm" if end.accuracy_um is not None else ""
        evidence = 0.0 if self.last is None else self.last.log_evidence / float(np.log(10.0))
        new = self.progress[-1] if len(self._looks) > 1 else None
        off = ""
        if new is not None and np.isfinite(new.by_lead):
            unit, led = self.layout.unit, new.by_lead < new.by_geometry
            without = f" ({new.by_geometry:.3g} {unit} by the geometry alone)" if led else ""
            off = f"; off by {new.by_lead:.3g} {unit} at the readings since the look before{without}"
        off += "".join(f"; {one}" for one in self._first)
        return (
            f"{self.readings} readings: {self.verdict}{known}; evidence that something is missing 1e{evidence:.1f}; "
            f"leading (powers of ten): {leading or 'nothing yet'}{off}"
        )

    @property
    def _first(self) -> tuple[str, ...]:
        """What is to be looked at, said before all else."""
        apart = told_of(self.last) if self.last is not None else ""
        return tuple(one for one in (*self._stuck, *self._against[:1], self._blind, apart) if one)

    def told(self) -> tuple[str, ...]:
        """What it found, in sentences for people."""
        end = self.conclusion
        named = ", ".join(end.effects)
        out = [f"{end.verdict}{f': {named}' if named else ''}"]
        out += [f"{' or '.join(tie)}: these readings cannot tell" for tie in end.indistinguishable]
        if end.accuracy_um is not None:
            needed = "" if self.required_um is None else f" ({self.required_um:g} µm needed)"
            out.append(
                f"calibrated, it is within {end.accuracy_um:.3g} µm anywhere in the region, in 95 of 100 cases{needed}"
            )
        return (*out, *end.notes)

    @property
    def conclusion(self) -> Conclusion:
        """All of the above, made once for the rows that there are."""
        if self._concluded is None or self._concluded[0] != self.readings:
            # of the rows and not of this loop, which would then outlive who forgets it, and its lock with it
            data = partial(told.in_time, self._frame, self.robot, self.model, self.layout)
            held = Held(
                self.robot, data, self.readings, self.last, self.state, self.budget,
                self.minutes, self.span_min, self.required_um, self.level, self.seed,
                tuple(told.incomplete(self._frame, self.layout)), self._stuck, self._against, self._blind,
            )  # fmt: skip
            self._concluded = (self.readings, conclude(held))
        return self._concluded[1]

    # -- asking ------------------------------------------------------------------------------------------

    def ask(self) -> list[dict[str, Any]]:
        """The rows to read next, in this order: ``pose`` and ``repeat``, the joints as a run file names them, where
        they lead, the ``reason``, and ``not_before_s``, the run's clock before which a row should not be read (0 where
        that does not matter). Empty once it is done."""
        if self.done:
            return []
        boundary = self._boundary
        if self._asked_at != boundary:
            self._asked, self._asked_at = self._planned(boundary), boundary
        known = set(told.poses(self._frame))
        missing = boundary - self.readings
        left = [one for one in self._asked if (one[POSE], one[REPEAT]) not in known]
        return left[:missing] if len(left) >= missing else [*left, *self._more(missing - len(left), boundary)]

    @property
    def _boundary(self) -> int:
        """How many rows there are at the next look."""
        return min(self._looked + self.batch if self._looked else self.start, self.budget)

    def _planned(self, boundary: int) -> list[dict[str, Any]]:
        rng = np.random.default_rng([self.seed, boundary])
        taken = told.poses(self._frame)
        if not self._looked:
            return self._batches.first(boundary, taken, rng)
        count = boundary - self._looked
        if self.last is None or self._blind:
            # nothing is known that could choose: what was read may come right again
            return self._batches.anywhere(count, next_pose(taken), rng)
        return self._batches.chosen(self.last, self.state, count, boundary, taken, self.data, rng)

    def _more(self, count: int, boundary: int) -> list[dict[str, Any]]:
        """Rows anywhere in place of those that came back as others than were asked."""
        rng = np.random.default_rng([self.seed, boundary, self.readings])
        first = max([next_pose(told.poses(self._frame)) - 1, *(one[POSE] for one in self._asked)]) + 1
        return self._batches.anywhere(count, first, rng)

    # -- telling -----------------------------------------------------------------------------------------

    def tell(self, rows: Any) -> None:
        """Takes what was read: rows as they were asked, with readings and any other column, as a list of dicts, a
        frame, columns by name, measurements or a file.

        Rows may be fewer, more, later or elsewhere than asked; those that were told before are known. Raises
        :class:`~sherkit.errors.MeasurementError` for what are no rows of this robot, and nothing is taken then.
        """
        frame = told.frame_of(rows)
        if not frame.height:
            return
        whole = told.added(self._frame, told.taken(frame, self._asked, self.region.targets, self.layout), self.layout)
        data = self._read(whole)
        late = self._frame.height and TIME in whole.columns and self._looks and data.time_s is not None
        if late and (data.time_s[self._frame.height :] < data.time_s[: self._frame.height].max()).any():  # type: ignore[index]
            self._begin_anew()
        self._frame = whole
        self._advance()
        self._close_if_done()

    def _read(self, frame: pl.DataFrame) -> Measurements:
        return told.measurements(frame, self.robot, self.model, self.layout)

    @linalg.one_thread()
    def _advance(self) -> None:
        """Looks wherever a batch is whole."""
        while self.readings >= self._boundary > self._looked:
            boundary = self._boundary
            some = self.data.select(np.arange(boundary))
            stuck = unread_cells(self.model, self.region, some)
            self._stuck, self._blind, self._against = stuck.sentences, "", ()
            if stuck.too_many(self.batch):
                self._blind = "what is left of these readings tells nothing"
            else:
                try:
                    self._look_at(stuck.without(some))
                except SherkitError as error:
                    self._against = mistaken(self.model, some)
                    self._blind = f"{boundary} readings cannot be fitted: {error}"
            self._looked = boundary

    def _look_at(self, some: Measurements) -> None:
        if self._known is None:
            axes = axes_of(some)
            self._known = Known.of(
                self.model.for_run(some), self.region, some, axes, max(60.0 * self.span_min, 600.0)
            )
        found = look(self._known, some, self.last)
        spanned = some.time_s is None or float(np.ptp(some.time_s)) >= 60.0 * self.span_min * (1 - 1e-9)
        self._against = against(found, self.required_um, self.level, self.seed)
        state = rule.after(self.state, found, spanned=spanned, vouched=not self._against, level=self.level)
        self._looks.append((found, state))
