"""``sherkit import``: files of other programs."""

from __future__ import annotations

from pathlib import Path

import click

from ..model.robot_file import save_robot
from ..robots.delta.klipper import import_klipper
from . import output


@click.group("import")
def import_group() -> None:
    """Turn files of other programs into robot.toml and run.csv."""


@import_group.command("klipper")
@click.argument("config", type=click.Path(path_type=Path))
@click.option("-o", "--output", "folder", type=click.Path(path_type=Path), required=True, help="Folder to write to.")
def klipper(config: Path, folder: Path) -> None:
    """A linear delta printer: its printer.cfg with a SAVE_CONFIG block."""
    found = import_klipper(config)
    folder.mkdir(parents=True, exist_ok=True)
    save_robot(found.robot, folder / "robot.toml")
    found.measurements.save(folder / "run.csv")
    output.say(f"{folder / 'robot.toml'}: the printer's own saved calibration")
    output.say(f"{folder / 'run.csv'}: {len(found.measurements)} rows (heights, bed mesh, distances)")
