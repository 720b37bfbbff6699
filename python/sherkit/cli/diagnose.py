"""``sherkit diagnose``: which effect is missing."""

from __future__ import annotations

from dataclasses import replace
from functools import reduce
from pathlib import Path

import click

from ..data.files import write_whole
from ..data.joined import joined
from ..diagnosis import Diagnosis, template
from ..diagnosis import diagnose as run_diagnosis
from ..errors import SherkitError
from ..fit.identify import identify
from ..model.effect import effects_by_name
from ..model.effect_file import load_effects
from ..model.kinds import model_of
from ..model.robot_file import run_for
from ..robots.machine.file import robot_at
from ..robots.tool_file import is_tool
from ..study import Study
from . import output, reporting
from .diagnosis_tables import diagnosis as print_diagnosis
from .reporting import report_option


@click.command()
@click.argument("robot", type=click.Path(path_type=Path))
@click.argument("runs", type=click.Path(path_type=Path), nargs=-1, required=True, metavar="RUN [MORE]...")
@click.option("--json", "as_json", is_flag=True, help="Print JSON for programs instead of tables.")
@click.option("--effects", "files", type=click.Path(path_type=Path), multiple=True, help="Python file of your effects.")
@click.option("--effect", "added", multiple=True, help="An effect that is in the model already.")
@click.option("-o", "--output", "written", type=click.Path(path_type=Path),
              help="Of a flexible tool: write it with the effects of --effect and those that were named.")  # fmt: skip
@click.option("--template", "destination", type=click.Path(path_type=Path), help="Write an effect of the shape found.")
@click.option("--level", type=click.FloatRange(0.0005, 0.2), default=0.01, show_default=True, help="Of the test.")
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Rules folds and flips.")
@report_option
def diagnose(
    robot: Path, runs: tuple[Path, ...], as_json: bool, files: tuple[Path, ...], added: tuple[str, ...],
    written: Path | None, destination: Path | None, level: float, seed: int, report: Path | None,
) -> None:  # fmt: skip
    """Say what ROBOT (TOML) is missing on the measurements RUN (CSV or Parquet), joined with MORE measured later.

    ROBOT may be the Python file of a machine, which is run.
    """
    if report is not None:
        reporting.require_view()
    if is_tool(robot):
        _tool(robot, runs, as_json=as_json, added=added, files=files, level=level, seed=seed, written=written,
              destination=destination, report=report)  # fmt: skip
        return
    if written is not None:
        raise SherkitError("--output: is for a flexible tool; sherkit calibrate --effect NAME -o writes a calibration")
    nominal, for_runs = robot_at(robot)
    own = tuple(effect for path in files for effect in load_effects(path))
    with output.steps(12) as step:
        step(f"reading {runs[0]}")
        data = reduce(joined, (run_for(for_runs, run) for run in runs))
        step("identifying the model as it is")
        plain = model_of(nominal)
        fit = identify(replace(plain, effects=effects_by_name(plain.known_effects, added, own)), data)
        found = run_diagnosis(fit, effects=own, level=level, seed=seed, step=step)
        if report is not None:
            step("writing the report")
            study = Study(nominal, data, effects=own, seed=seed)
            for name in (*added, *found.effects):
                study.add(name)
            title = f"What is {robot.stem} missing on {runs[0].name}?"
            reporting.write(report, title, study, found, (robot, *runs, *files))
    if as_json:
        output.print_json(found.to_json())
    else:
        print_diagnosis(found, *((robot, *runs) if len(runs) == 1 else ()))
    if report is not None and not as_json:
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


def _tool(
    path: Path, runs: tuple[Path, ...], *, as_json: bool, added: tuple[str, ...], files: tuple[Path, ...], level: float,
    seed: int, written: Path | None, destination: Path | None, report: Path | None,
) -> None:  # fmt: skip
    """A run of a flexible tool against its camera."""
    from ..robots.tool.applied import applied
    from ..robots.tool.filters import estimate as estimate_tool
    from ..robots.tool.model import ToolModel
    from ..robots.tool.runs import read_tool_run
    from ..robots.tool.tool import load_tool
    from .tool import say_applied, write_tool_report

    if len(runs) > 1:
        raise SherkitError(f"{runs[1]}: runs of a flexible tool are diagnosed one at a time")
    own = tuple(effect for file in files for effect in load_effects(file))
    with output.steps(12) as step:
        step(f"reading {runs[0]}")
        model = ToolModel(load_tool(path), read_tool_run(runs[0]))
        step("fitting the camera's offset")
        candidates = {e.name: e for e in model.candidates}
        fit = identify(model, model.readings, effects=effects_by_name(candidates, added, own))
        found = run_diagnosis(fit, effects=own, level=level, seed=seed, step=step)
    told = applied(model, found.fit)
    if report is not None:
        title = f"What is {path.stem} missing on {runs[0].name}?"
        write_tool_report(report, title, found, estimate_tool(told.tool, model.run), told)
    if written is not None:
        told.tool.save(written)
    if as_json:
        output.print_json(found.to_json())
    else:
        print_diagnosis(found)
        if written is not None:
            output.say("")
            say_applied(told)
            output.say(f"   the tool is in {written}")
        if report is not None:
            output.say(f"\nthe report is in {report}")
    _write_template(found, destination, as_json=as_json)
