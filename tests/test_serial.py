"""Serial arms: files, imports, kinematics, identification and diagnosis. What is hidden comes from
``second_simulator/serial.py``, which shares no formula with the core."""

from __future__ import annotations

import tomllib
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import sherkit as sk
from running import slow
from second_arms import SecondArm
from second_simulator import draw_pose
from sherkit.base.types import Floats
from sherkit.cli import main
from sherkit.errors import ExperimentError, OutOfReach, RobotError, ShapeError
from sherkit.lab.experiment import load_experiment
from sherkit.model.kinds import kind_of, known_kinds, model_of, robot_from_tables
from sherkit.model.robot_file import run_for
from sherkit.model.sensor_pose import SensorPose
from sherkit.robots.serial import KIND, Hidden, Joint, Plane, Serial, VirtualSerial, postures
from sherkit.robots.serial.frames import of_rpy, rpy_of
from sherkit.robots.serial.imported import import_dh, import_urdf

#: The UR5 of its maker's documents, a target beside its last axis, and no part of its limits beyond what cables allow.
UR5 = """name,d_mm,a_mm,alpha_deg
shoulder_pan,89.159,0,90
shoulder_lift,0,-425,0
elbow,0,-392.25,0
wrist_1,109.15,0,90
wrist_2,94.65,0,-90
wrist_3,82.3,0,0
"""
NOISE_MM = 0.05
PLAIN = {"noise_um": 1e3 * NOISE_MM, "yield_mrad": 0.0, "play_mrad": 0.0, "ring_mrad": 0.0}

URDF = """<?xml version="1.0"?>
<robot name="small">
  <link name="world"/><link name="foot"/>
  <link name="a"><inertial><origin xyz="0 0 0.2"/><mass value="3"/></inertial></link>
  <link name="box"><inertial><mass value="1"/></inertial></link>
  <link name="b"><inertial><mass value="2"/></inertial></link>
  <link name="tip"/>
  <joint name="bolt" type="fixed"><parent link="world"/><child link="foot"/><origin xyz="0 0 0.1"/></joint>
  <joint name="turn" type="continuous"><parent link="foot"/><child link="a"/><axis xyz="0 0 1"/></joint>
  <joint name="glue" type="fixed"><parent link="a"/><child link="box"/><origin xyz="0 0 1"/></joint>
  <joint name="slide" type="prismatic"><parent link="a"/><child link="b"/>
    <origin xyz="0 0 0.4" rpy="0 1.5707963267948966 0"/><axis xyz="0 0 2"/>
    <limit lower="0.1" upper="0.3" effort="1" velocity="1"/></joint>
  <joint name="end" type="fixed"><parent link="b"/><child link="tip"/><origin xyz="0 0.05 0"/></joint>
</robot>
"""


@pytest.fixture
def ur5(tmp_path: Path) -> Serial:
    """The arm of the table above."""
    (tmp_path / "ur5.csv").write_text(UR5)
    return replace(import_dh(tmp_path / "ur5.csv"), target_mm=(60.0, 20.0, 50.0))


def gantry() -> Serial:
    """Three joints that slide and one that turns, its axes askew."""
    return Serial(
        (
            Joint("along", "prismatic", axis=(1.0, 0.0, 0.0), limits=(0.0, 800.0)),
            Joint("aside", "prismatic", origin_mm=(0.0, 50.0, 0.0), axis=(0.0, 1.0, 0.1), limits=(0.0, 500.0)),
            Joint("up", "prismatic", axis=(0.0, 0.0, -1.0), limits=(-300.0, 0.0)),
            Joint("spindle", origin_mm=(0.0, 0.0, -80.0), rpy_deg=(10.0, 90.0, 0.0)),
        ),
        target_mm=(40.0, 10.0, 120.0),
    )


def palletiser() -> Serial:
    """A parallelogram keeps the fore arm's angle when the upper arm turns."""
    joints = list(KIND.example.joints)
    joints[2] = replace(joints[2], follows=-1.0)
    return replace(KIND.example, joints=tuple(joints))


# -- what is drawn -------------------------------------------------------------------------------------------------


def test_standard_modified_and_urdf_are_one_arm(tmp_path: Path, ur5: Serial) -> None:
    """Catches a convention whose shift or turn is on the wrong side of its joint, and an offset of the wrong sign."""

    def about(axis: str, angle: float) -> Any:
        return Rotation.from_euler(axis, angle).as_matrix()

    rows = [[float(cell) for cell in line.split(",")[1:]] for line in UR5.splitlines()[1:]]
    q = np.array([0.3, -1.1, 1.4, -0.7, 0.9, 0.4])
    turn, point = np.eye(3), np.zeros(3)
    for angle, (d, a, alpha) in zip(q, rows, strict=True):
        turn = turn @ about("z", angle)
        point = point + turn @ [a, 0.0, d]
        turn = turn @ about("x", np.deg2rad(alpha))
    np.testing.assert_allclose(ur5.forward(q), point + turn @ [60.0, 20.0, 50.0], atol=1e-9)
    np.testing.assert_allclose(ur5.tool_frame(q)[:3, :3], turn, atol=1e-12)
    # the modified table of the same arm has each row's a and α one row later
    later = [(0.0, 0.0), *((a, alpha) for _, a, alpha in rows)]
    table = "d_mm,a_mm,alpha_deg,theta_deg\n" + "".join(
        f"{d},{a},{alpha},10\n" for (d, _, _), (a, alpha) in zip(rows, later, strict=False)
    )
    (tmp_path / "modified.csv").write_text(table)
    other = replace(import_dh(tmp_path / "modified.csv", "modified"), target_mm=(60.0, 20.0, 50.0))
    np.testing.assert_allclose(other.forward(q - np.deg2rad(10.0)), ur5.forward(q), atol=1e-9)


def test_hayati_leans_an_axis_that_is_nearly_parallel(tmp_path: Path) -> None:
    """Catches a β that turns before α, or about another axis."""
    (tmp_path / "t.csv").write_text("d_mm,a_mm,alpha_deg,beta_deg\n0,300,2,-3\n0,200,0,0\n")
    q = np.array([0.4, -0.8])
    turn = Rotation.from_euler("ZXY", [q[0], np.deg2rad(2), np.deg2rad(-3)])
    expected = Rotation.from_euler("z", q[0]).apply([300, 0, 0]) + (turn * Rotation.from_euler("z", q[1])).apply(
        [200, 0, 0]
    )
    np.testing.assert_allclose(import_dh(tmp_path / "t.csv").forward(q), expected, atol=1e-9)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("d_mm,a_mm,alpha_deg\n89,159,0,90\n", "row 1 has more cells than there are columns"),
        ("d_mm,d_mm,a_mm,alpha_deg\n1,2,3,4\n", "column 'd_mm' is there twice"),
        ("name,d_mm,a_mm,alpha_deg\na,1,2,90\na,1,2,0\n", r"t\.csv: row 2: name: 'a' is the joint of row 1 already"),
        ("d_mm,a_mm,alpha_deg,follows\n1,2,90,0.5\n", r"t\.csv: joint joint_1: follows the one before it"),
    ],
)
def test_a_table_that_is_none_is_refused(text: str, said: str, tmp_path: Path) -> None:
    """Catches a decimal comma that moves every cell, a column that hides another, and a mistake without its file."""
    (tmp_path / "t.csv").write_text(text)
    with pytest.raises(RobotError, match=said):
        import_dh(tmp_path / "t.csv")


def test_a_urdf_is_folded_and_weighed(tmp_path: Path) -> None:
    """Catches metres taken for millimetres, a fixed joint that is lost, an axis of no unit length, a mass that hangs on
    the wrong joint or from the wrong place, and limits of another unit."""
    (tmp_path / "small.urdf").write_text(URDF)
    arm = import_urdf(tmp_path / "small.urdf", tip="tip")
    assert [joint.name for joint in arm.joints] == ["turn", "slide"]
    assert arm.layout.joints == ("turn_rad", "slide_mm")
    np.testing.assert_allclose(arm.forward([np.pi / 2, 150.0]), [-50.0, 150.0, 500.0], atol=1e-9)
    assert arm.joints[1].limits == (100.0, 300.0)
    assert arm.joints[0].limits is None
    # 3 kg at 0.2 m and 1 kg at 1 m
    assert arm.joints[0].mass_kg == pytest.approx(4.0)
    np.testing.assert_allclose(arm.joints[0].centre_mm, [0.0, 0.0, 400.0])
    assert arm.joints[1].mass_kg == pytest.approx(2.0)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('type="fixed"', 'type="floating"', "joint 'bolt' is floating"),
        ("<robot", "<xacro:robot xmlns:xacro='http://ros.org/xacro' x", "no XML|is a xacro"),
        ('xyz="0 0 2"', 'xyz="0 0 0"', "its axis has no direction"),
        ('xyz="0 0 0.4"', 'xyz="0 0"', "'slide': origin xyz: expected 3 numbers, found '0 0'"),
        ('<parent link="a"/><child link="b"/>', '<parent link="a"/><child link="c"/>', "its child 'c' is no link"),
        ('link name="tip"', 'link name="tup"', "no link of the file"),
        ('<axis xyz="0 0 1"/>', '<axis xyz="0 0 1"/><mimic joint="slide"/>', "follows another"),
        ("<robot", "<!DOCTYPE x []><robot", "DOCTYPE"),
        ("<robot", "<roboter", "no XML|expected <robot>"),
    ],
)
def test_what_is_no_arm_is_refused_in_a_sentence(tmp_path: Path, old: str, new: str, said: str) -> None:
    """Catches a URDF that is read as if it were whole, and an error that no person can act on."""
    (tmp_path / "small.urdf").write_text(URDF.replace(old, new, 1))
    with pytest.raises(RobotError, match=said):
        import_urdf(tmp_path / "small.urdf", tip="tip")


def test_a_tip_is_asked_for_and_must_hang_on_the_base(tmp_path: Path) -> None:
    """Catches a guess at one of several ends, and a chain that runs upwards."""
    (tmp_path / "small.urdf").write_text(URDF)
    with pytest.raises(RobotError, match=r"name the link at the end of the arm \(--tip\): there are box, tip"):
        import_urdf(tmp_path / "small.urdf")
    with pytest.raises(RobotError, match="'foot' does not hang on 'b'"):
        import_urdf(tmp_path / "small.urdf", "b", "foot")
    with pytest.raises(RobotError, match="is no link of the file; did you mean 'tip'"):
        import_urdf(tmp_path / "small.urdf", tip="tipp")


def test_a_parallelogram_turns_with_the_joint_before(tmp_path: Path) -> None:
    """Catches a joint that follows with the wrong sign, or in the file alone; and a first joint that follows none."""
    joints = postures(KIND.example, 20)
    apart = joints.copy()
    apart[:, 2] -= joints[:, 1]
    np.testing.assert_allclose(
        palletiser().forward_batch(joints).values, KIND.example.forward_batch(apart).values, atol=1e-9
    )
    assert robot_from_tables(tomllib.loads(as_toml(palletiser(), tmp_path)), "again") == palletiser()
    with pytest.raises(ShapeError, match="joint_1: follows the one before it, and there is none"):
        replace(KIND.example, joints=(replace(KIND.example.joints[0], follows=1.0), *KIND.example.joints[1:]))


def test_turns_are_written_without_loss() -> None:
    """Catches roll and yaw that are lost where pitch is a right angle: most URDFs have such joints."""
    rng = np.random.default_rng(0)
    for pitch in (0.3, np.pi / 2, -np.pi / 2, np.pi / 2 - 1e-9):
        for roll, yaw in rng.uniform(-3, 3, (20, 2)):
            turn = of_rpy((roll, pitch, yaw))
            np.testing.assert_allclose(of_rpy(rpy_of(turn)), turn, atol=1e-14)


@pytest.mark.parametrize("arm", [KIND.example, gantry()], ids=["six axes", "gantry"])
def test_the_inverse_comes_back_within_limits(arm: Serial) -> None:
    """Catches an inverse that stops early, leaves a joint's limits, or gives up where another posture would do."""
    joints = postures(arm, 60)
    places = arm.forward_batch(joints).require()
    found = arm.inverse_batch(places)
    np.testing.assert_allclose(arm.forward_batch(found.require()).values, places, atol=2e-9)
    low, high = arm.ranges
    assert (found.values >= low - 1e-12).all()
    assert (found.values <= high + 1e-12).all()
    # a start near the posture finds that posture's neighbour, not another branch
    near = arm.inverse(places[0], start=joints[0] + 1e-3)
    assert np.abs(near - joints[0]).max() < 0.01 * (500.0 if arm.joint_unit == "mm" else 1.0)
    with pytest.raises(OutOfReach, match="comes no nearer than"):
        arm.inverse([5000.0, 0.0, 0.0])


def test_two_arms_have_their_own_columns(tmp_path: Path, ur5: Serial) -> None:
    """Catches a run that is taken for another arm's, and a robot file that loses a digit."""
    for arm in (ur5, gantry(), KIND.example):
        assert robot_from_tables(tomllib.loads(as_toml(arm, tmp_path)), "again") == arm
        data = SecondArm(arm).measure(postures(arm, 20))
        data.save(tmp_path / "run.csv")
        assert sk.read_measurements(tmp_path / "run.csv").layout == arm.layout
        assert kind_of(arm).layout == arm.layout
    with pytest.raises(sk.errors.FitError, match="is no run of a serial robot"):
        sk.identify(ur5, SecondArm(gantry()).measure(postures(gantry(), 20)))


def as_toml(arm: Serial, folder: Path) -> str:
    """Its file."""
    sk.save_robot(arm, folder / "robot.toml")
    return (folder / "robot.toml").read_text()


# -- what is identified --------------------------------------------------------------------------------------------


def everything(arm: Serial, rng: np.random.Generator) -> tuple[SecondArm, dict[str, float]]:
    """An arm in which every error and every effect is at work, and their values by name."""
    k = len(arm.joints)
    slide = np.array([100.0 if joint.slides else 1.0 for joint in arm.joints])
    turns = slide == 1.0
    mixed = len(set(slide)) > 1

    def some(*shape: int) -> Any:
        return 1e-3 * rng.normal(size=shape)

    offset, shift, tilt, tool, stand = slide * some(k), 1e3 * some(k, 2), some(k, 2), 1e3 * some(3), 50 * some(6)
    # a link without length grows by what its errors are long: nothing that anybody would look for
    long = {p.name for p in model_of(arm).known_effects["link_growth"].parameters}
    grows = [name in long for name in ("base", *(f"link_{i + 1}" for i in range(k)))]
    hidden: dict[str, Any] = {
        "scale": some(k), "follows": np.r_[0.0, some(k - 1)] * slide / np.r_[1.0, slide[:-1]], "gives": slide * some(k),
        "play": slide * some(k), "ring": turns[:, None] * some(k, 2), "warmth_per_c": 1e-5, "rate_mm_h": 1e3 * some(3),
        "lines": 0.0 if mixed else some(k, 2), "twice": 0.0 if mixed else some(k, 2),
        "per_turn": 3.0, "step_mm": 1e3 * some(3), "zoom": 1e-4, "late_s": 0.02,
        "sags": 0.01 * slide * some(k),
        "growth_per_c": 0.02 * some(k + 1) * grows, "knock": np.r_[some(3), 1e3 * some(3)],
        "settles": np.r_[some(3), 1e3 * some(3)], "lost": slide * some(k),
        "stand_mm_per_c": 100.0 * some(3), "bend_mm": 1e3 * some(3),
    }  # fmt: skip
    names: dict[str, Any] = {
        "thermal_growth.coefficient": 1e-5,
        "sensor_scale.scale": 1e-4,
        "reading_delay.delay": 0.02,
        "link_growth.base": hidden["growth_per_c"][0],
    }
    for i in range(k):
        names |= {f"offset_{i + 1}": offset[i], f"joint_scale.scale_{i + 1}": hidden["scale"][i]}
        names |= {f"joint_coupling.share_{i + 1}": hidden["follows"][i], f"backlash.width_{i + 1}": hidden["play"][i]}
        names |= {f"joint_compliance.yield_{i + 1}": hidden["gives"][i], f"joint_slip.step_{i + 1}": hidden["lost"][i]}
        names |= {f"payload_compliance.give_{i + 1}": hidden["sags"][i]}
        names |= {f"link_growth.link_{i + 1}": hidden["growth_per_c"][i + 1]}
        for a, (axis, wave) in enumerate(zip("xy", ("sine", "cosine"), strict=True)):
            names |= {f"shift_{axis}_{i + 1}": shift[i, a], f"tilt_{axis}_{i + 1}": tilt[i, a]}
            names |= {f"encoder_eccentricity.{wave}_{i + 1}": hidden["ring"][i, a]}
            names |= {f"encoder_cyclic.{wave}_{i + 1}": 0.0 if mixed else hidden["lines"][i, a]}
            second = 0.0 if mixed else hidden["twice"][i, a]
            names |= {f"encoder_second_{i + 1}.{wave}_{i + 1}": second}
    for a, axis in enumerate("xyz"):
        names |= {f"tool_{axis}": tool[a], f"sensor_turn_{axis}": stand[a], f"sensor_shift_{axis}": stand[3 + a]}
        names |= {f"drift.rate_{axis}": hidden["rate_mm_h"][a], f"slip.step_{axis}": hidden["step_mm"][a]}
        names |= {f"thermal_shift.shift_{axis}": hidden["stand_mm_per_c"][a]}
        names |= {f"sensor_slip.{n}_{axis}": hidden["knock"][i + a] for n, i in (("turn", 0), ("shift", 3))}
        names |= {f"sensor_drift.{n}_rate_{axis}": hidden["settles"][i + a] for n, i in (("turn", 0), ("shift", 3))}
        names |= {f"sensor_linearity.cubic_{axis}": hidden["bend_mm"][a]}
    return SecondArm(arm, offset, shift, tilt, tool, stand, Hidden(**hidden)), names


@pytest.mark.parametrize("arm", [KIND.example, palletiser(), gantry()], ids=["six axes", "parallelogram", "gantry"])
def test_every_error_and_effect_is_that_of_the_second_simulator(arm: Serial) -> None:
    """Catches an effect of the wrong sign, unit, order or joint, in an arm that hangs askew before a turned tracker;
    and a derivative that is not that of the prediction."""
    stands = SensorPose((900.0, -2000.0, 500.0), (5.0, -3.0, 70.0))
    arm = replace(arm, gravity=(0.3, 0.1, -1.0), sensor_pose=stands)
    arm = replace(arm, joints=tuple(replace(joint, home=7.0 * i) for i, joint in enumerate(arm.joints)))
    virtual, by_name = everything(arm, np.random.default_rng(3))
    data = virtual.measure(postures(arm, 14), seed=3, payload_kg=np.linspace(0.0, 8.0, 14))
    model = model_of(arm)
    model = replace(model, free=tuple(p.name for p in model.base))
    middle = float(data.time_s[len(data) // 2])
    for effect in model.known_effects.values():
        at = 2 * np.pi / 3 if effect.is_periodic else middle
        model = model.with_effect(effect, at=at if effect.search and not effect.is_lagging else None)
    values = np.array([by_name[p.name] for p in model.parameters])
    assert np.abs(model.predict(data, 0.0 * values) - data.readings).max() > 1.0
    np.testing.assert_allclose(model.predict(data, values), data.readings, atol=1e-7)
    columns = model.derivatives(data, values)
    for k, p in enumerate(model.parameters):
        step = np.where(np.arange(len(values)) == k, 1e-3 * min(p.size, 10.0), 0.0)
        change = model.predict(data, values + step) - model.predict(data, values - step)
        np.testing.assert_allclose(columns[:, :, k] * 2 * step[k], change, rtol=1e-4, atol=1e-8, err_msg=p.name)


@pytest.mark.parametrize(
    "arm", [*slow(KIND.example), palletiser(), gantry()], ids=["six axes", "parallelogram", "gantry"]
)
def test_the_virtual_arm_does_what_the_second_one_does(arm: Serial) -> None:
    """Catches a virtual arm that hides something else than is asked for: another joint, sign, unit, target or plane."""
    planes = (Plane((0.0, 0.0, -5.0), (0.1, 0.2, 1.0)),)
    arm = replace(arm, more_targets_mm=((10.0, 20.0, 30.0),), centres_mm=((500.0, 0.0, 0.0),), planes=planes)
    second = replace(everything(arm, np.random.default_rng(3))[0], centres_mm=0.3, planes=0.01, noise_mm=0.1)
    second = second.with_hidden(bar_mm=0.3, stand_lag_s=30.0)
    virtual = VirtualSerial(**{one.name: getattr(second, one.name) for one in fields(second)})
    joints = postures(arm, 12)
    runs = [one.measure(joints, repeats=2, seed=5, payload_kg=2.0) for one in (virtual, second)]
    np.testing.assert_allclose(runs[0].readings, runs[1].readings, atol=1e-7)
    np.testing.assert_allclose(virtual.noise_free(joints), second.noise_free(joints), atol=1e-7)


def test_what_is_told_apart_is_free_and_the_rest_is_named(ur5: Serial) -> None:
    """Catches a default that is not of full rank or leaves something out, and redundant directions that are not those
    of the drawing: 4 for each of 6 joints and 3 for the target, the tracker among them. It
    stands nearly along the axes of the base, so that a turn about one has one name."""
    data = SecondArm.simulated(ur5, 1, 1.0, PLAIN).measure(postures(ur5, 120, 0.9, 1), seed=7)
    plain = sk.identify(ur5, data)
    assert plain.rank == len(plain.values) == 27
    assert plain.condition_number < 100
    whole = sk.identify(ur5, data, free=[p.name for p in model_of(ur5).base])
    assert (whole.rank, len(whole.values)) == (27, 39)
    np.testing.assert_allclose(whole.predicted, plain.predicted, atol=1e-5)
    said = [str(one) for one in whole.unobserved]
    assert "sensor_turn_z against offset_1" in said
    # along what nobody sees nothing moves further than is usual
    sizes = np.array([p.size for p in whole.parameters])
    assert np.abs(whole.values / sizes).max() < 4.0


def simulated(arm: Serial, seed: int, rows: int, **hidden: Any) -> sk.Measurements:
    """A run of an arm with geometric errors of plausible size before a tracker that stands anywhere, and what else is
    hidden in it; at half of the poses a payload hangs."""
    virtual = replace(SecondArm.simulated(arm, seed, 1.0, PLAIN), stand=draw_pose(np.random.default_rng([seed, 8])))
    virtual = virtual.with_hidden(**hidden)
    return virtual.measure(postures(arm, rows, 0.9, seed), seed=seed + 5, payload_kg=payloads(rows, seed))


def payloads(rows: int, seed: int) -> Floats:
    """What hangs at each pose (rows,), kg: nothing at about half of them."""
    return 5.0 * np.random.default_rng([seed, 9]).integers(0, 2, rows)


def test_a_tracker_may_stand_anywhere(ur5: Serial) -> None:
    """Catches a fit that is lost where the tracker is turned by more than a right angle, or where rows are wrong."""
    for seed in (7, 10, 13):
        virtual = SecondArm.simulated(ur5, seed, 1.0, PLAIN)
        turn = Rotation.random(random_state=seed).as_rotvec()
        virtual = replace(virtual, stand=np.r_[turn, 2000.0 * np.random.default_rng(seed).normal(size=3)])
        data = virtual.measure(postures(ur5, 80, 0.9, seed), seed=seed)
        fit = sk.identify(ur5, data)
        assert fit.converged
        assert fit.scale == pytest.approx(NOISE_MM, rel=0.2)
        wrong = data.readings.copy()
        wrong[:8] += 700.0
        robust = sk.identify(ur5, replace(data, readings=wrong), loss="tukey")
        assert np.nanmedian(np.abs(robust.residuals)) < 2 * NOISE_MM


# -- what is found -------------------------------------------------------------------------------------------------

#: Of each effect the fields that hide it, with the sizes that their parts have to each other.
EFFECTS = {
    "joint_scale": {"scale": (6,)}, "joint_coupling": {"follows": (6,)}, "joint_compliance": {"gives": (6,)},
    "backlash": {"play": (6,)}, "encoder_eccentricity": {"ring": (6, 2)}, "encoder_cyclic": {"lines": (6, 2)},
    "thermal_growth": {"warmth_per_c": ()}, "drift": {"rate_mm_h": (3,)}, "slip": {"step_mm": (3,)},
    "joint_slip": {"lost": (6,)}, "thermal_shift": {"stand_mm_per_c": (3,)},
    "sensor_slip": {"knock": (6,)}, "sensor_drift": {"settles": (6,)},
    "sensor_scale": {"zoom": ()}, "sensor_linearity": {"bend_mm": (3,)},
    "reading_delay": {"late_s": ()}, "payload_compliance": {"sags": (6,)}, "link_growth": {"growth_per_c": (7,)},
}  # fmt: skip


def left_by_geometry(model: Any, data: sk.Measurements, change: Floats) -> Floats:
    """What the best geometry leaves (n·m,) of a change of readings (n, m); all of one that it takes up whole."""
    columns = model.derivatives(data, model.start(data))[:, : change.shape[1]]
    columns = columns.reshape(change.size, -1)
    columns = columns / np.linalg.norm(columns, axis=0)
    left = change.ravel() - columns @ np.linalg.lstsq(columns, change.ravel(), rcond=1e-10)[0]
    return left if np.linalg.norm(left) >= 1e-2 * np.linalg.norm(change) else change.ravel()


def hidden_at(arm: Serial, name: str, ratio: float, seed: int) -> dict[str, Any]:
    """An effect of random signs, as large as leaves ``ratio`` times the noise beside the best geometry; one of which
    the geometry takes up all, as lengths do the scale of what reads them, as large as that beside the drawing."""
    rng = np.random.default_rng(seed)
    made: dict[str, Any] = {"per_turn": 3.0}
    for field, shape in EFFECTS[name].items():
        made[field] = rng.choice([-1.0, 1.0], shape) * rng.uniform(0.7, 1.3, shape)
        if field in ("knock", "settles"):
            made[field] *= [1e-3, 1e-3, 1e-3, 1.0, 1.0, 1.0]
    stand = draw_pose(np.random.default_rng([seed, 8]))
    virtual = replace(SecondArm.simulated(arm, seed, 1.0, PLAIN), noise_mm=0.0, stand=stand)
    poses = postures(arm, 200, 0.9, seed)
    small = {field: value if field == "per_turn" else 1e-4 * value for field, value in made.items()}
    hung = payloads(200, seed)
    with_it = virtual.with_hidden(**small).measure(poses, seed=seed + 5, payload_kg=hung)
    model = model_of(arm)
    still = replace(with_it, readings=virtual.measure(poses, seed=seed + 5, payload_kg=hung).readings)
    left = left_by_geometry(model, still, with_it.readings - still.readings)
    by = 1e-4 * ratio * NOISE_MM / np.sqrt(np.mean(left**2))
    return {field: value if field == "per_turn" else by * value for field, value in made.items()}


@pytest.mark.parametrize("name", ["sensor_slip", "sensor_drift", "slip"])
def test_an_effect_is_found(name: str, ur5: Serial) -> None:
    """Catches an effect of an arm that is taken for another, or not seen at twice the noise."""
    found = sk.diagnose(ur5, simulated(ur5, 1, 200, **hidden_at(ur5, name, 2.0, 1)))
    assert (found.verdict, found.effects) == ("explained", (name,))


def test_growth_of_all_links_alike_is_tied_with_that_of_the_whole(ur5: Serial) -> None:
    """Catches links that are blamed one by one, or the whole alone, where no run can tell the two apart."""
    found = sk.diagnose(ur5, simulated(ur5, 1, 200, **hidden_at(ur5, "thermal_growth", 2.0, 1)))
    assert (found.verdict, found.effects) == ("explained", ("thermal_growth",))
    assert ("thermal_growth", "link_growth") in found.indistinguishable


def test_a_tie_outlives_the_adding_of_one_of_it(ur5: Serial) -> None:
    """Catches "adequate: no effect is missing, use the calibration as it is" once a person has added the first name of
    a tie: no reading chose it. What is told from all others is no tie."""
    for name, told in (("thermal_growth", True), ("backlash", False)):
        data = simulated(ur5, 1, 200, **hidden_at(ur5, name, 2.0, 1))
        found = sk.diagnose(sk.identify(ur5, data, effects=[name]))
        assert found.verdict == "adequate"
        assert (f"{name}, which is in the model, is not told from" in (found.caveat or "")) is told


def test_what_hangs_is_told_to_the_loop(ur5: Serial) -> None:
    """Catches a payload that is lost between the run and the calibrated arm, or in its promise: the deviations of what
    gives way count by what hangs."""
    data = simulated(ur5, 3, 80, sags=1e-4)
    made = sk.calibrate(ur5, data, effects=["payload_compliance"], correction="none").calibration
    virtual = SecondArm.simulated(ur5, 3, 1.0, PLAIN).with_hidden(sags=1e-4)
    q, still = postures(ur5, 1, 0.8, seed=5)[0], np.zeros(6)
    sunk = made.forward(q, payload_kg=5.0) - made.forward(q)
    expected = virtual.true_target(q, still, still, payload_kg=5.0) - virtual.true_target(q, still, still)
    assert np.linalg.norm(expected) > 0.3
    np.testing.assert_allclose(sunk, expected, atol=0.1)
    place = made.forward(q, payload_kg=5.0)
    back = made.inverse(place, payload_kg=5.0, start=q)
    np.testing.assert_allclose(made.forward(back, payload_kg=5.0), place, atol=1e-8)
    promised = made.accuracy(place, payload_kg=5.0)
    assert promised > made.accuracy(place) == made.accuracy(place, payload_kg=0.0)
    assert made.accuracy_batch(place[None], payload_kg=5.0).require()[0] == promised
    assert made.predicted_accuracy(place, payload_kg=5.0).total_mm == promised


def test_where_nothing_is_hidden_nothing_is_found(ur5: Serial) -> None:
    """Catches an alarm on an arm whose geometry alone differs from the drawing."""
    found = sk.diagnose(ur5, simulated(ur5, 1, 200))
    assert (found.verdict, found.effects) == ("adequate", ())


@pytest.mark.slow
def test_an_instrument_that_mirrors_the_arm_is_not_explained(ur5: Serial) -> None:
    """Catches a division that overflows where next to no row is believed, and metres of a link taken for its error."""
    found = sk.diagnose(ur5, simulated(ur5, 1, 200, zoom=-6.785830732647848))
    assert found.verdict == "unexplained"


def test_an_arm_whose_joints_slide_is_diagnosed_in_mm() -> None:
    """Catches units, sizes or periods of turning joints in a machine that has none."""
    arm = replace(gantry(), joints=gantry().joints[:3])
    model = model_of(arm)
    assert {p.unit for p in model.known_effects["backlash"].parameters} == {"mm"}
    assert "encoder_eccentricity" not in model.known_effects
    assert model.known_effects["encoder_cyclic"].search == "period_mm"
    found = sk.diagnose(arm, simulated(arm, 1, 150, play=(0.4, -0.4, 0.3)))
    assert (found.verdict, found.effects) == ("explained", ("backlash",))


# -- what a person does --------------------------------------------------------------------------------------------


def test_the_story_of_an_arm(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Catches a command that a serial arm breaks, a calibration that is not read back as it was, and one that is no
    better than the drawing."""
    monkeypatch.chdir(tmp_path)
    Path("ur5.csv").write_text(UR5)

    def run(*arguments: str) -> str:
        with pytest.raises(SystemExit) as ended:
            main(list(arguments))
        shown = capsys.readouterr()
        assert not ended.value.code, shown.err
        return shown.out

    assert "6 joints" in run("import", "dh", "ur5.csv", "-o", "robot.toml")
    robot = replace(sk.load_robot("robot.toml"), target_mm=(60.0, 20.0, 50.0))
    sk.save_robot(robot, "robot.toml")
    run("simulate", "robot.toml", "-o", "run.csv", "--yield-mrad", "0.5", "--repeats", "2", "--truth", "truth.toml")
    assert "explained: joint_compliance" in run("diagnose", "robot.toml", "run.csv")
    run("calibrate", "robot.toml", "run.csv", "--effect", "joint_compliance", "-o", "calibrated.toml")
    calibration = sk.load_calibration("calibrated.toml")
    truth = tomllib.loads(Path("truth.toml").read_text())
    hidden = Hidden(**truth.pop("effects"))
    virtual = SecondArm(robot, **truth, effects=hidden)
    frame = Rotation.from_rotvec(calibration.whole.values[:3])
    errors: dict[str, list[float]] = {"drawn": [], "calibrated": []}
    for joints in postures(robot, 30, 0.9, seed=77):
        real = frame.inv().apply(virtual.noise_free(joints)[0] - calibration.whole.values[3:6])
        errors["drawn"].append(np.linalg.norm(robot.forward(joints) - real))
        errors["calibrated"].append(np.linalg.norm(calibration.forward(joints) - real))
        found = calibration.inverse(calibration.forward(joints), start=joints + 0.02)
        assert np.linalg.norm(calibration.forward(found) - calibration.forward(joints)) < 1e-8
    assert np.mean(errors["calibrated"]) < 0.1 < 1.0 < np.mean(errors["drawn"])
    predicted_accuracy = calibration.predicted_accuracy(calibration.forward(robot.home))
    assert 0.05 < predicted_accuracy.total_mm < 1.0


# -- not fooled by many parameters ---------------------------------------------------------------------------------


@pytest.mark.parametrize("arms", [3, *slow(6)])
def test_more_parameters_than_rows_support_are_said(arms: int, ur5: Serial) -> None:
    """Catches a geometry of 27 parameters on 34 rough samples that is called a success: it fits better than the few
    that the rows support and predicts worse, and plausible sizes make up for that."""
    rough = {**PLAIN, "noise_um": 4000.0}
    fitted: dict[bool, list[float]] = {False: [], True: []}
    for seed in range(arms):
        virtual = SecondArm.simulated(ur5, seed, 1.0, rough)
        data = virtual.measure(postures(ur5, 34, 0.5, seed), seed=seed)
        new = replace(virtual, noise_mm=0.0).measure(postures(ur5, 100, 0.9, seed + 50), seed=1)
        for priors in (False, True):
            fit = sk.identify(ur5, data, priors=priors)
            assert fit.overparametrised
            assert f"34 rows support {fit.supported} of 27 parameters" in fit.overparametrised
            assert ("--priors" in fit.overparametrised) is not priors
            assert 6 <= fit.supported < 20
            left = (new.readings - fit.model.predict(new, fit.values))[:, :3]
            fitted[priors].append(float(np.sqrt(np.mean(left**2))))
    assert np.mean(fitted[True]) < 0.8 * np.mean(fitted[False])
    assert sk.identify(ur5, simulated(ur5, 1, 120)).overparametrised is None


def test_an_experiment_says_what_it_cannot_drive(tmp_path: Path) -> None:
    """Catches a key that is asked for and that the file of an arm or a machine cannot have."""
    sk.save_robot(KIND.example, tmp_path / "arm.toml")
    (tmp_path / "e.toml").write_text("robot = 'arm.toml'\n[plan]\nposes = 'whole'\n")
    with pytest.raises(ExperimentError, match="by its own controller, and give the rows to sherkit diagnose"):
        load_experiment(tmp_path / "e.toml")
    gantry = Path(__file__).parents[1] / "examples" / "machines" / "gantry.py"
    with pytest.raises(RobotError, match="is a Python file, which is not run here; sherkit diagnose"):
        load_experiment(tmp_path / "e.toml", robot=gantry)


def test_a_run_may_be_read_before_its_robot(tmp_path: Path) -> None:
    """Catches "column 'q1_mm' is missing" of an arm whose joints have names of their own and whose file is read after
    its run; and a file of no known robot that then passes for anything."""
    text = UR5
    for k in range(1, 7):
        text = text.replace(text.splitlines()[k].split(",")[0], f"own_{k}", 1)
    (tmp_path / "own.csv").write_text(text)
    run = {f"own_{k}_rad": np.linspace(-0.5, 0.5, 12) ** k for k in range(1, 7)}
    run |= {name: np.arange(12.0) for name in ("x_mm", "y_mm", "z_mm")} | {"payload_kg": np.zeros(12)}
    early = sk.from_frame(run)
    assert early.layout.joints == tuple(f"own_{k}_rad" for k in range(1, 7))
    with pytest.raises(sk.SherkitError, match="is missing"):
        run_for(known_kinds()["delta"].example, early)
    arm = import_dh(tmp_path / "own.csv")
    assert run_for(arm, early).layout == arm.layout == sk.from_frame(run).layout
