"""What a reader asks of a TOML table, as JSON schema: the reader itself is the declaration of its file."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Self

from ..errors import RobotError, SherkitError
from .toml import Schema, Table


class AskedTable(Table):
    """A table that keeps what it is asked for. A key that it lacks it answers with something of the kind that was asked
    for, so that readers go on."""

    def __init__(
        self, values: Mapping[str, Any], where: str, path: str = "", error: type[SherkitError] = RobotError
    ) -> None:
        super().__init__(values, where, path, error)
        #: What was asked for: schemas by key, the keys that must be there, the tables inside.
        self._asked: dict[str, Schema] = {}
        self._needed: set[str] = set()
        self._inner: dict[str, list[Self]] = {}

    def _get(
        self, key: str, expected: str, schema: Schema, holds: Callable[[Any], bool], default: Any = None, *,
        sample: Any = None, optional: bool = False,
    ) -> Any:  # fmt: skip
        self._asked[key] = {"description": expected, **schema}
        if default is None and not optional:
            self._needed.add(key)
            default = sample
        return super()._get(key, expected, schema, holds, default, optional=optional)

    def _inside(self, key: str, values: Mapping[str, Any], name: str) -> Self:
        inner = super()._inside(key, values, name)
        self._inner.setdefault(key, []).append(inner)
        return inner

    def schema(self) -> Schema:
        """What was asked of this table so far, as JSON schema."""
        known = {key: self._asked.get(key, {}) for key in sorted(self._known)}
        for key, tables in self._inner.items():
            inside = merged([one.schema() for one in tables])
            known[key] = {"type": "array", "items": inside} if known[key].get("type") == "array" else inside
        made: Schema = {"type": "object", "properties": known, "additionalProperties": False}
        return made | ({"required": sorted(self._needed)} if self._needed else {})


def merged(schemas: Sequence[Schema]) -> Schema:
    """One schema of tables that were asked for different things: what any may have, what all must."""
    first, *others = schemas
    out = dict(first)
    for other in others:
        if "properties" in out and "properties" in other:
            known, more = out["properties"], other["properties"]
            out["properties"] = known | {k: merged([known[k], v]) if k in known else v for k, v in more.items()}
            needed = set(out.pop("required", ())) & set(other.get("required", ()))
            out |= {"required": sorted(needed)} if needed else {}
        elif "items" in out and "items" in other:
            out["items"] = merged([out["items"], other["items"]])
        elif "enum" in out and "enum" in other:
            out["enum"] = list(dict.fromkeys([*out["enum"], *other["enum"]]))
        elif other.get("properties") or other.get("items"):
            out = dict(other)
    return out
