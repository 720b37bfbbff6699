"""What must never be called trusted: a run that contradicts itself, its camera or its tool file; and sound ones are."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from second_tool import CONDITIONS
from second_tool.wide import Wide
from sherkit.robots.tool.runs import ToolRun
from sherkit.robots.tool.tool import FlexibleTool
from sherkit.robots.tool.trust import Trust
from tool_honesty import run_of, told, tool_of, without_camera
from wide_honesty import tool_of as wide_tool_of

WORLD = replace(CONDITIONS["exact_rod_pivot"], pivot_rad=0.3)

Made = tuple[FlexibleTool, ToolRun]


@pytest.fixture(scope="module")
def sound() -> Made:
    """A run of 20 s that a camera saw, without a truth of its depth."""
    return tool_of(WORLD, 5), replace(run_of(WORLD.run("phantom", seconds=20.0, seed=5)), depth_mm=None)


def failed(said: Trust) -> set[str]:
    """The checks that did not hold."""
    return {one.what for one in said.checks if one.holds is False}


@pytest.mark.parametrize("seen", [True, False])
def test_a_sound_run_is_trusted(sound: Made, seen: bool) -> None:
    """Catches a check that blames what is in order."""
    tool, run = sound
    said = told(tool, run if seen else without_camera(run))
    assert (said.verdict, failed(said)) == ("trusted", set())
    assert ("% of the pictures" in said.sentence) == seen


def metres(run: ToolRun) -> ToolRun:
    """Its robot's places in metres."""
    return replace(run, position_mm=run.position_mm / 1000.0)


def still(run: ToolRun) -> ToolRun:
    """Its robot's places are those of the first row."""
    return replace(run, position_mm=np.ascontiguousarray(np.broadcast_to(run.position_mm[0], run.position_mm.shape)))


def held(run: ToolRun) -> ToolRun:
    """Its robot's poses are those of the first row."""
    return replace(still(run), turn_rad=np.ascontiguousarray(np.broadcast_to(run.turn_rad[0], run.turn_rad.shape)))


def other_way(run: ToolRun) -> ToolRun:
    """Its robot's z with the other sign."""
    return replace(run, position_mm=run.position_mm * np.array([1.0, 1.0, -1.0]))


def swapped(run: ToolRun) -> ToolRun:
    """Its robot's x and y exchanged."""
    return replace(run, position_mm=np.ascontiguousarray(run.position_mm[:, [1, 0, 2]]))


def inverse(run: ToolRun) -> ToolRun:
    """Its turns base to tool."""
    return replace(run, turn_rad=-run.turn_rad)


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        (swapped, "robot_x_mm and robot_y_mm are exchanged: with that undone the hole strays by"),
        (inverse, "are those of the inverse turn"),
        (metres, "are robot_x_mm, robot_y_mm, robot_z_mm in m?"),
        (still, "the same in all rows, to the last digit, while the tool turned"),
        (held, "either its source froze, or it held still"),
        (other_way, "it goes the other way"),
    ],
)
def test_places_that_the_gratings_contradict_are_never_trusted(
    sound: Made, wrong: Callable[[ToolRun], ToolRun], says: str
) -> None:
    """Catches a filter that takes the robot's mistake for an eye that strays: depths 2 to 5 mm off, and trusted."""
    tool, run = sound
    said = told(tool, wrong(without_camera(run)))
    assert said.verdict in ("unknown", "overconfident")
    assert says in said.noticed[0]
    assert said.to_do not in ("", "use the estimate with its deviation")


def test_forces_of_the_bench_with_the_other_sign_are_said(sound: Made) -> None:
    """Catches a tool that bends to the other side than its file says, by both signs of a bench: a tip 7 mm off."""
    tool, run = sound
    said = told(replace(tool, gains=(-np.array(tool.gains)).tolist()), without_camera(run))
    assert said.verdict != "trusted"
    assert "or both forces of the bench have the other sign" in said.noticed[0]


def test_a_camera_that_contradicts_is_never_trusted(sound: Made) -> None:
    """Catches a tip 10 mm from the camera's of an estimate that is trusted; a clock, a frame and turns by their own
    words."""
    tool, run = sound
    late = told(tool, replace(run, camera_time_s=run.camera_time_s + 3.0))
    assert late.verdict != "trusted"
    assert "with its clock 3 s later than delay_s" in late.noticed[0]
    elsewhere = replace(tool, camera_translation_mm=tuple(np.add(tool.camera_translation_mm, (0.0, 200.0, 0.0))))
    off = told(elsewhere, run)
    assert off.verdict != "trusted"
    assert "is the tool file that of this tool, and its [camera] that of this camera?" in off.noticed[0]


def test_small_turns_that_are_inverse_are_said() -> None:
    """Catches turns by the inverse that move the tip by no more than the camera scatters: 0.2 mm, and trusted."""
    world = replace(WORLD, pivot_rad=0.15)
    tool, run = tool_of(world, 7), run_of(world.run("phantom", seconds=30.0, seed=7))
    assert failed(told(tool, run)) == set()
    said = told(tool, replace(run, turn_rad=-run.turn_rad))
    assert said.verdict != "trusted"
    assert "inverse turn" in said.noticed[0]


@cache
def of_a_world() -> Made:
    """A tool of a wide world, and a run of it without camera and truth."""
    world = Wide(21)
    seen = run_of(world.run("phantom", seconds=30.0))
    return wide_tool_of(world), replace(without_camera(seen), depth_mm=None)


def test_another_tools_file_is_never_trusted() -> None:
    """Catches sections that are left out all the run, or depths that go otherwise than the robot, and a depth 15 mm off
    that is trusted."""
    tool, run = of_a_world()
    assert failed(told(tool, run)) == set()
    off = np.repeat([0.0, 0.0, 1.0], 3) * np.tile([0.5, -0.3, 0.1], 3)
    said = told(replace(tool, reference_nm=tuple((np.array(tool.reference_nm) + off).tolist())), run)
    assert said.verdict != "trusted"
    # of section I and II one may be taken for what section III is off by
    assert "fbg8_nm, fbg9_nm are left out in" in said.noticed[0]


@pytest.mark.slow
def test_the_file_of_a_tool_that_was_drawn_alike_is_never_trusted() -> None:
    """Catches the same of a file whose references and fibres are those of another tool of the drawing."""
    tool, run = of_a_world()
    reference, rng = np.array(tool.reference_nm), np.random.default_rng(3)
    # drawn alike: references and fibres are where others were glued
    for crept in (rng.normal(0.0, 0.2, 9), rng.normal(0.0, 0.2, 9)):
        alike = replace(wide_tool_of(Wide(22)), reference_nm=tuple((reference + crept).tolist()))
        said = told(alike, run)
        assert said.verdict in ("unknown", "overconfident")
        assert failed(said)
