"""The poses of a plan: those that its robot's kind knows by name, the best of a grid, or what a diagnosis proposed."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from ...base.names import listed
from ...base.types import Floats
from ...data import Measurements
from ...data.toml import Table
from ...errors import ExperimentError
from ...model.effect import effects_by_name
from ...model.kinds import MOST_IN_LINE, Kind, Robot, kind_of, model_of
from ...planning.poses import choose_poses
from ...robots.files import load_calibration

_DESIGNED = "designed"
_DIAGNOSIS = "diagnosis"


def names_of_poses(kind: Kind) -> tuple[str, ...]:
    """What a plan for this kind of robot can name."""
    names: list[str] = []
    for name in kind.poses:
        names += [name, _DESIGNED] if name == kind.grid else [name]
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
    names = table.texts("effects", ())
    effects = effects_by_name(model.known_effects, names)
    needy = [e.name for e in effects if e.needs]
    if needy:
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
