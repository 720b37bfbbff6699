"""``sherkit demo``: the paper's two experiments on a virtual robot, calibrated."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import click
import numpy as np
from rich.table import Table

from ..calibration import Result, calibrate
from ..data import read_measurements
from ..diagnosis import Diagnosis
from ..errors import SherkitError
from ..model.robot_file import save_robot
from ..robots import delta
from ..robots.calibrated import Calibration
from ..robots.delta import paper
from ..robots.delta.robot import Delta, paper_local, paper_whole
from ..robots.delta.virtual import VirtualDelta
from ..study import Study
from . import demo_story, diagnosis_tables, output, reporting, tables

EXAMPLE: Delta = delta.KIND.example


@click.command()
@click.option("-o", "--output", "folder", type=click.Path(path_type=Path), default=Path("demo"), show_default=True)
@click.option("--seed", type=click.IntRange(min=0), default=6, show_default=True)
@click.option("--tables", "with_tables", is_flag=True, help="Print the paper's tables and the diagnosis too.")
def demo(folder: Path, seed: int, with_tables: bool) -> None:
    """Simulate the paper's experiments, calibrate, find the effect that is missing, and add it."""
    folder.mkdir(parents=True, exist_ok=True)
    save_robot(EXAMPLE, folder / "robot.toml")
    robot = EXAMPLE
    # rails that lean by some milliradians: what the geometric model does not know
    virtual = VirtualDelta.draw(robot, seed, rail_lean_rad=8e-3, noise_mm=0.005)
    with output.steps(21) as step:
        step("simulating the whole workspace")
        virtual.measure(paper_whole(), repeats=5, seed=seed).save(folder / "whole.csv")
        step("simulating the region of interest")
        virtual.measure(paper_local(), repeats=5, seed=seed + 1).save(folder / "local.csv")
        whole = read_measurements(folder / "whole.csv")
        result = calibrate(robot, whole, read_measurements(folder / "local.csv"), step=step)
        study = Study(robot, whole)
        found = study.diagnose(step=step)
        for name in found.effects:
            study.add(name)
        calibration = study.calibration()
        calibration.save(folder / "calibrated.toml")
        report = _report(folder, study, found, calibration, result, step)
    missed = _misses(virtual, robot, calibration)
    demo_story.story(study, found, missed, len(paper_whole()), folder, report)
    if with_tables:
        _tables(result, found, study, calibration)


def _tables(result: Result, found: Diagnosis, study: Study, calibration: Calibration) -> None:
    """Those of the paper, and of the diagnosis."""
    output.out.rule("The paper's tables")
    output.out.print(
        "SIMULATION: the geometry is an example; the paper's figures (dim) are of its own robot, so sizes may be "
        "compared and values may not.\n"
    )
    tables.result(result, demo=True)
    output.out.rule("What is missing?")
    diagnosis_tables.diagnosis(found)
    output.out.rule("With it in the model")
    output.out.print(_history(study))
    tables.accuracy(calibration)


def _report(
    folder: Path, study: Study, found: Diagnosis, calibration: Calibration, result: Result,
    step: Callable[[str], None],
) -> Path | None:  # fmt: skip
    """Writes the report where what draws is installed."""
    try:
        reporting.require_view()
    except SherkitError as error:
        output.warn(f"no report was written: {error}")
        return None
    step("writing the report")
    path = folder / "report.html"
    sources = [folder / name for name in ("robot.toml", "whole.csv", "local.csv")]
    title = "The paper's two experiments on a virtual delta robot"
    reporting.write(
        path, title, study, found, sources, calibration=calibration, result=result, simulated=True,
        printed=paper.TABLE_I,
    )  # fmt: skip
    return path


def _history(study: Study) -> Table:
    """The fall of the error, step by step and axis by axis."""
    axes = study.data.layout.coordinates
    made = output.table(
        "Error on poses held out, µm RMS", "step", "in 3-D", "95 % within", *(a.rsplit("_", 1)[0] for a in axes)
    )
    for one in study.history:
        each = [one.error.by_reading[a] for a in axes]
        made.add_row(one.action, *[f"{value:.1f}" for value in (one.error.rms, one.error.p95, *each)])
    return made


def _misses(virtual: VirtualDelta, robot: Delta, calibration: Calibration) -> tuple[float, float]:
    """RMS distance, µm, of where the virtual robot really goes from where it was sent: as drawn, and calibrated."""
    targets = paper_whole()
    home = virtual.true_reading(robot.inverse([0.0, 0.0, 0.0]))
    out = []
    for joints in (robot.inverse_batch(targets), calibration.inverse_batch(targets)):
        there = virtual.true_reading(joints.require("pose")) - home
        out.append(1e3 * float(np.sqrt(np.mean(((there - targets) ** 2).sum(axis=1)))))
    return out[0], out[1]
