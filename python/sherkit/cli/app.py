"""``sherkit app``: the page on which effects are added and the error falls."""

from __future__ import annotations

import webbrowser
from pathlib import Path

import click

from ..data.files import write_whole
from . import output
from .file_kinds import BEGUN_FROM, STUDY, TABLE, TYPED
from .machine_file import own_way_of
from .paths import InputFile, OutputFolder

#: The file in the study's folder by which a browser finds the page.
_LEADS = ".page.html"
#: What a study's folder holds. Tables that were dropped into the page get names that no file has.
STUDY_FOLDER = OutputFolder(
    {"study.json": STUDY, "sources.json": BEGUN_FROM, "typed_effects.py": TYPED, "rows-*.parquet": TABLE}
)


@click.command()
@click.argument("robot", type=InputFile())
@click.argument("run", type=InputFile())
@click.option("--effects", "files", type=InputFile(), multiple=True, help="Python file of your effects.")
@click.option("--study", "folder", type=STUDY_FOLDER, help="Folder of the study; default: beside RUN.")
@click.option("--fresh", is_flag=True, help="Begin anew where the folder holds a study.")
@click.option("--run-typed", is_flag=True, help="Run lines again that were typed into the page before.")
@click.option("--follow", is_flag=True, help="Read RUN again whenever it grows.")
@click.option("--address", default="127.0.0.1", show_default=True, help="Beyond loopback others can open it.")
@click.option("--port", type=click.IntRange(0, 65535), default=5006, show_default=True, help="0 takes a free one.")
@click.option("--no-open", is_flag=True, help="Print the address and open no browser.")
def app(
    robot: Path, run: Path, files: tuple[Path, ...], folder: Path | None, fresh: bool, run_typed: bool, follow: bool,
    address: str, port: int, no_open: bool,
) -> None:  # fmt: skip
    """Open ROBOT (TOML) and the measurements RUN (CSV or Parquet) as a page: add effects, and watch the error fall.

    Of a flexible tool the page is the story of its run.
    """
    output.require_view()
    if (own_way := own_way_of(robot, "app")) is not None:
        own_way(run, files, opened=not no_open)
        return
    from ..app.server import PageServer, is_loopback  # Bokeh takes a second to load
    from ..app.workbench import Workbench

    folder = folder or STUDY_FOLDER.checked(run.parent / f"{run.stem}.study", "the study beside RUN; --study")
    trusted = is_loopback(address)
    bench = Workbench.open(
        robot, run, folder, files=files, fresh=fresh, trusted=trusted, run_typed=run_typed, follow=follow
    )
    server = PageServer(
        bench, address=address, port=port, command=output.command_line(), follow=run if follow else None
    )  # fmt: skip
    output.say(f"the page is at {server.url}\nthe study is kept in {folder}; Ctrl-C ends")
    if not trusted:
        output.warn(
            f"{address} can be reached from other machines: whoever knows the address above can change this study"
        )
    leads = folder / _LEADS
    try:
        server.run(lambda: None if no_open else _open(server.url, leads))
    finally:
        leads.unlink(missing_ok=True)


def _open(url: str, leads: Path) -> None:
    """Opens the page by a file that only its owner reads: the address is its key, and command lines are for all."""
    leads.unlink(missing_ok=True)
    leads.touch(mode=0o600)
    write_whole(
        leads,
        '<!doctype html><meta charset="utf-8"><meta name="referrer" content="no-referrer">'
        f'<meta http-equiv="refresh" content="0; url={url}"><a href="{url}">the page</a>',
    )
    webbrowser.open(leads.resolve().as_uri())
