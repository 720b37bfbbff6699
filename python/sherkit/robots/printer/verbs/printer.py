"""``sherkit printer``: what is wrong with a delta printer, for its owner."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import click
from rich.markup import escape

from ....cli import output
from ....cli.file_kinds import KLIPPER
from ....cli.output import out, report_option
from ....cli.paths import InputFile, OutputFile
from ....data.files import write_whole
from ....errors import SherkitError
from ..calibration import klipper_config
from ..printer_diagnosis import examine, files_of


@click.command()
@click.argument("config", type=InputFile())
@click.argument("maps", type=InputFile(), nargs=-1, metavar="[HEIGHTMAP]...")
@click.option("--plate", "plates", multiple=True, metavar="NAME=DEGREES",
              help="The plate was turned by so much, anticlockwise seen from above, under the mesh NAME.")  # fmt: skip
@click.option("-o", "--output", "written", type=OutputFile(KLIPPER),
              help="Write CONFIG with the better numbers here (Klipper).")  # fmt: skip
@click.option("--json", "as_json", is_flag=True, help="Print JSON for programs instead of sentences.")
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Rules folds and flips.")
@report_option
def printer(
    config: Path, maps: tuple[Path, ...], plates: tuple[str, ...], written: Path | None, as_json: bool, seed: int,
    report: Path | None,
) -> None:  # fmt: skip
    """Say what is wrong with a linear delta printer, by what it probed itself.

    CONFIG is Klipper's printer.cfg, a config.g of RepRapFirmware with its HEIGHTMAPs, or a text file with what Marlin's
    terminal said to M503 and G29.
    """
    with output.steps(14) as step:
        step(f"reading {config}")
        found = files_of(config, maps, turned(plates))
        examined = examine(found, seed=seed, step=step)
    if written is not None:
        if found.robot.firmware != "klipper":
            raise SherkitError("--output: is for Klipper's printer.cfg; the commands of other firmwares are printed")
        if examined.better_numbers:
            write_whole(written, klipper_config(config, examined.new.towers))
            examined = replace(examined, written=str(written))
        else:
            output.say(f"{written} is not written: no numbers are clearly better than those of {config}")
            written = None
    if report is not None:
        from ..page import write_printer

        write_printer(report, examined, output.made_by((config, *maps), (config, *maps)))
    if as_json:
        output.print_json(examined.to_json())
        return
    out.print(f"[bold]Verdict: {escape(examined.answer.verdict)}[/]")
    for title, sentences in examined.sections:
        out.print(f"[bold]{title}[/]")
        for one in sentences:
            out.print(f"   {escape(one)}")
    for path in (one for one in (written, report) if one is not None):
        output.say(f"\n{path} written")


def turned(plates: tuple[str, ...]) -> dict[str, float]:
    """Degrees by the name of a mesh. Raises :class:`~sherkit.errors.SherkitError`."""
    made = {}
    for one in plates:
        name, _, degrees = one.rpartition("=")
        try:
            made[name] = float(degrees)
        except ValueError:
            name = ""
        if not name or not abs(made[name]) < 1e4:
            raise SherkitError(f"--plate: expected the name of a mesh and degrees, as turned=60, got '{one}'")
    return made
