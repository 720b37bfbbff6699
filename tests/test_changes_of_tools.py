"""What changes when an arm is given another tool, another motor, or another place to stand: told of each other, and
where no reading tells them, said."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sherkit as sk
from second_arms import SecondArm
from second_simulator import draw_pose
from sherkit.robots.serial import postures
from test_arm_counted import arm_in
from test_serial import PLAIN

#: Another tool, mm.
LONGER = np.array([12.0, -7.0, 35.0])


def exchanged(folder: Path, seed: int, *, zeros: dict[int, float] | None = None, tool: Any = 0.0) -> list[Any]:
    """Two runs before a tracker that was stationed anew: by then zeros of joints (numbers from 1, rad) and the place
    of the target, mm, are others by so much."""
    arm = arm_in(folder)
    rng = np.random.default_rng([seed, 31])
    before = replace(SecondArm.simulated(arm, seed, 1.0, PLAIN), stand=draw_pose(rng))
    offset = np.array(np.broadcast_to(before.offset, 6), dtype=float)
    for number, by in (zeros or {}).items():
        offset[number - 1] += by
    after = replace(before, offset=offset, tool_mm=np.asarray(before.tool_mm) + tool, stand=draw_pose(rng))
    where = [postures(arm, n, 0.8, seed + k) for k, n in enumerate((60, 40))]
    return [
        arm,
        [one.measure(at, seed=seed + k) for k, (one, at) in enumerate(zip((before, after), where, strict=True))],
    ]


def test_another_tool_is_one_change(tmp_path: Path) -> None:
    """Catches a tool that was exchanged, of which one number of three was named and the rest was "no single change": it
    stands for another by centimetres, where its size was held against what a drawing is off by."""
    found = sk.compare(*exchanged(tmp_path, 3, tool=LONGER))
    assert (found.verdict, found.changed) == ("changed", ("tool",))
    moved = {one.name: one.change for one in found.parameters}
    np.testing.assert_allclose([moved[f"tool_{axis}"] for axis in "xyz"], LONGER, atol=0.1)


def test_another_tool_does_not_hide_another_motor(tmp_path: Path) -> None:
    """Catches the zero of a joint that is never named beside a large change of the tool."""
    found = sk.compare(*exchanged(tmp_path, 4, zeros={3: 2e-3}, tool=LONGER))
    assert set(found.changed) == {"offset_3", "tool"}
    assert {one.name: one.change for one in found.parameters}["offset_3"] == pytest.approx(2e-3, abs=1e-4)


def test_the_last_zero_and_the_tool_are_tied(tmp_path: Path) -> None:
    """Catches a motor that was exchanged at the last joint, and a reader who is sent to the tool alone: the zero of
    that joint is held, since the tool says the same."""
    found = sk.compare(*exchanged(tmp_path, 5, zeros={6: 8e-3}))
    assert found.changed == ("tool",)
    assert ("tool_x", "offset_6") in found.indistinguishable or ("tool_y", "offset_6") in found.indistinguishable
    assert "as well fits: offset_6" in found.headline


def test_what_looks_like_the_stand_is_said_before_any_praise(tmp_path: Path) -> None:
    """Catches "nothing needs to be done" where the zero of the first joint moved by 2 mrad: every run takes that for
    the instrument's stand, and programs in the frame of the base are off by millimetres."""
    robot, runs = exchanged(tmp_path, 6, zeros={1: 2e-3})
    found = sk.compare(robot, runs)
    assert found.verdict == "unchanged"
    assert "no run tells from where the instrument does (its base, offset_1" in found.advice


def test_a_check_names_another_tool(tmp_path: Path) -> None:
    """Catches a check that is "not valid" after a tool was exchanged, and names nothing."""
    robot, (first, later) = exchanged(tmp_path, 7, tool=LONGER)
    found = sk.verify(sk.calibrate(robot, first).calibration, later)
    assert found.verdict == "not valid"
    assert {one.name for one in found.parameters} == {"tool_x", "tool_y", "tool_z"}
