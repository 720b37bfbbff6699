"""What a person meets who brings an arm of one's own: a target that nobody has measured, limits in another unit, and a
table that counts its rows."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl
import pytest

import sherkit as sk
from running import command, slow
from sherkit.data.file_check import check_file
from sherkit.errors import SherkitWarning
from sherkit.fit.set_up import set_up_mistakes
from sherkit.fit.set_up_zeros import several_joints
from sherkit.model.kinds import model_of
from sherkit.model.robot_file import save_robot
from sherkit.robots.serial import postures
from test_arm_counted import OwnArm, arm_in
from test_serial import NOISE_MM


@pytest.mark.parametrize("height_mm", [0.0, 50.0])
def test_a_target_that_nobody_measured_leaves_nothing_of_the_arm_out(height_mm: float, tmp_path: Path) -> None:
    """Catches numbers of the last joint that are held since a target drawn on its axis does not tell them: one that is
    held 60 mm beside it does, and a sound arm was "each pose is off by 36 µm of its own" (6 of 12)."""
    arm = arm_in(tmp_path)
    q = np.repeat(postures(arm, 60, 0.9, 3), 2, axis=0)
    run = OwnArm.made(3).run(arm, q, 3, declared=True)
    flange = replace(arm, target_mm=(0.0, 0.0, height_mm))
    assert set(sk.identify(flange, run).model.free) == set(sk.identify(arm, run).model.free)
    assert sk.diagnose(flange, run).verdict == "adequate"


def test_rows_beyond_the_limits_of_the_robot_file_are_said(tmp_path: Path) -> None:
    """Catches limits that were written in radians where degrees are read: they hold the arm to ± 3°, all rows stand
    elsewhere, and nothing said so."""
    arm = arm_in(tmp_path)
    q = postures(arm, 60, 0.9, 1)
    run = OwnArm.made(1).run(arm, q, 1, declared=True)
    small = [replace(arm.joints[0], limits=(-2.6, 2.6)), *arm.joints[1:]]
    told = f"{arm.layout.joints[0]}: .* of 60 rows stand outside its limits in the robot's file \\(-2.6 to 2.6 °\\)"
    with pytest.warns(SherkitWarning, match=told):
        sk.calibrate(replace(arm, joints=tuple(small)), run)
    notes = sk.diagnose(replace(arm, joints=tuple(small)), run).notes
    assert any("stand outside its limits" in note for note in notes)
    assert not any("stand outside its limits" in note for note in sk.diagnose(arm, run).notes)


def test_a_check_says_joints_beyond_their_limits(tmp_path: Path) -> None:
    """Catches degrees under a name in radians, of which a check said nothing and a diagnosis everything."""
    arm = arm_in(tmp_path)
    arm = replace(arm, joints=tuple(replace(one, limits=(-175.0, 175.0)) for one in arm.joints))
    save_robot(arm, tmp_path / "arm.toml")
    run = OwnArm.made(1).run(arm, postures(arm, 30, 0.9, 1), 1, declared=True).to_frame()
    name = arm.layout.joints[1]
    for column, said in ((pl.col(name), False), (pl.col(name) * 180.0 / np.pi, True)):
        run.with_columns(column).write_csv(tmp_path / "run.csv")
        code, shown, wrong = command(tmp_path, "check", "run.csv", "arm.toml")
        assert code == 0, wrong
        assert ("rows stand outside its limits in the robot's file" in " ".join(shown.split())) == said


@pytest.mark.parametrize(("numbers", "meant"), [("1,2,3,4", None), ("1,1,2,2", "Nr")])
def test_a_running_number_is_no_pose(numbers: str, meant: str | None, tmp_path: Path) -> None:
    """Catches "Nr" of each row taken for the number of its pose: each repeat was another pose, and what repeats tell of
    the noise was lost; and a number that is shared by repeats, which is one."""
    rows = [f"{k},{q},{q},{q},0,0,{0.001 * n}" for n, (k, q) in enumerate(zip(numbers.split(","), "1122", strict=True))]
    (tmp_path / "run.csv").write_text("\n".join(["Nr,q1_mm,q2_mm,q3_mm,x_mm,y_mm,z_mm", *rows]))
    found = check_file(tmp_path / "run.csv")
    assert found.columns.get("pose") == meant
    assert len(np.unique(found.data.groups)) == 2


@pytest.mark.parametrize(("seed", "flipped"), [(3, False), *slow((4, False), (5, True), (6, True))])
def test_zeros_and_senses_of_several_joints_at_once_are_said(seed: int, flipped: bool, tmp_path: Path) -> None:
    """Catches a vendor's zeros at quarter turns in several joints, of which each by itself shows nothing: "nothing that
    is usually mistaken explains the run", or physics that is not there. What is said to be changed, whichever of the
    wrist's two ways, leaves the noise."""
    arm = arm_in(tmp_path)
    rng = np.random.default_rng([seed, 51])
    zeros = 0.5 * np.pi * rng.integers(-1, 3, 6)
    senses = rng.choice([-1.0, 1.0], 6) if flipped else np.ones(6)
    run = OwnArm.made(seed).run(arm, postures(arm, 60, 0.9, seed), seed, declared=True)
    vendors = replace(run, joints=np.ascontiguousarray(senses * (run.joints - zeros)))
    (told, *_) = set_up_mistakes(model_of(arm), vendors)
    assert "the joints look counted from other zeros" in told.sentence
    assert told.after < 3.0 * 1e3 * NOISE_MM
    assert told.before > 1e4


def test_joints_that_are_counted_rightly_are_left_alone(tmp_path: Path) -> None:
    """Catches a sound arm of which another way to count is as good: the wrist has two."""
    arm = arm_in(tmp_path)
    run = OwnArm.made(7).run(arm, postures(arm, 60, 0.9, 7), 7, declared=True)
    assert several_joints(model_of(arm), run) is None
