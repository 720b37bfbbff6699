"""``sherkit export``: what sherkit found, as files of other programs."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click
import numpy as np
from click.shell_completion import CompletionItem

from ..base.extensions import EXPORTERS, declared
from ..base.figures import listed
from ..data.files import write_whole
from ..data.tables import write_table
from ..errors import CalibrationError
from ..robots.c_header import calibration_header, covariates_needed
from ..robots.calibrated import load_calibration, tables_of
from ..robots.compensation import axis_table, grid_table
from . import output
from .file_kinds import COMPENSATION, HEADER, TABLE, FileKind
from .groups import OpenGroup
from .machine_file import calibration_at, own_way_of
from .paths import InputFile, OutputFile

#: What is written where no word stands first: the rows of a run.
_ROWS = "rows"
#: Words that are called as the file is that they write.
_ALSO = {"kinematics.yaml": "kinematics"}


class _Exporters(OpenGroup):
    """Those below, and those that are declared (``sherkit.exporters``). What begins with none of their names is the
    file of a run."""

    declared = EXPORTERS
    called = "word and no run file "

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        asks_for_help = bool(args) and args[0] in ctx.help_option_names
        return super().parse_args(ctx, args if asks_for_help else self.worded(args))

    def worded(self, args: list[str]) -> list[str]:
        """What was typed, the word first: options may stand before it. What begins with no word names a run."""
        words = {*self.commands, *declared(EXPORTERS)}
        args = [_ALSO.get(one, one) for one in args]
        first = args[0] if args else ""
        if first in words and (first != _ROWS or not Path(first).is_file()):
            return args
        if first.startswith("-"):
            behind = {k + 1 for k, one in enumerate(args) if one in ("-o", "--output")}
            at = next((k for k, one in enumerate(args) if one in words and k not in behind), None)
            if at is not None:
                return [args[at], *args[:at], *args[at + 1 :]]
        return [_ROWS, *args] if args and _ROWS in words and _may_be_file(args) else args

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        return [*super().shell_complete(ctx, incomplete), CompletionItem(incomplete, type="file")]


def _may_be_file(args: list[str]) -> bool:
    """Whether there is a name with an ending or a file of that name: what is neither is a word that nobody knows."""
    named = [one for one in args if not one.startswith("-")]
    return args[0].startswith("-") or any(Path(one).suffix or Path(one).exists() for one in named[:1])


@click.group("export", cls=_Exporters)
def export() -> None:
    """Write what sherkit found as a file of another program: sherkit export WORD FILE -o OUTPUT.

    Without a word the rows of a run are written, also while it is being measured: sherkit export RUN_FILE -o run.csv.
    """


def written_as(*kinds: FileKind) -> Callable[[Any], Any]:
    """The option that says where an exporter writes."""
    return click.option(
        "-o", "--output", "destination", required=True, type=OutputFile(*kinds), help="The file to write."
    )


@export.command("c")
@click.argument("calibration", type=InputFile())
@written_as(HEADER)
def c(calibration: Path, destination: Path) -> None:
    """A calibrated robot, or a flexible tool, as a C header."""
    if (own_way := own_way_of(calibration, "export")) is not None:
        own_way(destination)
        return
    if "machine" in tables_of(calibration).get("robot", {}):
        raise CalibrationError(
            f"{calibration}: is of a machine that is a function of Python, and runs there alone; sherkit export comp "
            "and sherkit export grid write tables for its controller"
        )
    made = load_calibration(calibration)
    write_whole(destination, calibration_header(made, calibration.name))
    output.say(f"{destination} written; cc loop.c $(sherkit c --cflags --libs) links it (sherkit c --example FOLDER)")
    if needed := covariates_needed(made):
        columns = dict.fromkeys(one for needs in needed.values() for one in needs)
        follow = "follows" if len(needed) == 1 else "follow"
        output.say(
            f"{listed(needed)} {follow} {listed(columns)}: give covariates at every call, or &robot_now for what "
            "Python takes where it is told none; with NULL every call ends with SHERKIT_NOT_FINITE"
        )


@export.command("comp")
@click.argument("machine", type=InputFile())
@click.argument("calibration", type=InputFile())
@click.option("--axis", help="Which one, by its column, as x_mm.")
@click.option("--points", type=click.IntRange(2), default=101, show_default=True, help="Of the axis.")
@written_as(COMPENSATION)
def comp(machine: Path, calibration: Path, axis: str | None, points: int, destination: Path) -> None:
    """Compensation of an axis of MACHINE (its .py), for LinuxCNC."""
    made = calibration_at(calibration, machine)
    table = axis_table(made, axis, points)
    write_whole(destination, table.linuxcnc())
    unit = table.unit
    output.say(
        f"{destination}: {table.axis}, {len(table.nominal)} lines, {table.largest:.4g} {unit} at most, "
        f"{table.reversal:.4g} {unit} between both directions; {table.left:.2g} {unit} are left between lines",
        destination,
    )
    output.say(f"LinuxCNC reads it with COMP_FILE = {destination.name} and COMP_FILE_TYPE = 0, in {unit}",
               destination)  # fmt: skip
    if table.others:
        output.say(f"it cannot hold {listed(table.others)}: a grid can, as far as that depends on the axes alone",
                   destination)  # fmt: skip


@export.command("grid")
@click.argument("machine", type=InputFile())
@click.argument("calibration", type=InputFile())
@click.option("--points", type=click.IntRange(2), default=11, show_default=True, help="Of each axis.")
@written_as(TABLE)
def grid(machine: Path, calibration: Path, points: int, destination: Path) -> None:
    """Compensation of all axes of MACHINE (its .py), as a table of points."""
    made = calibration_at(calibration, machine)
    table = grid_table(made, points)
    write_table(table, destination)
    add = np.abs(table.select(name for name in table.columns if name.startswith("add_")).drop_nulls().to_numpy())
    gone = table.height - len(add)
    largest = add.max(axis=0, initial=0.0).tolist()
    most = ", ".join(f"{size:.4g} of {name}" for name, size in zip(made.model.layouts[0].joints, largest, strict=True))
    output.say(f"{destination}: {table.height} points, adding {most} at most", destination)
    if gone:
        output.say(f"{gone} points are empty: beyond what its axes reach", destination)
