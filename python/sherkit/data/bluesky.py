"""Runs that bluesky took: its documents, as a ``RunEngine``, Tiled or databroker gives them."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from ..base.arguments import validate_arguments
from ..base.figures import listed, nearest
from ..errors import MeasurementError
from .called import Columns
from .columns import POSE, TIME, bare
from .frames import from_frame
from .rows import Measurements


@validate_arguments
def from_bluesky(
    documents: Any, *, columns: Columns | None = None, stream: str = "primary", poses: bool = False
) -> Measurements:
    """Measurements from the documents of one run of bluesky.

    ``documents`` are pairs of name and document, as ``RE.subscribe`` hears them and ``run.documents()`` of Tiled or
    ``run.canonical(fill="yes")`` of databroker gives them; or the path of a file with one such pair as JSON on each
    line (``suitcase.jsonl``). Of each event of ``stream`` a row is made: a number for every data key that holds one,
    ``time_s`` from the beginning of the run, and with ``poses`` its number as ``pose``: no two rows are repeats then.

    A key is read under its name with its unit at the end (``x`` in mm as ``x_mm``); ``columns`` gives the keys of
    others by our names, ``{"q1_mm": "rails_q1"}``, as in :func:`~sherkit.data.read_measurements`.

    Raises :class:`~sherkit.errors.MeasurementError` naming document, stream, key, and what was expected.

        names = {"q1_mm": "rails_q1", "q2_mm": "rails_q2", "q3_mm": "rails_q3"}
        names |= {"x_mm": "laser_out1", "y_mm": "laser_out2", "z_mm": "laser_out3"}
        run = sk.from_bluesky("run.jsonl", columns=names)
    """
    source, pairs = _pairs(documents)
    begun, keys, rows = _events(pairs, stream, source)
    stated = {key: f"{key} [{unit}]" if (unit := str(about.get("units") or "")) else key for key, about in keys.items()}
    named = _named(columns or {}, stated, source)
    taken = [key for key in keys if all(_is_number(data.get(key)) for _, data in rows)]
    left = [key for key in named if key not in taken]
    if left:
        raise MeasurementError(f"{source}: key '{left[0]}' does not hold a number in every event of '{stream}'")
    table: dict[str, list[Any]] = {TIME: [time_s - begun for time_s, _ in rows]}
    if poses:
        table[POSE] = list(range(len(rows)))
    mapped: dict[str, str] = {}
    for key in taken:
        values = [data[key] for _, data in rows]
        unit = str(keys[key].get("units") or "")
        if key in named:
            mapped[named[key]] = stated[key]
            table[stated[key]] = values
        else:
            table[key if not unit or bare(key) != key else f"{key}_{unit}"] = values
    return from_frame(table, source, columns=mapped)


def _pairs(documents: Any) -> tuple[str, Iterator[tuple[str, Mapping[str, Any]]]]:
    if isinstance(documents, str | Path):
        return str(documents), _lines(Path(documents))
    if isinstance(documents, Iterable) and not isinstance(documents, Mapping):
        return "documents", _checked(documents, "documents")
    raise MeasurementError(
        f"documents: expected pairs of name and document, or a file of them; got {type(documents).__name__}"
    )


def _lines(path: Path) -> Iterator[tuple[str, Mapping[str, Any]]]:
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise MeasurementError(f"{path}: cannot be read: {getattr(error, 'strerror', None) or error}") from None
    found = []
    for number, line in enumerate(text.splitlines(), start=1):
        if not line.strip():
            continue
        try:
            found.append(json.loads(line))
        except (ValueError, RecursionError):
            raise MeasurementError(f"{path}: line {number} is not JSON; expected a pair of name and document") from None
    return _checked(found, str(path))


def _checked(documents: Iterable[Any], source: str) -> Iterator[tuple[str, Mapping[str, Any]]]:
    for number, one in enumerate(documents, start=1):
        whole = isinstance(one, list | tuple) and len(one) == 2 and isinstance(one[0], str)
        if not whole or not isinstance(one[1], Mapping):
            raise MeasurementError(f"{source}: document {number} is no pair of name and document")
        yield one[0], one[1]


def _events(
    pairs: Iterator[tuple[str, Mapping[str, Any]]], stream: str, source: str
) -> tuple[float, Mapping[str, Mapping[str, Any]], list[tuple[float, Mapping[str, Any]]]]:
    """When the run began, s; the data keys of the stream; time and data of each event."""
    started: list[float] = []
    streams: dict[str, str] = {}
    keys: dict[str, Mapping[str, Any]] = {}
    rows: list[tuple[float, Mapping[str, Any]]] = []
    try:
        for name, document in pairs:
            if name == "start":
                started.append(float(document["time"]))
            elif name == "descriptor":
                streams[document["uid"]] = str(document.get("name", "primary"))
                if streams[document["uid"]] == stream:
                    keys |= {str(key): dict(about) for key, about in document["data_keys"].items()}
            elif name in ("event", "event_page") and streams.get(document["descriptor"]) == stream:
                rows += (
                    _of_page(document) if name == "event_page" else [(float(document["time"]), dict(document["data"]))]
                )
    except (KeyError, TypeError, ValueError, IndexError, AttributeError, OverflowError) as error:
        raise MeasurementError(f"{source}: a document of kind '{name}' lacks or garbles {error}") from None
    if len(started) != 1:
        raise MeasurementError(f"{source}: holds {len(started)} runs; expected one, from its start to its stop")
    if not rows:
        has = listed(sorted(set(streams.values()))) or "none"
        raise MeasurementError(f"{source}: holds no event of the stream '{stream}'; streams are {has}")
    return started[0], keys, rows


def _of_page(page: Mapping[str, Any]) -> list[tuple[float, Mapping[str, Any]]]:
    data = page["data"]
    return [(float(t), {key: values[k] for key, values in data.items()}) for k, t in enumerate(page["time"])]


def _named(columns: Columns, stated: Mapping[str, str], source: str) -> dict[str, str]:
    """Our names by key."""
    out: dict[str, str] = {}
    for ours, key in columns.items():
        if key not in stated:
            raise MeasurementError(
                f"{source}: has no key '{key}', which is to be read as '{ours}'{nearest(key, stated)}; "
                f"keys are {listed(stated, 12)}"
            )
        if key in out:
            raise MeasurementError(f"{source}: key '{key}' is to be read as two columns")
        out[key] = ours
    return out


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) or (hasattr(value, "dtype") and getattr(value, "shape", None) == ())
