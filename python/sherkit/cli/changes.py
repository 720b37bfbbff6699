"""``sherkit compare``, ``history`` and ``verify``: what has changed of a machine; ``fleet``: many built alike."""

from __future__ import annotations

import glob
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar

import click
from rich.markup import escape

from ..base.figures import CALIBRATED, in_people_units, listed
from ..base.workers import processes
from ..changes import Comparison, History
from ..changes import compare as compare_runs
from ..changes import history as history_of
from ..changes import verify as verify_run
from ..changes.runs import moved_in_words
from ..data.tables import names_given
from ..errors import SherkitError
from ..fleets import FEWEST, Fleet, fleet
from ..model.effect import load_effects
from ..robots.machine import robot_at
from . import output
from .file_kinds import PAGE
from .machine_file import calibration_at, machine_option
from .output import columns_option, out, table
from .paths import InputFile, OutputFile

Told = TypeVar("Told", Comparison, History)

#: What ``--fail-if-invalid`` ends with.
INVALID = 3


@click.command()
@click.argument("robot", type=InputFile())
@click.argument("before", type=InputFile())
@click.argument("after", type=InputFile(), nargs=-1, required=True, metavar="AFTER [MORE]...")
@click.option("--effect", "added", multiple=True, help="An effect that is in the model of all runs; default: those "
              "that a diagnosis of BEFORE names.")  # fmt: skip
@click.option("--json", "as_json", is_flag=True, help="Print JSON for programs instead of tables.")
@click.option("--report", type=OutputFile(PAGE), help="Write a page with before and after beside each other.")
@columns_option
def compare(
    robot: Path, before: Path, after: tuple[Path, ...], added: tuple[str, ...], as_json: bool, report: Path | None
) -> None:
    """Say what has changed of ROBOT (TOML) between the measurements BEFORE and AFTER.

    Poses, noise and order may differ, and the sensor may stand elsewhere.
    """
    machine = _machine(robot, report)
    found = compare_runs(machine, [before, *after], effects=added or None)
    _tell(found, _say, (robot, before, *after), as_json, report)


def _machine(robot: Path, report: Path | None) -> Any:
    """The robot as its runs are read by; a report that cannot be drawn is refused before anything is computed."""
    if report is not None:
        output.require_view()
    return robot_at(robot)[1]


def _tell(
    found: Told, say: Callable[..., None], files: Sequence[Path], as_json: bool, report: Path | None
) -> None:  # fmt: skip
    """What was found: a page, and JSON or sentences; what is calibrated again is the latest run."""
    latest = (files[0], files[-1])
    if report is not None:
        from ..report.pages import write_comparison, write_history

        draw: Callable[..., None] = write_comparison if isinstance(found, Comparison) else write_history
        draw(report, found, output.made_by(files, latest))
    if as_json:
        output.print_json(found.to_json())
        return
    say(found, *latest)
    if report is not None:
        output.say(f"\nthe report is in {report}")


def _say(found: Comparison, *files: Path) -> None:
    output.show(found.answer, *files)
    if found.parameters:
        moved = table("What has changed", "parameter", "change", "since run")
        for one in found.parameters:
            moved.add_row(one.name, one.by, str(one.since + 1))
        out.print(moved)
    for run, stand in found.stand.items():
        turned = moved_in_words(stand)
        which, _, source = run.partition(": ")
        beside = ", as far as a robot that has not changed says; part of it may be what has" if found.changed else ""
        output.say(f"the sensor of run {which} ({source}) stands elsewhere than that of the first: {turned}{beside}")
    for run, count in found.aside.items():
        if count:
            output.say(f"{count} rows of run {run} stand apart from all others and were left out")
    if found.next_poses:
        proposed = table("Poses that would tell", *found.next_poses[0])
        for pose in found.next_poses:
            proposed.add_row(*[f"{value:.4g}" for value in pose.values()])
        out.print(proposed)


@click.command()
@click.argument("robot", type=InputFile())
@click.argument("runs", type=InputFile(), nargs=-1, required=True, metavar="RUN MORE...")
@click.option("--dates", default="", help="When each run was taken (2026-03-31), separated by commas.")
@click.option("--effect", "added", multiple=True, help="An effect that is in the model of all runs.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON for programs instead of tables.")
@click.option("--report", type=OutputFile(PAGE), help="Write a page with the course of what has changed.")
@columns_option
def history(
    robot: Path, runs: tuple[Path, ...], dates: str, added: tuple[str, ...], as_json: bool, report: Path | None
) -> None:
    """Say what has changed of ROBOT (TOML) in the course of RUN and MORE: steps, wear, what goes with the season."""
    machine = _machine(robot, report)
    given = [one.strip() for one in dates.split(",") if one.strip()]
    found = history_of(machine, list(runs), dates=given, effects=added or None)
    _tell(found, _say_course, (robot, *runs), as_json, report)


def _say_course(found: History, *files: Path) -> None:
    output.show(found.answer, *files)
    made = table("Runs", "run", "date", "rows", f"error {found.unit}",
                 note="by the model of the first, from where each run's sensor stands")  # fmt: skip
    for run in found.runs:
        error = "left out" if run["error"] is None else f"{run['error']:.4g}"
        made.add_row(run["run"], run["date"], str(run["rows"]), error)
    out.print(made)


@click.command()
@click.argument("calibration", type=InputFile())
@click.argument("run", type=InputFile())
@click.option("--json", "as_json", is_flag=True, help="Print JSON for programs instead of sentences.")
@click.option("--fail-if-invalid", is_flag=True, help=f"End with the exit code {INVALID} where it no longer holds.")
@machine_option
@columns_option
@click.pass_context
def verify(
    ctx: click.Context, calibration: Path, run: Path, as_json: bool, fail_if_invalid: bool, machine: Path | None
) -> None:
    """Say whether CALIBRATION (TOML) still holds, by the measurements RUN: a dozen poses, as plan --verify lists."""
    found = verify_run(calibration_at(calibration, machine), run)
    if as_json:
        output.print_json(found.to_json())
    else:
        output.show(found.answer, calibration, run)
    if fail_if_invalid and found.valid is False:
        ctx.exit(INVALID)


# -- Many machines built alike ----------------------------------------------------------------------------------------


@click.command("fleet")
@click.argument("runs", type=InputFile(words=r".*[*?\[].*", folders=True), nargs=-1, required=True, metavar="RUN...")
@click.option("--robot", type=InputFile(), required=True, help="The drawing that all are built from.")
@click.option("--effect", "added", multiple=True, help="An effect that is in the model of all already.")
@click.option("--effects", "files", type=InputFile(), multiple=True, help="Python file of your effects.")
@click.option("--workers", type=click.IntRange(min=1), help="Processes at a time; default: one for each core.")
@click.option("--level", type=click.FloatRange(0.0005, 0.2), default=0.01, show_default=True, help="Of each test.")
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Rules folds and flips.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON for programs instead of tables.")
@columns_option
def fleet_command(
    runs: tuple[Path | str, ...], robot: Path, added: tuple[str, ...], files: tuple[Path, ...], workers: int | None,
    level: float, seed: int, as_json: bool,
) -> None:  # fmt: skip
    """Diagnose every RUN (CSV or Parquet) of machines built alike: what they share, and who stands out.

    A pattern such as runs/*.csv may stand for many. A run that cannot be used is a line that says why.
    """
    own = [effect for path in files for effect in load_effects(path)]
    paths = [path for run in map(str, runs) for path in (sorted(glob.glob(run)) if _is_pattern(run) else [run])]
    if not paths:
        raise SherkitError(f"{' '.join(map(str, runs))}: no such file")
    _, machine = robot_at(robot)
    count = min(workers or os.cpu_count() or 1, len(paths))
    with output.steps(len(paths) + 1) as step:

        def told(done: int, total: int) -> None:
            step(f"{done} of {total} machines")

        if count == 1 or names_given():  # other processes do not know them
            found = fleet(paths, machine, effects=added, own=own, level=level, seed=seed, progress=told)
        else:
            with processes(count) as pool:
                found = fleet(paths, machine, effects=added, own=own, level=level, seed=seed, executor=pool,
                              progress=told)  # fmt: skip
    if as_json:
        output.print_json(found.to_json())
    else:
        _print(found)
    if not found.diagnosed:
        raise SherkitError(f"none of the {len(paths)} runs could be used; each says why above")


def _is_pattern(run: str) -> bool:
    """Whether a name stands for files: where no shell has done it, as on Windows."""
    return not os.path.exists(run) and any(mark in run for mark in "*?[")


def _print(found: Fleet) -> None:
    unit = next((m.unit for m in found.diagnosed), "")
    table = output.table(
        "Machines", "run", "rows", "verdict", "missing", f"{CALIBRATED}, {unit}", "left", "noise",
        note="errors: RMS of rows on poses held out, in 3-D for what is read in space",
    )  # fmt: skip
    for m in found.machines:
        if m.failed is None:
            errors = ("–" if v is None else f"{v:.3g}" for v in (m.before, m.after, m.noise))
            table.add_row(escape(m.run), str(m.rows), m.verdict, escape(", ".join(m.effects)), *errors)
        else:
            table.add_row(escape(m.run), "–", "failed", "", "", "", "")
    output.out.print(table)
    for m in found.machines:
        if m.failed is not None:
            output.say(f"failed: {m.failed}")
        for remark in m.remarks:
            output.warn(remark if remark.startswith(m.run) else f"{m.run}: {remark}")
    many = len(found.diagnosed)
    for name, runs in found.shared.items():
        few = f": {listed(runs)}" if 2 * len(runs) < many else ""
        output.say(f"{name} is missing in {len(runs)} of {many}{few}")
    if many < FEWEST:
        output.say(f"who stands out is told from {FEWEST} machines on")
        return
    for one in found.stands_out:
        output.say(str(one))
    if not found.stands_out:
        output.say("no machine stands out in its numbers")
    columns = ("", "median", "from machine to machine", "unit", "machines")
    spread = output.table("What the machines have in common", *columns)
    for c in found.common:
        shown, times = in_people_units(c.unit)
        spread.add_row(escape(c.name), f"{times * c.median:+.4g}", f"± {times * c.spread:.2g}", shown, str(c.machines))
    output.out.print(spread)
