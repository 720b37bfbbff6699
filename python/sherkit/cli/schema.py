"""``sherkit schema``: what files hold, as JSON schema for editors, from what their readers ask for."""

from __future__ import annotations

import tempfile
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import click
import tomli_w

from ..data.declared import AskedTable, Inner, merged
from ..data.files import write_whole
from ..data.toml import Schema
from ..errors import ExperimentError, SherkitError
from ..lab.experiment.file import experiment_from, names_of_poses
from ..lab.instruments.own import OwnCode
from ..lab.kinds import instrument_kinds
from ..model.kinds import Kind, known_kinds
from ..robots.tool.tool import FlexibleTool
from . import output

_LIMITS = {"mm": ("limits_mm", [60.0, 200.0]), "rad": ("limits_deg", [-180.0, 270.0])}


@click.command()
@click.argument("file", type=click.Choice(("robot", "experiment", "laboratory")))
def schema(file: str) -> None:
    """Print what a FILE of this sort may hold, as JSON schema: editors check and complete TOML with it."""
    made = {"robot": _robots, "experiment": _experiments, "laboratory": _laboratories}[file]()
    output.print_json({"$schema": "https://json-schema.org/draft/2020-12/schema", "title": f"sherkit {file}", **made})


def _robots() -> Schema:
    """One schema for each kind: its reader is shown an example."""
    named = {"type": "object", "additionalProperties": {"type": "string"}}
    columns = {"columns": {"description": "names of columns of its runs, by ours", **named}}
    out = []
    for kind in known_kinds().values():
        if kind.example is not None:
            # tables that a file may leave out are asked for all the same
            inner: dict[str, Any] = {
                name: {} for name, one in getattr(kind.robot, "TABLES", {}).items() if isinstance(one, Inner)
            }
            whole = inner | kind.example.to_tables()
            ways = [whole, *({**whole, **one} for one in kind.spelt)]
            out.append(_of_kind(kind.name, merged([_asked(one, kind.robot.from_table) for one in ways]), columns))
    tool = FlexibleTool().to_tables()
    return {"oneOf": [*out, _of_kind(tool["kind"], _asked(tool, FlexibleTool.from_table), {})]}


def _of_kind(name: str, asked: Schema, more: Schema) -> Schema:
    known = {"kind": {"const": name}, **asked["properties"], **more}
    return {
        **asked,
        "properties": dict(sorted(known.items())),
        "required": sorted({"kind", *asked.get("required", ())}),
    }


def _experiments() -> Schema:
    """Every set of poses and every instrument of every kind of robot."""

    def examples(kind: Kind, robot: str) -> Iterator[Mapping[str, Any]]:
        rules: dict[str, Any] = {"robot": robot, "goal": {}}
        for poses in names_of_poses(kind):
            yield {**rules, "plan": {"poses": poses}}
        yield {**rules, "adaptive": {}}
        # any set of poses, and each instrument by itself: none keeps the others from being asked
        simplest = min(kind.poses, key=len)
        for name in instrument_kinds():
            yield {**rules, "plan": {"poses": simplest}, "instrument": [{"kind": name, "address": "http://x"}]}

    return _of_kinds(examples, partial(experiment_from, code=OwnCode(), offline=True))


def _laboratories() -> Schema:
    """Every emulated instrument around every kind of robot."""
    from ..lab.laboratory import laboratory_from

    def examples(kind: Kind, robot: str) -> Iterator[Mapping[str, Any]]:
        shown = [n for n, row in instrument_kinds().items() if row.emulator and row.sees(kind.example)]
        parts = [{"kind": name, "name": name} for name in shown]
        yield {"robot": robot, "instrument": parts, "tool": {}}
        yield {"robot": robot, "instrument": parts}

    return _of_kinds(examples, laboratory_from)


def _of_kinds(
    examples: Callable[[Kind, str], Iterator[Mapping[str, Any]]], reader: Callable[[AskedTable, Path], object]
) -> Schema:
    found = []
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        path = Path(folder) / "robot.toml"
        for kind in known_kinds().values():
            if kind.example is None or not kind.poses:  # no plan can name poses of such a robot
                continue
            tables = kind.example.to_tables()
            key, limits = _LIMITS[kind.example.joint_unit]
            tables["joints"] = {**tables.get("joints", {}), key: limits}
            write_whole(path, tomli_w.dumps(tables))
            found += [_asked(one, lambda table: reader(table, path)) for one in examples(kind, path.name)]
    return merged(found)


def _asked(tables: Mapping[str, Any], reader: Callable[[AskedTable], object]) -> Schema:
    """What the reader of a file asks of it."""
    table = AskedTable(tables, "an example", error=ExperimentError)
    with suppress(SherkitError):  # an example need not be one that works
        reader(table)
    return table.schema()
