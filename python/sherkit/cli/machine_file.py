"""The file of a machine that a person gave to a verb: whatever its kind, the verbs ask it the same."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, cast

if TYPE_CHECKING:
    from ..data import Measurements
    from ..diagnosis import Diagnosis
    from ..model.base import ModelWithEffects
    from ..model.effect import Effect
    from ..model.kinds import Robot

#: Where the :class:`MachineFile` of a robot is, and by the key ``kind`` of their files that of machines that are none:
#: only the one that is asked for is loaded.
_ROBOT = ("robot_file", "RobotFile")
_OTHERS = {"flexible_tool": ("tool_file", "ToolFile")}


class MachineFile(Protocol):
    """What verbs ask of a machine by its file."""

    #: Verbs that it answers in a way of its own, by name: with what a person typed.
    own_ways: Mapping[str, Callable[..., None]]

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
    return _made(_other(path) or _ROBOT, path)


def own_way_of(path: Path, verb: str) -> Callable[..., None] | None:
    """How the machine of a file answers this verb, where that is in a way of its own. A robot's file is not read."""
    other = _other(path)
    return None if other is None else _made(other, path).own_ways.get(verb)


def _made(of: tuple[str, str], path: Path) -> MachineFile:
    module, name = of
    return cast("MachineFile", getattr(import_module(f".{module}", __package__), name)(path))


def _other(path: Path) -> tuple[str, str] | None:
    """Where the machine of a file is that is no robot with joints."""
    try:
        kind: Any = tomllib.loads(path.read_text(encoding="utf-8-sig")).get("kind")
    except (OSError, ValueError, RecursionError):
        return None  # its reader says what is wrong
    return _OTHERS.get(kind) if isinstance(kind, str) else None
