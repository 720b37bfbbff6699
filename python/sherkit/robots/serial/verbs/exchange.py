"""``sherkit import`` and ``export`` of arms: URDF, Denavit and Hartenberg, full poses; targets for a controller."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import click

from ....cli import output
from ....cli.exchange import folder_option
from ....cli.export import written_as
from ....cli.file_kinds import CALIBRATION, KINEMATICS, ROBOT, TABLE, URDF, FileContent
from ....cli.groups import examples
from ....cli.paths import InputFile, OutputFile
from ....data.files import write_whole
from ....data.tables import write_table
from ....errors import RobotError, SherkitError
from ....model.robot_file import load_robot, save_robot
from ...calibrated import load_calibration
from ..calibration import SerialCalibration
from ..full_poses import points_of_poses
from ..identified import FOLLOWING, as_identified, in_words, lost, missed_mm
from ..imported import CONVENTIONS, import_dh, import_urdf
from ..programs import DIALECTS, Program, program_of, read_targets
from ..robot import Serial
from ..written import TOOL_LINK, dh_table, kinematics_yaml, urdf, xacro

_Tool = tuple[float, float, float, float, float, float]

# -- Into sherkit's files --------------------------------------------------------------------------------------------

_ROBOT_FILE = click.option(
    "-o", "--output", "destination", type=OutputFile(ROBOT), required=True, help="The robot file to write."
)


@click.command("urdf", epilog=examples("sherkit import urdf arm.urdf -o robot.toml"))
@click.argument("urdf", type=InputFile())
@click.option("--base", help="Link at which the arm begins; left out, the root of the file.")
@click.option("--tip", help="Link whose origin is the target; left out, the only end that the file has.")
@_ROBOT_FILE
def import_urdf_command(urdf: Path, base: str | None, tip: str | None, destination: Path) -> None:
    """An arm: the joints between two links of a URDF, as a robot.toml."""
    _write_arm(import_urdf(urdf, base, tip), destination)


@click.command("dh", epilog=examples("sherkit import dh table.csv -o robot.toml"))
@click.argument("table", type=InputFile())
@click.option("--convention", type=click.Choice(CONVENTIONS), default=CONVENTIONS[0], show_default=True)
@output.columns_option
@_ROBOT_FILE
def import_dh_command(table: Path, convention: str, destination: Path) -> None:
    """An arm: a CSV table of Denavit-Hartenberg or Hayati parameters, as a robot.toml.

    A row for each joint: d_mm, a_mm, alpha_deg, and where they are not the same for all theta_deg, beta_deg, name, type
    (revolute, prismatic, fixed), follows, and the limits low and high, degrees (mm of what slides). A joint that counts
    the other way has its axis turned round in the robot.toml: axis = [0.0, 0.0, -1.0].
    """
    _write_arm(import_dh(table, convention), destination)


def _write_arm(robot: Serial, destination: Path) -> None:
    save_robot(robot, destination)
    weighed = sum(joint.mass_kg is not None for joint in robot.joints)
    known = f"masses of {weighed}" if weighed else "no masses: links count as sticks under gravity"
    output.say(f"{destination}: {len(robot.joints)} joints, {known}")
    output.say(f"a run of it has the columns {', '.join((*robot.layout.joints, *robot.layout.coordinates))}")


@click.command("poses", epilog=examples("sherkit import poses robot.toml run.csv -o arm"))
@click.argument("robot", type=InputFile())
@click.argument("run", type=InputFile())
@click.option("--lever-mm", type=float, default=100.0, show_default=True, help="How far two more points lie off.")
@output.columns_option
@folder_option
def poses(robot: Path, run: Path, lever_mm: float, folder: Path) -> None:
    """An arm's full poses (x_mm … and rx_rad …, rx_deg … or qx …), as the places of three points of its tool."""
    arm = load_robot(robot)
    if not isinstance(arm, Serial):
        raise RobotError(f'{robot}: expected an arm (kind = "serial"), found kind = "{arm.kind}"')
    arm, data = points_of_poses(arm, run, lever_mm)
    folder.mkdir(parents=True, exist_ok=True)
    save_robot(arm, folder / "robot.toml")
    data.save(folder / "run.csv")
    output.say(f"{folder / 'robot.toml'}: the arm with targets 2 and 3, {lever_mm:g} mm along x and y of its tool")
    output.say(f"{folder / 'run.csv'}: {len(data)} rows, three for each pose")


# -- Out of them -----------------------------------------------------------------------------------------------------


def _arm(path: Path, held: tuple[str, ...] = (FOLLOWING,)) -> tuple[Serial, SerialCalibration | None]:
    """The arm of a calibration, as identified, or of a robot file, as drawn."""
    if not CALIBRATION.holds(FileContent(path)):
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
    destination: Path, arm: Serial, made: SerialCalibration | None, called: str, holds: tuple[str, ...]
) -> None:
    """What was written, and what of the calibration is not in it."""
    if made is None:
        output.say(f"{destination}: {len(arm.joints)} joints as drawn; of a calibration they are as identified",
                   destination)  # fmt: skip
        return
    less, where = lost(made, holds)
    rms, worst = missed_mm(made, arm)
    if not less:
        output.say(f"{destination}: {len(arm.joints)} joints as identified, the same poses as the calibration",
                   destination)  # fmt: skip
        return
    output.say(
        f"{destination}: {len(arm.joints)} joints as identified; {where} its target is {in_words(rms)} RMS, "
        f"{in_words(worst)} at worst, from that of the calibration",
        destination,
    )
    for one in less:
        output.say(f"{called} cannot hold {one}", destination)
    output.say(
        f"without {' and '.join(one.effect for one in less)} other numbers fit best: for {called} alone calibrate "
        "again without; sherkit export program or c hold all of it",
        destination,
    )


@click.command("urdf", epilog=examples("sherkit export urdf calibrated.toml -o arm.urdf"))
@click.argument("calibration", type=InputFile())
@written_as(URDF)
def export_urdf(calibration: Path, destination: Path) -> None:
    """An arm as identified (a robot file: as drawn), for ROS."""
    _in_xml(calibration, destination, urdf, "a URDF")


@click.command("xacro")
@click.argument("calibration", type=InputFile())
@written_as(URDF)
def export_xacro(calibration: Path, destination: Path) -> None:
    """An arm as identified (a robot file: as drawn), as a xacro."""
    _in_xml(calibration, destination, xacro, "a xacro")


def _in_xml(calibration: Path, destination: Path, text: Callable[[Serial, str], str], called: str) -> None:
    arm, made = _arm(calibration)
    write_whole(destination, text(arm, destination.name.partition(".")[0]))
    _say_of_arm(destination, arm, made, called, (FOLLOWING,))
    output.say(f"its links are base to {TOOL_LINK}; inertias are zero, effort and speed of joints placeholders",
               destination)  # fmt: skip


@click.command("dh")
@click.argument("calibration", type=InputFile())
@click.option("--convention", type=click.Choice(CONVENTIONS), default=CONVENTIONS[0], show_default=True,
              help="Of the rows.")  # fmt: skip
@written_as(TABLE)
def export_dh(calibration: Path, convention: str, destination: Path) -> None:
    """An arm as identified, as a table of Denavit and Hartenberg."""
    arm, made = _arm(calibration)
    write_table(dh_table(arm, convention), destination)
    _say_of_arm(destination, arm, made, "such a table", (FOLLOWING,))
    output.say(
        f"{convention} rows, before and behind them a fixed one to the first axis and to the target; it is read "
        f"back by sherkit import dh --convention {convention}",
        destination,
    )


@click.command("kinematics")
@click.argument("calibration", type=InputFile())
@written_as(KINEMATICS)
def export_kinematics(calibration: Path, destination: Path) -> None:
    """An arm as identified, as kinematics.yaml of ur_description (m, rad)."""
    arm, made = _arm(calibration, ())
    write_whole(destination, kinematics_yaml(arm, calibration.stem))
    _say_of_arm(destination, arm, made, "kinematics.yaml", ())
    # as that file counts: in the axes of the last joint, z along it, which are not those of a URDF
    target = ", ".join(f"{value:.4g}" for value in arm.steps[-1][:3, 3].round(6) + 0.0)
    output.say(
        f"the target is not in it: it stands at {target} mm behind the last joint, in axes whose z is the joint's",
        destination,
    )


@click.command(
    "program", epilog=examples("sherkit export program calibrated.toml targets.csv --controller kuka -o program.csv")
)
@click.argument("calibration", type=InputFile())
@click.argument("targets", type=InputFile())
@click.option("--controller", type=click.Choice([*DIALECTS]), default="plain", show_default=True,
              help="Who is given the targets.")  # fmt: skip
@click.option("--tool", type=float, nargs=6, metavar="X Y Z ROLL PITCH YAW",
              help="The tool that works, mm and deg on the flange, for the measured target.")  # fmt: skip
@click.option("--payload-kg", type=click.FloatRange(0.0), default=0.0, show_default=True,
              help="What hangs at the target.")  # fmt: skip
@click.option("--temperature-c", type=float, help="Of the arm; left out, that of the run.")
@written_as(TABLE)
def export_program(
    calibration: Path, targets: Path, controller: str, tool: _Tool | None, payload_kg: float,
    temperature_c: float | None, destination: Path,
) -> None:  # fmt: skip
    """TARGETS as the controller of an arm, which knows the drawing, needs them.

    TARGETS has x_mm … and turns, or joints.
    """
    if not CALIBRATION.holds(FileContent(calibration)):
        raise SherkitError(f"{calibration}: expected the calibration of an arm: as drawn, every target stays as it is")
    made = _calibrated_arm(calibration)
    working = None
    if tool is not None:
        x, y, z, roll, pitch, yaw = tool
        working = replace(made.robot, target_mm=(x, y, z), tool_rpy_deg=(roll, pitch, yaw))
    wanted = read_targets(working or made.robot, targets)
    program = program_of(made, wanted, tool=working, payload_kg=payload_kg, temperature_c=temperature_c)
    write_table(program.to_frame(controller), destination)
    _say_of_program(destination, program, tool)


#: Rows of which a screen says something each.
_SAID = 5


def _say_of_program(destination: Path, program: Program, tool: _Tool | None) -> None:
    count, reached = len(program.reached), int(program.reached.sum())
    said = f"{destination}: {reached} of {count} targets in reach"
    if reached:
        moved, accuracy = program.moved_mm[program.reached], program.accuracy_mm[program.reached]
        said += (
            f", moved by {in_words(float(moved.mean()))} in the mean, {in_words(float(moved.max()))} at most; "
            f"predicted within {in_words(float(accuracy.max()))} at the worst of them"
        )
    output.say(said, destination)
    noted = [(row, note) for row, note in enumerate(program.notes, start=1) if note]
    for row, note in noted[:_SAID]:
        output.say(f"target {row}: {note}", destination)
    if len(noted) > _SAID:
        output.say(f"{len(noted) - _SAID} more are noted in the column reach", destination)
    if program.targets.turns is None and program.targets.places is not None:
        nearest = "home" if program.targets.joints is None else "those given"
        output.say(f"no columns tell turns: the tool is turned as the joints nearest to {nearest} have it",
                   destination)  # fmt: skip
    whose = "that --tool says" if tool else "of the robot file: the target that was measured"
    output.say(f"they are for a controller that knows the drawing, in its base, to the tool {whose}", destination)
