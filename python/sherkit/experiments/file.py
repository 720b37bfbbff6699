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

from ..calibration import Calibration
from ..calibrations import load_calibration
from ..chain import effects_by_name
from ..errors import ExperimentError
from ..instruments import Axis, Galil, Hyperion, Keyence, NetFT, Sm130, fetch_scale
from ..instruments.base import Instrument
from ..laboratory.file import read_toml
from ..laboratory.running import read_ports
from ..measurements import Measurements
from ..measurements.columns import POSITION
from ..models import model_of
from ..names import listed
from ..pose_design import choose_poses
from ..poses import grid, paper_local, paper_whole
from ..robots import Delta, load_robot
from ..robots.table import Table
from .bench import Bench, Checks, Sensor, Settling
from .live import GOALS, Goal
from .plan import ORDERS, Plan, plan_of_poses

Floats = NDArray[np.float64]

POSES = ("paper_local", "paper_whole", "grid", "designed", "line", "list", "diagnosis")
MOTION = "galil"
SENSORS = ("keyence", "sm130", "hyperion", "net_ft")
_LETTERS = "ABC"


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
    """A plan and what carries it out. ``run_path`` is where its run file stands unless another is named."""

    robot: Delta
    plan: Plan
    targets_mm: Floats
    instruments: tuple[InstrumentSettings, ...]
    settling: Settling
    checks: Checks
    goal: Goal | None
    warm_up_s: float
    run_path: Path
    source: str
    text: str

    @cached_property
    def times_s(self) -> Floats:
        """When each step is read (n,), s from the beginning, as far as speed and settling tell."""
        motion = next(i for i in self.instruments if i.kind == MOTION).settings
        speed, acceleration = motion["speed_mm_s"], motion["acceleration_mm_s2"]
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
        scale, zeros = settings.pop("counts_per_mm"), settings.pop("zero_counts")
        assert self.robot.joint_limits_mm is not None
        axes = [
            Axis(letter, scale[k], self.robot.joint_limits_mm, int(zeros[k]), f"q{k + 1}")
            for k, letter in enumerate(_LETTERS)
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
    values = read_toml(path)
    table = Table(values, str(path), error=ExperimentError)
    named = table.words("robot")
    robot_path = path.parent / named if robot is None else Path(robot)
    made = load_robot(robot_path)
    if not isinstance(made, Delta):
        raise ExperimentError(f"{path}: {robot_path} is a {made.kind} robot; experiments move a delta")
    if made.joint_limits_mm is None:
        raise ExperimentError(
            f"{robot_path}: [joints] limits_mm is missing; nothing is moved without the lowest and the highest joint "
            "reading that a motor may go to"
        )
    run_path = path.parent / table.words("run", path.stem + ".sqlite")
    given_ports = table.words("ports", "")
    known: Mapping[str, Mapping[str, Any]] = {}
    if not offline and (ports or given_ports):
        known = read_ports(ports or path.parent / given_ports)
    with table.table("plan") as p:
        targets = _targets(p, path.parent, made)
        joints = _joints(p, made, targets, path.parent)
        plan = plan_of_poses(
            joints,
            made.inverse([0.0, 0.0, 0.0]).tolist(),
            repeats=p.whole("repeats", 1, least=1),
            order=p.text("order", ORDERS, "planes"),
            seed=p.whole("seed", 0),
            approach=p.positive("approach_mm"),
        )
        warm_up_s = p.number("warm_up_s", 0.0)
    settling, checks, goal = _rules(table)
    instruments = tuple(_instrument(one, known, path, offline) for one in table.tables("instrument"))
    table.finish()
    _check_instruments(instruments, path)
    low, high = made.joint_limits_mm
    places = plan.places()
    outside = (places < low) | (places > high)
    if outside.any():
        raise ExperimentError(
            f"{path}: the plan sends a joint to {places[outside][0]:.3f} mm; [joints] limits_mm of {robot_path} are "
            f"{low:g} to {high:g}"
        )
    return Experiment(
        made, plan, targets, instruments, settling, checks, goal, warm_up_s, run_path, str(path), tomli_w.dumps(values)
    )  # fmt: skip


def _rules(table: Table) -> tuple[Settling, Checks, Goal | None]:
    with table.table("settle", optional=True) as s:
        within = s.positive("within_mm")
        settling = Settling(
            s.number("seconds", 2.0), within, s.whole("count", 3, least=2), s.number("longest_s", 30.0, positive=True)
        )
    with table.table("check", optional=True) as c:
        checks = Checks(
            c.number("agree_within_mm", 0.05, positive=True),
            c.number("moved_within_mm", 0.002, positive=True),
            c.positive("plausible_mm"),
        )
    goal = None
    if table.has("goal"):
        with table.table("goal") as g:
            goal = Goal(g.number("std_um", positive=True), g.text("of", GOALS, GOALS[0]), g.flag("stop", False))
    return settling, checks, goal


def _targets(table: Table, folder: Path, robot: Delta) -> Floats:
    """Places (n, 3), mm, that the plan names."""
    kind = table.text("poses", POSES)
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


def _joints(table: Table, robot: Delta, targets: Floats, folder: Path) -> Floats:
    """Joint readings (n, 3) that bring the robot to the places: by the drawing, or through a calibration."""
    name = table.words("through", "")
    if not name:
        return robot.inverse_batch(targets).require("pose")
    calibration = load_calibration(folder / name)
    if not isinstance(calibration, Calibration):
        raise table.fail("through", "the calibration of a delta")
    return calibration.inverse_batch(targets).require("pose")


def _instrument(table: Table, ports: Mapping[str, Mapping[str, Any]], path: Path, offline: bool) -> InstrumentSettings:
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
        per_mm = table.number("counts_per_mm")
        if per_mm == 0:
            raise table.fail("counts_per_mm", "a number other than 0")
        settings["counts_per_mm"] = [per_mm] * 3
        settings["zero_counts"] = list(table.numbers("zero_counts", 3, (0.0, 0.0, 0.0)))
        for key, default in (
            ("speed_mm_s", 5.0), ("acceleration_mm_s2", 50.0), ("arrived_within_mm", 0.01), ("settle_s", 2.0),
            ("poll_s", 0.05), ("poll_timeout_s", 0.5), ("stop_timeout_s", 5.0),
        ):  # fmt: skip
            settings[key] = table.number(key, default, positive=True)
    elif kind == "keyence":
        outputs = table.some_numbers("outputs", (1.0, 2.0, 3.0))
        settings["outputs"] = [int(k) for k in outputs]
        settings["method"] = table.text("method", ("MS", "MM", "MA"), "MS")
        settings["unit"] = table.text("unit", ("mm", "um"), "mm")
        columns = table.texts("columns", POSITION if len(outputs) == 3 else ())
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


def _check_instruments(instruments: tuple[InstrumentSettings, ...], path: Path) -> None:
    motors = [i.name for i in instruments if i.kind == MOTION]
    if len(motors) != 1:
        raise ExperimentError(f"{path}: has {len(motors)} [[instrument]] of kind '{MOTION}'; expected one")
    columns = [c for i in instruments for c in i.columns]
    if len(set(columns)) < len(columns):
        raise ExperimentError(f"{path}: two instruments have the same column; columns are {listed(columns, 20)}")
    if not any(name in columns for name in POSITION):
        raise ExperimentError(f"{path}: no instrument reads any of {', '.join(POSITION)}; there would be no reading")


def _sensor(one: InstrumentSettings) -> Instrument:
    settings = dict(one.settings)
    if one.kind == "keyence":
        return Keyence(one.address, settings.pop("outputs"), names=one.columns, name=one.name, **settings)
    if one.kind == "net_ft":
        if not one.page:
            raise ExperimentError(f"{one.name}: has no page; give the address of its netftapi2.xml")
        return NetFT(one.address, fetch_scale(one.page), name=one.name, **settings)
    kind = Sm130 if one.kind == "sm130" else Hyperion
    return kind(one.address, tuple(settings.pop("gratings")), name=one.name, **settings)
