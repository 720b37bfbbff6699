"""A robot that chooses its poses itself, through the real drivers and emulated instruments; killed, and resumed."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import polars as pl
import pytest

import sherkit as sk
from running import command
from sherkit.cli import main
from sherkit.errors import ExperimentError
from sherkit.lab.experiment import AdaptiveRun, Plan, PlanStep, RunFile, export_run, load_experiment
from sherkit.lab.laboratory import RunningLaboratory, load_laboratory
from sherkit.lab.verbs.lab import write_files

COMMAND = [sys.executable, "-c", "from sherkit.cli import main; main()", "measure", "adaptive.toml"]
UNTIL = ["--until", "diagnosed"]


@pytest.fixture
def folder(tmp_path: Path) -> Iterator[Path]:
    """The files of the demo, its laboratory running twenty times as fast."""
    write_files(tmp_path, repeats=1, time_scale=200.0)
    with RunningLaboratory(load_laboratory(tmp_path / "lab.toml")) as lab:
        lab.write_ports(tmp_path / "ports.json")
        yield tmp_path


def said(folder: Path, *more: str) -> str:
    """What the command prints, to its end."""
    code, out, wrong = command(folder, "measure", "adaptive.toml", *UNTIL, *more)
    assert code == 0, wrong
    return out


@pytest.mark.slow
def test_it_stops_by_itself_and_goes_on_after_a_kill(folder: Path) -> None:
    """Catches a run that knows less after it was killed in the middle, rows that are read twice or lost, and rows that
    do not say why they were driven."""
    whole = said(folder, "-o", "whole.sqlite")
    assert "explained: rail_lean" in whole
    assert re.search(r"\d+ readings: undecided; the odds that something is missing are ", whole)
    process = subprocess.Popen([*COMMAND, *UNTIL], cwd=folder, stdout=subprocess.PIPE, text=True)
    before = []
    while len(before) < 15:
        if (line := process.stdout.readline()).startswith("stored "):
            before.append(int(line.split()[1].rstrip(":")))
    process.send_signal(signal.SIGKILL)
    process.communicate()
    after = said(folder, "--resume")
    again = [int(n) for n in re.findall(r"^stored (\d+):", after, re.MULTILINE)]
    assert not set(before) & set(again)
    assert "explained: rail_lean" in after
    with RunFile.open(folder / "adaptive.sqlite") as file:
        frame = file.frame()
    assert frame["step"].to_list() == list(range(frame.height))
    assert set(frame["reason"]) <= {"start", "all", "confirm", "explore", "time", "again"} | {
        reason for reason in frame["reason"] if "|" in reason
    }
    export_run(folder / "adaptive.sqlite", folder / "adaptive.csv")
    assert "reason" in pl.read_csv(folder / "adaptive.csv").columns
    assert sk.diagnose(folder / "robot.toml", folder / "adaptive.csv").effects == ("rail_lean",)


def test_what_is_wrong_with_the_file_is_said(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches a run without poses that drives nowhere, and a loop that nobody asked for."""
    for typed, says in (
        (["local.toml", *UNTIL], "[adaptive] is missing"),
        (["adaptive.toml"], "has no [plan]: let the robot choose its poses with --until diagnosed"),
    ):
        with pytest.raises(SystemExit) as ended:
            main(["measure", str(folder / typed[0]), *typed[1:]])
        assert ended.value.code == 1
        assert says in " ".join(capsys.readouterr().err.split())
    text = (folder / "adaptive.toml").read_text()
    for wrong, says in (
        ("budget = 0", "budget: expected a whole number of at least 1"),
        ("[adaptive.box]\nx_mm = [3.0]", "2 numbers"),
        ("[adaptive.box]\nw_mm = [3.0, 4.0]", "w_mm"),
        ("[adaptive.box]\nx_mm = [300.0, 400.0]", "outside of the robot's own workspace"),
        ("level = -1.0", "level"),
    ):
        (folder / "wrong.toml").write_text(text.replace("budget = 200\n", "").replace("required_um = 20.0", wrong))
        with pytest.raises(ExperimentError, match=re.escape(says)):
            load_experiment(folder / "wrong.toml")


def test_a_plan_that_grows_keeps_why() -> None:
    """Catches reasons and moments that a run file loses, and steps that another plan had."""
    plan = Plan((PlanStep(1, 1, (1.0, 2.0), (), 0.0, "start"),), (0.0, 0.0))
    grown = plan.longer([PlanStep(2, 1, (3.0, 4.0), (), 17.5, "rail_lean|backlash")])
    assert Plan.from_json(grown.to_json()) == grown
    assert grown.steps[:1] == plan.steps


def test_the_first_poses_are_those_of_the_loop(folder: Path) -> None:
    """Catches an experiment whose plan is not what its loop asks for."""
    chosen = load_experiment(folder / "adaptive.toml")
    assert chosen.adaptive is not None
    made = AdaptiveRun(chosen.robot, chosen.adaptive)
    assert made.first() == chosen.plan
    assert {step.reason for step in chosen.plan} == {"start"}
