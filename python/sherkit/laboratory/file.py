"""Laboratory files: TOML that names the virtual robot, what is hidden in it, and the instruments around it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import ExperimentError
from ..instruments.emulators import KINDS as FAULTS
from ..names import listed
from ..robots import Delta, Spherical, load_robot
from ..robots.file import Robot
from ..robots.flexible_tool import FlexibleTool, load_tool
from ..robots.table import Table, read_toml
from ..simulation import TABLE_II_SIZES, VirtualDelta
from ..spherical_simulation import PAPER_ERRORS, VirtualSpherical
from ..tool_simulation import VirtualTool
from .virtual import HiddenEffects, ToolInHole, middle_of

#: What each kind of instrument is called, with the ports that it can have; the first is the default.
LINKS: Mapping[str, tuple[str, ...]] = {
    "galil": ("pty", "tcp"),
    "keyence": ("pty", "tcp"),
    "sm130": ("tcp",),
    "hyperion": ("tcp",),
    "net_ft": ("udp",),
    "camera": ("http",),
}
LOOPBACK = "127.0.0.1"


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
    virtual: VirtualDelta | VirtualSpherical
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
    table = Table(read_toml(path, "laboratory", ExperimentError), str(path), error=ExperimentError)
    robot_path = path.parent / table.words("robot")
    robot = load_robot(robot_path)
    seed = table.whole("seed", 0)
    time_scale = table.number("time_scale", 1.0, positive=True)
    host = table.words("host", LOOPBACK)
    virtual: VirtualDelta | VirtualSpherical
    if isinstance(robot, Spherical):
        virtual, hidden = _hidden_in_spherical(table, robot), HiddenEffects()
    else:
        virtual, hidden = _hidden(table, robot, seed)
    tool = _tool(table, path.parent) if isinstance(robot, Delta) and table.has("tool") else None
    instruments: list[EmulatedInstrument] = []
    for one in table.tables("instrument"):
        instruments.append(_instrument(one, robot))
        if instruments[-1].name in {i.name for i in instruments[:-1]}:
            raise one.fail("name", "a name that no other instrument has")
    table.finish()
    if not instruments:
        raise ExperimentError(f"{path}: has no [[instrument]]; known kinds: {listed(LINKS)}")
    return Laboratory(robot, virtual, hidden, tuple(instruments), seed, time_scale, host, str(path), tool)


def _hidden(table: Table, robot: Delta, seed: int) -> tuple[VirtualDelta, HiddenEffects]:
    with table.table("hidden", optional=True) as h:
        size = h.number("errors", 0.0)
        virtual = VirtualDelta.draw(
            robot,
            seed,
            sizes={name: size * value for name, value in TABLE_II_SIZES.items()},
            rail_lean_rad=1e-3 * h.number("rail_lean_mrad", 0.0),
            beam=1e-3 * h.number("beam_mrad", 0.0),
            noise_mm=0.0,
        )
        parameters: dict[str, float] = {}
        period = h.positive("period_mm")
        slip_time_s = h.number("slip_time_s", 0.0)
        with h.table("parameters", optional=True) as p:
            for name in p.names():
                parameters[name] = p.number(name)
    return virtual, HiddenEffects(parameters, period, slip_time_s)


def _tool(table: Table, folder: Path) -> ToolInHole:
    with table.table("tool") as t:
        name = t.words("file", "")
        tool = load_tool(folder / name) if name else FlexibleTool()
        virtual = VirtualTool(tool, hole_mn_mm=t.number("hole_mn_mm", 150.0, positive=True))
        return ToolInHole(virtual, t.number("depth_mm", 10.0, positive=True), t.number("clearance_mm", 0.05))


def _hidden_in_spherical(table: Table, robot: Spherical) -> VirtualSpherical:
    middle_of(robot)  # refuses a robot that would not know where to begin
    with table.table("hidden", optional=True) as h:
        size = h.number("errors", 0.0)
        offset, unequal = (h.numbers(key, 2, (0.0, 0.0)) for key in ("joint_offset_mrad", "unequal_limbs_mrad"))
        return VirtualSpherical(
            robot,
            {name: size * value for name, value in PAPER_ERRORS.items()},
            joint_offset_rad=1e-3 * np.array(offset),
            unequal_limbs_rad=1e-3 * np.array(unequal),
            marker_mm=h.numbers("marker_mm", 3, (0.0, 0.0, 0.0)),
            noise_px=0.0,
        )


def _instrument(table: Table, robot: Robot) -> EmulatedInstrument:
    unit = "rad" if isinstance(robot, Spherical) else "mm"
    kinds = [k for k in LINKS if k != ("camera" if unit == "mm" else "keyence")]
    kind = table.text("kind", tuple(kinds))
    name = table.words("name", kind)
    link = table.text("link", LINKS[kind], LINKS[kind][0])
    port = table.whole("port", 0, least=0)
    settings: dict[str, Any] = {}
    if kind != "camera":
        settings["latency_s"] = table.number("latency_s", 0.0)
        settings["pieces"] = table.whole("pieces", 1, least=1)
        settings["gap_s"] = table.number("gap_s", 0.001)
    if kind == "galil":
        settings["counts_per_unit"] = table.number(f"counts_per_{unit}", 10000.0, positive=True)
        settings["lag_s"] = table.number("lag_s", 0.0)
        settings["noise_counts"] = table.number("noise_counts", 0.0)
        settings["chatty"] = table.number("chatty", 0.0)
        travel = table.heights(f"travel_{unit}")
        if travel is not None:
            settings["travel"] = [travel] * (2 if unit == "rad" else 3)
    elif kind == "keyence":
        settings["noise_mm"] = table.number("noise_mm", 0.0)
        settings["noise_of_place"] = table.flag("noise_of_place", False)
        settings["decimals"] = table.whole("decimals", 4, least=0)
        settings["range_mm"] = table.number("range_mm", 1000.0, positive=True)
    elif kind == "camera":
        settings["noise_grey"] = table.number("noise_grey", 2.0)
    elif kind == "net_ft":
        settings["noise"] = table.number("noise", 0.0)
        settings["rate_hz"] = table.number("rate_hz", 1000.0, positive=True)
    else:
        settings["noise_nm"] = table.number("noise_nm", 0.0)
    with table.table("faults", optional=True) as f:
        stall_s = f.number("stall_s", 1.0, positive=True)
        faults = {kind: rate for kind in FAULTS if (rate := f.number(kind, 0.0))}
    return EmulatedInstrument(name, kind, link, port, settings, faults, stall_s)
