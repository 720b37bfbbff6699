"""``sherkit diagnose``: which effect is missing."""

from __future__ import annotations

from pathlib import Path

import click

from ..data.files import write_whole
from ..diagnosis import Diagnosis, template
from ..diagnosis import diagnose as run_diagnosis
from ..fit.identify import identify
from ..model.effect import effects_by_name, load_effects
from . import output, reporting
from .diagnosis_tables import diagnosis as print_diagnosis
from .machine_file import machine_at
from .reporting import report_option


@click.command()
@click.argument("robot", type=click.Path(path_type=Path))
@click.argument("runs", type=click.Path(path_type=Path), nargs=-1, required=True, metavar="RUN [MORE]...")
@click.option("--json", "as_json", is_flag=True, help="Print JSON for programs instead of tables.")
@click.option("--checks", "every_check", is_flag=True, help="List everything that was checked, not only what fails.")
@click.option("--effects", "files", type=click.Path(path_type=Path), multiple=True, help="Python file of your effects.")
@click.option("--effect", "added", multiple=True, help="An effect that is in the model already.")
@click.option("-o", "--output", "written", type=click.Path(path_type=Path),
              help="Of a flexible tool: write it with the effects of --effect and those that were named.")  # fmt: skip
@click.option("--template", "destination", type=click.Path(path_type=Path), help="Write an effect of the shape found.")
@click.option("--level", type=click.FloatRange(0.0005, 0.2), default=0.01, show_default=True, help="Of the test.")
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Of random splits.")
@report_option
def diagnose(
    robot: Path, runs: tuple[Path, ...], as_json: bool, every_check: bool, files: tuple[Path, ...],
    added: tuple[str, ...], written: Path | None, destination: Path | None, level: float, seed: int,
    report: Path | None,
) -> None:  # fmt: skip
    """Say what ROBOT (TOML) is missing on the measurements RUN (CSV or Parquet), joined with MORE measured later.

    ROBOT may be the Python file of a machine, which is run.
    """
    if report is not None:
        reporting.require_view()
    machine = machine_at(robot)
    machine.require_writable(written)
    own = tuple(effect for path in files for effect in load_effects(path))
    with output.steps(12) as step:
        step(f"reading {runs[0]}")
        model, data = machine.read(runs)
        step("identifying the model as it is")
        fit = identify(model, data, effects=effects_by_name(model.known_effects, added, own))
        found = run_diagnosis(fit, effects=own, level=level, seed=seed, step=step)
        if report is not None:
            step("writing the report")
            title = f"What is {robot.stem} missing on {runs[0].name}?"
            machine.report(report, title, found, own=own, added=added, seed=seed, sources=(robot, *runs, *files))
    said = [] if written is None else machine.write(written, found)
    if as_json:
        output.print_json(found.to_json())
    else:
        print_diagnosis(found, *machine.told(runs), every_check=every_check)
        if said:
            output.say("\n" + "\n".join(f"   {sentence}" for sentence in said))
        if report is not None:
            output.say(f"\nthe report is in {report}")
    _write_template(found, destination, as_json=as_json)


def _write_template(found: Diagnosis, destination: Path | None, *, as_json: bool) -> None:
    """An effect of the shape that was found, as a file to edit."""
    if destination is not None and found.signature is not None:
        write_whole(destination, template(found.signature, found.fit.data.layout, file=str(destination)))
        if not as_json:
            output.say(f"\na template of this effect is in {destination}")
    elif destination is not None and not as_json:
        output.say("\nnothing is left that would need a template")
