"""An instrument in one file: a digital gauge with two probes that answers ``?`` with both, in mm; and its emulator."""

from __future__ import annotations

from typing import Any

from sherkit.data.toml import Table
from sherkit.errors import Garbled
from sherkit.lab.emulators import InjectedFault, World
from sherkit.lab.emulators.server import LineEmulator
from sherkit.lab.instruments.base import Identity, Instrument, Reading
from sherkit.lab.instruments.transport import deadline_in
from sherkit.lab.kinds import InstrumentKind, InstrumentSettings
from sherkit.model.kinds import Robot


class DialGauge(Instrument):
    """Two probes on one line."""

    kind = "dial gauge"
    default_port = 4001

    def __init__(self, address: str, names: tuple[str, ...], **line: Any) -> None:
        super().__init__(address, **line)
        self.names = names

    def identify(self) -> Identity:
        """It has no name of its own: it answers."""
        self.read()
        return Identity(self.kind, "two probes", self.address)

    def read(self) -> Reading:
        """Both probes, mm. Raises :class:`~sherkit.errors.Garbled` for an answer of another form."""
        values, time_s = self._repeat(self._ask)
        return Reading(self.name, self.names, values, ("mm",) * len(values), time_s)

    def _ask(self) -> tuple[tuple[float, ...], float]:
        with self._exchanging(b"?\r") as port:
            port.drain()
            deadline = deadline_in(self.timeout_s)
            port.write(b"?\r", deadline)
            raw = port.read_until(b"\r", deadline)
            try:
                values = tuple(float(word) for word in raw.decode("ascii").split(","))
            except ValueError:
                values = ()
            if len(values) != len(self.names):
                raise Garbled(f"expected {len(self.names)} numbers parted by commas", received=raw)
            return values, port.arrived_s


class DialGaugeEmulator(LineEmulator):
    """Answers with where the table of the virtual stage is."""

    links = ("tcp", "pty")
    ending = b"\r"

    def __init__(self, world: World, *, noise_mm: float = 0.0, seed: int = 0, **line: Any) -> None:
        super().__init__(world, seed=seed, **line)
        self.noise_mm = noise_mm

    def answer(self, command: bytes, fault: InjectedFault | None) -> bytes:
        """Both probes."""
        del fault
        if command != b"?\r":
            return b"what\r"
        return (
            ",".join(f"{v + self.random.gauss(0.0, self.noise_mm):+.6f}" for v in self.world.lasers_mm()).encode()
            + b"\r"
        )


def _driver(one: InstrumentSettings, robot: Robot) -> DialGauge:
    del robot
    return DialGauge(one.address, one.columns, name=one.name, **one.settings)


def _settings(table: Table, robot: Robot, address: str) -> dict[str, Any]:
    del table, robot, address
    return {}


def _emulated(table: Table, robot: Robot) -> dict[str, Any]:
    del robot
    return {"noise_mm": table.number("noise_mm", 0.0)}


DIAL_GAUGE = InstrumentKind(
    _settings, _driver, "xy_stage.dial_gauge:DialGaugeEmulator", ("tcp", "pty"), _emulated, place_unit="mm"
)
