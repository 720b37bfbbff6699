"""Points fixed to the base: what they tell of where the instrument stands, and where a plan offers them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import sherkit as sk
from second_simulator import NOMINAL_CONFIG, grid, write_robot_toml
from sherkit.diagnosis.sensor_pose import pose_in_words, taken_by_pose
from sherkit.model.kinds import model_of

TARGETS = np.array([[150.0, 0.0, -20.0], [-80.0, 120.0, -20.0], [-70.0, -130.0, 10.0]])


def test_targets_tell_the_pose_as_well_as_they_say() -> None:
    """Catches a deviation about other axes or in degrees, and a turn by its inverse: 400 readings of three targets by
    one noise scatter by what is said, within a tenth (4 deviations of 400), about the true pose."""
    rng = np.random.default_rng(3)
    turn, shift = Rotation.from_euler("xyz", [100.0, -20.0, 170.0], degrees=True), np.array([300.0, -20.0, 900.0])
    made = [
        sk.SensorPose.from_targets(TARGETS, turn.apply(TARGETS) + shift + rng.normal(0, 0.01, (3, 3)), 0.01)
        for _ in range(400)
    ]
    off = [(Rotation.from_matrix(one.turn) * turn.inv()).as_rotvec(degrees=True) for one in made]
    np.testing.assert_allclose(np.std(off, axis=0), made[0].turn_sd_deg, rtol=0.15)
    np.testing.assert_allclose(np.std([one.origin_mm for one in made], axis=0), made[0].shift_sd_mm, rtol=0.15)
    np.testing.assert_allclose(np.mean([one.origin_mm for one in made], axis=0), shift, atol=0.01)


def test_without_a_noise_their_own_spread_tells() -> None:
    """Catches a pose that is known exactly because nobody said the noise: as large as what is left, and no smaller."""
    rng = np.random.default_rng(4)
    base = rng.uniform(-200, 200, (40, 3))
    read = base + rng.normal(0, 0.01, base.shape)
    by_spread, by_noise = sk.SensorPose.from_targets(base, read), sk.SensorPose.from_targets(base, read, 0.01)
    np.testing.assert_allclose(by_spread.shift_sd_mm, by_noise.shift_sd_mm, rtol=0.25)


@pytest.mark.parametrize(
    ("base", "read", "said"),
    [
        (TARGETS[:2], TARGETS[:2], "three points fixed to the base or more"),
        (TARGETS, TARGETS[:, :2], "three points fixed to the base or more"),
        (np.outer([0, 1, 2, 5.0], [1, 2, 3]), np.outer([0, 1, 2, 5.0], [1, 2, 3]), "lie on a line"),
        (TARGETS, TARGETS * np.nan, "expected finite numbers"),
    ],
)
def test_bad_targets(base: object, read: object, said: str) -> None:
    """Catches a pose that is guessed: a sentence says what is needed."""
    with pytest.raises(sk.SherkitError, match=said):
        sk.SensorPose.from_targets(base, read)


def test_offered_where_a_lean_cannot_be_told(tmp_path) -> None:  # type: ignore[no-untyped-def]
    """Catches a plan that is silent on what no pose of it tells, and one that offers targets where the pose is held."""
    for held, offered in ((False, True), (True, False)):
        write_robot_toml(tmp_path / "robot.toml", NOMINAL_CONFIG | {"sensor_pose": {"free": not held}})
        robot = sk.load_robot(tmp_path / "robot.toml")
        model = model_of(robot)
        rows = sk.Measurements.planned(robot.inverse_batch(grid(20.0, 4, (-20.0, 0.0, 20.0))).values, model.layouts[0])
        taken = taken_by_pose(model, rows, np.zeros(len(model.parameters)), tuple(model.known_effects.values()))
        assert (taken.get("rail_lean") == (2, 6)) == offered
        said = pose_in_words((), taken)
        assert (said is not None) == offered
        if said is not None:
            assert "2 of the 6 directions of rail_lean" in said
            assert "Three points fixed to the base" in said
