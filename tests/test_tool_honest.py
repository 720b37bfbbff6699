"""The tool's filter against a second simulator: deviations that are true, faults that are named, clocks that differ."""

from __future__ import annotations

import runpy
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from running import slow
from second_tool import CONDITIONS, FAULTS, World, honesty
from sherkit import _core
from sherkit.errors import MeasurementError, SherkitWarning
from sherkit.robots.tool.calibration import calibrate_tool
from sherkit.robots.tool.filters import estimate
from sherkit.robots.tool.tool import FlexibleTool, ToolDoubt, load_tool
from tool_honesty import honest, loads_of, measured, run_of, tool_of, warmed_of
from tool_table_one import EXAMPLE, recorded, table_one

#: Rows of the table of coverage whose truth the interval must cover in 93 to 97 of a hundred rows.
HONEST = ("matched", "pivot", "gains", "exact_rod", "exact_rod_pivot", "late_20", "late_100", "late_300", "slow", "eye")
DAMAGED = ("stuck_I", "dead_II", "swapped_I", "swapped_sections", "drifting", "jump", "spikes")


def test_a_loop_and_a_whole_run_agree_to_the_last_bit() -> None:
    """Catches a late, a lost or a damaged row that the two read differently."""
    world = replace(CONDITIONS["late_100"], faults=FAULTS["jump"].faults)
    recorded = world.run("phantom", seconds=25.0, seed=3)
    tool, run = tool_of(world, 3), run_of(recorded)
    waves = run.wavelengths_nm.copy()
    waves[700:720] = np.nan
    waves[900:950, 7] = np.nan
    there, stamps = np.isfinite(waves).any(axis=1), run.fibre_times_s
    whole = tool.tracker(0.0, run.poses[0]).run(run.time_s, run.poses, stamps, waves, there)
    single = tool.tracker(0.0, run.poses[0])
    for i in range(len(run)):
        reading = (stamps[i], waves[i]) if there[i] else ()
        assert single.step(run.time_s[i], run.poses[i], *reading) == whole["status"][i]
        if i % 50 == 0 or whole["faulty"][i]:
            np.testing.assert_array_equal([single.depth_mm, *single.tip_mm], whole["state"][i])
            np.testing.assert_array_equal(single.covariance, whole["covariance"][i])
            assert (single.misfit, single.faulty) == (whole["misfit"][i], whole["faulty"][i])
    assert (whole["status"] & _core.STATUS_MISSING).any()
    assert (whole["status"] & _core.STATUS_LATE).any()
    assert (whole["faulty"] == 1 << 5).any()


def test_intervals_cover_the_truth_as_often_as_they_say() -> None:
    """Catches a deviation that a turn about the hole, an exact rod, or late readings make untrue."""
    for name in ("exact_rod_pivot", "late_100"):
        told = measured(CONDITIONS[name], 3, seconds=40.0)
        for signal in ("depth", "tip"):
            # a calibration without an error: what fibres may lag and the tip may touch is doubted all the same
            assert told[signal].coverage > 0.88, (name, signal, told[signal])
            assert told[signal].nees > 0.2, (name, signal, told[signal])
        assert told["depth"].mean_error_mm < 0.12


def test_a_late_reading_says_what_may_have_happened_since() -> None:
    """Catches a force carried on by a pace in mN where it is the edge that strays, by a hole that is taken for stiffer
    than it is (by noise of the force), or from an edge that a small force does not place: 23 rows were off by more than
    5 deviations where readings are 0.3 s late. And a free shaft that is held to stray as if it leant."""
    world = CONDITIONS["late_300"]
    recorded = world.run("phantom", seed=0)
    tip = honest(estimate(tool_of(world, 0), run_of(recorded)), recorded)["tip"]
    assert tip.beyond_5 <= 3
    assert 0.93 <= tip.coverage <= 0.99, tip


def test_an_eye_that_moves_from_the_start_is_in_the_interval() -> None:
    """Catches a drift stated as the middle one of those that are still possible, where the variance of a mixture is the
    mean of the variances: 107 rows were off by more than 5 deviations before the pace of the eye was learnt."""
    recorded = CONDITIONS["eye"].run("phantom", seed=5, seconds=20.0)
    assert honest(estimate(tool_of(CONDITIONS["eye"], 5), run_of(recorded)), recorded)["depth"].beyond_5 == 0


@pytest.mark.parametrize(("since_s", "until_s"), [(0.0, 5.0), (10.0, 12.0), (10.0, 60.0)])
def test_where_no_fibre_is_read_the_tip_is_not_known(since_s: float, until_s: float) -> None:
    """Catches a force that nobody has read and is said to be none, and one that is held to stray no further after two
    seconds: half of the rows were off, by up to 180 deviations."""
    world = CONDITIONS["exact_rod_pivot"]
    for seed in range(3):
        recorded = world.run("phantom", seed=seed)
        run = run_of(recorded)
        lost = (run.time_s >= since_s) & (run.time_s < until_s)
        waves = np.where(lost[:, None], np.nan, run.wavelengths_nm)
        there = np.isfinite(waves).any(axis=1)
        tracker = tool_of(world, seed).tracker(0.0, run.poses[0])
        told = tracker.run(run.time_s, run.poses, run.fibre_times_s, waves, there)
        off = (told["state"][:, 1:] - recorded.tip_mm)[lost]
        assert honesty(off, told["covariance"][lost][:, 1:, 1:], np.zeros_like(off)).coverage > 0.95


@pytest.mark.parametrize("seed", [2, 6])
def test_references_that_creep_are_followed(seed: int) -> None:
    """Catches a grating that creeps by 1 pm a second while nothing touches and passes for a force in another hole: the
    mean error was 2.9 and 3.6 mm at a stated 0.5, and healthy gratings were named."""
    recorded = FAULTS["drifting"].run("phantom", seed=seed)
    e = estimate(tool_of(FAULTS["drifting"], seed), run_of(recorded))
    depth = honest(e, recorded)["depth"]
    assert depth.mean_error_mm < 0.15
    assert depth.beyond_5 == 0


def test_single_wild_readings_cost_nothing_that_lasts() -> None:
    """Catches a wild reading that stays in the mean of the last second, which is then doubted (depth off by 0.7 mm)."""
    world, seed = FAULTS["spikes"], 1
    recorded, sound = world.run("phantom", seed=seed), replace(world, faults=()).run("phantom", seed=seed)
    told, well = (honest(estimate(tool_of(world, seed), run_of(run)), run) for run in (recorded, sound))
    assert told["depth"].mean_error_mm < 2.0 * well["depth"].mean_error_mm


def test_what_warms_an_untouched_tool_is_learnt() -> None:
    """Catches answers to warmth of the wrong sign or fibre, deviations made up, and warmth learnt of nothing."""
    world, seed = CONDITIONS["warm"], 3
    tool, learnt = tool_of(world, seed), warmed_of(world, seed)
    answers = 0.02 * np.random.default_rng([seed, 8]).standard_normal((3, 3))[:2]
    answers = (1.0 + answers) / (1.0 + answers.mean(axis=1, keepdims=True)) - 1.0
    assert 0.0 < learnt.doubt.warmth < 0.002
    assert np.abs(np.array(learnt.warmth) - answers).max() < 4.0 * learnt.doubt.warmth
    recorded = world.run("phantom", seconds=40.0, seed=seed)
    before, after = (honest(estimate(one, run_of(recorded)), recorded)["depth"] for one in (tool, learnt))
    assert after.mean_error_mm < 1.05 * before.mean_error_mm
    assert after.largest < 5.0
    still = warmed_of(replace(world, temperature_c=0.0), seed)
    assert still.doubt.warmth == pytest.approx(tool.doubt.warmth, rel=0.2)


def test_table_one_is_met_with_the_exact_rod(capsys: pytest.CaptureFixture[str]) -> None:
    """Catches a filter that falls behind the paper's Table I in any row, on an exact rod that turns about its hole.

    The paper's total depth error of the phantom is 0.20 mm; its improvement over T0 95, 76 and 77 %. Two seeds.
    """
    told = table_one(2)
    paper = runpy.run_path(str(EXAMPLE))["PAPER"]
    for name, (_, sensor, of_sensor, of_filter) in paper.items():
        ours, raw = told[name]["noise by force"], told[name][sensor]
        assert all(mine <= theirs for mine, theirs in zip(ours, of_filter, strict=True)), name
        assert 1 - ours[1] / raw[1] > 1 - of_filter[1] / of_sensor[1], name
    assert told["phantom"]["noise by force"][0] <= 0.20
    assert "Table I" in capsys.readouterr().out


@pytest.mark.parametrize("seed", [3, 11])
def test_a_contact_far_from_where_it_was_thought_is_found(seed: int) -> None:
    """Catches a depth that jumps beyond the sections and stays there while the shaft is bent: a needle that presses
    elsewhere each time, 30 mm and more from where the motion of the robot had carried the contact."""
    tool, run = recorded("bends", seed)
    for start in (tool, replace(tool, start_depth_mm=55.0, start_std_mm=1.0)):
        e = estimate(start, run)
        off = np.linalg.norm(e.tip.value - run_truth(seed), axis=1)
        pressed = np.linalg.norm(e.force_mn, axis=1) > 20.0
        assert off[pressed].mean() < 0.05
        assert off.mean() < 0.05
        assert (np.abs(e.depth.value[pressed, 0] - e.fibre_depth_mm[pressed]) < 3.0).mean() > 0.97


@pytest.mark.parametrize(("grating", "shows"), [(0, 0.0), *slow((4, 0.0), (0, np.nan))])
def test_a_force_does_without_a_grating_that_is_dead(grating: int, shows: float) -> None:
    """Catches a force of the sclera by gratings of which one is dead, 200 mN off or 300 newtons, beside a depth and a
    tip that are right: what a surgeon is warned by."""
    tool, run = recorded("phantom", 3)
    waves, half = run.wavelengths_nm.copy(), len(run) // 2
    waves[half:, grating] = shows
    sound, e = estimate(tool, run), estimate(tool, replace(run, wavelengths_nm=waves))
    off = (e.force_mn - sound.force_mn)[half:]
    assert np.abs(off).max() < 2.0
    assert np.sqrt(np.mean(np.square(off / e.force_std_mn[half:, None]))) < 1.0
    assert np.abs(sound.force_mn).max() > 50.0


def test_a_loop_is_told_the_force_and_of_a_pose_that_is_none() -> None:
    """Catches a loop in Python that has depth and tip and no force, which C has, and a pose lost on its way, all ones,
    that moves the tool by metres with a status that praises it."""
    tool, run = recorded("phantom", 3)
    loop, last = tool.tracker(float(run.time_s[0]), run.poses[0]), 400
    for k in range(last):
        loop.step(float(run.time_s[k]), run.poses[k], float(run.fibre_times_s[k]), run.wavelengths_nm[k].copy())
    whole = estimate(tool, run)
    np.testing.assert_allclose(loop.force_mn, whole.force_mn[last - 1], rtol=1e-9)
    assert np.sqrt(loop.force_variance) == pytest.approx(whole.force_std_mn[last - 1])
    before = loop.tip_mm
    assert loop.step(float(run.time_s[last]), np.ones(12)) & _core.STATUS_NO_MOTION
    np.testing.assert_allclose(loop.tip_mm, before, atol=0.05)


def run_truth(seed: int) -> NDArray[np.float64]:
    """Where the tip of that run truly is (n, 3)."""
    return replace(CONDITIONS["exact_rod_pivot"], camera_warp_mm=0.25).run("bends", seed=seed).tip_mm


@pytest.mark.slow
@pytest.mark.parametrize("name", HONEST)
def test_every_row_of_the_table_is_covered(name: str) -> None:
    """Catches a condition in which the 95 % interval of depth or tip holds 93 % or fewer, or is far too wide: 24 runs.

    These worlds have no friction, no tissue that hardens, nothing at the tip and fibres that never lag; for all of it
    the filter allows: it is too careful here (twice the error), and is not where there are (`wide_honesty.py`).
    """
    told = measured(CONDITIONS[name], 24)
    assert told["depth"].coverage >= 0.93, told["depth"]
    assert told["depth"].nees > 0.18, told["depth"]
    # along the shaft the tip is known better than the micrometre that the judge allows: two of three freedoms are left
    assert 0.93 <= told["tip"].coverage <= 0.99, told["tip"]


@pytest.mark.parametrize("name", DAMAGED)
def test_the_estimate_goes_on_without_what_lies(name: str) -> None:
    """Catches a fault that reaches the depth, or that is held against the wrong gratings."""
    world = FAULTS[name]
    recorded = world.run("phantom", seconds=40.0, seed=2)
    e = estimate(tool_of(world, 2), run_of(recorded))
    told = honest(e, recorded)
    assert told["depth"].mean_error_mm < 0.32
    assert told["depth"].largest < 7.0
    assert told["tip"].mean_error_mm < 0.03
    expected = {"stuck_I": {"fbg1_nm"}, "dead_II": {"fbg4_nm"}, "swapped_I": {"fbg1_nm", "fbg2_nm"},
                "swapped_sections": {"fbg3_nm", "fbg4_nm"}, "jump": {"fbg6_nm"}}  # fmt: skip
    named = {fault.column: str(fault) for fault in e.faults}
    if name in expected:
        assert expected[name] == {f.column for f in e.faults if f.rows > 500 or len(e.faults) <= 2}, named
    says = {"stuck_I": "stuck", "dead_II": "shows nothing", "swapped_I": "shows the peak of", "jump": "does not agree"}
    if name in says:
        assert says[name] in " ".join(named.values())


def test_another_unit_is_said() -> None:
    """Catches wavelengths in pm or m that are taken for nm, or for nine dead gratings."""
    for name, unit in (("pm", "in pm"), ("m", "in m;")):
        run = run_of(FAULTS[name].run("phantom", seconds=5.0))
        with pytest.raises(MeasurementError, match=unit):
            estimate(tool_of(FAULTS[name]), run)


def test_a_witness_that_is_lost_costs_no_row() -> None:
    """Catches a reading thrown away for a grating of section III, which tells of a touch near the tip alone."""
    world = World()
    recorded = world.run("phantom", seconds=10.0)
    run = run_of(recorded)
    waves = run.wavelengths_nm.copy()
    waves[::2, 6] = np.nan
    a, b = (estimate(tool_of(world), r) for r in (run, replace(run, wavelengths_nm=waves)))
    off, without = (honest(e, recorded)["depth"] for e in (a, b))
    assert without.mean_error_mm < 1.2 * off.mean_error_mm + 0.02
    assert not b.gated.any()
    assert not (b.depth.status & _core.STATUS_NOT_FINITE).any()
    assert b.faulty_sections[::2, 2].all()


@pytest.mark.slow
@pytest.mark.parametrize("benches", [2, 12])
def test_a_calibration_says_what_it_does_not_know(tmp_path: Path, benches: int) -> None:
    """Catches a doubt that the file loses, deviations that are made up, and a stiffness that a noisy load cell bends.

    Benches of an exact rod; the load cell has 3 mN of noise, ten times what makes the cell's own fit too soft.
    """
    off = []
    for seed in range(benches):
        world = World(gain_error=0.05, reference_error_nm=0.01)
        found = calibrate_tool(tool_of(world, seed), loads_of(world, seed, force_std_mn=3.0))
        assert found.stiffness_mn_mm2
        off.append((found.stiffness_mn_mm2[0] - 1.13e6) / found.stiffness_mn_mm2[1])
        assert found.tool.doubt.reference_nm == pytest.approx(1e-3 / np.sqrt(20), rel=0.4)
    assert np.sqrt(np.mean(np.square(off))) < 1.7
    found.tool.save(tmp_path / "tool.toml")
    assert load_tool(tmp_path / "tool.toml") == found.tool
    assert found.tool.doubt != ToolDoubt()


@pytest.mark.slow
def test_a_bench_that_the_model_cannot_follow_is_said() -> None:
    """Catches a rod bent to 120 mN that gives wrong gains in silence, and a sentence where nothing is wrong."""
    world = World()
    loads = loads_of(world, 4, force_std_mn=0.3, largest_mn=120.0)
    with pytest.warns(SherkitWarning, match="do not follow the calibrated model"):
        said = calibrate_tool(replace(tool_of(world), bending="small"), loads)
    assert said.lack_of_fit
    with warnings.catch_warnings():
        warnings.simplefilter("error", SherkitWarning)
        assert not calibrate_tool(tool_of(world), loads).lack_of_fit


def test_a_tool_file_without_doubt_reads_as_before() -> None:
    """Catches a key that old files do not have and a new reader needs."""
    plain = FlexibleTool()
    assert plain.bending == "exact"
    assert plain.doubt == ToolDoubt()
