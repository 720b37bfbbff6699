"""``sherkit import`` and ``sherkit export`` of delta printers: what their firmware writes and reads."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import click

from ....cli import output
from ....cli.exchange import folder_option
from ....cli.export import written_as
from ....cli.file_kinds import COMMANDS, KLIPPER
from ....cli.groups import examples
from ....cli.paths import InputFile
from ....data.files import write_whole
from ....errors import SherkitError
from ....model.robot_file import save_robot
from ...calibrated import Calibration
from ..calibration import FirmwareFit, PrinterCalibration, commands, held, klipper_config
from ..gcode import import_duet, import_marlin
from ..klipper import import_klipper
from ..robot import ImportedPrinter
from .printer import turned

# -- Into sherkit's files --------------------------------------------------------------------------------------------

_PLATE = click.option(
    "--plate", "plates", multiple=True, metavar="NAME=DEGREES", help="How far the plate was turned under a mesh."
)


@click.command("klipper", epilog=examples("sherkit import klipper printer.cfg -o printer"))
@click.argument("config", type=InputFile())
@_PLATE
@folder_option
def klipper(config: Path, plates: tuple[str, ...], folder: Path) -> None:
    """A linear delta printer: its printer.cfg with a SAVE_CONFIG block."""
    _write_printer(import_klipper(config, turned(plates)), folder)


@click.command("reprapfirmware")
@click.argument("config", type=InputFile())
@click.argument("maps", type=InputFile(), nargs=-1, required=True, metavar="HEIGHTMAP...")
@_PLATE
@folder_option
def reprapfirmware(config: Path, maps: tuple[Path, ...], plates: tuple[str, ...], folder: Path) -> None:
    """A linear delta printer: M665 and M666 of its config.g, and its heightmap.csv."""
    _write_printer(import_duet(config, maps, turned(plates)), folder)


@click.command("marlin")
@click.argument("text", type=InputFile())
@_PLATE
@folder_option
def marlin(text: Path, plates: tuple[str, ...], folder: Path) -> None:
    """A linear delta printer: what its terminal said to M503 and G29, as text."""
    _write_printer(import_marlin(text, turned(plates)), folder)


def _write_printer(found: ImportedPrinter, folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    save_robot(found.robot, folder / "robot.toml")
    found.measurements.save(folder / "run.csv")
    output.say(f"{folder / 'robot.toml'}: the printer's own saved calibration")
    probings = ", ".join(found.robot.probings)
    output.say(f"{folder / 'run.csv'}: {len(found.measurements)} rows ({probings or 'distances'})")


# -- Out of them -----------------------------------------------------------------------------------------------------


@click.command("klipper", epilog=examples("sherkit export klipper calibrated.toml --config printer.cfg -o new.cfg"))
@click.argument("calibration", type=InputFile())
@click.option("--config", type=InputFile(), required=True, help="The printer.cfg to write the numbers into.")
@written_as(KLIPPER)
def export_klipper(calibration: Path, config: Path, destination: Path) -> None:
    """A printer's calibration for Klipper: its printer.cfg with the better numbers."""
    made, found = _held(calibration)
    write_whole(destination, klipper_config(config, found.towers))
    _say(destination, "klipper", made, found)
    output.say("saved meshes are left out where the numbers change: BED_MESH_CALIBRATE and SAVE_CONFIG before printing")


@click.command("reprapfirmware")
@click.argument("calibration", type=InputFile())
@written_as(COMMANDS)
def export_reprapfirmware(calibration: Path, destination: Path) -> None:
    """A printer's calibration for RepRapFirmware: its commands."""
    _commands(calibration, destination, "reprapfirmware")


@click.command("marlin")
@click.argument("calibration", type=InputFile())
@written_as(COMMANDS)
def export_marlin(calibration: Path, destination: Path) -> None:
    """A printer's calibration for Marlin: its commands."""
    _commands(calibration, destination, "marlin")


def _commands(calibration: Path, destination: Path, firmware: str) -> None:
    made, found = _held(calibration)
    lines = commands(replace(made.robot, firmware=firmware), found.towers)
    write_whole(destination, "\n".join(lines) + "\n")
    _say(destination, firmware, made, found)


def _held(calibration: Path) -> tuple[PrinterCalibration, FirmwareFit]:
    """A printer's calibration, and what of it a firmware can hold."""
    made = Calibration.load(calibration)
    if not isinstance(made, PrinterCalibration):
        raise SherkitError(
            f"{calibration}: is of {made.robot.kind}; only the calibration of a printer goes into a firmware"
        )
    names = [p.name for p in made.whole.model(made.robot).parameters]
    return made, held(made.robot, dict(zip(names, made.whole.values.tolist(), strict=True)))


def _say(destination: Path, firmware: str, made: PrinterCalibration, found: FirmwareFit) -> None:
    output.say(f"{destination} written")
    if made.whole.effects:
        output.say(
            f"{firmware} cannot hold {' and '.join(made.whole.effects)}: {1e3 * found.rms_mm:.0f} µm RMS of the "
            f"height over the plate remain, {1e3 * found.largest_mm:.0f} µm at worst; put the machine right, then "
            "probe again"
        )
