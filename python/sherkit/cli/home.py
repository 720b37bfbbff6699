"""``sherkit home``: the reference of the axes, without which nothing moves."""

from __future__ import annotations

from pathlib import Path

import click

from ..base.names import listed
from ..errors import ShapeError
from ..lab.experiment import load_experiment
from ..lab.instruments import AxisController
from ..model.kinds import kind_of
from . import output


@click.command()
@click.argument("experiment", type=click.Path(path_type=Path))
@click.option("--at", metavar="Q1,Q2,…", help="Where the axes stand now, by you; left out: where the plan begins.")
@click.option("--yes", is_flag=True, help="Do not ask: the way is free, or the robot stands where --at says.")
@click.option("--ports", type=click.Path(path_type=Path), help="Addresses by instrument, as 'sherkit lab' wrote them.")
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
            question = (
                f"All axes drive to their home switches ({switches}), then to where the plan begins. Is the way free?"
            )
            _sure(yes, question)
            motion.enable()
            motion.home()
        else:
            places = chosen.plan.start if at is None else _read(at, len(names))
            output.say(f"1. Bring the robot to {_places(names, places, motion.unit)}, by a gauge or its marks.")
            output.say(
                "2. Look that it stands there. From then on it is taken to be there; then it drives to the start."
            )
            _sure(yes, "Does it stand there?")
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


def _sure(yes: bool, question: str) -> None:
    if not yes:
        click.confirm(question, abort=True)


def _read(text: str, count: int) -> tuple[float, ...]:
    try:
        places = tuple(float(word) for word in text.split(","))
    except ValueError:
        places = ()
    if len(places) != count:
        raise ShapeError(f"--at {text}: expected {count} numbers parted by commas, one for each axis")
    return places


def _places(names: tuple[str, ...] | list[str], places: tuple[float, ...], unit: str) -> str:
    return listed(
        [f"{name.rpartition('_')[0] or name} = {q:.4g} {unit}" for name, q in zip(names, places, strict=True)]
    )
