"""``sherkit effects``: the catalogue."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

from ..data.files import write_whole
from ..errors import SherkitError
from ..model.effect import Effect, effects_by_name
from ..model.kinds import Robot, known_kinds
from ..robots.tool.effects import TOOL_CATALOGUE
from ..robots.tool.tool import KIND
from . import output, reporting
from .demo import EXAMPLE
from .machine_file import machine_at

_OF_TOOL = "the flexible tool and its camera"


@click.command()
@click.argument("name", required=False)
@click.option("--robot", type=click.Path(path_type=Path), help="The robot to draw the effect on; default: an example.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON for programs instead of tables.")
@click.option(
    "--picture",
    type=click.Path(path_type=Path),
    help="Draw the effect on this robot: its card (.html), or what it leaves at the poses (.svg).",
)
def effects(name: str | None, robot: Path | None, as_json: bool, picture: Path | None) -> None:
    """List the physical effects that can be found and added; with NAME, show one."""
    machine = None if robot is None else machine_at(robot)
    nominal = None if machine is None else machine.drawn_on
    catalogues = {name: kind.model.catalogue for name, kind in known_kinds().items()} | {KIND: TOOL_CATALOGUE}
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
                made.add_row(e.name, e.link, str(len(e.parameters)), ", ".join(e.needs))
            output.out.print(made)
        output.say("sherkit effects NAME shows one; your own go into a Python file: --effects my_effects.py")
        return
    for kind in holders:
        _show(catalogues[kind][name], _title(kind) if len(holders) > 1 else "")
    if picture is not None:
        reporting.require_view()
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
    elif picture is not None and name != "datum":
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
        "searched": effect.search,
        "parameters": [{"name": p.name, "plausible_size": p.size, "unit": p.unit} for p in effect.parameters],
    }


def _title(kind: str) -> str:
    known = known_kinds()
    return f"Effects of {known[kind].title if kind in known else _OF_TOOL}"


def _show(effect: Effect, of: str) -> None:
    if of:
        output.out.rule(of)
    output.out.print(f"[bold]{effect.name}[/], acts at the {effect.link}")
    for title, text in (
        ("physics", effect.physics),
        ("its residuals", effect.residuals),
        ("how to fix it", effect.remedy),
        ("needs", ", ".join(effect.needs) or "no column besides the readings"),
    ):
        output.out.print(f"  [bold]{title}:[/] {text}")
    if effect.search:
        what = "lag behind the recorded temperature" if effect.is_lagging else "moment"
        if effect.is_periodic:
            what = "period, down to the mean distance of a joint's distinct readings,"
        output.say(f"  its {what} is searched for as well")
    made = output.table("", "parameter", "plausible size", "unit")
    for p in effect.parameters:
        made.add_row(p.name, f"{p.size:g}", p.unit)
    output.out.print(made)
