"""``sherkit effects``: the catalogue."""

from __future__ import annotations

from pathlib import Path

import click

from ..effects import CATALOGUE
from ..model import effects_by_name
from ..robots import load_robot
from ..signatures import signature_map
from . import output
from .demo import EXAMPLE


@click.command()
@click.argument("name", required=False)
@click.option("--robot", type=click.Path(path_type=Path), help="The robot to draw the effect on; default: an example.")
@click.option("--picture", type=click.Path(path_type=Path), help="Draw what the effect leaves on this robot (SVG).")
def effects(name: str | None, robot: Path | None, picture: Path | None) -> None:
    """List the physical effects that can be found and added; with NAME, show one."""
    if name is None:
        made = output.table("Effects of the linear delta", "effect", "link", "parameters", "needs")
        for e in CATALOGUE.values():
            made.add_row(e.name, e.link, str(len(e.parameters)), ", ".join(e.needs))
        output.out.print(made)
        output.say("sherkit effects NAME shows one; your own go into a Python file: --effects my_effects.py")
        return
    effect = CATALOGUE["datum"] if name == "datum" else effects_by_name((name,))[0]
    output.out.print(f"[bold]{effect.name}[/], at the link '{effect.link}'")
    for title, text in (
        ("physics", effect.physics),
        ("its residuals", effect.residuals),
        ("in the workshop", effect.workshop),
        ("needs", ", ".join(effect.needs) or "no column besides the readings"),
    ):
        output.out.print(f"  [bold]{title}:[/] {text}")
    if effect.search:
        what = "period" if effect.search == "period_mm" else "moment"
        output.say(f"  its {what} is searched for as well")
    made = output.table("", "parameter", "plausible size", "unit")
    for p in effect.parameters:
        made.add_row(p.name, f"{p.size:g}", p.unit)
    output.out.print(made)
    if picture is not None and name != "datum":
        picture.write_text(signature_map(effect, load_robot(robot) if robot else EXAMPLE), encoding="utf-8")
        output.say(f"what {effect.name} leaves on this robot is drawn in {picture}")
