"""The demo's story on one screen: what the geometry leaves, which effect, the fall, the positions, what to open."""

from __future__ import annotations

from pathlib import Path
from textwrap import fill

from rich.markup import escape

from ..base.figures import number
from ..base.names import NOMINAL
from ..diagnosis import Diagnosis
from ..model.kinds import required_um
from ..study import Study
from .output import out, say

_WIDTH, _BAR, _NAME = 78, 34, 30


def story(
    study: Study, found: Diagnosis, missed_um: tuple[float, float], targets: int, folder: Path, report: Path | None
) -> None:
    """Prints it. ``missed_um`` are distances (RMS) from the ``targets`` commanded places, as drawn and calibrated."""
    out.print("[bold]SIMULATION.[/] A virtual delta robot, built a little wrong, with rails that lean,")
    out.print(f"is measured at {targets} places by an instrument with a noise of 5 µm.\n")
    unit = study.data.layout.unit
    noise, first = found.noise_size, study.history[0].error
    needed = required_um(study.robot)
    asked = f"; {needed:g} {unit} are needed" if needed else ""
    _head(1, "What calibrating the geometry leaves")
    _tell(
        f"{number(first.rms)} {unit} RMS {first.in_words} at places it was not fitted to, 95 % within "
        f"{number(first.p95)}; noise alone is {number(noise)}{asked}."
    )
    _head(2, "Which effect is missing")
    _tell(found.headline[:1].upper() + found.headline[1:] + ".")
    for name in found.effects:
        effect = study.model.known_effects[name]
        _tell(f"{effect.physics} {effect.remedy}")
    others = [c for c in found.candidates if c.effect not in found.effects]
    if found.effects and others:
        _tell(f"The next best, {others[0].effect}, would leave {number(others[0].held_out_rms)} {unit}.")
    _head(3, "The fall of the error")
    nominal = study.history[0].fit
    steps = [] if nominal is None else [(NOMINAL, nominal.nominal_error.rms)]
    steps += [(step.action, step.error.rms) for step in study.history]
    for name, value in (*steps, ("noise", noise)):
        _bar(name, value, steps[0][1], unit)
    _head(4, f"Sent to {targets} places, the robot misses them by")
    for name, value in zip((NOMINAL, "through calibrated.toml"), missed_um, strict=True):
        _bar(name, value, missed_um[0], "µm")
    _tell("(RMS in 3-D of where it stands, without the instrument's noise: a reading there adds that)")
    _head(5, "What to open next")
    _next(folder, report)


def _next(folder: Path, report: Path | None) -> None:
    offers = [] if report is None else [(str(report), "all this to look at, in a browser")]
    offers += [
        (f"sherkit app {folder}/robot.toml {folder}/whole.csv", "add effects yourself"),
        ("sherkit demo --tables", "the paper's tables beside these"),
        (
            f"sherkit calibrate {folder}/robot.toml {folder}/whole.csv --local {folder}/local.csv",
            "what a lab would run",
        ),
    ]
    for what, why in offers:
        say(f"  {what}" if len(what) + len(why) + 6 > _WIDTH else f"  {what}   {why}")


def _head(count: int, title: str) -> None:
    out.print(f"[bold]{count}. {escape(title)}[/]", soft_wrap=True)


def _tell(sentence: str) -> None:
    say(fill(sentence, _WIDTH, initial_indent="   ", subsequent_indent="   ", break_long_words=False))


def _bar(name: str, value: float, whole: float, unit: str) -> None:
    """A line whose bar is as long as its value is of the whole."""
    length = max(round(_BAR * min(value / whole, 1.0)), 1) if whole > 0 else 1
    say(f"   {name:<{_NAME}} {'█' * length} {number(value)} {unit}")
