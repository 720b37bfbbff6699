"""Readings of one grating that leap off for once are left out and counted; one that jumps for good is named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from second_tool.wide_families import FAMILIES
from sherkit.base.types import Floats
from sherkit.robots.tool.filters import estimate
from sherkit.robots.tool.runs import ToolRun
from sherkit.robots.tool.tool import FIBRES, FlexibleTool
from sherkit.robots.tool.trust import Trust
from sherkit.robots.tool.virtual import VirtualTool
from tool_families import EXPERIMENTS
from tool_honesty import run_of, told, without_camera

TOOL = FlexibleTool()


@pytest.fixture(scope="module")
def sound() -> ToolRun:
    """A run of 15 s in which the tool bends."""
    return replace(VirtualTool(TOOL).run("vessels", seconds=15.0, seed=3), depth_mm=None)


def read(run: ToolRun, wavelengths_nm: Floats) -> ToolRun:
    """The run with other readings."""
    return replace(run, wavelengths_nm=wavelengths_nm)


def said(run: ToolRun) -> Trust:
    """What is said of it, without its camera."""
    return told(TOOL, without_camera(run))


def test_sound_gratings_neither_leap_nor_jump(sound: ToolRun) -> None:
    """Catches a bend taken for a leap, and a scatter that is that of the motion."""
    assert (sound.leaps.single.sum(), sound.leaps.jumps) == (0, ())
    assert sound.leaps.scatter_nm == pytest.approx(TOOL.noise_nm, rel=0.1)


@pytest.mark.parametrize("grating", range(9))
def test_a_grating_that_jumps_for_good_is_named(sound: ToolRun, grating: int) -> None:
    """Catches a fibre that slips by 50 pm in silence, a sound one accused for it, and its jump counted as a leap."""
    waves = sound.wavelengths_nm.copy()
    waves[1500:, grating] += 0.05
    leaps = read(sound, waves).leaps
    (jump,) = leaps.jumps
    assert (jump.column, leaps.single.sum()) == (FIBRES[grating], 0)
    assert jump.at_s == pytest.approx(sound.time_s[1500], abs=0.011)
    assert jump.by_nm == pytest.approx(0.05, abs=0.01)


def test_a_jump_comes_before_what_follows_from_it(sound: ToolRun) -> None:
    """Catches a run with a jump that is trusted, or blamed on its tool file."""
    waves = sound.wavelengths_nm.copy()
    waves[1500:, 5] -= 0.05
    after = said(read(sound, waves))
    assert after.verdict in ("unknown", "overconfident")
    assert after.noticed[0].startswith("fbg6_nm jumps by -4")
    assert "tool file" not in " ".join(after.noticed)


def test_what_comes_back_is_no_jump_for_good(sound: ToolRun) -> None:
    """Catches a burst of wrong readings, and a dead grating, that are told as a fibre that slipped."""
    waves = sound.wavelengths_nm.copy()
    waves[1500:1512, 4] += 0.3
    assert read(sound, waves).leaps.jumps == ()
    waves = sound.wavelengths_nm.copy()
    waves[1500:, 4] = 0.0
    leaps = read(sound, waves).leaps
    assert (leaps.single.sum(), leaps.jumps) == (0, ())


def test_readings_that_leap_are_left_out_and_counted(sound: ToolRun) -> None:
    """Catches one wrong reading in twenty rows: the tip leapt by 2 mm, and the tool file was accused."""
    g = np.random.default_rng(1)
    hit = g.random(sound.wavelengths_nm.shape) < 0.05 / 9
    run = read(sound, sound.wavelengths_nm + 0.5 * hit * g.choice([-1.0, 1.0], size=hit.shape))
    single = run.leaps.single
    assert (single & ~hit).sum() == 0
    assert (single & hit).sum() > 0.95 * hit.sum()
    after, before = said(run), said(sound)
    assert after.verdict == before.verdict == "trusted"
    assert after.noticed[0].startswith(f"{single.sum()} single readings leap off")
    tip, usual = (estimate(TOOL, one).tip.value for one in (run, sound))
    assert np.abs(tip - usual).max() < 0.2


def test_an_interrogator_that_is_noisier_than_its_file_is_said(sound: ToolRun) -> None:
    """Catches a filter that is overconfident for a key of its file, and sends the tool back to its bench."""
    noise = np.random.default_rng(2).normal(size=sound.wavelengths_nm.shape)
    noisy = said(read(sound, sound.wavelengths_nm + 0.004 * noise)).noticed
    assert any("scatter by 0.0041 nm" in one and "noise_nm of [gratings] is 0.001" in one for one in noisy)
    assert not any("noise_nm" in one for one in said(sound).noticed)


def test_a_run_without_a_force_says_so() -> None:
    """Catches "nan of what is stated" and fibres that lag behind bends that were none."""
    free = said(VirtualTool(TOOL).free_motion(seconds=4.0))
    assert free.sentence.startswith("no force was felt")
    assert not any("lag behind" in one for one in free.noticed)


@pytest.mark.slow
@pytest.mark.parametrize("name", FAMILIES)
def test_no_sound_grating_of_any_family_is_accused(name: str) -> None:
    """Catches glue with play, warmth or a hard touch that pass for a jump, and a jump that is missed among them; seeds
    0, 1."""
    for seed in range(2):
        for experiment in EXPERIMENTS:
            run = run_of(FAMILIES[name](seed).run(experiment, seconds=20.0))
            assert (run.leaps.single.sum(), run.leaps.jumps) == (0, ())
            g = np.random.default_rng(seed + len(name))
            k, at = int(g.integers(9)), int(g.integers(1000, len(run) - 1000))
            waves = run.wavelengths_nm.copy()
            waves[at:, k] += 0.05 * g.choice([-1, 1])
            assert [one.column for one in read(run, waves).leaps.jumps] == [FIBRES[k]]
