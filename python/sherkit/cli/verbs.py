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

from ..base.extensions import VERBS
from ..base.starting import loaded
from ..errors import MeasurementError, SherkitError
from .groups import OpenGroup, told

# -- What a help ends with --------------------------------------------------------------------------------------------

#: Lines that can be typed as they stand. A test parses each of them.
EXAMPLES: dict[str, tuple[str, ...]] = {
    "app": ("sherkit app robot.toml run.csv", "sherkit app robot.toml run.csv --follow --study monday"),
    "c": ("sherkit c --cflags --libs", "sherkit c --example my_loop"),
    "calibrate": (
        "sherkit calibrate robot.toml run.csv -o calibrated.toml",
        "sherkit calibrate robot.toml whole.csv --local near.csv --effect rail_lean --report calibration.html",
    ),
    "check": ("sherkit check run.csv", "sherkit check run.csv robot.toml --write clean.csv"),
    "compare": ("sherkit compare robot.toml monday.csv friday.csv",),
    "completion": ("sherkit completion bash",),
    "demo": ("sherkit demo",),
    "diagnose": (
        "sherkit diagnose robot.toml run.csv",
        "sherkit diagnose robot.toml run.csv --effects my_effects.py --report diagnosis.html",
    ),
    "doctor": ("sherkit doctor",),
    "effects": ("sherkit effects", "sherkit effects backlash --picture backlash.svg"),
    "estimate": ("sherkit estimate tool.toml run.csv -o estimate.csv",),
    "export": (
        "sherkit export experiment.sqlite -o run.csv",
        "sherkit export c calibrated.toml -o robot.h",
        "sherkit export urdf calibrated.toml -o arm.urdf",
        "sherkit export program calibrated.toml targets.csv --controller kuka -o program.csv",
        "sherkit export klipper calibrated.toml --config printer.cfg -o new.cfg",
    ),
    "fleet": ("sherkit fleet machine_*.csv --robot robot.toml",),
    "history": ("sherkit history robot.toml january.csv april.csv july.csv --dates 2026-01-10,2026-04-09,2026-07-12",),
    "home": ("sherkit home experiment.toml", "sherkit home experiment.toml --at 128.9,128.9,128.9"),
    "import": (
        "sherkit import klipper printer.cfg -o printer",
        "sherkit import urdf arm.urdf -o robot.toml",
        "sherkit import bluesky run.jsonl --column q1_mm=rails_q1 --column x_mm=laser_x -o run.csv",
        "sherkit import rosbag recorded --joint q1_mm=rail_1 --poses /tracker -o run.csv",
    ),
    "intrinsics": ("sherkit intrinsics boards/ --chessboard 9x6 --square-mm 10 -o camera.toml",),
    "lab": ("sherkit lab --demo", "sherkit lab lab.toml --ports ports.json"),
    "markers": (
        "sherkit markers --print marker.pdf",
        "sherkit markers pictures/ --joints joints.csv -o run.csv",
    ),
    "measure": (
        "sherkit measure experiment.toml --live",
        "sherkit measure experiment.toml --until diagnosed",
        "sherkit measure experiment.toml --python my_lab.py --resume",
    ),
    "plan": (
        "sherkit plan robot.toml experiment.toml --noise-um 2",
        "sherkit plan calibrated.toml --verify --poses 20",
    ),
    "printer": (
        "sherkit printer printer.cfg --report printer.html",
        "sherkit printer printer.cfg --plate turned=60 -o new.cfg",
    ),
    "register": ("sherkit register tool.toml camera.csv -o registered.toml",),
    "schema": ("sherkit schema experiment",),
    "simulate": ("sherkit simulate robot.toml -o run.csv --seed 3",),
    "tool": ("sherkit tool bench.csv free.csv run.csv -o tool.toml --report tool.html",),
    "verify": ("sherkit verify calibrated.toml check.csv --fail-if-invalid",),
}


def epilog(verb: str) -> str:
    """The last paragraph of a verb's help."""
    return "\n".join(["\b", "Examples:", *(f"  {line}" for line in EXAMPLES[verb])])


# -- The command ------------------------------------------------------------------------------------------------------

#: The verbs by what they are for, each with where it stands (a file here, loaded when its verb is typed, and the name
#: in it) and what it does in a line.
_GROUPS = {
    "Start": {
        "demo": ("demo.demo", "the whole way on a virtual robot, in half a minute"),
        "doctor": ("doctor.doctor", "what is installed, what is missing, how to fix it"),
        "completion": ("doctor.completion", "verbs, options and files completed with the tab key"),
    },
    "Diagnose": {
        "diagnose": ("diagnose.diagnose", "which effect the model of a robot is missing on a run"),
        "calibrate": ("calibrate.calibrate", "identify a robot, correct it, predict its accuracy"),
        "app": ("app.app", "the same on a page, to click"),
        "check": ("check.check", "all that is wrong with a file of measurements, mended"),
        "effects": ("effects.effects", "the effects that can be found and added"),
        "compare": ("changes.compare", "what has changed between two runs of a machine"),
        "history": ("changes.history", "its course over many runs: steps, wear, season"),
        "verify": ("changes.verify", "whether a calibration still holds, by a dozen poses"),
        "fleet": ("changes.fleet_command", "many runs of machines built alike, in one table"),
        "simulate": ("effects.simulate", "a run with errors planted in it"),
    },
    "Measure": {
        "plan": ("plan.plan", "what an experiment could find, before it is driven"),
        "home": ("measure.home", "set the zero of axes"),
        "measure": ("measure.measure", "drive to each pose, read the instruments"),
        "lab": ("lab.lab", "emulated instruments of a laboratory"),
        "export": ("export.export", "rows of a run; a calibration for a controller, C or ROS"),
        "schema": ("schema.schema", "what a file may hold, as JSON schema"),
    },
    "Import, cameras, C": {
        "import": ("exchange.import_group", "files of other programs into robot.toml and run.csv"),
        "markers": ("vision.markers", "where a marker is in pictures"),
        "intrinsics": ("vision.intrinsics", "focal lengths, centre, distortion of a camera"),
        "c": ("c_library.c_library", "header and library for a control loop in C or C++"),
    },
    "Flexible tool": {
        "tool": ("tool_story.tool_story", "a tool file from known loads, its story in a run"),
        "estimate": ("tool.estimate", "depth and tip of a tool along a run"),
        "register": ("tool.register", "frame and clock of its camera"),
    },
    "Printer": {
        "printer": ("printer.printer", "what is wrong with a delta printer, by what it probed"),
    },
}
_VERBS = {name: place for group in _GROUPS.values() for name, (place, _) in group.items()}


class _Verbs(OpenGroup):
    """Knows the names of its commands; each is loaded when it is called, or told of in a help."""

    declared = VERBS
    own = _VERBS

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in _VERBS:
            return super().get_command(ctx, cmd_name)
        file, _, name = _VERBS[cmd_name].partition(".")
        command: click.Command = getattr(import_module(f".{file}", __package__), name)
        command.epilog = epilog(cmd_name)
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """By what they are for, a line each."""
        for title, group in _GROUPS.items():
            with formatter.section(title):
                formatter.write_dl([(name, said) for name, (_, said) in group.items()])
        if more := self.brought:
            with formatter.section("Of other packages"):
                formatter.write_dl([(name, told(command)) for name, command in more.items()])


@click.group(
    cls=_Verbs,
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
    return f"; sherkit check {shlex.quote(source)} lists all that is wrong with it" if is_table else ""


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
