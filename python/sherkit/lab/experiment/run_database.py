"""A run file as a database: its tables, how it is opened, and what is said where it cannot be read."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable
from contextlib import ExitStack
from functools import wraps
from pathlib import Path
from typing import Any, TypeVar, cast

import polars as pl

from ...base.figures import on_one_line
from ...errors import ExperimentError

#: "Sher", in the file's header: what kind of database this is.
APPLICATION = 0x53686572
FORMAT = 2
#: Runs of an earlier version, which can be read and not gone on with.
READ_TOO = ("1", "2")
TABLES = """
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


#: What SQLite says where the disk or another program stands in the way, not what is in the file.
_OUTSIDE = ("SQLITE_FULL", "SQLITE_IOERR", "SQLITE_BUSY", "SQLITE_LOCKED", "SQLITE_CANTOPEN", "SQLITE_READONLY")


def connected(path: Path) -> sqlite3.Connection:
    """Opens a run file, or one that is not there yet, so that what is written in it outlives the machine.

    Raises :class:`~sherkit.errors.ExperimentError` for another program's database, before anything is changed in it.
    """
    with ExitStack() as failing:
        try:
            db = sqlite3.connect(path, isolation_level=None, timeout=10.0)
            failing.callback(db.close)
            # a file from somebody else must not run code of its own
            db.execute("PRAGMA trusted_schema = OFF")
            tables = db.execute("SELECT count(*) FROM sqlite_master").fetchone()[0]
            kind = db.execute("PRAGMA application_id").fetchone()[0]
            if tables and kind != APPLICATION:
                raise ExperimentError(f"{path}: is a database, but no run file")
            for setting in ("journal_mode = WAL", "synchronous = FULL", "foreign_keys = ON"):
                db.execute(f"PRAGMA {setting}")
        except (sqlite3.Error, UnicodeError) as error:
            # what SQLite says may quote the file, and be no text
            raise ExperimentError(f"{path}: cannot be opened as a run file: {error}") from None
        failing.pop_all()
    return db


def statements(text: str) -> list[str]:
    return [one.strip().rstrip(";") for one in text.split(";\n") if one.strip()]


_Method = TypeVar("_Method", bound=Callable[..., Any])


def reads(method: _Method) -> _Method:
    """What is wrong with the file, or with what is in it, as a sentence."""

    @wraps(method)
    def sound(self: Any, *args: Any, **kwargs: Any) -> Any:
        try:
            return method(self, *args, **kwargs)
        except (sqlite3.Error, pl.exceptions.PolarsError, ValueError, TypeError, LookupError, OverflowError) as error:
            outside = getattr(error, "sqlite_errorname", "").startswith(_OUTSIDE)
            what = "cannot be read now" if outside else "is damaged and cannot be read"
            raise ExperimentError(f"{self.path}: {what}: {on_one_line(error)}") from None

    return cast(_Method, sound)
