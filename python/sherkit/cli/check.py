"""``sherkit check``: all that is wrong with a file of measurements, at once."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path

import click
from rich.markup import escape

from ..data import Measurements
from ..data.called import in_toml
from ..data.file_check import FileCheck, check_file, said_of
from ..fit.constant_columns import outside_limits
from ..model.kinds import kind_of, model_of
from ..model.robot_file import columns_of
from ..robots.machine import is_machine, robot_at
from . import output
from .file_kinds import TABLE
from .machine_file import own_way_of
from .next_command import completed
from .output import columns_option, out, table
from .paths import InputFile, OutputFile


@click.command()
@click.argument("run", type=InputFile())
@click.argument("robot", type=InputFile(), required=False)
@click.option("--write", "destination", type=OutputFile(TABLE), metavar="CLEAN.CSV",
              help="Write the rows, all mended, under the names and in the units that sherkit reads.")  # fmt: skip
@click.option("--json", "as_json", is_flag=True, help="Print JSON for programs instead of tables.")
@columns_option
def check(run: Path, robot: Path | None, destination: Path | None, as_json: bool) -> None:
    """List all that is wrong with the file RUN, with its lines and cures, and what its columns could be.

    ROBOT is the file of the machine that was measured: it says which columns there may be. Ends with 1 where the file
    cannot be read as it is, or what is asked for cannot be written.
    """
    if robot is not None and (own_way := own_way_of(robot, "check")) is not None:
        own_way(run, destination, as_json=as_json)
        return
    if robot is not None:
        nominal, _ = robot_at(robot)
        columns = getattr(nominal, "columns", {}) if is_machine(robot) else columns_of(robot)
        layouts = kind_of(nominal).layouts
        whose = f"{robot} ({nominal.kind})"

        def as_read(data: Measurements) -> Measurements:
            return data.read_as(layouts[0]) if is_machine(robot) else data

        def require(data: Measurements) -> None:
            model_of(nominal).require_own(as_read(data))

        found = check_file(run, columns=columns, layouts=layouts, whose=whose, require=require)
        beyond = [] if found.data is None else list(outside_limits(model_of(nominal), as_read(found.data)))
    else:
        found, beyond = check_file(run), []
    written = destination is not None and found.data is not None and found.is_mended
    if written and destination is not None and found.data is not None:
        found.data.save(destination)
    if as_json:
        output.print_json({**found.to_json(), "outside_limits": beyond})
    else:
        _tell(found)
        for said in beyond:
            out.print(f"[yellow]{escape(said)}.[/]")
        _next(found, robot, destination if written else None)
    if not (written if destination is not None else found.is_good):
        what = (
            "not all of it can be mended, nothing was written" if destination is not None else "cannot be used as it is"
        )
        output.fail(f"{run}: {what}")
        sys.exit(1)


def _tell(found: FileCheck) -> None:
    """What is wrong, with its cure; what each column is read as."""
    out.print(f"[bold]{escape(said_of(found))}[/]")
    if found.wrong:
        made = table("What is wrong", "", "what", "cure", texts=True)
        for one in found.wrong:
            made.add_row("mended" if one.mended else "[bold red]by hand[/]", escape(str(one)), escape(one.cure))
        out.print(made)
    if found.columns or found.further or found.unused:
        made = table("Columns", "of the file", "read as", "", texts=True)
        for ours, theirs in found.columns.items():
            made.add_row(escape(theirs), ours, "")
        for name in found.further:
            could = found.unused.get(name, "")
            made.add_row(escape(name), "a covariate", f"could be {could}" if could else "")
        for name, could in found.unused.items():
            if name not in found.further:
                made.add_row(escape(name), "[bold]not used[/]", f"could be {could}" if could else "holds no numbers")
        out.print(made)
    if found.refused:
        out.print(f"[bold red]{escape(found.refused)}[/]")


def _next(found: FileCheck, robot: Path | None, written: Path | None) -> None:
    """What to do next."""
    machine = shlex.quote(str(robot)) if robot is not None else "ROBOT"
    if written is not None:
        output.say(f"{written}: {len(found.data or ())} rows, none lost")
        # what was written has names of its own
        out.print(f"Next:\n     sherkit diagnose {machine} {shlex.quote(str(written))}", soft_wrap=True, markup=False)
    elif found.is_good:
        asked = completed(f"sherkit diagnose {machine} {shlex.quote(found.source)}")
        out.print(f"Next:\n     {asked}", soft_wrap=True, markup=False)
    elif found.is_mended:
        if found.unsaid and not found.wrong:
            out.print("The names can stay: write at the beginning of the robot file")
            out.print(f"     {in_toml(found.unsaid)}", soft_wrap=True, markup=False)
        asked = f"sherkit check {shlex.quote(found.source)} {'' if robot is None else machine + ' '}--write clean.csv"
        out.print(f"All of it can be mended:\n     {completed(asked)}", soft_wrap=True, markup=False)
    else:
        out.print("What is to be done by hand comes first; then ask again.")
