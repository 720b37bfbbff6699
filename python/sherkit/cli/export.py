"""``sherkit export``: what others take from sherkit: rows, a C header, the numbers of a printer's firmware."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import click

from ..data.files import write_whole
from ..errors import SherkitError
from ..robots.c_header import calibration_header
from ..robots.calibrated import Calibration, load_calibration
from ..robots.printer.calibration import PrinterCalibration, commands, held, write_klipper_config
from ..robots.printer.robot import FIRMWARES
from . import output
from .machine_file import own_way_of


@click.command()
@click.argument("what", nargs=-1, required=True, metavar="RUN_FILE | c CALIBRATION | c TOOL | FIRMWARE CALIBRATION")
@click.option("-o", "--output", "destination", type=click.Path(path_type=Path), required=True,
              help="CSV or Parquet of a run; a C header; what a printer's firmware takes.")  # fmt: skip
@click.option("--config", type=click.Path(path_type=Path), help="The printer.cfg to write the numbers into (Klipper).")
def export(what: tuple[str, ...], destination: Path, config: Path | None) -> None:
    """Write the rows of RUN_FILE as CSV or Parquet, also while it is being measured; with c, a calibrated robot or a
    flexible TOOL as a C header for the control loop; with klipper, reprapfirmware or marlin, a printer's CALIBRATION
    for its firmware."""
    if len(what) == 1:
        # only what reads a run's file needs SQLite
        from ..lab.experiment import export_run

        rows = export_run(Path(what[0]), destination)
        output.say(f"{rows} rows written to {destination}", destination)
    elif len(what) == 2 and what[0] in FIRMWARES:
        _printer(what[0], Path(what[1]), destination, config)
    elif len(what) == 2 and what[0] == "c":
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
    kept = None
    names = [p.name for p in made.whole.model(made.robot).parameters]
    found = held(made.robot, dict(zip(names, made.whole.values.tolist(), strict=True)))
    if firmware == "klipper":
        if config is None:
            raise SherkitError("--config: name the printer.cfg into which the numbers go")
        kept = write_klipper_config(config, found.towers, destination)
    else:
        lines = commands(replace(made.robot, firmware=firmware), found.towers)
        write_whole(destination, "\n".join(lines) + "\n")
    output.say(f"{destination} written" + (f"; as it was, it is kept in {kept}" if kept else ""))
    if made.whole.effects:
        output.say(
            f"{firmware} cannot hold {' and '.join(made.whole.effects)}: {1e3 * found.rms_mm:.0f} µm RMS of the height "
            f"over the plate remain, {1e3 * found.largest_mm:.0f} µm at worst; put the machine right, then probe again"
        )
