"""A page of every verb that writes one, of worlds that hide something: what tests read and ``docs/draw_screens.py``
draws."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import polars as pl

import sherkit as sk
from changed_worlds import DeltaPair
from driven_worlds import DrivenDelta
from running import command, thin
from second_printer.trials import Trial
from sherkit.cli.demo import EXAMPLE
from sherkit.model.sensor_pose import HELD, SensorPose
from sherkit.report.page import Made
from sherkit.report.pages import write_adaptive
from sherkit.robots.delta.robot import paper_whole
from sherkit.robots.tool.tool import FlexibleTool
from sherkit.robots.tool.virtual import VirtualTool
from test_arm_counted import arm_in


def _by(folder: Path, line: str) -> str:
    """What a command that ends well prints. Raises AssertionError with what it said else."""
    code, out, err = command(folder, *line.split())
    assert code == 0, f"sherkit {line}: {err}"
    return out


def _demo(folder: Path) -> None:
    """The demo's robot, and every third pose of its run."""
    sk.save_robot(replace(EXAMPLE, sensor_pose=SensorPose(turn_sd_deg=HELD)), folder / "robot.toml")
    leaning = sk.delta.VirtualDelta.draw(sk.load_robot(folder / "robot.toml"), 6, rail_lean_rad=8e-3, noise_mm=0.005)
    leaning.measure(paper_whole(), repeats=5, seed=6).save(folder / "whole.csv")
    thin(folder / "whole.csv", 3)


def _diagnose(folder: Path) -> str:
    _demo(folder)
    return _by(folder, "diagnose robot.toml whole.csv --report page.html")


def _calibrate(folder: Path) -> str:
    _demo(folder)
    return _by(folder, "calibrate robot.toml whole.csv --effect rail_lean -o new.toml --report page.html")


def _arm(folder: Path) -> str:
    sk.save_robot(replace(arm_in(folder), required_um=100.0), folder / "arm.toml")
    _by(folder, "simulate arm.toml -o run.csv --yield-mrad 0.6 --repeats 2 --order shuffled --seed 4")
    return _by(folder, "diagnose arm.toml run.csv --report page.html")


def runs_of_a_pair(folder: Path) -> DeltaPair:
    """A delta of which one foot was moved between two runs."""
    world = DeltaPair(3, ("base_angle_2",), 4.0)
    sk.save_robot(world.robot, folder / "robot.toml")
    for k, run in enumerate(world.runs):
        pl.DataFrame(run).write_csv(folder / f"run_{k + 1}.csv")
    return world


def _compare(folder: Path) -> str:
    runs_of_a_pair(folder)
    return _by(folder, "compare robot.toml run_1.csv run_2.csv --report page.html")


def _history(folder: Path) -> str:
    world = runs_of_a_pair(folder)
    moved = {"base_angle_2": world.true["base_angle_2"]}
    for k in (3, 4):
        pl.DataFrame(world.run_with(moved, 7 + k)).write_csv(folder / f"run_{k}.csv")
    dates = "2026-01-10,2026-02-09,2026-03-11,2026-04-12"
    return _by(folder, f"history robot.toml run_1.csv run_2.csv run_3.csv run_4.csv --dates {dates} --report page.html")


def _measure(folder: Path) -> str:
    world = DrivenDelta(1, ("rail_lean",), 5.0)
    loop = sk.Adaptive(world.robot, budget=150, span_min=60.0, required_um=20)
    while not loop.done:
        asked = loop.ask()
        loop.tell([told | {"reason": row["reason"]} for told, row in zip(world.read(asked), asked, strict=True)])
    write_adaptive(folder / "page.html", loop, Made("run"))
    return "\n".join([loop.why, *loop.told()])


def tables_of_a_tool(folder: Path) -> None:
    VirtualTool(FlexibleTool()).bench().save(folder / "bench.csv")
    there = VirtualTool(FlexibleTool(), bias_nm=(0.004, -0.002, -0.002, 0.001, 0.003, -0.004), camera_warp_mm=0.0)
    there = there.changed(
        camera_rotation_rad=(0.3, -0.2, 1.0), camera_translation_mm=(50.0, -20.0, 300.0), camera_delay_s=0.031
    )
    there.free_motion().save(folder / "free.csv")
    there.changed(camera_delay_s=0.051).run("vessels", seconds=30.0).save(folder / "run.csv")


def _tool(folder: Path) -> str:
    tables_of_a_tool(folder)
    return _by(folder, "tool bench.csv free.csv run.csv -o tool.toml --report page.html")


def _estimate(folder: Path) -> str:
    _tool(folder)
    return _by(folder, "estimate tool.toml run.csv --report page.html")


def _printer(folder: Path) -> str:
    Trial.of("frame twisted", 5, 1).write(folder, "klipper", (0.0, 60.0), 1)
    return _by(folder, "printer printer.cfg --plate at60=60 --report page.html")


def _effects(folder: Path) -> str:
    return _by(folder, "effects rail_lean --picture page.html")


#: By verb, what makes ``page.html`` in a folder and gives what the terminal says.
PAGES: dict[str, Callable[[Path], str]] = {
    "diagnose": _diagnose, "arm": _arm, "calibrate": _calibrate, "compare": _compare, "history": _history,
    "measure": _measure, "tool": _tool, "estimate": _estimate, "printer": _printer, "effects": _effects,
}  # fmt: skip
#: Those that propose a command.
COMMANDS = ("diagnose", "arm", "compare", "history", "measure", "tool", "printer")
