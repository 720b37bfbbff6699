"""What installed packages bring, by entry points that they declare; what each group is for stands at its name below.

sherkit's own arms, printers, flexible tool, laboratory and cameras come through the same doors: nothing else of the
package names them, and it works where their folders are not there.
"""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Collection, Iterable, Iterator
from contextlib import ExitStack, contextmanager, nullcontext, redirect_stdout, suppress
from functools import cache
from typing import TYPE_CHECKING, TypeVar

from ..errors import SherkitWarning
from .figures import brief

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

#: Kinds of robot and of instrument: values are a :class:`~sherkit.model.kinds.Kind` and a
#: :class:`~sherkit.lab.kinds.InstrumentKind`.
ROBOTS, INSTRUMENTS = "sherkit.robots", "sherkit.instruments"
#: A ``click.Command`` each: beside the verbs, below ``sherkit import``, below ``sherkit export``.
VERBS, IMPORTERS, EXPORTERS = "sherkit.verbs", "sherkit.importers", "sherkit.exporters"
#: By the key ``kind`` of their files, machines that are no robots with joints: a
#: :class:`~sherkit.cli.machine_file.MachineFile` each.
MACHINES = "sherkit.machines"
#: Another way to measure a virtual robot: a :class:`~sherkit.cli.effects.Simulation`.
SIMULATIONS = "sherkit.simulations"
#: What another file may hold, by the name of its sort: a function that gives its JSON schema.
SCHEMAS = "sherkit.schemas"
#: The package whose entries nobody takes the place of.
_OWN = "sherkit"

_Value = TypeVar("_Value")


@cache
def declared(group: str) -> dict[str, EntryPoint]:
    """What packages declare in a group, by name and not loaded yet: sherkit's own first, then by name. A name that two
    packages have is the first one's, and a warning."""
    out: dict[str, EntryPoint] = {}
    for entry in sorted(_entries(group), key=lambda e: (_package(e) != _OWN, e.name, _package(e))):
        if entry.name in out and entry.value != out[entry.name].value:
            leave_out(group, entry, f"is not used: {_whose(group, out[entry.name])} has that name")
        out.setdefault(entry.name, entry)
    return out


def _entries(group: str) -> Iterable[EntryPoint]:
    from importlib.metadata import distributions, entry_points  # takes as long as all else that is loaded to begin

    try:
        return entry_points(group=group)
    except Exception:  # one package whose metadata cannot be read ends it for all
        found: dict[str, list[EntryPoint]] = {}
        for one in distributions():
            try:
                found.setdefault(one.name, [e for e in one.entry_points if e.group == group])
            except Exception as error:
                said = f"a package has metadata that cannot be read ({type(error).__name__}: {brief(error)})"
                warnings.warn(f"{said}; mend or uninstall it: {brief(getattr(one, '_path', one))}", SherkitWarning,
                              stacklevel=2)  # fmt: skip
        return [entry for entries in found.values() for entry in entries]


def _package(entry: EntryPoint) -> str:
    """The package that declares it, by its own word and not by where its value stands."""
    return (entry.dist.name or "").lower() if entry.dist is not None else ""


def is_own(group: str, name: str) -> bool:
    """Whether a name is sherkit's own: its value need not be loaded to know that it is one."""
    entry = declared(group).get(name)
    return entry is not None and _package(entry) == _OWN


def brought(group: str, name: str, what: type[_Value], has: Collection[str] = ()) -> _Value | None:
    """The value of a name, loaded now; None where nobody declares it, and with a warning where it cannot be loaded, is
    no ``what`` or lacks an attribute that it is to have (``has``): a package that is broken takes nothing with it but
    what it brings.

    What it prints goes where messages go, not into what a program reads.
    """
    entry = declared(group).get(name)
    if entry is None:
        return None
    try:
        with nullcontext() if _package(entry) == _OWN else _kept_apart():
            value = entry.load()
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # SystemExit too: a package that ends itself does not end us
        leave_out(group, entry, f"cannot be loaded ({type(error).__name__}: {brief(error)}); mend or uninstall it")
        return None
    if not isinstance(value, what):
        leave_out(group, entry, f"is {type(value).__name__}, expected {what.__name__}")
        return None
    if lacks := [name for name in has if not hasattr(value, name)]:
        leave_out(group, entry, f"lacks '{lacks[0]}'")
        return None
    return value


@contextmanager
def _kept_apart() -> Iterator[None]:
    """What is printed within it is a message, by whatever way it goes; what is set of warnings is forgotten."""
    with redirect_stdout(sys.stderr), warnings.catch_warnings(), ExitStack() as undo:
        with suppress(OSError, ValueError, AttributeError):  # a program without one of the two has nothing to mix up
            kept = os.dup(1)
            undo.callback(os.close, kept)
            sys.__stdout__.flush()  # type: ignore[union-attr]
            os.dup2(2, 1)
            undo.callback(os.dup2, kept, 1)
            undo.callback(sys.__stdout__.flush)  # type: ignore[union-attr]
        yield


def plugins(
    own: Collection[str], group: str, what: type[_Value], *, has: Collection[str] = (), others_alone: bool = False
) -> dict[str, _Value]:  # fmt: skip
    """All that packages bring in a group (:func:`brought`), by name, but for names that sherkit's ``own`` have: those
    are a warning. ``others_alone`` loads what other packages bring and nothing of sherkit's."""
    found: dict[str, _Value] = {}
    for name, entry in declared(group).items():
        if others_alone and _package(entry) == _OWN:
            continue
        if name in own:
            leave_out(group, entry, f"is not used: sherkit's own {_called(group)} has that name")
        elif (value := brought(group, name, what, has)) is not None:
            found[name] = value
    return found


def leave_out(group: str, entry: EntryPoint, why: str) -> None:
    """Warns that what a package declares is not used, and why."""
    package = _package(entry) or "a package"
    warnings.warn(f"{package}: its {_called(group)} '{entry.name}' ({entry.value}) {why}", SherkitWarning, stacklevel=3)


def _whose(group: str, entry: EntryPoint) -> str:
    return f"sherkit's own {_called(group)}" if _package(entry) == _OWN else entry.value


def _called(group: str) -> str:
    """What a value of a group is called in a sentence."""
    return group.removeprefix("sherkit.").removesuffix("s")
