"""Where a run measured ends at the hull of its poses, and what is promised of an arm beside the base's places."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import linprog

import sherkit as sk
from field_worlds import field
from second_arms import SecondArm
from sherkit.model.kinds import known_kinds
from sherkit.robots.calibrated import MIDDLE
from sherkit.robots.delta import VirtualDelta, paper_local
from sherkit.robots.poses_hull import MARGIN, beyond, outermost
from sherkit.robots.serial import SerialCalibration
from sherkit.robots.unobserved_effects import Search
from strategies import EXAMPLE

PLAIN = {"noise_um": 50.0, "yield_mrad": 0.0, "play_mrad": 0.0, "ring_mrad": 0.0}


@pytest.fixture(scope="module")
def arm() -> tuple[SecondArm, SerialCalibration]:
    """An arm off by what is plausible, calibrated from 150 poses of a part of its joints."""
    robot = known_kinds()["serial"].example
    virtual = SecondArm.simulated(robot, 2, 1.0, PLAIN)
    middle, half = robot.home, 0.15 * np.ptp(robot.ranges, axis=0).clip(max=2.0)
    poses = middle + half * np.random.default_rng(3).uniform(-1, 1, (150, len(middle)))
    made = sk.calibrate(robot, virtual.measure(poses, repeats=2, seed=3)).calibration
    assert isinstance(made, SerialCalibration)
    return virtual, made


def test_the_hull_is_that_of_linear_programming() -> None:
    """Catches a posture inside that counts as outside or the other way round: 40 in six joints, asked of a linear
    program written down otherwise; and a run cut to its rim that has another hull."""
    rng = np.random.default_rng(0)
    poses = rng.uniform(-1, 1, (80, 6)) * [1, 2, 3, 1, 1, 0.2] + 5.0
    middle = poses.mean(axis=0)
    for scale in rng.uniform(0.2, 1.6, 40):
        q = middle + scale * (poses[rng.integers(80)] - middle)
        weights = np.ones(len(poses))
        by = linprog(weights, A_eq=(poses - middle).T, b_eq=q - middle)
        far = float(beyond(poses, q[None])[0])
        assert (far > 0) <= (by.fun > 1.0)
        assert (far > 0) >= (by.fun > 1.0 + 1e-3)
    flat = rng.normal(size=(1000, 3))
    few = outermost(flat)
    assert len(few) <= 300
    asked = rng.normal(size=(100, 3)) * 2.0
    assert ((beyond(few, asked) > 0) == (beyond(flat, asked) > 0)).mean() > 0.98


def test_a_joint_that_never_moved_ends_where_it_stood() -> None:
    """Catches a joint that stood still and counts as measured everywhere, and one that is outside by its jitter."""
    poses = np.random.default_rng(0).uniform(-1, 1, (50, 3)) * [1, 1, 1e-5]
    assert beyond(poses, np.array([[0.0, 0.0, 1e-3], [0.0, 0.0, 0.5]]))[0] <= MARGIN
    assert beyond(poses, np.array([[0.0, 0.0, 0.5]]))[0] > 1.0


def test_an_arm_is_not_measured_where_its_joints_are_others(arm: tuple[SecondArm, SerialCalibration]) -> None:
    """Catches a promise that knows places alone: far from the poses in its joints the radius grows, and says so."""
    _, made = arm
    own = made.whole.poses[:5]
    other = own + 1.2 * np.ptp(made.whole.poses, axis=0)
    inside, outside = (made.predicted_accuracies_with(q, frame="sensor") for q in (own, other))
    assert inside.beyond is not None
    assert outside.beyond is not None
    assert (inside.beyond == 0).all()
    assert (outside.beyond > 0.5).all()
    assert (outside.radius_mm > 1.5 * inside.radius_mm).all()
    assert "extrapolated" in str(outside[0])
    assert "extrapolated" not in str(inside[0])
    assert made.measured(made.forward(own[0]))
    assert not made.measured(made.forward(other[0]))


def test_places_of_an_arm_are_where_it_was_measured(arm: tuple[SecondArm, SerialCalibration]) -> None:
    """Catches a middle of the run at which no joints like those of the run lead, and accuracy in the tracker's frame
    that is that of the base: there where the base lies counts, here it does not."""
    _, made = arm
    places = dict(made.places())
    assert made.measured(places[MIDDLE])
    beside = {one.name: one for one in made.beside_base()}
    assert beside[MIDDLE].sensor_mm < 0.5 * made.accuracy(places[MIDDLE])
    assert np.isnan(beside[MIDDLE].move_mm)


def test_moves_are_as_accurate_as_is_said(arm: tuple[SecondArm, SerialCalibration]) -> None:
    """Catches an accuracy of moves in which what both ends share still counts, or that forgets what it leaves at both:
    of 15 moves as the tracker would see them without noise at least 13 are within, and half are not within a tenth
    (fixed seeds)."""
    virtual, made = arm
    poses, rng = made.whole.poses, np.random.default_rng(1)
    off, said = [], []
    for _ in range(15):
        ends = poses[rng.choice(len(poses), 2, replace=False)]
        true = virtual.noise_free(ends)[:, :3]
        told = made.forward_batch(ends, frame="sensor").values
        off.append(np.linalg.norm((true[1] - true[0]) - (told[1] - told[0])))
        said.append(made.move_accuracy_with(ends[0], ends[1], frame="sensor"))
    assert np.mean(np.array(off) <= said) >= 13 / 15
    assert np.median(np.array(off) / said) > 0.1


def test_poses_are_kept_in_the_file(arm: tuple[SecondArm, SerialCalibration], tmp_path: Path) -> None:
    """Catches a calibration that forgets where it was measured once it is saved."""
    _, made = arm
    made.save(tmp_path / "c.toml")
    again = sk.load_calibration(tmp_path / "c.toml")
    assert again.whole.poses.tolist() == made.whole.poses.tolist()
    assert again.whole.elsewhere == made.whole.elsewhere >= 1.0


def test_a_deltas_corner_is_outside_though_its_box_holds_it() -> None:
    """Catches a box: poses in a diagonal strip have corners beside them in which nothing was measured."""
    grid = paper_local()
    strip = grid[np.abs(grid[:, 0] - grid[:, 1]) < 3.0]
    made = sk.calibrate(EXAMPLE, VirtualDelta(EXAMPLE, {"rod_length_1": 0.1}, noise_mm=0.005).measure(strip, seed=1))
    asked = np.array([[0.0, 0.0, 0.0], [9.0, -9.0, 0.0]])
    assert made.calibration.measured_batch(asked, frame="base").tolist() == [True, False]


@pytest.mark.parametrize("declared", [True, False])
def test_a_fit_takes_of_an_effect_what_its_drawing_leaves_it(declared: bool) -> None:
    """Catches an effect that a fit is said to take as if no drawing held it: of an arm that was measured in one small
    part it would then be 50 mm off elsewhere. What is said to be taken is what a fit to readings with the effect
    does."""
    world = field(2, sizes=0.1)
    result = sk.calibrate(world.arm.robot(), world.run(declared=declared))
    fit, made = result.whole.fit, result.calibration
    assert fit.priors
    effect = fit.model.known_effects["joint_scale"]
    one = Search(result.whole, made.whole, made.asked(made.whole)).told(effect, None)[1]
    wider = fit.model.with_effect(effect)
    size = 2e-4 * np.ones(len(effect.parameters))
    values = np.insert(fit.values, wider.owns(effect).start, size)
    moved = wider.predict(fit.data, values) - fit.predicted
    there = replace(fit.data, readings=fit.data.readings + np.nan_to_num(moved))
    again = sk.identify(fit.model, there, priors=fit.priors, noise=fit.noise, start=fit.values)
    std = np.sqrt(np.diag(fit.covariance))
    took, said = (again.values - fit.values) / std, one.absorbed @ size / std
    assert np.abs(said).max() > 0.5
    assert np.abs(took - said).max() < 0.05 * np.abs(said).max()
