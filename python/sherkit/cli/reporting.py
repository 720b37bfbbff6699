"""``--report``: the same story as the tables, as one HTML file to look at."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from ..errors import SherkitError
from . import output

if TYPE_CHECKING:
    from ..calibration import Result
    from ..diagnosis import Diagnosis
    from ..robots.calibrated import Calibration
    from ..study import Study

F = TypeVar("F", bound=Callable[..., Any])


def report_option(command: F) -> F:
    """Adds ``--report FILE`` to a command."""
    made: F = click.option(
        "--report", "report", type=click.Path(path_type=Path, dir_okay=False),
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


def write(
    path: Path, title: str, study: Study, found: Diagnosis, sources: Sequence[Path], *,
    calibration: Calibration | None = None, result: Result | None = None, simulated: bool = False,
    printed: Mapping[str, Any] | None = None,
) -> None:  # fmt: skip
    """Writes the report of a study that stands at the last state to be told."""
    from ..report.document import Report, SourceFile, write_report  # Bokeh takes a second to load

    written = Report(
        title=title,
        study=study,
        found=found,
        command=output.command_line(),
        sources=[SourceFile.of(p) for p in sources],
        calibration=calibration,
        result=result,
        simulated=simulated,
        printed=printed or {},
    )
    write_report(written, path)
