"""Mistakes of the set-up, on robots and models that are no part of the long list of ``test_honest_verdict.py``."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from copy import deepcopy
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from scipy.spatial.transform import Rotation

import mistakes
import sherkit as sk
import worlds
from planar_arm import KIND, PlanarArm, VirtualPlanarArm
from planar_arm.pose_sets import fan
from running import slow
from second_arms import SecondArm
from second_machines import apart
from sherkit.base.types import Floats
from sherkit.data import Measurements
from sherkit.errors import FitError
from sherkit.fit import Mistake, set_up_mistakes
from sherkit.model import kinds
from sherkit.model.kinds import model_of, robot_from_tables
from sherkit.robots.serial import postures
from sherkit.robots.serial.imported import import_dh
from sherkit.robots.spherical import CameraView
from test_arm_counted import TARGET_MM
from test_serial import KIND as ARMS
from test_serial import PLAIN, UR5, simulated
from worlds import World

NAMED = {m.name: m for m in mistakes.MISTAKES["delta"][1]}
POSITION = ("x_mm", "y_mm", "z_mm")


def told(world: World) -> tuple[Mistake, ...]:
    """What is said of a run of a robot."""
    data = sk.from_frame(pl.DataFrame(mistakes.file_of(world).columns))
    fit = sk.identify(world.robot, data)
    return set_up_mistakes(fit.model, fit.data, fit.values)


def turned(degrees: float) -> Callable[[World], World]:
    """The instrument stands turned about z."""
    turn = Rotation.from_euler("z", degrees, degrees=True).as_matrix()

    def change(c: dict[str, Any]) -> dict[str, Any]:
        return dict(zip(POSITION, turn @ np.stack([c[name] for name in POSITION]), strict=True))

    return mistakes.columns(change)


@pytest.mark.parametrize("degrees", [20.0, -37.0, 103.0, 120.0, 179.0])
def test_an_instrument_may_stand_turned_by_any_angle(degrees: float) -> None:
    """Catches a tracker that is blamed for where it stands, and base angles of 37° in its place."""
    assert told(turned(degrees)(worlds.clean(0))) == ()


@pytest.mark.parametrize("degrees", [*slow(20.0), -37.0])
def test_a_frame_turned_against_a_pose_that_is_held_is_said(degrees: float) -> None:
    """Catches a file that holds the sensor's pose where it does not stand so, and a turn in the wrong sense."""
    world = turned(degrees)(worlds.delta_world(0, own_axes=True))
    held = replace(world, settings=world.settings | {"sensor_pose": {"free": True, "turn_sd_deg": 0.0}})
    (said,) = told(held)
    assert abs(float(said.sentence.split("turned by ")[1].split("°")[0]) - abs(degrees)) < 0.5
    assert f"{np.sign(degrees):.2f})" in said.sentence
    assert said.after < 0.01 * said.before


@pytest.mark.parametrize("name", ["x and y swapped", "z mirrored"])
def test_a_left_handed_frame_is_said_wherever_the_instrument_stands(name: str) -> None:
    """Catches a mirror that a free turn of the instrument hides, and one of six repairs that is said to be the one."""
    (said,) = told(turned(63.0)(NAMED[name].change(worlds.clean(0))))
    assert "left-handed" in said.sentence
    assert said.after < 0.01 * said.before


@pytest.mark.parametrize("seed", [0, *slow(*range(1, 8))])
@pytest.mark.parametrize("name", ["joints 1 and 2 swapped", *slow("joints 2 and 3 swapped")])
def test_joints_that_were_swapped_are_among_what_is_said(name: str, seed: int) -> None:
    """Catches a list of mistakes "which here is the same" in which the one that was made is not: eight were looked at
    to their end, of which more are the same where an instrument may stand anywhere (4 of 12)."""
    said = told(turned(80.0 + seed)(NAMED[name].change(worlds.clean(seed))))[0].sentence
    one, other = name.split()[1::2]
    assert f"q{one}_mm and q{other}_mm look swapped" in said


@pytest.mark.parametrize(("part", "degrees", "by_mm"), [(0.8, 40.0, 50.0), (0.1, -7.0, 0.0), *slow((0.5, 90.0, 300.0))])
def test_an_instrument_that_was_set_up_anew_is_said_from_its_first_row(
    part: float, degrees: float, by_mm: float
) -> None:
    """Catches rows of another day that are left out as wrong, a slip of 80 mm, and a robot that is bent for them; also
    where most rows are fitted well without them."""

    def change(c: dict[str, Any]) -> dict[str, Any]:
        since = np.argsort(np.argsort(c["time_s"])) >= part * len(c["time_s"])
        turn = Rotation.from_euler("zx", [degrees, 0.3 * degrees], degrees=True).as_matrix()
        seen = np.stack([c[name] for name in POSITION])
        return dict(zip(POSITION, np.where(since, turn @ seen + by_mm, seen), strict=True))

    world = mistakes.columns(change)(worlds.clean(1))
    first = float(np.sort(world.columns["time_s"])[int(np.ceil(part * len(world.columns["time_s"])))])
    line = int(np.flatnonzero(world.columns["time_s"] == first)[0])
    (said,) = told(world)
    assert "set up anew" in said.sentence
    assert "'setup'" in said.sentence
    assert f"row {line} " in said.sentence


def test_an_instrument_that_was_set_up_anew_twice_is_said_twice() -> None:
    """Catches a second move that hides behind the first one: said with it, or once a column 'setup' has the first."""

    def change(c: dict[str, Any]) -> dict[str, Any]:
        rank = np.argsort(np.argsort(c["time_s"])) / len(c["time_s"])
        seen = np.stack([c[name] for name in POSITION])
        for since, degrees, by_mm in ((0.3, 35.0, 1000.0), (0.7, -20.0, -400.0)):
            turn = Rotation.from_euler("y", degrees, degrees=True).as_matrix()
            seen = np.where(rank >= since, turn @ seen + by_mm, seen)
        return dict(zip(POSITION, seen, strict=True))

    world, rows = mistakes.columns(change)(worlds.clean(2)), set[int]()
    rank = np.argsort(np.argsort(world.columns["time_s"]))
    while said := [one.sentence for one in told(world) if "set up anew" in one.sentence]:
        rows |= {int(rank[int(row)]) for row in re.findall(r"before row (\d+)", said[0])}
        names = np.searchsorted(sorted(rows), rank, side="right")
        world = replace(world, columns=world.columns | {"setup": np.array(["A", "B", "C"])[names]})
    assert sorted(rows) == [int(np.ceil(part * len(rank))) for part in (0.3, 0.7)]


@pytest.mark.filterwarnings("ignore:.*are they in metres:sherkit.SherkitWarning")
def test_two_mistakes_are_both_said() -> None:
    """Catches a search that ends at the first: joints in metres, and then x mirrored."""
    world = NAMED["x mirrored"].change(NAMED["joints in metres"].change(mistakes.delta_run(1)))
    first, second = told(world)
    assert "metres" in first.sentence
    assert "x_mm looks mirrored" in second.sentence


@pytest.mark.parametrize(
    "world",
    [
        worlds.delta_world(0, {"rail_lean": 200 * worlds.NOISE_UM}),
        worlds.delta_world(0, {"beam_alignment": 200 * worlds.NOISE_UM}),
        worlds.delta_world(1, {"rod_mismatch": 10 * worlds.NOISE_UM}),
        worlds.spherical_world(0, scaled={"joint_offset": 100}),
    ],
    ids=["rail_lean", "beam_alignment", "rod_mismatch", "joint_offset"],
)
def test_large_physics_is_no_mistake(world: World) -> None:
    """Catches an axis called swapped, or a camera called mirrored, since that fits a little better than nothing."""
    assert told(world) == ()


def test_a_length_of_an_arm_in_inches_is_said_of_that_joint() -> None:
    """Catches "what is left varies with A2" where one row of a table of an arm is in inches."""
    tables = deepcopy(ARMS.example.to_tables())
    tables["joint"][1]["origin_mm"][0] /= 25.4
    said = sk.diagnose(robot_from_tables(tables, "arm"), simulated(ARMS.example, 1, 60)).headline
    assert "the x of origin_mm of joint_2 in the robot file looks like inches" in said
    assert "write 50" in said


@pytest.mark.parametrize(
    "name", [*slow("a camera that is turned"), "alpha in radians", "platform in centimetres", *slow("base in inches")]
)
def test_mistakes_of_a_robots_file_are_said_as_such(name: str) -> None:
    """Catches a limb blamed for an angle in radians, and a camera blamed for how it was mounted."""
    kind, mistake = next((k, m) for k, (_, every) in mistakes.MISTAKES.items() for m in every if m.name == name)
    right, short = mistakes.named(mistake, mistakes.MISTAKES[kind][0](0))
    assert right, short


def test_one_column_in_another_unit_is_said_of_that_column_alone() -> None:
    """Catches a proposal that makes a coordinate worse, ten times as many µm as before, since others get better."""
    world = mistakes.delta_run(2)
    for name in ("x_mm", "q2_mm"):
        changed = mistakes.times(1 / 25.4, name)(world)
        try:
            said = [m.sentence for m in told(changed)]
        except FitError as error:
            said = [str(error)]
        assert f"{name} alone looks like inches" in said[0]


@pytest.mark.parametrize("read", ["standard", *slow("modified")])
def test_a_table_of_the_other_convention_is_said(read: str, tmp_path: Path) -> None:
    """Catches an arm that nothing explains where its table was read as standard and is modified, or the reverse."""
    (tmp_path / "ur5.csv").write_text(UR5)
    meant = {"standard": "modified", "modified": "standard"}[read]
    right, wrong = (replace(import_dh(tmp_path / "ur5.csv", how), target_mm=TARGET_MM) for how in (meant, read))
    arm = SecondArm.simulated(right, 1, 1.0, PLAIN)
    data = arm.measure(postures(right, 40, 0.9, 1), order="shuffled", seed=1)
    fit = sk.identify(wrong, data)
    said = set_up_mistakes(fit.model, fit.data, fit.values)
    assert f"looks {meant}, and was read as {read}" in said[0].sentence


@pytest.mark.parametrize("sign", [-1.0, *slow(1.0)])
def test_a_joint_counted_from_the_horizontal_is_said(sign: float, tmp_path: Path) -> None:
    """Catches "nothing that is usually mistaken explains the run" of joint 3 of an arm that is read with joint 2 in it,
    16 of 16 arms; and a cure that does not cure."""
    (tmp_path / "ur5.csv").write_text(UR5)
    robot = replace(import_dh(tmp_path / "ur5.csv"), target_mm=TARGET_MM)
    arm = SecondArm.simulated(robot, 1, 1.0, PLAIN)
    frame = arm.measure(postures(robot, 60, 0.9, 1), order="shuffled", seed=1).to_frame()
    second, third = (robot.layout.joints[k] for k in (1, 2))
    data = sk.from_frame(frame.with_columns(pl.col(third) + sign * pl.col(second)))
    fit = sk.identify(robot, data)
    (said,) = set_up_mistakes(fit.model, fit.data, fit.values)
    assert f"{third} looks counted from the" in said.sentence
    joints = [replace(one, follows=-sign) if k == 2 else one for k, one in enumerate(robot.joints)]
    cured = sk.identify(replace(robot, joints=tuple(joints)), data)
    assert f"follows = {-sign:g}" in said.sentence
    assert max(cured.rms().values()) < 100.0


def test_wild_rows_neither_hide_nor_fake_a_mistake() -> None:
    """Catches a comparison by squares: a tenth of the poses is wrong by up to a metre."""
    world = worlds.clean(2)
    wrong = world.columns["pose"] % 10 == 0
    off = 1e3 * np.random.default_rng(0).uniform(-1.0, 1.0, len(wrong))
    wild = mistakes.columns(lambda c: {name: c[name] + wrong * off for name in POSITION})
    assert told(wild(world)) == ()
    (said,) = told(NAMED["x and z swapped"].change(wild(world)))
    assert "left-handed" in said.sentence


def test_a_height_that_was_held_is_no_mistake() -> None:
    """Catches a probe's zeros that are called a broken sensor; and times that are only slow."""
    world = worlds.printer_heights(0)
    assert not any("constant" in m.sentence for m in told(world))
    slow = worlds.delta_world(0)
    slow = replace(slow, columns=slow.columns | {"time_s": 20.0 * slow.columns["time_s"]})
    assert told(slow) == ()


def test_noise_at_one_place_is_no_mistake() -> None:
    """Catches a fit called absurd where the robot stood still, as in a test of repeatability."""
    assert told(worlds.delta_world(0, points=np.zeros((30, 3)), repeats=1)) == ()


def test_what_nothing_usual_explains_is_said() -> None:
    """Catches physics that is blamed for readings of another run: rows in another order."""
    world = worlds.delta_world(0, repeats=1)
    order = np.random.default_rng(3).permutation(len(world.columns["pose"]))
    (said,) = told(mistakes.columns(lambda c: {name: c[name][order] for name in POSITION})(world))
    assert "nothing that is usually mistaken" in said.sentence


@pytest.mark.parametrize(
    ("written", "looks"),
    [
        ("inverse turn", "rotation_rad of [camera] in the robot file looks like that from the camera to the base"),
        ("pose in the base", "rotation_rad and translation_mm of [camera] in the robot file look like that from the"),
        ("place in the base", "translation_mm of [camera] in the robot file looks like the camera's place in the base"),
        ("degrees", "rotation_rad of [camera] in the robot file looks like degrees"),
    ],
)
def test_a_camera_that_is_written_from_its_own_side_is_said(written: str, looks: str) -> None:
    """Catches the pose that OpenCV gives written the other way round, which was answered with physics of the robot."""
    world = mistakes.spherical_run(7)
    camera = world.robot.camera
    turn, shift = Rotation.from_rotvec(camera.rotation_rad), np.array(camera.translation_mm)
    place = tuple((-turn.inv().apply(shift)).tolist())
    changed: dict[str, Any] = {
        "inverse turn": {"rotation_rad": tuple(turn.inv().as_rotvec().tolist())},
        "pose in the base": {"rotation_rad": tuple(turn.inv().as_rotvec().tolist()), "translation_mm": place},
        "place in the base": {"translation_mm": place},
        "degrees": {"rotation_rad": tuple(np.rad2deg(camera.rotation_rad).tolist())},
    }[written]
    robot = replace(world.robot, camera=replace(camera, **changed))
    said = sk.diagnose(robot, sk.from_frame(pl.DataFrame(world.columns))).notes[0]
    assert said.startswith(looks)
    for key in changed:
        assert f"{key} = [{', '.join(f'{round(v, 9) + 0.0:.6g}' for v in getattr(camera, key))}]" in said


@pytest.mark.parametrize("seed", [3, *slow(8)])
@pytest.mark.parametrize("ask", [sk.diagnose, *slow(lambda robot, run: sk.Study(robot, run).diagnose())])
def test_a_camera_that_stands_nowhere_near_ends_in_a_sentence(ask: Callable[..., Any], seed: int) -> None:
    """Catches a traceback where a fit to the rows that are left cannot compute the others, and silence where the robot
    moves the marker by less than the camera is off."""
    robot = sk.spherical.Spherical(
        45.0, 45.0, 200.0,
        camera=CameraView((1280, 640), (1027.0, 1027.0), (640.0, 320.0), translation_mm=(0.0, 0.0, 446.2)),
    )  # fmt: skip
    assert robot.camera is not None
    rng = np.random.default_rng(seed)
    places = np.tile(np.column_stack([rng.uniform(1.2, 1.9, 100), rng.uniform(0.55, 1.0, 100)]), (2, 1))
    # it looks at the centre from above, half a turn about an axis in space from where the file has it
    along, across = np.array([0.0, -np.sqrt(0.5), -np.sqrt(0.5)]), np.array([-1.0, 0.0, 0.0])
    turned = Rotation.from_matrix(np.stack([across, np.cross(along, across), along]))
    there = replace(robot.camera, rotation_rad=tuple(turned.as_rotvec().tolist())).core
    seen = np.array([there.project(one) for one in robot.point(places)]) + rng.normal(0.0, 0.05, (200, 2))
    joints = robot.inverse_batch(places).require()
    columns = dict(zip(("theta1_rad", "theta2_rad", "u_px", "v_px"), np.hstack([joints, seen]).T, strict=True))
    run = sk.from_frame(pl.DataFrame(columns | {"pose": np.tile(np.arange(100), 2) + 1}))
    found = ask(robot, run)
    assert found.verdict == "unexplained"
    assert "nothing that is usually mistaken explains the run" in found.notes[0]


def test_an_error_of_reach_names_the_mistake() -> None:
    """Catches "cannot reach" without a word on the joint that is counted downwards, or a word that is not right."""
    world = mistakes.file_of(NAMED["joint 2 counted downwards"].change(mistakes.delta_run(3)))
    with pytest.raises(FitError, match=r"cannot reach .* Most likely: q2_mm looks counted the other way"):
        sk.identify(world.robot, sk.from_frame(pl.DataFrame(world.columns)))


# -- robots and models of a user's own -------------------------------------------------------------------------------


@pytest.fixture
def arm() -> Iterator[tuple[PlanarArm, sk.Measurements]]:
    """A planar arm and a run of it; the kind is known while a test runs. It is read in its own axes, as few are:
    which columns were exchanged can be said only so, from elsewhere they are left-handed."""
    robot = PlanarArm((250.0, 180.0), 40.0)
    hidden = VirtualPlanarArm(robot, length_error_mm=(0.8, -0.6), offset_rad=(0.01, -0.015), noise_mm=0.005)
    with apart():
        kinds.register(KIND)
        yield robot, hidden.measure(fan(robot, 8), repeats=2, order="shuffled", seed=1)


ARM: dict[str, tuple[Callable[[dict[str, Any]], dict[str, Any]], str]] = {
    "clean": (lambda c: {}, ""),
    "joints": (
        lambda c: {"shoulder_rad": c["elbow_rad"], "elbow_rad": c["shoulder_rad"]}, "shoulder_rad and elbow_rad look"
    ),
    "elbow the other way": (lambda c: {"elbow_rad": -c["elbow_rad"]}, "elbow_rad looks counted the other way"),
    "degrees": (lambda c: {n: np.rad2deg(c[n]) for n in ("shoulder_rad", "elbow_rad")}, "look like degrees"),
    # an instrument behind the arm's plane sees it so
    "x and y": (lambda c: {"x_mm": c["y_mm"], "y_mm": c["x_mm"]}, ""),
    "inches": (lambda c: {n: c[n] / 25.4 for n in POSITION}, "look like inches"),
    # of the shoulder it is a turn of the instrument
    "quarter turn": (lambda c: {"elbow_rad": c["elbow_rad"] - np.pi / 2}, "elbow_rad looks off by"),
    "shoulder": (lambda c: {"shoulder_rad": c["shoulder_rad"] - np.pi / 2}, ""),
    "still": (lambda c: {"y_mm": np.full(len(c["y_mm"]), 3.0)}, "y_mm is constant"),
}  # fmt: skip


#: The others are mistakes of a delta's columns as well, on the long list.
ASKED = ("clean", "shoulder")


@pytest.mark.parametrize("name", [pytest.param(n, marks=[pytest.mark.slow] * (n not in ASKED)) for n in ARM])
def test_an_arm_of_a_users_own_has_the_usual_mistakes(name: str, arm: tuple[PlanarArm, sk.Measurements]) -> None:
    """Catches hypotheses that know the built-in robots alone."""
    robot, run = arm
    change, words = ARM[name]
    frame = {c: run.to_frame()[c].to_numpy() for c in run.to_frame().columns}
    data = sk.from_frame(pl.DataFrame(frame | change(frame)))
    fit = sk.identify(robot, data)
    said = set_up_mistakes(fit.model, data, fit.values)
    assert [words in m.sentence for m in said] == ([True] if words else [])


@pytest.mark.slow
def test_a_word_of_an_arms_file_is_found(arm: tuple[PlanarArm, sk.Measurements]) -> None:
    """Catches a choice of the robot's file that no reading tells and its joints do."""
    robot, run = arm
    fit = sk.identify(replace(robot, elbow="right"), run)
    (said,) = set_up_mistakes(fit.model, run, fit.values)
    assert 'elbow = "left"' in said.sentence


@dataclass(frozen=True)
class Turntable:
    """A turntable whose scale is eccentric; reading in mrad."""

    parameters: tuple[sk.model.Parameter, ...] = tuple(
        sk.model.Parameter(name, name, "mrad", size) for name, size in (("offset", 1.0), ("a", 5.0), ("b", 5.0))
    )

    def predict(self, data: sk.Measurements, values: Floats) -> Floats:
        angle = data["angle_rad"]
        return (1e3 * angle + np.stack([np.ones_like(angle), np.sin(angle), np.cos(angle)], axis=1) @ values)[:, None]

    def derivatives(self, data: sk.Measurements, values: Floats) -> Floats:
        angle = data["angle_rad"]
        return np.stack([np.ones_like(angle), np.sin(angle), np.cos(angle)], axis=1)[:, None, :]

    def covariates(self, data: sk.Measurements) -> dict[str, Floats]:
        return {}


def test_a_model_with_three_methods_has_them_too() -> None:
    """Catches a search that needs a robot's file: angles in degrees under a ``_rad`` name, and counted backwards."""
    rng = np.random.default_rng(5)
    angle = rng.uniform(-1.5, 1.5, 100)
    shown = (1e3 * angle + 3.0 * np.sin(angle) + 0.2 * rng.normal(size=100))[:, None]
    model = model_of(Turntable())
    for given, words in ((angle, None), (np.rad2deg(angle), "look like degrees"), (-angle, "counted the other way")):
        data = sk.data.from_arrays(place={"angle_rad": given}, readings=shown, names=("shown",), unit="mrad")
        fit = sk.identify(model, data)
        said = set_up_mistakes(model, data, fit.values)
        assert [words in m.sentence for m in said] == ([] if words is None else [True]), words


def test_a_mistake_beside_large_physics_ends_in_a_sentence() -> None:
    """Catches a search for wrong rows where all are wrong: the columns of x and y exchanged on leaning rails."""
    world = worlds.delta_world(0, effects={"rail_lean": np.full(6, 8e-3)}, repeats=1)
    columns = world.columns | {"x_mm": world.columns["y_mm"], "y_mm": world.columns["x_mm"]}
    answer = replace(world, columns=columns).ask()
    assert answer.verdict == "unexplained"
    assert answer.says(("x_mm",), ("y_mm",), ("swap", "interchang", "mirror"))


@pytest.mark.parametrize(("seed", "lean_mrad"), [(0, 1.0), (0, 20.0), *slow((1, 5.0))])
def test_swapped_columns_are_said_on_leaning_rails(seed: int, lean_mrad: float) -> None:
    """Catches swapped columns that are not said for what they do wherever the instrument stands, a left-handed frame,
    where rails lean too."""
    lean = 1e-3 * lean_mrad * np.random.default_rng([seed, 9]).normal(size=6)
    world = worlds.delta_world(seed, effects={"rail_lean": lean})
    swapped = {"x_mm": world.columns["y_mm"], "y_mm": world.columns["x_mm"]}
    said = told(replace(world, columns=world.columns | swapped))
    assert "left-handed" in said[0].sentence


@pytest.mark.parametrize("kind", ["delta", "spherical", *slow("serial")])
@pytest.mark.parametrize("poses", ["a line", "a place", "everywhere"])
def test_readings_that_were_computed_are_told_from_measured_ones(kind: str, poses: str) -> None:
    """Catches a division by what is left where nothing is, a structure found in rounding, and a silent yes to a file of
    commanded places."""
    robot = kinds.known_kinds()[kind].example
    model = model_of(robot)
    (layout, *_), rng = model.layouts, np.random.default_rng(1)
    middle, reach = (130.0, 3.0) if kind == "delta" else (0.1, 0.3)
    joints = middle + rng.uniform(-reach, reach, (12, len(layout.joints)))
    if poses == "a line":
        joints = joints[0] + np.linspace(0, 1, 12)[:, None] * (joints[-1] - joints[0])
    elif poses == "a place":
        joints[:] = joints[0]
    told = dict(zip(layout.joints, joints.T, strict=True)) | dict.fromkeys(layout.coordinates, np.arange(12.0))
    empty = Measurements.from_columns(told, "computed.csv", layout=layout)
    shown = model.predict(empty, np.zeros(len(model.parameters)))
    told |= dict(zip(layout.coordinates, shown.T, strict=False))
    data = Measurements.from_columns(told, "computed.csv", layout=layout)
    found = sk.diagnose(robot, data)
    assert found.effects == ()
    assert found.verdict != "unexplained"
    assert any("computed.csv was computed" in note for note in found.notes)
    assert sk.calibrate(robot, data).converged


def test_a_robot_far_from_its_drawing_is_said_in_the_first_line() -> None:
    """Catches a drawing with rods 14 mm too long that identification swallows without a word: everything fits, and
    whoever deploys it has the file of another robot."""
    robot = kinds.known_kinds()["delta"].example
    data = sk.delta.VirtualDelta.draw(robot, 1).measure(sk.delta.paper_whole()[::6], repeats=2, seed=1)
    wrong = replace(robot, rod_length_mm=tuple(length + 14.0 for length in robot.rod_length_mm))
    right, found = (sk.diagnose(one, data) for one in (robot, wrong))
    assert right.verdict == found.verdict == "adequate"
    assert "is usual" not in right.headline
    assert "mm where 2 mm is usual" in found.headline
    assert "is the robot file that of this robot?" in found.headline
    # and nobody is sent on with it
    assert "Use the calibration as it is" in str(right.findings)
    assert "Use the calibration as it is" not in str(found.findings)
    assert "correct the file or look again" in str(found.findings)
