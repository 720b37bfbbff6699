"""What a laboratory calls its columns, when its clock starts and in which order it writes its rows decides nothing."""

from __future__ import annotations

import tempfile
import warnings
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest

import sherkit as sk
from conventions import written_otherwise
from running import slow
from second_machines import apart, run_of
from sherkit.robots.machine import load_machine
from test_arm_counted import arm_in
from test_serial import hidden_at, simulated
from worlds import NOISE_UM, World, delta_world, spherical_world

GANTRY = Path(__file__).parents[1] / "examples" / "machines" / "gantry.py"
Make = Callable[[int], tuple[Any, Mapping[str, Any]]]


@pytest.fixture(autouse=True)
def forgotten() -> Iterator[None]:
    """What the gantry makes known is forgotten."""
    with apart():
        yield


def of_world(make: Callable[[int], World]) -> Make:
    def made(seed: int) -> tuple[Any, Mapping[str, Any]]:
        world = make(seed)
        return world.robot, world.columns

    return made


def gantry(seed: int) -> tuple[Any, Mapping[str, Any]]:
    run = run_of("gantry", seed, {"play_mm": 0.03, "growth": 2e-5})
    return load_machine(GANTRY), {name: run[name].to_numpy() for name in run.columns}


def arm(seed: int) -> tuple[Any, Mapping[str, Any]]:
    with tempfile.TemporaryDirectory() as folder:
        made = arm_in(Path(folder))
    run = simulated(made, seed, 60, **hidden_at(made, "drift", 4.0, seed)).to_frame()
    return made, {name: run[name].to_numpy() for name in run.columns}


#: Worlds in which the order, the time and the temperature matter.
MADE: dict[str, Make] = {
    "delta, backlash and growth": of_world(
        lambda seed: delta_world(seed, {"backlash": 3 * NOISE_UM, "thermal_growth": 3 * NOISE_UM}, repeats=2)
    ),
    "delta, a slip": of_world(lambda seed: delta_world(seed, {"slip": 3 * NOISE_UM}, repeats=2)),
    "spherical, filmed late": of_world(lambda seed: spherical_world(seed, scaled={"camera_delay": 3})),
    "spherical, drift": of_world(lambda seed: spherical_world(seed, scaled={"drift": 3})),
    "gantry, play and growth": gantry,
    "arm, drift": arm,
}


#: The slow ones besides: what else hangs on time.
MORE = ("arm, drift", "delta, a slip", "spherical, drift", "delta, backlash and growth", "gantry, play and growth")


@pytest.mark.parametrize("seed", [1, *slow(2)])
@pytest.mark.parametrize("name", [pytest.param(n, marks=[pytest.mark.slow] * (n in MORE)) for n in MADE])
def test_how_a_table_is_written_decides_nothing(name: str, seed: int) -> None:
    """Catches an answer that hangs on the order of rows, the start of a clock, the numbers of poses, or a unit: each
    world is asked as it is and as another laboratory writes it."""
    robot, columns = MADE[name](seed)
    plain = sk.diagnose(robot, sk.from_frame(columns))
    table, names = written_otherwise(columns, seed)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", sk.SherkitWarning)
        other = sk.diagnose(robot, sk.from_frame(table, columns=names))
    assert other.verdict == plain.verdict
    # which of a tie comes first may hang on the last digits of the machine that adds them up
    tied = {one for tie in (*plain.indistinguishable, *other.indistinguishable) for one in tie}
    assert set(other.effects) ^ set(plain.effects) <= tied
    if set(other.effects) != set(plain.effects):
        return
    assert set(map(frozenset, other.indistinguishable)) == set(map(frozenset, plain.indistinguishable))
    errors = [[step.error.rms for step in d.steps] for d in (plain, other)]
    assert errors[1] == pytest.approx(errors[0], rel=0.01)
