"""A laboratory that runs: its emulators on their ports, and where those are."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Self

from ..errors import ExperimentError
from ..instruments.emulators import (
    CameraEmulator,
    CameraPage,
    Emulator,
    Faults,
    GalilEmulator,
    HyperionEmulator,
    KeyenceEmulator,
    NetFtEmulator,
    NetFtPage,
    Sm130Emulator,
    World,
)
from ..simulation import VirtualDelta
from .file import EmulatedInstrument, Laboratory
from .virtual import DeltaOnTheBench, SphericalOnTheBench

_EMULATORS: Mapping[str, type[Emulator]] = {
    "galil": GalilEmulator,
    "keyence": KeyenceEmulator,
    "sm130": Sm130Emulator,
    "hyperion": HyperionEmulator,
    "net_ft": NetFtEmulator,
}


class RunningLaboratory:
    """Starts the instruments of a laboratory; ``with`` stops them again. The robot begins at its home.

    ``world`` holds the virtual robot and its clock, ``emulators`` the instruments by name.
    """

    def __init__(self, laboratory: Laboratory) -> None:
        self.laboratory = laboratory
        self.bench = _on_the_bench(laboratory)
        self.world = World(
            [float(q) for q in self.bench.home_joints], robot=self.bench, time_scale=laboratory.time_scale
        )
        self.bench.left = self.world.left
        self.emulators: dict[str, Emulator] = {}
        self.cameras: dict[str, CameraEmulator] = {}
        self.pages: dict[str, str] = {}
        self._stack = contextlib.ExitStack()

    def __enter__(self) -> Self:
        with contextlib.ExitStack() as stack:
            for number, one in enumerate(self.laboratory.instruments):
                if one.kind == "camera":
                    self._start_camera(stack, one, number)
                    continue
                emulator = self._started(stack, one, number)
                self.emulators[one.name] = emulator
                if isinstance(emulator, NetFtEmulator):
                    self.pages[one.name] = stack.enter_context(NetFtPage(emulator)).url
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def _started(self, stack: contextlib.ExitStack, one: EmulatedInstrument, number: int) -> Emulator:
        lab = self.laboratory
        # every instrument draws for itself, and the same in every run of this file
        seed = 1000 * lab.seed + number
        emulator = _EMULATORS[one.kind](
            self.world,
            link=one.link,
            host=lab.host,
            port=one.port,
            faults=Faults(one.faults, seed=seed, stall_s=one.stall_s),
            seed=seed,
            **one.settings,
        )
        try:
            return stack.enter_context(emulator)
        except OSError as error:
            raise self._no_port(one, error) from None

    def _start_camera(self, stack: contextlib.ExitStack, one: EmulatedInstrument, number: int) -> None:
        faults = Faults(one.faults, seed=1000 * self.laboratory.seed + number, stall_s=one.stall_s)
        # grey noise is that of the place: the bench draws it
        camera = CameraEmulator(self.world, faults=faults)
        try:
            page = stack.enter_context(CameraPage(camera, self.laboratory.host, one.port))
        except OSError as error:
            raise self._no_port(one, error) from None
        self.cameras[one.name] = camera
        self.pages[one.name] = page.address

    def _no_port(self, one: EmulatedInstrument, error: OSError) -> ExperimentError:
        lab = self.laboratory
        return ExperimentError(
            f"{lab.source}: {one.name} cannot listen on {lab.host}, port {one.port}: {error.strerror}; is another "
            "laboratory running?"
        )

    def ports(self) -> dict[str, dict[str, str]]:
        """Kind and address of every instrument by name, as the drivers take them."""
        out: dict[str, dict[str, str]] = {}
        for one in self.laboratory.instruments:
            if one.kind == "camera":
                out[one.name] = {"kind": one.kind, "address": self.pages[one.name]}
                continue
            out[one.name] = {"kind": one.kind, "address": self.emulators[one.name].address}
            if one.name in self.pages:
                out[one.name]["page"] = self.pages[one.name]
        return out

    def write_ports(self, path: str | Path) -> None:
        """Writes :meth:`ports` as JSON; the file is whole whenever another program looks at it."""
        path = Path(path)
        fresh = path.with_name(path.name + ".new")
        fresh.write_text(json.dumps(self.ports(), indent=2) + "\n", encoding="utf-8")
        fresh.replace(path)


def _on_the_bench(laboratory: Laboratory) -> DeltaOnTheBench | SphericalOnTheBench:
    if isinstance(laboratory.virtual, VirtualDelta):
        return DeltaOnTheBench(laboratory.virtual, laboratory.hidden, laboratory.tool)
    noise = [i.settings["noise_grey"] for i in laboratory.instruments if i.kind == "camera"]
    return SphericalOnTheBench(laboratory.virtual, noise_grey=noise[0] if noise else 0.0, seed=laboratory.seed)


def read_ports(path: str | Path) -> dict[str, dict[str, Any]]:
    """Reads what :meth:`RunningLaboratory.write_ports` wrote. Raises :class:`~sherkit.errors.ExperimentError`."""
    path = Path(path)
    try:
        ports = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise ExperimentError(f"{path}: there is no such file of ports; is the laboratory running?") from None
    except (OSError, ValueError) as error:
        raise ExperimentError(f"{path}: holds no ports: {error}") from None
    if not isinstance(ports, dict) or not all(isinstance(p, dict) and "address" in p for p in ports.values()):
        raise ExperimentError(f"{path}: expected an object with an address for each instrument")
    return ports
