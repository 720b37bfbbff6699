"""The ``sherkit`` command."""

from __future__ import annotations

import sys
import warnings
from importlib import import_module
from types import ModuleType

import click

import sherkit._core as _core

from ..errors import SherkitError
from ..starting import loaded

#: The verbs, and where each stands: a file here, loaded when its verb is typed, and the name in it.
_VERBS = {
    "app": "app.app",
    "c": "c_library.c_library",
    "calibrate": "calibrate.calibrate",
    "demo": "demo.demo",
    "diagnose": "diagnose.diagnose",
    "completion": "completion.completion",
    "doctor": "doctor.doctor",
    "effects": "effects.effects",
    "estimate": "tool.estimate",
    "export": "export.export",
    "fleet": "fleet.fleet_command",
    "home": "home.home",
    "import": "importing.import_group",
    "intrinsics": "vision.intrinsics",
    "lab": "lab.lab",
    "markers": "vision.markers",
    "measure": "measure.measure",
    "plan": "plan.plan",
    "printer": "printer.printer",
    "register": "tool.register",
    "schema": "schema.schema",
    "simulate": "simulate.simulate",
    "tool": "tool_story.tool_story",
}


class _Verbs(click.Group):
    """A group that knows the names of its commands; each is loaded when it is called, or told of in a help."""

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in _VERBS:
            return None
        file, _, name = _VERBS[cmd_name].partition(".")
        command: click.Command = getattr(import_module(f".{file}", __package__), name)
        command.epilog = import_module(".examples", __package__).epilog(cmd_name)
        return command


@click.group(
    cls=_Verbs,
    commands=[click.Command(name) for name in _VERBS],
    context_settings={"help_option_names": ["-h", "--help"]},
)
@click.version_option(_core.__version__, prog_name="sherkit")
def cli() -> None:
    """sherkit finds the physics that a robot's model is missing."""
    loaded()


def _output() -> ModuleType:
    """What prints in colours is loaded when there is something to say."""
    return import_module(".output", __package__)


def main(arguments: list[str] | None = None) -> None:
    """Runs a command; errors become one sentence and an exit code."""
    try:
        with warnings.catch_warnings():
            warnings.showwarning = lambda message, *_, **__: _output().warn(str(message))
            typed = sys.argv[1:] if arguments is None else arguments
            code = cli.main(args=typed, prog_name="sherkit", standalone_mode=False, obj=typed)
    except SherkitError as error:
        _output().fail(str(error))
        sys.exit(1)
    except (click.exceptions.Abort, KeyboardInterrupt):
        _output().fail("interrupted")
        sys.exit(130)
    except click.ClickException as error:
        error.show()
        sys.exit(error.exit_code)
    except BrokenPipeError:
        sys.exit(1)
    except ModuleNotFoundError as error:
        if error.name not in ("sqlite3", "_sqlite3"):
            raise
        _output().fail(
            "this Python was built without SQLite, which keeps the rows of a run; use one that has it: those of Debian "
            "and of python.org do, one built from source (pyenv too) does where libsqlite3-dev was there before"
        )
        sys.exit(1)
    except OSError as error:
        _output().fail(f"{error.filename}: {error.strerror}" if error.filename else str(error))
        sys.exit(1)
    sys.exit(code if isinstance(code, int) else 0)
