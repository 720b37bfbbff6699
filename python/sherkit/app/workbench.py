"""What stands behind the page: a study, one worker that changes it, and a folder that holds every step of it.

Nothing here knows of a browser. Work runs in one thread, in order; what a page shows is a :class:`Moment`, a value that
no later work changes.
"""

from __future__ import annotations

import getpass
import json
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar
from weakref import WeakKeyDictionary

from ..diagnosis import Diagnosis
from ..effects import CATALOGUE, Effect
from ..effects.file import load_effects
from ..errors import EffectError, SherkitError
from ..measurements import Measurements, read_measurements
from ..report.left import Left, left_of
from ..report.story import Source
from ..robots import load_robot
from ..study import Step, Study

T = TypeVar("T")
Progress = Callable[[str], None]

TYPED = "typed_effects.py"
_SOURCES = "sources.json"


class Cancelled(SherkitError):
    """Work that a person stopped."""


@dataclass(frozen=True, eq=False)
class Moment:
    """The study as it stands: model, rows and history, what is left at every step that is known, and a diagnosis
    where it is done.

    ``lefts`` (one for each step of the history) are None where the rows of that step are no longer the rows of today.
    """

    data: Measurements
    effects: tuple[str, ...]
    own: tuple[str, ...]
    history: tuple[Step, ...]
    lefts: tuple[Left | None, ...]
    diagnosis: Diagnosis[Any] | None
    can_undo: bool
    number: int

    @property
    def now(self) -> Left:
        """What the current model leaves."""
        last = self.lefts[-1]
        assert last is not None  # the current step always has a fit
        return last


class Workbench:
    """A study that people change by hand, in a ``folder`` from which it is reopened.

    ``listen`` is told of every new moment, of progress (a sentence, empty when there is none) and of errors.
    """

    def __init__(self, study: Study, folder: Path, sources: Sequence[Path] = (), *, trusted: bool = True) -> None:
        self.folder = folder
        self.trusted = trusted
        self.sources = list(sources)
        self._study = study
        self._worker = ThreadPoolExecutor(1, thread_name_prefix="study")
        self._listeners: list[Callable[[str, Any], None]] = []
        self._stop = threading.Event()
        self._waiting = 0
        self._lock = threading.Lock()
        self._lefts: WeakKeyDictionary[Any, Left] = WeakKeyDictionary()
        self._number = 0
        self._typed: set[str] = set()
        self.moment = self._moment(None)
        self.progress = ""

    # -- opening -----------------------------------------------------------------------------------------

    @classmethod
    def open(
        cls, robot: Path, run: Path, folder: Path, *, files: Sequence[Path] = (), fresh: bool = False,
        trusted: bool = True, run_typed: bool = False,
    ) -> Workbench:  # fmt: skip
        """Reopens the study of a folder, or begins one there.

        ``files`` hold the user's effects; effects that were typed into the page are run again only where ``run_typed``
        says so. Raises :class:`~sherkit.errors.SherkitError` where the folder holds a study of other files, or one that
        needs effects which are not given.
        """
        effects = [e for path in files for e in load_effects(path)]
        typed = folder / TYPED
        hashes = {name: Source.of(path).sha256 for name, path in (("robot", robot), ("run", run))}
        if (folder / "study.json").exists() and not fresh:
            _require_same(folder, hashes)
            if typed.exists() and run_typed:
                effects += load_effects(typed)
            _require_effects(folder, {e.name for e in effects}, typed)
            study = Study.load(folder, effects=effects)
        else:
            study = Study(load_robot(robot), read_measurements(run), effects=effects)
            study.save(folder)
            (folder / _SOURCES).write_text(json.dumps(hashes), encoding="utf-8")
        return cls(study, folder, [robot, run, *files], trusted=trusted)

    def listen(self, listener: Callable[[str, Any], None]) -> Callable[[], None]:
        """Tells ``listener`` of ``moment``, ``progress`` and ``error``, as (kind, value). Returns what ends it."""
        self._listeners.append(listener)
        return lambda: self._listeners.remove(listener) if listener in self._listeners else None

    def close(self) -> None:
        """Stops the work and waits for it."""
        self._stop.set()
        self._worker.shutdown(wait=True)

    # -- work --------------------------------------------------------------------------------------------

    def ask(self, what: str, work: Callable[[Study, Progress], T]) -> Future[T]:
        """Runs ``work`` on the study when its turn comes; errors go to the caller, not to the listeners."""

        def run() -> T:
            self._stop.clear()
            try:
                return work(self._study, self._step(what))
            finally:
                self._say("progress", "")

        return self._worker.submit(run)

    def change(self, what: str, work: Callable[[Study, Progress], object]) -> Future[None]:
        """Runs a change; then the study is saved, shown, and diagnosed anew. A diagnosis under way gives way."""
        with self._lock:
            self._waiting += 1
        self._stop.set()

        def run() -> None:
            with self._lock:
                self._waiting -= 1
            self._stop.clear()
            try:
                work(self._study, self._step(what))
                self._study.save(self.folder)
            except BaseException as error:  # whatever a user's effect raises is shown, and nothing is lost
                self._say("error", _sentence(error))
                self._say("progress", "")
                return
            self._show(None)
            self._say("progress", "")

        done = self._worker.submit(run)
        self.diagnose()
        return done

    def diagnose(self) -> Future[None]:
        """Asks what is missing now; other changes that wait go first."""

        def run() -> None:
            if self._waiting or self.moment.diagnosis is not None:
                return
            self._stop.clear()
            try:
                found = self._study.diagnose(step=self._step("diagnosing"))
            except Cancelled:
                self._say("progress", "")
                return
            except BaseException as error:
                self._say("error", _sentence(error))
                self._say("progress", "")
                return
            self._show(found)
            self._say("progress", "")

        return self._worker.submit(run)

    @property
    def typed_path(self) -> Path:
        """Where lines that were typed into the page are kept."""
        return self.folder / TYPED

    def cancel(self) -> None:
        """Stops the work at its next step; the study stays as it was."""
        self._stop.set()

    def _step(self, what: str) -> Progress:
        def step(name: str) -> None:
            if self._stop.is_set():
                raise Cancelled(f"{what}: stopped")
            self._say("progress", f"{what}: {name}" if name else what)

        step("")
        return step

    # -- what a person does ------------------------------------------------------------------------------

    def toggle(self, effect: str) -> Future[None]:
        """Adds an effect, or takes it out where it is in the model."""
        if effect in self.moment.effects:
            return self.change(f"removing {effect}", lambda study, _: study.remove(effect))
        return self.change(f"adding {effect}", lambda study, _: study.add(effect))

    def undo(self) -> Future[None]:
        """Takes the last change back."""
        return self.change("undoing", lambda study, _: study.undo())

    def mark_outliers(self, rows: Sequence[int]) -> Future[None]:
        """Marks rows (from 0) as outliers."""
        return self.change(f"marking {len(rows)} rows", lambda study, _: study.mark_outliers(rows))

    def add_measurements(self, name: str, content: bytes) -> Future[None]:
        """Joins a CSV or Parquet file, given by name and bytes; a copy stays in the folder."""

        def work(study: Study, _: Progress) -> None:
            path = self.folder / f"added_{len(study.history)}_{Path(name).name}"
            path.write_bytes(content)
            try:
                study.extend(read_measurements(path))
            except SherkitError as error:
                path.unlink()
                # the file that a person dropped, not the copy of it
                raise type(error)(str(error).replace(str(path), name)) from error
            self.sources.append(path)

        return self.change(f"joining {name}", work)

    def type_effect(self, source: str) -> Future[None]:
        """Runs lines that define effects, with the rights of who started the page, and tries what they define.

        The lines are kept in the folder. Refused where the page can be reached from other machines.
        """

        def work(study: Study, _: Progress) -> None:
            if not self.trusted:
                raise SherkitError("effects cannot be typed here: this page can be reached from other machines")
            path = self.folder / TYPED
            trial = self.folder / f"next.{TYPED}"
            trial.write_text(source, encoding="utf-8")
            try:
                effects = _loaded(trial)
                lost = self._typed & set(study.effects) - {e.name for e in effects}
                if lost:
                    raise EffectError(
                        f"{', '.join(sorted(lost))} is in the model and no longer in these lines; remove it"
                    )
                for effect in effects:
                    if effect.name not in study.effects:
                        study.register(effect)
            except BaseException:
                trial.unlink()
                raise
            trial.replace(path)
            self._typed = {e.name for e in effects}

        return self.change("running your lines", work)

    def follow(self, run: Path) -> Future[None] | None:
        """Reads the run again where it has grown; returns None where there is nothing new."""
        size = run.stat().st_size
        if size == getattr(self, "_followed", None):
            return None
        self._followed = size

        def work(study: Study, _: Progress) -> None:
            data = read_measurements(run)
            if len(data) > len(study.data):
                study.follow(data)

        return self.change("reading new rows", work)

    # -- moments -----------------------------------------------------------------------------------------

    def _moment(self, found: Diagnosis[Any] | None) -> Moment:
        study = self._study
        lefts: list[Left | None] = []
        for step in study.history:
            if step.fit is None or len(step.fit.data) != len(study.data):
                lefts.append(None)
                continue
            if step.fit not in self._lefts:
                self._lefts[step.fit] = left_of(step.fit)
            lefts.append(self._lefts[step.fit])
        self._number += 1
        return Moment(
            data=study.data,
            effects=study.effects,
            own=tuple(study.own),
            history=tuple(study.history),
            lefts=tuple(lefts),
            diagnosis=found,
            can_undo=study.can_undo,
            number=self._number,
        )

    def _show(self, found: Diagnosis[Any] | None) -> None:
        self.moment = replace(self.moment, diagnosis=found) if found is not None else self._moment(None)
        self._say("moment", self.moment)

    def _say(self, kind: str, value: Any) -> None:
        if kind == "progress":
            self.progress = value
        for listener in list(self._listeners):
            listener(kind, value)


def _loaded(path: Path) -> tuple[Effect, ...]:
    """Effects from lines that were typed: the page has no file to speak of."""
    try:
        return load_effects(path)
    except EffectError as error:
        raise EffectError(str(error).replace(str(path), "your lines")) from error


def rights_of() -> str:
    """Whose rights typed lines run with."""
    try:
        return getpass.getuser()
    except (OSError, KeyError):
        return "the person who started this page"


def _sentence(error: BaseException) -> str:
    return str(error) if isinstance(error, SherkitError) else f"{type(error).__name__}: {error}"


def _require_same(folder: Path, hashes: dict[str, str]) -> None:
    """Refuses a folder whose study was begun from other files."""
    path = folder / _SOURCES
    known = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    changed = [name for name, value in hashes.items() if known.get(name) != value]
    if changed:
        raise SherkitError(
            f"{folder}: holds a study that was begun from another {' and '.join(changed)} file; "
            "give --fresh to begin anew there, or --study with another folder"
        )


def _require_effects(folder: Path, known: set[str], typed: Path) -> None:
    """Refuses a study whose effects are not all there, and says where they may be."""
    state = json.loads((folder / "study.json").read_text(encoding="utf-8"))
    needed = {name for name in state["effects"] if name not in CATALOGUE} - known
    if needed and typed.exists():
        raise SherkitError(
            f"{folder}: this study uses {', '.join(sorted(needed))}, typed into the page; read {typed} and give "
            "--run-typed to run those lines again"
        )
