"""``sherkit plan``: what a run could find, before it is measured, and which poses to measure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
import numpy as np
import polars as pl
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from ...base.figures import in_names, listed, sized
from ...base.types import Floats
from ...cli import output
from ...cli.file_kinds import RESULTS, TABLE
from ...cli.machine_file import calibration_at, machine_option
from ...cli.output import out, table
from ...cli.paths import InputFile, OutputFile
from ...data import Measurements
from ...data.columns import TIME, Layout
from ...data.reader import checked
from ...data.tables import read_table, write_table
from ...diagnosis.sensor_pose import pose_in_words, taken_by_pose
from ...errors import SherkitError
from ...evidence.thresholds import LEVEL, POWER
from ...model.kinds import Robot, kind_of, model_of
from ...planning.effect_power import EffectPower, Planning, planning_of
from ...planning.power import DetectionCount, EffectSize, study_power
from ...planning.to_measure import poses_to_measure, rows_at
from ...robots.machine import robot_at
from ..experiment import Experiment, load_experiment

#: Standard deviation of a reading by the unit that people read.
_NOISE = {"µm": 5.0, "px": 0.1}
#: Multiple of the plausible size beyond which an effect is not simulated.
_LARGEST_STUDIED = 5.0
_SIGNS = 8
#: Poses of a check, and of a run, unless it is said.
_OF_CHECK, _OF_RUN = 12, 40


@click.command()
@click.argument("robot", type=InputFile())
@click.argument("planned", metavar="[EXPERIMENT|POSES]", type=InputFile(), required=False)
@click.option(
    "--verify",
    is_flag=True,
    help="ROBOT is a calibration: list the poses that would see most of what may have changed since.",
)
@machine_option
@click.option("--poses", type=click.IntRange(min=6, max=1000), help="So many poses; default 40, of --verify 12.")
@click.option("--repeats", type=click.IntRange(min=1, max=100), default=2, show_default=True, help="Of each pose.")
@click.option(
    "--pace-s", type=click.FloatRange(min=0, min_open=True), help="Seconds from row to row, for what goes with time."
)
@click.option(
    "-o", "--output", "to", type=OutputFile(TABLE), help="Write the poses here, to be measured in this order."
)
@click.option("--noise-um", type=click.FloatRange(min=0, min_open=True), help="Of a reading in µm; default 5.")
@click.option("--noise-px", type=click.FloatRange(min=0, min_open=True), help="Of a reading in px; default 0.1.")
@click.option("--effect", "effects", multiple=True, help="An effect that is in the model already.")
@click.option("--study", "runs", type=click.IntRange(min=1), help="Check the promise on so many simulated robots.")
@click.option("--keep", type=OutputFile(RESULTS), help="Keep the study's results here; it can be interrupted.")
@click.option("--workers", type=click.IntRange(min=1), help="Processes of the study; by default one per processor.")
@click.option("--json", "as_json", is_flag=True, help="Print the results as JSON.")
def plan(
    robot: Path, planned: Path | None, verify: bool, machine: Path | None, poses: int | None, repeats: int,
    pace_s: float | None, to: Path | None, noise_um: float | None, noise_px: float | None, effects: tuple[str, ...],
    runs: int | None, keep: Path | None, workers: int | None, as_json: bool,
) -> None:  # fmt: skip
    """Say what a run could find on ROBOT (TOML), and how well it would know the parameters.

    The run is that of an EXPERIMENT (TOML), one at POSES (CSV, a column for each joint), or else one at poses that are
    chosen here: those that show most of all effects, and as many that fill the workspace.
    """
    if planned is not None and (verify or poses is not None or to is not None):
        given = "--verify" if verify else "--poses" if poses is not None else "-o"
        raise click.UsageError(
            f"{given} is of poses that are chosen here, and takes no {planned}: leave one of them out"
        )
    if verify:
        _verifying(robot, machine, poses or _OF_CHECK, to, as_json=as_json)
        return
    if machine is not None:
        raise click.UsageError("--machine belongs to --verify: name the machine's file in place of ROBOT")
    nominal, _ = robot_at(robot)
    noise = _noise(robot, nominal, {"µm": noise_um, "px": noise_px})
    run = _planned(robot, nominal, planned, poses or _OF_RUN, repeats, pace_s)
    rows = run.rows
    planning = planning_of(model_of(nominal), rows, noise / rows.layout.per_unit, effects=effects)
    effect_powers = planning.effect_powers
    found = _study(planning, effect_powers, runs, keep, workers) if runs else ()
    if to is not None:
        _write(run.poses, rows.layout, to)
    if as_json:
        output.print_json(_json(run, planning, effect_powers, found))
        return
    output.say(f"{run.said}, {noise:g} {rows.layout.unit} noise\n")
    _show_effects(effect_powers, rows.layout.unit)
    for line in _sentences(effect_powers):
        output.say(line)
    # what these poses could not tell from where the sensor stands, and what would
    model = planning.model
    taken = taken_by_pose(model, rows, np.zeros(len(model.parameters)), tuple(model.known_effects.values()))
    if (told := pose_in_words((), taken)) is not None:
        output.say(told)
    _show_parameters(planning)
    if found:
        _show_study(found)
    if to is not None:
        output.say(f"Written to {to}: measure its rows from the first to the last, fill in what is read, then "
                   f"sherkit check {to} {robot}")  # fmt: skip
    elif run.poses:
        output.say("Write the poses with -o poses.csv.")


@dataclass(frozen=True)
class _ToMeasure:
    """What is to be measured: the ``rows``, in words, how long they take where that is known, and the ``poses`` where
    they were chosen here."""

    rows: Measurements
    said: str
    seconds: float | None = None
    poses: Sequence[Mapping[str, float]] = ()


def _planned(
    path: Path, robot: Robot, planned: Path | None, count: int, repeats: int, pace_s: float | None
) -> _ToMeasure:
    """An experiment's, that of a table of poses, or one of poses that are chosen here."""
    if planned is not None and planned.suffix.lower() == ".toml":
        chosen = load_experiment(planned, robot=path, offline=True)
        long = f"{chosen.seconds / 60:.0f} minutes" if chosen.seconds >= 120 else f"{chosen.seconds:.0f} s"
        return _ToMeasure(
            planned_rows(chosen), f"{chosen.source}: {len(chosen.plan)} steps, about {long}", chosen.seconds
        )
    names = kind_of(robot).layout.joints
    if planned is not None:
        return _ToMeasure(rows_at(_joints(planned, names), model_of(robot), pace_s), str(planned))
    found = poses_to_measure(robot, count, repeats=repeats)
    joints = np.array([[one[name] for name in names] for one in found])
    often = {1: "once", 2: "twice"}.get(repeats, f"{repeats} times")
    said = f"{path}: {count} poses, each read {often}"
    return _ToMeasure(rows_at(joints, model_of(robot), pace_s), said, poses=found)


def _joints(path: Path, names: Sequence[str]) -> Floats:
    """Joint readings (n, k) of a table of poses."""
    try:
        frame = read_table(checked(path))
    except pl.exceptions.PolarsError as error:
        raise SherkitError(f"{path}: is no table of poses: {str(error).splitlines()[0]}") from None
    for name in names:
        if name not in frame.columns:
            raise SherkitError(f"{path}: has no column '{name}'; poses have one for each joint: {listed(names)}")
        column = frame[name].cast(pl.Float64, strict=False)
        wrong = column.is_null() | ~column.is_finite()
        if wrong.any():
            raise SherkitError(f"{path}: row {wrong.arg_true()[0] + 1}, column '{name}': expected a number")
    if not len(frame):
        raise SherkitError(f"{path}: has no row; expected a pose in each")
    return frame.select(pl.col(names).cast(pl.Float64)).to_numpy()


def _write(poses: Sequence[Mapping[str, float]], layout: Layout, path: Path) -> None:
    """A table of poses with a place for what is read."""
    frame = pl.DataFrame(list(poses))
    names = [name for name in (TIME, *layout.coordinates) if name not in frame.columns]
    write_table(frame.with_columns(pl.lit(None, dtype=pl.Float64).alias(name) for name in names), path)


def _verifying(calibration: Path, machine: Path | None, count: int, to: Path | None, *, as_json: bool) -> None:
    """The poses of an interim check."""
    from ...changes import verifying_poses

    made = calibration_at(calibration, machine)
    found = verifying_poses(made, count)
    if to is not None:
        layout = kind_of(made.robot).layout
        _write([{name: pose[name] for name in ("pose", *layout.joints)} for pose in found], layout, to)
    if as_json:
        output.print_json({"poses": found})
        return
    shown = table(f"{len(found)} poses that see most of what may have changed since", *found[0],
                  note="in this order; then: sherkit verify")  # fmt: skip
    for pose in found:
        shown.add_row(*[f"{value:.6g}" for value in pose.values()])
    out.print(shown)


def _noise(path: Path, robot: Robot, given: dict[str, float | None]) -> float:
    """Standard deviation of a reading of this robot, in the unit in which people read it."""
    unit = kind_of(robot).layout.unit
    if unit not in given:
        raise SherkitError(f"{path}: is a {robot.kind} robot, read in {unit}; noise is known in {listed(given)}")
    if any(value is not None for other, value in given.items() if other != unit):
        raise SherkitError(f"{path}: is a {robot.kind} robot; its noise is --noise-{in_names(unit)}")
    chosen = given[unit]
    return _NOISE[unit] if chosen is None else chosen


def planned_rows(experiment: Experiment) -> Measurements:
    """The rows that the plan will give: joints, directions and, as far as they are known, times."""
    plan = experiment.plan
    directions = {f"direction_{k + 1}": d for k, d in enumerate(plan.directions.T)}
    return Measurements.planned(
        np.array([s.joints for s in plan]),
        kind_of(experiment.robot).layout,
        experiment.source,
        time_s=experiment.times_s,
        **directions,
    )


def _study(
    planning: Planning, effect_powers: tuple[EffectPower, ...], runs: int, keep: Path | None, workers: int | None
) -> tuple[DetectionCount, ...]:
    """Every effect at the size that is promised to be found in 80 of 100 runs, each parameter with a sign of its own.

    Those that take many times their plausible size are left out: the model is not linear so far from the drawing.
    """
    rng = np.random.default_rng(0)
    sought = []
    for o in effect_powers:
        if o.missing_columns or not np.isfinite(o.times):
            continue
        sizes = {p.name: p.size for p in planning.effect(o.name).parameters}
        for _ in range(_SIGNS):
            # along some signs the fitted parameters may take all of it
            values = planning.found_along(o.name, {k: v * float(rng.choice((-1.0, 1.0))) for k, v in o.values.items()})
            if all(abs(v) <= _LARGEST_STUDIED * sizes[k] for k, v in values.items()):
                sought.append(EffectSize(o.name, values))
                break
    columns = (TextColumn("simulating robots"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=output.err, transient=True, disable=not output.err.is_terminal) as shown:
        task = shown.add_task("")
        return study_power(
            planning, sought, runs=runs, workers=workers, path=keep,
            progress=lambda done, total: shown.update(task, completed=done, total=total),
        )  # fmt: skip


def _show_effects(effect_powers: tuple[EffectPower, ...], unit: str) -> None:
    made = table(
        f"What it could find (level {LEVEL:g}, power {POWER:g})", "effect", "found", "smallest", f"leaves {unit}",
        "absorbed", "tied with", note="found: its chance at its plausible size. smallest: in plausible sizes, and the "
        "RMS that it leaves there. absorbed: by the fitted parameters.",
    )  # fmt: skip
    for o in effect_powers:
        if o.missing_columns:
            made.add_row(o.name, "", "", "", "", f"[dim]needs {listed(o.missing_columns)}[/]")
            continue
        smallest = f"{o.times:.3g} ×" if np.isfinite(o.times) else "never"
        made.add_row(o.name, f"{100 * o.power:.0f} %", smallest, f"{o.left_um:.2f}", f"{100 * o.absorbed:.1f} %",
                     listed(o.indistinguishable))  # fmt: skip
    out.print(made)


def _sentences(effect_powers: tuple[EffectPower, ...]) -> list[str]:
    seen = [o for o in effect_powers if not o.missing_columns]
    named = {
        "At its plausible size it would rather be missed": [o.name for o in seen if o.power < POWER],
        "The fitted parameters would take nearly all of": [o.name for o in seen if o.is_absorbed],
        "Found, but not told from what it is tied with": [o.name for o in effect_powers if o.indistinguishable],
    }
    return [f"{said}: {listed(names)}." for said, names in named.items() if names]


def _show_parameters(planning: Planning) -> None:
    made = table(
        "How well the parameters would be known", "parameter", "standard deviation", "µm where it acts",
        note=f"Of {len(planning.parameters)} parameters {planning.design.rank} directions are observed; the others are "
        "held.",
    )  # fmt: skip
    for p, std in zip(planning.parameters, planning.design.std.tolist(), strict=True):
        made.add_row(p.name, sized(std, p.unit), f"{1e3 * std * p.lever_mm:.3g}")
    out.print(made)


def _show_study(found: tuple[DetectionCount, ...]) -> None:
    made = table("What simulated robots say", "effect", "promised", "found", "of runs")
    for one in found:
        made.add_row(one.name, f"{100 * one.power:.0f} %", f"{100 * one.share:.1f} %", str(one.runs))
    out.print(made)


def _json(
    run: _ToMeasure, planning: Planning, effect_powers: tuple[EffectPower, ...], found: tuple[DetectionCount, ...]
) -> dict[str, Any]:
    def number(value: float) -> float | None:
        return float(value) if np.isfinite(value) else None

    return {
        "steps": len(run.rows),
        "seconds": run.seconds,
        **({"poses": list(run.poses)} if run.poses else {}),
        "level": planning.level,
        "effects": [
            {
                "name": o.name, "link": o.link, "missing_columns": list(o.missing_columns), "power": number(o.power),
                "smallest_in_plausible_sizes": number(o.times),
                "smallest": {k: number(v) for k, v in o.values.items()}, "left_um": number(o.left_um),
                "absorbed": number(o.absorbed), "indistinguishable": list(o.indistinguishable),
            }
            for o in effect_powers
        ],
        "parameters": [
            {"name": p.name, "unit": p.unit, "std": float(std)}
            for p, std in zip(planning.parameters, planning.design.std, strict=True)
        ],
        "rank": planning.design.rank,
        "study": [{"name": f.name, "promised": f.power, "found": f.found, "runs": f.runs} for f in found],
    }  # fmt: skip
