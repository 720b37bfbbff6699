"""``sherkit export``: what sherkit found, as files of other programs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import click
import numpy as np

from ..base.names import listed
from ..data.files import write_whole
from ..data.tables import write_table
from ..errors import RobotError, SherkitError
from ..model.robot_file import load_robot
from ..robots.c_header import calibration_header
from ..robots.calibrated import Calibration, load_calibration
from ..robots.compensation import axis_table, grid_table
from ..robots.machine import robot_at
from ..robots.printer.calibration import PrinterCalibration, commands, held, klipper_config
from ..robots.printer.robot import FIRMWARES
from ..robots.serial import Serial, SerialCalibration
from ..robots.serial.identified import FOLLOWING, as_identified, in_words, lost, missed_mm
from ..robots.serial.imported import CONVENTIONS
from ..robots.serial.programs import DIALECTS, Program, program_of, read_targets
from ..robots.serial.written import TOOL_LINK, dh_table, kinematics_yaml, urdf, xacro
from . import output
from .file_kinds import CALIBRATION, COMMANDS, COMPENSATION, HEADER, KINEMATICS, KLIPPER, TABLE, URDF, FileKind, Look
from .machine_file import own_way_of
from .paths import InputFile, OutputFile, require_kind


@dataclass(frozen=True)
class _Asked:
    """What was typed: the files behind the word, where to write, the options."""

    files: tuple[Path, ...]
    destination: Path
    config: Path | None
    convention: str
    controller: str
    tool: tuple[float, float, float, float, float, float] | None
    payload_kg: float
    temperature_c: float | None
    axis: str | None
    points: int | None

    @property
    def file(self) -> Path:
        """The first of the files."""
        return self.files[0]


@dataclass(frozen=True)
class _Way:
    """What is written for a word: its kind of file, how, the files that it reads, and options that are for it."""

    kind: FileKind
    write: Callable[[_Asked], None]
    reads: str = "CALIBRATION"
    options: tuple[str, ...] = ()


# -- Arms -----------------------------------------------------------------------------------------------------------


def _arm(path: Path, held: tuple[str, ...] = (FOLLOWING,)) -> tuple[Serial, SerialCalibration | None]:
    """The arm of a calibration, as identified, or of a robot file, as drawn."""
    if not CALIBRATION.holds(Look(path)):
        robot = load_robot(path)
        if not isinstance(robot, Serial):
            raise RobotError(f'{path}: expected an arm (kind = "serial") or its calibration, found "{robot.kind}"')
        return robot, None
    made = _calibrated_arm(path)
    return as_identified(made, held), made


def _calibrated_arm(path: Path) -> SerialCalibration:
    made = load_calibration(path)
    if not isinstance(made, SerialCalibration):
        raise SherkitError(f'{path}: expected the calibration of an arm (kind = "serial"), found "{made.robot.kind}"')
    return made


def _say_of_arm(
    asked: _Asked, arm: Serial, made: SerialCalibration | None, called: str, holds: tuple[str, ...]
) -> None:
    """What was written, and what of the calibration is not in it."""
    if made is None:
        output.say(f"{asked.destination}: {len(arm.joints)} joints as drawn; of a calibration they are as identified",
                   asked.destination)  # fmt: skip
        return
    less, where = lost(made, holds)
    rms, worst = missed_mm(made, arm)
    if not less:
        output.say(f"{asked.destination}: {len(arm.joints)} joints as identified, the same poses as the calibration",
                   asked.destination)  # fmt: skip
        return
    output.say(
        f"{asked.destination}: {len(arm.joints)} joints as identified; {where} its target is {in_words(rms)} RMS, "
        f"{in_words(worst)} at worst, from that of the calibration",
        asked.destination,
    )
    for one in less:
        output.say(f"{called} cannot hold {one}", asked.destination)
    output.say(
        f"without {' and '.join(one.effect for one in less)} other numbers fit best: for {called} alone calibrate "
        "again without; sherkit export program or c hold all of it",
        asked.destination,
    )


def _urdf(asked: _Asked) -> None:
    _in_xml(asked, urdf, "a URDF")


def _xacro(asked: _Asked) -> None:
    _in_xml(asked, xacro, "a xacro")


def _in_xml(asked: _Asked, text: Callable[[Serial, str], str], called: str) -> None:
    arm, made = _arm(asked.file)
    write_whole(asked.destination, text(arm, asked.destination.name.partition(".")[0]))
    _say_of_arm(asked, arm, made, called, (FOLLOWING,))
    output.say(f"its links are base to {TOOL_LINK}; inertias are zero, effort and speed of joints placeholders",
               asked.destination)  # fmt: skip


def _dh(asked: _Asked) -> None:
    arm, made = _arm(asked.file)
    write_table(dh_table(arm, asked.convention), asked.destination)
    _say_of_arm(asked, arm, made, "such a table", (FOLLOWING,))
    output.say(
        f"{asked.convention} rows, before and behind them a fixed one to the first axis and to the target; it is read "
        f"back by sherkit import dh --convention {asked.convention}",
        asked.destination,
    )


def _kinematics(asked: _Asked) -> None:
    arm, made = _arm(asked.file, ())
    write_whole(asked.destination, kinematics_yaml(arm, asked.file.stem))
    _say_of_arm(asked, arm, made, "kinematics.yaml", ())
    target = ", ".join(f"{value:.4g}" for value in arm.target_mm)
    output.say(f"the target is not in it: it stands at {target} mm behind the last joint", asked.destination)


def _program(asked: _Asked) -> None:
    """Targets for the controller, which knows the drawing."""
    if not CALIBRATION.holds(Look(asked.file)):
        raise SherkitError(f"{asked.file}: expected the calibration of an arm: as drawn, every target stays as it is")
    made = _calibrated_arm(asked.file)
    tool = None
    if asked.tool is not None:
        x, y, z, roll, pitch, yaw = asked.tool
        tool = replace(made.robot, target_mm=(x, y, z), tool_rpy_deg=(roll, pitch, yaw))
    targets = read_targets(tool or made.robot, asked.files[1])
    program = program_of(made, targets, tool=tool, payload_kg=asked.payload_kg, temperature_c=asked.temperature_c)
    write_table(program.to_frame(asked.controller), asked.destination)
    _say_of_program(asked, program)


#: Rows of which a screen says something each.
_SAID = 5


def _say_of_program(asked: _Asked, program: Program) -> None:
    count, reached = len(program.reached), int(program.reached.sum())
    said = f"{asked.destination}: {reached} of {count} targets in reach"
    if reached:
        moved, accuracy = program.moved_mm[program.reached], program.accuracy_mm[program.reached]
        said += (
            f", moved by {in_words(float(moved.mean()))} in the mean, {in_words(float(moved.max()))} at most; "
            f"predicted within {in_words(float(accuracy.max()))} at the worst of them"
        )
    output.say(said, asked.destination)
    noted = [(row, note) for row, note in enumerate(program.notes, start=1) if note]
    for row, note in noted[:_SAID]:
        output.say(f"target {row}: {note}", asked.destination)
    if len(noted) > _SAID:
        output.say(f"{len(noted) - _SAID} more are noted in the column reach", asked.destination)
    if program.targets.turns is None and program.targets.places is not None:
        nearest = "home" if program.targets.joints is None else "those given"
        output.say(f"no columns tell turns: the tool is turned as the joints nearest to {nearest} have it",
                   asked.destination)  # fmt: skip
    whose = "that --tool says" if asked.tool else "of the robot file: the target that was measured"
    output.say(f"they are for a controller that knows the drawing, in its base, to the tool {whose}", asked.destination)


# -- Axes ---------------------------------------------------------------------------------------------------------


def _of_machine(asked: _Asked) -> Calibration:
    """The calibration of a machine, whose Python file was named before it and is run."""
    robot, _ = robot_at(asked.file)
    made = load_calibration(asked.files[1])
    if made.robot.kind != robot.kind:
        made_of, found = asked.file, made.robot.kind
        raise SherkitError(f"{asked.files[1]}: is the calibration of {found}, {made_of} makes {robot.kind}")
    return made


def _comp(asked: _Asked) -> None:
    made = _of_machine(asked)
    table = axis_table(made, asked.axis, asked.points or 101)
    write_whole(asked.destination, table.linuxcnc())
    unit = table.unit
    output.say(
        f"{asked.destination}: {table.axis}, {len(table.nominal)} lines, {table.largest:.4g} {unit} at most, "
        f"{table.reversal:.4g} {unit} between both directions; {table.left:.2g} {unit} are left between lines",
        asked.destination,
    )
    output.say(f"LinuxCNC reads it with COMP_FILE = {asked.destination.name} and COMP_FILE_TYPE = 0, in {unit}",
               asked.destination)  # fmt: skip
    if table.others:
        output.say(f"it cannot hold {listed(table.others)}: a grid can, as far as that depends on the axes alone",
                   asked.destination)  # fmt: skip


def _grid(asked: _Asked) -> None:
    made = _of_machine(asked)
    table = grid_table(made, asked.points or 11)
    write_table(table, asked.destination)
    add = np.abs(table.select(name for name in table.columns if name.startswith("add_")).drop_nulls().to_numpy())
    gone = table.height - len(add)
    largest = add.max(axis=0, initial=0.0).tolist()
    most = ", ".join(f"{size:.4g} of {name}" for name, size in zip(made.model.layouts[0].joints, largest, strict=True))
    output.say(f"{asked.destination}: {table.height} points, adding {most} at most", asked.destination)
    if gone:
        output.say(f"{gone} points are empty: beyond what its axes reach", asked.destination)


# -- Runs, C, firmware ----------------------------------------------------------------------------------------------


def _c(asked: _Asked) -> None:
    """A calibrated robot, or a machine that has a header of its own, as a C header."""
    calibration, destination = asked.file, asked.destination
    if (own_way := own_way_of(calibration, "export")) is not None:
        own_way(destination)
        return
    write_whole(destination, calibration_header(load_calibration(calibration), calibration.name))
    output.say(f"{destination} written; cc loop.c $(sherkit c --cflags --libs) links it (sherkit c --example FOLDER)")


def _printer(firmware: str) -> Callable[[_Asked], None]:
    """A calibrated printer for its firmware, and what that cannot hold."""

    def write(asked: _Asked) -> None:
        calibration, destination, config = asked.file, asked.destination, asked.config
        made = Calibration.load(calibration)
        if not isinstance(made, PrinterCalibration):
            raise SherkitError(
                f"{calibration}: is of {made.robot.kind}; only the calibration of a printer goes into a firmware"
            )
        names = [p.name for p in made.whole.model(made.robot).parameters]
        found = held(made.robot, dict(zip(names, made.whole.values.tolist(), strict=True)))
        if firmware == "klipper":
            if config is None:
                raise SherkitError("--config: name the printer.cfg into which the numbers go")
            write_whole(destination, klipper_config(config, found.towers))
        else:
            lines = commands(replace(made.robot, firmware=firmware), found.towers)
            write_whole(destination, "\n".join(lines) + "\n")
        output.say(f"{destination} written")
        if made.whole.effects:
            output.say(
                f"{firmware} cannot hold {' and '.join(made.whole.effects)}: {1e3 * found.rms_mm:.0f} µm RMS of the "
                f"height over the plate remain, {1e3 * found.largest_mm:.0f} µm at worst; put the machine right, then "
                "probe again"
            )

    return write


_WAYS = {
    "c": _Way(HEADER, _c),
    "urdf": _Way(URDF, _urdf),
    "xacro": _Way(URDF, _xacro),
    "dh": _Way(TABLE, _dh, options=("convention",)),
    "kinematics": _Way(KINEMATICS, _kinematics),
    "program": _Way(TABLE, _program, "CALIBRATION TARGETS", ("controller", "tool", "payload_kg", "temperature_c")),
    "comp": _Way(COMPENSATION, _comp, "MACHINE CALIBRATION", ("axis", "points")),
    "grid": _Way(TABLE, _grid, "MACHINE CALIBRATION", ("points",)),
} | {
    name: _Way(KLIPPER if name == "klipper" else COMMANDS, _printer(name), options=("config",)) for name in FIRMWARES
}  # fmt: skip


@click.command()
@click.argument(
    "what",
    type=InputFile(words="|".join((*_WAYS, r"kinematics\.yaml"))),
    nargs=-1,
    required=True,
    metavar="RUN_FILE | WORD [MACHINE] CALIBRATION [TARGETS]",
)
@click.option("-o", "--output", "destination", required=True, help="The file to write.",
              type=OutputFile(TABLE, HEADER, KLIPPER, COMMANDS, URDF, KINEMATICS, COMPENSATION))  # fmt: skip
@click.option("--convention", type=click.Choice(CONVENTIONS), default=CONVENTIONS[0], show_default=True,
              help="Of the rows (dh).")  # fmt: skip
@click.option("--controller", type=click.Choice([*DIALECTS]), default="plain", show_default=True,
              help="Who is given the targets (program).")  # fmt: skip
@click.option("--tool", type=float, nargs=6, metavar="X Y Z ROLL PITCH YAW",
              help="The tool that works, mm and deg on the flange, for the measured target (program).")  # fmt: skip
@click.option("--payload-kg", type=click.FloatRange(0.0), default=0.0, show_default=True,
              help="What hangs at the target (program).")  # fmt: skip
@click.option("--temperature-c", type=float, help="Of the arm; left out, that of the run (program).")
@click.option("--axis", help="Which one, by its column, as x_mm (comp).")
@click.option("--points", type=click.IntRange(2), help="Of an axis; 101 of comp, 11 of grid.")
@click.option("--config", type=InputFile(), help="The printer.cfg to write the numbers into (klipper).")
def export(
    what: tuple[str | Path, ...], destination: Path, convention: str, controller: str,
    tool: tuple[float, float, float, float, float, float] | None, payload_kg: float,
    temperature_c: float | None, axis: str | None, points: int | None, config: Path | None,
) -> None:  # fmt: skip
    """Write the rows of RUN_FILE as CSV or Parquet, also while it is being measured; or what WORD says:

    \b
    c                  a calibrated robot or a flexible tool as a C header
    urdf, xacro        an arm as identified (a robot file: as drawn), for ROS
    dh                 the same as a table of Denavit and Hartenberg
    kinematics         the same as kinematics.yaml of ur_description (m, rad)
    program            TARGETS (x_mm … and turns, or joints) as the controller
                       of an arm, which knows its drawing, must be given them
    comp, grid         of MACHINE (its .py) and its calibration: compensation of
                       an axis (LinuxCNC), of all axes
    klipper, reprapfirmware, marlin
                       a printer's calibration for its firmware
    """
    # as that file is called, too
    word, files = str(what[0]).replace("kinematics.yaml", "kinematics"), tuple(Path(one) for one in what[1:])
    way = _WAYS.get(word)
    wanted = len(way.reads.split()) if way else 0
    if way is None and len(what) == 1:
        # only what reads a run's file needs SQLite
        from ..lab.experiment import export_run

        require_kind(destination, "--output", (TABLE,))
        output.refuse_given("what", "destination", why="is not for the rows of a run")
        rows = export_run(what[0], destination)
        output.say(f"{rows} rows written to {destination}", destination)
        return
    if way is None or len(files) != wanted:
        raise click.UsageError(
            f"expected {word} {way.reads}" if way else
            "expected the file of a run; c and the file of a calibration or a flexible tool; or one of "
            f"{', '.join(one for one in _WAYS if one != 'c')} and the file of a calibration"
        )  # fmt: skip
    require_kind(destination, "--output", (way.kind,))
    output.refuse_given("what", "destination", *way.options, why=f"is not for {word}")
    way.write(
        _Asked(files, destination, config, convention, controller, tool, payload_kg, temperature_c, axis, points)
    )  # fmt: skip
