"""What stands behind the page: a study, one worker that changes it, and a folder that holds every step of it.

Nothing here knows of a browser. Work runs in one thread, in order; what a page shows is a :class:`PageState`, a value
that no later work changes.
"""

from __future__ import annotations

import copy
import getpass
import itertools
import json
import shlex
import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import replace
from pathlib import Path
from typing import IO, Any, TypeVar

import numpy as np

from ..base.figures import state_with
from ..data import Measurements, read_measurements
from ..data.called import Columns
from ..data.files import write_whole
from ..diagnosis import Diagnosis
from ..errors import MeasurementError, SherkitError, SherkitWarning
from ..model.effect import load_effects
from ..model.kinds import required_um
from ..model.robot_file import columns_of
from ..report.card import drawing_of
from ..report.residuals import ModelState
from ..report.scene import space_of
from ..report.states import states_so_far
from ..robots.machine import is_machine, robot_at
from ..study import Study
from .folder import SOURCES, TYPED, Typed, begun_from, hold, read_as, read_so_far, require_effects, require_same
from .page_state import EXPORTS, FILES, HISTORY, LINES, ROWS, PageState, Said
from .sandbox import Worker

T = TypeVar("T")
Progress = Callable[[str], None]


class Workbench:
    """A study that people change by hand, in a ``folder`` from which it is reopened.

    ``listen`` is told of every new moment, of progress (a sentence, empty when there is none), of errors and warnings.
    """

    def __init__(
        self, study: Study, folder: Path, sources: Sequence[Path] = (), *, trusted: bool = True,
        typed: Typed | None = None, columns: Columns | None = None, lock: IO[str] | None = None,
    ) -> None:  # fmt: skip
        self.folder = folder
        self.trusted = trusted
        self.sources = list(sources)
        self.columns = columns
        self._study = study
        self._listeners: list[Callable[[str, Any], None]] = []
        self._worker = Worker(lambda: self._say("progress", ""))
        self._typed = typed or Typed(folder / TYPED)
        self._typed.look = self._worker.look
        self._number = 0
        #: The last diagnosis: what it knows of the noise holds until the next one.
        self._found: Diagnosis | None = None
        self._warned: set[str] = set()
        self._followed: tuple[int, int] | None = None
        #: Rows that the run had when it was followed last.
        self._run_rows = 0
        self._held = lock
        self.page_state = self._page_state()
        self.progress = ""

    # -- opening -----------------------------------------------------------------------------------------

    @classmethod
    def open(
        cls, robot: Path, run: Path, folder: Path, *, files: Sequence[Path] = (), fresh: bool = False,
        trusted: bool = True, run_typed: bool = False, follow: bool = False,
    ) -> Workbench:  # fmt: skip
        """Reopens the study of a folder, or begins one there.

        ``files`` hold the user's effects; effects that were typed into the page are run again only where ``run_typed``
        says so. With ``follow`` the run may have grown since. Raises :class:`~sherkit.errors.SherkitError` where the
        folder holds a study of other files or one that needs effects which are not given, and where another page has it
        open.
        """
        nominal, _ = robot_at(robot)
        columns: Columns = getattr(nominal, "columns", {}) if is_machine(robot) else columns_of(robot)
        own = [e for path in files for e in load_effects(path)]
        lines = Typed(folder / TYPED)
        sources = [robot, run, *files]
        if folder.exists() and not folder.is_dir():
            raise SherkitError(f"{folder}: is a file, expected the folder of a study; give --study with another name")
        known = (folder / "study.json").exists() and not fresh
        data = read_so_far(run, columns) if follow else read_measurements(run, columns=columns)
        if known:
            require_same(folder, robot, run, follow=follow)
        held = hold(folder)
        if known:
            again = lines.again() if run_typed else ()
            try:
                require_effects(folder, {e.name for e in (*own, *again)}, lines.path)
                study = Study.load(folder, effects=[*own, *again])
            except SherkitError:
                raise
            except Exception as error:  # a file of the folder that was changed or cut by hand
                raise SherkitError(
                    f"{folder}: holds a study that cannot be read ({_sentence(error)}); "
                    "give --fresh to begin anew there"
                ) from error
        else:
            study = Study(nominal, data, effects=own)
            try:
                write_whole(folder / SOURCES, json.dumps(begun_from(robot, run, follow=follow)))
                study.save(folder)
            except OSError as error:
                raise SherkitError(f"{folder}: the study cannot be kept here: {error.strerror}") from None
        return cls(study, folder, sources, columns=columns, trusted=trusted, typed=lines, lock=held)

    def listen(self, listener: Callable[[str, Any], None]) -> Callable[[], None]:
        """Tells ``listener`` of ``moment``, ``space``, ``progress``, ``error`` and ``warning``, as (kind, value).

        Returns what ends it.
        """
        self._listeners.append(listener)
        return lambda: self._listeners.remove(listener) if listener in self._listeners else None

    def close(self) -> None:
        """Stops the work and waits for it."""
        self._worker.close()
        self._typed.end()
        if self._held is not None:
            self._held.close()

    # -- work --------------------------------------------------------------------------------------------

    def _say_if_it_changed(self, found: Diagnosis) -> None:
        """Of joined runs that one model does not explain: who asks what has changed between them."""
        runs = [one for one in self.sources[1:] if one.suffix.lower() != ".py"]
        if len(runs) > 1 and found.verdict in ("partly explained", "unexplained"):
            files = shlex.join(map(str, (self.sources[0], *runs)))
            told = (
                f"one model does not explain these runs together; what has changed is said by: sherkit compare {files}"
            )
            self._say("warning", Said(told, FILES))

    def ask(self, what: str, work: Callable[[Study, Progress], T]) -> Future[T]:
        """Runs ``work`` on the study when its turn comes; errors go to the caller, not to the listeners."""
        return self._worker.submit(lambda: work(self._study, self._step(what)))

    def change(self, what: str, work: Callable[[Study, Progress], object], *, about: str = "") -> Future[None]:
        """Runs a change; then the study is saved, shown, and diagnosed anew. A diagnosis under way gives way.

        What goes wrong is said beside the control that the change is ``about``.
        """
        done = self._worker.submit(lambda: self._apply(what, work, about), first=True)
        self.diagnose()
        return done

    def diagnose(self) -> Future[None]:
        """Asks what is missing now; other changes that wait go first."""

        def run() -> None:
            if self._worker.unwanted or self.page_state.diagnosis is not None:
                return
            try:
                step = self._step("diagnosing")
                found = self._found = self._study.diagnose(step=step)
                if self._study.history[-1] is not self.page_state.history[-1]:
                    # other rows are left out now
                    self.page_state = self._page_state()
                without = {}
                for name in self.page_state.effects:
                    step(f"without {name}")
                    without[name] = self._study.without(name).error.rms
                drawings = self._drawings(found, step)
                self.page_state = replace(
                    self.page_state, states=states_so_far(self._study, found), diagnosis=found, without=without,
                    drawings=drawings,
                )  # fmt: skip
                self._say("moment", self.page_state)
                self._say_if_it_changed(found)
                self.page_state = replace(self.page_state, space=self._space(step))
                self._say("space", self.page_state)
            except BaseException as error:
                self._told_of(error, "diagnosing", HISTORY)

        return self._worker.submit(run, gives_way=True)

    def _drawings(self, found: Diagnosis, step: Progress) -> dict[str, str]:
        """The machine with each of the user's own effects, exaggerated; their lines are asked in this thread alone."""
        out = {}
        for name in self.page_state.own:
            fit = found.fit if name in found.effects else self.page_state.history[-1].fit
            if fit is not None and name in (*found.effects, *self.page_state.effects):
                step(f"drawing {name}")
                out[name] = drawing_of(self.page_state.known[name], fit.model, fit)
                self._typed.forgive()
                step("diagnosing")  # what was cancelled meanwhile is not shown as a failure to draw
        return out

    def _space(self, step: Progress) -> str:
        """The workspace with the errors of the first step and the last, or of what is found missing where there is one
        step alone; typed lines are asked in this thread alone."""
        path, found = [*self.page_state.states.values()], self.page_state.diagnosis
        last = path[-1]
        if len(path) == 1 and found is not None and found.effects:
            last = ModelState(state_with(found.effects), found.fit)
        step("drawing the workspace")
        scene = space_of(path[0], last, moment=len(path) - 1, whole=True)
        return "" if scene is None else scene.html()

    def tell(self, error: BaseException, about: str = EXPORTS) -> None:
        """Shows an error on every page."""
        self._say("error", Said(_sentence(error), about))

    def _told_of(self, error: BaseException, what: str, about: str) -> None:
        """Says what ended work: nothing where it gave way by itself."""
        if self._worker.cancelled:
            self._say("warning", Said(f"cancelled: {what}; nothing was changed", about))
        elif not self._worker.unwanted:
            self._say("error", Said(_sentence(error), about))

    def _apply(self, what: str, work: Callable[[Study, Progress], object], about: str) -> None:
        """All of a change, or nothing of it: where it cannot be saved, it did not happen either."""
        before, sources, typed = _copy(self._study), list(self.sources), self._typed.names
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            try:
                work(self._study, step := self._step(what))
                step("")  # what was cancelled meanwhile did not happen
                try:
                    self._study.save(self.folder)
                except OSError as error:
                    said_so = f"the study cannot be saved: {error.strerror}; nothing was changed"
                    raise SherkitError(f"{self.folder}: {said_so}") from error
                self.page_state = self._page_state()
            except BaseException as error:  # whatever a user's effect raises is shown, and nothing is lost
                self._study, self.sources, self._typed.names = before, sources, typed
                self._told_of(error, what, about)
                return
        self._say("moment", self.page_state)
        for one in said:
            text = str(one.message)
            if issubclass(one.category, SherkitWarning) and text not in self._warned:
                self._warned.add(text)
                self._say("warning", Said(text, about))

    @property
    def typed_path(self) -> Path:
        """Where lines that were typed into the page are kept."""
        return self._typed.path

    def cancel(self) -> None:
        """Cancels all that was asked for; the study stays as it was."""
        self._worker.cancel()

    def _step(self, what: str) -> Progress:
        def step(name: str) -> None:
            self._worker.look()
            self._say("progress", f"{what}: {name}" if name else what)

        step("")
        return step

    # -- what a person does ------------------------------------------------------------------------------

    def toggle(self, effect: str) -> Future[None]:
        """Adds an effect, or takes it out where it is in the model."""
        what, work = ("removing", Study.remove) if effect in self.page_state.effects else ("adding", Study.add)
        return self.change(f"{what} {effect}", lambda study, _: work(study, effect), about=effect)

    def undo(self) -> Future[None]:
        """Takes the last change back."""
        return self.change("undoing", lambda study, _: study.undo(), about=HISTORY)

    def redo(self) -> Future[None]:
        """Makes the change again that was taken back last."""
        return self.change("doing again", lambda study, _: study.redo(), about=HISTORY)

    def put_back(self) -> Future[None]:
        """Takes the rows in that are left out as gross errors."""
        return self.change("putting rows back", lambda study, _: study.put_back(), about=ROWS)

    def mark_outliers(self, rows: Sequence[int]) -> Future[None]:
        """Marks rows (from 0) as outliers."""
        count = f"{len(rows)} row{'s' if len(rows) != 1 else ''}"
        return self.change(f"marking {count}", lambda study, _: study.mark_outliers(rows), about=ROWS)

    def add_measurements(self, name: str, content: bytes) -> Future[None]:
        """Joins a CSV or Parquet file, given by name and bytes; a copy stays in the folder."""

        def work(study: Study, _: Progress) -> None:
            if not content:
                raise MeasurementError(f"{name}: is empty; expected a CSV or Parquet file with the run's columns")
            names = (f"added_{k}_{Path(name).name}" for k in itertools.count(len(study.history)))
            path = next(one for one in map(self.folder.joinpath, names) if not one.exists())
            write_whole(path, content)
            try:
                # the file that a person dropped, not the copy of it
                study.extend(read_as(path, name, self.columns))
            except BaseException:
                path.unlink()
                raise
            self.sources.append(path)

        return self.change(f"joining {name}", work, about=FILES)

    def type_effect(self, source: str) -> Future[None]:
        """Runs lines that define effects, with the rights of who started the page, and tries what they define.

        The lines are kept in the folder. Refused where the page can be reached from other machines.
        """

        def work(study: Study, _: Progress) -> None:
            if not self.trusted:
                raise SherkitError("effects cannot be typed here: this page can be reached from other machines")
            self._typed.run(source, study)

        return self.change("running your lines", work, about=LINES)

    def follow(self, run: Path) -> Future[None] | None:
        """Reads the run again where its file has changed; returns None where it has not.

        Rows that come wait for what a person does, and for a diagnosis that is under way: else a run that grows every
        second would never be diagnosed. A last line that is not complete is left for the next time.
        """
        if self._worker.pending:
            return None
        try:
            now = (run.stat().st_size, run.stat().st_mtime_ns)
        except OSError:
            now = (-1, 0)
        if now == self._followed:
            return None
        self._followed = now

        def read() -> None:
            self._step("looking for new rows")
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")  # said when the run was opened
                    data = read_so_far(run, self.columns)
                fresh = self._new_rows(data)
            except BaseException as error:
                self._told_of(error, "reading new rows", FILES)
                return
            if fresh:
                self._apply("reading new rows", lambda study, _: study.follow(data), FILES)
                self.diagnose()

        return self._worker.submit(read)

    def _new_rows(self, data: Measurements) -> bool:
        """Whether a run that is followed has rows that the study lacks.

        Raises :class:`~sherkit.errors.MeasurementError` where it is another run, or has become shorter.
        """
        known, before = self._study.data, self._run_rows
        count = min(len(known), len(data))
        same = np.array_equal(known.joints[:count], data.joints[:count]) and np.array_equal(
            known.readings[:count], data.readings[:count], equal_nan=True
        )
        if len(data) < before:
            raise MeasurementError(
                f"{data.source}: has {len(data)} rows, and had {before} before; the page keeps those it has read"
            )
        if not same and before and len(known) > before:
            raise MeasurementError(
                f"{data.source}: has {len(data) - before} new rows, which cannot be taken: other measurements were "
                "joined after its first ones"
            )
        if not same:
            raise MeasurementError(
                f"{data.source}: its first {count} rows are no longer those that were read before; the page keeps those"
            )
        self._run_rows = len(data)
        return len(data) > len(known)

    # -- moments -----------------------------------------------------------------------------------------

    def _page_state(self) -> PageState:
        study = self._study
        self._number += 1
        return PageState(
            data=study.data,
            left_out=tuple(study.left_out.tolist()),
            effects=study.effects,
            own=tuple(study.own),
            known={**study.model.known_effects, **study.model.held, **study.own},
            history=tuple(study.history),
            states=states_so_far(study, self._found),
            diagnosis=None,
            undoes=study.undoes,
            redoes=study.redoes,
            number=self._number,
            required_um=required_um(study.robot),
        )

    def _say(self, kind: str, value: Any) -> None:
        if kind == "progress":
            self.progress = value
        for listener in list(self._listeners):
            listener(kind, value)


def rights_of() -> str:
    """Whose rights typed lines run with."""
    try:
        return getpass.getuser()
    except (OSError, KeyError):
        return "the person who started this page"


def _sentence(error: BaseException) -> str:
    return str(error) if isinstance(error, SherkitError) else f"{type(error).__name__}: {error}"


def _copy(study: Study) -> Study:
    """A study that later changes of ``study`` leave alone: what it holds are values, in lists and tables of its own."""
    made = copy.copy(study)
    for name, value in vars(made).items():
        if isinstance(value, (list, dict)):
            setattr(made, name, copy.copy(value))
    return made
