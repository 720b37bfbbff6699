"""Laboratory files: TOML that names the virtual robot, what is hidden in it, and the instruments around it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...base.names import listed
from ...data.toml import Table, read_toml
from ...errors import ExperimentError
from ...model.kinds import Robot, Virtual, kind_of, model_of
from ...model.robot_file import load_robot
from ...robots.tool.tool import FlexibleTool, load_tool
from ...robots.tool.virtual import VirtualTool
from ..emulators import FAULTS
from ..kinds import instrument_kinds
from .virtual import HiddenEffects, ToolInHole

LOOPBACK = "127.0.0.1"
#: Coordinates of what a tool in its hole is bent by.
_PLACE = 3


@dataclass(frozen=True)
class EmulatedInstrument:
    """One instrument of a laboratory: its ``settings`` are those of the emulator, ``faults`` rates by kind."""

    name: str
    kind: str
    link: str
    port: int
    settings: Mapping[str, Any]
    faults: Mapping[str, float]
    stall_s: float


@dataclass(frozen=True)
class Laboratory:
    """A virtual robot with what is hidden in it, and the instruments around it.

    The virtual robot's clock runs ``time_scale`` times as fast as the host's. Ports are open to this machine alone
    unless ``host`` names another address of it.
    """

    robot: Robot
    virtual: Virtual
    hidden: HiddenEffects
    instruments: tuple[EmulatedInstrument, ...]
    seed: int = 0
    time_scale: float = 1.0
    host: str = LOOPBACK
    source: str = "laboratory"
    tool: ToolInHole | None = None


def load_laboratory(path: str | Path) -> Laboratory:
    """Reads a laboratory. Raises :class:`~sherkit.errors.ExperimentError` naming file, table and key."""
    path = Path(path)
    return laboratory_from(
        Table(read_toml(path, "laboratory", ExperimentError), str(path), error=ExperimentError), path
    )


def laboratory_from(table: Table, path: Path) -> Laboratory:
    """The laboratory of the table of a file ``path``. Raises as :func:`load_laboratory`."""
    robot_path = path.parent / table.words("robot")
    robot = load_robot(robot_path)
    kind = kind_of(robot)
    _ = robot.middle  # refuses a robot that would not know where to begin
    seed = table.whole("seed", 0, least=0)
    time_scale = table.number("time_scale", 1.0, positive=True)
    host = table.words("host", LOOPBACK)
    with table.table("hidden", optional=True) as h:
        virtual = kind.require_virtual().hidden(robot, seed, h)
        # pictures are drawn of the virtual robot as it is: effects of the core would not be seen in them
        hidden = _hidden_effects(h, robot) if kind.place_unit == "mm" else HiddenEffects()
    has_place = kind.place_unit == "mm" and len(kind.layout.coordinates) == _PLACE
    tool = _tool(table, path.parent) if has_place and table.has("tool") else None
    instruments: list[EmulatedInstrument] = []
    for one in table.tables("instrument"):
        instruments.append(_instrument(one, robot))
        if instruments[-1].name in {i.name for i in instruments[:-1]}:
            raise one.fail("name", "a name that no other instrument has")
    table.finish()
    if not instruments:
        raise ExperimentError(f"{path}: has no [[instrument]]; known kinds: {listed(instrument_kinds())}")
    return Laboratory(robot, virtual, hidden, tuple(instruments), seed, time_scale, host, str(path), tool)


def _hidden_effects(table: Table, robot: Robot) -> HiddenEffects:
    settings = {
        name: table.positive(name) if usual is None else table.number(name, usual)
        for name, usual in model_of(robot).settings().items()
    }
    with table.table("parameters", optional=True) as p:
        parameters = {name: p.number(name) for name in p.names()}
    return HiddenEffects(parameters, settings)


def _tool(table: Table, folder: Path) -> ToolInHole:
    with table.table("tool") as t:
        name = t.words("file", "")
        tool = load_tool(folder / name) if name else FlexibleTool()
        virtual = VirtualTool(tool, hole_mn_mm=t.number("hole_mn_mm", 150.0, positive=True))
        return ToolInHole(virtual, t.number("depth_mm", 10.0, positive=True), t.number("clearance_mm", 0.05))


def _instrument(table: Table, robot: Robot) -> EmulatedInstrument:
    # of those that see where a robot is, only what sees this one
    kinds = tuple(name for name, row in instrument_kinds().items() if row.emulator and row.sees(robot))
    kind = table.text("kind", kinds)
    row = instrument_kinds()[kind]
    name = table.words("name", kind)
    link = table.text("link", row.links, row.links[0])
    port = table.whole("port", 0, least=0, most=65535)
    settings: dict[str, Any] = {}
    if link != "http":
        settings["latency_s"] = table.number("latency_s", 0.0)
        settings["pieces"] = table.whole("pieces", 1, least=1)
        settings["gap_s"] = table.number("gap_s", 0.001)
    settings |= row.emulated(table, robot)
    with table.table("faults", optional=True) as f:
        stall_s = f.number("stall_s", 1.0, positive=True)
        faults = {kind: rate for kind in FAULTS if (rate := f.number(kind, 0.0))}
    return EmulatedInstrument(name, kind, link, port, settings, faults, stall_s)
