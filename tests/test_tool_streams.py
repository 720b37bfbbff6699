"""Streams of a tool's run that froze are said, and count for nothing; a robot that stands still has not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from second_tool import CONDITIONS, Recorded
from sherkit.errors import SherkitWarning
from sherkit.robots.tool.checks import exchanged
from sherkit.robots.tool.consistency import known
from sherkit.robots.tool.filters import estimate
from sherkit.robots.tool.model import ToolModel
from sherkit.robots.tool.runs import ToolRun
from sherkit.robots.tool.tool import FlexibleTool
from sherkit.robots.tool.trust import trust
from tool_honesty import honest, run_of, told, tool_of, without_fibres

WORLD = CONDITIONS["exact_rod_pivot"]
SINCE_S, UNTIL_S = 6.0, 11.0


@pytest.fixture(scope="module")
def sound() -> tuple[FlexibleTool, Recorded, ToolRun]:
    """A run of 15 s."""
    recorded = WORLD.run("vessels", seconds=15.0, seed=41)
    return tool_of(WORLD, 41), recorded, run_of(recorded)


def stands(run: ToolRun, *names: str, until_s: float = UNTIL_S) -> ToolRun:
    """The run with arrays that stand for some seconds."""
    here = np.flatnonzero((run.time_s >= SINCE_S) & (run.time_s < until_s))
    changed = {name: getattr(run, name).copy() for name in names}
    for values in changed.values():
        values[here] = values[here[0]]
    return replace(run, **changed)


@pytest.mark.parametrize("until_s", [UNTIL_S, 99.0])
def test_wavelengths_that_froze_count_as_lost(sound: tuple[FlexibleTool, Recorded, ToolRun], until_s: float) -> None:
    """Catches one reading that counts a thousand times: the depth was covered in 0.6 of the rows, and trusted."""
    tool, recorded, run = sound
    e = estimate(tool, stands(run, "wavelengths_nm", until_s=until_s))
    said = trust(e, known(e))
    assert said.verdict == "unknown"
    assert any(s.startswith("All wavelengths repeat themselves to the last digit from 6.00") for s in said.noticed)
    depth = honest(e, recorded)["depth"]
    assert depth.coverage > 0.95
    lost = honest(estimate(tool, without_fibres(run, e.run.lost_fibres)), recorded)["depth"]
    assert depth.mean_error_mm == lost.mean_error_mm


@pytest.mark.parametrize("names", [("position_mm", "turn_rad"), ("position_mm",)])
def test_a_pose_that_froze_is_not_trusted(
    sound: tuple[FlexibleTool, Recorded, ToolRun], names: tuple[str, ...]
) -> None:
    """Catches a source of poses that stopped and went on elsewhere: the tip was 2000 deviations off, and trusted."""
    tool, recorded, run = sound
    with pytest.warns(SherkitWarning, match="pose repeats itself to the last digit from 6"):
        model = ToolModel(tool, stands(run, *names))
    e = estimate(tool, model.run)
    said = trust(e, known(e))
    assert said.verdict != "trusted"
    assert any("pose repeats itself" in s for s in said.noticed)
    off = np.linalg.norm(e.tip.value - recorded.tip_mm, axis=1) / np.sqrt((e.tip.std**2).sum(axis=1))
    assert np.quantile(off, 0.95) < 2.0
    assert off.max() < 5.0
    moment = model.moments_s
    assert not ((moment > SINCE_S) & (moment < UNTIL_S - 0.1)).any()


def test_a_pose_that_froze_until_the_end_is_told_by_the_bends(sound: tuple[FlexibleTool, Recorded, ToolRun]) -> None:
    """Catches a recorder of poses that stopped for good, after which nothing jumps."""
    tool, _, run = sound
    said = told(tool, stands(run, "position_mm", "turn_rad", until_s=99.0))
    assert any("pose repeats itself" in s for s in said.noticed)


def test_a_robot_that_holds_still_has_not_frozen() -> None:
    """Catches a sentence on equal encoder counts of a tool that is held still, in air, and in an eye that moves."""
    free = run_of(WORLD.run("free", seconds=12.0, seed=3))
    # it slows down, stands for four seconds, and moves on
    pace = np.interp(free.time_s, [0.0, 3.7, 4.0, 8.0, 8.3, 12.0], [1.0, 1.0, 0.0, 0.0, 1.0, 1.0])
    along = np.concatenate([[0.0], np.cumsum(0.5 * (pace[1:] + pace[:-1]) * np.diff(free.time_s))])
    held = {
        name: np.stack([np.interp(along, free.time_s, v) for v in getattr(free, name).T], axis=1)
        for name in ("position_mm", "turn_rad")
    }
    assert (np.diff(held["position_mm"], axis=0) == 0).all(axis=1).sum() > 700
    assert replace(free, **held).froze == []
    eye = CONDITIONS["eye"].run("phantom", seconds=12.0, seed=3)
    assert replace(run_of(eye), **held).froze == []


def test_a_reading_that_is_given_several_times_has_not_frozen(sound: tuple[FlexibleTool, Recorded, ToolRun]) -> None:
    """Catches a slow interrogator, whose last reading stands in four rows, that is called frozen;
    and wavelengths that are written so coarsely that noise repeats them."""
    tool, recorded, run = sound
    held = replace(run, wavelengths_nm=run.wavelengths_nm[np.arange(len(run)) // 4 * 4])
    assert held.froze == []
    assert held.again.mean() == pytest.approx(0.75, abs=0.01)
    depth = honest(estimate(tool, held), recorded)["depth"]
    assert depth.coverage > 0.95
    coarse = replace(run, wavelengths_nm=np.round(run.wavelengths_nm, 1))
    assert not coarse.again.any()


@pytest.mark.parametrize(("order", "says"), [("xyz", "that stand still"), ("XYZ", "that turn with the tool")])
def test_roll_pitch_and_yaw_are_said(order: str, says: str) -> None:
    """Catches three angles where a rotation vector belongs: a tip 20 mm off, of a depth that is trusted."""
    world = replace(WORLD, pivot_rad=0.8)
    tool, run = tool_of(world, 1), run_of(world.run("vessels", seconds=15.0, seed=1))
    # near no turn at all both are alike: in a base that is turned they are not
    base = Rotation.from_rotvec([1.9, -1.2, 0.7])
    tool = replace(
        tool,
        camera_rotation_rad=tuple((base * Rotation.from_rotvec(tool.camera_rotation_rad)).as_rotvec()),
        camera_translation_mm=tuple(base.apply(tool.camera_translation_mm)),
    )
    turned = base * Rotation.from_rotvec(run.turn_rad)
    run = replace(run, position_mm=base.apply(run.position_mm), turn_rad=turned.as_rotvec())
    e = estimate(tool, run)
    assert exchanged(e, known(e)) == []
    said = told(tool, replace(run, turn_rad=turned.as_euler(order)))
    assert said.verdict != "trusted"
    assert any(f"roll, pitch and yaw about axes {says}" in s for s in said.noticed), said.noticed
