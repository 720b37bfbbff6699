"""``sherkit calibrate``: from a run to a calibrated model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import reduce
from pathlib import Path

import click
import numpy as np
from rich.table import Table

from ..base.figures import in_people_units, in_small_units, listed, number, with_error
from ..calibration import CORRECTIONS, Result, to_json
from ..calibration import calibrate as run_calibration
from ..data import Measurements
from ..data.stream import joined
from ..errors import MeasurementError, SherkitError
from ..fit.least_squares import LOSSES
from ..fit.regions import TO_DO
from ..model.effect import effects_by_name, load_effects
from ..model.kinds import catalogue_of, model_of, required_um
from ..model.robot_file import run_for
from ..model.sensor_pose import POSE
from ..model.thermometers import thermometers_of
from ..robots.calibrated import BesideBase, Calibration, calibration_class
from ..robots.calibration_run import CalibrationRun
from ..robots.delta import paper
from ..robots.machine import robot_at
from ..study import Study
from . import output
from .file_kinds import CALIBRATION, TOOL
from .machine_file import own_way_of
from .output import columns_option, out, report_option, table
from .paths import InputFile, OutputFile, require_kind

NOT_CONVERGED = 3


@click.command()
@click.argument("robot", type=InputFile())
@click.argument("runs", type=InputFile(), nargs=-1, required=True, metavar="RUN [MORE]...")
@click.option("--local", type=InputFile(), help="A second run inside the region of interest.")
@click.option("-o", "--output", "destination", type=OutputFile(CALIBRATION, TOOL), help="Write the calibration here.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON for programs instead of tables.")
@click.option("--loss", type=click.Choice(LOSSES), default="linear", show_default=True, help="Against outliers.")
@click.option("--free", default="", help="Parameters to identify, separated by commas; default: those of its kind.")
@click.option("--effect", "added", multiple=True, help="A physical effect to identify too; see sherkit effects.")
@click.option("--effects", "files", type=InputFile(), multiple=True, help="Python file of your effects.")
@click.option(
    "--priors/--no-priors",
    default=None,
    help="Take the drawing, with plausible sizes, as one more measurement: always, or never. Left out: where the "
    "readings alone would leave something less sure than the drawing does, as closely as they find that it holds.",
)
@click.option("--linear", is_flag=True, help="The paper's single linear step instead of the nonlinear minimum.")
@click.option("--correction", type=click.Choice(CORRECTIONS), default="auto", show_default=True)
@click.option("--exclude", default="", help="Lines of RUN to leave out as outliers, separated by commas.")
@click.option("--with-outliers", is_flag=True, help="Use the rows that a diagnosis leaves out as gross errors too.")
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Of random splits.")
@report_option
@columns_option
def calibrate(
    robot: Path,
    runs: tuple[Path, ...],
    local: Path | None,
    destination: Path | None,
    as_json: bool,
    loss: str,
    free: str,
    added: tuple[str, ...],
    files: tuple[Path, ...],
    priors: bool | None,
    linear: bool,
    correction: str,
    exclude: str,
    with_outliers: bool,
    seed: int,
    report: Path | None,
) -> int:
    """Identify ROBOT (TOML) from the measurements RUN (CSV or Parquet), joined with MORE measured later; or a flexible
    tool from known loads.

    ROBOT may be the Python file of a machine, which is run.
    """
    run, *more = runs
    if (own_way := own_way_of(robot, "calibrate")) is not None:
        if more:
            raise SherkitError(f"{more[0]}: known loads of a tool are one table, {run}")
        own_way(run, destination, as_json=as_json)
        return 0
    if destination is not None:
        require_kind(destination, "--output", (CALIBRATION,))
    if report is not None:
        output.require_view()
    nominal, for_runs = robot_at(robot)
    own = [e for path in files for e in load_effects(path)]
    with output.steps(7) as step:
        step(f"reading {run}")
        first = _without(run_for(for_runs, run), exclude)
        data = reduce(joined, (run_for(for_runs, one) for one in more), first)
        inner = run_for(for_runs, local) if local else None
        names = [name.strip() for name in free.split(",") if name.strip()]
        chosen = effects_by_name(catalogue_of(nominal), added, [*own, *thermometers_of(model_of(nominal), data)])
        result = run_calibration(
            for_runs,
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
            sources = [robot, *runs, *([local] if local else []), *files]
            output.write_report(report, study, found, sources, calibration=result.calibration, result=result)
    if as_json:
        output.print_json(to_json(result))
    else:
        print_result(result)
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


# -- What is said of it -----------------------------------------------------------------------------------------------


def _pm(value: tuple[float, float] | None, unit: str = "µm") -> str:
    if value is None:
        return ""
    return f"{value[0]:.1f} ± {value[1]:.1f}" if unit == "µm" else f"{value[0]:.3g} ± {value[1]:.3g}"


def errors(e: CalibrationRun, title: str, beside: Mapping[str, Mapping[str, tuple[int, int]]] | None = None) -> Table:
    """Table I: error per axis before, after the geometry, held out, after the correction."""
    layout, taken = e.fit.data.layout, np.any(e.fit.data.taken, axis=0)
    axes = [name for name, any_ in zip(layout.readings, taken.tolist(), strict=True) if any_]
    several = e.fit.error.axes > 1
    together = [f"error {e.fit.error.in_words}", "95 % within"] if several else ["95 % within"]
    made = table(title, f"{layout.unit}, RMS", *together, *[f"{a.rsplit('_', 1)[0]} ± std" for a in axes])
    for name, key, error, rms in e.lines():
        sizes = [number(error.rms), number(error.p95)] if several else [number(error.p95)]
        made.add_row(name, *sizes, *[_pm(rms.get(a), layout.unit) for a in axes])
        printed = (beside or {}).get(key)
        if printed:
            blank = [""] * len(sizes)
            made.add_row("  the paper's robot", *blank, *[f"{v[0]} ± {v[1]}" for v in printed.values()], style="dim")
    repeats = e.fit.repeatability
    if repeats:
        made.add_row(
            "repeatability (1 σ)",
            *[""] * len(together),
            *[f"± {layout.per_unit * v:.3g}" for v in repeats.sigma.values()],
        )
    return made


def parameters(e: CalibrationRun, title: str) -> Table:
    """Table II: identified errors with their standard deviations, four per limb."""
    fit = e.fit
    note = "± readings: what the readings leave.  ± total: with what they do not tell, from plausible sizes."
    made = table(title, "parameter", "", "identified error", "± readings", "± total", "unit", note=note)
    for p, v, r, s in zip(fit.parameters, fit.values, fit.std_from_readings, fit.std, strict=True):
        unit, factor = in_people_units(p.unit)
        value, readings, total = with_error(*(factor * x for x in (v, r, s)))
        made.add_row(p.name, p.symbol, value, readings, total, unit)
    return made


def polynomials(e: CalibrationRun, title: str, beside: Mapping[str, tuple[object, ...]] | None = None) -> Table | None:
    """Table III: the errors of the robot's correction as its paper has them; None where it has none."""
    found = e.correction.cells() if e.correction is not None else None
    if found is None:
        return None
    made = table(title, "µm, RMS ± std", *found.columns)
    for line in found.lines:
        made.add_row(*line)
        if beside:
            order, *rest = beside[line[0]]
            numbers = [f"{v[0]} ± {v[1]}" for v in rest if isinstance(v, tuple)][: len(found.columns) - 1]
            made.add_row("  the paper's robot", str(order), *numbers, style="dim")
    return made


def account(e: CalibrationRun, title: str) -> None:
    """How well the parameters are known, in sentences."""
    fit = e.fit
    out.print(f"[bold]{title}[/]")
    out.print(
        f"  {len(fit.data)} rows, {fit.evaluations} evaluations, "
        f"{'converged' if fit.converged else '[bold red]not converged[/]'}; "
        f"rank {fit.rank} of {len(fit.parameters)}, condition number {fit.condition_number:.0f}; "
        f"noise: {_NOISE[fit.noise.origin]}"
    )
    if fit.unobserved:
        out.print(
            f"  [bold]{len(fit.unobserved)} of {len(fit.parameters)} directions change no reading[/] "
            "and were left at the smallest plausible change:"
        )
        for d in fit.unobserved:
            out.print(f"    {d}")
    if fit.elsewhere is None:
        out.print("  too few poses to leave out whole regions: how far it is off away from them is not known")
    elif said := fit.elsewhere.sentence(fit.error):
        out.print(f"  {said} {TO_DO[fit.priors > 0.0]}")
    for doubt in (fit.lacking, fit.overparametrised):
        if doubt:
            out.print(f"  {doubt}")
    if fit.badly_observed:
        out.print("  worst observed directions (one standard deviation):")
        for d in fit.badly_observed:
            out.print(f"    {d}")
    if len(e.outliers):
        lines, used = fit.data.line[e.outliers], not fit.data.outlier[e.outliers].any()
        plural = "s" if len(lines) > 1 else ""
        out.print(
            f"  [bold yellow]{len(lines)} gross error{plural}[/], {fit.data.counted}{plural} {listed(lines, 20)}: "
            + ("used all the same" if used else "left out; --with-outliers uses them")
        )
    marked = np.setdiff1d(np.flatnonzero(fit.data.outlier), e.outliers)
    if len(marked):
        out.print(f"  marked as outliers and not fitted: {fit.data.counted}s {listed(fit.data.line[marked], 20)}")
    if e.correction is not None:
        out.print(f"  {e.correction}")


_NOISE = {
    "declared": "as declared in the file",
    "repeats": "from repeats of poses",
    "unknown": "unknown (no repeats, none declared), so its size comes from the residuals",
}


def _sized(value: float, unit: str) -> str:
    return f"{value:.1f}" if unit == "µm" else f"{value:.3g}"


def print_accuracy(calibration: Calibration) -> None:
    """Predicted accuracy at the centre and at the rims, against what the robot is for: what the poses show, what could
    hide between them, and what to measure against that."""
    needed = required_um(calibration.robot)
    unit, factor = in_small_units(calibration.accuracy_unit)
    made = table(
        f"Predicted accuracy{f' (target: {needed:g} µm)' if needed else ''}",
        "at",
        *(name.rpartition("_")[0] + ", " + name.rpartition("_")[2] for name in calibration.coordinates),
        f"accuracy, {unit}",
        "of it unseen",
        "repeatability",
        "one reading",
        "",
        note="accuracy: so far from the command lies the mean of many visits, in 95 of 100 cases.  of it unseen: what "
        "effects of plausible size could do there that the poses of the run could not show.  repeatability: so far "
        "from that mean lie 95 of 100 readings, the instrument's noise with them.  one reading: both together.",
    )
    narrowing: dict[str, str] = {}
    for name, place in calibration.places():
        cells = [f"{v:.4g}" for v in place]
        try:
            predicted = calibration.predicted_accuracy(place)
            note = "" if calibration.measured(place) else "extrapolated: no pose was measured there"
            scatter = calibration.repeatability(place)
            sizes = (predicted.total_mm, predicted.addition_mm, scatter, predicted.visit_mm)
            made.add_row(name, *cells, *("unknown" if np.isnan(v) else _sized(factor * v, unit) for v in sizes), note)
            if predicted.matters:
                narrowing[predicted.effect] = predicted.advice
        except SherkitError as error:  # the rim may be beyond reach: say so in the table
            made.add_row(name, *cells, "", "", "", "", str(error))
    out.print(made)
    if beside := calibration.beside_base():
        drawn = [p.name for p in calibration.model.fixed if p.name not in POSE]
        out.print(_beside_base(beside, unit, factor, drawn))
    for effect, advice in narrowing.items():
        out.print(f"  unseen is mostly {effect}. {advice}")
    untried = {name for part in calibration.parts_made for name in part.untried}
    if untried:
        out.print(f"  not counted, for want of a column in the run: {listed(sorted(untried), 20)}")


def _beside_base(rows: Sequence[BesideBase], unit: str, factor: float, drawn: Sequence[str]) -> Table:
    """Accuracy as the sensor reads, and of moves; the base is where what is ``drawn`` is so."""
    made = table(
        "The same as the sensor reads, and of moves",
        "at",
        f"as the sensor reads, {unit}",
        f"a move from the middle, {unit}",
        note=f"The base lies where {listed(drawn, 16)} are as drawn, which no reading tells: by what they are off it "
        "lies elsewhere, and all places with it, and that is no part of the accuracy. What the sensor reads has none "
        "of it; of a move from the middle of the run to there what both ends are off by alike is no part.",
    )
    for one in rows:
        sizes = ("" if np.isnan(v) else _sized(factor * v, unit) for v in (one.sensor_mm, one.move_mm))
        made.add_row(one.name, *sizes)
    return made


def print_result(r: Result, *, demo: bool = False) -> None:
    """Everything a calibration found."""
    label = " — simulation" if demo else ""
    for name, e in (("whole workspace", r.whole), ("local", r.local)):
        if e is None:
            continue
        key = name.split()[0]
        out.print(errors(e, f"Table I{label}: errors, {name}", paper.TABLE_I[key] if demo else None))
        out.print(parameters(e, f"Table II{label}: identified errors, {name}"))
        if demo:
            out.print(_paper_parameters(key))
        third = polynomials(
            e, f"Table III{label}: after the polynomial, {name}", paper.TABLE_III[key] if demo else None
        )
        if third is not None:
            out.print(third)
        account(e, f"How well the {name} run knows its parameters")
        out.print()
    print_accuracy(r.calibration)
    for note in (*calibration_class(r.whole.fit.model.robot).about(r.whole.fit), *r.calibration.notes()):
        out.print(str(note))


def _paper_parameters(key: str) -> Table:
    made = table(f"Table II of the paper, {key} (another robot: sizes may be compared, values not)",
                 "limb", "δr_b mm", "δθ_b deg", "δL mm", "δl mm")  # fmt: skip
    for limb, row in enumerate(paper.TABLE_II[key], start=1):
        made.add_row(str(limb), *[f"{v:+.2f}" for v in row], style="dim")
    return made
