"""Experiment files: TOML that names robot, run, poses and instruments. Nothing in it is a program."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w
from numpy.typing import NDArray

from ..calibrations import load_calibration
from ..chain import effects_by_name
from ..errors import ExperimentError
from ..instruments import Axis, Camera, Galil, Hyperion, Keyence, NetFT, Sm130, Snapshots, fetch_scale
from ..instruments.base import Instrument
from ..laboratory.running import read_ports
from ..laboratory.virtual import middle_of
from ..measurements import Measurements
from ..measurements.columns import JOINTS, POSITION, SPHERICAL_JOINTS, SPHERICAL_PIXELS
from ..models import model_of
from ..names import listed
from ..pose_design import choose_poses
from ..poses import grid, paper_local, paper_whole, sphere_patch
from ..robots import Delta, Spherical, load_robot
from ..robots.file import Robot
from ..robots.table import Table, read_toml
from ..straightness import LINES
from ..straightness import targets as line_targets
from .bench import Bench, Checks, Sensor, Settling
from .live import GOALS, Goal
from .plan import ORDERS, Plan, plan_of_poses

Floats = NDArray[np.float64]

#: Poses that a plan can name, by the kind of robot.
POSES = {
    "delta": ("paper_local", "paper_whole", "grid", "designed", "line", "list", "diagnosis"),
    "spherical": ("patch", "line", "list"),
}
MOTION = "galil"
SENSORS = ("keyence", "sm130", "hyperion", "net_ft", "camera")
_LETTERS = "ABC"
#: Defaults of what has the unit of the joints: speed per s, acceleration per s², and two ways to stand still.
_MOVING = {"mm": (5.0, 50.0, 0.01, 0.002), "rad": (0.5, 5.0, 2e-4, 5e-5)}
#: What sensors read of it, and by how much two readings may differ.
_SEEN = {"mm": ("mm", 0.05), "rad": ("px", 0.5)}


@dataclass(frozen=True)
class InstrumentSettings:
    """One instrument as the file has it; ``settings`` go to its driver, ``columns`` name its values in the run."""

    name: str
    kind: str
    address: str
    settings: Mapping[str, Any]
    columns: tuple[str, ...]
    page: str = ""


@dataclass(frozen=True)
class Experiment:
    """A plan and what carries it out. ``run_path`` is where its run file stands unless another is named.

    ``targets`` are the places of its poses: x, y, z of a delta, mm, or φ, γ of a spherical robot, rad.
    """

    robot: Robot
    plan: Plan
    targets: Floats
    instruments: tuple[InstrumentSettings, ...]
    settling: Settling
    checks: Checks
    goal: Goal | None
    warm_up_s: float
    attempts: int
    run_path: Path
    source: str
    text: str

    @cached_property
    def times_s(self) -> Floats:
        """When each step is read (n,), s from the beginning, as far as speed and settling tell."""
        motion = next(i for i in self.instruments if i.kind == MOTION).settings
        speed, acceleration = motion["speed"], motion["acceleration"]
        at, now, out = np.array(self.plan.start), 0.0, []
        for step in self.plan:
            for place in (*step.via, step.joints):
                way = float(np.abs(np.subtract(place, at)).max())
                # a trapezoid of speed, or a triangle on a short way
                ramp = speed * speed / acceleration
                now += way / speed + speed / acceleration if way > ramp else 2.0 * float(np.sqrt(way / acceleration))
                at = np.array(place)
            now += self.settling.seconds
            out.append(now)
        return np.array(out)

    @property
    def seconds(self) -> float:
        """How long the plan takes, about."""
        return float(self.times_s[-1]) + self.warm_up_s

    def about(self) -> dict[str, str]:
        """What the run file holds of it, besides the plan."""
        return {"robot": tomli_w.dumps(self.robot.to_tables()), "experiment": self.text, "source": self.source}

    def bench(self) -> Bench:
        """The instruments, not yet connected. Raises :class:`~sherkit.errors.ExperimentError`."""
        motion = None
        sensors: list[Sensor] = []
        noted: dict[str, Any] = {}
        for one in self.instruments:
            if one.kind == MOTION:
                motion, noted = self._galil(one), dict(one.settings)
            else:
                sensors.append(Sensor(_sensor(one), one.columns, dict(one.settings)))
        assert motion is not None
        return Bench(
            self.robot, motion, sensors, settling=self.settling, checks=self.checks, motion_settings=noted
        )  # fmt: skip

    def _galil(self, one: InstrumentSettings) -> Galil:
        settings = dict(one.settings)
        scale, zeros = settings.pop("counts_per_unit"), settings.pop("zero_counts")
        limits, unit = limits_of(self.robot), unit_of(self.robot)
        assert limits is not None
        names = [name.rsplit("_", 1)[0] for name in (SPHERICAL_JOINTS if unit == "rad" else JOINTS)]
        axes = [
            Axis(letter, scale, limits, int(zero), name, unit)
            for letter, zero, name in zip(_LETTERS, zeros, names, strict=False)
        ]
        return Galil(one.address, axes, name=one.name, **settings)


def load_experiment(
    path: str | Path, ports: str | Path | None = None, *, robot: str | Path | None = None, offline: bool = False
) -> Experiment:
    """Reads an experiment; ``ports`` (a file that ``sherkit lab`` wrote) gives addresses by the instruments' names.

    ``robot`` is another robot file than the one it names. ``offline`` is for planning: addresses may be missing.
    Raises :class:`~sherkit.errors.ExperimentError` naming file, table and key, and where the robot cannot be where the
    plan sends it.
    """
    path = Path(path)
    values = read_toml(path, "experiment", ExperimentError)
    table = Table(values, str(path), error=ExperimentError)
    named = table.words("robot")
    robot_path = path.parent / named if robot is None else Path(robot)
    made = load_robot(robot_path)
    limits, unit = limits_of(made), unit_of(made)
    if limits is None:
        raise ExperimentError(
            f"{robot_path}: [joints] limits_{'mm' if unit == 'mm' else 'deg'} is missing; nothing is moved without the "
            "lowest and the highest joint reading that a motor may go to"
        )
    run_path = path.parent / table.words("run", path.stem + ".sqlite")
    given_ports = table.words("ports", "")
    known: Mapping[str, Mapping[str, Any]] = {}
    if not offline and (ports or given_ports):
        known = read_ports(ports or path.parent / given_ports)
    with table.table("plan") as p:
        targets = _targets(p, path.parent, made) if isinstance(made, Delta) else _directions(p, made)
        joints = _joints(p, made, targets, path.parent)
        home = (0.0, 0.0, 0.0) if isinstance(made, Delta) else middle_of(made)
        plan = plan_of_poses(
            joints,
            made.inverse(home).tolist(),
            repeats=p.whole("repeats", 1, least=1),
            order=p.text("order", ORDERS, "planes"),
            seed=p.whole("seed", 0),
            approach=p.positive(f"approach_{unit}"),
        )
        warm_up_s = p.number("warm_up_s", 0.0)
    settling, checks, goal = _rules(table, unit)
    with table.table("retry", optional=True) as r:
        attempts = r.whole("attempts", 1, least=1)
    instruments = tuple(_instrument(one, known, path, offline, made) for one in table.tables("instrument"))
    table.finish()
    _check_instruments(instruments, path, made)
    low, high = limits
    places = plan.places()
    outside = (places < low) | (places > high)
    if outside.any():
        raise ExperimentError(
            f"{path}: the plan sends a joint to {places[outside][0]:.3f} {unit}; by [joints] of {robot_path} it may go "
            f"from {low:g} to {high:g} {unit}"
        )
    return Experiment(
        made, plan, targets, instruments, settling, checks, goal, warm_up_s, attempts, run_path,
        str(path), tomli_w.dumps(values),
    )  # fmt: skip


def limits_of(robot: Robot) -> tuple[float, float] | None:
    """The lowest and highest reading that a joint may go to, mm or rad; None where the robot file names none."""
    if isinstance(robot, Delta):
        return robot.joint_limits_mm
    degrees = robot.joint_limits_deg
    return None if degrees is None else (float(np.deg2rad(degrees[0])), float(np.deg2rad(degrees[1])))


def unit_of(robot: Robot) -> str:
    """The unit of its joints."""
    return "mm" if isinstance(robot, Delta) else "rad"


def _rules(table: Table, unit: str) -> tuple[Settling, Checks, Goal | None]:
    seen, agree = _SEEN[unit]
    with table.table("settle", optional=True) as s:
        within = s.positive(f"within_{seen}")
        settling = Settling(
            s.number("seconds", 2.0), within, s.whole("count", 3, least=2), s.number("longest_s", 30.0, positive=True)
        )
    with table.table("check", optional=True) as c:
        checks = Checks(
            c.number(f"agree_within_{seen}", agree, positive=True),
            c.number(f"moved_within_{unit}", _MOVING[unit][3], positive=True),
            c.positive("plausible_mm") if unit == "mm" else None,
        )
    goal = None
    if table.has("goal"):
        with table.table("goal") as g:
            of = g.text("of", GOALS, GOALS[0])
            name = "std_px" if seen == "px" and of == "position" else "std_um"
            goal = Goal(g.number(name, positive=True), of, g.flag("stop", False))
    return settling, checks, goal


def _targets(table: Table, folder: Path, robot: Delta) -> Floats:
    """Places (n, 3), mm, that the plan names."""
    kind = table.text("poses", POSES[robot.kind])
    if kind == "paper_local":
        return paper_local()
    if kind == "paper_whole":
        return paper_whole()
    if kind in ("grid", "designed"):
        places = grid(
            table.number("half_width_mm", positive=True),
            table.whole("per_side", least=1),
            table.some_numbers("planes_mm", (0.0,)),
        )
        return _designed(table, places, robot) if kind == "designed" else places
    if kind == "line":
        begin, end = table.numbers("from_mm", 3), table.numbers("to_mm", 3)
        return np.linspace(begin, end, table.whole("count", 41, least=2))
    if kind == "list":
        rows = table.rows("list_mm", 3)
        if not rows:
            raise table.fail("list_mm", "at least one place")
        return np.array(rows)
    return _proposed(folder / table.words("file"))


def _directions(table: Table, robot: Spherical) -> Floats:
    """Directions φ, γ (n, 2), rad, that the plan names."""
    kind = table.text("poses", POSES[robot.kind])
    if kind == "patch":
        return sphere_patch(robot, table.whole("per_side", least=1), table.number("share", 1.0, positive=True))
    if kind == "line":
        # the straightness experiment: the picture of the marker is to follow a line
        line = LINES[table.text("line", tuple(LINES))]
        return line_targets(robot.seen, robot.radius_mm, line, table.whole("count", 41, least=3))
    rows = table.rows("list_deg", 2)
    if not rows:
        raise table.fail("list_deg", "at least one direction")
    return np.deg2rad(np.array(rows))


def _designed(table: Table, places: Floats, robot: Delta) -> Floats:
    """Those of a grid that observe the parameters best, in a random order; what the robot cannot reach is left out."""
    count = table.whole("count", least=1)
    model = model_of(robot)
    names = table.texts("effects", ())
    effects = effects_by_name(model.catalogue, names)
    needy = [e.name for e in effects if e.needs]
    if needy:
        raise table.fail("effects", f"effects that depend on the pose alone; {listed(needy)} needs more")
    reached = robot.inverse_batch(places)
    rows = Measurements.planned(reached.values[reached.reached])
    design = choose_poses(replace(model, effects=effects), rows, count, seed=table.whole("design_seed", 0))
    return places[reached.reached][design.rows]


def _proposed(path: Path) -> Floats:
    """The poses that a diagnosis proposed: what ``sherkit diagnose --json`` prints."""
    try:
        poses = json.loads(path.read_text(encoding="utf-8"))["next_poses"]
        out = np.array([[float(p[name]) for name in POSITION] for p in poses]).reshape(-1, 3)
    except OSError as error:
        raise ExperimentError(f"{path}: cannot be read: {error.strerror}") from None
    except (ValueError, KeyError, TypeError) as error:
        raise ExperimentError(f"{path}: is not what 'sherkit diagnose --json' prints: {error}") from None
    if not len(out):
        raise ExperimentError(f"{path}: the diagnosis proposes no pose; nothing is tied")
    return out


def _joints(table: Table, robot: Robot, targets: Floats, folder: Path) -> Floats:
    """Joint readings (n, k) that bring the robot to the places: by the drawing, or through a calibration."""
    name = table.words("through", "")
    if not name:
        return robot.inverse_batch(targets).require("pose")
    calibration = load_calibration(folder / name)
    if calibration.robot.kind != robot.kind:
        raise table.fail("through", f"the calibration of a {robot.kind} robot")
    return calibration.inverse_batch(targets).require("pose")


def _instrument(
    table: Table, ports: Mapping[str, Mapping[str, Any]], path: Path, offline: bool, robot: Robot
) -> InstrumentSettings:
    kind = table.text("kind", (MOTION, *SENSORS))
    name = table.words("name", kind)
    found = ports.get(name, {})
    address = table.words("address", str(found.get("address", "")))
    if not address and not offline:
        raise ExperimentError(
            f"{path}: instrument '{name}' has no address; give it one, or name the file of ports that 'sherkit lab' "
            f"wrote{f' (it has {listed(ports)})' if ports else ''}"
        )
    settings: dict[str, Any] = {}
    columns: tuple[str, ...] = ()
    page = ""
    if kind == MOTION:
        unit = unit_of(robot)
        per_unit = table.number(f"counts_per_{unit}")
        if per_unit == 0:
            raise table.fail(f"counts_per_{unit}", "a number other than 0")
        settings["counts_per_unit"] = per_unit
        count = 3 if unit == "mm" else 2
        settings["zero_counts"] = list(table.numbers("zero_counts", count, (0.0,) * count))
        speed, acceleration, within, _ = _MOVING[unit]
        for key, written, default in (
            ("speed", f"speed_{unit}_s", speed), ("acceleration", f"acceleration_{unit}_s2", acceleration),
            ("arrived_within", f"arrived_within_{unit}", within), ("settle_s", "settle_s", 2.0),
            ("poll_s", "poll_s", 0.05), ("poll_timeout_s", "poll_timeout_s", 0.5),
            ("stop_timeout_s", "stop_timeout_s", 5.0),
        ):  # fmt: skip
            settings[key] = table.number(written, default, positive=True)
    elif kind == "keyence":
        outputs = table.some_numbers("outputs", (1.0, 2.0, 3.0))
        settings["outputs"] = [int(k) for k in outputs]
        settings["method"] = table.text("method", ("MS", "MM", "MA"), "MS")
        settings["unit"] = table.text("unit", ("mm", "um"), "mm")
        columns = table.texts("columns", POSITION if len(outputs) == 3 else ())
    elif kind == "camera":
        settings["discard"] = table.whole("discard", 0 if address.startswith("http://") else 4, least=0)
        columns = table.texts("columns", SPHERICAL_PIXELS.coordinates)
    elif kind == "net_ft":
        page = table.words("page", str(found.get("page", "")))
        columns = table.texts("columns", ())
    else:
        settings["gratings"] = [int(k) for k in table.some_numbers("gratings")]
        columns = table.texts("columns", ())
    settings["timeout_s"] = table.number("timeout_s", 2.0, positive=True)
    settings["retries"] = table.whole("retries", 2, least=0)
    if kind in (MOTION, "keyence"):
        settings["baud"] = table.whole("baud", 115200, least=1)
    return InstrumentSettings(name, kind, address, settings, columns, page)


def _check_instruments(instruments: tuple[InstrumentSettings, ...], path: Path, robot: Robot) -> None:
    motors = [i.name for i in instruments if i.kind == MOTION]
    if len(motors) != 1:
        raise ExperimentError(f"{path}: has {len(motors)} [[instrument]] of kind '{MOTION}'; expected one")
    columns = [c for i in instruments for c in i.columns]
    if len(set(columns)) < len(columns):
        raise ExperimentError(f"{path}: two instruments have the same column; columns are {listed(columns, 20)}")
    wanted = POSITION if isinstance(robot, Delta) else SPHERICAL_PIXELS.coordinates
    if not any(name in columns for name in wanted):
        raise ExperimentError(f"{path}: no instrument reads any of {', '.join(wanted)}; there would be no reading")


def _sensor(one: InstrumentSettings) -> Instrument:
    settings = dict(one.settings)
    if one.kind == "keyence":
        return Keyence(one.address, settings.pop("outputs"), names=one.columns, name=one.name, **settings)
    if one.kind == "net_ft":
        if not one.page:
            raise ExperimentError(f"{one.name}: has no page; give the address of its netftapi2.xml")
        return NetFT(one.address, fetch_scale(one.page), name=one.name, **settings)
    if one.kind == "camera":
        return _camera(one, settings)
    kind = Sm130 if one.kind == "sm130" else Hyperion
    return kind(one.address, tuple(settings.pop("gratings")), name=one.name, **settings)


def _camera(one: InstrumentSettings, settings: dict[str, Any]) -> Instrument:
    """A camera with the finder of markers; over HTTP it hands out single pictures."""
    try:
        from ..vision.marker import find_marker
    except ImportError:
        raise ExperimentError(f'{one.name}: cameras need OpenCV: pip install "sherkit[vision]"') from None

    def find(picture: NDArray[np.uint8]) -> tuple[float, float]:
        seen = find_marker(picture)
        return seen.u_px, seen.v_px

    source = None
    if one.address.startswith("http://"):

        def source() -> Snapshots:
            return Snapshots(one.address, settings["timeout_s"])

    return Camera(one.address, source=source, find=find, name=one.name, **settings)
