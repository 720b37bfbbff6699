"""An importer: the log of the stage's controller, a line ``X=… Y=… DX=… DY=…`` each, as a run."""

from __future__ import annotations

import re
from pathlib import Path

import click

import sherkit as sk
from sherkit.errors import MeasurementError

_LINE = re.compile(r"X=(\S+) Y=(\S+) DX=(\S+) DY=(\S+)")
_COLUMNS = ("axis_1_mm", "axis_2_mm", "x_mm", "y_mm")


@click.command("xy-log")
@click.argument("log", type=click.Path(path_type=Path))
@click.option("-o", "--output", "destination", type=click.Path(path_type=Path), required=True, help="The CSV to write.")
def xy_log(log: Path, destination: Path) -> None:
    """The log of an XY stage's controller, as a run.csv."""
    rows = []
    for number, line in enumerate(log.read_text().splitlines(), start=1):
        found = _LINE.fullmatch(line.strip())
        if found is None:
            raise MeasurementError(f"{log}: line {number}: expected X=… Y=… DX=… DY=…")
        rows.append([float(word) for word in found.groups()])
    columns = dict(zip(_COLUMNS, zip(*rows, strict=True), strict=True))
    sk.from_frame(columns).save(destination)
    click.echo(f"{destination}: {len(rows)} rows")
