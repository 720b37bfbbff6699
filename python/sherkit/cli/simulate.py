"""``sherkit simulate``: a virtual robot's runs, to try things on."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click
import tomli_w

from ..base.names import listed
from ..data import Measurements
from ..data.files import write_whole
from ..errors import SherkitError
from ..model.kinds import Option, Robot, SeenInPictures, kind_of, known_kinds
from ..model.robot_file import load_robot
from ..robots.tool.virtual import EXPERIMENTS
from . import output
from .machine_file import own_way_of
from .vision import require_vision


def _errors_to_hide() -> list[click.Parameter]:
    """An option for each error that the virtual robots know, with the kinds of robot that have it."""
    known: dict[str, list[tuple[str, Option]]] = {}
    for kind in known_kinds().values():
        for name, one in (kind.virtual.OPTIONS if kind.virtual is not None else {}).items():
            known.setdefault(name, []).append((kind.name.capitalize(), one))
    made: list[click.Parameter] = []
    for name, having in known.items():
        said = [f"{who}: {o.what}{f'; default {o.default:g}' if o.default else ''}." for who, o in having]
        limits = float if any(o.signed for _, o in having) else click.FloatRange(min=0)
        made.append(click.Option([f"--{name.replace('_', '-')}"], type=limits, help=" ".join(said)))
    return made


class _Simulate(click.Command):
    """Its options are those of the kinds that are known when it is called, a user's own among them."""

    def get_params(self, ctx: click.Context) -> list[click.Parameter]:
        *own, asking_for_help = super().get_params(ctx)
        return [*own, *_errors_to_hide(), asking_for_help]


@click.command(cls=_Simulate)
@click.argument("robot", type=click.Path(path_type=Path))
@click.option("-o", "--output", "destination", type=click.Path(path_type=Path), required=True, help="CSV or Parquet.")
@click.option("--poses", type=click.Choice(("whole", "local")), default="whole", show_default=True)
@click.option("--repeats", type=click.IntRange(min=1), default=5, show_default=True)
@click.option("--order", type=click.Choice(("planes", "shuffled")), default="planes", show_default=True)
@click.option("--errors", type=click.FloatRange(min=0), default=1.0, show_default=True,
              help="Size of the geometric errors, 1 = as in the paper's tables.")  # fmt: skip
@click.option("--pictures", type=click.Path(path_type=Path), help="With a camera: draw pictures into this folder, and "
              "read the pixels from them.")  # fmt: skip
@click.option("--experiment", type=click.Choice((*EXPERIMENTS, "free", "bench")), default="vessels", show_default=True,
              help="Flexible tool: one of the paper's, free (unbent), bench (known loads).")  # fmt: skip
@click.option("--seconds", type=click.FloatRange(min=2), default=60.0, show_default=True, help="Flexible tool.")
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Draws the robot and the noise.")
@click.option("--truth", type=click.Path(path_type=Path), help="Write the planted errors here (TOML).")
def simulate(
    robot: Path, destination: Path, poses: str, repeats: int, order: str, errors: float, seed: int,
    truth: Path | None, experiment: str, seconds: float, **given: Any,
) -> None:  # fmt: skip
    """Simulate a run of ROBOT (TOML) with planted errors, or of a flexible tool (see --experiment)."""
    if (own_way := own_way_of(robot, "simulate")) is not None:
        own_way(destination, experiment=experiment, seconds=seconds, seed=seed, given=given)
        return
    nominal = load_robot(robot)
    data, planted = _run(robot, nominal, poses, repeats, order, errors, seed, given)
    data.save(destination)
    output.say(f"{len(data)} rows written to {destination}", destination)
    if truth is not None:
        write_whole(truth, tomli_w.dumps(planted))
        output.say(f"planted errors written to {truth}", destination)


def _run(
    path: Path, robot: Robot, poses: str, repeats: int, order: str, errors: float, seed: int, given: dict[str, Any]
) -> tuple[Measurements, dict[str, Any]]:
    """A run of a robot with hidden errors, and these errors; ``given`` are the options, None where left out."""
    kind = kind_of(robot)
    made = kind.require_virtual()
    sizes = {name: one.default if given.get(name) is None else given[name] for name, one in made.OPTIONS.items()}
    virtual = made.simulated(robot, seed, errors, sizes)
    own = {*sizes, "pictures"} if isinstance(virtual, SeenInPictures) else {*sizes}
    wrong = [f"--{name.replace('_', '-')}" for name, value in given.items() if value is not None and name not in own]
    if wrong:
        raise SherkitError(f"{path}: is a {robot.kind} robot; {listed(wrong)} is not for that kind")
    if poses not in kind.areas:
        raise SherkitError(f"{path}: is a {robot.kind} robot, for which there are no poses '{poses}'")
    coordinates = kind.areas[poses](robot)
    if given["pictures"] is None:
        return virtual.measure(coordinates, repeats=repeats, order=order, seed=seed + 1), virtual.truth()
    assert isinstance(virtual, SeenInPictures)
    require_vision()
    plan = virtual.plan(coordinates, repeats=repeats, order=order, seed=seed + 1)
    return virtual.seen_run(plan, virtual.pictures(plan, seed=seed), save_in=given["pictures"]), virtual.truth()
