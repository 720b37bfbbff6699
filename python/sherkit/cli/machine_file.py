"""The file of a machine that a person gave to a verb: whatever its kind, the verbs ask it the same."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property, reduce
from pathlib import Path
from typing import Any, ClassVar, Protocol

import click

from ..base.extensions import MACHINES, ROBOTS, brought, declared, plugins
from ..data import Measurements
from ..data.stream import joined
from ..diagnosis import Diagnosis
from ..errors import SherkitError
from ..model.base import ModelWithEffects
from ..model.effect import Effect
from ..model.kinds import Robot, catalogue_of, model_of
from ..model.robot_file import RobotLike, run_for
from ..robots.calibrated import Calibration, load_calibration, tables_of
from ..robots.machine import robot_at
from ..study import Study
from . import output
from .paths import InputFile

# -- Robot file --------------------------------------------------------------------------------------------------------
# The file of a robot, as the verbs ask for it.


class RobotFile:
    """A robot, an arm, a printer, a machine of the user's."""

    #: None: a verb's body is about robots.
    own_ways: Mapping[str, Callable[..., None]] = {}

    def __init__(self, path: Path) -> None:
        self.path = path

    @cached_property
    def _read(self) -> tuple[Robot, RobotLike]:
        """The robot, and what a run of it is read by; once, and not before a verb has refused its options."""
        return robot_at(self.path)

    @property
    def nominal(self) -> Robot:
        """The robot as drawn."""
        return self._read[0]

    @property
    def kind(self) -> str:
        """The name of its kind."""
        return self.nominal.kind

    @cached_property
    def catalogue(self) -> Mapping[str, Effect]:
        """Its effects by name."""
        return catalogue_of(self.nominal)

    @property
    def drawn_on(self) -> Robot | None:
        """The robot that an effect is drawn on: itself."""
        return self.nominal

    def read(self, runs: Sequence[Path]) -> tuple[ModelWithEffects, Measurements]:
        """Its model as drawn, and all runs joined."""
        self.data = reduce(joined, (run_for(self._read[1], run) for run in runs))
        return model_of(self.nominal), self.data

    def told(self, runs: Sequence[Path]) -> tuple[Path, ...]:
        """Robot and runs."""
        return (self.path, *runs)

    def require_writable(self, destination: Path | None) -> None:
        """A robot's calibration is a verb of its own."""
        if destination is not None:
            raise SherkitError(
                "--output: is for a flexible tool; sherkit calibrate --effect NAME -o writes a calibration"
            )

    def write(self, destination: Path, found: Diagnosis) -> tuple[Diagnosis, list[str]]:
        """Never: :meth:`require_writable` refuses."""
        raise NotImplementedError

    def report(
        self, path: Path, found: Diagnosis, *, own: Sequence[Effect], added: Sequence[str], seed: int,
        sources: Sequence[Path],
    ) -> None:  # fmt: skip
        """The report of a study that has all that was named."""
        study = Study(self.nominal, self.data, effects=own, seed=seed)
        for name in (*added, *found.effects):
            study.add(name)
        output.write_report(path, study, found, sources)


# -- Calibrations ------------------------------------------------------------------------------------------------------

#: The file that makes a machine known whose calibration a verb is given.
machine_option = click.option(
    "--machine", type=InputFile(), help="The Python file of the machine (sk.Machine) that was calibrated; it is run."
)


def calibration_at(calibration: Path, machine: Path | None) -> Calibration:
    """A calibration by its file: of the robot in it, or of the machine whose Python file a person named, which is run.

    Raises :class:`~sherkit.errors.SherkitError` where it is that of another.
    """
    if machine is None:
        return load_calibration(calibration)
    robot, _ = robot_at(machine)
    table = tables_of(calibration).get("robot")
    found = table.get("kind") if isinstance(table, dict) else None
    if isinstance(found, str) and found != robot.kind:
        raise SherkitError(f"{calibration}: is the calibration of {found}, {machine} makes {robot.kind}")
    return load_calibration(calibration)


# -- Machine file ------------------------------------------------------------------------------------------------------

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

    def write(self, destination: Path, found: Diagnosis) -> tuple[Diagnosis, list[str]]:
        """Writes what was named into a file of the next run: the diagnosis, which goes on from there, and sentences on
        what was written."""
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
        from .machine_file import RobotFile  # loads all that a robot is asked

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
