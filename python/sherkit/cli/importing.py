"""``sherkit import``: files of other programs."""

from __future__ import annotations

from pathlib import Path

import click

from ..model.robot_file import save_robot
from ..robots.delta.klipper import import_klipper
from ..robots.serial import Serial
from ..robots.serial.dh import CONVENTIONS, import_dh
from ..robots.serial.urdf import import_urdf
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


_ROBOT_FILE = click.option(
    "-o", "--output", "destination", type=click.Path(path_type=Path), required=True, help="The robot file to write."
)


@import_group.command("urdf")
@click.argument("urdf", type=click.Path(path_type=Path))
@click.option("--base", help="Link at which the arm begins; left out, the root of the file.")
@click.option("--tip", help="Link whose origin is the target; left out, the only end that the file has.")
@_ROBOT_FILE
def urdf(urdf: Path, base: str | None, tip: str | None, destination: Path) -> None:
    """An arm: the joints between two links of a URDF, as a robot.toml."""
    _write_arm(import_urdf(urdf, base, tip), destination)


@import_group.command("dh")
@click.argument("table", type=click.Path(path_type=Path))
@click.option("--convention", type=click.Choice(CONVENTIONS), default=CONVENTIONS[0], show_default=True)
@_ROBOT_FILE
def dh(table: Path, convention: str, destination: Path) -> None:
    """An arm: a CSV table of Denavit-Hartenberg or Hayati parameters (d_mm, a_mm, alpha_deg …), as a robot.toml."""
    _write_arm(import_dh(table, convention), destination)


def _write_arm(robot: Serial, destination: Path) -> None:
    save_robot(robot, destination)
    weighed = sum(joint.mass_kg is not None for joint in robot.joints)
    known = f"masses of {weighed}" if weighed else "no masses: links count as sticks under gravity"
    output.say(f"{destination}: {len(robot.joints)} joints, {known}")
    output.say(f"a run of it has the columns {', '.join((*robot.layout.joints, *robot.layout.coordinates))}")
