"""Every verb reads a run under the names that the robot's file gives, a check weeks later those of the calibration."""

from __future__ import annotations

from pathlib import Path

import polars as pl
import pytest

import sherkit as sk
from running import command
from sherkit.cli.demo import EXAMPLE
from sherkit.robots.delta import VirtualDelta, paper_whole

OWN = {"q1_mm": "Achse A", "q2_mm": "Achse B", "q3_mm": "Achse C", "x_mm": "Pos X", "y_mm": "Pos Y", "z_mm": "Pos Z"}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A robot file that names its columns, and two runs of it."""
    made = tmp_path_factory.mktemp("own")
    sk.save_robot(EXAMPLE, made / "robot.toml")
    names = "\n".join(f'{ours} = "{theirs}"' for ours, theirs in OWN.items())
    (made / "robot.toml").write_text(f"{(made / 'robot.toml').read_text()}\n[columns]\n{names}\n", encoding="utf-8")
    for seed, name in ((1, "before.csv"), (2, "after.csv")):
        run = VirtualDelta.draw(EXAMPLE, 1, noise_mm=0.005).measure(paper_whole()[::8], repeats=2, seed=seed)
        run.to_frame().rename(OWN).write_csv(made / name)
    return made


@pytest.mark.filterwarnings("default")
@pytest.mark.parametrize(
    "line",
    ["diagnose robot.toml before.csv", "compare robot.toml before.csv after.csv",
     "history robot.toml before.csv after.csv", "calibrate robot.toml before.csv -o made.toml"],
)  # fmt: skip
def test_a_verb_reads_the_names_of_the_robot_file(line: str, folder: Path) -> None:
    """Catches a verb that reads the robot's file and forgets its table of names: compare and history refused all runs
    of such robots, with a sentence that asked for the table that is there."""
    code, _, wrong = command(folder, *line.split())
    assert code == 0, wrong


@pytest.mark.filterwarnings("default")
def test_a_check_weeks_later_reads_the_names_that_the_calibration_keeps(folder: Path) -> None:
    """Catches a calibration that forgets under which names its robot is read: every check was refused."""
    made = sk.calibrate(folder / "robot.toml", folder / "before.csv").calibration
    made.save(folder / "kept.toml")
    assert sk.load_calibration(folder / "kept.toml").columns == OWN
    assert command(folder, "verify", "kept.toml", "after.csv")[0] == 0
    assert sk.verify(made, folder / "after.csv").verdict == "valid"
    ours = pl.read_csv(folder / "after.csv").rename({theirs: name for name, theirs in OWN.items()})
    assert sk.verify(made, ours).verdict == "valid"
