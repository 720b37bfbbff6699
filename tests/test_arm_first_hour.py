"""What a person meets who brings an arm of one's own: a target that nobody has measured, limits in another unit, and a
table that counts its rows."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import sherkit as sk
from sherkit.data.file_check import check_file
from sherkit.errors import SherkitWarning
from sherkit.robots.serial import postures
from test_arm_counted import OwnArm, arm_in


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


@pytest.mark.parametrize(("numbers", "meant"), [("1,2,3,4", None), ("1,1,2,2", "Nr")])
def test_a_running_number_is_no_pose(numbers: str, meant: str | None, tmp_path: Path) -> None:
    """Catches "Nr" of each row taken for the number of its pose: each repeat was another pose, and what repeats tell of
    the noise was lost; and a number that is shared by repeats, which is one."""
    rows = [f"{k},{q},{q},{q},0,0,{0.001 * n}" for n, (k, q) in enumerate(zip(numbers.split(","), "1122", strict=True))]
    (tmp_path / "run.csv").write_text("\n".join(["Nr,q1_mm,q2_mm,q3_mm,x_mm,y_mm,z_mm", *rows]))
    found = check_file(tmp_path / "run.csv")
    assert found.columns.get("pose") == meant
    assert len(np.unique(found.data.groups)) == 2
