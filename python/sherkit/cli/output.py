"""What people see in the terminal: tables, progress, warnings. Tables go to stdout, the rest to stderr."""

from __future__ import annotations

import json
import shlex
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import click
from click.core import ParameterSource
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.table import Table

from ..errors import SherkitError

#: Width of tables where the output is not a terminal.
_WIDTH = 110
_SHOW_AFTER_S = 1.0

out = Console(highlight=False, width=None if Console().is_terminal else _WIDTH)
err = Console(stderr=True, highlight=False)


def fail(message: str) -> None:
    """An error, as one sentence."""
    err.print(f"[bold red]error:[/] {escape(message)}", soft_wrap=True)


def warn(message: str) -> None:
    """A warning, as one sentence."""
    err.print(f"[bold yellow]warning:[/] {escape(message)}", soft_wrap=True)


def say(message: str) -> None:
    """Plain text to stdout: nothing in it is markup."""
    out.print(escape(message), soft_wrap=True)


def print_json(value: Any) -> None:
    """JSON for programs; no NaN ever leaves."""
    print(json.dumps(value, indent=2, allow_nan=False))


def table(title: str, *columns: str, note: str | None = None) -> Table:
    """An empty table; the first column is text, the others numbers."""
    made = Table(title=escape(title), title_justify="left", title_style="bold", caption_justify="left")
    made.caption = escape(note) if note else None
    for k, column in enumerate(columns):
        made.add_column(escape(column), justify="left" if k == 0 else "right")
    return made


def command_line() -> str:
    """The command as it was typed, to make a report again."""
    typed = click.get_current_context().find_root().obj
    return shlex.join(["sherkit", *(sys.argv[1:] if typed is None else typed)])


def refuse_given(*taken: str, why: str) -> None:
    """Refuses every option that was typed but those ``taken``. Raises :class:`~sherkit.errors.SherkitError`."""
    context = click.get_current_context()
    for option in context.command.params:
        if option.name in taken or option.name is None:
            continue
        if context.get_parameter_source(option.name) is ParameterSource.COMMANDLINE:
            raise SherkitError(f"{option.opts[0]}: {why}")


@contextmanager
def steps(total: int) -> Iterator[Any]:
    """A progress bar that shows itself only where the work takes longer than a second.

    Yields a function that is told each step before it starts.
    """
    columns = (SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    progress = Progress(*columns, console=err, transient=True)
    started = time.monotonic()
    shown = False
    task = progress.add_task("", total=total)

    def step(name: str) -> None:
        nonlocal shown
        if not shown and err.is_terminal and time.monotonic() - started > _SHOW_AFTER_S:
            progress.start()
            shown = True
        progress.update(task, description=name, advance=1)

    try:
        yield step
    finally:
        if shown:
            progress.stop()
