"""A laboratory of emulated instruments around one virtual robot: what these see, the file that describes it, its ports.

Geometric errors, and what else its kind hides, come from the :class:`~sherkit.model.kinds.Virtual` of that kind.
What that one does not know (backlash, drift, …) is added as the core has it.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from ..base.figures import listed, nearest
from ..base.types import Floats
from ..data import Measurements
from ..data.columns import TEMPERATURE, TIME
from ..data.toml import Table, read_toml
from ..errors import EffectError, ExperimentError, NotFinite, OutOfReach, Singular
from ..model.chain import ChainModel
from ..model.kinds import Robot, SeenInPictures, Virtual, kind_of, model_of
from ..model.robot_file import load_robot
from ..robots.tool.tool import FlexibleTool, load_tool
from ..robots.tool.virtual import VirtualTool
from .emulators import FAULTS, Faults, StillRobot, World
from .emulators.server import LOOPBACK
from .kinds import instrument_kinds, write_ports

_ROOM_C = 20.0


@dataclass(frozen=True)
class HiddenEffects:
    """Effects of the catalogue by the names of their parameters (as in a calibration), and their settings."""

    parameters: Mapping[str, float] = field(default_factory=dict)
    settings: Mapping[str, float | None] = field(default_factory=dict)

    def model(self, plain: ChainModel) -> tuple[ChainModel, Floats]:
        """A model with these effects alone, and its values. Raises :class:`~sherkit.errors.EffectError`."""
        owners = {p.name: e for e in plain.known_effects.values() for p in e.qualified()}
        for name in self.parameters:
            if name not in owners:
                raise EffectError(f"no effect has a parameter '{name}'{nearest(name, owners)}")
        effects = tuple(dict.fromkeys(owners[name] for name in self.parameters))
        made = replace(plain, effects=effects, **self.settings)  # type: ignore[arg-type]
        values = np.array([self.parameters.get(p.name, 0.0) for p in made.parameters])
        return made, values


@dataclass(frozen=True)
class ToolInHole:
    """A tool on the platform, in a hole of the bench: where the robot goes aside, the hole bends it.

    At home the shaft is ``depth_mm`` deep and in the middle; ``clearance_mm`` is how far it is free. The load cell
    feels the force, the gratings the bending: three fibres, each on a channel of its own, with three gratings.
    """

    virtual: VirtualTool
    depth_mm: float = 10.0
    clearance_mm: float = 0.05

    def felt(self, position_mm: Floats) -> tuple[Floats, Floats]:
        """Force (2,), mN, and wavelengths (9,), nm, with the platform at ``position_mm`` (3,) from home."""
        depth = np.array([max(self.depth_mm - float(position_mm[2]), 0.0)])
        force, waves = self.virtual.pressed(-position_mm[None, :2], depth, self.clearance_mm)
        return force[0], waves[0]


class RobotOnTheBench(StillRobot):
    """A virtual robot with instruments around it. It begins in the middle of its workspace.

    Lasers look at it where its place is read in mm, zeroed at home; a camera where it is read in px. Pictures are drawn
    anew at each place, with grey noise of that place: where the robot comes back to by the same way, the camera sees
    the same (needs the extra ``sherkit[vision]``).

    ``left`` tells where the joints came from (:meth:`~sherkit.lab.emulators.World.left`): backlash depends
    on it.
    """

    def __init__(
        self,
        virtual: Virtual,
        hidden: HiddenEffects | None = None,
        tool: ToolInHole | None = None,
        *,
        noise_grey: float = 2.0,
        seed: int = 0,
    ) -> None:
        robot = virtual.robot
        self.virtual = virtual
        self.kind = kind_of(robot)
        self.tool = tool
        self.noise_grey = noise_grey
        self.seed = seed
        self.home_joints: Floats = robot.inverse(robot.middle)
        self._plain = model_of(robot) if hidden is not None and hidden.parameters else None
        self._effects = None if hidden is None or self._plain is None else hidden.model(self._plain)
        self.left: Callable[[], Floats] = lambda: self.home_joints
        self._last_place: tuple[tuple[float, ...], Floats] | None = None
        self._last_picture: tuple[tuple[float, ...], NDArray[np.uint8]] | None = None

    def lasers_mm(self, joints: Floats, time_s: float) -> Sequence[float]:
        """Its coordinates from those at home, mm; NaN where the robot cannot be."""
        if self.kind.place_unit != "mm":
            return super().lasers_mm(joints, time_s)
        return [float(v) for v in self.position(joints, time_s)]

    def wrench(self, joints: Floats, time_s: float) -> Sequence[float]:
        """The force on the tool at its hole, N; no torque."""
        if (felt := self._felt(joints, time_s)) is None:
            return super().wrench(joints, time_s)
        return [*(1e-3 * felt[0]).tolist(), 0.0, 0.0, 0.0, 0.0]

    def wavelengths_nm(self, joints: Floats, time_s: float) -> Sequence[Sequence[float]]:
        """The gratings of sections I, II and III on one channel for each of three fibres."""
        if (felt := self._felt(joints, time_s)) is None:
            return super().wavelengths_nm(joints, time_s)
        return [*felt[1].reshape(3, 3).T.tolist(), []]

    def _felt(self, joints: Floats, time_s: float) -> tuple[Floats, Floats] | None:
        """As :meth:`ToolInHole.felt`; None without a tool, and where the robot cannot be."""
        if self.tool is None:
            return None
        place = self.position(joints, time_s)
        return self.tool.felt(place) if np.isfinite(place).all() else None

    def picture(self, joints: Floats, time_s: float) -> NDArray[np.uint8]:
        """What the camera sees; grey where the robot cannot be."""
        if not isinstance(self.virtual, SeenInPictures):
            return super().picture(joints, time_s)
        key = self._key(joints)
        if self._last_picture is not None and self._last_picture[0] == key:
            return self._last_picture[1]
        columns = {name: np.array([q]) for name, q in zip(self.kind.layout.joints, joints, strict=True)}
        columns[TIME] = np.zeros(1)
        places = [int(v * 1e6) & 0xFFFFFFFF for v in key]
        seed = int(np.random.SeedSequence([self.seed, *places]).generate_state(1)[0])
        from ..vision.spherical import pictures_of  # needs OpenCV

        try:
            (drawn,) = pictures_of(self.virtual, columns, seed=seed, noise_grey=self.noise_grey)
            picture: NDArray[np.uint8] = drawn.grey
        except OutOfReach:
            width, height = self.virtual.eye.size_px
            picture = np.full((height, width), 128, np.uint8)
        self._last_picture = (key, picture)
        return picture

    def position(self, joints: Floats, time_s: float) -> Floats:
        """Where it is in truth (k,), in the columns of a run: mm from home, or px; NaN where it cannot be."""
        key = self._key(joints)
        # three outputs are asked one after the other where nothing moves; time matters to effects alone
        if self._last_place is not None and self._last_place[0] == key and self._effects is None:
            return self._last_place[1]
        try:
            with np.errstate(all="ignore"):
                place: Floats = self.virtual.noise_free(joints)[0]
        except (OutOfReach, NotFinite, Singular):
            return np.full(len(self.kind.layout.coordinates), np.nan)
        if self._effects is not None and self._plain is not None:
            (model, values), row = self._effects, self._row(joints, time_s)
            drawn = self._plain.predict(row, np.zeros(len(self._plain.parameters)))
            place = place + (model.predict(row, values) - drawn)[0, : len(place)]
        self._last_place = (key, place)
        return place

    def _key(self, joints: Floats) -> tuple[float, ...]:
        """The place, and where it was reached from."""
        return (*map(float, joints), *map(float, self.left()))

    def _row(self, joints: Floats, time_s: float) -> Measurements:
        way = np.sign(np.round(np.asarray(joints) - self.left(), 6))
        layout = self.kind.layout
        columns = {
            TIME: np.array([time_s]),
            TEMPERATURE: np.array([_ROOM_C]),
            **{name: np.array([q]) for name, q in zip(layout.joints, joints, strict=True)},
            **{name: np.zeros(1) for name in layout.coordinates},
            # a joint that has not moved yet stands as if it had come from below
            **{name: np.array([w or 1.0]) for name, w in zip(layout.directions, way, strict=True)},
        }
        return Measurements.from_columns(columns, "laboratory", layout=layout)


# -- the file ---------------------------------------------------------------------------------------------------------

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
    robot = load_robot(path.parent / table.words("robot"))
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
    instruments: dict[str, EmulatedInstrument] = {}
    for one in table.tables("instrument"):
        made = _instrument(one, robot)
        if made.name in instruments:
            raise one.fail("name", "a name that no other instrument has")
        instruments[made.name] = made
    table.finish()
    if not instruments:
        raise ExperimentError(f"{path}: has no [[instrument]]; known kinds: {listed(instrument_kinds())}")
    return Laboratory(robot, virtual, hidden, tuple(instruments.values()), seed, time_scale, host, str(path), tool)


def _hidden_effects(table: Table, robot: Robot) -> HiddenEffects:
    settings = {
        name: table.number(name, usual) if isinstance(usual, float) else table.positive(name)
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
    kinds = {name: row for name, row in instrument_kinds().items() if row.emulator and row.sees(robot)}
    kind = table.text("kind", tuple(kinds))
    row = kinds[kind]
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


# -- running ----------------------------------------------------------------------------------------------------------


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
        self.world = World(self.bench.home_joints.tolist(), robot=self.bench, time_scale=laboratory.time_scale)
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
        made = instrument_kinds()[one.kind].emulator_class()(
            self.world, link=one.link, host=lab.host, port=one.port, seed=seed,
            faults=Faults(one.faults, seed=seed, stall_s=one.stall_s), **one.settings,
        )  # fmt: skip
        try:
            return stack.enter_context(made)
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
