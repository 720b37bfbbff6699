"""A verb: how square the axes are."""

from __future__ import annotations

from pathlib import Path

import click

import sherkit as sk


@click.command("squareness")
@click.argument("robot", type=click.Path(path_type=Path))
@click.argument("run", type=click.Path(path_type=Path))
def squareness(robot: Path, run: Path) -> None:
    """How far the axes of an XY stage are from a right angle."""
    fit = sk.identify(robot, run)
    k = [p.name for p in fit.parameters].index("lean")
    click.echo(f"the axes lean by {1e6 * fit.values[k]:.1f} ± {1e6 * fit.std[k]:.1f} µrad")
