"""``sherkit effects``: the catalogue."""

from __future__ import annotations

import click

from ..effects import CATALOGUE
from ..model import effects_by_name
from . import output


@click.command()
@click.argument("name", required=False)
def effects(name: str | None) -> None:
    """List the physical effects that can be found and added; with NAME, show one."""
    if name is None:
        made = output.table("Effects of the linear delta", "effect", "link", "parameters", "needs")
        for e in CATALOGUE.values():
            made.add_row(e.name, e.link, str(len(e.parameters)), ", ".join(e.needs))
        output.out.print(made)
        output.say("sherkit effects NAME shows one; your own go into a Python file: --effects my_effects.py")
        return
    (effect,) = effects_by_name((name,))
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
