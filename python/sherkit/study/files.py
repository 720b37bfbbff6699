"""The steps of a study, and its folder: steps as JSON, which name the file of its rows, whole or not there."""

from __future__ import annotations

import hashlib
import io
import itertools
import json
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from ..base.types import Ints
from ..data import Measurements, from_frame
from ..data.files import write_whole
from ..data.tables import parquet_errors
from ..data.toml import Table
from ..errors import EffectError, NotWritten, SherkitError
from ..fit.error import ErrorSize
from ..fit.identify import Fit
from ..model.chain import ChainModel
from ..model.effect import Effect, as_written, effects_by_name
from ..model.kinds import Robot, model_of


@dataclass(frozen=True, eq=False)
class StudyStep:
    """One state of a study: what was done, and the ``error`` it left on poses held out, beside that of the rows it was
    ``fitted`` to.

    ``fit`` is None for steps of a loaded study whose rows were others than the last ones: those were not kept.
    """

    action: str
    effects: tuple[str, ...]
    fitted: ErrorSize
    error: ErrorSize
    parameters: dict[str, float]
    rows: int
    fit: Fit | None

    def __repr__(self) -> str:
        return f"StudyStep({self.action}: {self.error})"


@dataclass(frozen=True, eq=False)
class Before:
    """What a change took the place of. The ``step`` that recorded it is not known of a study that was saved."""

    model: ChainModel
    data: Measurements
    step: StudyStep | None = None
    #: What the change was; empty where the study was saved before that was kept.
    action: str = ""


# -- In the folder of a study -----------------------------------------------------------------------------------------

_FORMAT = 4
_STATE = "study.json"
#: How large an error is, in a file.
_SIZES = ("mean", "rms", "p95", "max")
#: No table has a line beyond.
_MOST_LINES = 2**53


def write_study(folder: Path, state: Mapping[str, Any], data: Measurements) -> None:
    """Writes steps and rows. Raises :class:`~sherkit.errors.NotWritten`, and
    :class:`~sherkit.errors.SherkitError` where the folder's ``study.json`` is another program's.

    The rows are there, under a name that no file has, before the steps that name them: a crash at any moment leaves the
    old study or the new one. Of what else is in the folder, only the rows that the old steps name are taken away, and
    only where they are what was written.
    """
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)  # who measured decides who reads it
    except OSError as error:
        raise NotWritten(folder, error) from None
    before = _rows_in(folder)
    held = io.BytesIO()
    data.to_frame().write_parquet(held)
    wanted = _hash(held.getvalue())
    rows = next(n for n in _names(wanted) if not os.path.lexists(folder / n) or _holds(folder / n, wanted))
    if not (folder / rows).exists():
        write_whole(folder / rows, held.getvalue())
    kept = {"source": data.source, "counted": data.counted, "line": _packed(data.line)}
    known = {"format": _FORMAT, "rows": rows, "rows_sha256": wanted, **kept}
    write_whole(folder / _STATE, json.dumps({**known, **state}, indent=2, allow_nan=False))
    if before is not None and before[0] != rows and _holds(folder / before[0], before[1]):
        (folder / before[0]).unlink(missing_ok=True)


def _rows_in(folder: Path) -> tuple[str, str] | None:
    """Name and hash of the rows of the study that is in a folder; None where it says neither, as older ones do not."""
    try:
        state = json.loads((folder / _STATE).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return None  # none there, or cut by hand
    if not isinstance(state, dict) or not isinstance(state.get("format"), int):
        raise SherkitError(f"{folder / _STATE}: is no study; give the study another folder")
    name, wanted = state.get("rows"), state.get("rows_sha256")
    if not isinstance(name, str) or not isinstance(wanted, str) or name != Path(name).name:
        return None  # nor is a path that leads elsewhere
    return name, wanted


def _names(wanted: str) -> Iterator[str]:
    """Names for rows of this hash, from the first on that is free."""
    return (f"rows-{wanted[:32]}{f'-{k}' if k else ''}.parquet" for k in itertools.count())


def _holds(path: Path, wanted: str) -> bool:
    """Whether a file is the one that was written, by its hash; a link is none that was."""
    try:
        return path.is_file() and not path.is_symlink() and _hash(path.read_bytes()) == wanted
    except OSError:
        return False


def _hash(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def read_state(folder: Path) -> Table:
    """The steps, key by key. Raises :class:`~sherkit.errors.SherkitError` where there are none of this version."""
    path = folder / _STATE
    try:
        state = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise SherkitError(f"{folder}: holds no study that can be read: {error}") from None
    if not isinstance(state, dict) or state.get("format") != _FORMAT:
        raise SherkitError(f"{folder}: is not a study of this version (expected format {_FORMAT})")
    table = Table(state, str(path), error=SherkitError)
    table.pass_over("format")
    return table


def read_rows(folder: Path, state: Table) -> Measurements:
    """The rows that the steps name. Raises :class:`~sherkit.errors.SherkitError` where they are not those written."""
    name = state.words("rows")
    try:
        # only a name that this folder's own files have: nothing outside it is read
        content = (folder / Path(name).name).read_bytes()
    except (OSError, ValueError):
        raise SherkitError(f"{folder}: its rows ({name}) are not there") from None
    found = _hash(content)
    # older studies have the hash in the name alone
    written = state.words("rows_sha256") if state.has("rows_sha256") else None
    if found != written if written is not None else not name.startswith(f"rows-{found[:32]}."):
        raise SherkitError(f"{folder / name}: is damaged: it is not what the study wrote")
    with parquet_errors(folder / name):
        frame = pl.read_parquet(io.BytesIO(content))
    data = from_frame(frame, state.words("source", empty=True))
    stretches = [(int(first), int(count)) for first, count in state.rows("line", 2)]
    counted = state.text("counted", ("line", "row"))
    sensible = all(0 <= first < _MOST_LINES and count >= 1 for first, count in stretches)
    if not sensible or sum(count for _, count in stretches) != len(data):
        raise state.fail("line", f"first and count of stretches that make {len(data)} rows")
    # rows keep the numbers by which people know them
    line = np.concatenate([np.arange(count, dtype=np.int64) + first for first, count in stretches])
    return replace(data, line=line, counted=counted)


def _packed(line: Ints) -> list[list[int]]:
    """Numbers that mostly go up by one, as first and count of each stretch."""
    starts = np.flatnonzero(np.diff(line, prepend=line[0] - 2) != 1)
    counts = np.diff(np.append(starts, len(line)))
    return [[int(line[start]), int(count)] for start, count in zip(starts, counts, strict=True)]


def finite(figures: Mapping[str, float]) -> dict[str, float]:
    """Figures that a file can hold."""
    return {name: value for name, value in figures.items() if np.isfinite(value)}


def error_state(error: ErrorSize) -> dict[str, Any]:
    """An error, for a file."""
    sizes = finite({name: getattr(error, name) for name in _SIZES})
    known = {"unit": error.unit, "held_out": error.held_out, "axes": error.axes, "rows": error.rows}
    return {**sizes, **known, "by_reading": finite(error.by_reading)}


def error_from(step: Table, key: str) -> ErrorSize:
    """The error that a step has under this key."""
    with step.table(key) as t:
        sizes = [t.number(name, float("nan")) if t.has(name) else float("nan") for name in _SIZES]
        with t.table("by_reading") as b:
            by_reading = {name: b.number(name) for name in b.names()}
        mean, rms, p95, most = sizes
        return ErrorSize(
            mean,
            rms,
            p95,
            most,
            unit=t.words("unit"),
            held_out=t.flag("held_out", False),
            axes=t.whole("axes", least=1),
            rows=t.whole("rows", least=0),
            by_reading=by_reading,
        )


def model_state(model: ChainModel) -> dict[str, Any]:
    """What is free in a model, with its effects and their settings."""
    return {
        "free": list(model.free),
        "effects": [e.name for e in model.effects],
        **as_written(model.settings()),
    }


def model_from(state: Table, robot: Robot, own: Sequence[Effect]) -> ChainModel:
    """The model of a state of the study. Raises :class:`~sherkit.errors.EffectError` where an effect is not known."""
    plain = model_of(robot, state.texts("free"))
    try:
        effects = effects_by_name(plain.known_effects, state.texts("effects"), own)
    except EffectError as error:
        raise EffectError(f"{error}; your own are given again: Study.load(folder, effects=[...])") from None
    settings: dict[str, Any] = {name: state.one_or_more(name) if state.has(name) else None for name in plain.settings()}
    return replace(plain, effects=effects, **settings)


def before_state(before: Before) -> dict[str, Any]:
    """What can be undone, for a file: rows are only ever added, and marked."""
    outliers = np.flatnonzero(before.data.outlier).tolist()
    return {**model_state(before.model), "action": before.action, "rows": len(before.data), "outliers": outliers}


def rows_from(undone: Table, data: Measurements) -> Measurements:
    """The rows of a state that can be undone, from those of the study."""
    count = undone.whole("rows", least=1)
    if count > len(data):
        raise undone.fail("rows", f"no more than the {len(data)} rows of the study")
    marked = np.zeros(count, dtype=bool)
    for row in undone.wholes("outliers"):
        if not 0 <= row < count:
            raise undone.fail("outliers", f"rows from 0 to {count - 1}")
        marked[row] = True
    return replace(data.select(np.arange(count)), outlier=marked)


def step_state(step: StudyStep) -> dict[str, Any]:
    """A step of the history, for a file."""
    return {
        "action": step.action,
        "effects": list(step.effects),
        "fitted": error_state(step.fitted),
        "error": error_state(step.error),
        "parameters": finite(step.parameters),
        "rows": step.rows,
    }


def step_from(one: Table) -> StudyStep:
    """A step of the history, without its fit."""
    with one.table("parameters") as t:
        parameters = {name: t.number(name) for name in t.names()}
    return StudyStep(
        action=one.words("action"),
        effects=one.texts("effects"),
        rows=one.whole("rows", least=0),
        fit=None,
        fitted=error_from(one, "fitted"),
        error=error_from(one, "error"),
        parameters=parameters,
    )
