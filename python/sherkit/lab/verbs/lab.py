"""``sherkit lab``: a laboratory of emulated instruments on ports of this machine, and the demo in it."""

from __future__ import annotations

import signal
import tempfile
import threading
import time
import tomllib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import click
import numpy as np
import tomli_w
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

from ...calibration import calibrate
from ...cli import output
from ...cli.demo import EXAMPLE
from ...cli.diagnose import print_diagnosis
from ...cli.file_kinds import CALIBRATION, PLANNED, PORTS, ROBOT, TABLE
from ...cli.paths import InputFile, OutputFile, OutputFolder
from ...data import read_measurements
from ...data.files import write_whole
from ...errors import ExperimentError
from ...model.robot_file import load_robot
from ...robots.delta.robot import POSITION
from ...study import Study
from ..experiment import Live, RunFile, RunProgress, export_run, load_experiment, run
from ..laboratory import RunningLaboratory, load_laboratory
from .measure import signals_to, until_diagnosed

_LOOPBACK = ("127.", "localhost")
_DEMO = Path("demo-lab")
#: What the demo writes besides its runs.
_DEMO_FOLDER = OutputFolder({
    "robot.toml": ROBOT, "lab.toml": PLANNED, "ports.json": PORTS, "twelve.toml": CALIBRATION,
    "calibrated.toml": CALIBRATION, "local.csv": TABLE, "adaptive.csv": TABLE,
    **{f"{name}.toml": PLANNED for name in ("local", "check_drawn", "check_twelve", "check_calibrated", "adaptive")},
})  # fmt: skip


@click.command()
@click.argument("laboratory", type=InputFile(), required=False)
@click.option("--ports", type=OutputFile(PORTS), help="Write the addresses into this file (JSON).")
@click.option("--host", help="Listen on this address of the machine; left out, for programs of this machine alone.")
@click.option("--time-scale", type=click.FloatRange(min=0, min_open=True), help="Run so much faster than real time.")
@click.option("--json", "as_json", is_flag=True, help="Print the addresses as JSON.")
@click.option("--demo", is_flag=True, help="Start a laboratory, find what is hidden in its robot, and compensate it.")
@click.option("-o", "--output", "folder", type=_DEMO_FOLDER, show_default=str(_DEMO),
              help="Where --demo puts its files.")  # fmt: skip
def lab(
    laboratory: Path | None, ports: Path | None, host: str | None, time_scale: float | None, as_json: bool, demo: bool,
    folder: Path | None,
) -> None:  # fmt: skip
    """Start the emulated instruments of LABORATORY (TOML), until Ctrl-C; without one, those of an example."""
    if demo:
        lab_demo(folder or _DEMO_FOLDER.checked(_DEMO, "--output"))
        return
    if laboratory is None:
        with tempfile.TemporaryDirectory() as example:
            chosen = replace(load_laboratory(write_laboratory(Path(example))), source="example")
    else:
        chosen = load_laboratory(laboratory)
    if host is not None:
        chosen = replace(chosen, host=host)
    if time_scale is not None:
        chosen = replace(chosen, time_scale=time_scale)
    if not chosen.host.startswith(_LOOPBACK):
        output.warn(f"the emulators listen on {chosen.host}: every machine that reaches it can drive them")
    over = threading.Event()
    with signals_to(lambda *_: over.set(), signal.SIGINT, signal.SIGTERM), RunningLaboratory(chosen) as running:
        if ports is not None:
            running.write_ports(ports)
        if as_json:
            output.print_json(running.ports())
        else:
            _show(running)
        output.out.file.flush()
        while not over.wait(0.2):
            pass


def _show(running: RunningLaboratory) -> None:
    lab = running.laboratory
    scale = f"; its clock runs {lab.time_scale:g} times as fast" if lab.time_scale != 1 else ""
    made = output.table(f"{lab.source}: instruments around a virtual {lab.robot.kind} robot{scale}", "instrument",
                        "kind", "address", note="Ctrl-C ends the laboratory.")  # fmt: skip
    for name, one in running.ports().items():
        made.add_row(name, one["kind"], one["address"])
        if "page" in one:
            made.add_row("", "its page", one["page"])
    output.out.print(made)


# -- The demo in a laboratory -----------------------------------------------------------------------------------------

_LIMITS_MM = (60.0, 200.0)
_TIME_SCALE = 50.0
_LABORATORY = """\
# A virtual delta that is not as drawn, and the instruments around it: 'sherkit lab lab.toml' starts them.
robot = "robot.toml"
seed = 6
time_scale = {time_scale}

[hidden]
errors = 1.0            # geometric errors of the size of the paper's Table II
rail_lean_mrad = 8.0    # and rails that lean: what the geometric model does not know

[[instrument]]
name = "rails"
kind = "galil"
counts_per_mm = 10000
chatty = 0.02           # text of the controller's own program comes in between
pieces = 3              # and answers come in pieces

[[instrument]]
name = "lasers"
kind = "keyence"
noise_mm = 0.005
noise_of_place = true   # a run that was interrupted reads the same when it goes on
"""
_EXPERIMENT = """\
# {what}: 'sherkit measure {name}.toml' while the laboratory runs.
robot = "robot.toml"
ports = "ports.json"

{plan}

[settle]
seconds = {settle}            # two in the paper, on this laboratory's clock

[goal]
std_um = 10.0

[retry]
attempts = 3            # a busy computer may answer late

[[instrument]]
name = "rails"
kind = "galil"
counts_per_mm = 10000
speed_mm_s = 10.0
poll_s = 0.002

[[instrument]]
name = "lasers"
kind = "keyence"
"""
_PLANS = {
    "local": ("The paper's experiment in the region of interest", '[plan]\nposes = "paper_local"\norder = "shuffled"\n'
              "repeats = {repeats}\nseed = 1"),
    "check_drawn": ("Places that were not measured before, by the drawing", "[plan]\n{check}"),
    "check_twelve": ("The same places with the paper's twelve parameters", '[plan]\n{check}\nthrough = "twelve.toml"'),
    "check_calibrated": ("The same places through the calibration", '[plan]\n{check}\nthrough = "calibrated.toml"'),
    "adaptive": ("No poses: the robot chooses them until it is known what is missing",
                 "[adaptive]\nbudget = 200\nspan_min = {span_min}\nrequired_um = 20.0"),
}  # fmt: skip
_CHECKED = 40
#: Over which time the robot that chooses its poses is judged, on the laboratory's clock.
_SPAN_MIN = 10.0
#: Experiments whose misses are compared, and how the robot was sent there.
_COMPARED = {
    "check_drawn": "by the drawing",
    "check_twelve": "with the twelve parameters",
    "check_calibrated": "and the effect that was found",
}


def lab_demo(folder: Path, *, repeats: int = 2, time_scale: float = _TIME_SCALE) -> None:
    """Writes the files, starts the laboratory, measures, diagnoses, calibrates, and measures again."""
    _anew(folder, experiments(repeats, time_scale))
    write_files(folder, repeats, time_scale)
    with RunningLaboratory(load_laboratory(folder / "lab.toml")) as lab:
        lab.write_ports(folder / "ports.json")
        output.out.print(
            "[bold]SIMULATION.[/] A virtual delta behind emulated instruments; what drives them are the real drivers "
            f"on pseudo-terminals. Its clock runs {time_scale:g} times as fast."
        )
        for name, one in lab.ports().items():
            output.say(f"  {name} ({one['kind']}): {one['address']}")
        took = _measured(folder, "local")
        rows = export_run(folder / "local.sqlite", folder / "local.csv")
        output.say(f"\n{rows} rows in {took:.0f} s: {folder}/local.sqlite, exported to local.csv\n")
        study = Study(load_robot(folder / "robot.toml"), read_measurements(folder / "local.csv"))
        with output.steps(12) as step:
            found = study.diagnose(step=step)
            for name in found.effects:
                study.add(name)
        calibrate(study.robot, study.data, correction="none").calibration.save(folder / "twelve.toml")
        output.out.rule("What is missing?")
        print_diagnosis(found)
        calibration = study.calibration()
        calibration.save(folder / "calibrated.toml")
        output.out.rule("Deployed back")
        for name in _COMPARED:
            _measured(folder, name)
        _compare(folder, lab)
        output.out.rule("And without a plan: the robot measures until it is known")
        chosen = folder / "adaptive.toml"
        experiment = load_experiment(chosen)
        until_diagnosed(experiment, chosen, experiment.run_path)
        export_run(experiment.run_path, folder / "adaptive.csv")
    output.say(
        f"\nTo do it yourself, in {folder}/: sherkit lab lab.toml --ports ports.json, and in another terminal\n"
        "  sherkit measure local.toml --live -o again.sqlite\n"
        "  sherkit measure adaptive.toml --until diagnosed -o known.sqlite"
    )


def write_laboratory(folder: Path, time_scale: float = 1.0) -> Path:
    """Writes ``robot.toml`` and ``lab.toml`` of the example; returns the latter."""
    folder.mkdir(parents=True, exist_ok=True)
    tables = EXAMPLE.to_tables()
    tables["joints"] = {**tables.get("joints", {}), "limits_mm": list(_LIMITS_MM)}
    write_whole(folder / "robot.toml", tomli_w.dumps(tables))
    write_whole(folder / "lab.toml", _LABORATORY.format(time_scale=time_scale))
    return folder / "lab.toml"


def write_files(folder: Path, repeats: int, time_scale: float) -> None:
    """Writes the laboratory and the experiments of the demo."""
    write_laboratory(folder, time_scale)
    for name, text in experiments(repeats, time_scale).items():
        write_whole(folder / f"{name}.toml", text)


def experiments(repeats: int, time_scale: float) -> dict[str, str]:
    """The text of each experiment's file, by name."""
    rng = np.random.default_rng(7)
    places = np.round(rng.uniform(-9.0, 9.0, (_CHECKED, 3)), 2).tolist()
    check = f'poses = "list"\nlist_mm = {places}'
    return {
        name: _EXPERIMENT.format(
            what=what, name=name, settle=2.0 / time_scale,
            plan=plan.format(repeats=repeats, check=check, span_min=_SPAN_MIN / time_scale),
        )
        for name, (what, plan) in _PLANS.items()
    }  # fmt: skip


def _anew(folder: Path, texts: Mapping[str, str]) -> None:
    """Takes the runs of an earlier demo away: those that were measured by its very experiments.

    Raises :class:`~sherkit.errors.ExperimentError`, before anything is taken away, for a run of somebody else's.
    """
    runs = {folder / f"{name}.sqlite": text for name, text in texts.items()}
    for run_path, text in runs.items():
        if run_path.exists() and run_path.stat().st_size:
            with RunFile.open(run_path) as file:
                if file.about("experiment") != tomli_w.dumps(tomllib.loads(text)):
                    raise ExperimentError(
                        f"{run_path}: holds a run that is none of this demo's; give -o another folder"
                    )
    for run_path in runs:
        for ending in ("", "-wal", "-shm", ".lock"):
            Path(f"{run_path}{ending}").unlink(missing_ok=True)


def _measured(folder: Path, name: str) -> float:
    """Runs an experiment from the beginning; returns seconds."""
    experiment = load_experiment(folder / f"{name}.toml")
    live = Live(experiment.robot, experiment.plan, experiment.goal) if name == "local" else None
    began = time.monotonic()
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TextColumn("{task.fields[model]}"))
    with (
        Progress(*columns, console=output.err, disable=not output.err.is_terminal) as shown,
        RunFile.create(experiment.run_path, experiment.plan, experiment.about()) as file,
        experiment.bench() as bench,
    ):
        task = shown.add_task(f"measuring {name}", total=len(experiment.plan), model="")

        def report(now: RunProgress) -> None:
            if live is not None:
                live.add(now.point)
            shown.update(task, completed=now.stored, model=live.short() if live is not None else "")

        run(experiment.plan, bench, file, attempts=experiment.attempts, report=report)
    if live is not None:
        output.say(live.sentence())
    return time.monotonic() - began


def _compare(folder: Path, lab: RunningLaboratory) -> None:
    """How far the robot is from where it was sent: as the lasers saw it, and as it was in truth."""
    made = output.table(
        f"Distance from {_CHECKED} commanded places, µm", "sent there", "RMS seen", "largest seen", "RMS in truth",
        "largest in truth", note="Seen by the lasers, whose own noise is 5 µm in each axis.",
    )  # fmt: skip
    for name, called in _COMPARED.items():
        experiment = load_experiment(folder / f"{name}.toml")
        with RunFile.open(experiment.run_path) as file:
            points = file.points()
        seen = np.array([[p.values[axis] for axis in POSITION] for p in points])
        joints = np.array([s.joints for s in experiment.plan])
        true = np.array([lab.bench.position(q, 0.0) for q in joints])
        row = []
        for there in (seen, true):
            miss = 1e3 * np.linalg.norm(there - experiment.targets, axis=1)
            row += [np.sqrt(np.mean(miss**2)), miss.max()]
        made.add_row(called, *[f"{v:.1f}" for v in row])
    output.out.print(made)
