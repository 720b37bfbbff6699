"""The folder of a study: open in one page only, and only for the files from which it was begun; and the lines that were
typed into the page, which are kept there.
"""

from __future__ import annotations

import ast
import hashlib
import json
import tempfile
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import IO, Any

from ..base.figures import listed
from ..data import Measurements, read_measurements
from ..data.called import Columns
from ..data.files import write_whole
from ..data.tables import PARQUET
from ..errors import EffectError, SherkitError
from ..model.effect import Effect
from ..model.kinds import known_kinds
from ..study import Study
from ..study.files import read_state
from .sandbox import PATIENCE_S, Sandbox

# -- Reads a run that is still being written, and files that are known to people under another name -----------------


def read_as(path: Path, name: str, columns: Columns | None = None) -> Measurements:
    """Reads a file under another name: that is what errors and warnings are about."""
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        try:
            data = read_measurements(path, columns=columns)
        except SherkitError as error:
            raise type(error)(str(error).replace(str(path), name)) from None
    for one in said:
        warnings.warn(str(one.message).replace(str(path), name), one.category, stacklevel=2)
    return replace(data, source=name)


def read_so_far(run: Path, columns: Columns | None = None) -> Measurements:
    """The rows of a run that is being written: a last line that has no end may be half of one, or half a number."""
    if run.suffix.lower() in PARQUET or not run.is_file():
        return read_measurements(run, columns=columns)
    content = run.read_bytes()
    with tempfile.TemporaryDirectory() as folder:
        whole = Path(folder) / run.name
        write_whole(whole, whole_lines(content))
        return read_as(whole, str(run), columns)


def whole_lines(content: bytes) -> bytes:
    return content[: content.rfind(b"\n") + 1]


# -- The folder ------------------------------------------------------------------------------------------------------

TYPED = "typed_effects.py"
SOURCES = "sources.json"
_LOCK = ".open"


def hold(folder: Path) -> IO[str] | None:
    """Keeps a second page from writing the same folder, until this process ends in whatever way.

    Raises :class:`~sherkit.errors.SherkitError`.
    """
    try:
        import fcntl
    except ImportError:  # not on Windows
        return None
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        held = (folder / _LOCK).open("a")
    except OSError as error:
        raise SherkitError(f"{folder}: the study cannot be kept here: {error.strerror}") from None
    try:
        fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        held.close()
        raise SherkitError(
            f"{folder}: this study is open in another sherkit app; use that page, or give --study with another folder"
        ) from None
    return held


def begun_from(robot: Path, run: Path, *, follow: bool) -> dict[str, Any]:
    """What tells the files of a study from others; of a run that grows, its beginning."""
    content = run.read_bytes()
    if follow and run.suffix.lower() not in PARQUET:
        content = whole_lines(content) or content
    return {"robot": _hash(robot.read_bytes()), "run": _hash(content), "run_bytes": len(content)}


def _hash(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def require_same(folder: Path, robot: Path, run: Path, *, follow: bool) -> None:
    """Refuses a folder whose study was begun from other files."""
    try:
        known = json.loads((folder / SOURCES).read_text(encoding="utf-8"))
        first = int(known["run_bytes"])
    except (OSError, ValueError, KeyError, TypeError):
        raise SherkitError(
            f"{folder}: holds a study of which it is not known from which files it was begun; "
            "give --fresh to begin anew there, or --study with another folder"
        ) from None
    content = run.read_bytes()
    same = {"robot": known.get("robot") == _hash(robot.read_bytes()), "run": known["run"] == _hash(content[:first])}
    if follow and run.suffix.lower() in PARQUET:
        same["run"] = True  # written anew as a whole where it grows; its rows are compared when they are read
    changed = [name for name, as_before in same.items() if not as_before]
    if changed:
        raise SherkitError(
            f"{folder}: holds a study that was begun from another {' and '.join(changed)} file; "
            "give --fresh to begin anew there, or --study with another folder"
        )
    if len(content) > first and not follow:
        raise SherkitError(
            f"{run}: has grown since the study in {folder} was begun; give --follow to read the new rows, or --fresh "
            "to begin anew there"
        )


def require_effects(folder: Path, known: set[str], typed: Path) -> None:
    """Refuses a study whose effects are not all there, and says where they may be."""
    state = read_state(folder)
    with state.table("robot") as robot:
        kinds = known_kinds()
        built_in = kinds[robot.text("kind", tuple(kinds))].model.catalogue
        robot.pass_over(*robot.names())
    needed = {name for name in state.texts("effects") if name not in built_in} - known
    if needed and typed.exists():
        raise SherkitError(
            f"{folder}: this study uses {', '.join(sorted(needed))}, typed into the page; read {typed} and give "
            "--run-typed to run those lines again"
        )


# -- Lines that were typed into the page ------------------------------------------------------------------------------


class Typed:
    """The lines of one study, at ``path``. ``look`` is called while they run; what it raises ends them."""

    def __init__(self, path: Path, patience_s: float = PATIENCE_S) -> None:
        self.path = path
        self.look: Callable[[], None] = lambda: None
        self._patience_s = patience_s
        #: Effects of older lines, which a step that is undone may bring back, and of those that are kept.
        self._sandbox: list[Sandbox] = []
        #: Of the effects that the lines define: what goes back to what it was where a change did not happen.
        self.names: frozenset[str] = frozenset()

    def again(self) -> tuple[Effect, ...]:
        """Runs the lines that are kept, if there are any."""
        if not self.path.exists():
            return ()
        return self._kept(self._begun(self.path.read_text(encoding="utf-8")))

    def run(self, source: str, study: Study) -> None:
        """Runs lines, makes their effects known to the study, and keeps them.

        Raises :class:`~sherkit.errors.EffectError`, with lines and effects as they were before.
        """
        trial = self.path.with_name(f"next.{self.path.name}")
        write_whole(trial, source)
        known = dict(study.own)
        used = self.names & set(study.effects)
        made: Sandbox | None = None
        try:
            if used and not _contains(source, self.path.read_text(encoding="utf-8")):
                # the model would go on with the old lines, and the study come back with the new ones
                raise EffectError(
                    f"{listed(sorted(used))} is in the model: remove it before you change its lines; you can add to "
                    "them"
                )
            made = self._begun(source)
            for effect in made.effects:
                if effect.name not in used:
                    study.register(effect)
        except BaseException:
            if made is not None:
                made.end()
            study.own = known
            trial.unlink()
            raise
        trial.replace(self.path)
        self._kept(made)

    def _begun(self, source: str) -> Sandbox:
        return Sandbox(source, lambda: self.look(), self._patience_s)

    def _kept(self, made: Sandbox) -> tuple[Effect, ...]:
        self.end()  # those that are asked again begin again, with their own lines
        self._sandbox.append(made)
        self.names = frozenset(e.name for e in made.effects)
        return made.effects

    def forgive(self) -> None:
        """Asks lines again that were ended."""
        for one in self._sandbox:
            one.forgive()

    def end(self) -> None:
        """Ends what runs."""
        for one in self._sandbox:
            one.end()


def _contains(source: str, old: str) -> bool:
    """Whether every statement of the old lines is in the new ones, comments and spaces aside."""
    return {ast.dump(s) for s in _statements(old)} <= {ast.dump(s) for s in _statements(source)}


def _statements(source: str) -> list[ast.stmt]:
    try:
        return ast.parse(source).body
    except (SyntaxError, ValueError) as error:
        raise EffectError(f"your lines: {type(error).__name__}: {error}") from None
