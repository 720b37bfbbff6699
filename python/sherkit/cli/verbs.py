"""The ``sherkit`` command."""

from __future__ import annotations

import shlex
import sys
import warnings
from importlib import import_module
from pathlib import Path
from types import ModuleType

import click

import sherkit._core as _core

from ..base.extensions import VERBS as VERBS_OF_PACKAGES
from ..base.starting import loaded
from ..errors import MeasurementError, SherkitError
from .groups import Later, OpenGroup, help_line

# -- The command ------------------------------------------------------------------------------------------------------

#: Verbs that need none of the folders that sherkit works without; those bring theirs.
VERBS = {
    "demo": Later(
        "sherkit.cli.demo:demo",
        "Start",
        "the whole way on a virtual robot, in half a minute",
        "sherkit demo",
    ),
    "doctor": Later(
        "sherkit.cli.doctor:doctor",
        "Start",
        "what is installed, what is missing, how to fix it",
        "sherkit doctor",
    ),
    "completion": Later(
        "sherkit.cli.doctor:completion",
        "Start",
        "verbs, options and files completed with the tab key",
        "sherkit completion bash",
    ),
    "diagnose": Later(
        "sherkit.cli.diagnose:diagnose",
        "Diagnose",
        "which effect the model of a robot is missing on a run",
        "sherkit diagnose robot.toml run.csv",
        "sherkit diagnose robot.toml run.csv --effects my_effects.py --report diagnosis.html",
    ),
    "calibrate": Later(
        "sherkit.cli.calibrate:calibrate",
        "Diagnose",
        "identify a robot, correct it, predict its accuracy",
        "sherkit calibrate robot.toml run.csv -o calibrated.toml",
        "sherkit calibrate robot.toml whole.csv --local near.csv --effect rail_lean --report calibration.html",
    ),
    "app": Later(
        "sherkit.cli.app:app",
        "Diagnose",
        "the same on a page, to click",
        "sherkit app robot.toml run.csv",
        "sherkit app robot.toml run.csv --follow --study monday",
    ),
    "check": Later(
        "sherkit.cli.check:check",
        "Diagnose",
        "all that is wrong with a file of measurements, mended",
        "sherkit check run.csv",
        "sherkit check run.csv robot.toml --write clean.csv",
    ),
    "effects": Later(
        "sherkit.cli.effects:effects",
        "Diagnose",
        "the effects that can be found and added",
        "sherkit effects",
        "sherkit effects backlash --picture backlash.svg",
    ),
    "compare": Later(
        "sherkit.cli.changes:compare",
        "Diagnose",
        "what has changed between two runs of a machine",
        "sherkit compare robot.toml monday.csv friday.csv",
    ),
    "history": Later(
        "sherkit.cli.changes:history",
        "Diagnose",
        "its course over many runs: steps, wear, season",
        "sherkit history robot.toml january.csv april.csv july.csv --dates 2026-01-10,2026-04-09,2026-07-12",
    ),
    "verify": Later(
        "sherkit.cli.changes:verify",
        "Diagnose",
        "whether a calibration still holds, by a dozen poses",
        "sherkit verify calibrated.toml check.csv --fail-if-invalid",
    ),
    "fleet": Later(
        "sherkit.cli.changes:fleet_command",
        "Diagnose",
        "many runs of machines built alike, in one table",
        "sherkit fleet machine_*.csv --robot robot.toml",
    ),
    "simulate": Later(
        "sherkit.cli.effects:simulate",
        "Diagnose",
        "a run with errors planted in it",
        "sherkit simulate robot.toml -o run.csv --seed 3",
    ),
    "export": Later(
        "sherkit.cli.export:export",
        "Measure",
        "rows of a run; a calibration for a controller, C or ROS",
        "sherkit export c calibrated.toml -o robot.h",
        "sherkit export comp gantry.py calibrated.toml --axis x_mm -o x.comp",
        at=5,
    ),
    "schema": Later(
        "sherkit.cli.schema:schema",
        "Measure",
        "what a file may hold, as JSON schema",
        "sherkit schema robot",
        at=6,
    ),
    "import": Later(
        "sherkit.cli.exchange:import_group",
        "Import, cameras, C",
        "files of other programs into robot.toml and run.csv",
        "sherkit import bluesky run.jsonl --column q1_mm=rails_q1 --column x_mm=laser_x -o run.csv",
        "sherkit import rosbag recorded --joint q1_mm=rail_1 --poses /tracker -o run.csv",
    ),
    "c": Later(
        "sherkit.cli.c_library:c_library",
        "Import, cameras, C",
        "header and library for a control loop in C or C++",
        "sherkit c --cflags --libs",
        "sherkit c --example my_loop",
        at=9,
    ),
}
#: Headings of the help in their order; others come behind them.
_GROUPS = ("Start", "Diagnose", "Measure")
_OF_OTHERS = "Of other packages"


def _at(named: tuple[str, click.Command]) -> int:
    """Where a verb stands below its heading."""
    return named[1].at if isinstance(named[1], Later) else 0


class _Verbs(OpenGroup):
    """Knows the names of its commands; each is loaded when it is called, and told of in a help without."""

    declared = VERBS_OF_PACKAGES

    @property
    def grouped(self) -> dict[str, dict[str, click.Command]]:
        """All verbs by what they are for."""
        found: dict[str, dict[str, click.Command]] = {group: {} for group in _GROUPS}
        for name, command in {**self.commands, **self.brought}.items():
            group = command.group if isinstance(command, Later) else _OF_OTHERS
            found.setdefault(group, {})[name] = command
        found = {group: dict(sorted(verbs.items(), key=_at)) for group, verbs in found.items()}
        of_others = found.pop(_OF_OTHERS, {})
        return {**found, **({_OF_OTHERS: of_others} if of_others else {})}

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """By what they are for, a line each."""
        for title, commands in self.grouped.items():
            with formatter.section(title):
                formatter.write_dl([(name, help_line(command)) for name, command in commands.items()])


@click.group(
    cls=_Verbs,
    commands=VERBS,
    context_settings={"help_option_names": ["-h", "--help"]},
)
@click.version_option(_core.__version__, prog_name="sherkit")
def cli() -> None:
    """sherkit finds the physics that a robot's model is missing."""
    loaded()


def _output() -> ModuleType:
    """What prints in colours is loaded when there is something to say."""
    return import_module(".output", __package__)


#: Tables that a check lists the mistakes of.
_TEXTS = (".csv", ".tsv", ".txt", ".dat")


def _pointer(error: SherkitError, typed: list[str]) -> str:
    """Where a person is led who has met the first of a file's mistakes."""
    source = str(error).partition(": ")[0]
    is_table = isinstance(error, MeasurementError) and source.endswith(_TEXTS) and Path(source).is_file()
    if typed[:1] == ["check"] or "--columns" in str(error):
        return ""
    if not is_table:
        return ""
    # a machine that is no robot has tables of its own, which nobody knows without its file
    own = next((one for one in typed[1:] if one.endswith(".toml") and _checks_its_tables(Path(one))), None)
    if own is None and typed[:1] == ["tool"]:
        return ""
    asked = shlex.join(("sherkit", "check", source, *(() if own is None else (own,))))
    return f"; {asked} lists all that is wrong with it"


def _checks_its_tables(path: Path) -> bool:
    """Whether a file is of a machine that checks tables in a way of its own."""
    from .machine_file import own_way_of  # loads all that a robot is asked

    return path.is_file() and own_way_of(path, "check") is not None


def run(typed: list[str]) -> None:
    """Runs what was typed; errors become one sentence and an exit code."""
    try:
        with warnings.catch_warnings():
            # what libraries have to say of their arrays is nobody's on a screen
            warnings.simplefilter("ignore", RuntimeWarning)
            warnings.showwarning = lambda message, *_, **__: _output().warn(str(message))
            code = cli.main(args=typed, prog_name="sherkit", standalone_mode=False, obj=typed)
    except SherkitError as error:
        _output().fail(f"{error}{_pointer(error, typed)}")
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
