"""The file of a machine that a person gave to a verb: whatever its kind, the verbs ask it the same."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Protocol

import click

from ..base.extensions import MACHINES, ROBOTS, brought, declared, plugins

if TYPE_CHECKING:
    from ..data import Measurements
    from ..diagnosis import Diagnosis
    from ..model.base import ModelWithEffects
    from ..model.effect import Effect
    from ..model.kinds import Robot


#: What the class of a machine's file has, besides what it does with one: see :class:`OtherMachine`.
_HAS = ("title", "catalogue", "example", "simulate_options", "own_ways")


class MachineFile(Protocol):
    """What verbs ask of a machine by its file."""

    #: Verbs that it answers in a way of its own, by name: with what a person typed.
    own_ways: Mapping[str, Callable[..., None]]

    def __init__(self, path: Path) -> None: ...

    @property
    def kind(self) -> str:
        """The name of its kind."""
        ...

    @property
    def catalogue(self) -> Mapping[str, Effect]:
        """Its effects by name."""
        ...

    @property
    def drawn_on(self) -> Robot | None:
        """The robot that an effect is drawn on."""
        ...

    def read(self, runs: Sequence[Path]) -> tuple[ModelWithEffects, Measurements]:
        """Its model as it is, and the rows to compare it with."""
        ...

    def told(self, runs: Sequence[Path]) -> tuple[Path, ...]:
        """The files that the next command of a diagnosis names, where it is one of theirs."""
        ...

    def require_writable(self, destination: Path | None) -> None:
        """Refuses a file ``--output`` of a diagnosis where a diagnosis writes none."""
        ...

    def write(self, destination: Path, found: Diagnosis) -> list[str]:
        """Writes what was named into a file of the next run; sentences on what was written."""
        ...

    def report(
        self, path: Path, found: Diagnosis, *, own: Sequence[Effect], added: Sequence[str], seed: int,
        sources: Sequence[Path],
    ) -> None:  # fmt: skip
        """Writes the report of a diagnosis."""
        ...


def machine_at(path: Path) -> MachineFile:
    """The machine of a file: TOML, or the Python file of a machine, which is run.

    Raises :class:`~sherkit.errors.RobotError` as :func:`~sherkit.load_robot` does, where it is first asked.
    """
    other = _other(path)
    if other is None:
        from .robot_file import RobotFile  # loads all that a robot is asked

        return RobotFile(path)
    return other(path)


def own_way_of(path: Path, verb: str) -> Callable[..., None] | None:
    """How the machine of a file answers this verb, where that is in a way of its own. A robot's file is not read."""
    other = _other(path)
    return None if other is None else other(path).own_ways.get(verb)


class OtherMachine(Protocol):
    """What the class of a :class:`MachineFile` also says, of a machine that is no robot with joints: a folder or a
    package declares it (``sherkit.machines``) under the key ``kind`` of its file. Only the one that is asked for is
    loaded."""

    #: What people call it, its effects by name, a machine of this kind with ``from_table`` and ``to_tables``, and what
    #: ``sherkit simulate`` is asked for it.
    title: ClassVar[str]
    catalogue: ClassVar[Mapping[str, Effect]]
    example: ClassVar[Any]
    simulate_options: ClassVar[tuple[click.Option, ...]]


def other_machines() -> dict[str, type[OtherMachine]]:
    """All of them by kind, loaded now."""
    return plugins(declared(ROBOTS), MACHINES, type, has=_HAS)


def _other(path: Path) -> type[MachineFile] | None:
    """The machine of a file that is no robot with joints."""
    try:
        kind: Any = tomllib.loads(path.read_text(encoding="utf-8-sig")).get("kind")
    except (OSError, ValueError, RecursionError):
        return None  # its reader says what is wrong
    # a kind of robot is nobody's to take
    return brought(MACHINES, kind, type, _HAS) if isinstance(kind, str) and kind not in declared(ROBOTS) else None
