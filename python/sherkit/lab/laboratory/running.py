"""A laboratory that runs: its emulators on their ports, and where those are."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Any, Self

from ...errors import ExperimentError
from ..emulators import Faults, World
from ..kinds import instrument_kinds
from ..ports import write_ports
from .file import EmulatedInstrument, Laboratory
from .virtual import RobotOnTheBench


class RunningLaboratory:
    """Starts the instruments of a laboratory; ``with`` stops them again. The robot begins at its home.

    ``world`` holds the virtual robot and its clock, ``emulators`` the instruments by name.
    """

    def __init__(self, laboratory: Laboratory) -> None:
        self.laboratory = laboratory
        grey = [i.settings["noise_grey"] for i in laboratory.instruments if "noise_grey" in i.settings]
        self.bench = RobotOnTheBench(
            laboratory.virtual, laboratory.hidden, laboratory.tool, noise_grey=next(iter(grey), 0.0),
            seed=laboratory.seed,
        )  # fmt: skip
        self.world = World(
            [float(q) for q in self.bench.home_joints], robot=self.bench, time_scale=laboratory.time_scale
        )
        self.bench.left = self.world.left
        self.emulators: dict[str, Any] = {}
        self._stack = contextlib.ExitStack()

    def __enter__(self) -> Self:
        with contextlib.ExitStack() as stack:
            for number, one in enumerate(self.laboratory.instruments):
                self.emulators[one.name] = self._started(stack, one, number)
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def _started(self, stack: contextlib.ExitStack, one: EmulatedInstrument, number: int) -> Any:
        lab = self.laboratory
        # every instrument draws for itself, and the same in every run of this file
        seed = 1000 * lab.seed + number
        emulator = instrument_kinds()[one.kind].emulator_class()
        faults = Faults(one.faults, seed=seed, stall_s=one.stall_s)
        try:
            return stack.enter_context(
                emulator(
                    self.world, link=one.link, host=lab.host, port=one.port, faults=faults, seed=seed, **one.settings
                )
            )
        except OSError as error:
            raise ExperimentError(
                f"{lab.source}: {one.name} cannot listen on {lab.host}, port {one.port}: {error.strerror}; is another "
                "laboratory running?"
            ) from None

    def ports(self) -> dict[str, dict[str, str]]:
        """Kind and address of every instrument by name, as the drivers take them."""
        out: dict[str, dict[str, str]] = {}
        for one in self.laboratory.instruments:
            emulator = self.emulators[one.name]
            out[one.name] = {"kind": one.kind, "address": emulator.address}
            if emulator.page:
                out[one.name]["page"] = emulator.page
        return out

    def write_ports(self, path: str | Path) -> None:
        """Writes :meth:`ports` for an experiment."""
        write_ports(path, self.ports())
