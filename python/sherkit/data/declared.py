"""What stands where in a file, declared once by the class that it makes: reading, writing and its JSON schema follow.

    @dataclass(frozen=True)
    class Stage(Declared):
        travel_mm: tuple[float, float]
        limits_mm: tuple[float, float] | None = None
        kind: str = field(default="stage", init=False)

        TABLES: ClassVar = {
            "geometry": {"travel_mm": key(Table.numbers, 2, positive=True)},
            "joints": {"limits_mm": key(Table.heights)},
        }

Defaults are those of the class. A table is needed where one of its keys is.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import MISSING, dataclass, fields, replace
from functools import reduce
from operator import getitem
from typing import Any, ClassVar, Concatenate, ParamSpec, Self

import numpy as np

from ..errors import RobotError, SherkitError
from .toml import Schema, Table

P = ParamSpec("P")


@dataclass(frozen=True)
class Key:
    """A key of a table: how it is ``read``, and the ``attribute`` that it is, which has its name unless another is
    given, or the element of it at ``place``. Where the file leaves it out it is what the class has by itself."""

    read: Callable[..., Any]
    attribute: str = ""
    place: tuple[int, ...] = ()
    is_needed: bool = False
    is_quiet: bool = False

    def of(self, attribute: str, *place: int) -> Key:
        """The same of an attribute with another name, or of an element of it."""
        return replace(self, attribute=attribute, place=place)

    @property
    def needed(self) -> Key:
        """The same where a file must say it, though Python need not."""
        return replace(self, is_needed=True)

    @property
    def quiet(self) -> Key:
        """The same, written only where it is not what the class has by itself."""
        return replace(self, is_quiet=True)

    def default(self, usual: Mapping[str, Any]) -> Any:
        """What it is where it is left out, of what the class has by itself; MISSING where it may not be."""
        missing = self.is_needed or self.attribute not in usual
        return MISSING if missing else reduce(getitem, self.place, usual[self.attribute])


def key(method: Callable[Concatenate[Table, str, P], Any], *given: P.args, **how: P.kwargs) -> Key:
    """A key that a method of :class:`~sherkit.data.toml.Table` reads, with what it takes besides key and default."""
    return Key(lambda table, name, **default: method(table, name, *given, **how, **default))


@dataclass(frozen=True)
class Inner:
    """A table that makes an attribute of its own, by ``from_table`` and ``to_table`` of its class."""

    made: type[Any]
    attribute: str


Keys = Mapping[str, Key]


def keys_from(table: Table, keys: Keys, made: type[Any]) -> dict[str, Any]:
    """What ``keys`` of a table say, by the attributes of the class that they make."""
    usual = _usual(made)
    out: dict[str, dict[tuple[int, ...], Any]] = {}
    for name, one in _named(keys):
        default = one.default(usual)
        given = {} if default is None or default is MISSING else {"default": default}
        out.setdefault(one.attribute, {})[one.place] = one.read(table, name, **given)
    return {attribute: _joined(elements) for attribute, elements in out.items()}


def keys_of(made: object, keys: Keys) -> dict[str, Any]:
    """What :func:`keys_from` reads; None is left out."""
    usual, out = _usual(type(made)), {}
    for name, one in _named(keys):
        value = _plain(reduce(getitem, one.place, getattr(made, one.attribute)))
        if value is not None and not (one.is_quiet and value == _plain(one.default(usual))):
            out[name] = value
    return out


class Declared:
    """A dataclass with a ``kind`` that reads and writes its file by ``TABLES``: the keys of each table."""

    TABLES: ClassVar[Mapping[str, Keys | Inner]]
    kind: str

    @classmethod
    def check(cls, name: str, table: Table, values: Mapping[str, Any]) -> None:
        """Refuses, with ``table.fail``, what does not fit together: ``values`` up to those of the table called
        ``name``."""

    @classmethod
    def from_table(cls, table: Table) -> Self:
        """Reads the tables of a file. Raises what the table raises, naming file, table and key."""
        return cls(**cls.values_from(table))

    @classmethod
    def values_from(cls, table: Table) -> dict[str, Any]:
        """What ``TABLES`` say, by attributes."""
        usual, out = _usual(cls), {}
        for name, inside in cls.TABLES.items():
            if isinstance(inside, Inner):
                table.pass_over(name)
                if table.has(name) or inside.attribute not in usual:
                    with table.table(name, optional=inside.attribute in usual) as inner:
                        out[inside.attribute] = inside.made.from_table(inner)
                continue
            optional = all(one.default(usual) is not MISSING for _, one in _named(inside))
            with table.table(name, optional=optional) as inner:
                out |= keys_from(inner, inside, cls)
                cls.check(name, inner, out)
        return out

    def to_tables(self) -> dict[str, Any]:
        """What :meth:`from_table` reads, without loss."""
        out: dict[str, Any] = {"kind": self.kind}
        for name, inside in self.TABLES.items():
            if not isinstance(inside, Inner):
                out[name] = keys_of(self, inside)
            elif (made := getattr(self, inside.attribute)) is not None:
                out[name] = made.to_table()
        return {name: inside for name, inside in out.items() if inside}


def _usual(made: type[Any]) -> dict[str, Any]:
    return {one.name: one.default for one in fields(made) if one.default is not MISSING}


def _named(keys: Keys) -> Iterator[tuple[str, Key]]:
    """Each key with its attribute."""
    for name, one in keys.items():
        yield name, one if one.attribute else one.of(name)


def _joined(elements: Mapping[tuple[int, ...], Any]) -> Any:
    """Elements by their place, as tuples in tuples."""
    if () in elements:
        return elements[()]
    firsts = sorted({place[0] for place in elements})
    return tuple(_joined({p[1:]: v for p, v in elements.items() if p[0] == first}) for first in firsts)


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value.tolist()
    return [_plain(v) for v in value] if isinstance(value, tuple | list) else value


# -- What a reader asks of a table, as JSON schema: the reader itself is the declaration of its file ---------------


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
        #: What any other key holds; none may be there unless its reader takes all.
        self._others: Schema | bool = False

    def _get(
        self, key: str, expected: str, schema: Schema, holds: Callable[[Any], bool], default: Any = None, *,
        sample: Any = None, optional: bool = False,
    ) -> Any:  # fmt: skip
        self._asked[key] = {"description": expected, **schema}
        if default is None and not optional:
            self._needed.add(key)
            default = sample
        return super()._get(key, expected, schema, holds, default, optional=optional)

    def all_texts(self, expected: str) -> dict[str, str]:
        """As any table's; an editor lets any key be."""
        self._others = {"type": "string", "description": expected}
        return super().all_texts(expected)

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
        made: Schema = {"type": "object", "properties": known, "additionalProperties": self._others}
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
