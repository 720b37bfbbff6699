"""``sherkit import`` and ``export``: files of other programs into sherkit's, and out of them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import click

from ..base.extensions import IMPORTERS
from ..data import Measurements, from_bluesky, from_rosbag
from ..data.files import write_whole
from ..errors import MeasurementError, RobotError, SherkitError
from ..model.robot_file import load_robot, save_robot
from ..robots.c_header import calibration_header
from ..robots.calibrated import Calibration, load_calibration
from ..robots.printer import import_duet, import_klipper, import_marlin
from ..robots.printer.calibration import PrinterCalibration, commands, held, klipper_config
from ..robots.printer.robot import FIRMWARES, Found
from ..robots.serial import Serial, points_of_poses
from ..robots.serial.imported import CONVENTIONS, import_dh, import_urdf
from . import output
from .file_kinds import COMMANDS, HEADER, KLIPPER, ROBOT, TABLE
from .groups import OpenGroup
from .machine_file import own_way_of
from .paths import InputFile, OutputFile, OutputFolder, require_kind
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


# -- Out of sherkit ---------------------------------------------------------------------------------------------------


@click.command()
@click.argument(
    "what",
    type=InputFile(words="|".join(("c", *FIRMWARES))),
    nargs=-1,
    required=True,
    metavar="RUN_FILE | c CALIBRATION | c TOOL | FIRMWARE CALIBRATION",
)
@click.option("-o", "--output", "destination", type=OutputFile(TABLE, HEADER, KLIPPER, COMMANDS), required=True,
              help="CSV or Parquet of a run; a C header; what a printer's firmware takes.")  # fmt: skip
@click.option("--config", type=InputFile(), help="The printer.cfg to write the numbers into (Klipper).")
def export(what: tuple[str | Path, ...], destination: Path, config: Path | None) -> None:
    """Write the rows of RUN_FILE as CSV or Parquet, also while it is being measured; with c, a calibrated robot or a
    flexible TOOL as a C header for the control loop; with klipper, reprapfirmware or marlin, a printer's CALIBRATION
    for its firmware."""
    if len(what) == 1:
        # only what reads a run's file needs SQLite
        from ..lab.experiment import export_run

        require_kind(destination, "--output", (TABLE,))
        rows = export_run(what[0], destination)
        output.say(f"{rows} rows written to {destination}", destination)
    elif len(what) == 2 and what[0] in FIRMWARES:
        require_kind(destination, "--output", (KLIPPER if what[0] == "klipper" else COMMANDS,))
        _printer(str(what[0]), Path(what[1]), destination, config)
    elif len(what) == 2 and what[0] == "c":
        require_kind(destination, "--output", (HEADER,))
        _c(Path(what[1]), destination)
    else:
        raise click.UsageError(
            "expected the file of a run; c and the file of a calibration or a flexible tool; or a firmware and the "
            "file of a printer's calibration"
        )


def _c(calibration: Path, destination: Path) -> None:
    """A calibrated robot, or a machine that has a header of its own, as a C header."""
    if (own_way := own_way_of(calibration, "export")) is not None:
        own_way(destination)
        return
    write_whole(destination, calibration_header(load_calibration(calibration), calibration.name))
    output.say(f"{destination} written; cc loop.c $(sherkit c --cflags --libs) links it (sherkit c --example FOLDER)")


def _printer(firmware: str, calibration: Path, destination: Path, config: Path | None) -> None:
    """A calibrated printer for its firmware, and what that cannot hold."""
    made = Calibration.load(calibration)
    if not isinstance(made, PrinterCalibration):
        raise SherkitError(
            f"{calibration}: is of {made.robot.kind}; only the calibration of a printer goes into a firmware"
        )
    names = [p.name for p in made.whole.model(made.robot).parameters]
    found = held(made.robot, dict(zip(names, made.whole.values.tolist(), strict=True)))
    if firmware == "klipper":
        if config is None:
            raise SherkitError("--config: name the printer.cfg into which the numbers go")
        write_whole(destination, klipper_config(config, found.towers))
    else:
        lines = commands(replace(made.robot, firmware=firmware), found.towers)
        write_whole(destination, "\n".join(lines) + "\n")
    output.say(f"{destination} written")
    if made.whole.effects:
        output.say(
            f"{firmware} cannot hold {' and '.join(made.whole.effects)}: {1e3 * found.rms_mm:.0f} µm RMS of the height "
            f"over the plate remain, {1e3 * found.largest_mm:.0f} µm at worst; put the machine right, then probe again"
        )
