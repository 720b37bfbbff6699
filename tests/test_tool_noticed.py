"""What a calibration and an estimate notice: single wrong loads, columns that are exchanged, and whether to trust."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from running import slow
from second_tool import CONDITIONS
from second_tool.wide import Wide
from second_tool.wide_families import FAMILIES
from sherkit.errors import SherkitWarning
from sherkit.robots.tool.calibration import ToolCalibration, calibrate_tool
from sherkit.robots.tool.checks import exchanged
from sherkit.robots.tool.consistency import known
from sherkit.robots.tool.filters import Estimate, estimate
from sherkit.robots.tool.runs import ToolRun
from sherkit.robots.tool.trust import trust
from tool_honesty import loads_from, run_of, told, tool_from, tool_of, without_camera
from wide_honesty import tool_of as wide_tool_of

Table = dict[str, np.ndarray]


def calibrated(change: Callable[[Table], None], seed: int = 101) -> tuple[ToolCalibration, float]:
    """Of a bench with a mistake, and its stiffness over the true one."""
    world = Wide(seed)
    bench = {k: v.copy() for k, v in world.bench().items()}
    change(bench)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SherkitWarning)
        made = calibrate_tool(tool_from(world.drawing()), loads_from(bench))
    return made, made.tool.stiffness_mn_mm2 / world.drawn.rod.stiffness_mn_mm2


def _exchange(a: str, b: str) -> Callable[[Table], None]:
    def change(table: Table) -> None:
        table[a], table[b] = table[b], table[a]

    return change


def _scale(names: tuple[str, ...], factor: float) -> Callable[[Table], None]:
    def change(table: Table) -> None:
        for name in names:
            table[name] *= factor

    return change


@pytest.mark.slow
@pytest.mark.parametrize("seed", [100, 101, 102, 103])
def test_a_sound_bench_is_not_blamed(seed: int) -> None:
    """Catches a sentence on a bench that has nothing wrong."""
    made, _ = calibrated(lambda table: None, seed)
    assert made.lack_of_fit == ()


@pytest.mark.slow
def test_one_wrong_load_of_eighty_is_left_out() -> None:
    """Catches a load ten times too large that moves the stiffness (by 18 % without a word), or a wrong row's number."""
    row = 0

    def change(table: Table) -> None:
        nonlocal row
        row = int(np.flatnonzero(table["force_x_mn"])[7])
        for name in ("force_x_mn", "force_y_mn"):
            table[name][row] *= 10.0

    made, stiffness = calibrated(change)
    assert len(made.lack_of_fit) == 1
    assert made.lack_of_fit[0].startswith(f"row {row + 1}: its force of")
    assert stiffness == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (_exchange("force_x_mn", "force_y_mn"), "force_x_mn and force_y_mn are exchanged"),
        pytest.param(_scale(("force_y_mn",), -1.0), "force_y_mn has the other sign", marks=pytest.mark.slow),
        pytest.param(
            _scale(("force_x_mn", "force_y_mn"), 1.0 / 9.80665), "are forces in gram-force?", marks=pytest.mark.slow
        ),
        pytest.param(
            _exchange("fbg1_nm", "fbg2_nm"), "are exchanged, fbg1_nm and fbg2_nm as it seems", marks=pytest.mark.slow
        ),
        pytest.param(
            _exchange("fbg3_nm", "fbg4_nm"),
            "fbg3_nm and fbg4_nm are exchanged: loads are off by",
            marks=pytest.mark.slow,
        ),
    ],
)
def test_columns_are_held_against_the_drawing(change: Callable[[Table], None], says: str) -> None:
    """Catches axes, units or gratings that are taken as they come, without a word."""
    made, _ = calibrated(change)
    assert any(says in sentence for sentence in made.lack_of_fit), made.lack_of_fit


def test_exchanged_columns_of_a_run_are_said() -> None:
    """Catches x and y of the robot exchanged, and turns that are their inverse: a tip 7 mm off without a word."""
    world = replace(CONDITIONS["exact_rod_pivot"], pivot_rad=0.8)
    recorded = world.run("vessels", seconds=15.0, seed=1)
    tool, run = tool_of(world, 1), run_of(recorded)

    def said(run: ToolRun) -> list[str]:
        e = estimate(tool, run)
        return exchanged(e, known(e))

    assert said(run) == []
    swapped = replace(run, position_mm=np.ascontiguousarray(run.position_mm[:, [1, 0, 2]]))
    assert "robot_x_mm and robot_y_mm are exchanged" in said(swapped)[0]
    inverse = said(replace(run, turn_rad=-run.turn_rad))
    assert len(inverse) == 1
    assert "inverse turn" in inverse[0]


@pytest.mark.parametrize(
    ("mistake", "says"), [("flange", "those of the flange"), *slow(("quarter", "to the other side"), ("none", ""))]
)
def test_the_hole_tells_how_a_tool_is_held(mistake: str, says: str) -> None:
    """Catches places of the flange, 60 mm from the tip, and a tool that is clocked by a quarter turn against its bench:
    without a camera each was "trusted", though the hole swung by millimetres in a second."""
    world = replace(CONDITIONS["exact_rod_pivot"], pivot_rad=0.8)
    tool = tool_of(world, 1)
    run = replace(without_camera(run_of(world.run("vessels", seconds=15.0, seed=1))), depth_mm=None)
    if mistake == "flange":
        run = replace(run, position_mm=run.position_mm - tool.length_mm * run.rotations[:, :, 2])
    elif mistake == "quarter":
        turned = Rotation.from_rotvec(run.turn_rad) * Rotation.from_rotvec([0.0, 0.0, 0.5 * np.pi])
        run = replace(run, turn_rad=turned.as_rotvec())
    said = told(tool, run)
    assert (said.verdict in ("trusted", "too careful")) != bool(says)
    assert says in " ".join(sentence for check in said.checks for sentence in check.sentences)


def test_the_depth_is_called_once() -> None:
    """Catches a verdict that contradicts the truth beside it, or one without what to do."""
    world = CONDITIONS["exact_rod_pivot"]
    recorded = world.run("phantom", seconds=20.0, seed=1)
    tool, run = tool_of(world, 1), run_of(recorded)
    said = told(tool, run)
    assert said.verdict in ("trusted", "too careful")
    assert said.answer.to_do[0].sentence == said.to_do
    sure = replace(tool, gains=(np.array(tool.gains) * [[[1.02]], [[1.0]]]).tolist())
    assert told(sure, run).verdict == "overconfident"
    assert "no depth_mm is in this run" in told(tool, replace(run, depth_mm=None)).sentence


@pytest.mark.parametrize("is_late", [True, pytest.param(False, marks=pytest.mark.slow)])
@pytest.mark.parametrize("seed", [60, pytest.param(61, marks=pytest.mark.slow)])
def test_a_robot_that_is_late_is_said_and_led_on(seed: int, is_late: bool) -> None:
    """Catches a lateness of the wrong sign or size, one of a robot that is not late, and a tip that stays behind."""
    world = FAMILIES["robot late"](seed)
    late = float(world._rng("late").uniform(0.02, 0.08)) if is_late else 0.0
    w = world if is_late else Wide(seed)
    truth = w.run("vessels", seconds=60.0)
    # its camera was not registered
    e = estimate(wide_tool_of(w), without_camera(run_of(truth)))
    assert 0.3 * late - 0.004 < e.late_s[-1] < 1.4 * late + 0.004, (seed, late)
    said = [s for s in trust(e, known(e)).noticed if "later than the gratings" in s]
    assert bool(said) == is_late
    if is_late:
        off = [np.linalg.norm(x[6000:] - truth.tip_mm[6000:], axis=1).mean() for x in
               (e.tip.value, e.tip.value - led_on(e))]  # fmt: skip
        assert off[0] < 0.85 * off[1]


def led_on(e: Estimate) -> np.ndarray:
    """How far the tip was led on, by a speed over 30 ms."""
    speed = np.zeros((len(e.run), 3))
    step = np.diff(e.run.position_mm, axis=0) / np.diff(e.run.time_s)[:, None]
    for i in range(1, len(speed)):
        speed[i] = speed[i - 1] + (step[i - 1] - speed[i - 1]) * (0.005 / 0.035)
    return np.asarray(speed * e.late_s.clip(0.0)[:, None])


@pytest.mark.slow
def test_a_bend_that_comes_at_once_is_no_exchange_of_peaks() -> None:
    """Catches two peaks that pass each other in a bend of one row, taken for exchanged: the depth was off by 8 mm."""
    world = FAMILIES["softer outwards"](901)
    truth = world.run("vessels", seconds=60.0)
    e = estimate(wide_tool_of(world), run_of(truth))
    assert not e.faulty.any()
