"""``sherkit import``: files of other programs into sherkit's."""

from __future__ import annotations

from pathlib import Path

import click

from ..base.extensions import IMPORTERS
from ..data import Measurements, from_bluesky, from_rosbag
from ..errors import MeasurementError, RobotError
from ..model.robot_file import load_robot, save_robot
from ..robots.printer import import_duet, import_klipper, import_marlin
from ..robots.printer.robot import Found
from ..robots.serial import Serial, points_of_poses
from ..robots.serial.imported import CONVENTIONS, import_dh, import_urdf
from . import output
from .file_kinds import ROBOT, TABLE
from .groups import OpenGroup
from .paths import InputFile, OutputFile, OutputFolder
from .printer import turned


class _Importers(OpenGroup):
    """Those below, and those of other packages."""

    declared = IMPORTERS


@click.group("import", cls=_Importers)
def import_group() -> None:
    """Turn files of other programs into robot.toml and run.csv."""


_FOLDER = click.option(
    "-o",
    "--output",
    "folder",
    required=True,
    help="Folder to write to.",
    type=OutputFolder({"robot.toml": ROBOT, "run.csv": TABLE}),
)
_PLATE = click.option(
    "--plate", "plates", multiple=True, metavar="NAME=DEGREES", help="How far the plate was turned under a mesh."
)


@import_group.command("klipper")
@click.argument("config", type=InputFile())
@_PLATE
@_FOLDER
def klipper(config: Path, plates: tuple[str, ...], folder: Path) -> None:
    """A linear delta printer: its printer.cfg with a SAVE_CONFIG block."""
    _write_printer(import_klipper(config, turned(plates)), folder)


@import_group.command("reprapfirmware")
@click.argument("config", type=InputFile())
@click.argument("maps", type=InputFile(), nargs=-1, required=True, metavar="HEIGHTMAP...")
@_PLATE
@_FOLDER
def reprapfirmware(config: Path, maps: tuple[Path, ...], plates: tuple[str, ...], folder: Path) -> None:
    """A linear delta printer: M665 and M666 of its config.g, and its heightmap.csv."""
    _write_printer(import_duet(config, maps, turned(plates)), folder)


@import_group.command("marlin")
@click.argument("text", type=InputFile())
@_PLATE
@_FOLDER
def marlin(text: Path, plates: tuple[str, ...], folder: Path) -> None:
    """A linear delta printer: what its terminal said to M503 and G29, as text."""
    _write_printer(import_marlin(text, turned(plates)), folder)


def _write_printer(found: Found, folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    save_robot(found.robot, folder / "robot.toml")
    found.measurements.save(folder / "run.csv")
    output.say(f"{folder / 'robot.toml'}: the printer's own saved calibration")
    probings = ", ".join(found.robot.probings)
    output.say(f"{folder / 'run.csv'}: {len(found.measurements)} rows ({probings or 'distances'})")


_ROBOT_FILE = click.option(
    "-o", "--output", "destination", type=OutputFile(ROBOT), required=True, help="The robot file to write."
)


@import_group.command("urdf")
@click.argument("urdf", type=InputFile())
@click.option("--base", help="Link at which the arm begins; left out, the root of the file.")
@click.option("--tip", help="Link whose origin is the target; left out, the only end that the file has.")
@_ROBOT_FILE
def urdf(urdf: Path, base: str | None, tip: str | None, destination: Path) -> None:
    """An arm: the joints between two links of a URDF, as a robot.toml."""
    _write_arm(import_urdf(urdf, base, tip), destination)


@import_group.command("dh")
@click.argument("table", type=InputFile())
@click.option("--convention", type=click.Choice(CONVENTIONS), default=CONVENTIONS[0], show_default=True)
@output.columns_option
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


@import_group.command("poses")
@click.argument("robot", type=InputFile())
@click.argument("run", type=InputFile())
@click.option("--lever-mm", type=float, default=100.0, show_default=True, help="How far two more points lie off.")
@output.columns_option
@_FOLDER
def poses(robot: Path, run: Path, lever_mm: float, folder: Path) -> None:
    """An arm's full poses (x_mm … and rx_rad …, rx_deg … or qx …), as the places of three points of its tool."""
    arm = load_robot(robot)
    if not isinstance(arm, Serial):
        raise RobotError(f'{robot}: expected an arm (kind = "serial"), found kind = "{arm.kind}"')
    arm, data = points_of_poses(arm, run, lever_mm)
    folder.mkdir(parents=True, exist_ok=True)
    save_robot(arm, folder / "robot.toml")
    data.save(folder / "run.csv")
    output.say(f"{folder / 'robot.toml'}: the arm with targets 2 and 3, {lever_mm:g} mm along x and y of its tool")
    output.say(f"{folder / 'run.csv'}: {len(data)} rows, three for each pose")


_RUN_FILE = click.option(
    "-o", "--output", "destination", type=OutputFile(TABLE), required=True, help="The CSV or Parquet to write."
)


@import_group.command("bluesky")
@click.argument("documents", type=InputFile())
@click.option("--column", "columns", multiple=True, metavar="OURS=KEY", help="A column's key; repeat it.")
@click.option("--stream", default="primary", show_default=True, help="The stream whose events are rows.")
@click.option("--each-a-pose", is_flag=True, help="Every event is a pose of its own: no two are repeats.")
@_RUN_FILE
def bluesky(documents: Path, columns: tuple[str, ...], stream: str, each_a_pose: bool, destination: Path) -> None:
    """A run of bluesky: its documents, a pair of name and document as JSON on each line, as a run.csv."""
    run = from_bluesky(documents, columns=_named(columns, "--column"), stream=stream, poses=each_a_pose)
    _write_run(run, destination)


@import_group.command("rosbag")
@click.argument("folder", type=InputFile(folders=True))
@click.option("--joint", "joints", multiple=True, required=True, metavar="OURS=NAME", help="A joint's name; repeat it.")
@click.option("--poses", "topic", required=True, metavar="TOPIC", help="What a tracker saw.")
@click.option("--joint-states", default="/joint_states", show_default=True, metavar="TOPIC", help="Where joints are.")
@click.option("--coordinates", default="x_mm,y_mm,z_mm", show_default=True, help="Columns of what was seen.")
@click.option("--longest-gap-s", type=click.FloatRange(0.0), default=0.05, show_default=True,
              help="Between the joint states around a pose.")  # fmt: skip
@click.option("--still-per-s", type=click.FloatRange(0.0), help="Leave out poses at which a joint was faster.")
@_RUN_FILE
def rosbag(
    folder: Path, joints: tuple[str, ...], topic: str, joint_states: str, coordinates: str, longest_gap_s: float,
    still_per_s: float | None, destination: Path,
) -> None:  # fmt: skip
    """A ROS bag: joint states and the poses that a tracker saw, as a run.csv."""
    _write_run(
        from_rosbag(
            folder, _named(joints, "--joint"), topic, joint_states=joint_states,
            coordinates=[name.strip() for name in coordinates.split(",")], longest_gap_s=longest_gap_s,
            still_per_s=still_per_s,
        ),
        destination,
    )  # fmt: skip


def _named(pairs: tuple[str, ...], option: str) -> dict[str, str]:
    """Names of others by ours."""
    out: dict[str, str] = {}
    for pair in pairs:
        ours, equals, theirs = (part.strip() for part in pair.partition("="))
        if not (ours and equals and theirs):
            raise MeasurementError(f"{option} {pair}: expected a column and its name there, as q1_mm=rails_q1")
        if ours in out:
            raise MeasurementError(f"{option} {pair}: '{ours}' is given twice")
        out[ours] = theirs
    return out


def _write_run(run: Measurements, destination: Path) -> None:
    run.save(destination)
    layout = run.layout
    read = [name for name, taken in zip(layout.readings, run.taken.T, strict=True) if taken.any()]
    output.say(f"{destination}: {len(run)} rows of {', '.join((*layout.joints, *read))}")
