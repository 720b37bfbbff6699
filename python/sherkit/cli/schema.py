"""``sherkit schema``: what files hold, as JSON schema for editors, from what their readers ask for."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from types import FunctionType
from typing import Any

import click

from ..base.extensions import SCHEMAS, brought, declared
from ..data.declared import AskedTable, Inner, merged
from ..data.toml import Schema
from ..errors import ExperimentError, SherkitError
from ..model.kinds import known_kinds
from . import output
from .machine_file import other_machines


@click.command()
@click.argument("file", type=click.Choice(("robot", *(name for name in declared(SCHEMAS) if name != "robot"))))
def schema(file: str) -> None:
    """Print what a FILE of this sort may hold, as JSON schema: editors check and complete TOML with it."""
    of_others = None if file == "robot" else brought(SCHEMAS, file, FunctionType)
    if file != "robot" and of_others is None:
        raise SherkitError(f"schema {file}: what makes it cannot be loaded")
    made = _robots() if of_others is None else of_others()
    output.print_json({"$schema": "https://json-schema.org/draft/2020-12/schema", "title": f"sherkit {file}", **made})


def _robots() -> Schema:
    """One schema for each kind: its reader is shown an example."""
    named = {"type": "object", "additionalProperties": {"type": "string"}}
    columns = {"columns": {"description": "names of columns of its runs, by ours", **named}}
    out = []
    for kind in known_kinds().values():
        if kind.example is not None:
            whole = _whole(kind.example)
            ways = [whole, *({**whole, **one} for one in kind.spelt)]
            out.append(_of_kind(kind.name, merged([asked(one, kind.robot.from_table) for one in ways]), columns))
    for name, other in other_machines().items():
        out.append(_of_kind(name, asked(_whole(other.example), type(other.example).from_table), {}))
    return {"oneOf": out}


def _whole(example: Any) -> dict[str, Any]:
    """Its tables; those that a file may leave out are asked for all the same."""
    inner: dict[str, Any] = {name: {} for name, one in getattr(example, "TABLES", {}).items() if isinstance(one, Inner)}
    return inner | example.to_tables()


def _of_kind(name: str, asked: Schema, more: Schema) -> Schema:
    known = {"kind": {"const": name}, **asked["properties"], **more}
    return {
        **asked,
        "properties": dict(sorted(known.items())),
        "required": sorted({"kind", *asked.get("required", ())}),
    }


def asked(tables: Mapping[str, Any], reader: Callable[[AskedTable], object]) -> Schema:
    """What the reader of a file asks of it."""
    table = AskedTable(tables, "an example", error=ExperimentError)
    with suppress(SherkitError):  # an example need not be one that works
        reader(table)
    return table.schema()
