"""``sherkit measure`` and ``sherkit export``: experiments, and what they leave."""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Iterator
from pathlib import Path
from types import FrameType
from typing import NoReturn

import click
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

from ..data.files import write_whole
from ..lab.experiment import Control, Experiment, Live, RunFile, RunProgress, export_run, load_experiment, run
from ..robots.c_row import c_row
from ..robots.files import load_calibration
from ..robots.tool.c_header import c_header
from ..robots.tool.tool import load_tool
from ..robots.tool_file import is_tool
from . import keys, output

#: Signals by which another program, or a closing terminal, asks for an end; not every system has both.
_POLITE = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]


@click.command()
@click.argument("experiment", type=click.Path(path_type=Path))
@click.option("-o", "--output", "destination", type=click.Path(path_type=Path),
              help="The run file (SQLite); by default the one that the experiment names.")  # fmt: skip
@click.option("--resume", is_flag=True, help="Go on with a run that was interrupted, at its first missing step.")
@click.option("--accept", is_flag=True, help="With --resume: rows that were marked as in doubt are right.")
@click.option("--live", "is_live", is_flag=True, help="Identify while the rows come in, and say when they are enough.")
@click.option("--ports", type=click.Path(path_type=Path), help="Addresses by instrument, as 'sherkit lab' wrote them.")
def measure(
    experiment: Path, destination: Path | None, resume: bool, accept: bool, is_live: bool, ports: Path | None
) -> None:
    """Run EXPERIMENT (TOML): drive to each pose, read the instruments, store.

    Nothing moves before the controller has proven where its axes are ('sherkit home'), and the run ends where sensors
    and joints cannot both be right. Keys: p pauses after the present step and goes on, q ends after it. Ctrl-C stops
    the motors at once.
    """
    chosen = load_experiment(experiment, ports)
    path = destination or chosen.run_path
    live = Live(chosen.robot, chosen.plan, chosen.goal, fitting=is_live)
    begin = RunFile.resume if resume else RunFile.create
    with begin(path, chosen.plan, chosen.about()) as file, _ended_by_signals():
        if accept:
            output.say(f"{file.accept()} rows that were in doubt are taken as right")
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
        "ended": f"ended; go on with: sherkit measure {experiment} --resume",
    }
    output.say(f"{stored} of {len(chosen.plan)} steps are in {path}: {ends[why]}")
    if is_live:
        output.say(live.sentence())
    output.say(f"Take them out with: sherkit export {path} -o {path.with_suffix('.csv')}")


def _measure(chosen: Experiment, file: RunFile, live: Live) -> str:
    control = Control()
    columns = (
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TextColumn("{task.fields[left]}"),
        TextColumn("{task.fields[model]}"),
    )  # fmt: skip
    shown = Progress(*columns, console=output.err, disable=not output.err.is_terminal)
    task = shown.add_task("measuring", total=len(chosen.plan), completed=len(file.done()), left="", model="")
    told = False

    def pressed(key: str) -> None:
        if key == "p":
            (control.resume if control.paused else control.pause)()
            shown.update(task, description="paused" if control.paused else "measuring")
        elif key == "q":
            control.end()
            shown.update(task, description="ending")

    def report(now: RunProgress) -> None:
        nonlocal told
        live.add(now.point)
        model = live.short()
        if live.enough and not told:
            told = True
            output.err.print(f"[bold green]enough:[/] {live.sentence()}", soft_wrap=True)
        if live.enough and live.goal is not None and live.goal.stop:
            control.end()
        shown.update(task, completed=now.stored, left=_left(now.seconds_left), model=model)
        if not output.err.is_terminal:
            # a program that reads this may count on the step: it is on the disk
            print(f"stored {now.step}: {now.stored} of {now.total}{', ' + model if model else ''}", flush=True)

    with shown, keys.listening(pressed) as heard, chosen.bench() as bench:
        if heard:
            output.err.print("p pauses and goes on, q ends after this step, Ctrl-C stops at once", style="dim")
        why = run(chosen.plan, bench, file, control=control, warm_up_s=chosen.warm_up_s,
                  attempts=chosen.attempts, report=report)  # fmt: skip
    return "goal" if why == "ended" and live.enough else why


def _left(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d} left"


@contextlib.contextmanager
def _ended_by_signals() -> Iterator[None]:
    """A polite end by another program stops the motors as Ctrl-C does."""

    def end(number: int, frame: FrameType | None) -> NoReturn:
        del frame
        raise SystemExit(128 + number)

    before = {n: signal.signal(n, end) for n in _POLITE}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@click.command()
@click.argument("what", nargs=-1, required=True, metavar="RUN_FILE | c CALIBRATION | c TOOL")
@click.option("-o", "--output", "destination", type=click.Path(path_type=Path), required=True,
              help="CSV or Parquet of a run; a C header of a calibration or tool.")  # fmt: skip
def export(what: tuple[str, ...], destination: Path) -> None:
    """Write the rows of RUN_FILE as CSV or Parquet, also while it is being measured; with c, a CALIBRATION or a
    flexible TOOL as a C header for the control loop."""
    if len(what) == 1:
        rows = export_run(Path(what[0]), destination)
        output.say(f"{rows} rows written to {destination}", destination)
        return
    if len(what) != 2 or what[0] != "c":
        raise click.UsageError("expected the file of a run, or c and the file of a calibration or flexible tool")
    source = Path(what[1])
    made, more = (_tool_in_c if is_tool(source) else _robot_in_c)(source)
    write_whole(destination, made)
    output.say(
        f"{destination} written; a loop includes it and links libsherkit.a, which cargo build --profile control "
        f"-p sherkit-c makes.{more}"
    )


def _robot_in_c(source: Path) -> tuple[str, str]:
    """Its header, and what else to say."""
    return c_row(load_calibration(source), source.name), ""


def _tool_in_c(source: Path) -> tuple[str, str]:
    """Its header, and what else to say."""
    tool = load_tool(source)
    if tool.noise != "propagated":
        output.warn(f"{source}: noise '{tool.noise}' is for comparisons; the loop in C runs the filter of 'propagated'")
    more = " No CMake is needed: rust/c/examples/replay replays a CSV file with it"
    return c_header(tool, source.name), more
