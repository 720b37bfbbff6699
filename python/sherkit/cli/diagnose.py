"""``sherkit diagnose``: which effect is missing."""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Sequence
from pathlib import Path

import click
from rich.markup import escape
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from ..base.answer import FILES
from ..data.files import write_whole
from ..diagnosis import Diagnosis, largest, template
from ..diagnosis import diagnose as run_diagnosis
from ..diagnosis.findings import figure, p_value, plausibility
from ..diagnosis.next_poses import SEPARATION
from ..diagnosis.result import APART, MISSING, NEXT, WHERE, WHICH, Check, Finding
from ..diagnosis.selection import adopting
from ..fit.identify import identify
from ..model.effect import effects_by_name, load_effects
from ..model.kinds import model_of
from ..model.thermometers import thermometers_of
from . import output
from .file_kinds import TEMPLATE, TOOL
from .machine_file import machine_at
from .next_command import completed, in_json
from .output import columns_option, out, report_option, table
from .paths import InputFile, OutputFile


@click.command()
@click.argument("robot", type=InputFile())
@click.argument("runs", type=InputFile(), nargs=-1, required=True, metavar="RUN [MORE]...")
@click.option("--json", "as_json", is_flag=True, help="Print JSON for programs instead of tables.")
@click.option("--checks", "every_check", is_flag=True, help="List everything that was checked, not only what fails.")
@click.option("--effects", "files", type=InputFile(), multiple=True, help="Python file of your effects.")
@click.option("--effect", "added", multiple=True, help="An effect that is in the model already.")
@click.option("--free", default="", help="Parameters to identify, separated by commas; default: those of its kind.")
@click.option("-o", "--output", "written", type=OutputFile(TOOL),
              help="Of a flexible tool: write it with the effects of --effect and those that were named.")  # fmt: skip
@click.option("--template", "destination", type=OutputFile(TEMPLATE), help="Write an effect of the shape found.")
@click.option("--level", type=click.FloatRange(0.0005, 0.2), default=0.01, show_default=True, help="Of the test.")
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Of random splits.")
@report_option
@columns_option
def diagnose(
    robot: Path, runs: tuple[Path, ...], as_json: bool, every_check: bool, files: tuple[Path, ...],
    added: tuple[str, ...], free: str, written: Path | None, destination: Path | None, level: float, seed: int,
    report: Path | None,
) -> None:  # fmt: skip
    """Say what ROBOT (TOML) is missing on the measurements RUN (CSV or Parquet), joined with MORE measured later.

    ROBOT may be the Python file of a machine, which is run.
    """
    if report is not None:
        output.require_view()
    machine = machine_at(robot)
    machine.require_writable(written)
    own = tuple(effect for path in files for effect in load_effects(path))
    with output.steps(12) as step:
        step(f"reading {runs[0]}")
        model, data = machine.read(runs)
        every = (*own, *thermometers_of(model, data))
        step("identifying the model as it is")
        freed = [name.strip() for name in free.split(",") if name.strip()]
        inside = effects_by_name(model.known_effects, added, every)
        fit = identify(adopting(model_of(model, freed), inside, data), data)
        found = run_diagnosis(fit, effects=own, level=level, seed=seed, step=step)
        said: list[str] = []
        if written is not None:
            found, said = machine.write(written, found)
        if report is not None:
            step("writing the report")
            machine.report(report, found, own=own, added=added, seed=seed, sources=(robot, *runs, *files))
    if as_json:
        output.print_json(in_json(found.to_json(), shlex.join(map(str, machine.told(runs)))))
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


# -- What is said of it -----------------------------------------------------------------------------------------------

_COLOUR = {
    "adequate": "green",
    "explained": "green",
    "partly explained": "yellow",
    "unexplained": "red",
    "undecided": "yellow",
}
_MOST = 8
#: Columns of a screen on which candidates have their parameters beside them.
_WIDE = 105


def _long(d: Diagnosis, value: float) -> str:
    return f"{value:.2f}" if d.unit == "µm" and not 0 < abs(value) < 0.01 else f"{value:.4g}"


def _with_unit(column: str) -> str:
    name, _, unit = column.rpartition("_")
    return f"{name}, {unit}"


def print_diagnosis(d: Diagnosis, *files: Path, every_check: bool = False) -> None:
    """The answer first: verdict, cause and size, error before and after, the next command; then everything that a
    diagnosis found. ``files`` are those of the robot and of its run, for the commands it proposes; of what was checked
    that is said which fails, or ``every_check``."""
    given = shlex.join(map(str, files)) or FILES
    # praise has no colour where nobody knows how much of the rest is noise
    colour = _COLOUR[d.verdict] if d.noise_origin != "unknown" or d.verdict not in ("adequate", "explained") else "cyan"
    output.show(d.answer, *files, colour=colour)
    first, *more = (one for one in d.findings if one.question == MISSING and one.about != "left_out")
    out.print()
    out.print(f"[bold]1. {MISSING}[/]  {escape(str(first))}")
    _say(more)
    if d.smallest_found:
        out.print(_power(d))
    out.print(f"\n[bold]2. {WHERE}[/]")
    out.print(_where(d))
    out.print(f"[bold]3. {WHICH}[/]")
    out.print(_candidates(d))
    out.print(f"\n[bold]4. {APART}[/]")
    _say(one for one in d.findings if one.question == APART)
    out.print(f"\n[bold]5. {NEXT}[/]")
    # what is to be looked for comes before what is to be written
    _say(one for one in d.findings if one.about == "shape")
    _say((one for one in d.findings if one.question == NEXT), given)
    if d.next_poses:
        out.print(_poses(d))
    out.print(falling(d))
    failing = [check for check in d.checks if check.holds is False]
    if every_check or failing:
        out.print(_checks(d.checks if every_check else failing))
    if not every_check:
        holding = sum(check.holds is True for check in d.checks)
        idle = len(d.checks) - holding - len(failing)
        told = [f"{holding} checks passed", *([f"{idle} not applicable"] if idle else [])]
        out.print(f"{', '.join(told)}; --checks lists them")


def _say(findings: Iterable[Finding], files: str = FILES) -> None:
    """Findings one under the other, a line that is too long goes on below its begin."""
    for one in findings:
        said = Text(f"{one.answer}:" if one.command else str(one))
        if one.about == "tie":
            # the names of a tie come first, and before them nothing matters
            said.stylize("bold", 0, said.plain.index(":"))
        out.print(Padding(said, (0, 0, 0, 3), expand=False))
        if one.command:
            # a line of its own, which is copied as one however wide the screen is
            out.print(Text(f"     {completed(one.command, files)}"), soft_wrap=True)


def _checks(checks: Sequence[Check]) -> Table:
    """What the verdict rests on."""
    made = table("What the verdict rests on", "check", "", "result", "p", "rows")
    for check in checks:
        word = {True: "yes", False: "[bold red]no[/]", None: "?"}[check.holds]
        p = "" if check.p is None else p_value(check.p)
        made.add_row(escape(check.tested), word, escape(check.result), p, escape(check.rows))
    return made


def falling(d: Diagnosis) -> Table:
    """The error on poses held out, step by step."""
    made = table("Error on poses held out", "model", f"{d.unit} RMS {d.error.in_words}", "95 % within")
    for s in d.steps:
        made.add_row(s.state, _long(d, s.error.rms), _long(d, s.error.p95))
    if d.elsewhere is not None:
        made.add_row("regions left out whole", _long(d, d.elsewhere.error.rms), _long(d, d.elsewhere.error.p95))
    elif d.fit.data.layout.joints:
        made.add_row("regions left out whole", "too few poses", "", style="dim")
    made.add_row("noise", _long(d, d.noise_size), "", style="dim")
    return made


def _where(d: Diagnosis) -> Table:
    made = table("", "against", "p", f"{d.unit} RMS from its lowest to its highest sextile")
    for line in d.where[:_MOST]:
        made.add_row(line.variable, p_value(line.p_value), "  ".join(figure(d, v) for v in line.rms))
    made.caption = f"correlation with the nearest neighbour in space: {d.neighbour_correlation:.2f}"
    return made


def _candidates(d: Diagnosis) -> Table:
    """Every effect that could be tried; on a narrow screen without their parameters, which report and JSON have."""
    columns = ["effect", "acts at", f"held out {d.unit}", "p", "× plausible size"]
    wide = out.width >= _WIDE
    made = table("", *columns, *(["largest parameter, or what is known"] if wide else []))
    for c in d.candidates:
        name = f"[bold]{escape(c.effect)}[/]" if c.effect in d.effects else escape(c.effect)
        cells = [name, c.link, _long(d, c.held_out_rms), p_value(c.p_value), plausibility(c)]
        made.add_row(*cells, *([largest(d, c)] if wide else []))
    return made


def _power(d: Diagnosis) -> Table:
    made = table(
        "Smallest effects that would have been found (80 % power)",
        "effect",
        "× plausible size",
        f"leaves {d.unit} RMS",
    )
    for name, (size, rms) in d.smallest_found.items():
        made.add_row(escape(name), f"{size:.2g}" if size < 1e6 else "never", _long(d, rms) if rms < 1e6 else "")
    return made


def _poses(d: Diagnosis) -> Table:
    axes = [name for name in d.next_poses[0] if name != SEPARATION]
    made = table("Poses to measure next, in this order", "", *map(_with_unit, axes), "separation with it, σ")
    for k, pose in enumerate(d.next_poses, start=1):
        made.add_row(str(k), *(f"{pose[a]:.6g}" for a in axes), f"{pose[SEPARATION]:.1f}")
    return made
