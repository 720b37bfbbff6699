"""Columns of too few digits, as a controller's display or a spreadsheet leaves them: what their steps do is computed
from the columns, and named where it is what is left. Nothing else is."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from hypothesis import given
from hypothesis import strategies as st

import sherkit as sk
from running import slow
from sherkit.base.types import Floats
from sherkit.data.noise import step_of
from sherkit.diagnosis.repeats import shared_by_repeats
from sherkit.robots.serial import Serial, postures
from test_arm_counted import OwnArm, arm_in
from test_discovery import DELTA, SIGMA
from test_few_poses import few


def rounded(values: Floats, step: float) -> Floats:
    return np.asarray(np.round(values / step) * step)


def check(d: sk.Diagnosis) -> bool | None:
    """Whether the digits are enough."""
    (found,) = [one for one in d.checks if one.name == "digits"]
    return found.holds


# -- the steps -----------------------------------------------------------------------------------------------------


@given(
    st.integers(0, 2**32 - 1), st.floats(1e-4, 10.0), st.floats(-200.0, 200.0), st.integers(60, 400),
    st.sampled_from([1.0, np.pi / 180.0, 2 * np.pi / 8192]), st.sampled_from([20, 200, 40_000]),
)  # fmt: skip
def test_a_step_is_read_whatever_its_size_its_zero_and_its_unit(
    seed: int, step: float, zero: float, n: int, unit: float, spread: int
) -> None:
    """Catches an algorithm that only knows decimals, or that loses a step in the rounding of floats, and one that
    takes the smallest difference that happened to occur for the step."""
    step, zero = step * unit, zero * unit
    values = zero + step * np.random.default_rng(seed).integers(0, spread, n)
    found = step_of(values)
    counts = np.rint((values - zero) / step).astype(np.int64)
    expected = step * np.gcd.reduce(np.diff(np.unique(counts))) if len(np.unique(counts)) >= 8 else 0.0
    assert found == pytest.approx(expected, rel=1e-6)


@given(st.integers(0, 2**32 - 1), st.integers(8, 3000))
def test_values_that_stand_anywhere_have_no_step_that_matters(seed: int, n: int) -> None:
    """Catches steps seen in values that have none: of few values, or of many that lie close."""
    assert step_of(np.random.default_rng(seed).uniform(-50.0, 50.0, n)) < 100.0 / n


@pytest.mark.parametrize("noise", [0.05, 0.15, 0.3, 0.6])
def test_what_repeats_share_of_rounding_is_what_rounding_leaves_in_their_means(noise: float) -> None:
    """Catches a wrong series, or the spread taken for the noise: 400 places, 2,000 repeats each, within 10 %, or of
    what is next to nothing within what 2,000 repeats leave of their noise, 0.02 of a step."""
    rng = np.random.default_rng(3)
    places = rng.uniform(0.0, 1.0, 400)
    read = np.round(places[:, None] + noise * rng.normal(size=(400, 2000)))
    left = float(np.std(read.mean(axis=1) - places))
    spread = float(np.sqrt(read.var(axis=1).mean()))
    assert shared_by_repeats(1.0, spread) == pytest.approx(left, rel=0.1, abs=0.02)
    assert shared_by_repeats(0.2, 0.2 * spread) == pytest.approx(0.2 * left, rel=0.1, abs=0.004)


def test_repeats_that_all_agree_share_all_of_the_rounding() -> None:
    """Catches a root that is looked for where there is none."""
    assert shared_by_repeats(0.1, 0.0) == pytest.approx(0.1 / np.sqrt(12.0), rel=0.01)


# -- named ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("repeats", [1, *slow(5)])
@pytest.mark.parametrize("seed", [0, *slow(1, 2)])
def test_joints_of_too_few_digits_are_named(seed: int, repeats: int) -> None:
    """Catches "each pose is off by its own" that sends somebody to look at markers and seats."""
    data = few(200, repeats, seed).data
    d = sk.diagnose(DELTA, replace(data, joints=rounded(data.joints, 0.03)))
    # without repeats nobody knows that it is not noise
    assert d.verdict in (("adequate", "unexplained") if repeats == 1 else ("unexplained",)), d.headline
    assert not d.effects
    assert "q1_mm, q2_mm, q3_mm stand in steps of 0.03 mm: that alone leaves 1" in d.headline
    assert "with all the digits" in d.headline
    assert "seating" not in d.headline


@pytest.mark.slow
def test_what_steps_of_joints_leave_is_what_they_left() -> None:
    """Catches a wrong size: that of the poses' own, estimated without any model of rounding, within 15 %."""
    data = few(400, 4, 9).data
    d = sk.diagnose(DELTA, replace(data, joints=rounded(data.joints, 0.02)))
    own = next(one.result for one in d.checks if one.name == "poses_as_repeats").split("off by ")[1].split()[0]
    alone = d.headline.split("that alone leaves ")[1].split()[0]
    assert float(alone) == pytest.approx(float(own), rel=0.15)


@pytest.mark.parametrize("repeats", [1, *slow(5)])
def test_readings_of_too_few_digits_are_named(repeats: int) -> None:
    """Catches a dial of a tenth of a millimetre that is taken for physics."""
    data = few(300, repeats, 4).data
    d = sk.diagnose(DELTA, replace(data, readings=rounded(data.readings, 0.1)))
    assert check(d) is False
    assert not d.effects
    assert "x_mm, y_mm, z_mm stand in steps of 0.1 mm" in d.headline
    assert "what the instrument read" in d.headline


def test_a_file_with_two_decimals_says_so(tmp_path: Path) -> None:
    """The whole way, from the text of a file."""
    frame = few(150, 3, 5).data.to_frame().with_columns(pl.col("^q.*$").round(2))
    frame.write_csv(tmp_path / "two.csv")
    d = sk.diagnose(DELTA, str(tmp_path / "two.csv"))
    assert "stand in steps of 0.01 mm" in d.headline


@pytest.fixture(scope="module")
def ur5(tmp_path_factory: pytest.TempPathFactory) -> Serial:
    """A six-joint arm with 27 numbers."""
    return arm_in(Path(tmp_path_factory.mktemp("arm")))


def test_degrees_of_two_decimals_are_named_in_degrees(ur5: Serial) -> None:
    """Catches a step in radians that nobody recognises, and a robot for which nothing of this was made."""
    joints = np.tile(postures(ur5, 70, 0.9, 2), (2, 1))
    data = OwnArm.made(2).run(ur5, joints, 2, False)
    step = float(np.radians(0.02))
    d = sk.diagnose(ur5, replace(data, joints=rounded(data.joints, step)))
    assert "in steps of 0.02°" in d.headline
    assert "shoulder_pan_rad" in d.headline


# -- and nothing else ----------------------------------------------------------------------------------------------


def test_digits_that_are_enough_are_not_mentioned_beside_a_missing_effect() -> None:
    """Catches steps of a file's last digit that are said of any run."""
    run = few(300, 3, 6, rail_lean=15.0)
    d = sk.diagnose(DELTA, replace(run.data, joints=rounded(run.data.joints, 1e-4)))
    assert d.effects == ("rail_lean",)
    assert check(d) is True


def test_joints_that_were_sent_to_a_grid_are_not_taken_for_rounded_ones() -> None:
    """Catches every run of a grid of round numbers being blamed on digits: the steps of what was sent to are far
    larger than what is left. Here with an error of each pose's own that has another cause."""
    rng = np.random.default_rng(8)
    joints = rounded(few(150, 3, 7).data.joints, 1.0)
    pose = np.unique(joints, axis=0, return_inverse=True)[1].ravel()
    own = 3 * SIGMA * rng.normal(size=(pose.max() + 1, 3))[pose]
    readings = DELTA.forward_batch(joints).require() + own + SIGMA * rng.normal(size=joints.shape)
    names = ("q1_mm", "q2_mm", "q3_mm", "x_mm", "y_mm", "z_mm")
    d = sk.diagnose(DELTA, sk.from_frame(dict(zip(names, [*joints.T, *readings.T], strict=True))))
    assert "of its own" in d.headline
    assert check(d) is True, d.headline
