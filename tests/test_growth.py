"""Parts of a delta that grow with temperature, hidden by the second simulator: named, and told from the whole."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

import sherkit as sk
from running import slow
from second_simulator import NOMINAL_CONFIG, Robot, draw_geometric_errors, grid, make_plan, simulate
from strategies import EXAMPLE

ROBOT = Robot.from_dict(NOMINAL_CONFIG)
#: 1/°C: steel has 1.2e-5, aluminium 2.4e-5.
PARTS = {
    "rods": {"link_growth": [3e-5, 0.0, 0.0]},
    "frame": {"link_growth": [0.0, 3e-5, 0.0]},
    "rails": {"link_growth": [0.0, 0.0, 3e-5]},
    "whole": {"thermal_growth": [9e-5]},
}


def columns(part: str, seed: int) -> dict[str, np.ndarray[Any, Any]]:
    """A run in a shop that is 16 to 24 °C warm, in random order, noise 3 µm."""
    rng = np.random.default_rng(1000 + seed)
    plan = make_plan(ROBOT, grid(20.0, 8, (-20.0, 0.0, 20.0)), repeats=2, order="shuffled", seed=seed)
    time = plan["time_s"] / plan["time_s"].max()
    plan["temperature_c"] = 20.0 + 4.0 * np.sin(5.0 * time) + rng.normal(0.0, 0.1, len(time))
    return simulate(ROBOT, plan, draw_geometric_errors(rng), PARTS[part], noise=3e-3, seed=seed)


def check(part: str, seed: int) -> None:
    d = sk.diagnose(sk.identify(EXAMPLE, sk.from_frame(columns(part, seed))))
    name = next(iter(PARTS[part]))
    assert d.effects == (name,), d.headline
    effect = next(e for e in d.fit.model.effects if e.name == name)
    place = d.fit.model.owns(effect)
    assert (np.abs(d.fit.values[place] - PARTS[part][name]) < 4 * d.fit.std[place]).all()


@pytest.mark.parametrize("part", ["rods", "whole", *slow("frame", "rails")])
def test_the_part_that_grows_is_named(part: str) -> None:
    """Catches growth of the whole about a base that lies a tenth of a metre beside its drawing in the place of a part
    that grows; a shape that stays beside the effect that contains it (a division by zero once); values that are not
    those planted."""
    check(part, 2)


@pytest.mark.parametrize("room", [True, *slow(False)])
@pytest.mark.parametrize("part", ["rods", *slow("whole", "frame")])
def test_growth_goes_with_the_thermometer_of_its_part(part: str, room: bool, tmp_path: Path) -> None:
    """Catches rods that follow the motors' thermometer while the room's is called temperature_c, taken for a stand of
    the instrument that does; and advice that leads nowhere."""
    run = pl.DataFrame(columns(part, 3)).rename({"temperature_c": "motor_c"})
    if room:
        run = run.with_columns(temperature_c=20.0 + 0.5 * np.cos(np.arange(len(run)) / 40.0))
    found = sk.diagnose(EXAMPLE, run)
    name = next(iter(PARTS[part]))
    assert found.effects == (name,), found.headline
    (advice,) = (said for said in found.answer.sure if f"{name} goes with motor_c" in said)
    # what it says leads to the same
    sk.save_robot(EXAMPLE, tmp_path / "robot.toml")
    toml = (tmp_path / "robot.toml").read_text(encoding="utf-8")
    (tmp_path / "robot.toml").write_text(f"{advice[advice.index('columns =') :].rstrip('.')}\n{toml}", encoding="utf-8")
    run.write_csv(tmp_path / "run.csv")
    again = sk.diagnose(tmp_path / "robot.toml", tmp_path / "run.csv")
    assert again.effects == (name,)
    assert not any("goes with" in said for said in again.answer.sure)
    # whoever does not read it is told again
    if room:
        with pytest.warns(sk.SherkitWarning, match="the robot follows motor_c"):
            assert sk.calibrate(EXAMPLE, run, effects=[name])


@pytest.mark.filterwarnings("ignore:.*do not run in a control loop")
def test_what_a_diagnosis_names_a_calibration_takes() -> None:
    """Catches an effect of a thermometer that sk.diagnose names and sk.calibrate and sk.identify do not know."""
    run = pl.DataFrame(columns("rods", 4)).with_columns(mast_c=20.0 + pl.int_range(pl.len()) % 7)
    named = sk.identify(EXAMPLE, run, effects=["thermal_shift_mast"]).model.effects
    assert [one.name for one in named] == ["thermal_shift_mast"]
    made = sk.calibrate(EXAMPLE, run, effects=["thermal_shift_mast"], correction="none")
    assert made.calibration is not None


@pytest.mark.slow
@pytest.mark.parametrize("part", PARTS)
@pytest.mark.parametrize("seed", range(100, 120))
def test_the_part_that_grows_is_named_on_other_runs(part: str, seed: int) -> None:
    check(part, seed)
