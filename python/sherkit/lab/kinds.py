"""THE table of instruments: a row for each kind, which says all that laboratories and experiments ask of it.

A new one is its driver, its emulator, and a row of :data:`INSTRUMENTS`, or of another package that declares it under
``[project.entry-points."sherkit.instruments"]``. Emulators are named, not imported: who measures needs none.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base.extensions import INSTRUMENTS as OF_PACKAGES
from ..base.extensions import plugins
from ..data.files import write_whole
from ..data.toml import Table
from ..errors import ExperimentError
from ..model.kinds import Robot, kind_of
from .instruments import Axis, Galil, Hyperion, Keyence, NetFT, Scpi, Sm130, Snapshots, VideoCamera, fetch_scale
from .instruments.base import LETTERS, Instrument
from .instruments.galil_line import ZEROED
from .instruments.user_driver import Make, OwnAxes, OwnSensor

#: Defaults by the unit of the joints: speed per s, acceleration per s², how near a target counts as there.
_MOTION = {"mm": (5.0, 50.0, 0.01), "rad": (0.5, 5.0, 2e-4)}


@dataclass(frozen=True)
class InstrumentSettings:
    """One instrument as an experiment has it; ``settings`` go to its driver, ``columns`` name its values in the run."""

    name: str
    kind: str
    address: str
    settings: Mapping[str, Any]
    columns: tuple[str, ...]
    page: str = ""
    #: What makes an instrument of the user's own, and the words for where its code stands.
    make: Make | None = None
    said: str = ""

    def meaning(self) -> dict[str, Any]:
        """What gives its numbers their meaning, for JSON: its kind, columns, and settings such as scale and zero."""
        return {"kind": self.kind, "columns": list(self.columns)} | {
            name: self.settings[name] for name in instrument_kinds()[self.kind].meaning
        }


@dataclass(frozen=True)
class InstrumentKind:
    """What a kind of instrument brings.

    ``settings`` reads its own keys of an experiment (table, robot, address), ``driver`` makes it of them. It ``moves``
    the joints, or else it is read: where the robot is in ``place_unit``, or something else where that is empty.
    ``has_page`` for one that says on HTTP how to read it. ``meaning`` names those of its settings without which its
    numbers would mean something else: a run goes on only with the same.

    ``emulator`` names the module and class (``package.module:Class`` of another package) that plays it in a laboratory,
    on a port of one of the ``links`` (the first unless another is named); ``emulated`` reads the emulator's keys of a
    laboratory (table, robot). What is the user's ``own`` Python has none.
    """

    settings: Callable[[Table, Robot, str], dict[str, Any]]
    driver: Callable[[InstrumentSettings, Robot], Instrument]
    emulator: str = ""
    links: tuple[str, ...] = ()
    emulated: Callable[[Table, Robot], dict[str, Any]] = lambda *_: {}
    own: bool = False
    moves: bool = False
    place_unit: str = ""
    has_page: bool = False
    meaning: tuple[str, ...] = ()

    @property
    def is_serial(self) -> bool:
        """Whether it can be on a serial port."""
        return "pty" in self.links

    def shows_place_of(self, robot: Robot) -> bool:
        """Whether it reads where such a robot is."""
        return self.place_unit == kind_of(robot).place_unit

    def sees(self, robot: Robot) -> bool:
        """Whether it has something to read at such a robot: its place, or what is no place."""
        return not self.place_unit or self.shows_place_of(robot)

    def columns(self, settings: Mapping[str, Any], robot: Robot) -> tuple[str, ...]:
        """What its values are called unless the file says so: the robot's coordinates, where it reads all of them."""
        names = kind_of(robot).layout.coordinates
        return names if self.shows_place_of(robot) and len(settings.get("outputs", names)) == len(names) else ()

    def emulator_class(self) -> Any:
        """The emulator, imported now."""
        module, of_package, name = self.emulator.partition(":")
        if not of_package:
            module, name = self.emulator.split(".")
            module = f"{__package__}.emulators.{module}"
        return getattr(import_module(module), name)


# -- motion ----------------------------------------------------------------------------------------------------


def _motion_settings(table: Table, unit: str) -> dict[str, Any]:
    """What all axes have: how they move, and how near a target counts as there."""
    speed, acceleration, within = _MOTION[unit]
    return {
        "speed": table.number(f"speed_{unit}_s", speed, positive=True),
        "acceleration": table.number(f"acceleration_{unit}_s2", acceleration, positive=True),
        "arrived_within": table.number(f"arrived_within_{unit}", within, positive=True),
    }


def _galil_settings(table: Table, robot: Robot, _: str) -> dict[str, Any]:
    unit, joints = robot.joint_unit, len(kind_of(robot).layout.joints)
    counts, home_at = f"counts_per_{unit}", f"home_at_{unit}"
    per_unit = table.number(counts)
    if per_unit == 0:
        raise table.fail(counts, "a number other than 0")
    seconds = {"settle_s": 2.0, "poll_s": 0.05, "poll_timeout_s": 0.5, "stop_timeout_s": 5.0}
    return {
        "counts_per_unit": per_unit,
        "zero_counts": list(table.numbers("zero_counts", joints, (0.0,) * joints)),
        **_motion_settings(table, unit),
        **{name: table.number(name, usual, positive=True) for name, usual in seconds.items()},
        "home_at": list(table.numbers(home_at, joints)) if table.has(home_at) else None,
        "home_speed": table.number(f"home_speed_{unit}_s", 0.2 * _MOTION[unit][0], positive=True),
    }


def _galil(one: InstrumentSettings, robot: Robot) -> Galil:
    settings = dict(one.settings)
    axes = _axes_of(robot, one.name, settings.pop("counts_per_unit"), settings.pop("zero_counts"))
    return Galil(one.address, axes, name=one.name, **settings)


def _emulated_galil(table: Table, robot: Robot) -> dict[str, Any]:
    unit, joints = robot.joint_unit, len(kind_of(robot).layout.joints)
    settings: dict[str, Any] = {
        "counts_per_unit": table.number(f"counts_per_{unit}", 10000.0, positive=True),
        **{name: table.number(name, 0.0) for name in ("lag_s", "noise_counts", "chatty")},
        # as one that was zeroed by somebody, or as after a power cut
        "variables": {ZEROED: 1.0} if table.flag("zeroed", True) else {},
    }
    if table.has(f"home_{unit}"):
        settings["home"] = table.numbers(f"home_{unit}", joints)
    if (travel := table.heights(f"travel_{unit}")) is not None:
        settings["travel"] = [travel] * joints
    return settings


def _axes_of(robot: Robot, name: str, counts_per_unit: float, zeros: Sequence[float] = ()) -> list[Axis]:
    """An axis for each joint, within the robot's limits."""
    if robot.joint_limits is None:
        raise ExperimentError(f"{name}: moves nothing without the limits of the joints in the robot file")
    names = [joint.rsplit("_", 1)[0] for joint in kind_of(robot).layout.joints]
    return [
        Axis(letter, counts_per_unit, robot.joint_limits, int(zero), label, robot.joint_unit)
        for letter, zero, label in zip(LETTERS, zeros or [0.0] * len(names), names, strict=False)
    ]


# -- the user's own --------------------------------------------------------------------------------------------


def _own_settings(table: Table, _: Robot, address: str) -> dict[str, Any]:
    given = table.free("with") | ({"address": address} if address else {})
    return {"make": table.words("make"), "with": given}


def _sensor_settings(table: Table, robot: Robot, address: str) -> dict[str, Any]:
    return {**_own_settings(table, robot, address), "fields": list(table.texts("fields", ()))}


def _axes_settings(table: Table, robot: Robot, address: str) -> dict[str, Any]:
    unit = robot.joint_unit
    return {
        **_own_settings(table, robot, address),
        "resolution": table.number(f"resolution_{unit}", 0.1 * _MOTION[unit][2], positive=True),
        **_motion_settings(table, unit),
        "settle_s": table.number("settle_s", 10.0, positive=True),
    }


def _own(one: InstrumentSettings, robot: Robot) -> OwnSensor | OwnAxes:
    """What its code makes with what its file gives."""
    settings = dict(one.settings)
    name, given = settings.pop("make"), settings.pop("with")
    if one.make is None:
        raise ExperimentError(f"{one.name}: '{name}' is made by Python code that was not given")
    make = partial(one.make, **given)
    if "resolution" not in settings:
        return OwnSensor(make, one.columns, said=one.said, name=one.name, **settings)
    axes = _axes_of(robot, one.name, 1.0 / settings.pop("resolution"))
    return OwnAxes(make, axes, said=one.said, name=one.name, **settings)


# -- sensors ---------------------------------------------------------------------------------------------------


def _wholes(table: Table, key: str, *default: tuple[float, ...]) -> list[int]:
    return [int(k) for k in table.some_numbers(key, *default)]


def _net_ft(one: InstrumentSettings, _: Robot) -> NetFT:
    if not one.page:
        raise ExperimentError(f"{one.name}: has no page; give the address of its netftapi2.xml")
    return NetFT(one.address, fetch_scale(one.page), name=one.name, **one.settings)


def _camera(one: InstrumentSettings, _: Robot) -> VideoCamera:
    """A camera with the finder of markers; over HTTP it hands out single pictures."""
    try:
        from ..vision.marker import find_marker
    except ImportError:
        raise ExperimentError(f'{one.name}: cameras need OpenCV: pip install "sherkit[vision]"') from None

    def find(picture: NDArray[np.uint8]) -> tuple[float, float]:
        seen = find_marker(picture)
        return seen.u_px, seen.v_px

    over_http = one.address.startswith("http://")
    source = partial(Snapshots, one.address, one.settings["timeout_s"]) if over_http else None
    return VideoCamera(one.address, source=source, find=find, name=one.name, **one.settings)


# -- the table -------------------------------------------------------------------------------------------------

_SERIAL = ("pty", "tcp")


def _interrogator(driver: type[Sm130] | type[Hyperion], emulator: str) -> InstrumentKind:
    """A kind of interrogator of fibre gratings."""
    return InstrumentKind(
        lambda table, *_: {"gratings": _wholes(table, "gratings")},
        lambda one, _: driver(one.address, name=one.name, **one.settings),
        emulator, ("tcp",), lambda table, _: {"noise_nm": table.number("noise_nm", 0.0)}, meaning=("gratings",),
    )  # fmt: skip


INSTRUMENTS: Mapping[str, InstrumentKind] = {
    "galil": InstrumentKind(
        _galil_settings, _galil, "galil.GalilEmulator", _SERIAL, _emulated_galil, moves=True,
        meaning=("counts_per_unit", "zero_counts"),
    ),
    "keyence": InstrumentKind(
        lambda table, *_: {
            "outputs": _wholes(table, "outputs", (1.0, 2.0, 3.0)),
            "method": table.text("method", ("MS", "MM", "MA"), "MS"),
            "unit": table.text("unit", ("mm", "um"), "mm"),
        },
        lambda one, _: Keyence(one.address, names=one.columns, name=one.name, **one.settings),
        "keyence.KeyenceEmulator", _SERIAL,
        lambda table, _: {
            "noise_mm": table.number("noise_mm", 0.0),
            "noise_of_place": table.flag("noise_of_place", False),
            "decimals": table.whole("decimals", 4, least=0),
            "range_mm": table.number("range_mm", 1000.0, positive=True),
        },
        place_unit="mm", meaning=("outputs", "unit"),
    ),
    "scpi": InstrumentKind(
        lambda table, *_: {"question": table.words("ask", "READ?"), "unit": table.words("unit", "mm")},
        lambda one, _: Scpi(one.address, names=one.columns, name=one.name, **one.settings),
        "scpi.ScpiEmulator", ("tcp", "pty"),
        lambda table, _: {
            "question": table.words("ask", "READ?"),
            "outputs": _wholes(table, "outputs", (1.0, 2.0, 3.0)),
            "noise_mm": table.number("noise_mm", 0.0),
        },
        place_unit="mm", meaning=("question", "unit"),
    ),
    "sm130": _interrogator(Sm130, "micron_optics.Sm130Emulator"),
    "hyperion": _interrogator(Hyperion, "micron_optics.HyperionEmulator"),
    "net_ft": InstrumentKind(
        lambda *_: {}, _net_ft, "ati.NetFtEmulator", ("udp",),
        lambda table, _: {
            "noise": table.number("noise", 0.0), "rate_hz": table.number("rate_hz", 1000.0, positive=True),
        },
        has_page=True,
    ),
    "camera": InstrumentKind(
        lambda table, _, address: {
            "discard": table.whole("discard", 0 if address.startswith("http://") else 4, least=0)
        },
        _camera, "camera.NetworkCamera", ("http",),
        lambda table, _: {"noise_grey": table.number("noise_grey", 2.0)}, place_unit="px",
    ),
    "python": InstrumentKind(_sensor_settings, _own, own=True, meaning=("make", "with", "fields")),
    "python_axes": InstrumentKind(_axes_settings, _own, own=True, moves=True, meaning=("make", "with")),
}  # fmt: skip


@cache
def instrument_kinds() -> Mapping[str, InstrumentKind]:
    """Every kind of instrument by name: those here, then those of other packages."""
    return {**INSTRUMENTS, **plugins(INSTRUMENTS, OF_PACKAGES, InstrumentKind)}


# -- files of ports: kind and address by name, written by a laboratory and read by an experiment ----------------


def write_ports(path: str | Path, ports: Mapping[str, Mapping[str, str]]) -> None:
    """Writes kind and address by name as JSON; the file is whole whenever another program looks at it."""
    write_whole(path, json.dumps(ports, indent=2) + "\n")


def read_ports(path: str | Path) -> dict[str, dict[str, Any]]:
    """Reads what :func:`write_ports` wrote. Raises :class:`~sherkit.errors.ExperimentError`."""
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
