"""What installed packages bring: kinds of robot and of instrument, importers, verbs, by entry points that they declare.

The built-in kinds of robot come through the same door: ``[project.entry-points."sherkit.robots"]`` of a package names
each kind, and what it is called in Python.
"""

from __future__ import annotations

import warnings
from collections.abc import Collection
from functools import cache
from typing import TYPE_CHECKING, TypeVar

from ..errors import SherkitWarning

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

#: The groups: values are a :class:`~sherkit.model.kinds.Kind`, a :class:`~sherkit.lab.kinds.InstrumentKind`, and a
#: ``click.Command`` each below ``sherkit import`` and beside the verbs.
ROBOTS, INSTRUMENTS, IMPORTERS, VERBS = (f"sherkit.{n}" for n in ("robots", "instruments", "importers", "verbs"))
#: What one of them is called in a sentence.
_CALLED = {ROBOTS: "robot", INSTRUMENTS: "instrument", IMPORTERS: "importer", VERBS: "verb"}

_Value = TypeVar("_Value")


@cache
def declared(group: str) -> dict[str, EntryPoint]:
    """What packages declare in a group, by name and not loaded yet: sherkit's own first, then by name. A name that two
    packages have is the first one's, and a warning."""
    from importlib.metadata import entry_points  # takes as long as all else that the command loads to begin

    out: dict[str, EntryPoint] = {}
    own_first = sorted(entry_points(group=group), key=lambda e: (not e.value.startswith("sherkit."), e.name))
    for entry in own_first:
        if entry.name in out and entry.value != out[entry.name].value:
            _warn(group, entry, f"is not used: {out[entry.name].value} has that name")
        out.setdefault(entry.name, entry)
    return out


def _brought(group: str, name: str, what: type[_Value]) -> _Value | None:
    """The value of a name, loaded now; None, and a warning, where it cannot be loaded or is no ``what``: a package that
    is broken takes nothing with it but what it brings."""
    entry = declared(group)[name]
    try:
        value = entry.load()
    except Exception as error:
        _warn(group, entry, f"cannot be loaded ({type(error).__name__}: {error}); mend or uninstall it")
        return None
    if not isinstance(value, what):
        _warn(group, entry, f"is {type(value).__name__}, expected {what.__name__}")
        return None
    return value


def brought_beside(own: Collection[str], group: str, what: type[_Value]) -> dict[str, _Value]:
    """All that packages bring in a group, by name, but for names that sherkit's ``own`` have."""
    found = {name: _brought(group, name, what) for name in declared(group) if name not in own}
    return {name: value for name, value in found.items() if value is not None}


def _warn(group: str, entry: EntryPoint, why: str) -> None:
    package = entry.dist.name if entry.dist is not None else "a package"
    warnings.warn(f"{package}: its {_CALLED[group]} '{entry.name}' ({entry.value}) {why}", SherkitWarning, stacklevel=2)
