"""The file of a loop: robot, settings, rows and what was asked, as JSON; one loop at a time has it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..data.lock import FileLock
from ..errors import ExperimentError, MeasurementError

KIND = "sherkit adaptive loop"
#: Settings that may be left open.
_OPEN = {"required_um", "minutes", "box"}


def text_of(robot: Any, settings: Mapping[str, Any], rows: Mapping[str, Any], asked: Mapping[str, Any]) -> str:
    """What is written."""
    held = {"kind": KIND, "robot": robot.to_tables(), "settings": settings, "rows": rows, "asked": asked}
    return json.dumps(held, indent=1) + "\n"


def held_in(where: Path) -> dict[str, Any]:
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


def asked_in(held: Mapping[str, Any], where: Path, columns: set[str]) -> tuple[list[dict[str, Any]], int]:
    """The rows of the batch that was asked for, and at which look; none of an older file."""
    kept = held.get("asked") or {"rows": [], "at": -1}
    rows, at = (kept.get("rows"), kept.get("at")) if isinstance(kept, dict) else (None, None)
    if not isinstance(rows, list) or type(at) is not int or not all(
        isinstance(row, dict) and columns <= set(row) and type(row["pose"]) is int and type(row["repeat"]) is int
        for row in rows
    ):  # fmt: skip
        raise MeasurementError(f"{where}: asked: expected the rows that were asked for, as save() writes them")
    return rows, at


def lock(path: Path) -> FileLock:
    """The lock of a loop's file. Raises :class:`~sherkit.errors.ExperimentError` where another loop has it."""
    try:
        return FileLock(path)
    except BlockingIOError as error:
        raise ExperimentError(
            f"{path}: another loop has this file ({error}): one file has one loop. End that one first (the "
            "file is given back when its loop is done or its program ends), or give another file"
        ) from None


def _short(value: Any) -> str:
    text = "null" if value is None else repr(value)
    return text if len(text) <= 40 else f"{text[:40]} …"
