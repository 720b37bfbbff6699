"""What a loop is to do, and its file: robot, settings, rows and what was asked, as JSON; one loop at a time has it."""

from __future__ import annotations

import json
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Self

import polars as pl

from ..base.arguments import Count, Level, NotNegative, Positive, Seed, validate_arguments
from ..data.columns import POSE, REPEAT
from ..data.files import FileLock, write_whole
from ..errors import ArgumentError, ExperimentError, MeasurementError
from ..model.kinds import kind_of, model_of, robot_from_tables
from ..model.kinds import required_um as stated_um
from ..model.robot_file import RobotLike, read_robot
from ..planning.region import Region

#: Readings in a batch and in all, unless it is said.
BATCH, BUDGET = 4, 400
#: What its file says that it is.
KIND = "sherkit adaptive loop"
#: Settings, and those that may be left open.
_SETTINGS = ("required_um", "budget", "span_min", "box", "level", "batch", "seed", "minutes")
_OPEN = {"required_um", "minutes", "box"}


class Task(ABC):
    """As :class:`~.loop.Adaptive` has it, and the table of what was told: what a loop holds in a file, and in a pickle.
    All of it follows from robot, settings and rows, but for the batch that was asked for."""

    #: The rows of the batch that was asked for, and at which look.
    _asked: list[dict[str, Any]]
    _asked_at: int
    _lock: FileLock | None = None

    @validate_arguments
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
        self.robot = read_robot(robot)
        self.model = model_of(self.robot)
        self.layout = kind_of(self.robot).layout
        self.required_um = required_um if required_um is not None else stated_um(self.robot)
        self.budget, self.span_min, self.level, self.batch, self.seed = budget, span_min, level, batch, seed
        self.minutes = minutes
        self.box = {name: [float(end) for end in ends] for name, ends in (box or {}).items()}
        self.region = Region.of(self.model, self.layout, self.box)
        self.frame = pl.DataFrame()
        self._begin_anew()

    @abstractmethod
    def _begin_anew(self) -> None:
        """Forgets what was made of the rows."""

    @property
    @abstractmethod
    def done(self) -> bool:
        """Whether it has ended."""

    @abstractmethod
    def tell(self, rows: Any) -> None:
        """Takes what was read."""

    @validate_arguments
    def save(self, path: str | Path) -> None:
        """Writes robot, settings, rows and the batch that was asked for as JSON, whole or not at all. Until the loop is
        done, or its program ends, no other loop can have the file: raises :class:`~sherkit.errors.ExperimentError`
        where one has it."""
        where = Path(path)
        if self._lock is None or not self._lock.is_of(where):
            # what another loop has is not written over, and one that was held goes once this one is
            self._lock = _lock_of(where)
        held = {"kind": KIND, "robot": self.robot.to_tables(), **self._held()}
        write_whole(where, json.dumps(held, indent=1) + "\n")
        self._close_if_done()

    def close(self) -> None:
        """Gives back the file that it was loaded from or saved to; it does so by itself once it is done."""
        if self._lock is not None:
            self._lock.release()
            self._lock = None

    def _close_if_done(self) -> None:
        if self._lock is not None and self.done:
            self.close()

    def _held(self) -> dict[str, Any]:
        return {
            "settings": {name: getattr(self, name) for name in _SETTINGS},
            "rows": {name: self.frame[name].to_list() for name in self.frame.columns},
            "asked": {"rows": self._asked, "at": self._asked_at},
        }

    @classmethod
    def _of(cls, robot: Any, held: dict[str, Any], where: str) -> Self:
        """The loop with what another one held."""
        try:
            loop = cls(robot, **held["settings"])
        except (ArgumentError, TypeError) as error:
            raise MeasurementError(f"{where}: settings: {error}") from None
        asked = held.get("asked") or {"rows": [], "at": -1}
        columns = {POSE, REPEAT, *loop.layout.joints, *loop.region.targets}
        rows, at = (asked.get("rows"), asked.get("at")) if isinstance(asked, dict) else (None, None)
        if not isinstance(rows, list) or type(at) is not int or not all(
            isinstance(row, dict) and columns <= set(row) and type(row[POSE]) is int and type(row[REPEAT]) is int
            for row in rows
        ):  # fmt: skip
            raise MeasurementError(f"{where}: asked: expected the rows that were asked for, as save() writes them")
        try:
            if held["rows"]:
                loop.tell(held["rows"])
        except MeasurementError as error:
            raise MeasurementError(f"{where}: rows: {error}") from None
        loop._asked, loop._asked_at = rows, at
        return loop

    def __reduce__(self) -> tuple[Any, ...]:
        # a lock has one owner
        return type(self)._of, (self.robot, self._held(), "pickle")

    @classmethod
    @validate_arguments
    def load(cls, path: str | Path, robot: RobotLike | None = None) -> Self:
        """The loop of a file, as it was; ``robot`` is only needed for a machine that is no file. Until it is done, no
        other loop can have the file. Raises :class:`~sherkit.errors.ExperimentError` for what is no such file, and for
        one that another loop has, and :class:`~sherkit.errors.MeasurementError` where what it holds cannot be used."""
        where = Path(path)
        # a file that is not there leaves no lock behind
        _held_in(where)
        mine = _lock_of(where)
        try:
            held = _held_in(where)
            robot = robot_from_tables(held["robot"], f"{where}: robot") if robot is None else robot
            loop = cls._of(robot, held, str(where))
        except BaseException:
            mine.release()
            raise
        loop._lock = mine
        loop._close_if_done()
        return loop


def _held_in(where: Path) -> dict[str, Any]:
    """What a file holds. Raises :class:`~sherkit.errors.ExperimentError` for what is no file of a loop, and
    :class:`~sherkit.errors.MeasurementError` where what it holds cannot be used."""
    try:
        held = json.loads(where.read_text(encoding="utf-8"))
    except OSError as error:
        raise ExperimentError(f"{where}: cannot be read: {error.strerror or error}") from None
    except RecursionError:
        raise MeasurementError(f"{where}: is nested too deeply to be a loop, as its save() writes one") from None
    except ValueError as error:
        raise ExperimentError(f"{where}: is no JSON: {error}") from None
    if not isinstance(held, dict) or held.get("kind") != KIND or not {"robot", "settings", "rows"} <= set(held):
        raise ExperimentError(f"{where}: is no file of an adaptive loop, as its save() writes one")
    for name in ("robot", "settings", "rows"):
        if not isinstance(held[name], dict):
            raise MeasurementError(f"{where}: {name}: expected a table by name, found {_short(held[name])}")
    for name, value in held["settings"].items():
        if value is None and name not in _OPEN:
            raise MeasurementError(f"{where}: settings: {name} is null: give its number, or leave the line out")
    return held


def _short(value: Any) -> str:
    text = "null" if value is None else repr(value)
    return text if len(text) <= 40 else f"{text[:40]} …"


def _lock_of(path: Path) -> FileLock:
    """The lock of a loop's file. Raises :class:`~sherkit.errors.ExperimentError` where another loop has it."""
    try:
        return FileLock(path)
    except BlockingIOError as error:
        raise ExperimentError(
            f"{path}: another loop has this file ({error}): one file has one loop. End that one first (the "
            "file is given back when its loop is done or its program ends), or give another file"
        ) from None
