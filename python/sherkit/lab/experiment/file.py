"""Experiment files: TOML that names robot, run, poses and instruments. Nothing in it is a program."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from ...adaptive import Adaptive
from ...adaptive.task import BATCH, BUDGET
from ...base.figures import listed
from ...base.types import Floats
from ...data import Measurements
from ...data.columns import POSE, REASON, REPEAT, TIME
from ...data.toml import Table, read_toml
from ...errors import ExperimentError
from ...model.effect import effects_by_name
from ...model.kinds import MOST_IN_LINE, Kind, Robot, kind_of, model_of
from ...model.robot_file import load_robot
from ...planning.poses import choose_poses
from ...robots.calibrated import load_calibration
from ..instruments import AxisController
from ..instruments.user_driver import OwnCode, run_code
from ..kinds import InstrumentSettings, instrument_kinds, read_ports
from .bench import Bench, Checks, Sensor, Settling
from .plan import ORDERS, Plan, PlanStep, plan_of_poses
from .run_file import RunFile
from .runner import GOALS, Goal

# -- The poses of a plan --------------------------------------------------------------------------------------------

_DESIGNED = "designed"
_DIAGNOSIS = "diagnosis"


def names_of_poses(kind: Kind) -> tuple[str, ...]:
    """What a plan for this kind of robot can name."""
    names = [one for name in kind.poses for one in ((name, _DESIGNED) if name == kind.grid else (name,))]
    return (*names, _DIAGNOSIS) if kind.coordinates else tuple(names)


def coordinates_of_plan(table: Table, folder: Path, robot: Robot) -> Floats:
    """Coordinates (n, k) that ``[plan]`` names, mm or rad; files are looked for in ``folder``.

    Raises :class:`~sherkit.errors.ExperimentError` naming the key.
    """
    kind = kind_of(robot)
    names = names_of_poses(kind)
    if not names:
        raise ExperimentError(f"{robot.kind} robots know no poses that a plan could name")
    name = table.text("poses", names)
    if name == _DESIGNED:
        return _designed(table, kind.poses[kind.grid](robot, table), robot)
    if name == _DIAGNOSIS:
        return _proposed(folder / table.words("file"), kind.coordinates)
    return kind.poses[name](robot, table)


def joints_of_plan(table: Table, folder: Path, robot: Robot, coordinates: Floats) -> Floats:
    """Joint readings (n, k) that bring the robot there: by the drawing, or through a calibration."""
    name = table.words("through", "")
    if not name:
        return robot.inverse_batch(coordinates).require("pose")
    calibration = load_calibration(folder / name)
    if calibration.robot.kind != robot.kind:
        raise table.fail("through", f"the calibration of a {robot.kind} robot")
    return calibration.inverse_batch(coordinates).require("pose")


def _designed(table: Table, places: Floats, robot: Robot) -> Floats:
    """Those of a grid that observe the parameters best, in a random order; what the robot cannot reach is left out."""
    count = table.whole("count", least=1, most=MOST_IN_LINE)
    model = model_of(robot)
    effects = effects_by_name(model.known_effects, table.texts("effects", ()))
    if needy := [e.name for e in effects if e.needs]:
        raise table.fail("effects", f"effects that depend on the pose alone; {listed(needy)} needs more")
    reached = robot.inverse_batch(places)
    rows = Measurements.planned(reached.values[reached.reached], kind_of(robot).layout)
    design = choose_poses(replace(model, effects=effects), rows, count, seed=table.whole("design_seed", 0, least=0))
    return places[reached.reached][design.rows]


def _proposed(path: Path, names: tuple[str, ...]) -> Floats:
    """The poses that a diagnosis proposed: what ``sherkit diagnose --json`` prints."""
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        out = np.array([[float(p[name]) for name in names] for p in found["next_poses"]]).reshape(-1, len(names))
    except OSError as error:
        raise ExperimentError(f"{path}: cannot be read: {error.strerror}") from None
    except (ValueError, KeyError, TypeError) as error:
        raise ExperimentError(f"{path}: is not what 'sherkit diagnose --json' prints: {error}") from None
    if not len(out):
        raise ExperimentError(f"{path}: the diagnosis proposes no pose: {found.get('advice') or 'nothing is tied'}")
    return out


# -- The file --------------------------------------------------------------------------------------------------------

#: How far joints may move while sensors are read, by their unit.
_MOVED_WITHIN = {"mm": 0.002, "rad": 5e-5}
#: By how much two readings of a sensor may differ, by the unit of the robot's place.
_AGREE_WITHIN = {"mm": 0.05, "px": 0.5}
#: Endings of keys for the units in which people read a place.
_SPELT = {"µm": "um"}


@dataclass(frozen=True)
class Experiment:
    """A plan and what carries it out. ``run_path`` is where its run file stands unless another is named,
    ``robot_path`` the file of its robot.

    ``targets`` are the coordinates of its poses (n, k), as the robot's kinematics has them: mm or rad.
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
    robot_path: Path
    source: str
    text: str
    #: How the robot chooses its poses itself, as :class:`~sherkit.Adaptive` takes it; None where ``[adaptive]`` is
    #: missing. Without a list of poses the plan holds those that it begins with.
    adaptive: Mapping[str, Any] | None = None

    @property
    def _motors(self) -> InstrumentSettings:
        return next(one for one in self.instruments if instrument_kinds()[one.kind].moves)

    @cached_property
    def times_s(self) -> Floats:
        """When each step is read (n,), s from the beginning, as far as speed and settling tell."""
        motion = self._motors.settings
        speed, acceleration = motion["speed"], motion["acceleration"]
        ways = np.abs(np.diff(self.plan.places(), axis=0)).max(axis=1)
        # a trapezoid of speed, or a triangle on a short way
        whole = ways > speed * speed / acceleration
        took = np.where(whole, ways / speed + speed / acceleration, 2.0 * np.sqrt(ways / acceleration))
        ends = np.cumsum([1 + len(step.via) for step in self.plan]) - 1
        return np.asarray(np.cumsum(took)[ends] + self.settling.seconds * np.arange(1, len(ends) + 1))

    @property
    def seconds(self) -> float:
        """How long the plan takes, about."""
        return float(self.times_s[-1]) + self.warm_up_s

    def about(self) -> dict[str, str]:
        """What the run file holds of it, besides the plan."""
        return {
            "robot": tomli_w.dumps(self.robot.to_tables()),
            "experiment": self.text,
            "source": self.source,
            "meaning": json.dumps({one.name: one.meaning() for one in self.instruments}),
        }

    def motion(self) -> AxisController:
        """The motion controller, not yet connected. Raises :class:`~sherkit.errors.ExperimentError`."""
        motion = instrument_kinds()[self._motors.kind].driver(self._motors, self.robot)
        assert isinstance(motion, AxisController), "a kind that moves has a driver of axes"
        return motion

    def bench(self) -> Bench:
        """The instruments, not yet connected. Raises :class:`~sherkit.errors.ExperimentError`."""
        sensors = [
            Sensor(instrument_kinds()[one.kind].driver(one, self.robot), one.columns, one.settings)
            for one in self.instruments
            if one is not self._motors
        ]
        return Bench(
            self.robot, self.motion(), sensors, settling=self.settling, checks=self.checks,
            motion_settings=self._motors.settings,
        )  # fmt: skip


def load_experiment(
    path: str | Path, ports: str | Path | None = None, *, robot: str | Path | None = None, offline: bool = False,
    python: Sequence[str | Path] = (),
) -> Experiment:  # fmt: skip
    """Reads an experiment; ``ports`` (a file that ``sherkit lab`` wrote) gives addresses by the instruments' names.

    ``robot`` is another robot file than the one it names. ``offline`` is for planning: addresses may be missing.
    ``python`` are files that define instruments of your own; they are run.
    Raises :class:`~sherkit.errors.ExperimentError` naming file, table and key, and where the robot cannot be where the
    plan sends it.
    """
    path = Path(path)
    code = run_code(python)
    table = Table(read_toml(path, "experiment", ExperimentError), str(path), error=ExperimentError)
    return experiment_from(table, path, code, ports, robot, offline=offline)


def experiment_from(
    table: Table, path: Path, code: OwnCode, ports: str | Path | None = None, robot: str | Path | None = None, *,
    offline: bool = False,
) -> Experiment:  # fmt: skip
    """The experiment of the table of a file ``path``, otherwise as :func:`load_experiment`."""
    named = table.words("robot")
    robot_path = path.parent / named if robot is None else Path(robot)
    made = load_robot(robot_path)
    limits, unit = made.joint_limits, made.joint_unit
    shown = kind_of(made).example
    if limits is None and shown is not None and "joints" not in shown.to_tables():
        raise ExperimentError(
            f"{robot_path}: experiments drive robots whose joints share one range; bring this one to its poses by its "
            "own controller, and give the rows to sherkit diagnose"
        )
    if limits is None:
        raise ExperimentError(
            f"{robot_path}: [joints] limits_{'mm' if unit == 'mm' else 'deg'} is missing; nothing is moved without the "
            "lowest and the highest joint reading that a motor may go to"
        )
    run_path = path.parent / table.words("run", path.stem + ".sqlite")
    given_ports = table.words("ports", "")
    known = read_ports(ports or path.parent / given_ports) if not offline and (ports or given_ports) else {}
    chosen: Mapping[str, Any] | None = None
    if table.has("adaptive"):
        with table.table("adaptive") as a:
            chosen = adaptive_settings(a, made)
    with table.table("plan", optional=chosen is not None) as p:
        if chosen is not None and not p.has("poses"):
            plan = AdaptiveRun(made, chosen).first()
            targets = np.array([made.forward(step.joints) for step in plan])
        else:
            targets = coordinates_of_plan(p, path.parent, made)
            plan = plan_of_poses(
                joints_of_plan(p, path.parent, made, targets),
                made.inverse(made.middle).tolist(),
                repeats=p.whole("repeats", 1, least=1),
                order=p.text("order", ORDERS, "planes"),
                seed=p.whole("seed", 0, least=0),
                approach=p.positive(f"approach_{unit}"),
            )
        warm_up_s = p.number("warm_up_s", 0.0)
    settling, checks, goal = _rules(table, made)
    with table.table("retry", optional=True) as r:
        attempts = r.whole("attempts", 1, least=1)
    instruments = tuple(_instrument(one, known, path, offline, made, code) for one in table.tables("instrument"))
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
        made, plan, targets, instruments, settling, checks, goal, warm_up_s, attempts, run_path, robot_path,
        str(path), tomli_w.dumps(table.values), chosen,
    )  # fmt: skip


def _rules(table: Table, robot: Robot) -> tuple[Settling, Checks, Goal | None]:
    kind, unit = kind_of(robot), robot.joint_unit
    place = kind.place_unit
    if place not in _AGREE_WITHIN:
        raise ExperimentError(f"experiments read a place in {listed(_AGREE_WITHIN)}; {kind.name} robots have {place}")
    with table.table("settle", optional=True) as s:
        within = s.positive(f"within_{place}")
        settling = Settling(
            s.number("seconds", 2.0), within, s.whole("count", 3, least=2), s.number("longest_s", 30.0, positive=True)
        )
    with table.table("check", optional=True) as c:
        checks = Checks(
            c.number(f"agree_within_{place}", _AGREE_WITHIN[place], positive=True),
            c.number(f"moved_within_{unit}", _MOVED_WITHIN[unit], positive=True),
            c.positive(f"plausible_{place}") if kind.shows_coordinates else None,
            c.flag("watch", True),
            c.number(f"noise_{place}", _AGREE_WITHIN[place], positive=True),
        )
    goal = None
    if table.has("goal"):
        with table.table("goal") as g:
            of = g.text("of", GOALS, GOALS[0])
            read_in = _SPELT.get(kind.layout.unit, kind.layout.unit) if of == "position" else "um"
            goal = Goal(g.number(f"std_{read_in}", positive=True), of, g.flag("stop", False))
    return settling, checks, goal


def _instrument(
    table: Table, ports: Mapping[str, Mapping[str, Any]], path: Path, offline: bool, robot: Robot, code: OwnCode
) -> InstrumentSettings:
    kind = table.text("kind", tuple(instrument_kinds()))
    row = instrument_kinds()[kind]
    name = table.words("name", kind)
    found = ports.get(name, {})
    address = table.words("address", str(found.get("address", "")))
    if not address and not offline and not row.own:
        raise ExperimentError(
            f"{path}: instrument '{name}' has no address; give it one, or name the file of ports that 'sherkit lab' "
            f"wrote{f' (it has {listed(ports)})' if ports else ''}"
        )
    settings = row.settings(table, robot, address)
    # what a user's own sensor reads, nobody else knows
    columns = () if row.moves else table.texts("columns", None if row.own else row.columns(settings, robot))
    page = table.words("page", str(found.get("page", ""))) if row.has_page else ""
    settings["timeout_s"] = table.number("timeout_s", 2.0, positive=True)
    settings["retries"] = table.whole("retries", 2, least=0)
    if row.is_serial:
        settings["baud"] = table.whole("baud", 115200, least=1)
    make, said = code.maker(settings["make"], str(path)) if row.own and not offline else (None, "")
    return InstrumentSettings(name, kind, address, settings, columns, page, make, said)


def _check_instruments(instruments: tuple[InstrumentSettings, ...], path: Path, robot: Robot) -> None:
    motors = [i.name for i in instruments if instrument_kinds()[i.kind].moves]
    if len(motors) != 1:
        moving = " or ".join(f"'{name}'" for name, row in instrument_kinds().items() if row.moves)
        raise ExperimentError(f"{path}: has {len(motors)} [[instrument]] of kind {moving}; expected one")
    columns = [c for i in instruments for c in i.columns]
    if len(set(columns)) < len(columns):
        raise ExperimentError(f"{path}: two instruments have the same column; columns are {listed(columns, 20)}")
    wanted = kind_of(robot).layout.coordinates
    if not any(name in columns for name in wanted):
        raise ExperimentError(f"{path}: no instrument reads any of {', '.join(wanted)}; there would be no reading")


# -- a run whose poses nobody planned ---------------------------------------------------------------------------------


def adaptive_settings(table: Table, robot: Robot) -> dict[str, Any]:
    """What ``[adaptive]`` says, as :class:`~sherkit.Adaptive` takes it. Raises
    :class:`~sherkit.errors.ExperimentError` naming the key."""
    kind = kind_of(robot)
    box: dict[str, list[float]] = {}
    with table.table("box", optional=True) as inner:
        for name in dict.fromkeys((*kind.layout.joints, *kind.coordinates)):
            ends = inner.numbers(name, 2, (0.0, 1.0))
            if inner.has(name):
                box[name] = list(ends)
    return {
        "required_um": table.positive("required_um"),
        "budget": table.whole("budget", BUDGET, least=1),
        "minutes": table.positive("minutes"),
        "span_min": table.number("span_min", 0.0),
        "box": box or None,
        "level": table.number("level", 0.01, positive=True),
        "batch": table.whole("batch", BATCH, least=1),
        "seed": table.whole("seed", 0, least=0),
    }


class AdaptiveRun:
    """A loop that chooses the poses and the run file that it fills: :meth:`more` is what the runner asks when all steps
    are taken.

    What the loop holds follows from the rows of the run file, so that a run that was interrupted goes on as if nothing
    had been.
    """

    def __init__(self, robot: Robot, settings: Mapping[str, Any]) -> None:
        self.robot, self.settings = robot, dict(settings)
        self.loop = Adaptive(robot, **self.settings)

    def first(self) -> Plan:
        """The poses to begin with, from the middle of the robot's workspace."""
        start = np.asarray(self.robot.inverse(self.robot.middle), dtype=float)
        return Plan(self._steps(), tuple(start.tolist()))

    def _steps(self) -> tuple[PlanStep, ...]:
        joints = kind_of(self.robot).layout.joints
        return tuple(
            PlanStep(
                row[POSE], row[REPEAT], tuple(row[name] for name in joints), (), row["not_before_s"], row["reason"]
            )
            for row in self.loop.ask()
        )

    def take(self, file: RunFile) -> None:
        """Tells the loop what stands in the run file; what it knows already is no news."""
        why = {(step.pose, step.repeat): step.reason for step in file.plan.steps}
        rows = [
            {POSE: p.pose, REPEAT: p.repeat, TIME: p.time_s, **p.values, REASON: why.get((p.pose, p.repeat), "")}
            for p in file.points()
        ]
        if rows:
            self.loop.tell(rows)

    def more(self, file: RunFile, plan: Plan) -> Plan | None:
        """The plan that goes on, or None where it is known."""
        self.take(file)
        return plan.longer(self._steps()) if not self.loop.done else None
