"""``sherkit demo``: the paper's two experiments on a virtual robot, calibrated, and its story."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from textwrap import fill

import click
import numpy as np
from rich.markup import escape
from rich.table import Table

from ..base.figures import NOMINAL, number
from ..calibration import Result, calibrate
from ..data import read_measurements
from ..diagnosis import Diagnosis
from ..errors import SherkitError
from ..model.kinds import required_um
from ..model.robot_file import save_robot
from ..model.sensor_pose import HELD, SensorPose
from ..robots import delta
from ..robots.calibrated import Calibration
from ..robots.delta import paper
from ..robots.delta.robot import Delta, paper_local, paper_whole
from ..robots.delta.virtual import VirtualDelta
from ..study import Study
from . import output
from .calibrate import print_accuracy, print_result
from .diagnose import print_diagnosis
from .file_kinds import CALIBRATION, PAGE, ROBOT, TABLE
from .output import out, say
from .paths import OutputFolder

EXAMPLE: Delta = delta.KIND.example
#: The paper's sensors stand along the robot's own axes.
_PAPER = replace(EXAMPLE, sensor_pose=SensorPose(turn_sd_deg=HELD))
_FOLDER = OutputFolder(
    {"robot.toml": ROBOT, "whole.csv": TABLE, "local.csv": TABLE, "calibrated.toml": CALIBRATION, "report.html": PAGE}
)


@click.command()
@click.option("-o", "--output", "folder", type=_FOLDER, default=Path("demo"), show_default=True)
@click.option("--seed", type=click.IntRange(min=0), default=6, show_default=True)
@click.option("--tables", "with_tables", is_flag=True, help="Print the paper's tables and the diagnosis too.")
def demo(folder: Path, seed: int, with_tables: bool) -> None:
    """Simulate the paper's experiments, calibrate, find the effect that is missing, and add it."""
    folder.mkdir(parents=True, exist_ok=True)
    save_robot(_PAPER, folder / "robot.toml")
    robot = _PAPER
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
    story(study, found, missed, len(paper_whole()), folder, report)
    if with_tables:
        _tables(result, found, study, calibration)


def _tables(result: Result, found: Diagnosis, study: Study, calibration: Calibration) -> None:
    """Those of the paper, and of the diagnosis."""
    output.out.rule("The paper's tables")
    output.out.print(
        "SIMULATION: the geometry is an example; the paper's figures (dim) are of its own robot, so sizes may be "
        "compared and values may not.\n"
    )
    print_result(result, demo=True)
    output.out.rule("What is missing?")
    print_diagnosis(found)
    output.out.rule("With it in the model")
    output.out.print(_history(study))
    print_accuracy(calibration)


def _report(
    folder: Path, study: Study, found: Diagnosis, calibration: Calibration, result: Result,
    step: Callable[[str], None],
) -> Path | None:  # fmt: skip
    """Writes the report where what draws is installed."""
    try:
        output.require_view()
    except SherkitError as error:
        output.warn(f"no report was written: {error}")
        return None
    step("writing the report")
    path = folder / "report.html"
    sources = [folder / name for name in ("robot.toml", "whole.csv", "local.csv")]
    output.write_report(
        path, study, found, sources, calibration=calibration, result=result, simulated=True,
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


# -- The story as it is told ------------------------------------------------------------------------------------------

_WIDTH, _BAR, _NAME = 78, 34, 30


def story(
    study: Study, found: Diagnosis, missed_um: tuple[float, float], targets: int, folder: Path, report: Path | None
) -> None:
    """Prints it. ``missed_um`` are distances (RMS) from the ``targets`` commanded places, as drawn and calibrated."""
    out.print("[bold]SIMULATION.[/] A virtual delta robot, built a little wrong, with rails that lean,")
    out.print(f"is measured at {targets} places by an instrument with a noise of 5 µm.\n")
    unit = study.data.layout.unit
    noise, first = found.noise_size, study.history[0].error
    needed = required_um(study.robot)
    asked = f"; the target is {needed:g} {unit}" if needed else ""
    _head(1, "What calibrating the geometry leaves")
    _tell(
        f"{number(first.rms)} {unit} RMS {first.in_words} at places it was not fitted to, 95 % within "
        f"{number(first.p95)}; noise alone is {number(noise)}{asked}."
    )
    _head(2, "Which effect is missing")
    _tell(found.headline[:1].upper() + found.headline[1:] + ".")
    for name in found.effects:
        effect = study.model.known_effects[name]
        _tell(f"{effect.physics} {effect.remedy}")
    others = [c for c in found.candidates if c.effect not in found.effects]
    if found.effects and others:
        _tell(f"The next best, {others[0].effect}, would leave {number(others[0].held_out_rms)} {unit}.")
    _head(3, "The fall of the error")
    nominal = study.history[0].fit
    steps = [] if nominal is None else [(NOMINAL, nominal.nominal_error.rms)]
    steps += [(step.action, step.error.rms) for step in study.history]
    for name, value in (*steps, ("noise", noise)):
        _bar(name, value, steps[0][1], unit)
    _head(4, f"Sent to {targets} places, the robot misses them by")
    for name, value in zip((NOMINAL, "through calibrated.toml"), missed_um, strict=True):
        _bar(name, value, missed_um[0], "µm")
    _tell("(RMS in 3-D of where it stands, without the instrument's noise: a reading there adds that)")
    _head(5, "What to open next")
    _next(folder, report)


def _next(folder: Path, report: Path | None) -> None:
    offers = [] if report is None else [(str(report), "all this to look at, in a browser")]
    offers += [
        (f"sherkit app {folder}/robot.toml {folder}/whole.csv", "add effects yourself"),
        ("sherkit demo --tables", "the paper's tables beside these"),
        (
            f"sherkit calibrate {folder}/robot.toml {folder}/whole.csv --local {folder}/local.csv",
            "what a lab would run",
        ),
    ]
    for what, why in offers:
        say(f"  {what}" if len(what) + len(why) + 6 > _WIDTH else f"  {what}   {why}")


def _head(count: int, title: str) -> None:
    out.print(f"[bold]{count}. {escape(title)}[/]", soft_wrap=True)


def _tell(sentence: str) -> None:
    say(fill(sentence, _WIDTH, initial_indent="   ", subsequent_indent="   ", break_long_words=False))


def _bar(name: str, value: float, whole: float, unit: str) -> None:
    """A line whose bar is as long as its value is of the whole."""
    length = max(round(_BAR * min(value / whole, 1.0)), 1) if whole > 0 else 1
    say(f"   {name:<{_NAME}} {'█' * length} {number(value)} {unit}")
