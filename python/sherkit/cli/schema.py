"""``sherkit schema``: what files hold, as JSON schema for editors, from what their readers ask for."""

from __future__ import annotations

import tempfile
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import click
import tomli_w

from ..data.files import write_whole
from ..data.toml import Schema, Table, merged, watched
from ..errors import SherkitError
from ..lab.experiment import load_experiment
from ..lab.experiment.file import names_of_poses
from ..lab.kinds import instrument_kinds
from ..model.kinds import Kind, known_kinds
from ..model.robot_file import load_robot
from ..robots.tool.tool import FlexibleTool, load_tool
from . import output

_LIMITS = {"mm": ("limits_mm", [60.0, 200.0]), "rad": ("limits_deg", [-180.0, 270.0])}


@click.command()
@click.argument("file", type=click.Choice(("robot", "experiment", "laboratory")))
def schema(file: str) -> None:
    """Print what a FILE of this sort may hold, as JSON schema: editors check and complete TOML with it."""
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        made = {"robot": _robots, "experiment": _experiments, "laboratory": _laboratories}[file](Path(folder))
    output.print_json({"$schema": "https://json-schema.org/draft/2020-12/schema", "title": f"sherkit {file}", **made})


def _robots(folder: Path) -> Schema:
    """One schema for each kind: its reader is shown an example."""
    examples: dict[str, tuple[list[Mapping[str, Any]], Callable[[Path], object]]] = {}
    for kind in known_kinds().values():
        if kind.example is not None:
            whole = kind.example.to_tables()
            examples[kind.name] = ([whole, *({**whole, **one} for one in kind.spelt)], load_robot)
    tool = FlexibleTool().to_tables()
    examples[tool["kind"]] = ([tool], load_tool)
    out = []
    for name, (ways, reader) in examples.items():
        made = merged([_asked(folder / f"{name}.toml", tables, reader) for tables in ways])
        made["properties"]["kind"] = {"const": name}
        if reader is load_robot:
            named = {"type": "object", "additionalProperties": {"type": "string"}}
            made["properties"]["columns"] = {"description": "names of columns of its runs, by ours", **named}
        out.append(made)
    return {"oneOf": out}


def _experiments(folder: Path) -> Schema:
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

    return _of_kinds(folder, examples, lambda path: load_experiment(path, offline=True))


def _laboratories(folder: Path) -> Schema:
    """Every emulated instrument around every kind of robot."""
    from ..lab.laboratory import load_laboratory

    def examples(kind: Kind, robot: str) -> Iterator[Mapping[str, Any]]:
        shown = [n for n, row in instrument_kinds().items() if row.emulator and row.sees(kind.example)]
        parts = [{"kind": name, "name": name} for name in shown]
        yield {"robot": robot, "instrument": parts, "tool": {}}
        yield {"robot": robot, "instrument": parts}

    return _of_kinds(folder, examples, load_laboratory)


def _of_kinds(
    folder: Path, examples: Callable[[Kind, str], Iterator[Mapping[str, Any]]], reader: Callable[[Path], object]
) -> Schema:
    found = []
    for kind in known_kinds().values():
        if kind.example is None or not kind.poses:  # no plan can name poses of such a robot
            continue
        tables = kind.example.to_tables()
        key, limits = _LIMITS[kind.example.joint_unit]
        tables["joints"] = {**tables.get("joints", {}), key: limits}
        write_whole(folder / f"{kind.name}.toml", tomli_w.dumps(tables))
        found += [_asked(folder / "file.toml", one, reader) for one in examples(kind, f"{kind.name}.toml")]
    return merged(found)


def _asked(path: Path, tables: Mapping[str, Any], reader: Callable[[Path], object]) -> Schema:
    """What the reader of a file asks of it."""
    write_whole(path, tomli_w.dumps(tables))
    with watched() as seen, suppress(SherkitError):  # an example need not be one that works
        reader(path)
    mine: list[Table] = [one for one in seen if one.where == str(path)]
    return merged([one.schema() for one in mine], one_table=True)
