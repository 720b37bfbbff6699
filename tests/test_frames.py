"""In which frame a calibration's places are: that of the base, that of the sensor, and how accurate it is in each.

Readings are those of the second simulators, from an instrument that stands anywhere. Robots are drawn at plausible
size: in the frame of the base nobody knows more of what no reading tells. There the places of one robot are missed
together, so that a share is one of robots, and its level follows from their number.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import polars as pl
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import sherkit as sk
from accuracy_coverage import MIDDLE_RAD
from running import slow
from second_arms import SecondArm
from second_simulator import NOMINAL_CONFIG, Robot, draw_pose, make_plan, simulate, truth
from sherkit.errors import CalibrationError
from sherkit.fit.error import radius_95
from sherkit.fit.hold_out import hold_out
from sherkit.model.kinds import model_of
from sherkit.model.robot_file import run_for
from sherkit.model.sensor_pose import POSE, slip_of
from sherkit.robots.calibrated import calibration_class
from sherkit.robots.calibration_run import CalibrationRun
from sherkit.robots.identified_model import IdentifiedModel
from sherkit.robots.serial import SerialCalibration, postures
from test_arm_counted import arm_in
from test_calibration import made, seen
from worlds import SPHERICAL, World, real_spherical

Floats = NDArray[np.float64]

ROBOT = Robot.from_dict(NOMINAL_CONFIG)
#: Plausible sizes of what is identified of a delta, mm and rad.
SIZES = {"base_radius": 3.0, "base_angle": np.deg2rad(1.0), "joint_offset": 2.0, "rod_length": 2.0}
NOISE_MM = 2e-3


def calibrated(robot: Any, run: sk.Measurements, **settings: Any) -> Any:
    """By a run, without the search for what its poses could not show."""
    fit = sk.identify(robot, run, **settings)
    return calibration_class(fit.model.robot).of(CalibrationRun(fit, hold_out(fit.model, run).residuals))


# -- the frames ----------------------------------------------------------------------------------------------


def test_both_frames_are_one_robot() -> None:
    """Catches a frame that is turned the wrong way, left out of Jacobian or inverse, or mixed up in a batch."""
    c = made(1)
    x = np.random.default_rng(1).uniform(-15.0, 15.0, (20, 3))
    q = c.inverse_batch(x, frame="base").require()
    np.testing.assert_allclose(c.inverse_batch(seen(c, x)).require(), q, atol=1e-7)
    np.testing.assert_allclose(c.forward_batch(q).require(), seen(c, x), atol=1e-6)
    np.testing.assert_allclose(c.from_sensor(c.forward_batch(q).require()), x, atol=1e-6)
    turn = c.sensor_frame[0]
    by_base = c.jacobian_batch(q, frame="base").require()
    np.testing.assert_allclose(turn @ by_base, c.jacobian_batch(q).require(), atol=1e-9)
    np.testing.assert_array_equal(c.jacobian(q[0], frame="base"), by_base[0])
    np.testing.assert_array_equal(c.forward(q[0], frame="sensor"), c.forward(q[0]))


OF_INSTRUMENT = ("beam_alignment", "sensor_linearity", "sensor_slip")


@pytest.mark.parametrize("effect", OF_INSTRUMENT)
@pytest.mark.parametrize("local", [False, True])
def test_errors_of_the_instrument_are_none_of_the_base(effect: str, local: bool) -> None:
    """Catches beams that are not square, an end that bends, or a knock of the stand, in where the robot is; and none of
    them in what the instrument reads there. What it reads has no part in the base to the last bit; where it stood is
    turned there and back."""
    c = made(2, effects=(effect,), local=local)

    def without(part: Any) -> Any:
        its = np.array([p.name.startswith(effect) for p in part.model(c.robot).parameters])
        return replace(part, values=np.where(its, 0.0, part.values))

    # the same instrument saw both
    parts = {"local": replace(c.local, values=c.whole.values)} if local else {}
    c = replace(c, **parts)
    other = replace(c, whole=without(c.whole), **({"local": without(c.local)} if local else {}))
    x = np.random.default_rng(0).uniform(-15.0, 15.0, (10, 3))
    q = c.robot.inverse_batch(x).require()
    assert np.abs(c.forward_batch(q).require() - other.forward_batch(q).require()).max() > 1e-4
    np.testing.assert_allclose(
        c.forward_batch(q, frame="base").require(), other.forward_batch(q, frame="base").require(), atol=1e-9
    )
    if effect != "sensor_slip":
        np.testing.assert_array_equal(c.forward(q[0], frame="base"), other.forward(q[0], frame="base"))
        np.testing.assert_array_equal(c.inverse(x[0], frame="base"), other.inverse(x[0], frame="base"))


def test_a_delta_is_read_as_the_instrument_reads_after_its_last_slip() -> None:
    """Catches a deployed robot that is seen from where its instrument stood before it was knocked, or without its
    errors, and a frame that says another pose than the core has. Readings are those of the fitted model, 1e-9 mm."""
    c = made(4, effects=OF_INSTRUMENT, local=False)
    c = replace(c, whole=replace(c.whole, correction=None))
    model, q = c.model, c.robot.inverse_batch(np.random.default_rng(4).uniform(-15.0, 15.0, (10, 3))).require()
    values = dict(zip((p.name for p in model.parameters), c.whole.values, strict=True))
    off = np.array([values[one] + values[slip_of(one)] for one in POSE])
    turn, shift = Rotation.from_rotvec(off[:3]).as_matrix() @ model.sensor_pose.turn, off[3:]
    for found in (c.sensor_frame, (c.core.sensor()[:9].reshape(3, 3), c.core.sensor()[9:])):
        np.testing.assert_allclose(found[0], turn, atol=1e-12)
        np.testing.assert_allclose(found[1], shift + model.sensor_pose.origin_mm, atol=1e-12)
    # rows of the run after the slip, which is at 0 s
    after = [1.0, 20.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 20.0]
    read = model.core.predict(model.full(c.whole.values), (q, None, np.tile(after, (len(q), 1)), None))[0][:, :3]
    for time_s in (1.0, -1e6):
        early = replace(c, whole=replace(c.whole, now=(time_s, 20.0, 0.0, 0.0, 0.0)))
        np.testing.assert_allclose(early.forward_batch(q).require(), read, atol=1e-9)
        np.testing.assert_allclose(early.inverse_batch(read).require(), q, atol=1e-6)


def test_an_arm_is_read_as_its_tracker_reads_after_its_last_slip() -> None:
    """Catches an arm whose tracker has no scale, no bend and never slipped where its places are asked for as that reads
    them; and any of these in where the arm is. Readings are those of the fitted model, 1e-9 mm."""
    effects = ("sensor_scale", "sensor_linearity", "sensor_slip")
    with TemporaryDirectory() as folder:
        robot = arm_in(Path(folder))
    rng, q = np.random.default_rng(6), postures(robot, 12, 0.7, 6)
    model = model_of(robot)
    for name in effects:
        model = model.with_effect(model.known_effects[name])
    values = rng.normal(size=len(model.parameters)) * [0.3 * p.size for p in model.parameters]
    values[[p.name in POSE for p in model.parameters]] = draw_pose(rng)
    rows = {name: q[:, k] for k, name in enumerate(robot.layout.joints)} | {"time_s": np.arange(len(q)) + 1.0}
    run = sk.from_frame(pl.DataFrame(rows | dict.fromkeys(("x_mm", "y_mm", "z_mm"), np.zeros(len(q)))))
    read = model.predict(run, values)[:, :3]
    k = len(model.indices)
    part = IdentifiedModel(
        free=model.free, effects=effects, settings=dict.fromkeys(model.settings(), 0.0), left_out=(),
        now=(0.0, 20.0, *np.zeros(len(robot.joints))), values=values[:k], covariance=np.zeros((k, k)),
        residual_covariance=np.zeros((3, 3)), low=np.full(3, -2000.0), high=np.full(3, 2000.0), made_from="a test",
        rows=len(q), readings=("x_mm", "y_mm", "z_mm"),
    )  # fmt: skip
    for time_s in (0.0, -1e6):
        c: Any = SerialCalibration(robot, replace(part, now=(time_s, *part.now[1:])))
        np.testing.assert_allclose(c.forward_batch(q, frame="sensor").require(), read, atol=1e-9)
        back = c.inverse_batch(read, frame="sensor", starts=q + 1e-3).require()
        np.testing.assert_allclose(c.forward_batch(back, frame="sensor").require(), read, atol=1e-6)
        np.testing.assert_allclose(c.inverse(read[0], frame="sensor", start=q[0] + 1e-3), back[0], atol=1e-12)
        own = np.array([any(p.name.startswith(name) for name in effects) for p in c.model.parameters])
        straight: Any = replace(c, whole=replace(c.whole, values=np.where(own, 0.0, c.whole.values)))
        np.testing.assert_array_equal(c.forward_batch(q).require(), straight.forward_batch(q).require())
        assert np.abs(straight.forward_batch(q, frame="sensor").require() - read).max() > 0.05


def test_a_machine_is_seen_from_where_its_instrument_stood_at_last() -> None:
    """Catches a machine that is sent to where its tracker would have seen it before that was knocked."""
    machine = sk.Machine(
        lambda q, p: q * (1.0 + p.scale), joints=("x_axis_mm", "y_axis_mm", "z_axis_mm"),
        readings=("x_mm", "y_mm", "z_mm"), parameters={"scale": ("", 1e-4)}, sensor_pose="free",
    )  # fmt: skip
    rng = np.random.default_rng(8)
    q, stood, knock = rng.uniform(0.0, 400.0, (60, 3)), draw_pose(rng), np.array([1e-3, -2e-3, 1e-3, 0.5, -0.5, 0.3])
    late = np.arange(60) >= 30

    def read(places: Floats, after: bool) -> Floats:
        off = stood + knock * after
        return Rotation.from_rotvec(off[:3]).apply(places) + off[3:]

    seen_mm = np.where(late[:, None], read(q, True), read(q, False)) + 1e-3 * rng.normal(size=q.shape)
    names = ("x_axis_mm", "y_axis_mm", "z_axis_mm", "x_mm", "y_mm", "z_mm")
    columns = dict(zip(names, np.column_stack([q, seen_mm]).T, strict=True)) | {"time_s": np.arange(60.0)}
    run = run_for(machine, pl.DataFrame(columns))
    model = model_of(machine)
    c = calibrated(model.with_effect(model.known_effects["sensor_slip"], at=29.5), run)
    there = rng.uniform(50.0, 350.0, (5, 3))
    np.testing.assert_allclose(c.forward_batch(there).require(), read(there, True), atol=0.02)
    np.testing.assert_allclose(c.to_sensor(there), read(there, True), atol=0.02)
    np.testing.assert_allclose(c.forward_batch(there, frame="base").require(), there, atol=0.02)


def test_an_unknown_frame_is_refused() -> None:
    """Catches a word that is taken for a frame, and a frame that a robot has not."""
    c = made(0)
    for ask in (c.inverse, c.forward, c.jacobian, c.accuracy, c.predicted_accuracy, c.measured):
        with pytest.raises(CalibrationError, match="expected 'base' or 'sensor', found 'bass'; did you mean 'base'"):
            ask([0.0, 0.0, 0.0], frame="bass")
    for ask in (c.inverse_batch, c.forward_batch, c.jacobian_batch, c.accuracy_batch, c.predicted_accuracies):
        with pytest.raises(CalibrationError, match="expected 'base' or 'sensor'"):
            ask([[0.0, 0.0, 0.0]], frame="bed")


def test_a_sphere_points_about_its_own_base_alone() -> None:
    """Catches angles of a tool that are asked for as a camera sees them."""
    angles = MIDDLE_RAD + np.random.default_rng(0).uniform(-0.3, 0.3, (20, 2))
    real, robot = real_spherical(SPHERICAL, 1), World(deepcopy(SPHERICAL), {}, 0.0).robot
    c = calibrated(robot, sk.from_frame(pl.DataFrame(real.run(robot.inverse_batch(angles).require(), 2, 0.1))))
    np.testing.assert_array_equal(c.inverse(MIDDLE_RAD, frame="base"), c.inverse(MIDDLE_RAD))
    with pytest.raises(CalibrationError, match="about its own centre"):
        c.inverse(MIDDLE_RAD, frame="sensor")


# -- how accurate it is in each --------------------------------------------------------------------------------


def delta(
    seed: int, errors: Mapping[str, float], hidden: Mapping[str, Floats], poses: int = 40
) -> tuple[Any, Any, Any]:
    """A robot with these errors, read from anywhere: its file, its run, and where it really is, seen from the base and
    by the instrument, at joints (n, 3) just after the run."""
    rng = np.random.default_rng([seed, 53])
    stands = {"sensor_pose": draw_pose(rng)}
    plan = make_plan(ROBOT, rng.uniform(-20.0, 20.0, (poses, 3)), 2, "shuffled", seed)
    columns = simulate(ROBOT, plan, errors, stands | dict(hidden), NOISE_MM, seed)

    def really(joints: Floats, frame: str) -> Floats:
        there = make_plan(ROBOT, np.zeros((len(joints), 3)))
        there |= {f"q{k + 1}_mm": joints[:, k] for k in range(3)}
        there["time_s"] = columns["time_s"][-1] + 1e-3 * np.arange(len(joints))
        there["temperature_c"] = np.full(len(joints), columns["temperature_c"].mean())
        return truth(ROBOT, there, errors, dict(hidden) | (stands if frame == "sensor" else {}))

    return World(deepcopy(dict(NOMINAL_CONFIG)), columns, 1e3 * NOISE_MM).robot, columns, really


def delta_held(seed: int) -> dict[str, float]:
    """Of one robot of plausible errors, the share of places that are missed by no more than promised, by frame."""
    rng = np.random.default_rng([seed, 54])
    errors = {f"{g}_{i}": size * rng.normal() for g, size in SIZES.items() for i in (1, 2, 3)}
    robot, columns, really = delta(seed, errors, {})
    c = calibrated(robot, sk.from_frame(pl.DataFrame(columns)))
    x, out = rng.uniform(-18.0, 18.0, (20, 3)), {}
    for frame, at in (("base", x), ("sensor", c.to_sensor(x))):
        off = np.linalg.norm(really(c.inverse_batch(at, frame=frame).require(), frame) - at, axis=1)
        out[frame] = float(np.mean(off <= c.predicted_accuracies(at, frame=frame).radius_mm))
    return out


def arm_held(seed: int) -> dict[str, float]:
    """The same of an arm before a tracker: its base is the one that its first axis defines, so that what would only say
    the same once more is as drawn."""
    with TemporaryDirectory() as folder:
        robot = arm_in(Path(folder))
    k, rng = len(robot.joints), np.random.default_rng([seed, 55])
    drawn: dict[str, Floats] = {
        "offset": np.zeros(k),
        "shift": np.zeros((k, 2)),
        "tilt": np.zeros((k, 2)),
        "tool": np.zeros(3),
    }
    for p in model_of(robot).parameters:
        what, *where = p.name.split("_")
        if what in drawn:
            axis = ["xyz".index(one) for one in where if one in "xyz"]
            drawn[what][(*(int(one) - 1 for one in where if one.isdigit()), *axis)] = p.size * rng.normal()
    real = SecondArm(robot, drawn["offset"], drawn["shift"], drawn["tilt"], drawn["tool"], draw_pose(rng))
    still = np.zeros(k)

    def really(joints: Floats, frame: str) -> Floats:
        at = [real.true_target(q, still, still) for q in joints]
        return np.array([real.seen(one, False) for one in at] if frame == "sensor" else at)

    q, there = postures(robot, 60, 0.8, seed), postures(robot, 20, 0.7, seed + 1000)
    q = np.repeat(q, 2, axis=0)
    read = really(q, "sensor") + 0.05 * rng.normal(size=(len(q), 3))
    columns = dict(zip((*robot.layout.joints, "x_mm", "y_mm", "z_mm"), np.column_stack([q, read]).T, strict=True))
    columns |= {"pose": np.arange(len(q)) // 2 + 1, "repeat": np.arange(len(q)) % 2 + 1}
    c, out = calibrated(robot, sk.from_frame(pl.DataFrame(columns))), {}
    for frame in ("base", "sensor"):
        at = c.forward_batch(there, frame=frame).require()
        spread = c.spread(c.forward_batch(there).require(), there, frame=frame)
        out[frame] = float(np.mean(np.linalg.norm(really(there, frame) - at, axis=1) <= radius_95(spread)))
    return out


@pytest.mark.parametrize("held", [delta_held, arm_held])
@pytest.mark.parametrize("robots", [3, *slow(200)])
def test_accuracy_holds_in_both_frames(held: Any, robots: int) -> None:
    """Catches a base whose unknown tilt and shift are left out, or counted where the instrument sees them cancel.

    In the base 95 of 100 robots: of 200 a deviation of 1.5 %, so that 0.92 to 0.99 fails by chance in 3 of 100; of
    three two at least (7 in 1000). Where the sensor saw it noise alone is in the way, which the radius counts in full.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        each = [held(seed) for seed in range(robots)]
    base, sensor = (float(np.mean([one[frame] for one in each])) for frame in ("base", "sensor"))
    print(f"{held.__name__}: {robots} robots, base {base:.3f}, sensor {sensor:.3f}")
    if robots > 100:
        assert 0.92 <= base <= 0.99
        assert sensor >= 0.93
    assert base > 0.6
    assert sensor > 0.8


def test_the_tilt_that_nobody_knows_counts_in_the_base() -> None:
    """Catches a lean common to all rails that is promised away: an instrument that stands anywhere takes it for its own
    tilt, so that in the base all of it is open, and where the instrument sees the robot none."""
    robot, columns, really = delta(3, {}, {"rail_lean": np.array([2.0, 1.0, 1.0, -2.0, -2.5, 0.5]) * 2e-3})
    run = sk.from_frame(pl.DataFrame(columns))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        c = sk.calibrate(robot, run, free=list(POSE), correction="none").calibration
    x = np.random.default_rng(0).uniform(-15.0, 15.0, (30, 3))
    base, sensor = c.predicted_accuracies(x, frame="base"), c.predicted_accuracies(c.to_sensor(x))
    assert any(one.effect == "rail_lean" for one in c.whole.unobserved_effects)
    assert np.median(base.addition_mm) > 3.0 * np.median(sensor.addition_mm)
    off = np.linalg.norm(really(c.inverse_batch(x, frame="base").require(), "base") - x, axis=1)
    assert (off <= base.total_mm).all()
    assert base[0].advice == ""


def test_a_machine_is_where_its_instrument_saw_it_and_in_its_base() -> None:
    """Catches a machine whose base is taken from where its tracker stands, and a frame promised of one that has
    none."""

    def gantry(q: Floats, p: Any) -> Floats:
        return np.column_stack([q[:, 0] + p.lean * q[:, 1], q[:, 1], q[:, 2]])

    joints = dict.fromkeys(("x_axis_mm", "y_axis_mm", "z_axis_mm"), (0.0, 400.0))
    machine = sk.Machine(
        gantry, joints=joints, readings=("x_mm", "y_mm", "z_mm"), parameters={"lean": ("rad", 2e-3)}, sensor_pose="free"
    )
    rng = np.random.default_rng(4)
    q, stands = rng.uniform(0.0, 400.0, (40, 3)), draw_pose(rng)

    def at(there: Floats) -> Floats:
        return np.column_stack([there[:, 0] + 1e-3 * there[:, 1], there[:, 1], there[:, 2]])

    turn = Rotation.from_rotvec(stands[:3])
    read = turn.apply(at(q)) + stands[3:] + 0.005 * rng.normal(size=q.shape)
    columns = dict(zip((*joints, "x_mm", "y_mm", "z_mm"), np.column_stack([q, read]).T, strict=True))
    c = calibrated(machine, run_for(machine, pl.DataFrame(columns)))
    there = rng.uniform(50.0, 350.0, (5, 3))
    np.testing.assert_allclose(c.forward_batch(there, frame="base").require(), at(there), atol=0.02)
    np.testing.assert_allclose(c.forward_batch(there).require(), turn.apply(at(there)) + stands[3:], atol=0.02)
    np.testing.assert_allclose(c.inverse_batch(at(there), frame="base").require(), there, atol=0.02)
    assert (c.predicted_accuracies(at(there), frame="base").radius_mm < 0.1).all()
    held = replace(machine, sensor_pose="held")
    straight = columns | dict(zip(("x_mm", "y_mm", "z_mm"), (at(q) + 0.005 * rng.normal(size=q.shape)).T, strict=True))
    own = calibrated(held, run_for(held, pl.DataFrame(straight)))
    np.testing.assert_allclose(own.forward_batch(there, frame="base").require(), own.forward_batch(there).require())
