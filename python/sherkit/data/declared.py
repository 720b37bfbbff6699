"""What stands where in a file, declared once by the class that it makes: reading and writing follow from that.

@dataclass(frozen=True)
class Stage(Declared):
    travel_mm: tuple[float, float]
    limits_mm: tuple[float, float] | None = None
    kind: str = field(default="stage", init=False)

    TABLES = {
        "geometry": {"travel_mm": key(Table.numbers, 2, positive=True)},
        "joints": {"limits_mm": key(Table.heights)},
    }
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import MISSING, dataclass, fields, replace
from typing import Any, ClassVar, Concatenate, ParamSpec, Self

import numpy as np

from .toml import Table

P = ParamSpec("P")
#: The default of a key is that of the class.
_OF_CLASS = object()


@dataclass(frozen=True)
class Key:
    """A key of a table: how it is ``read``, and the ``attribute`` that it is, which has its name unless another is
    given. Where it is left out it is ``default``, that of the class unless another is given; None needs it."""

    read: Callable[..., Any]
    attribute: str = ""
    default: Any = _OF_CLASS
    is_quiet: bool = False

    def of(self, attribute: str) -> Key:
        """The same of an attribute with another name."""
        return replace(self, attribute=attribute)

    def otherwise(self, default: Any) -> Key:
        """The same with a default of its own."""
        return replace(self, default=default)

    @property
    def needed(self) -> Key:
        """The same where the file must say it, though Python need not."""
        return replace(self, default=MISSING)

    @property
    def quiet(self) -> Key:
        """The same, written only where it is not what the class has by itself."""
        return replace(self, is_quiet=True)


def key(method: Callable[Concatenate[Table, str, P], Any], *given: P.args, **how: P.kwargs) -> Key:
    """A key that a method of :class:`~sherkit.data.toml.Table` reads, with what it takes besides key and default."""
    return Key(lambda table, name, **default: method(table, name, *given, **how, **default))


@dataclass(frozen=True)
class Inner:
    """A table that makes an attribute of its own, by ``from_table`` and ``to_table`` of its class; left out where that
    is None."""

    made: type[Any]
    attribute: str


Keys = Mapping[str, Key]


def keys_from(table: Table, keys: Keys, made: type[Any]) -> dict[str, Any]:
    """What ``keys`` of a table say, by the attributes of the class that they make."""
    usual, out = _defaults(made), {}
    for name, one in keys.items():
        default = _default(name, one, usual)
        given = {} if default in (None, MISSING) else {"default": default}
        out[one.attribute or name] = one.read(table, name, **given)
    return out


def keys_of(values: Mapping[str, Any], keys: Keys, made: type[Any]) -> dict[str, Any]:
    """What :func:`keys_from` reads, for attributes by name; None is left out."""
    usual, out = _defaults(made), {}
    for name, one in keys.items():
        value = values[one.attribute or name]
        if value is not None and not (one.is_quiet and value == _default(name, one, usual)):
            out[name] = _plain(value)
    return out


def tables_from(table: Table, tables: Mapping[str, Keys | Inner], made: type[Any]) -> dict[str, Any]:
    """What the tables inside a table say, by the attributes of the class that they make; one is needed where a key of
    it is. ``made.check(name, table, values)``, if it has that, refuses numbers that do not fit together."""
    usual, out = _defaults(made), {}
    for name, inside in tables.items():
        if isinstance(inside, Inner):
            if table.has(name):
                with table.table(name) as inner:
                    out[inside.attribute] = inside.made.from_table(inner)
            continue
        optional = all(_default(name, one, usual) is not MISSING for name, one in inside.items())
        with table.table(name, optional=optional) as inner:
            values = keys_from(inner, inside, made)
            made.check(name, inner, values)
        out |= values
    return out


def tables_of(values: Mapping[str, Any], tables: Mapping[str, Keys | Inner], made: type[Any]) -> dict[str, Any]:
    """What :func:`tables_from` reads, for attributes by name; tables without a key are left out."""
    out = {}
    for name, inside in tables.items():
        if not isinstance(inside, Inner):
            out[name] = keys_of(values, inside, made)
        elif values[inside.attribute] is not None:
            out[name] = values[inside.attribute].to_table()
    return {name: inside for name, inside in out.items() if inside}


class Declared:
    """A dataclass with a ``kind`` that reads and writes its file by ``TABLES``: the keys of each table."""

    TABLES: ClassVar[Mapping[str, Keys | Inner]]
    kind: str

    @classmethod
    def check(cls, name: str, table: Table, values: Mapping[str, Any]) -> None:
        """Refuses ``values`` of the table called ``name`` that do not fit together, with ``table.fail``."""

    @classmethod
    def from_table(cls, table: Table) -> Self:
        """Reads the tables of a file. Raises what the table raises, naming file, table and key."""
        return cls(**tables_from(table, cls.TABLES, cls))

    def to_tables(self) -> dict[str, Any]:
        """What :meth:`from_table` reads, without loss."""
        return {"kind": self.kind, **tables_of(vars(self), self.TABLES, type(self))}


def _defaults(made: type[Any]) -> dict[str, Any]:
    return {one.name: one.default for one in fields(made) if one.default is not MISSING}


def _default(name: str, one: Key, usual: Mapping[str, Any]) -> Any:
    """What a key is where it is left out; MISSING where it may not be."""
    return usual.get(one.attribute or name, MISSING) if one.default is _OF_CLASS else one.default


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value.tolist()
    return [_plain(v) for v in value] if isinstance(value, tuple | list) else value
