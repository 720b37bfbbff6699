"""``sherkit calibrate``: from a run to a calibrated model."""

from __future__ import annotations

from pathlib import Path

import click
import numpy as np

from ..calibration import CORRECTIONS, to_json
from ..calibration import calibrate as run_calibration
from ..data import Measurements
from ..errors import MeasurementError
from ..fit.least_squares import LOSSES
from ..model.effect import effects_by_name, load_effects
from ..model.kinds import catalogue_of
from ..model.robot_file import run_for
from ..robots.machine import robot_at
from ..study import Study
from . import output, reporting, tables
from .machine_file import own_way_of
from .reporting import report_option

NOT_CONVERGED = 3


@click.command()
@click.argument("robot", type=click.Path(path_type=Path))
@click.argument("run", type=click.Path(path_type=Path))
@click.option("--local", type=click.Path(path_type=Path), help="A second run inside the region of interest.")
@click.option("-o", "--output", "destination", type=click.Path(path_type=Path), help="Write the calibration here.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON for programs instead of tables.")
@click.option("--loss", type=click.Choice(LOSSES), default="linear", show_default=True, help="Against outliers.")
@click.option("--free", default="", help="Parameters to identify, separated by commas; default: those of its kind.")
@click.option("--effect", "added", multiple=True, help="A physical effect to identify too; see sherkit effects.")
@click.option("--effects", "files", type=click.Path(path_type=Path), multiple=True, help="Python file of your effects.")
@click.option("--priors", is_flag=True, help="Take plausible sizes as knowledge, not only where nothing is observed.")
@click.option("--linear", is_flag=True, help="The paper's single linear step instead of the nonlinear minimum.")
@click.option("--correction", type=click.Choice(CORRECTIONS), default="auto", show_default=True)
@click.option("--exclude", default="", help="Lines of RUN to leave out as outliers, separated by commas.")
@click.option("--with-outliers", is_flag=True, help="Use the rows that a diagnosis leaves out as gross errors too.")
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Of random splits.")
@report_option
def calibrate(
    robot: Path,
    run: Path,
    local: Path | None,
    destination: Path | None,
    as_json: bool,
    loss: str,
    free: str,
    added: tuple[str, ...],
    files: tuple[Path, ...],
    priors: bool,
    linear: bool,
    correction: str,
    exclude: str,
    with_outliers: bool,
    seed: int,
    report: Path | None,
) -> int:
    """Identify ROBOT (TOML) from the measurements RUN (CSV or Parquet), or a flexible tool from known loads.

    ROBOT may be the Python file of a machine, which is run.
    """
    if (own_way := own_way_of(robot, "calibrate")) is not None:
        own_way(run, destination)
        return 0
    if report is not None:
        reporting.require_view()
    nominal, for_runs = robot_at(robot)
    own = [e for path in files for e in load_effects(path)]
    with output.steps(7) as step:
        step(f"reading {run}")
        data = _without(run_for(for_runs, run), exclude)
        inner = run_for(for_runs, local) if local else None
        names = [name.strip() for name in free.split(",") if name.strip()]
        chosen = effects_by_name(catalogue_of(nominal), added, own)
        result = run_calibration(
            nominal,
            data,
            inner,
            free=names,
            effects=chosen,
            loss=loss,
            priors=priors,
            linear=linear,
            correction=correction,
            with_outliers=with_outliers,
            seed=seed,
            step=step,
        )
        # what was calibrated is kept, whatever becomes of the report
        if destination is not None:
            result.calibration.save(destination)
        if report is not None:
            step("diagnosing what is left")
            free_ones = result.whole.fit.model.free
            study = Study(nominal, data, effects=own, free=free_ones, loss=loss, seed=seed, with_outliers=with_outliers)
            for name in added:
                study.add(name)
            found = study.diagnose(step=step)
            step("writing the report")
            sources = [robot, run, *([local] if local else []), *files]
            title = f"Calibration of {robot.stem} from {run.name}"
            reporting.write(report, title, study, found, sources, calibration=result.calibration, result=result)
    if as_json:
        output.print_json(to_json(result))
    else:
        tables.result(result)
        if destination is not None:
            output.say(f"calibration written to {destination}")
        if report is not None:
            output.say(f"report written to {report}")
    return 0 if result.converged or linear else NOT_CONVERGED


def _without(data: Measurements, exclude: str) -> Measurements:
    """Marks lines as outliers; refuses lines that hold no row."""
    if not exclude.strip():
        return data
    try:
        lines = [int(part) for part in exclude.split(",")]
    except ValueError:
        raise MeasurementError(f"--exclude: expected line numbers separated by commas, got '{exclude}'") from None
    rows = []
    for line in lines:
        found = (data.line == line).nonzero()[0]
        if len(found) == 0:
            raise MeasurementError(f"--exclude: {data.source} has no row on {data.counted} {line}")
        rows.append(found[0])
    return data.mark_outliers(np.array(rows))
