"""Whole stories from a plan to a diagnosis: the poses that ``sherkit plan`` writes are measured as they stand, in their
order, by simulators that share nothing with it, and what is read is filled into the same file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from running import command, slow
from second_simulator import NOMINAL_CONFIG, Robot, draw_geometric_errors, truth, write_robot_toml
from sherkit.cli.demo import EXAMPLE
from sherkit.model.robot_file import save_robot
from sherkit.planning.to_measure import poses_to_measure
from test_arm_counted import OwnArm, arm_in
from test_spherical_discovery import NOISE_PX, ROBOT, real_robot

NOISE_MM = 0.003


def filled(folder: Path, robot: str, read: Any, *more: str) -> pl.DataFrame:
    """The table that the command wrote, with what ``read`` makes of it."""
    code, shown, wrong = command(folder, "plan", robot, "-o", "poses.csv", "--pace-s", "20", *more)
    assert code == 0, wrong
    assert "each read twice" in shown
    frame = pl.read_csv(folder / "poses.csv")
    frame = frame.with_columns(pl.Series("time_s", 20.0 * np.arange(len(frame))))
    frame = frame.with_columns(**{name: pl.Series(name, v) for name, v in read(frame).items()})
    frame.write_csv(folder / "poses.csv")
    return frame


def diagnosed(folder: Path, robot: str) -> str:
    assert command(folder, "check", "poses.csv", robot)[0] == 0
    code, shown, wrong = command(folder, "diagnose", robot, "poses.csv")
    assert code == 0, wrong
    return shown.splitlines()[0]


@pytest.mark.parametrize("hidden", ["", *slow("rail_lean", "backlash")])
def test_a_delta_is_planned_measured_and_diagnosed(hidden: str, tmp_path: Path) -> None:
    """Catches poses that another verb does not read, that are out of reach, or that do not show what was promised."""
    robot = Robot.from_dict(NOMINAL_CONFIG)
    write_robot_toml(tmp_path / "robot.toml", NOMINAL_CONFIG)
    rng, sizes = np.random.default_rng(4), {"rail_lean": [2e-3] * 3 + [-2e-3] * 3, "backlash": [0.02] * 3}

    def read(frame: pl.DataFrame) -> dict[str, Any]:
        plan = {name: frame[name].to_numpy() for name in ("time_s", "q1_mm", "q2_mm", "q3_mm")}
        plan |= {"temperature_c": np.full(len(frame), 20.0), "humidity_pct": np.full(len(frame), 45.0)}
        seen = truth(robot, plan, draw_geometric_errors(rng), {hidden: sizes[hidden]} if hidden else None)
        return dict(zip(("x_mm", "y_mm", "z_mm"), (seen + NOISE_MM * rng.normal(size=seen.shape)).T, strict=True))

    filled(tmp_path, "robot.toml", read)
    assert diagnosed(tmp_path, "robot.toml").startswith(f"Verdict: explained: {hidden}" if hidden else "Verdict: adeq")


def test_a_sphere_is_planned_and_measured(tmp_path: Path) -> None:
    """Catches a plan that a spherical robot has to build a laboratory for, and a working mode that it leaves."""
    save_robot(replace(ROBOT, phi_deg=(60.0, 120.0), gamma_deg=(27.0, 60.0)), tmp_path / "robot.toml")
    rng = np.random.default_rng(2)

    def read(frame: pl.DataFrame) -> dict[str, Any]:
        seen = real_robot(2).pixels(frame.select("theta1_rad", "theta2_rad").to_numpy())
        return dict(zip(("u_px", "v_px"), (seen + NOISE_PX * rng.normal(size=seen.shape)).T, strict=True))

    filled(tmp_path, "robot.toml", read, "--noise-px", str(NOISE_PX))
    assert diagnosed(tmp_path, "robot.toml").startswith("Verdict: adequate")


def test_an_arm_is_planned_and_measured(tmp_path: Path) -> None:
    """Catches "experiments drive robots whose joints share one range": an arm had no plan at all."""
    arm = arm_in(tmp_path)
    save_robot(arm, tmp_path / "robot.toml")
    rng = np.random.default_rng(3)

    def read(frame: pl.DataFrame) -> dict[str, Any]:
        seen = OwnArm.made(3).places(frame.select(arm.layout.joints).to_numpy()) + np.array([20.0, -10.0, 15.0])
        return dict(zip(arm.layout.coordinates, (seen + 0.02 * rng.normal(size=seen.shape)).T, strict=True))

    filled(tmp_path, "robot.toml", read, "--poses", "60", "--noise-um", "20")
    assert diagnosed(tmp_path, "robot.toml").startswith("Verdict: adequate")


def test_chosen_poses_fill_the_workspace_and_are_read_in_another_order_each_time() -> None:
    """Catches a design that is all corners, in which no bump is seen; repeats that follow each other, in which time and
    lost motion hide; and one that is another one each time."""
    robot = EXAMPLE
    found = poses_to_measure(robot, 40, seed=1)
    assert found == poses_to_measure(robot, 40, seed=1)
    first, second = ([one["pose"] for one in half] for half in (found[:40], found[40:]))
    assert sorted(first) == sorted(second) == list(range(1, 41))
    assert first != second
    x = robot.forward_batch(np.array([[one[f"q{k}_mm"] for k in (1, 2, 3)] for one in found[:40]])).require()
    within = np.linalg.norm(x[:, :2], axis=1) < 0.6 * np.linalg.norm(x[:, :2], axis=1).max()
    assert within.sum() >= 10


def test_poses_of_ones_own_are_planned_with_and_bad_ones_are_refused(tmp_path: Path) -> None:
    """Catches a table of poses that is taken for an experiment, and a traceback where a cell is no number."""
    write_robot_toml(tmp_path / "robot.toml", NOMINAL_CONFIG)
    assert command(tmp_path, "plan", "robot.toml", "-o", "poses.csv", "--poses", "12")[0] == 0
    code, shown, _ = command(tmp_path, "plan", "robot.toml", "poses.csv")
    assert code == 0
    assert "needs time_s" in shown
    assert "needs time_s" not in command(tmp_path, "plan", "robot.toml", "poses.csv", "--pace-s", "5")[1]
    (tmp_path / "bad.csv").write_text("q1_mm,q2_mm,q3_mm\n1,2,x\n")
    assert "row 1, column 'q3_mm': expected a number" in command(tmp_path, "plan", "robot.toml", "bad.csv")[2]
    (tmp_path / "bad.csv").write_text("q1_mm,q2_mm\n1,2\n")
    assert "has no column 'q3_mm'" in command(tmp_path, "plan", "robot.toml", "bad.csv")[2]
    (tmp_path / "bad.csv").write_text("q1_mm,q2_mm,q3_mm\n")
    assert "has no row" in command(tmp_path, "plan", "robot.toml", "bad.csv")[2]
    assert "nosuch.csv: there is no such file" in command(tmp_path, "plan", "robot.toml", "nosuch.csv")[2]
    refused = command(tmp_path, "plan", "robot.toml", "poses.csv", "-o", "more.csv")
    assert refused[0] == 2
    assert "-o is of poses that are chosen here" in refused[2]
