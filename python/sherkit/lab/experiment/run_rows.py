"""The rows of a run file, and what is said of them: reading alone, also while a program writes."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Mapping
from functools import wraps
from pathlib import Path
from typing import Any, TypeVar, cast

import polars as pl

from ...base.figures import on_one_line
from ...data import Measurements, from_frame
from ...data.columns import OUTLIER, POSE, REASON, REPEAT, TIME
from ...errors import ExperimentError
from .plan import Plan, Point

# -- A run file as a database ---------------------------------------------------------------------------------------

#: "Sher", in the file's header: what kind of database this is.
_APPLICATION = 0x53686572
FORMAT = 2
#: Runs of an earlier version, which can be read and not gone on with.
READ_TOO = ("1", "2")
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
    repeat INTEGER NOT NULL, time_s REAL NOT NULL, wall_s REAL NOT NULL, UNIQUE (pose, repeat)
) STRICT;
CREATE TABLE reading (
    step INTEGER NOT NULL REFERENCES point, place INTEGER NOT NULL, name TEXT NOT NULL, value REAL,
    PRIMARY KEY (step, place), UNIQUE (step, name)
) STRICT, WITHOUT ROWID;
CREATE TABLE doubt (step INTEGER PRIMARY KEY REFERENCES point, instrument TEXT NOT NULL, why TEXT NOT NULL) STRICT;
CREATE TABLE former (
    step INTEGER NOT NULL, session INTEGER NOT NULL, time_s REAL NOT NULL, instrument TEXT NOT NULL, why TEXT NOT NULL,
    readings TEXT NOT NULL
) STRICT;
CREATE TABLE diary (at_s REAL NOT NULL, session INTEGER, step INTEGER, what TEXT NOT NULL) STRICT;
"""


def connected(path: Path) -> sqlite3.Connection:
    """Opens a run file, or one that is not there yet, so that what is written in it outlives the machine.

    Raises :class:`~sherkit.errors.ExperimentError` for another program's database, before anything is changed in it.
    """
    db: sqlite3.Connection | None = None
    try:
        db = sqlite3.connect(path, isolation_level=None, timeout=10.0)
        # a file from somebody else must not run code of its own
        db.execute("PRAGMA trusted_schema = OFF")
        tables = db.execute("SELECT count(*) FROM sqlite_master").fetchone()[0]
        kind = db.execute("PRAGMA application_id").fetchone()[0]
        if tables and kind != _APPLICATION:
            db.close()
            raise ExperimentError(f"{path}: is a database, but no run file")
        db.execute("PRAGMA journal_mode = WAL")
        db.execute("PRAGMA synchronous = FULL")
        db.execute("PRAGMA foreign_keys = ON")
    except (sqlite3.Error, UnicodeError) as error:
        # what SQLite says may quote the file, and be no text
        if db is not None:
            db.close()
        raise ExperimentError(f"{path}: cannot be opened as a run file: {error}") from None
    return db


def make_tables(db: sqlite3.Connection, values: Mapping[str, str]) -> None:
    """Makes a run of a bare file, with what it holds beside its rows: within a transaction, whole or not at all."""
    db.execute("BEGIN IMMEDIATE")
    for statement in _statements(_TABLES):
        db.execute(statement)
    db.executemany("INSERT INTO run VALUES (?, ?)", values.items())
    db.execute(f"PRAGMA application_id = {_APPLICATION}")


def is_bare(db: sqlite3.Connection) -> bool:
    """Whether nothing is in it: a program died before the run was begun."""
    return not db.execute("SELECT count(*) FROM sqlite_master").fetchone()[0]


def holds_nothing_else(db: sqlite3.Connection) -> bool:
    """Whether its tables are those of a run: a view or a trigger of somebody else's could run for ever."""
    found = {str(sql) for (sql,) in db.execute("SELECT sql FROM sqlite_master WHERE sql IS NOT NULL")}
    # runs of the first version had no wall clock in their points
    return found <= {*_statements(_TABLES), *_statements(_TABLES.replace("wall_s REAL NOT NULL, ", ""))}


def _statements(text: str) -> list[str]:
    return [one.strip().rstrip(";") for one in text.split(";\n") if one.strip()]


# -- Its rows --------------------------------------------------------------------------------------------------------

#: What SQLite says where the disk or another program stands in the way, not what is in the file.
_OUTSIDE = ("SQLITE_FULL", "SQLITE_IOERR", "SQLITE_BUSY", "SQLITE_LOCKED", "SQLITE_CANTOPEN", "SQLITE_READONLY")

_Method = TypeVar("_Method", bound=Callable[..., Any])


def reads(method: _Method) -> _Method:
    """What is wrong with the file, or with what is in it, as a sentence."""

    @wraps(method)
    def sound(self: RunRows, *args: Any, **kwargs: Any) -> Any:
        try:
            return method(self, *args, **kwargs)
        except sqlite3.OperationalError as error:
            outside = getattr(error, "sqlite_errorname", "").startswith(_OUTSIDE)
            what = "cannot be read now" if outside else "is damaged and cannot be read"
            raise ExperimentError(f"{self.path}: {what}: {on_one_line(error)}") from None
        except (sqlite3.Error, pl.exceptions.PolarsError, ValueError, TypeError, LookupError, OverflowError) as error:
            raise ExperimentError(f"{self.path}: is damaged and cannot be read: {on_one_line(error)}") from None

    return cast(_Method, sound)


class RunRows:
    """What an open run file holds. Raises :class:`~sherkit.errors.ExperimentError` where it is damaged."""

    def __init__(self, path: Path, connection: sqlite3.Connection) -> None:
        self.path = path
        self._db = connection

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
        if doubts := self.doubts():
            head[OUTLIER] = pl.Series([int(row[0] in doubts) for row in points], dtype=pl.Int64)
        reasons = {k: step.reason for k, step in enumerate(self.plan.steps)} if points else {}
        told = {REASON: pl.Series([reasons.get(row[0], "") for row in points])} if any(reasons.values()) else {}
        return pl.DataFrame({**head, **{n: pl.Series(v, dtype=pl.Float64) for n, v in columns.items()}, **told})

    def measurements(self) -> Measurements:
        """The rows as measurements, by time. Raises :class:`~sherkit.errors.MeasurementError` where there are none."""
        return from_frame(exported(self.frame()), str(self.path))


def exported(frame: pl.DataFrame) -> pl.DataFrame:
    """The columns of a run that a person or program goes on with: time counted from the first row, no step numbers."""
    first = frame[TIME].min() if len(frame) else 0.0
    return frame.drop("step").with_columns(pl.col(TIME) - first)
