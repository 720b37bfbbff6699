"""The ``sherkit`` command."""

from __future__ import annotations

import sys
import warnings

import click

import sherkit._core as _core

from ..errors import SherkitError
from . import output
from .app import app
from .calibrate import calibrate
from .demo import demo
from .diagnose import diagnose
from .effects import effects
from .importing import import_group
from .lab import lab
from .measure import export, measure
from .plan import plan
from .simulate import simulate
from .tool import estimate, register
from .tool_story import tool_story
from .vision import intrinsics, markers


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(_core.__version__, prog_name="sherkit")
def cli() -> None:
    """sherkit finds the physics that a robot's model is missing."""


cli.add_command(app)
cli.add_command(calibrate)
cli.add_command(demo)
cli.add_command(diagnose)
cli.add_command(effects)
cli.add_command(estimate)
cli.add_command(register)
cli.add_command(export)
cli.add_command(lab)
cli.add_command(measure)
cli.add_command(plan)
cli.add_command(simulate)
cli.add_command(tool_story)
cli.add_command(import_group)
cli.add_command(intrinsics)
cli.add_command(markers)


def main(arguments: list[str] | None = None) -> None:
    """Runs a command; errors become one sentence and an exit code."""
    try:
        with warnings.catch_warnings():
            warnings.showwarning = lambda message, *_, **__: output.warn(str(message))
            typed = sys.argv[1:] if arguments is None else arguments
            code = cli.main(args=typed, prog_name="sherkit", standalone_mode=False, obj=typed)
    except SherkitError as error:
        output.fail(str(error))
        sys.exit(1)
    except click.exceptions.Abort:
        output.fail("interrupted")
        sys.exit(130)
    except click.ClickException as error:
        error.show()
        sys.exit(error.exit_code)
    except BrokenPipeError:
        sys.exit(1)
    except OSError as error:
        output.fail(f"{error.filename}: {error.strerror}" if error.filename else str(error))
        sys.exit(1)
    sys.exit(code if isinstance(code, int) else 0)
