"""Whole stories: an independent simulator's files in, the command in between, positions on the simulator out."""

from __future__ import annotations

import json
import re
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from running import command, slow
from second_simulator import (
    Noise,
    Robot,
    draw_geometric_errors,
    local_grid,
    make_plan,
    scaled_effect,
    simulate,
    truth,
    whole_grid,
    write_csv,
    write_robot_toml,
)
from sherkit import load_robot
from sherkit.robots.calibrated import Calibration

Floats = NDArray[np.float64]

# as the command's own process has it
pytestmark = pytest.mark.filterwarnings("always::sherkit.SherkitWarning")
ROBOT = Robot.from_dict()
NOISE_UM = 5.0


def sherkit(folder: Path, *arguments: str, code: int = 0) -> subprocess.CompletedProcess[str]:
    """Runs the command in ``folder``; it must end with ``code``."""
    done = subprocess.CompletedProcess(arguments, *command(folder, *arguments))
    assert done.returncode == code, done.stderr
    return done


def errors(seed: int) -> dict[str, float]:
    """What the workshop did to the robot."""
    return draw_geometric_errors(np.random.default_rng(seed))


def run(points: Floats, seed: int, noise: Noise | float = 1e-3 * NOISE_UM, effects: Any = None) -> dict[str, Any]:
    """A run of the simulated robot over ``points``, each twice."""
    plan = make_plan(ROBOT, points, repeats=2, order="shuffled", seed=seed)
    return simulate(ROBOT, plan, errors(seed), effects, noise=noise, seed=seed)


def arrived(joints_mm: Floats, seed: int, effects: Any = None) -> Floats:
    """Where the simulated robot truly goes with these joint readings, mm, in a room at rest."""
    still = {"time_s": 0.0, "temperature_c": 20.0, "humidity_pct": 45.0}
    columns = {name: np.full(len(joints_mm), value) for name, value in still.items()}
    return truth(ROBOT, columns | {f"q{k + 1}_mm": joints_mm[:, k] for k in range(3)}, errors(seed), effects)


def misses_um(model: Any, targets_mm: Floats, seed: int, effects: Any = None) -> Floats:
    """How far from each target the robot ends where ``model`` commands it."""
    joints = model.inverse_batch(targets_mm).require()
    return 1e3 * np.linalg.norm(arrived(joints, seed, effects) - targets_mm, axis=1)


def targets(half_width_mm: float, count: int = 300) -> Floats:
    """Positions at random in a cube; none is a measured one."""
    return np.random.default_rng(99).uniform(-half_width_mm, half_width_mm, (count, 3))


@pytest.mark.parametrize("seed", [0, *slow(1)])
def test_a_wrongly_built_robot_is_brought_on_target(seed: int, tmp_path: Path) -> None:
    """Catches any link of the chain that sherkit's own tests have wrong on both sides: geometry, datum, files, sign."""
    write_robot_toml(tmp_path / "robot.toml")
    write_csv(run(whole_grid(), seed), tmp_path / "run.csv")
    sherkit(tmp_path, "calibrate", "robot.toml", "run.csv", "-o", "calibrated.toml")
    calibrated = Calibration.load(tmp_path / "calibrated.toml")
    where = targets(18.0)
    assert misses_um(load_robot(tmp_path / "robot.toml"), where, seed).min() > 300.0
    assert misses_um(calibrated, where, seed).max() < NOISE_UM
    # and the accuracy that it claims holds: 95 of 100 readings within the radius, ± 4 standard deviations
    joints = calibrated.inverse_batch(where).require()
    reading = arrived(joints, seed) + np.random.default_rng(seed).normal(size=where.shape) * 1e-3 * NOISE_UM
    inside = np.linalg.norm(reading - where, axis=1) <= calibrated.predicted_accuracies(where).visit_mm
    assert 0.90 < inside.mean() < 1.0


@pytest.mark.slow
@pytest.mark.parametrize("seed", [2])
def test_leaning_rails_are_corrected_in_the_region_of_interest(seed: int, tmp_path: Path) -> None:
    """Catches a correction with the wrong sign, or evaluated elsewhere than it was fitted, or a local model unused."""
    effects = scaled_effect(
        ROBOT, make_plan(ROBOT, whole_grid()), "rail_lean", np.random.default_rng(seed), 0.06, errors=errors(seed)
    )
    write_robot_toml(tmp_path / "robot.toml")
    write_csv(run(whole_grid(), seed, effects=effects), tmp_path / "whole.csv")
    write_csv(run(local_grid(), seed, effects=effects), tmp_path / "local.csv")
    sherkit(tmp_path, "calibrate", "robot.toml", "whole.csv", "--local", "local.csv", "-o", "both.toml")
    sherkit(tmp_path, "calibrate", "robot.toml", "whole.csv", "--correction", "none", "-o", "geometry.toml")
    where = targets(9.0)
    assert misses_um(load_robot(tmp_path / "robot.toml"), where, seed, effects).min() > 300.0
    geometry, both = (Calibration.load(tmp_path / f"{name}.toml") for name in ("geometry", "both"))
    left = misses_um(geometry, where, seed, effects)
    assert np.sqrt(np.mean(left**2)) > 4 * NOISE_UM
    assert misses_um(both, where, seed, effects).max() < 3 * NOISE_UM


@pytest.mark.slow
def test_a_run_with_faults_is_mended_by_what_sherkit_says(tmp_path: Path) -> None:
    """Catches messages that lead nowhere: each step here uses nothing but what the step before has said."""
    seed = 3
    write_robot_toml(tmp_path / "robot.toml")
    columns = run(whole_grid(), seed)
    columns["y_mm"][49] += 0.4  # a knock at the table
    write_csv(columns, tmp_path / "run.csv")
    text = (tmp_path / "run.csv").read_text().splitlines()
    cells = text[700].split(",")
    cells[7] = "nan"  # a laser that lost its target
    text[700] = ",".join(cells)
    european = "\r\n".join(["# Versuch 7"] + [line.replace(",", ";").replace(".", ",") for line in text]) + "\r\n"
    path = tmp_path / "run.csv"
    path.write_text(european, encoding="utf-8-sig", newline="")

    said = sherkit(tmp_path, "calibrate", "robot.toml", "run.csv", code=1).stderr
    place = re.search(r"line (\d+), column 'y_mm': nan is not a measurement; .* leave the cell empty", said)
    lines = path.read_text(encoding="utf-8-sig").splitlines()
    assert "nan" in lines[int(place[1]) - 1]
    lines[int(place[1]) - 1] = lines[int(place[1]) - 1].replace("nan", "")
    path.write_text("\n".join(lines) + "\n")

    suspects = json.loads(sherkit(tmp_path, "calibrate", "robot.toml", "run.csv", "--json").stdout)["whole"]["outliers"]
    assert suspects == [52]  # row 49 from 0, below a note and the header
    exclude = ",".join(str(line) for line in suspects)
    sherkit(tmp_path, "calibrate", "robot.toml", "run.csv", "--exclude", exclude, "-o", "calibrated.toml")
    assert misses_um(Calibration.load(tmp_path / "calibrated.toml"), targets(18.0), seed).max() < NOISE_UM


@pytest.mark.slow
def test_outliers_do_not_decide_under_a_robust_loss(tmp_path: Path) -> None:
    """Catches a robust loss that is robust in name only: one row in fifty is wrong by 0.1 to 0.25 mm, and used."""
    seed = 4
    write_robot_toml(tmp_path / "robot.toml")
    noise = Noise(sigma_mm=1e-3 * NOISE_UM, outlier_fraction=0.02)
    write_csv(run(whole_grid(), seed, noise), tmp_path / "run.csv")
    for loss in ("linear", "tukey"):
        sherkit(
            tmp_path, "calibrate", "robot.toml", "run.csv", "--loss", loss, "--correction", "none", "--with-outliers",
            "-o", f"{loss}.toml",
        )  # fmt: skip
    where = targets(18.0)
    linear, tukey = (misses_um(Calibration.load(tmp_path / f"{n}.toml"), where, seed) for n in ("linear", "tukey"))
    assert tukey.max() < NOISE_UM
    assert np.sqrt(np.mean(tukey**2)) < 0.5 * np.sqrt(np.mean(linear**2))


def test_heights_alone_teach_heights_and_say_what_they_do_not(tmp_path: Path) -> None:
    """Catches a missing reading taken for zero, and parameters given out as known that no height can tell."""
    seed = 5
    write_robot_toml(tmp_path / "robot.toml")
    write_csv(run(whole_grid(), seed), tmp_path / "run.csv")
    lines = [line.split(",") for line in (tmp_path / "run.csv").read_text().splitlines()]
    for cells in lines[1:]:
        cells[6] = cells[7] = ""
    (tmp_path / "run.csv").write_text("\n".join(",".join(cells) for cells in lines) + "\n")
    done = sherkit(tmp_path, "calibrate", "robot.toml", "run.csv", "-o", "calibrated.toml", "--json")
    said = json.loads(done.stdout)["whole"]
    assert set(said["rms_um"]["after"]) == {"z"}
    assert said["rms_um"]["before"]["z"] > 100.0
    assert {"sensor_shift_x alone", "sensor_shift_y alone"} <= {d["text"] for d in said["unobserved"]}
    assert said["rank"] == said["parameters_free"] - len(said["unobserved"])
    calibrated = Calibration.load(tmp_path / "calibrated.toml")
    joints = load_robot(tmp_path / "robot.toml").inverse_batch(targets(18.0)).require()
    height = calibrated.forward_batch(joints).require()[:, 2]
    assert np.abs(height - arrived(joints, seed)[:, 2]).max() < 1e-3 * NOISE_UM
