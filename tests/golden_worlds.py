"""Two hundred worlds whose answers are kept: all robots, mistakes of a set-up, physics of no catalogue, real runs.

A world is a name and a function that asks for its diagnosis. None is judged here: what its answer was is kept in
``tests/golden``, and a change of the product is compared with it.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

import mistakes
import sherkit as sk
import table_mistakes
import test_telescope
import test_tool_missing
import worlds
from clean_tables import DATA
from second_machines import MACHINES, apart, run_of
from second_printer.trials import FAULTS, Trial
from second_simulator import CATALOGUE, OUTSIDE_CATALOGUE
from second_simulator.spherical import SPHERICAL_EFFECTS
from second_simulator.unnamed import DELTA_KINDS, SPHERICAL_KINDS, Unnamed, delta_unnamed, spherical_unnamed
from sherkit.robots.machine import load_machine
from sherkit.robots.printer import import_klipper
from test_arm_counted import arm_in
from test_serial import EFFECTS as ARM_EFFECTS
from test_serial import hidden_at, simulated
from worlds import Answer, World, heard
from zeros import counted_from_anywhere

Ask = Callable[[], Answer]

MACHINE_FILES = Path(__file__).parents[1] / "examples" / "machines"


def _asked(make: Callable[..., World], *given: Any, **more: Any) -> Answer:
    return make(*given, **more).ask()


def _unnamed(make: Callable[..., Unnamed], kind: Any) -> Answer:
    world = make(kind, 5.0, "shuffled", 0)
    return World(world.settings, world.columns, world.noise).ask()


def _mistaken(make: Callable[[int], World], mistake: mistakes.Mistake) -> Answer:
    return mistakes.file_of(mistake.change(make(0))).ask()


def _slipped(robot: str, slip: table_mistakes.Slip) -> Answer:
    return slip.change(table_mistakes.ROBOTS[robot](0), np.random.default_rng([0, 60])).ask()


def _zeros(seed: int, scaled: dict[str, float]) -> Answer:
    robot, data = counted_from_anywhere(seed, scaled)
    return heard(lambda: sk.diagnose(robot, data))


def _arm(name: str | None, seed: int) -> Answer:
    with tempfile.TemporaryDirectory() as folder:
        arm = arm_in(Path(folder))
    data = simulated(arm, seed, 60, **(hidden_at(arm, name, 5.0, seed) if name else {}))
    return heard(lambda: sk.diagnose(arm, data))


def _machine(name: str, sizes: dict[str, float]) -> Answer:
    with apart():
        machine = load_machine(MACHINE_FILES / f"{name}.py")
        return heard(lambda: sk.diagnose(machine, run_of(name, 1, sizes, poses=80)))


def _printer(fault: str) -> Answer:
    with tempfile.TemporaryDirectory() as folder:
        (path,) = Trial.of(fault, 3, 1).write(Path(folder), "klipper", (0.0,), 1)
        return _klipper(path)


def _klipper(path: Path) -> Answer:
    printer = import_klipper(path)
    return heard(lambda: sk.diagnose(printer.robot, printer.measurements))


def _telescope(file: str, run: str) -> Answer:
    mount = test_telescope.mount
    read = mount.read_gem if file == mount.GEM else mount.read_mmt
    return heard(lambda: mount.diagnosed(read(DATA / file, run)))


def _tool(name: str | None) -> Answer:
    return heard(lambda: test_tool_missing.diagnosed(name, 1))


def _worlds() -> Iterator[tuple[str, Ask]]:
    for seed in range(6):
        yield f"delta, nothing hidden, {seed}", partial(_asked, worlds.clean, seed)
        yield f"spherical, nothing hidden, {seed}", partial(_asked, worlds.spherical_clean, seed)
    for name, row in worlds.ROWS.items():
        yield f"contradiction, {name}", partial(_asked, row, 0)
    for name in (*CATALOGUE, *OUTSIDE_CATALOGUE):
        if name not in ("sensor_pose", "sensor_tilt"):
            scaled = {name: 4 * worlds.NOISE_UM}
            yield f"delta, {name}", partial(_asked, worlds.delta_world, 1, scaled)
    for name in CATALOGUE[::3]:
        yield f"delta, zeros of its own, {name}", partial(_zeros, 1, {name: 2.0})
    for one, other in pairwise(CATALOGUE[::2]):
        yield f"delta, {one} and {other}", partial(_zeros, 2, {one: 4.0, other: 4.0})
    for name in SPHERICAL_EFFECTS:
        yield f"spherical, {name}", partial(_asked, worlds.spherical_world, 1, repeats=3, scaled={name: 4})
    for kind in DELTA_KINDS:
        yield f"delta, no catalogue, {kind.__name__}", partial(_unnamed, delta_unnamed, kind)
    for kind in SPHERICAL_KINDS:
        yield f"spherical, no catalogue, {kind.__name__}", partial(_unnamed, spherical_unnamed, kind)
    for robot, (make, made) in mistakes.MISTAKES.items():
        for mistake in made:
            yield f"{robot}, mistake, {mistake.name}", partial(_mistaken, make, mistake)
    robots = tuple(table_mistakes.ROBOTS)
    for k, slip in enumerate(table_mistakes.SLIPS[::2]):
        robot = "delta" if slip.rule == "places" else robots[k % len(robots)]
        yield f"{robot}, table, {slip.name}", partial(_slipped, robot, slip)
    yield "arm, nothing hidden", partial(_arm, None, 1)
    for name in ARM_EFFECTS:
        yield f"arm, {name}", partial(_arm, name, 1)
    for name in MACHINES:
        yield f"{name}, nothing hidden", partial(_machine, name, {})
        yield f"{name}, drift", partial(_machine, name, {"drift_mm_h": 0.1})
        yield f"{name}, thermal shift", partial(_machine, name, {"stand_per_c": 0.01})
    for fault in FAULTS:
        yield f"printer, {fault}", partial(_printer, fault)
    yield "real, FLSUN V400", partial(_klipper, DATA / "delta_flsun_v400_b" / "printer.cfg")
    yield "real, telescope GEM", partial(_telescope, test_telescope.mount.GEM, "gem-28.dat")
    yield "real, telescope MMT", partial(_telescope, test_telescope.mount.MMT, "point_20230702.dat")
    for name in (None, "tool_stiffness", "shaft_bend", "registration"):
        yield f"tool, {name or 'nothing hidden'}", partial(_tool, name)


#: Every world by its name.
WORLDS: dict[str, Ask] = dict(_worlds())
