"""``sherkit measure``: experiments, watched while they run; ``home``: the zero of axes."""

from __future__ import annotations

import contextlib
import os
import select
import shlex
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import FrameType
from typing import NoReturn

import click
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

from ...base.figures import listed
from ...cli import output
from ...cli.file_kinds import PAGE, RUN
from ...cli.next_command import completed
from ...cli.paths import InputFile, OutputFile
from ...errors import ExperimentError, ShapeError
from ...model.kinds import kind_of
from ..experiment import AdaptiveRun, Control, Experiment, Live, Plan, RunFile, RunProgress, load_experiment, run
from ..instruments import AxisController

#: Signals by which another program, or a closing terminal, asks for an end; not every system has both.
_POLITE = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]


def _again(experiment: Path) -> str:
    """The command that goes on with a run, with the options that it was begun with."""
    command = completed(f"sherkit measure {shlex.quote(str(experiment))}")
    return command if "--resume" in shlex.split(command) else f"{command} --resume"


@click.command()
@click.argument("experiment", type=InputFile())
@click.option("-o", "--output", "destination", type=OutputFile(RUN),
              help="The run file (SQLite); by default the one that the experiment names.")  # fmt: skip
@click.option("--resume", is_flag=True, help="Go on with a run that was interrupted, at its first missing step.")
@click.option("--accept", is_flag=True, help="With --resume: rows that were marked as in doubt are right.")
@click.option("--live", "is_live", is_flag=True, help="Identify while the rows come in, and say when they are enough.")
@click.option(
    "--until",
    type=click.Choice(["diagnosed"]),
    help="The robot chooses its poses itself, by [adaptive], until it is known what is missing.",
)
@click.option(
    "--report",
    type=OutputFile(PAGE),
    help="With --until: a page that shows the run while it goes on, and its story afterwards.",
)
@click.option("--ports", type=InputFile(), help="Addresses by instrument, as 'sherkit lab' wrote them.")
@output.OWN_INSTRUMENTS
def measure(
    experiment: Path, destination: Path | None, resume: bool, accept: bool, is_live: bool, until: str | None,
    report: Path | None, ports: Path | None, python: tuple[Path, ...],
) -> None:  # fmt: skip
    """Run EXPERIMENT (TOML): drive to each pose, read the instruments, store.

    Nothing moves before the controller has proven where its axes are ('sherkit home'), and the run ends where sensors
    and joints cannot both be right. Keys: p pauses after the present step and goes on, q ends after it. Ctrl-C stops
    the motors at once.
    """
    output.say_that_code_runs(python)
    chosen = load_experiment(experiment, ports, python=python)
    path = destination or OutputFile(RUN).checked(chosen.run_path, f"the run file that {experiment} names")
    if until is not None:
        if report is not None:
            output.require_view()
        until_diagnosed(chosen, experiment, path, resume=resume, accept=accept, report=report)
        return
    if chosen.adaptive is not None and all(step.reason for step in chosen.plan):
        raise ExperimentError(
            f"{experiment}: has no [plan]: let the robot choose its poses with --until diagnosed, or list some"
        )
    live = Live(chosen.robot, chosen.plan, chosen.goal, fitting=is_live)
    with _begun(chosen, path, chosen.plan, resume=resume, accept=accept) as file:
        if is_live:
            # what is in the file already counts
            for point in file.points():
                live.take(point)
            live.refit()
        why = _measure(chosen, file, live)
        stored = len(file.done())
    ends = {
        "complete": "complete",
        "goal": "ended early, since the goal is reached",
        "ended": f"ended; go on with: {_again(experiment)}",
    }
    output.say(f"{stored} of {len(chosen.plan)} steps are in {path}: {ends[why]}")
    if is_live:
        output.say(live.sentence())
    output.say(f"Take them out with: sherkit export {path} -o {path.with_suffix('.csv')}")


def until_diagnosed(
    chosen: Experiment, experiment: Path, path: Path, *, resume: bool = False, accept: bool = False,
    report: Path | None = None,
) -> None:  # fmt: skip
    """Runs an experiment whose poses a loop chooses, into the run file ``path``, and says what it found."""
    if chosen.adaptive is None:
        raise ExperimentError(
            f"{experiment}: [adaptive] is missing: it says within what the robot may choose its poses (budget, "
            "span_min, required_um, box)"
        )
    adaptive = AdaptiveRun(chosen.robot, chosen.adaptive)
    loop = adaptive.loop
    plan = (RunFile.plan_in(path) if resume else None) or adaptive.first()
    with _begun(chosen, path, plan, resume=resume, accept=accept) as file:
        adaptive.take(file)
        looks = len(loop.looks)

        def draw() -> None:
            if report is not None:
                from ...report.pages import write_adaptive

                write_adaptive(
                    report, loop, output.made_by([experiment], [chosen.robot_path, path.with_suffix(".csv")])
                )

        draw()
        if report is not None:
            output.say(f"{report} shows it while it goes on: open it in a browser")

        def more(now: Plan) -> Plan | None:
            nonlocal looks
            further = adaptive.more(file, now)
            if len(loop.looks) > looks:
                looks = len(loop.looks)
                reason = "" if further is None else further.steps[len(now)].reason
                output.say(f"{loop.sentence()}{f'; next: {reason}' if reason else ''}")
                draw()
            return further

        why = _run(chosen, plan, file, lambda *_: loop.verdict, more)
        stored = len(file.done())
    if why == "ended":
        output.say(f"{stored} rows are in {path}: ended; go on with: {_again(experiment)}")
        return
    output.show(loop.answer, chosen.robot_path, path.with_suffix(".csv"))
    output.say(f"{stored} rows are in {path}; take them out with: sherkit export {path} -o {path.with_suffix('.csv')}")


def _measure(chosen: Experiment, file: RunFile, live: Live) -> str:
    told = False

    def took(now: RunProgress, control: Control) -> str:
        nonlocal told
        live.add(now.point)
        if live.enough and not told:
            told = True
            output.err.print(f"[bold green]enough:[/] {live.sentence()}", soft_wrap=True)
        if live.enough and live.goal is not None and live.goal.stop:
            control.end()
        return live.short()

    why = _run(chosen, chosen.plan, file, took)
    return "goal" if why == "ended" and live.enough else why


def _run(
    chosen: Experiment, plan: Plan, file: RunFile, took: Callable[[RunProgress, Control], str],
    more: Callable[[Plan], Plan | None] | None = None,
) -> str:  # fmt: skip
    """Runs a plan and shows how far it is; ``took`` hears of every row, and says in a few words what it makes of it."""
    control = Control()
    columns = (
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TextColumn("{task.fields[left]}"),
        TextColumn("{task.fields[model]}"),
    )  # fmt: skip
    shown = Progress(*columns, console=output.err, disable=not output.err.is_terminal)
    task = shown.add_task("measuring", total=len(plan), completed=len(file.done()), left="", model="")

    def pressed(key: str) -> None:
        if key == "p":
            (control.resume if control.paused else control.pause)()
            shown.update(task, description="paused" if control.paused else "measuring")
        elif key == "q":
            control.end()
            shown.update(task, description="ending")

    def report(now: RunProgress) -> None:
        model = took(now, control)
        left = "" if more else _left(now.seconds_left)
        shown.update(task, completed=now.stored, total=now.total, left=left, model=model)
        if not output.err.is_terminal:
            # a program that reads this may count on the step: it is on the disk
            print(f"stored {now.step}: {now.stored} of {now.total}{', ' + model if model else ''}", flush=True)

    with shown, listening(pressed) as heard, chosen.bench() as bench:
        if heard:
            output.err.print("p pauses and goes on, q ends after this step, Ctrl-C stops at once", style="dim")
        return run(plan, bench, file, control=control, warm_up_s=chosen.warm_up_s, attempts=chosen.attempts,
                   report=report, more=more)  # fmt: skip


def _left(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d} left"


@contextlib.contextmanager
def _begun(chosen: Experiment, path: Path, plan: Plan, *, resume: bool, accept: bool) -> Iterator[RunFile]:
    """The run file, until the run ends. A polite end by another program stops the motors as Ctrl-C does."""

    def end(number: int, frame: FrameType | None) -> NoReturn:
        del frame
        raise SystemExit(128 + number)

    begin = RunFile.resume if resume else RunFile.create
    with begin(path, plan, chosen.about()) as file, signals_to(end, *_POLITE):
        if accept:
            output.say(f"{file.accept()} rows that were in doubt are taken as right")
        yield file


@contextlib.contextmanager
def signals_to(handler: Callable[[int, FrameType | None], object], *numbers: int) -> Iterator[None]:
    """Lets ``handler`` hear of these signals meanwhile."""
    before = {number: signal.signal(number, handler) for number in numbers}
    try:
        yield
    finally:
        for number, one in before.items():
            signal.signal(number, one)


# -- Single keys of a terminal, while something runs ------------------------------------------------------------------

_POLL_S = 0.1


@contextlib.contextmanager
def listening(pressed: Callable[[str], None]) -> Iterator[bool]:
    """Calls ``pressed`` with every key, from a thread; yields whether there is a terminal to hear keys from.

    Ctrl-C stays what it is. The terminal is as before afterwards.
    """
    try:
        import termios
        import tty
    except ImportError:  # no terminals of this kind here: the run goes on without keys
        yield False
        return
    if not sys.stdin or not sys.stdin.isatty():
        yield False
        return
    where = sys.stdin.fileno()
    before = termios.tcgetattr(where)
    ended = threading.Event()

    def listen() -> None:
        while not ended.is_set():
            if select.select([where], [], [], _POLL_S)[0]:
                for key in os.read(where, 16).decode("ascii", "ignore"):
                    pressed(key)

    thread = threading.Thread(target=listen, daemon=True, name="keys")
    try:
        tty.setcbreak(where)
        thread.start()
        yield True
    finally:
        ended.set()
        thread.join(2.0)
        termios.tcsetattr(where, termios.TCSADRAIN, before)


# -- The zero of axes -------------------------------------------------------------------------------------------------


@click.command()
@click.argument("experiment", type=InputFile())
@click.option("--at", metavar="Q1,Q2,…", help="Where the axes stand now, by you; left out: where the plan begins.")
@click.option("--yes", is_flag=True, help="Do not ask: the way is free, or the robot stands where --at says.")
@click.option("--ports", type=InputFile(), help="Addresses by instrument, as 'sherkit lab' wrote them.")
@output.OWN_INSTRUMENTS
def home(experiment: Path, at: str | None, yes: bool, ports: Path | None, python: tuple[Path, ...]) -> None:
    """Set the zero of the axes that EXPERIMENT (TOML) moves, and drive to where its plan begins.

    With home_at_mm (or _rad) in the file, the controller finds its home switches. Without, you bring the robot to a
    known place by hand or by its own panel, and say that it stands there.
    """
    output.say_that_code_runs(python)
    chosen = load_experiment(experiment, ports, python=python)
    names = kind_of(chosen.robot).layout.joints
    with chosen.motion() as motion:
        if motion.is_moving():
            motion.stop()
        _show(motion)
        if motion.home_at is not None and at is None:
            switches = _places(names, motion.home_at, motion.unit)
            question = f"All axes drive to their home switches ({switches}), then to where the plan begins."
            if not yes:
                click.confirm(f"{question} Is the way free?", abort=True)
            motion.enable()
            motion.home()
        else:
            places = chosen.plan.start if at is None else _read(at, len(names))
            output.say(f"1. Bring the robot to {_places(names, places, motion.unit)}, by a gauge or its marks.")
            output.say(
                "2. Check that it stands there. From then on it is taken to be there; then it drives to the start."
            )
            if not yes:
                click.confirm("Does it stand there?", abort=True)
            motion.set_reference(places)
            motion.enable()
        motion.move(chosen.plan.start)
    output.say(f"{motion.name}: zero set; the axes stand where the plan begins "
               f"({_places(names, chosen.plan.start, motion.unit)})")  # fmt: skip


def _show(motion: AxisController) -> None:
    found = motion.reference()
    known = "cannot tell whether it was zeroed" if not found.said else (
        "was zeroed since it was switched on" if found.mark is not None else "was not zeroed since it was switched on"
    )  # fmt: skip
    now = _places([a.label for a in motion.axes], found.positions, motion.unit)
    output.say(f"{motion.name} {known}; its encoders say {now}")


def _read(text: str, count: int) -> tuple[float, ...]:
    try:
        places = tuple(float(word) for word in text.split(","))
    except ValueError:
        places = ()
    if len(places) != count:
        raise ShapeError(f"--at {text}: expected {count} numbers parted by commas, one for each axis")
    return places


def _places(names: Sequence[str], places: Sequence[float], unit: str) -> str:
    return listed(
        [f"{name.rpartition('_')[0] or name} = {q:.4g} {unit}" for name, q in zip(names, places, strict=True)]
    )
