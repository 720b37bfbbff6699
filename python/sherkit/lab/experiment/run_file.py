"""The run file: one SQLite database per run, which holds plan, instruments, settings and versions beside the rows.

Write-ahead log and ``synchronous=FULL``: a point whose :meth:`RunFile.store` has returned survives the death of the
program and of the machine. Each point is one transaction under its step's number, so that it is whole or absent, and
there once. No text in it is ever run: plans and settings are JSON, robot and experiment TOML.
"""

from __future__ import annotations

import json
import platform
import sqlite3
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Self

import numpy as np
import polars as pl

import sherkit._core as _core

from ...data import Measurements, from_frame
from ...data.columns import POSE, REPEAT, TIME
from ...data.files import is_output
from ...data.tables import PARQUET, write_table
from ...errors import ExperimentError
from .bench import Point
from .plan import Plan

#: "Sher", in the file's header: what kind of database this is.
_APPLICATION = 0x53686572
_FORMAT = 1
_TABLES = """
CREATE TABLE run (key TEXT PRIMARY KEY, value TEXT NOT NULL) STRICT;
CREATE TABLE session (
    session INTEGER PRIMARY KEY, began_s REAL NOT NULL, ended_s REAL, why TEXT, versions TEXT NOT NULL
) STRICT;
CREATE TABLE instrument (
    session INTEGER NOT NULL REFERENCES session, name TEXT NOT NULL, kind TEXT NOT NULL, identity TEXT NOT NULL,
    port TEXT NOT NULL, settings TEXT NOT NULL, PRIMARY KEY (session, name)
) STRICT;
CREATE TABLE point (
    step INTEGER PRIMARY KEY, session INTEGER NOT NULL REFERENCES session, pose INTEGER NOT NULL,
    repeat INTEGER NOT NULL, time_s REAL NOT NULL, UNIQUE (pose, repeat)
) STRICT;
CREATE TABLE reading (
    step INTEGER NOT NULL REFERENCES point, place INTEGER NOT NULL, name TEXT NOT NULL, value REAL,
    PRIMARY KEY (step, place), UNIQUE (step, name)
) STRICT, WITHOUT ROWID;
CREATE TABLE diary (at_s REAL NOT NULL, session INTEGER, step INTEGER, what TEXT NOT NULL) STRICT;
"""
#: Of :meth:`RunFile.create`, what must be the same for a run to go on.
_SAME = ("plan", "robot")


class RunFile:
    """An open run file. ``create``, ``resume`` and ``open`` make one; ``with`` closes it.

    Raises :class:`~sherkit.errors.ExperimentError` where the file is none, or another run's.
    """

    def __init__(self, path: Path, connection: sqlite3.Connection) -> None:
        self.path = path
        self._db = connection
        self.session = 0

    # --- making and opening

    @classmethod
    def create(cls, path: str | Path, plan: Plan, about: Mapping[str, str]) -> Self:
        """A new run: its plan, and ``about`` (robot and experiment as TOML, settings as JSON). Refuses a file that is.

        A file that a program left before anything was in it is taken over.
        """
        path = Path(path)
        made = cls(path, cls._connect(path))
        if not made._is_bare():
            made.close()
            raise ExperimentError(f"{path}: exists; go on with --resume, or give the run another name")
        values = {"format": str(_FORMAT), "created_s": repr(time.time()), "plan": plan.to_json(), **about}
        with made._db:
            # one transaction: the file holds a whole run, or none
            made._db.execute("BEGIN IMMEDIATE")
            for statement in _TABLES.split(";\n"):
                if statement.strip():
                    made._db.execute(statement)
            made._db.executemany("INSERT INTO run VALUES (?, ?)", values.items())
            made._db.execute(f"PRAGMA application_id = {_APPLICATION}")
        return made

    @classmethod
    def resume(cls, path: str | Path, plan: Plan, about: Mapping[str, str]) -> Self:
        """Opens the run to go on with it; begins it where there is none yet. Refuses one with another plan or robot."""
        path = Path(path)
        made = cls(path, cls._connect(path))
        bare = made._is_bare()
        made.close()
        if bare:
            return cls.create(path, plan, about)
        made = cls.open(path)
        given = {"plan": plan.to_json(), **about}
        for key in _SAME:
            if made.about(key) != given.get(key, ""):
                made.close()
                raise ExperimentError(
                    f"{path}: was begun with another {key}; a run goes on only as it began. Give the changed "
                    "experiment a run of its own"
                )
        return made

    @classmethod
    def open(cls, path: str | Path) -> Self:
        """Opens a run that exists."""
        path = Path(path)
        if not path.is_file():
            raise ExperimentError(f"{path}: there is no such run file")
        made = cls(path, cls._connect(path))
        try:
            with made._sound():
                found = made.about("format") if not made._is_bare() else ""
                own = made._holds_nothing_else()
            if found != str(_FORMAT) or not own:
                raise ExperimentError(f"{path}: holds no run of this version (expected format {_FORMAT})")
        except BaseException:
            made.close()
            raise
        return made

    def _holds_nothing_else(self) -> bool:
        """Whether its tables are those of a run: a view or a trigger of somebody else's could run for ever."""
        found = {str(sql) for (sql,) in self._db.execute("SELECT sql FROM sqlite_master WHERE sql IS NOT NULL")}
        return found == {one.strip().rstrip(";") for one in _TABLES.split(";\n") if one.strip()}

    @contextmanager
    def _sound(self) -> Iterator[None]:
        """What is wrong with the file, or with what is in it, as a sentence."""
        try:
            yield
        except (sqlite3.Error, pl.exceptions.PolarsError, ValueError, TypeError, LookupError, OverflowError) as error:
            raise ExperimentError(f"{self.path}: is damaged and cannot be read: {error}") from None

    @staticmethod
    def _connect(path: Path) -> sqlite3.Connection:
        db: sqlite3.Connection | None = None
        try:
            db = sqlite3.connect(path, isolation_level=None, timeout=10.0)
            # a file from somebody else must not run code of its own
            db.execute("PRAGMA trusted_schema = OFF")
            tables = db.execute("SELECT count(*) FROM sqlite_master").fetchone()[0]
            kind = db.execute("PRAGMA application_id").fetchone()[0]
            if tables and kind != _APPLICATION:
                db.close()
                # before anything is changed in it
                raise ExperimentError(f"{path}: is a database, but no run file")
            db.execute("PRAGMA journal_mode = WAL")
            db.execute("PRAGMA synchronous = FULL")
            db.execute("PRAGMA foreign_keys = ON")
        except sqlite3.Error as error:
            if db is not None:
                db.close()
            raise ExperimentError(f"{path}: cannot be opened as a run file: {error}") from None
        return db

    def _is_bare(self) -> bool:
        """Whether nothing is in it: a program died before the run was begun."""
        return not self._db.execute("SELECT count(*) FROM sqlite_master").fetchone()[0]

    def close(self) -> None:
        """Gives the file back; twice does no harm."""
        self._db.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    # --- writing

    def begin(self, instruments: Mapping[str, Mapping[str, Any]]) -> int:
        """A new session: the program was started. ``instruments`` are kind, identity, port and settings by name."""
        versions = {
            "sherkit": _core.__version__,
            "python": platform.python_version(),
            "numpy": np.__version__,
            "sqlite": sqlite3.sqlite_version,
            "system": platform.platform(),
        }
        with self._db:
            self._db.execute("BEGIN IMMEDIATE")
            cursor = self._db.execute(
                "INSERT INTO session (began_s, versions) VALUES (?, ?)", (time.time(), json.dumps(versions))
            )
            self.session = int(cursor.lastrowid or 0)
            for name, one in instruments.items():
                self._db.execute(
                    "INSERT INTO instrument VALUES (?, ?, ?, ?, ?, ?)",
                    (self.session, name, one["kind"], one["identity"], one["port"], json.dumps(one["settings"])),
                )
        return self.session

    def end(self, why: str) -> None:
        """The session's end, and what brought it about."""
        with self._db:
            self._db.execute(
                "UPDATE session SET ended_s = ?, why = ? WHERE session = ?", (time.time(), why, self.session)
            )

    def note(self, what: str, step: int | None = None) -> None:
        """A line of the diary: a pause, an error."""
        with self._db:
            self._db.execute("INSERT INTO diary VALUES (?, ?, ?, ?)", (time.time(), self.session, step, what))

    def store(self, step: int, point: Point) -> None:
        """Stores a step's point, whole: it is on the disk when this returns.

        Raises :class:`~sherkit.errors.ExperimentError` where the step is stored already.
        """
        # SQLite has no NaN; an empty cell is NULL
        rows = [
            (step, place, name, None if value != value else float(value))
            for place, (name, value) in enumerate(point.values.items())
        ]
        try:
            with self._db:
                self._db.execute("BEGIN IMMEDIATE")
                self._db.execute(
                    "INSERT INTO point VALUES (?, ?, ?, ?, ?)",
                    (step, self.session, point.pose, point.repeat, point.time_s),
                )
                self._db.executemany("INSERT INTO reading VALUES (?, ?, ?, ?)", rows)
        except sqlite3.IntegrityError as error:
            raise ExperimentError(f"{self.path}: step {step} is stored already ({error})") from None
        except sqlite3.Error as error:
            raise ExperimentError(f"{self.path}: step {step} could not be stored: {error}") from None

    # --- reading

    def about(self, key: str) -> str:
        """What the run holds of ``plan``, ``robot``, ``experiment`` …; "" where it holds nothing."""
        with self._sound():
            found = self._db.execute("SELECT value FROM run WHERE key = ?", (key,)).fetchone()
        return str(found[0]) if found is not None else ""

    @property
    def plan(self) -> Plan:
        """The plan that the run was begun with."""
        with self._sound():
            return Plan.from_json(self.about("plan"))

    def done(self) -> set[int]:
        """Numbers of the steps that are stored."""
        with self._sound():
            return {int(row[0]) for row in self._db.execute("SELECT step FROM point")}

    def points(self) -> list[Point]:
        """Every stored point, in the order of the steps."""
        values: dict[int, dict[str, float]] = {}
        with self._sound():
            for step, name, value in self._db.execute("SELECT step, name, value FROM reading ORDER BY step, place"):
                values.setdefault(step, {})[name] = float("nan") if value is None else float(value)
            found = self._db.execute("SELECT step, pose, repeat, time_s FROM point ORDER BY step")
            return [Point(int(p), int(r), float(t), values.get(step, {})) for step, p, r, t in found]

    def diary(self) -> list[tuple[float, int | None, str]]:
        """When, at which step, what."""
        with self._sound():
            return [(float(a), b, str(c)) for a, b, c in self._db.execute("SELECT at_s, step, what FROM diary")]

    def instruments(self) -> list[tuple[int, str, str, str, str]]:
        """Session, name, kind, identity and port of every instrument of every session."""
        with self._sound():
            return list(self._db.execute("SELECT session, name, kind, identity, port FROM instrument"))

    def frame(self) -> pl.DataFrame:
        """The rows in the order of their steps: step, time, pose, repeat, and a column for every value."""
        with self._sound():
            points = self._db.execute("SELECT step, time_s, pose, repeat FROM point ORDER BY step").fetchall()
            place = {row[0]: k for k, row in enumerate(points)}
            columns: dict[str, list[float | None]] = {}
            for step, name, value in self._db.execute("SELECT step, name, value FROM reading ORDER BY step, place"):
                columns.setdefault(str(name), [None] * len(points))[place[step]] = value
            head = {
                "step": pl.Series([row[0] for row in points], dtype=pl.Int64),
                TIME: pl.Series([row[1] for row in points], dtype=pl.Float64),
                POSE: pl.Series([row[2] for row in points], dtype=pl.Int64),
                REPEAT: pl.Series([row[3] for row in points], dtype=pl.Int64),
            }
            return pl.DataFrame({**head, **{n: pl.Series(v, dtype=pl.Float64) for n, v in columns.items()}})

    def measurements(self) -> Measurements:
        """The rows as measurements, by time. Raises :class:`~sherkit.errors.MeasurementError` where there are none."""
        return from_frame(exported(self.frame()), str(self.path))


def exported(frame: pl.DataFrame) -> pl.DataFrame:
    """The columns of a run that a person or program goes on with: time counted from the first row, no step numbers."""
    first = frame[TIME].min() if len(frame) else 0.0
    return frame.drop("step").with_columns(pl.col(TIME) - first)


def export_run(source: str | Path, destination: str | Path) -> int:
    """Writes a run's rows as CSV or Parquet, by the ending of the name; returns how many. Reads a run that goes on.

    Raises :class:`~sherkit.errors.ExperimentError`.
    """
    destination = Path(destination)
    if destination.suffix.lower() not in (".csv", *PARQUET) and not is_output(destination):
        raise ExperimentError(f"{destination}: expected a name that ends in .csv or .parquet")
    with RunFile.open(source) as run:
        frame = run.frame()
    if not len(frame):
        raise ExperimentError(f"{source}: holds no row yet")
    write_table(exported(frame), destination)
    return len(frame)
