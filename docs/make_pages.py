"""Pages that follow from the code: one for each effect (drawing, pattern, cure, parameters), one of all verbs.

``python docs/make_pages.py FOLDER`` writes them; the site has them (docs/build_site.py).
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import click

from sherkit.base.figures import listed
from sherkit.cli.verbs import cli
from sherkit.errors import SherkitError
from sherkit.model.effect import Effect
from sherkit.model.kinds import Kind, known_kinds
from sherkit.report.card import exaggerated, scene_of
from sherkit.report.residual_map import signature_map
from sherkit.robots.tool.effects import TOOL_CATALOGUE
from sherkit.robots.tool.tool import KIND

#: What a drawing shows moves by more than this, or there is nothing to see.
_SEEN_MM = 1e-9


def make(folder: Path) -> list[tuple[str, list[tuple[str, Path]]]]:
    """Writes the pages into ``folder``; what stands in the list of pages: title, and its pages by name."""
    folder.mkdir(parents=True, exist_ok=True)
    nav = []
    for kind in known_kinds().values():
        pages = [(effect.name, _page(effect, kind, folder)) for effect in kind.model.catalogue.values()]
        nav.append((f"Effects of {kind.title}", pages))
    pages = [(effect.name, _page(effect, None, folder)) for effect in TOOL_CATALOGUE.values()]
    nav.append(("Effects of the flexible tool", pages))
    verbs = folder / "verbs.md"
    verbs.write_text("\n".join(_verbs()), encoding="utf-8")
    return [("Verbs", [("All verbs and their options", verbs)]), *nav]


def _page(effect: Effect, kind: Kind | None, folder: Path) -> Path:
    """The page of one effect, with its pictures beside it."""
    name = f"{KIND if kind is None else kind.name}_{effect.name}".replace(" ", "_")
    title = "the flexible tool" if kind is None else kind.title
    lines = [f"# {effect.name}", "", f"An effect of {title}; it acts at the {effect.link}.", "", effect.physics, ""]
    for what, svg in _pictures(effect, kind):
        (folder / f"{name}_{what}.svg").write_text(svg, encoding="utf-8")
        said = "the machine without it and with it, exaggerated" if what == "drawn" else "what it leaves at poses"
        lines += [f"![{effect.name}: {said}]({name}_{what}.svg)", ""]
    lines += ["## How it shows", "", effect.residuals, "", "## How to fix it in the machine", "", effect.remedy, ""]
    lines += ["## What it needs", "", listed(effect.needs) or "No column besides the readings.", ""]
    lines += ["## Its parameters", "", "| parameter | plausible size | unit |", "| --- | --- | --- |"]
    lines += [f"| {p.name} | {p.size:g} | {p.unit} |" for p in effect.parameters]
    lines += ["", "## In use", "", "```", f"sherkit effects {effect.name}",
              f"sherkit calibrate robot.toml run.csv --effect {effect.name} -o calibrated.toml", "```", ""]  # fmt: skip
    path = folder / f"{name}.md"
    path.write_text("\n".join(lines), encoding="utf-8")
    return path


def _pictures(effect: Effect, kind: Kind | None) -> Iterator[tuple[str, str]]:
    """The drawing and the pattern of an effect, where a machine of its kind can be drawn."""
    if kind is None or kind.example is None:
        return
    # some show in no drawing of this machine, some leave nothing at its usual poses
    with suppress(SherkitError):
        shown = exaggerated(effect, kind.example)
        if shown.moves_mm > _SEEN_MM:
            yield "drawn", scene_of(shown).still()
    if kind.signature is not None:
        with suppress(SherkitError):
            yield "pattern", signature_map(effect, kind.example)


def _verbs() -> Iterator[str]:
    """Every verb with its help, in the groups of ``sherkit --help``."""
    yield from ("# All verbs and their options", "", "As `sherkit VERB --help` prints them.", "")
    top = click.Context(cli, info_name="sherkit")
    for title, group in cli.grouped.items():
        yield from (f"## {title}", "")
        for name in group:
            verb = cli.get_command(top, name)
            assert verb is not None
            yield from _verb(verb, click.Context(verb, info_name=name, parent=top))


def _verb(verb: click.Command, context: click.Context) -> Iterator[str]:
    yield from (f"### {context.command_path}", "", "```", verb.get_help(context), "```", "")
    if isinstance(verb, click.Group):
        for name in verb.list_commands(context):
            own = verb.get_command(context, name)
            if own is not None:
                yield from _verb(own, click.Context(own, info_name=name, parent=context))


if __name__ == "__main__":
    make(Path(sys.argv[1]))
