"""What is read of a serial arm besides one target: several targets, distances from fixed centres, all in one run."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from scipy.spatial.transform import Rotation

import sherkit as sk
from running import slow
from second_arms import SecondArm
from sherkit.errors import FitError, MeasurementError, RobotError
from sherkit.model.kinds import model_of, robot_from_tables
from sherkit.robots.serial import KIND, Hidden, Joint, Plane, Serial, postures

PLAIN = {"noise_um": 50.0, "yield_mrad": 0.0, "play_mrad": 0.0, "ring_mrad": 0.0}


#: A plate that leans, a wall, the ground.
PLATES = (
    Plane((300.0, 0.0, 40.0), (0.1, -0.2, 1.0)),
    Plane((0.0, 900.0, 0.0), (0.0, -2.0, 0.0)),
    Plane((0.0, 0.0, 0.0)),
)


def arm(targets: int, centres: int, *, planes: int = 0, tracker: bool = True) -> Serial:
    """The example with so many targets, centres and planes."""
    more = ((-80.0, 40.0, 20.0), (60.0, -70.0, 30.0), (0.0, 0.0, 150.0))[: targets - 1]
    fixed = ((600.0, 300.0, 0.0), (-500.0, 400.0, 100.0), (200.0, -700.0, 50.0), (0.0, 0.0, 1500.0))[:centres]
    return replace(KIND.example, more_targets_mm=more, centres_mm=fixed, planes=PLATES[:planes], has_tracker=tracker)


def along_the_plane(drawn: Any, real: Any) -> list[float]:
    """By how much a normal leans along two directions within the plane as drawn, the first nearest to an axis."""
    n = np.array(drawn) / np.linalg.norm(drawn)
    axis = np.eye(3)[int(np.argmin(np.abs(n)))]
    u = axis - n * (n @ axis)
    u /= np.linalg.norm(u)
    return [float(real @ side / (real @ n)) for side in (u, np.cross(n, u))]


def run_of(robot: Serial, seed: int, rows: int, *, bars: float = 0.01, **hidden: Any) -> sk.Measurements:
    """A run of an arm with geometric errors of plausible size."""
    virtual = SecondArm.simulated(robot, seed, 1.0, PLAIN).with_hidden(**hidden)
    poses = postures(robot, rows, 0.9, seed)
    return replace(virtual, distance_noise_mm=bars).measure(poses, repeats=2, seed=seed + 5)


@pytest.mark.parametrize(
    ("targets", "centres", "planes", "tracker"),
    [(3, 0, 0, True), (1, 2, 0, True), (2, 4, 3, False), (2, 1, 1, True), (1, 0, 2, True), (2, 0, 3, False)],
)
def test_every_reading_is_that_of_the_second_simulator(
    targets: int, centres: int, planes: int, tracker: bool, tmp_path: Path
) -> None:
    """Catches a target, centre or plane that is another one's, an error in the wrong frame, a derivative that is not
    that of the prediction, and a file that loses one of them."""
    robot = arm(targets, centres, planes=planes, tracker=tracker)
    sk.save_robot(robot, tmp_path / "arm.toml")
    assert robot_from_tables(tomllib.loads((tmp_path / "arm.toml").read_text()), "again") == robot
    rng = np.random.default_rng(5)
    tools, fixed = rng.normal(size=(targets, 3)), rng.normal(size=(centres, 3))
    offset = 1e-3 * rng.normal(size=6)
    effects = Hidden(rate_mm_h=(0.5, 0.2, -0.3), bar_mm=0.4 if centres else 0.0)
    leant = 0.02 * rng.normal(size=(planes, 4))
    virtual = SecondArm(robot, offset, tool_mm=tools, centres_mm=fixed, planes=leant, effects=effects)
    data = virtual.measure(postures(robot, 12), seed=1)
    data.save(tmp_path / "run.csv")
    data = sk.read_measurements(tmp_path / "run.csv")
    model = model_of(robot)
    added = [model.known_effects[name] for name in ("drift", "bar_zero") if name in model.known_effects]
    model = replace(model, free=tuple(p.name for p in model.base), effects=tuple(added))
    names = {f"offset_{i + 1}": offset[i] for i in range(6)} | {"bar_zero.length": 0.4}
    for a, axis in enumerate("xyz"):
        names |= {f"tool_{axis}": tools[0, a], f"drift.rate_{axis}": effects.rate_mm_h[a]}  # type: ignore[index]
        names |= {f"target_{k + 1}_{axis}": tools[k, a] for k in range(1, targets)}
        names |= {f"centre_{k + 1}_{axis}": fixed[k, a] for k in range(centres)}
    for k, (drawn, (*turn, lift)) in enumerate(zip(PLATES, leant.tolist(), strict=False)):
        lean = along_the_plane(drawn.normal, Rotation.from_rotvec(turn).apply(drawn.normal))
        names |= {f"plane_{k + 1}_lean_u": lean[0], f"plane_{k + 1}_lean_v": lean[1], f"plane_{k + 1}_height": lift}
    values = np.array([names.get(p.name, 0.0) for p in model.parameters])
    predicted = model.predict(data, values)
    np.testing.assert_allclose(predicted[data.taken], data.readings[data.taken], atol=1e-7)
    columns = model.derivatives(data, values)
    for k, p in enumerate(model.parameters):
        step = np.where(np.arange(len(values)) == k, 1e-3 * min(p.size, 10.0), 0.0)
        change = model.predict(data, values + step) - model.predict(data, values - step)
        np.testing.assert_allclose(columns[:, :, k] * 2 * step[k], change, rtol=1e-4, atol=1e-8, err_msg=p.name)


def test_more_targets_tell_the_last_joints_apart() -> None:
    """Catches a default that stays as it is with one target: two more tell how the last axis leans and where it is."""
    one, three = (model_of(arm(count, 0)) for count in (1, 3))
    assert len(one.free) == 27
    assert {name[:9] for name in three.free} >= {"target_2_", "target_3_"}
    fit = sk.identify(three, run_of(arm(3, 0), 1, 60))
    # six for the frame and four for each joint, two targets beyond what the first axis shows of its three numbers
    assert fit.rank == len(fit.values) == len(three.free)
    assert fit.scale == pytest.approx(1.0, rel=0.15)


@pytest.mark.slow
def test_distances_alone_name_what_gives() -> None:
    """Catches joints that give way and that places alone tell."""
    robot = arm(1, 3, tracker=False)
    assert sk.diagnose(robot, run_of(robot, 3, 40, gives=1e-3)).headline == "explained: joint_compliance"


def test_distances_alone_calibrate_an_arm() -> None:
    """Catches a tracker that is asked for where there is none, and distances that are not those of the base frame."""
    robot = arm(1, 3, tracker=False)
    data = run_of(robot, 3, 40, gives=1e-3)
    assert not any(name.startswith("frame") for name in model_of(robot).free)
    result = sk.calibrate(robot, data, effects=["joint_compliance"], correction="none")
    made, fit = result.calibration, result.whole.fit
    virtual = SecondArm.simulated(robot, 3, 1.0, PLAIN).with_hidden(gives=1e-3)
    known = dict(zip((p.name for p in fit.parameters), fit.values.tolist(), strict=True))
    centres = np.array(robot.centres_mm) + [[known.get(f"centre_{k}_{a}", 0.0) for a in "xyz"] for k in (1, 2, 3)]
    still = np.zeros(6)
    for joints in postures(robot, 20, 0.8, seed=8):
        real = virtual.true_target(joints, still, still)
        told = np.linalg.norm(made.forward(joints) - centres, axis=1)
        shown = [virtual.distance(real, k) for k in range(3)]
        np.testing.assert_allclose(told, shown, atol=0.06)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 3])
def test_what_links_without_masses_leave_is_said(seed: int) -> None:
    """Catches an arm whose file has no masses and whose joints give way under others than sticks: encoders off their
    axes were named for the rest, or the joints too soft, without a word of the masses."""
    drawn = KIND.example
    weights = zip(drawn.joints, (20.0, 12.0, 2.0, 4.0, 1.0, 6.0), (0.0, 80.0, 0.0, 0.0, 0.0, 50.0), strict=True)
    heavy = replace(
        drawn, joints=tuple(replace(joint, mass_kg=mass, centre_mm=(x, 0.0, 0.0)) for joint, mass, x in weights)
    )
    data = run_of(heavy, seed, 100, gives=2e-3)
    assert sk.diagnose(heavy, data).headline == "explained: joint_compliance"
    found = sk.diagnose(drawn, data)
    assert "joint_compliance" in found.effects
    rest = ", ".join(name for name in found.effects if name != "joint_compliance") or "what is left"
    assert f"takes links for sticks: {rest} may be what that makes up for; add mass_kg and centre_mm" in found.caveat


@pytest.mark.parametrize(
    ("centres", "planes", "hidden", "says"),
    [
        (3, 0, {}, ()),
        *slow(
            (0, 3, {}, ()),
            (3, 0, {"play": 5e-4}, ("backlash",)),
            (0, 3, {"play": 5e-4}, ("backlash",)),
            (3, 0, {"ring": 5e-4}, ("encoder_eccentricity",)),
            (0, 3, {"ring": 5e-4}, ("encoder_eccentricity",)),
        ),
    ],
)
def test_distances_alone_tell_what_is_missing(
    centres: int, planes: int, hidden: dict[str, float], says: tuple[str, ...]
) -> None:
    """Catches a search that needs three coordinates: one distance a row is what a ball bar or a touch tells.

    Tried besides: 20 runs of each with nothing hidden, none of which alarmed."""
    robot = arm(1, centres, planes=planes, tracker=False)
    found = sk.diagnose(robot, run_of(robot, 2, 100, **hidden))
    assert (found.verdict, found.effects) == ("explained" if says else "adequate", says)
    # poses are held out by where they stand, though nothing read says where that is
    where = found.fit.model.place(found.fit.data, found.fit.predicted)
    assert min(np.ptp(one) for one in where.values()) > 500.0


def test_joints_that_turn_ripple_beside_one_that_slides() -> None:
    """Catches an arm of joints in two units, as every SCARA, that has no periodic effect, or one period in both; and a
    quill "counted the other way" because four joints reach a place in many postures, of which the file gives one."""
    joints = (
        Joint("shoulder", origin_mm=(0.0, 0.0, 300.0), limits=(-130.0, 130.0)),
        Joint("elbow", origin_mm=(350.0, 0.0, 0.0), limits=(-140.0, 140.0)),
        Joint("quill", "prismatic", (250.0, 0.0, 0.0), axis=(0.0, 0.0, -1.0), limits=(0.0, 150.0)),
        Joint("wrist", limits=(-180.0, 180.0)),
    )
    robot = Serial(joints, target_mm=(40.0, 0.0, -30.0))
    lines = np.array([[3e-4, 1e-4], [-2e-4, 2e-4], [0.0, 0.0], [0.0, 3e-4]])
    virtual = SecondArm.simulated(robot, 3, 1.0, PLAIN).with_hidden(lines=lines, per_turn=40.0)
    found = sk.diagnose(robot, virtual.measure(postures(robot, 160, 0.9, 3), repeats=2, seed=4))
    assert found.effects == ("encoder_cyclic",)
    period = model_of(robot).known_effects["encoder_cyclic"]
    assert [p.name for p in period.parameters] == [f"{w}_{k}" for k in (1, 2, 4) for w in ("sine", "cosine")]
    assert any("period 0.157080 ± 0.000079 rad, 40 per turn" in note for note in found.notes)


def test_a_mixed_run_weighs_each_reading_by_its_own_noise() -> None:
    """Catches a bar of 10 µm that counts as much as a tracker of 50, and repeats of two targets that are one noise."""
    robot = arm(2, 1)
    virtual = replace(SecondArm.simulated(robot, 2, 1.0, PLAIN), distance_noise_mm=0.01)
    fit = sk.identify(robot, virtual.measure(postures(robot, 40, 0.9, 2), repeats=2, seed=4))
    sigma = fit.data.repeatability.sigma
    assert sigma["distance_mm"] == pytest.approx(0.01, rel=0.25)
    assert sigma["x_mm"] == pytest.approx(0.05, rel=0.25)
    left = fit.residuals[fit.data.taken[:, 3], 3]
    assert np.sqrt(np.mean(left**2)) < 0.015


@pytest.mark.slow
@pytest.mark.parametrize(
    ("repeats", "seed"),
    [(1, 0), (3, 2), (1, 1), (3, 6), (3, 7)],
)
def test_what_targets_of_a_pose_share_is_no_evidence_for_each(repeats: int, seed: int) -> None:
    """Catches three witnesses made of one: an arm stands 20 µm beside its pose, and three targets on it show that.

    Taken for readings of their own, three of these five runs were unexplained; at 1 % for each, none is.
    """
    robot, rng = arm(3, 0), np.random.default_rng(1000 + seed)
    virtual = SecondArm.simulated(robot, seed, 1.0, PLAIN | {"noise_um": 0.0})
    frame = virtual.measure(postures(robot, 60, 0.8, seed=seed), repeats=repeats, seed=seed).to_frame()
    shared = np.repeat(rng.normal(0.0, 0.02, (len(frame) // 3, 3)), 3, axis=0)
    error = shared + rng.normal(0.0, 0.005, shared.shape)
    moved = [pl.col(name) + pl.Series(error[:, k]) for k, name in enumerate(("x_mm", "y_mm", "z_mm"))]
    found = sk.diagnose(sk.identify(robot, frame.with_columns(moved).drop("temperature_c")))
    assert (found.verdict, found.effects) == ("adequate", ())


def test_a_length_of_all_bars_is_identified() -> None:
    """Catches a zero of the bars that is taken for geometry, as the places of their centres."""
    data = run_of(arm(1, 2), 4, 60, bar_mm=0.08)
    without, fit = (sk.identify(arm(1, 2), data, effects=effects) for effects in ([], ["bar_zero"]))
    assert without.rms()["distance_mm"] > 15.0
    assert fit.rms()["distance_mm"] == pytest.approx(10.0, rel=0.2)
    assert fit.by_name["bar_zero.length"] == pytest.approx(0.08, abs=4 * fit.std[-1])
    assert fit.std[-1] < 0.01


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"target": 3.0}, "target: expected a number from 1 to 2, found 3"),
        ({"target": 1.5}, "target: expected a number from 1 to 2, found 1.5"),
        ({"centre": 2.0}, "centre: expected a number from 1 to 1, found 2"),
        ({"centre": np.nan, "plane": 3.0}, "plane: expected a number from 1 to 2, found 3"),
    ],
)
def test_numbers_that_name_nothing_are_refused(change: dict[str, float], said: str) -> None:
    """Catches a row that is read as another target's or centre's."""
    robot = arm(2, 1, planes=2)
    data = run_of(robot, 1, 30)
    frame = {name: data.to_frame()[name].to_numpy().copy() for name in data.to_frame().columns}
    for name, number in change.items():
        frame[name] = np.where(np.arange(len(data)) == int(np.argmax(data.is_distance)), number, frame[name])
    with pytest.raises(FitError, match=said):
        sk.identify(robot, sk.from_frame(frame))


def test_half_a_distance_is_refused() -> None:
    """Catches a distance without a centre, which would count from nowhere, and one from two things at once."""
    data = run_of(arm(1, 1), 1, 10)
    frame = {name: data.to_frame()[name].to_numpy().copy() for name in data.to_frame().columns}
    for wrong in ({"centre": np.full(len(data), np.nan)}, {"plane": np.ones(len(data))}):
        with pytest.raises(
            MeasurementError, match="a distance needs distance_mm and one, and only one, of centre, pla"
        ):
            sk.from_frame(frame | wrong)
    del frame["centre"]
    with pytest.raises(MeasurementError, match=r"'centre' is missing .the other end of each distance.*, or 'plane'"):
        sk.from_frame(frame)


@pytest.mark.slow
def test_planes_that_are_touched_calibrate_an_arm() -> None:
    """Catches planes that pull the arm with them, or a run of touches alone of which a frame is asked that nobody saw:
    places within the planes' own frame are right to what the probe repeats."""
    robot = arm(1, 0, planes=3, tracker=False)
    data = run_of(robot, 3, 150)
    virtual = SecondArm.simulated(robot, 3, 1.0, PLAIN)
    fit = sk.identify(robot, data)
    assert fit.scale == pytest.approx(1.0, rel=0.15)
    made = sk.calibrate(robot, data).calibration
    known = dict(zip((p.name for p in fit.parameters), fit.values.tolist(), strict=True))
    still = np.zeros(6)
    for joints in postures(robot, 20, 0.8, seed=8):
        real, told = virtual.true_target(joints, still, still), made.forward(joints)
        for k, drawn in enumerate(PLATES):
            n = np.array(drawn.normal) / np.linalg.norm(drawn.normal)
            u = np.eye(3)[int(np.argmin(np.abs(n)))]
            u = (u - n * (n @ u)) / np.linalg.norm(u - n * (n @ u))
            leant = n + known.get(f"plane_{k + 1}_lean_u", 0.0) * u
            leant += known.get(f"plane_{k + 1}_lean_v", 0.0) * np.cross(n, u)
            above = leant @ (told - drawn.at_mm) / np.linalg.norm(leant) - known.get(f"plane_{k + 1}_height", 0.0)
            assert above == pytest.approx(virtual.height(real, k), abs=0.06)


def test_an_arm_that_nothing_reads_is_refused(tmp_path: Path) -> None:
    """Catches a fifth target that is lost without a word."""
    tables = arm(4, 4).to_tables()
    tables["target"].append({"at_mm": [1.0, 2.0, 3.0]})
    with pytest.raises(RobotError, match="targets: an arm has at most 4, got 5"):
        robot_from_tables(tables, "robot.toml")
