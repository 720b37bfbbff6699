"""The file of a robot, as the verbs ask for it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property, reduce
from pathlib import Path

from ..data import Measurements
from ..data.stream import joined
from ..diagnosis import Diagnosis
from ..errors import SherkitError
from ..model.base import ModelWithEffects
from ..model.effect import Effect
from ..model.kinds import Robot, catalogue_of, model_of
from ..model.robot_file import RobotLike, run_for
from ..robots.machine import robot_at
from ..study import Study
from . import output


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

    def write(self, destination: Path, found: Diagnosis) -> list[str]:
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
