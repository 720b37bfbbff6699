"""``sherkit fleet``: a table of verdicts over many machines of one robot."""

from __future__ import annotations

import concurrent.futures as futures
import glob
import multiprocessing
import os
from pathlib import Path

import click
from rich.markup import escape

from ..base.names import CALIBRATED
from ..errors import SherkitError
from ..fleets import FEWEST, Fleet, fleet
from ..model.effect import load_effects
from . import output


@click.command("fleet")
@click.argument("runs", nargs=-1, required=True, metavar="RUN...")
@click.option("--robot", type=click.Path(path_type=Path), required=True, help="The drawing that all are built from.")
@click.option("--effect", "added", multiple=True, help="An effect that is in the model of all already.")
@click.option("--effects", "files", type=click.Path(path_type=Path), multiple=True, help="Python file of your effects.")
@click.option("--workers", type=click.IntRange(min=1), help="Processes at a time; default: one for each core.")
@click.option("--level", type=click.FloatRange(0.0005, 0.2), default=0.01, show_default=True, help="Of each test.")
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Rules folds and flips.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON for programs instead of tables.")
def fleet_command(
    runs: tuple[str, ...], robot: Path, added: tuple[str, ...], files: tuple[Path, ...], workers: int | None,
    level: float, seed: int, as_json: bool,
) -> None:  # fmt: skip
    """Diagnose every RUN (CSV or Parquet) of machines built alike: what they share, and who stands out.

    A pattern such as runs/*.csv may stand for many. A run that cannot be used is a line that says why.
    """
    own = [effect for path in files for effect in load_effects(path)]
    paths = [path for run in runs for path in (sorted(glob.glob(run)) if _is_pattern(run) else [run])]
    if not paths:
        raise SherkitError(f"{' '.join(runs)}: no such file")
    count = min(workers or os.cpu_count() or 1, len(paths))
    with output.steps(len(paths) + 1) as step:

        def told(done: int, total: int) -> None:
            step(f"{done} of {total} machines")

        if count == 1:
            found = fleet(paths, robot, effects=added, own=own, level=level, seed=seed, progress=told)
        else:
            # fresh processes: a copy of one that has threads can hang
            with futures.ProcessPoolExecutor(count, multiprocessing.get_context("spawn")) as pool:
                found = fleet(paths, robot, effects=added, own=own, level=level, seed=seed, executor=pool,
                              progress=told)  # fmt: skip
    if as_json:
        output.print_json(found.to_json())
        return
    _print(found)


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
        output.say(f"{name} is missing in {len(runs)} of {many}")
    if many < FEWEST:
        output.say(f"who stands out is told from {FEWEST} machines on")
        return
    for one in found.stands_out:
        output.say(str(one))
    if not found.stands_out:
        output.say("no machine stands out")
    columns = ("", "median", "from machine to machine", "unit", "machines")
    spread = output.table("What the machines have in common", *columns)
    for c in found.common:
        spread.add_row(escape(c.name), f"{c.median:+.4g}", f"± {c.spread:.2g}", c.unit, str(c.machines))
    output.out.print(spread)
