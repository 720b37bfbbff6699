"""The run file: one SQLite database per run, which holds plan, instruments, settings and versions beside the rows.

A point whose :meth:`RunFile.store` has returned is on the disk. Each is one transaction under its step's number, so
that it is whole or absent, and there once. One runner at a time holds the run's lock; it is read also while a program
writes. Rows that are in doubt are marked and kept. No text in it is ever run: plans and settings are JSON, robot and
experiment TOML.
"""

from __future__ import annotations

import json
import platform
import sqlite3
import time
import warnings
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, Self

import numpy as np
import polars as pl

import sherkit._core as _core

from ...data import Measurements, from_frame
from ...data.columns import OUTLIER, POSE, REASON, REPEAT, TIME
from ...data.files import is_output
from ...data.tables import PARQUET, write_table
from ...errors import ExperimentError, SherkitWarning
from ..instruments.transport import now_s, wall_ahead_s
from .plan import Plan, Point
from .run_database import APPLICATION, FORMAT, READ_TOO, TABLES, connected, reads, statements
from .run_lock import RunLock

#: Of :meth:`RunFile.create`, what must be the same for a run to go on.
_SAME = ("plan", "robot")
#: What gives the numbers of each instrument their meaning, as JSON: the same, too, told apart by instrument and key.
_MEANING = "meaning"
#: The wall clock may be set by so much against the steady one before it is said, s.
_CLOCK_SET_S = 1.0


class RunFile:
    """An open run file. ``create``, ``resume`` and ``open`` make one; ``with`` closes it.

    Raises :class:`~sherkit.errors.ExperimentError` where the file is none, or another run's, or damaged.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self._db = connected(self.path)
        self._lock: RunLock | None = None
        self._wall_ahead_s = wall_ahead_s()
        self._later_s = 0.0
        self.session = 0

    # --- making and opening

    @classmethod
    def create(cls, path: str | Path, plan: Plan, about: Mapping[str, str]) -> Self:
        """A new run: its plan, and ``about`` (robot and experiment as TOML, settings as JSON). Refuses a file that is.

        A file that a program left before anything was in it is taken over.
        """
        made = cls(path)
        with ExitStack() as failing:
            failing.callback(made.close)
            if not made._is_bare():
                raise ExperimentError(f"{path}: exists; go on with --resume, or give the run another name")
            made._lock = RunLock(made.path)
            values = {"format": str(FORMAT), "created_s": repr(now_s()), "plan": plan.to_json(), **about}
            with made._writing():
                made._db.execute("BEGIN IMMEDIATE")
                for statement in statements(TABLES):
                    made._db.execute(statement)
                made._db.executemany("INSERT INTO run VALUES (?, ?)", values.items())
                made._db.execute(f"PRAGMA application_id = {APPLICATION}")
            failing.pop_all()
        return made

    @classmethod
    def resume(cls, path: str | Path, plan: Plan, about: Mapping[str, str]) -> Self:
        """Opens the run to go on with it; begins it where there is none yet.

        Refuses one with another plan or robot, or in which an instrument's numbers meant something else (``about`` has
        ``meaning`` as JSON: kind, columns and settings by instrument).
        """
        with cls(path) as made:
            bare = made._is_bare()
        if bare:
            return cls.create(path, plan, about)
        made = cls.open(path)
        with ExitStack() as failing:
            failing.callback(made.close)
            made._lock = RunLock(made.path)
            made._require_same({"plan": plan.to_json(), **about})
            failing.pop_all()
        return made

    @reads
    def _require_same(self, given: Mapping[str, str]) -> None:
        if self.about("format") != str(FORMAT):
            raise ExperimentError(f"{self.path}: was begun by an earlier version; it can be exported, not gone on with")
        for key in _SAME:
            if self.about(key) != given.get(key, ""):
                raise ExperimentError(
                    f"{self.path}: was begun with another {key}; a run goes on only as it began. Give the changed "
                    "experiment a run of its own"
                )
        then, now = (_by_instrument(text) for text in (self.about(_MEANING), given.get(_MEANING, "")))
        self._require_same_instruments(then, now)

    def _require_same_instruments(self, then: Mapping[str, Any], now: Mapping[str, Any]) -> None:
        """Compares tables of instruments by name; names what is another."""
        told = f"{self.path}: a run goes on only as it began"
        for name in sorted({*then, *now}):
            if name not in then or name not in now:
                raise ExperimentError(
                    f"{told}, and it began with{'out' if name in now else ''} the instrument '{name}'"
                )
            for key in sorted({*then[name], *now[name]}):
                old, new = then[name].get(key), now[name].get(key)
                if old != new:
                    raise ExperimentError(
                        f"{told}, and its rows were taken with {name} {key} = {old}; now it is {new}. Set it back, or "
                        "give the changed experiment a run of its own"
                    )

    @classmethod
    def plan_in(cls, path: str | Path) -> Plan | None:
        """The plan of a run, grown as it is; None where there is no run yet."""
        if not Path(path).is_file():
            return None
        with cls(path) as made:
            if made._is_bare():
                return None
        with cls.open(path) as made:
            return made.plan

    @classmethod
    def open(cls, path: str | Path) -> Self:
        """Opens a run that exists."""
        if not Path(path).is_file():
            raise ExperimentError(f"{path}: there is no such run file")
        made = cls(path)
        with ExitStack() as failing:
            failing.callback(made.close)
            if made._is_bare() or not made._is_ours() or made.about("format") not in READ_TOO:
                raise ExperimentError(f"{path}: holds no run of this version (expected format {FORMAT})")
            failing.pop_all()
        return made

    @reads
    def _is_bare(self) -> bool:
        """Whether nothing is in it: a program died before the run was begun."""
        return not self._db.execute("SELECT count(*) FROM sqlite_master").fetchone()[0]

    @reads
    def _is_ours(self) -> bool:
        """Whether its tables are those of a run: a view or a trigger of somebody else's could run for ever."""
        found = {str(sql) for (sql,) in self._db.execute("SELECT sql FROM sqlite_master WHERE sql IS NOT NULL")}
        # runs of the first version had no wall clock in their points
        return found <= {*statements(TABLES), *statements(TABLES.replace("wall_s REAL NOT NULL, ", ""))}

    def close(self) -> None:
        """Gives the file back; twice does no harm."""
        self._db.close()
        if self._lock is not None:
            self._lock.release()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    # --- reading

    @reads
    def about(self, key: str) -> str:
        """What the run holds of ``plan``, ``robot``, ``experiment`` …; "" where it holds nothing."""
        found = self._db.execute("SELECT value FROM run WHERE key = ?", (key,)).fetchone()
        return str(found[0]) if found is not None else ""

    @property
    @reads
    def plan(self) -> Plan:
        """The plan that the run was begun with."""
        return Plan.from_json(self.about("plan"))

    @reads
    def done(self) -> set[int]:
        """Numbers of the steps that are stored and not in doubt."""
        return {int(row[0]) for row in self._db.execute("SELECT step FROM point")} - set(self.doubts())

    @reads
    def doubts(self) -> dict[int, tuple[str, str]]:
        """Instrument and reason for each step whose row is in doubt."""
        if self.about("format") == "1":
            return {}
        found = self._db.execute("SELECT step, instrument, why FROM doubt ORDER BY step")
        return {int(step): (str(who), str(why)) for step, who, why in found}

    @reads
    def last(self) -> Point | None:
        """The point that was stored last, in doubt or not."""
        found = self._db.execute("SELECT step FROM point ORDER BY time_s DESC LIMIT 1").fetchone()
        return None if found is None else self._stored("WHERE step = ?", (found[0],))[0]

    @reads
    def points(self) -> list[Point]:
        """Every stored point that is not in doubt, in the order of the steps."""
        return self._stored("WHERE step NOT IN (SELECT step FROM doubt)" if self.doubts() else "", ())

    def _stored(self, where: str, values: tuple[int, ...]) -> list[Point]:
        read: dict[int, dict[str, float]] = {}
        for step, name, value in self._db.execute(
            f"SELECT step, name, value FROM reading {where} ORDER BY step, place", values
        ):
            read.setdefault(step, {})[name] = float("nan") if value is None else float(value)
        found = self._db.execute(f"SELECT step, pose, repeat, time_s FROM point {where} ORDER BY step", values)
        return [Point(int(p), int(r), float(t), read.get(step, {})) for step, p, r, t in found]

    @reads
    def diary(self) -> list[tuple[float, int | None, str]]:
        """When, at which step, what."""
        return [(float(a), b, str(c)) for a, b, c in self._db.execute("SELECT at_s, step, what FROM diary")]

    @reads
    def instruments(self) -> list[tuple[int, str, str, str, str]]:
        """Session, name, kind, identity and port of every instrument of every session."""
        return list(self._db.execute("SELECT session, name, kind, identity, port FROM instrument"))

    @reads
    def frame(self) -> pl.DataFrame:
        """The rows in the order of their steps: step, time, pose, repeat, and a column for every value.

        Where a loop has chosen the poses, ``reason`` says why. Where rows are in doubt, they have a 1 in the column
        ``outlier``: no fit uses them.
        """
        points = self._table(
            "SELECT step, time_s, pose, repeat FROM point ORDER BY step",
            {"step": pl.Int64, TIME: pl.Float64, POSE: pl.Int64, REPEAT: pl.Int64},
        )
        readings = self._table(
            "SELECT step, name, value FROM reading ORDER BY step, place",
            {"step": pl.Int64, "name": pl.String, "value": pl.Float64},
        )
        steps, values = points["step"], readings.pivot("name", index="step", values="value")
        if doubts := self.doubts():
            points = points.with_columns(steps.is_in([*doubts]).cast(pl.Int64).alias(OUTLIER))
        frame = points.join(values, on="step", how="left", maintain_order="left")
        reasons = {k: step.reason for k, step in enumerate(self.plan.steps)} if len(points) else {}
        told = [reasons.get(step, "") for step in steps] if any(reasons.values()) else None
        return frame if told is None else frame.with_columns(pl.Series(REASON, told))

    def _table(self, question: str, schema: dict[str, Any]) -> pl.DataFrame:
        return pl.DataFrame(self._db.execute(question).fetchall(), schema, orient="row")

    def measurements(self) -> Measurements:
        """The rows as measurements, by time. Raises :class:`~sherkit.errors.MeasurementError` where there are none."""
        return from_frame(_exported(self.frame()), str(self.path))

    # --- writing

    @contextmanager
    def _writing(self) -> Iterator[None]:
        """A transaction; what hinders it (no space, no right) as a sentence."""
        try:
            with self._db:
                yield
        except sqlite3.Error as error:
            raise ExperimentError(f"{self.path}: cannot be written: {error}") from None

    def begin(self, instruments: Mapping[str, Mapping[str, Any]]) -> int:
        """A new session: the program was started. ``instruments`` are kind, identity, port and settings by name.

        Raises :class:`~sherkit.errors.ExperimentError` where an earlier session had another instrument under a name.
        Where the wall clock was set back since the last row, rows go on after that one, and the diary says so.
        """
        if before := self._identities():
            now = {name: {"kind": one["kind"], "identity": one["identity"]} for name, one in instruments.items()}
            self._require_same_instruments(before, now)
        versions = {
            "sherkit": _core.__version__,
            "python": platform.python_version(),
            "numpy": np.__version__,
            "sqlite": sqlite3.sqlite_version,
            "system": platform.platform(),
        }
        with self._writing():
            self._db.execute("BEGIN IMMEDIATE")
            cursor = self._db.execute(
                "INSERT INTO session (began_s, versions) VALUES (?, ?)", (now_s(), json.dumps(versions))
            )
            self.session = int(cursor.lastrowid or 0)
            for name, one in instruments.items():
                self._db.execute(
                    "INSERT INTO instrument VALUES (?, ?, ?, ?, ?, ?)",
                    (self.session, name, one["kind"], one["identity"], one["port"], json.dumps(one["settings"])),
                )
        newest = self._db.execute("SELECT max(time_s) FROM point").fetchone()[0]
        if newest is not None and newest > now_s():
            self._later_s = newest + _CLOCK_SET_S - now_s()
            self._say_clock(-self._later_s, "since the last row was taken", "right after that row")
        return self.session

    @reads
    def _identities(self) -> dict[str, dict[str, str]]:
        """Kind and identity of the instruments of the last session."""
        found = self._db.execute(
            "SELECT name, kind, identity FROM instrument WHERE session = (SELECT max(session) FROM instrument)"
        )
        return {name: {"kind": kind, "identity": identity} for name, kind, identity in found}

    def _say_clock(self, by_s: float, when: str, on: str) -> None:
        way = "back" if by_s < 0 else "forward"
        told = f"the clock of this computer was set {way} by {abs(by_s):.0f} s {when}; times of rows go on {on}"
        self.note(told)
        warnings.warn(f"{self.path}: {told}", SherkitWarning, stacklevel=3)

    def end(self, why: str) -> None:
        """The session's end, and what brought it about."""
        with self._writing():
            self._db.execute(
                "UPDATE session SET ended_s = ?, why = ? WHERE session = ?", (self._now_s(), why, self.session)
            )

    def _now_s(self) -> float:
        return now_s() + self._later_s

    def grow(self, plan: Plan) -> None:
        """The plan goes on: steps that were taken stay as they are."""
        with self._writing():
            self._db.execute("UPDATE run SET value = ? WHERE key = 'plan'", (plan.to_json(),))

    @property
    @reads
    def reference(self) -> int | None:
        """The mark of the axes' zero with which the last rows were taken; None before the first."""
        return int(text) if (text := self.about("reference")) else None

    @reference.setter
    def reference(self, mark: int | None) -> None:
        with self._writing():
            self._db.execute("INSERT OR REPLACE INTO run VALUES ('reference', ?)", ("" if mark is None else str(mark),))

    def note(self, what: str, step: int | None = None) -> None:
        """A line of the diary: a pause, an error."""
        with self._writing():
            self._db.execute("INSERT INTO diary VALUES (?, ?, ?, ?)", (self._now_s(), self.session, step, what))

    def dated(self, point: Point) -> Point:
        """The point by the time of the run, which goes on where the clock of this computer was set back."""
        return replace(point, time_s=point.time_s + self._later_s)

    def store(self, step: int, point: Point) -> Point:
        """Stores a step's point, whole: it is on the disk when this returns. A row in doubt of that step is kept aside.

        Returns the point as it is stored (:meth:`dated`).

        Raises :class:`~sherkit.errors.ExperimentError` where the step is stored already.
        """
        if abs(by_s := wall_ahead_s() - self._wall_ahead_s) > _CLOCK_SET_S:
            self._wall_ahead_s += by_s
            self._say_clock(by_s, "during the run", "by a clock that is not set")
        point = self.dated(point)
        # SQLite has no NaN; an empty cell is NULL
        rows = [
            (step, place, name, None if value != value else float(value))
            for place, (name, value) in enumerate(point.values.items())
        ]
        try:
            with self._db:
                self._db.execute("BEGIN IMMEDIATE")
                self._set_aside(step)
                self._db.execute(
                    "INSERT INTO point VALUES (?, ?, ?, ?, ?, ?)",
                    (step, self.session, point.pose, point.repeat, point.time_s, time.time()),
                )
                self._db.executemany("INSERT INTO reading VALUES (?, ?, ?, ?)", rows)
        except sqlite3.IntegrityError as error:
            raise ExperimentError(f"{self.path}: step {step} is stored already ({error})") from None
        except sqlite3.Error as error:
            raise ExperimentError(f"{self.path}: step {step} could not be stored: {error}") from None
        return point

    def doubt(self, steps: Iterable[int], instrument: str, why: str) -> None:
        """Marks the rows of these steps as in doubt: they are kept, exported as outliers, and taken again."""
        with self._writing():
            self._db.executemany("INSERT OR REPLACE INTO doubt VALUES (?, ?, ?)", [(s, instrument, why) for s in steps])

    def accept(self) -> int:
        """Takes all marks away, since a person says that the rows are right; returns how many."""
        with self._writing():
            count = self._db.execute("DELETE FROM doubt").rowcount
        if count:
            self.note(f"{count} rows in doubt were accepted")
        return int(count)

    def _set_aside(self, step: int) -> None:
        found = self._db.execute(
            "SELECT session, time_s, instrument, why FROM point JOIN doubt USING (step) WHERE step = ?", (step,)
        ).fetchone()
        if found is None:
            return
        values = self._db.execute("SELECT name, value FROM reading WHERE step = ? ORDER BY place", (step,)).fetchall()
        self._db.execute("INSERT INTO former VALUES (?, ?, ?, ?, ?, ?)", (step, *found, json.dumps(dict(values))))
        for table in ("doubt", "reading", "point"):
            self._db.execute(f"DELETE FROM {table} WHERE step = ?", (step,))


def _by_instrument(text: str) -> dict[str, dict[str, Any]]:
    made = json.loads(text or "{}")
    if not isinstance(made, dict) or not all(isinstance(one, dict) for one in made.values()):
        raise ValueError("what its instruments' numbers mean is not said by instrument")
    return made


def _exported(frame: pl.DataFrame) -> pl.DataFrame:
    """The columns of a run that a person or program goes on with: time counted from the first row, no step numbers."""
    first = frame[TIME].min() if len(frame) else 0.0
    return frame.drop("step").with_columns(pl.col(TIME) - first)


def export_run(source: str | Path, destination: str | Path) -> int:
    """Writes a run's rows as CSV or Parquet, by the ending of the name; returns how many. Reads a run that goes on.

    Raises :class:`~sherkit.errors.ExperimentError`.
    """
    destination = Path(destination)
    if destination.suffix.lower() not in (".csv", *PARQUET) and not is_output(destination):
        header = "; a calibration becomes a C header by sherkit export c" if destination.suffix.lower() == ".h" else ""
        raise ExperimentError(f"{destination}: expected a name that ends in .csv or .parquet{header}")
    with RunFile.open(source) as run:
        frame = run.frame()
    if not len(frame):
        raise ExperimentError(f"{source}: holds no row yet")
    write_table(_exported(frame), destination)
    return len(frame)
