"""What goes out again: an arm as URDF, xacro, tables and YAML, programs for its controller, tables for axes.

Each is read back by something else than what wrote it, and must make the same poses.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from click.testing import CliRunner, Result
from scipy.spatial.transform import Rotation

import sherkit as sk
from sherkit import from_frame, load_robot, save_robot
from sherkit.cli.verbs import cli
from sherkit.errors import CalibrationError, MeasurementError, RobotError
from sherkit.robots.compensation import axis_table, grid_table
from sherkit.robots.serial import Joint, Serial, SerialCalibration
from sherkit.robots.serial.identified import as_identified, lost, missed_mm
from sherkit.robots.serial.imported import import_dh, import_urdf
from sherkit.robots.serial.programs import DIALECTS, program_of, read_targets
from sherkit.robots.serial.written import dh_table, kinematics_yaml, urdf, xacro

#: What may be between an arm and itself read back, mm.
SAME = 1e-6


def some_arm(seed: int, count: int, *, follows: bool = True) -> Serial:
    """An arm that nobody has built: joints of both kinds, askew, some that follow the one before them."""
    rng = np.random.default_rng(seed)

    def three(size: float) -> tuple[float, float, float]:
        x, y, z = rng.normal(0.0, size, 3).tolist()
        return x, y, z

    joints = [
        Joint(
            f"j{k}", "prismatic" if rng.uniform() < 0.3 else "revolute", three(200.0), three(90.0), three(1.0),
            (-100.0, 120.0), mass_kg=2.0, centre_mm=(1.0, 2.0, 3.0),
            follows=float(rng.normal()) if follows and k and k % 2 == 0 else 0.0,
        )
        for k in range(count)
    ]  # fmt: skip
    return Serial(tuple(joints), three(100.0), three(90.0))


def as_built(tilts: float = 0.0) -> Serial:
    """Six joints of a common arm, of which axes that are parallel are so, or lean a little."""
    lean = (tilts, 2.0 * tilts, 0.0)
    return Serial(
        (
            Joint("waist", origin_mm=(0.0, 0.0, 300.0), limits=(-170.0, 170.0)),
            Joint("shoulder", origin_mm=(50.0, 0.0, 100.0), axis=(0.0, 1.0, 0.0), limits=(-90.0, 110.0)),
            Joint("elbow", origin_mm=(0.0, 0.0, 450.0), rpy_deg=lean, axis=(0.0, 1.0, 0.0), limits=(-120.0, 70.0)),
            Joint("roll", origin_mm=(200.0, 0.0, 40.0), axis=(1.0, 0.0, 0.0), limits=(-170.0, 170.0)),
            Joint("bend", origin_mm=(250.0, 0.0, 0.0), axis=(0.0, 1.0, 0.0), limits=(-110.0, 110.0)),
            Joint("turn", origin_mm=(80.0, 0.0, 0.0), axis=(1.0, 0.0, 0.0), limits=(-170.0, 170.0)),
        ),
        target_mm=(120.0, 0.0, 60.0), tool_rpy_deg=(10.0, 20.0, -30.0),
    )  # fmt: skip


ARMS: dict[str, Callable[[], Serial]] = {
    "as drawn": as_built,
    "leaning": lambda: as_built(0.05),
    **{f"{count} joints": lambda count=count: some_arm(count, count) for count in (1, 3, 6, 9)},
}


def by_urdf(arm: Serial, folder: Path) -> Serial:
    """Out and in again."""
    (folder / "arm.urdf").write_text(urdf(arm))
    return import_urdf(folder / "arm.urdf", "base", "tool")


def by_xacro(arm: Serial, folder: Path) -> Serial:
    """The same, its macro called by hand as xacro does, with a prefix."""
    text = xacro(arm, "mine")
    assert 'xmlns:xacro="http://www.ros.org/wiki/xacro"' in text
    body = re.search(r'<xacro:macro name="mine" params="prefix">(.*)</xacro:macro>', text, re.S)
    assert body
    assert '<xacro:mine prefix="$(arg prefix)" />' in text
    (folder / "made.urdf").write_text(f"<robot name='mine'>{body[1].replace('${prefix}', 'left_')}</robot>")
    return import_urdf(folder / "made.urdf", "left_base", "left_tool")


def by_dh(convention: str) -> Callable[[Serial, Path], Serial]:
    """Out and in again, in a convention."""

    def read(arm: Serial, folder: Path) -> Serial:
        dh_table(arm, convention).write_csv(folder / "dh.csv")
        return import_dh(folder / "dh.csv", convention)

    return read


WAYS = {"urdf": by_urdf, "xacro": by_xacro, "dh": by_dh("standard"), "modified": by_dh("modified")}


@pytest.mark.parametrize("arm", ARMS)
@pytest.mark.parametrize("way", WAYS)
def test_out_and_in_again_is_the_same_arm(way: str, arm: str, tmp_path: Path) -> None:
    """Catches an axis in the wrong frame, a link on the wrong side of its joint, metres for millimetres, a joint that
    no longer follows, a foot of a common normal so far away that digits are lost."""
    made = ARMS[arm]()
    back = WAYS[way](made, tmp_path)
    joints = np.random.default_rng(1).uniform(*made.ranges, (50, len(made.joints)))
    assert [joint.type for joint in back.joints] == [joint.type for joint in made.joints]
    np.testing.assert_allclose(back.ranges, made.ranges, rtol=1e-12)
    for q in joints:
        np.testing.assert_allclose(back.tool_frame(q), made.tool_frame(q), atol=SAME)
    if way in ("urdf", "xacro"):
        assert [joint.mass_kg for joint in back.joints] == [joint.mass_kg for joint in made.joints]


@pytest.mark.parametrize("arm", ["as drawn", "leaning"])
def test_a_public_library_makes_the_same_poses_of_the_urdf(arm: str, tmp_path: Path) -> None:
    """Catches a URDF that only its writer's own reader takes; where pinocchio is installed."""
    pin = pytest.importorskip("pinocchio", reason="pinocchio is not installed: pip install pin")
    made = ARMS[arm]()
    (tmp_path / "arm.urdf").write_text(urdf(made))
    model = pin.buildModelFromUrdf(str(tmp_path / "arm.urdf"))
    data, frame = model.createData(), model.getFrameId("tool", pin.FrameType.BODY)
    for q in np.random.default_rng(2).uniform(*made.ranges, (50, len(made.joints))):
        pin.framesForwardKinematics(model, data, q)
        np.testing.assert_allclose(1000.0 * data.oMf[frame].translation, made.forward(q), atol=SAME)
        np.testing.assert_allclose(data.oMf[frame].rotation, made.tool_frame(q)[:3, :3], atol=1e-9)


def test_kinematics_are_read_by_any_yaml_and_make_the_same_poses() -> None:
    """Catches degrees for radians, the frames of the drawing where the driver has those of the axes, a number that YAML
    takes for a word, links that the driver does not know."""
    yaml = pytest.importorskip("yaml")
    arm = as_built(0.05)
    made = yaml.safe_load(kinematics_yaml(arm))["kinematics"]
    assert made.pop("hash").startswith("calib_")
    assert [*made] == ["shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3"]
    for q in np.random.default_rng(3).uniform(*arm.ranges, (20, 6)):
        turn, place = np.eye(3), np.zeros(3)
        for cells, value in zip(made.values(), q, strict=True):
            place = place + turn @ (1000.0 * np.array([cells[axis] for axis in "xyz"]))
            rpy = [cells[name] for name in ("roll", "pitch", "yaw")]
            turn = turn @ Rotation.from_euler("xyz", rpy).as_matrix() @ Rotation.from_euler("z", value).as_matrix()
        flange = turn @ arm.joints[-1].turn.T
        np.testing.assert_allclose(place + flange @ np.array(arm.target_mm), arm.forward(q), atol=SAME)
    with pytest.raises(RobotError, match="'j2' follows the one before it"):
        kinematics_yaml(some_arm(3, 3))


# -- Of a calibration ---------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def made() -> SerialCalibration:
    """An arm that was measured, with what no drawing holds."""
    robot = replace(as_built(), joints=tuple(replace(joint, mass_kg=3.0) for joint in as_built().joints))
    hidden = {"yield_mrad": 0.6, "play_mrad": 0.0, "ring_mrad": 0.0, "noise_um": 20.0}
    virtual = sk.serial.VirtualSerial.simulated(robot, 4, 1.0, hidden)
    q = np.repeat(sk.serial.postures(robot, 60, 0.8, seed=9), 2, axis=0)
    places = virtual.noise_free(q) + np.random.default_rng(5).normal(0.0, 0.02, (len(q), 3))
    columns = dict(zip((*robot.layout.joints, *robot.layout.coordinates), (*q.T, *places.T), strict=True))
    run = from_frame(pl.DataFrame(columns))
    calibration = sk.calibrate(robot, run, effects=["joint_compliance", "joint_coupling"]).calibration
    assert isinstance(calibration, SerialCalibration)
    return calibration


def test_what_is_identified_is_what_is_drawn_and_what_is_not_held_is_counted(made: SerialCalibration) -> None:
    """Catches an error that is left out or put into the wrong frame, a share that is counted from another home, and a
    size of what is lost that is not what the arm then misses."""
    arm = as_identified(made)
    names = [p.name for p in made.model.parameters]
    rigid = np.array([not name.startswith("joint_compliance") for name in names])
    stiff = replace(made, whole=replace(made.whole, values=np.where(rigid, made.whole.values, 0.0)))
    q = np.random.default_rng(6).uniform(*arm.ranges, (100, 6))
    np.testing.assert_allclose(arm.forward_batch(q).values, stiff.forward_batch(q).values, atol=SAME)
    now = [*stiff.whole.now, 0.0]
    for joints in q[:10]:
        turn = stiff.core.flange(joints, now) @ made.robot.joints[-1].turn.T
        tool = Rotation.from_euler("xyz", made.robot.tool_rpy_deg, degrees=True).as_matrix()
        np.testing.assert_allclose(arm.tool_frame(joints)[:3, :3], turn @ tool, atol=1e-9)
    (only,), _ = lost(made)
    assert only.effect == "joint_compliance"
    assert only.rms_mm > 0.1
    assert (only.rms_mm, only.worst_mm) == pytest.approx(missed_mm(made, arm))
    assert {one.effect for one in lost(made, ())[0]} == {"joint_compliance", "joint_coupling"}


def poses_of(arm: Serial, count: int) -> tuple[np.ndarray, pl.DataFrame]:
    """Joints of targets, and the targets as a table."""
    q = sk.serial.postures(arm, count, 0.6, seed=3)
    frames = np.array([arm.tool_frame(one) for one in q])
    quaternions = Rotation.from_matrix(frames[:, :3, :3]).as_quat()
    names = ("x_mm", "y_mm", "z_mm", "qx", "qy", "qz", "qw")
    cells = (*frames[:, :3, 3].T, *quaternions.T)
    return q, pl.DataFrame({"name": [f"p{k}" for k in range(count)], **dict(zip(names, cells, strict=True))})


@pytest.mark.parametrize("dialect", DIALECTS)
def test_the_controller_leads_the_calibrated_arm_to_its_targets(
    dialect: str, made: SerialCalibration, tmp_path: Path
) -> None:
    """Catches angles in another order or unit, a correction with the wrong sign, a posture that is not the one that was
    asked for, a table that lost a target's name: what is written is read as the controller would, which goes to it by
    the drawing, and the calibrated arm must then be where it was to be."""
    arm, (q, table) = made.robot, poses_of(made.robot, 8)
    table.with_columns(**dict(zip(arm.layout.joints, q.T, strict=True))).write_csv(tmp_path / "targets.csv")
    program = program_of(made, read_targets(arm, tmp_path / "targets.csv"))
    program.to_frame(dialect).write_csv(tmp_path / "program.csv")
    sent = read_targets(arm, tmp_path / "program.csv")
    assert sent.others["name"].to_list() == table["name"].to_list()
    assert sent.others["reach"].str.starts_with("reached").all()
    assert sent.joints is not None
    assert sent.places is not None
    assert sent.turns is not None
    for row, (place, turn) in enumerate(zip(sent.places, sent.turns, strict=True)):
        np.testing.assert_allclose(arm.forward(sent.joints[row]), place, atol=SAME)
        np.testing.assert_allclose(arm.tool_frame(sent.joints[row])[:3, :3], turn, atol=1e-9)
        wanted = table.row(row, named=True)
        np.testing.assert_allclose(
            made.forward(sent.joints[row]), [wanted[a] for a in ("x_mm", "y_mm", "z_mm")], atol=SAME
        )
        held = made.core.flange(sent.joints[row], [*made.whole.now, 0.0]) @ arm.joints[-1].turn.T
        held = held @ Rotation.from_euler("xyz", arm.tool_rpy_deg, degrees=True).as_matrix()
        off = Rotation.from_matrix(held).inv() * Rotation.from_quat([wanted[a] for a in ("qx", "qy", "qz", "qw")])
        assert off.magnitude() < 1e-8
    assert (program.moved_mm > 0.1).all()
    assert (program.accuracy_mm > 0.0).all()
    assert np.abs(sent.joints - q).max() < 0.1


def test_a_program_of_joints_of_places_and_of_what_is_out_of_reach(made: SerialCalibration, tmp_path: Path) -> None:
    """Catches joints that are sent as they are, a place without a turn that is refused, a target out of reach that ends
    the rest or is given numbers, accuracies that stand in the wrong row."""
    arm, (q, table) = made.robot, poses_of(made.robot, 4)
    pl.DataFrame(dict(zip([f"J{k} [deg]" for k in range(1, 7)], np.rad2deg(q).T, strict=True))).write_csv(
        tmp_path / "j.csv"
    )
    table.write_csv(tmp_path / "p.csv")
    by_joints, by_poses = (program_of(made, read_targets(arm, tmp_path / name)) for name in ("j.csv", "p.csv"))
    for row, joints in enumerate(by_joints.joints):
        np.testing.assert_allclose(made.forward(joints), arm.forward(q[row]), atol=SAME)
        np.testing.assert_allclose(made.forward(by_poses.joints[row]), arm.forward(q[row]), atol=SAME)
    far = table.select("x_mm", "y_mm", "z_mm").with_columns(
        x_mm=pl.when(pl.row_index() == 1).then(5000.0).otherwise("x_mm")
    )
    far.write_csv(tmp_path / "far.csv")
    program = program_of(made, read_targets(arm, tmp_path / "far.csv"))
    rows = program.to_frame("kuka")
    assert program.reached.tolist() == [True, False, True, True]
    assert rows["reach"][1].startswith("not reached: ")
    assert rows.row(1)[:-1] == (None,) * (len(rows.columns) - 1)
    for row in (0, 2, 3):
        np.testing.assert_allclose(made.forward(program.joints[row]), far.row(row), atol=SAME)
        alone = made.predicted_accuracies_with(program.joints[[row]])
        assert rows["accuracy_mm"][row] == pytest.approx(float(alone.total_mm[0]))


def test_a_tool_that_was_not_measured_is_brought_there_too(made: SerialCalibration, tmp_path: Path) -> None:
    """Catches a tool that is taken for the target, a flange whose turn counts for nothing at the tool's tip, and
    a tool whose turn is open."""
    tool = replace(made.robot, target_mm=(0.0, 150.0, 250.0), tool_rpy_deg=(0.0, 45.0, 5.0))
    q, table = poses_of(tool, 5)
    table.write_csv(tmp_path / "p.csv")
    program = program_of(made, read_targets(tool, tmp_path / "p.csv"), tool=tool)
    assert program.reached.all()
    identified = as_identified(made)
    for row, joints in enumerate(program.joints):
        np.testing.assert_allclose(program.places[row], tool.forward(joints), atol=SAME)
        flange = made.core.flange(joints, [*made.whole.now, 0.0]) @ made.robot.joints[-1].turn.T
        tip = made.forward(joints) + flange @ (np.array(tool.target_mm) - np.array(identified.target_mm))
        np.testing.assert_allclose(tip, tool.forward(q[row]), atol=SAME)
        turn = flange @ Rotation.from_euler("xyz", tool.tool_rpy_deg, degrees=True).as_matrix()
        np.testing.assert_allclose(turn, tool.tool_frame(q[row])[:3, :3], atol=1e-8)
    table.select("x_mm", "y_mm", "z_mm").write_csv(tmp_path / "open.csv")
    with pytest.raises(MeasurementError, match="a tool of its own needs turns"):
        program_of(made, read_targets(tool, tmp_path / "open.csv"), tool=tool)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("x_mm,y_mm\n1,2\n", "'z_mm' is missing|z_mm is missing"),
        ("a,b\n1,2\n", "no columns tell targets"),
        ("x_mm,y_mm,z_mm\n1,2,three\n", "line 2: z_mm: expected a number, found 'three'"),
        ("x_mm,y_mm,z_mm\n", "holds no row"),
        ("waist_mm,shoulder_rad,elbow_rad,roll_rad,bend_rad,turn_rad\n1,2,3,4,5,6\n", "is in mm, expected rad"),
        ("x_mm,y_mm,z_mm,qx,qy,qz,qw\n1,2,3,1,1,1,1\n", "quaternion of length one"),
        (
            "waist_rad,shoulder_rad,elbow_rad,roll_rad,bend_rad,turn_rad,x_mm,y_mm,z_mm\n0,0,0,0,0,0,9,9,9\n",
            "the tracker",
        ),
    ],
)
def test_targets_that_are_none(text: str, says: str, tmp_path: Path) -> None:
    """Catches a table that is read wrongly rather than refused."""
    (tmp_path / "targets.csv").write_text(text)
    with pytest.raises(MeasurementError, match=says):
        read_targets(as_built(), tmp_path / "targets.csv")


# -- Axes -----------------------------------------------------------------------------------------------------------

STAGE = """\
import numpy as np
import sherkit as sk


def forward(q, p):
    return np.stack([q[:, 0] - p.square * q[:, 1], q[:, 1]], axis=1)


machine = sk.Machine(
    forward, joints={"x_mm": (0.0, 300.0), "y_mm": (0.0, 200.0)}, readings=("u_mm", "v_mm"),
    parameters={"square": ("rad", 1e-3)}, name="exported_stage",
)
"""


@pytest.fixture(scope="module")
def stage(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a stage, and its calibration: scales, a wave, play, and axes that are not square."""
    folder = tmp_path_factory.mktemp("stage")
    (folder / "stage.py").write_text(STAGE)
    rng = np.random.default_rng(0)
    q = np.column_stack([rng.uniform(0, 300, 300), rng.uniform(0, 200, 300)])
    side = np.sign(np.diff(q, axis=0, prepend=q[:1] - 1.0))
    w = np.column_stack([axis(q, side, k) for k in range(2)])
    shown = np.column_stack([w[:, 0] - 8e-4 * w[:, 1], w[:, 1]]) + rng.normal(0.0, 1e-5, q.shape)
    names, cells = ("time_s", "x_mm", "y_mm", "u_mm", "v_mm"), (5.0 * np.arange(len(q)), *q.T, *shown.T)
    pl.DataFrame(dict(zip(names, cells, strict=True))).write_csv(folder / "run.csv")
    effects = [word for name in ("joint_scale", "encoder_cyclic", "backlash") for word in ("--effect", name)]
    typed = ["calibrate", folder / "stage.py", folder / "run.csv", *effects, "-o", folder / "made.toml"]
    assert sherkit(*typed).exit_code == 0
    return folder


def axis(q: np.ndarray, side: np.ndarray, k: int) -> np.ndarray:
    """Where an axis of the stage really is."""
    wave = (0.01, 0.0)[k] * np.sin(2.0 * np.pi * q[:, k] / 20.0)
    return np.asarray(q[:, k] * (1.0 + (3e-4, -1e-4)[k]) + wave + (0.004, 0.002)[k] * side[:, k])


def sherkit(*arguments: object) -> Result:
    """What the command says."""
    return CliRunner().invoke(cli, [str(one) for one in arguments])


def test_a_comp_file_sets_the_axis_right(stage: Path, tmp_path: Path) -> None:
    """Catches a correction of the wrong sign, upwards and downwards exchanged, errors of the other axis or of
    squareness in it, a file that LinuxCNC stops reading: it is applied to the stage itself, as LinuxCNC's
    usrmotLoadComp does."""
    said = sherkit(
        "export", "comp", stage / "stage.py", stage / "made.toml", "--axis", "x_mm", "-o", tmp_path / "x.comp"
    )
    assert said.exit_code == 0, said.exception
    assert "COMP_FILE_TYPE = 0" in said.output
    assert "it cannot hold square" in " ".join(said.output.split())
    lines = [[float(cell) for cell in line.split()] for line in (tmp_path / "x.comp").read_text().splitlines()]
    assert len(lines) <= 256
    nominal, *ways = np.array(lines).T
    for side, way in zip((1.0, -1.0), ways, strict=True):
        sent = np.column_stack([nominal + (nominal - way), np.full_like(nominal, 100.0)])
        really = axis(sent, np.full_like(sent, side), 0)
        # the period of the wave is identified to 1 in 1000
        assert np.abs(really - nominal).max() < 1e-3
        assert np.abs(axis(np.column_stack([nominal, nominal]), np.full_like(sent, side), 0) - nominal).max() > 0.05


def test_a_grid_sets_all_of_the_machine_right(stage: Path, tmp_path: Path) -> None:
    """Catches what is added to the wrong axis, and squareness that is left out."""
    said = sherkit(
        "export", "grid", stage / "stage.py", stage / "made.toml", "--points", 7, "-o", tmp_path / "grid.csv"
    )
    assert said.exit_code == 0, said.exception
    table = pl.read_csv(tmp_path / "grid.csv")
    assert table.height == 49
    sent = table.select("x_mm", "y_mm").to_numpy() + table.select("add_x_mm", "add_y_mm").to_numpy()
    w = np.column_stack([axis(sent, np.zeros_like(sent), k) for k in range(2)])
    shown = np.column_stack([w[:, 0] - 8e-4 * w[:, 1], w[:, 1]])
    inside = np.isfinite(shown).all(axis=1)
    assert inside.sum() > 20
    assert np.abs(shown - table.select("x_mm", "y_mm").to_numpy())[inside].max() < 1e-3


def test_axes_that_have_no_table(stage: Path, made: SerialCalibration, tmp_path: Path) -> None:
    """Catches a table of an axis that there is not, of a machine that has none, and of no errors."""
    calibration = sk.load_calibration(stage / "made.toml")
    with pytest.raises(CalibrationError, match=r"--axis: name one of x_mm, y_mm"):
        axis_table(calibration)
    with pytest.raises(CalibrationError, match="'z_mm' is no axis"):
        axis_table(calibration, "z_mm")
    with pytest.raises(CalibrationError, match="2 to 256"):
        axis_table(calibration, "x_mm", 300)
    with pytest.raises(CalibrationError, match="2 to 447"):
        grid_table(calibration, 1000)
    with pytest.raises(CalibrationError, match="a serial robot has no axes"):
        axis_table(made)
    del tmp_path


# -- The command --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("word", ["urdf", "xacro", "dh", "kinematics", "kinematics.yaml"])
def test_the_command_says_what_is_in_it_and_what_is_not(word: str, made: SerialCalibration, tmp_path: Path) -> None:
    """Catches a verb that writes without saying what is lost, and one that replaces a file of another kind."""
    made.save(tmp_path / "made.toml")
    out = tmp_path / {"dh": "out.csv", "kinematics": "out.yaml", "kinematics.yaml": "out.yaml"}.get(word, f"out.{word}")
    said = sherkit("export", word, tmp_path / "made.toml", "-o", out)
    assert said.exit_code == 0, said.exception
    assert said.output.startswith(f"{out}: 6 joints as identified")
    assert "cannot hold joint_compliance: " in said.output
    assert ("cannot hold joint_coupling: " in said.output) == word.startswith("kinematics")
    if word.startswith("kinematics"):
        # the axes of the file, whose z is the joint's: typed in as those of the drawing it was 161 mm off
        arm = as_identified(made, ())
        told = re.search(r"stands at (\S+), (\S+), (\S+) mm", " ".join(said.output.split()))
        assert told is not None
        there = arm.joints[-1].turn.T @ np.array(arm.target_mm)
        np.testing.assert_allclose([float(one) for one in told.groups()], there, rtol=1e-3, atol=0.05)
    assert sherkit("export", word, tmp_path / "made.toml", "-o", out).exit_code == 0  # its own may be replaced
    out.write_text("mine\n")
    assert sherkit("export", word, tmp_path / "made.toml", "-o", out).exit_code != 0
    assert out.read_text() == "mine\n"


def test_a_folder_that_is_called_as_a_word_does_not_hide_it(
    made: SerialCalibration, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Catches a word that is taken for a file, since a package of ROS has a folder urdf; and one that is looked for in
    the name of the output."""
    made.save(tmp_path / "made.toml")
    (tmp_path / "urdf").mkdir()
    monkeypatch.chdir(tmp_path)
    assert sherkit("export", "urdf", "made.toml", "-o", "arm.urdf").exit_code == 0
    assert sherkit("export", "-o", "again.urdf", "urdf", "made.toml").exit_code == 0
    refused = sherkit("export", "-o", "dh", "run.sqlite")
    assert "dh: expected a name that ends in .csv or .parquet" in f"{refused.exception} {refused.output}"


def test_the_command_refuses_in_sentences(made: SerialCalibration, stage: Path, tmp_path: Path) -> None:
    """Catches a traceback, and an option that is taken in silence where it does nothing."""
    made.save(tmp_path / "made.toml")
    save_robot(made.robot, tmp_path / "arm.toml")
    (tmp_path / "targets.csv").write_text("x_mm,y_mm,z_mm\n300,0,700\n")
    drawn = sherkit("export", "urdf", tmp_path / "arm.toml", "-o", tmp_path / "drawn.urdf")
    assert "6 joints as drawn" in drawn.output
    assert load_robot(tmp_path / "arm.toml").kind == "serial"
    out, robot, calibration = tmp_path / "new.csv", tmp_path / "arm.toml", tmp_path / "made.toml"
    for typed, says in (
        (("program", robot, tmp_path / "targets.csv"), "as drawn, every target stays as it is"),
        (("program", calibration), "Missing argument 'TARGETS'"),
        (("program", calibration, tmp_path / "none.csv"), "there is no such file"),
        (("dh", calibration, "--axis", "x_mm"), "No such option '--axis'"),
        (("dh", stage / "made.toml"), "expected"),
        (("grid", robot, calibration), "a serial robot has no axes"),
        (("grid", stage / "stage.py", calibration), "is the calibration of serial"),
    ):
        refused = sherkit("export", *typed, "-o", out)
        assert refused.exit_code != 0
        assert says in f"{refused.exception} {refused.output}", typed
        assert not out.exists()
