"""``sherkit effects``: the catalogue; ``simulate``: a virtual robot's runs with some of it planted."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Protocol

import click
import tomli_w

from ..base.extensions import SIMULATIONS, plugins
from ..base.figures import listed, sized
from ..data import Measurements
from ..data.files import write_whole
from ..errors import SherkitError
from ..model.effect import WITHIN, Effect, effects_by_name
from ..model.kinds import Option, Robot, Virtual, kind_of, known_kinds
from ..model.robot_file import load_robot
from . import output
from .demo import EXAMPLE
from .file_kinds import DRAWN, PLANTED, PLANTED_BY, TABLE
from .machine_file import machine_at, other_machines, own_way_of
from .paths import InputFile, OutputFile


@click.command()
@click.argument("name", required=False)
@click.option("--robot", type=InputFile(), help="The robot to draw the effect on; default: an example.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON for programs instead of tables.")
@click.option(
    "--picture",
    type=OutputFile(DRAWN),
    help="Draw the effect on this robot: its card (.html), or what it leaves at the poses (.svg).",
)
def effects(name: str | None, robot: Path | None, as_json: bool, picture: Path | None) -> None:
    """List the physical effects that can be found and added; with NAME, show one."""
    machine = None if robot is None else machine_at(robot)
    nominal = None if machine is None else machine.drawn_on
    catalogues = {name: kind.model.catalogue for name, kind in known_kinds().items()}
    catalogues |= {name: other.catalogue for name, other in other_machines().items()}
    if machine is not None:
        catalogues = {machine.kind: dict(machine.catalogue)}
    holders = [kind for kind, catalogue in catalogues.items() if name in catalogue]
    if name is not None and not holders:
        effects_by_name({k: v for catalogue in catalogues.values() for k, v in catalogue.items()}, (name,))
    if as_json:
        output.print_json(_json(catalogues, name))
        return
    if name is None:
        for kind, catalogue in catalogues.items():
            made = output.table(_title(kind), "effect", "acts at", "parameters", "needs", texts=True)
            for e in catalogue.values():
                made.add_row(e.name, e.link, str(len(e.parameters)), ", ".join([*e.needs, *_partner(e)]))
            output.out.print(made)
        output.say("sherkit effects NAME shows one; your own go into a Python file: --effects my_effects.py")
        return
    for kind in holders:
        _show(catalogues[kind][name], _title(kind) if len(holders) > 1 else "")
    if picture is not None:
        output.require_view()
        from ..report.card import card_page, effect_card
        from ..report.residual_map import signature_map
    if picture is not None and picture.suffix.lower() == ".html":
        cards = []
        for kind in holders:
            drawn_on = (
                nominal if nominal is not None else known_kinds()[kind].example if kind in known_kinds() else None
            )
            cards.append(effect_card(catalogues[kind][name], drawn_on))
        write_whole(picture, card_page(name, cards))
        output.say(f"{name} is drawn in {picture}")
    elif picture is not None and name not in WITHIN:
        if nominal is None and EXAMPLE.kind not in holders:
            raise SherkitError(
                f"'{name}' is an effect of another kind ({holders[0]}); --picture draws on a {EXAMPLE.kind} alone"
            )
        drawn: Robot = EXAMPLE if nominal is None else nominal
        write_whole(picture, signature_map(catalogues[drawn.kind][name], drawn))
        output.say(f"what {name} leaves on this robot is drawn in {picture}")


def _json(catalogues: Mapping[str, Mapping[str, Effect]], name: str | None) -> dict[str, Any]:
    """The catalogues by kind of machine, or what they hold under one name."""
    every = {
        kind: [_told(effect) for effect in catalogue.values() if name in (None, effect.name)]
        for kind, catalogue in catalogues.items()
    }
    return {"format": "sherkit effects 1", "effects": {kind: told for kind, told in every.items() if told}}


def _told(effect: Effect) -> dict[str, Any]:
    return {
        "name": effect.name,
        "acts_at": effect.link,
        "physics": effect.physics,
        "residuals": effect.residuals,
        "remedy": effect.remedy,
        "needs": list(effect.needs),
        "goes_with": effect.goes_with or None,
        "searched": effect.search,
        "parameters": [{"name": p.name, "plausible_size": p.size, "unit": p.unit} for p in effect.parameters],
    }


def _partner(effect: Effect) -> list[str]:
    return [f"{effect.goes_with} in the model"] if effect.goes_with else []


def _title(kind: str) -> str:
    known = known_kinds()
    return f"Effects of {known[kind].title if kind in known else other_machines()[kind].title}"


def _show(effect: Effect, of: str) -> None:
    if of:
        output.out.rule(of)
    output.out.print(f"[bold]{effect.name}[/], acts at the {effect.link}")
    for title, text in (
        ("physics", effect.physics),
        ("its residuals", effect.residuals),
        ("how to fix it", effect.remedy),
        ("needs", ", ".join([*effect.needs, *_partner(effect)]) or "no column besides the readings"),
    ):
        output.out.print(f"  [bold]{title}:[/] {text}")
    if effect.search:
        what = "lag behind the recorded temperature" if effect.is_lagging else "moment"
        if effect.is_periodic:
            what = "period, down to the mean distance of a joint's distinct readings,"
        output.say(f"  its {what} is searched for as well")
    made = output.table("", "parameter", "plausible size")
    for p in effect.parameters:
        made.add_row(p.name, sized(p.size, p.unit))
    output.out.print(made)


# -- Runs with some of them planted -----------------------------------------------------------------------------------


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


class Simulation(Protocol):
    """Another way to measure a virtual robot, as a folder or a package declares it (``sherkit.simulations``): by what
    ``sherkit simulate`` is asked for it."""

    simulate_options: tuple[click.Option, ...]

    def is_asked(self, virtual: Virtual, given: Mapping[str, Any]) -> bool:
        """Whether what was typed asks for it, and the robot can be measured so."""
        ...

    def measuring(self, virtual: Virtual, given: Mapping[str, Any]) -> Callable[..., Measurements]:
        """In the place of the virtual robot's own ``measure``."""
        ...


def _simulations() -> list[Simulation]:
    has = ("simulate_options", "is_asked", "measuring")
    return [*plugins((), SIMULATIONS, object, has=has).values()]  # type: ignore[list-item]


def _ways_of_others() -> list[Any]:
    """Who adds options to those of the command."""
    return [*other_machines().values(), *_simulations()]


class _Simulate(click.Command):
    """Its options are those of the kinds that are known when it is called, a user's own among them."""

    def get_params(self, ctx: click.Context) -> list[click.Parameter]:
        *own, asking_for_help = super().get_params(ctx)
        of_others = [option for one in _ways_of_others() for option in one.simulate_options]
        return [*own, *of_others, *_errors_to_hide(), asking_for_help]


@click.command(cls=_Simulate)
@click.argument("robot", type=InputFile())
@click.option("-o", "--output", "destination", type=OutputFile(TABLE), required=True, help="CSV or Parquet.")
@click.option("--poses", type=click.Choice(("whole", "local")), default="whole", show_default=True)
@click.option("--repeats", type=click.IntRange(min=1), default=5, show_default=True)
@click.option("--order", type=click.Choice(("planes", "shuffled")), default="planes", show_default=True)
@click.option("--errors", type=click.FloatRange(min=0), default=1.0, show_default=True,
              help="Size of the geometric errors, 1 = as in the paper's tables.")  # fmt: skip
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Draws the robot and the noise.")
@click.option("--truth", type=OutputFile(PLANTED), help="Write the planted errors here (TOML).")
def simulate(
    robot: Path, destination: Path, poses: str, repeats: int, order: str, errors: float, seed: int,
    truth: Path | None, **given: Any,
) -> None:  # fmt: skip
    """Simulate a run of ROBOT (TOML) with planted errors."""
    if (own_way := own_way_of(robot, "simulate")) is not None:
        own_way(destination, seed=seed, given=given)
        return
    nominal = load_robot(robot)
    data, planted = _run(robot, nominal, poses, repeats, order, errors, seed, given)
    data.save(destination)
    output.say(f"{len(data)} rows written to {destination}", destination)
    if truth is not None:
        write_whole(truth, PLANTED_BY + tomli_w.dumps(planted))
        output.say(f"planted errors written to {truth}", destination)


def _run(
    path: Path, robot: Robot, poses: str, repeats: int, order: str, errors: float, seed: int, given: dict[str, Any]
) -> tuple[Measurements, dict[str, Any]]:
    """A run of a robot with hidden errors, and these errors; ``given`` are the options, None where left out."""
    kind = kind_of(robot)
    made = kind.require_virtual()
    sizes = {name: one.default if given.get(name) is None else given[name] for name, one in made.OPTIONS.items()}
    virtual = made.simulated(robot, seed, errors, sizes)
    measured_by = next((one for one in _simulations() if one.is_asked(virtual, given)), None)
    own = {*sizes, *(() if measured_by is None else (o.name for o in measured_by.simulate_options))}
    wrong = [f"--{name.replace('_', '-')}" for name in given if name not in own and output.was_typed(name, given[name])]
    if wrong:
        raise SherkitError(f"{path}: is a {robot.kind} robot; {listed(wrong)} is not for that kind")
    if poses not in kind.areas:
        raise SherkitError(f"{path}: is a {robot.kind} robot, for which there are no poses '{poses}'")
    coordinates = kind.areas[poses](robot)
    measure = virtual.measure if measured_by is None else measured_by.measuring(virtual, given)
    return measure(coordinates, repeats=repeats, order=order, seed=seed + 1), virtual.truth()
