"""What people see in the terminal: tables, progress, warnings, the report. Tables go to stdout, the rest to stderr."""

from __future__ import annotations

import json
import math
import shlex
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click
from click.core import ParameterSource
from rich.console import Console
from rich.markup import escape
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from ..base.answer import Answer, as_sentence
from ..base.figures import finite
from ..data.files import is_output
from ..data.tables import columns_called
from ..errors import SherkitError
from .file_kinds import PAGE
from .next_command import KEPT, completed
from .paths import InputFile, OutputFile

if TYPE_CHECKING:
    from rich.progress import Progress

#: Width of tables where the output is not a terminal.
_WIDTH = 110
_SHOW_AFTER_S = 1.0

out = Console(highlight=False, width=None if Console().is_terminal else _WIDTH)
err = Console(stderr=True, highlight=False)


#: For commands that drive an experiment: Python of the user's own, named here and nowhere else.
OWN_INSTRUMENTS = click.option(
    "--python", type=InputFile(), multiple=True, help="Python file of your instruments; it is run."
)


def _called(ctx: click.Context, option: click.Parameter, value: str) -> None:
    if value:
        ctx.meta.setdefault(KEPT, {})[option.name] = value
        ctx.with_resource(columns_called(value.split(",")))


#: For verbs that read tables of text: names for columns that have none, as long as the verb goes on.
columns_option = click.option(
    "--columns", metavar="A,B,C", default="", callback=_called, expose_value=False,
    help="Names of the columns, in the order of the file, where it has none or others.",
)  # fmt: skip


def say_that_code_runs(files: tuple[Path, ...]) -> None:
    """Says which files are run with the rights of whoever named them."""
    for file in files:
        err.print(escape(f"{file} is run: it was named on the command line"), style="dim", soft_wrap=True)


def fail(message: str) -> None:
    """An error, as one sentence."""
    err.print(f"[bold red]error:[/] {escape(message)}", soft_wrap=True)


def warn(message: str) -> None:
    """A warning, as one sentence."""
    err.print(f"[bold yellow]warning:[/] {escape(message)}", soft_wrap=True)


def say(message: str, about: Path | None = None) -> None:
    """Plain text to stdout, nothing in it is markup; to stderr where stdout is the very file that it is ``about``."""
    (err if about is not None and is_output(about) else out).print(escape(message), soft_wrap=True)


def show(answer: Answer, *files: Path, colour: str = "") -> None:
    """The answer first, as every verb gives it: what was found in one line, under it what that rests on, and what to
    do; ``files`` stand in the commands that it proposes."""
    out.print(f"[bold]Verdict:[/] [bold {colour}]{escape(answer.verdict)}[/]")
    for one in (answer.headline, *answer.sure):
        if one:
            out.print(_under(as_sentence(one)))
    for step in answer.to_do:
        out.print(_under(f"{as_sentence(step.sentence).rstrip('.:')}:" if step.command else as_sentence(step.sentence)))
        if step.command:
            # a line of its own, which is copied as one however wide the screen is
            out.print(Text(f"     {completed(step.command, shlex.join(map(str, files)))}"), soft_wrap=True)


def _under(text: str) -> Padding:
    """A line below a heading; what is too long for it goes on below its begin."""
    return Padding(Text(text), (0, 0, 0, 3), expand=False)


def print_json(value: Any) -> None:
    """JSON for programs; no NaN ever leaves, nor a figure by which nothing is meant."""
    print(json.dumps(_meant(value), indent=2, allow_nan=False))


def _meant(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _meant(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_meant(one) for one in value]
    return finite(value) if isinstance(value, float) and math.isfinite(value) else value


def table(title: str, *columns: str, note: str | None = None, texts: bool = False) -> Table:
    """An empty table; the first column is text, the others numbers, or ``texts`` as well."""
    made = Table(title=escape(title), title_justify="left", title_style="bold", caption_justify="left")
    made.caption = escape(note) if note else None
    for k, column in enumerate(columns):
        # a name is broken rather than cut
        made.add_column(escape(column), justify="left" if k == 0 or texts else "right", overflow="fold")
    return made


def command_line() -> str:
    """The command as it was typed, to make a report again."""
    typed = click.get_current_context().find_root().obj
    return shlex.join(["sherkit", *(sys.argv[1:] if typed is None else typed)])


def was_typed(name: str, value: Any) -> bool:
    """Whether the option that has this value was given, and not by its default."""
    asked = click.get_current_context(silent=True)
    return value is not None if asked is None else asked.get_parameter_source(name) is ParameterSource.COMMANDLINE


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
    progress: Progress | None = None
    started = time.monotonic()
    done = 0

    def step(name: str) -> None:
        nonlocal progress, done
        done += 1
        if progress is None and err.is_terminal and time.monotonic() - started > _SHOW_AFTER_S:
            progress = _bar()
            progress.start()
            progress.add_task("", total=total)
        if progress is not None:
            progress.update(progress.task_ids[0], description=name, completed=done)

    try:
        yield step
    finally:
        if progress is not None:
            progress.stop()


def _bar() -> Progress:
    from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    columns = (SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    return Progress(*columns, console=err, transient=True)


# -- ``--report`` -----------------------------------------------------------------------------------------------------

if TYPE_CHECKING:
    from ..calibration import Result
    from ..diagnosis import Diagnosis
    from ..report.page import Made
    from ..robots.calibrated import Calibration
    from ..study import Study

F = TypeVar("F", bound=Callable[..., Any])


def report_option(command: F) -> F:
    """Adds ``--report FILE`` to a command."""
    made: F = click.option(
        "--report", "report", type=OutputFile(PAGE),
        help="Write the story as one HTML file that opens without a network.",
    )(command)  # fmt: skip
    return made


def require_view() -> None:
    """Refuses early where what draws is not installed. Raises :class:`~sherkit.errors.SherkitError`."""
    try:
        import bokeh  # noqa: F401
        import jinja2  # noqa: F401
    except ModuleNotFoundError as error:
        message = f"pictures need the extra 'view' ({error.name} is not installed): pip install \"sherkit[view]\""
        raise SherkitError(message) from None


def made_by(sources: Sequence[Path], files: Sequence[Path] = ()) -> Made:
    """How this command makes a page of ``sources``; ``files``, by default the first two, stand in what it proposes."""
    from ..report.page import Made  # Bokeh takes a second to load

    given = shlex.join(map(str, files or sources[:2]))
    return Made.of(sources, command_line(), lambda line: completed(line, given))


def write_report(
    path: Path, study: Study, found: Diagnosis, sources: Sequence[Path], *,
    calibration: Calibration | None = None, result: Result | None = None, simulated: bool = False,
    printed: Mapping[str, Any] | None = None,
) -> None:  # fmt: skip
    """Writes the report of a study that stands at the last state to be told."""
    from ..report.document import Report
    from ..report.document import write_report as write_it

    write_it(Report(study, found, made_by(sources), calibration, result, simulated, printed or {}), path)
