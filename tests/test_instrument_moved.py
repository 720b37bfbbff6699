"""An instrument that moved in the course of a run: said of it, with how far and at which line, and of no robot."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from scipy.spatial.transform import Rotation

import sherkit as sk
from running import command
from second_simulator import (
    NOMINAL_CONFIG,
    Noise,
    Robot,
    draw_geometric_errors,
    draw_pose,
    grid,
    make_plan,
    scaled_effect,
    simulate,
    write_robot_toml,
)

NOISE_MM = 2e-3


def knocked(seed: int, shift_mm: float, turn_deg: float, beside: str = "") -> tuple[pl.DataFrame, dict[str, float]]:
    """A run of a delta whose tracker stands anywhere and is knocked, its rows in any order; what is true of it.
    ``beside`` is an effect that leaves five times the noise."""
    rng = np.random.default_rng([seed, 53])
    robot = Robot.from_dict(NOMINAL_CONFIG)
    plan = make_plan(robot, grid(20.0, 5, (-20.0, 0.0, 20.0)), 2, "shuffled", seed)
    errors, pose = draw_geometric_errors(np.random.default_rng([seed, 1])), draw_pose(rng)
    noise = Noise(sigma_mm=NOISE_MM)
    plain = simulate(robot, plan, errors, {"sensor_pose": pose}, noise, seed=seed)
    time = np.asarray(plain["time_s"])
    when = float(np.sort(time)[rng.integers(40, 110)])
    along = [one / np.linalg.norm(one) for one in rng.normal(size=(2, 3))]
    step = np.array([*np.deg2rad(turn_deg) * along[0], *shift_mm * along[1]])
    stands = {"sensor_pose": pose}
    hidden = scaled_effect(robot, plan, beside, rng, 5 * NOISE_MM, errors=errors, beside=stands) if beside else {}
    effects = hidden | {"sensor_pose": pose, "sensor_slip": np.array([*step, when - 1e-6])}
    table = pl.DataFrame(simulate(robot, plan, errors, effects, noise, seed=seed))
    by = Rotation.from_rotvec(pose[:3] + step[:3]) * Rotation.from_rotvec(pose[:3]).inv()
    rows = rng.permutation(len(table))
    line = int(np.flatnonzero(time[rows] == when)[0]) + 2
    return table[rows], {"turn_deg": float(np.rad2deg(by.magnitude())), "shift_mm": shift_mm, "line": line}


def diagnosed(folder: Path, table: pl.DataFrame) -> sk.diagnosis.Diagnosis:
    """From files, as a person has them."""
    write_robot_toml(folder / "robot.toml", NOMINAL_CONFIG)
    table.write_csv(folder / "run.csv")
    return sk.diagnose(folder / "robot.toml", folder / "run.csv")


@pytest.mark.parametrize(
    ("seed", "shift_mm", "turn_deg"),
    [(0, 0.12, 0.02), *(pytest.param(*one, marks=pytest.mark.slow) for one in ((1, 0.03, 0.05), (2, 8.0, 0.8)))],
)
def test_how_far_and_at_which_line(seed: int, shift_mm: float, turn_deg: float, tmp_path: Path) -> None:
    """Catches a turn that is counted from the robot's axes, a row by its place in time and not in the file, and a
    motion that is too large for a knock and therefore none. Within four deviations of the other program's."""
    table, true = knocked(seed, shift_mm, turn_deg)
    d = diagnosed(tmp_path, table)
    assert d.effects == ("sensor_slip",)
    assert d.verdict == "explained"
    cause = d.finding("cause")
    assert cause.answer.startswith("The robot's model lacks nothing; the instrument moved by ")
    assert f" at line {true['line']} " in cause.answer
    # six to seven of a hundred poses fix a turn by the noise over their reach; a shift by the noise
    assert abs(cause.numbers["turn_deg"] - true["turn_deg"]) < 4e-3
    assert abs(cause.numbers["shift_mm"] - true["shift_mm"]) < 2e-3 + 2e-3 * shift_mm
    assert d.headline == "explained: the instrument moved (sensor_slip)"
    assert "Of the instrument: clamp the stand" in d.finding("brings").to_do


@pytest.mark.slow
def test_it_leads_before_a_slip_of_the_robot(tmp_path: Path) -> None:
    """Catches a robot that is blamed where its instrument was shifted: both leave the same, and the tie is told."""
    table, true = knocked(3, 0.12, 0.0)
    d = diagnosed(tmp_path, table)
    assert d.effects == ("sensor_slip",)
    assert d.indistinguishable == (("sensor_slip", "slip"),)
    assert "without a turn" in d.finding("cause").answer
    assert "cannot tell it from slip" in d.finding("cause").answer
    assert f"at line {true['line']} " in d.finding("cause").answer
    code, told, _ = command(tmp_path, "diagnose", "robot.toml", "run.csv")
    assert code == 0
    assert "model lacks slip" not in told


def test_beside_an_effect_of_the_robot(tmp_path: Path) -> None:
    """Catches a motion that hides what the robot's model lacks, and a sentence that says it lacks nothing."""
    table, true = knocked(4, 0.2, 0.02, beside="rail_lean")
    d = diagnosed(tmp_path, table)
    assert set(d.effects) == {"sensor_slip", "rail_lean"}
    cause = d.finding("cause").answer
    assert cause.startswith("The instrument moved by ")
    assert f"at line {true['line']} " in cause
    assert "Beside that, the model lacks rail_lean." in cause


def said_by(fit: Any) -> str:
    """What is said of the instrument where its motion is in the model already."""
    return next(one.answer for one in sk.diagnose(fit).findings if one.answer.startswith("the instrument moved"))


def test_in_the_model_already(tmp_path: Path) -> None:
    """Catches a motion that is said no more once it is in the model."""
    table, true = knocked(0, 0.12, 0.02)
    d = diagnosed(tmp_path, table)
    assert f"at line {true['line']} " in said_by(d.fit)
