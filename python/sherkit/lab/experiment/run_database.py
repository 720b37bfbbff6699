"""A run file as a database: its tables, and how it is opened.

Write-ahead log and ``synchronous=FULL``: what was written survives the death of the program and of the machine. A file
from somebody else runs nothing: its schema is not trusted, and is compared with ours.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Mapping
from pathlib import Path

from ...errors import ExperimentError

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
