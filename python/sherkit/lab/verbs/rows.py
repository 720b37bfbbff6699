"""``sherkit export RUN_FILE``: the rows of a run."""

from __future__ import annotations

from pathlib import Path

import click

from ...cli import output
from ...cli.export import written_as
from ...cli.file_kinds import TABLE
from ...cli.groups import examples
from ...cli.paths import InputFile


@click.command("rows", epilog=examples("sherkit export experiment.sqlite -o run.csv"))
@click.argument("run", type=InputFile())
@written_as(TABLE)
def rows(run: Path, destination: Path) -> None:
    """The rows of a RUN file, also while it is measured (the word may be left out)."""
    from ..experiment import export_run  # needs SQLite

    output.say(f"{export_run(run, destination)} rows written to {destination}", destination)
