"""What the flexible tool's model is missing: planted in the virtual tool, found by name, written into its file."""

from __future__ import annotations

import warnings
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import sherkit as sk
from consistency import named
from running import slow
from second_tool import CONDITIONS
from sherkit.diagnosis.result import StepReport
from sherkit.errors import MeasurementError, SherkitWarning
from sherkit.robots.tool import places as tip_places
from sherkit.robots.tool.effects import TOOL_CATALOGUE
from sherkit.robots.tool.filters import estimate
from sherkit.robots.tool.model import ToolModel, applied, mended
from sherkit.robots.tool.places import TipPlaces
from sherkit.robots.tool.tare import tare
from sherkit.robots.tool.tool import FlexibleTool
from sherkit.robots.tool.virtual import VirtualTool
from test_tool import KNOWING, TOOL
from tool_honesty import fitted, honest, run_of, tool_of, without_camera

SECONDS = 40.0
#: Of the camera, per axis.
NOISE_MM = 0.2 / np.sqrt(3.0)
_PATTERNS = np.array([[1.0, -1.0, 0.0], [0.5, 0.5, -1.0]])


def planted(name: str | None, seed: int, factor: float = 1.0) -> VirtualTool:
    """A virtual tool with one effect of ``factor`` times about its plausible size, in the world and not in its file."""
    rng = np.random.default_rng([seed, 7])
    size = factor * rng.choice([-1, 1]) * rng.uniform(0.7, 1.5)
    v = VirtualTool(FlexibleTool(), camera_warp_mm=0.0)
    if name == "tool_stiffness":
        return v.changed(stiffness_mn_mm2=v.tool.stiffness_mn_mm2 * (1 + 0.06 * size))
    if name == "tool_length":
        return v.changed(length_mm=60 + 1.5 * size)
    if name == "fbg_gain":
        return v.changed(gains=(np.array(v.tool.gains) * (1 + 0.04 * factor * rng.normal(size=(2, 1, 1)))).tolist())
    if name == "fbg_bias":
        return replace(v, bias_nm=tuple((0.01 * factor * rng.normal(size=(2, 2)) @ _PATTERNS).ravel()))
    if name == "fbg_temperature":
        leak = tuple((0.1 * factor * rng.normal(size=(2, 2)) @ _PATTERNS).ravel())
        return replace(v, temperature_c=10.0, leak=leak)
    if name == "force_hysteresis":
        return replace(v, hysteresis_mn=6 * abs(size))
    if name == "shaft_bend":
        return replace(v, shaft_bend_mm=tuple(0.3 * factor * rng.normal(size=2)))
    if name == "registration":
        return v.changed(camera_rotation_rad=tuple(0.02 * factor * rng.normal(size=3)))
    if name == "camera_delay":
        return v.changed(camera_delay_s=0.02 * size)
    if name == "fibre_delay":
        return v.changed(fibre_delay_s=0.02 * abs(size))
    assert name is None
    return v


def visible(name: str, seed: int, factor: float) -> float:
    """What the effect leaves of the tip's places beside the camera's offset, without noise: RMS per axis, in noise."""
    virtual = replace(planted(name, seed, factor), camera_mm=0.0, noise_nm=1e-6)
    model = ToolModel(FlexibleTool(), virtual.run("vessels", seconds=SECONDS, seed=seed))
    fit = fitted(model)
    return float(np.sqrt(np.mean(fit.residuals**2)) / NOISE_MM)


def diagnosed(name: str | None, seed: int, ratio: float = 1.0) -> sk.diagnosis.Diagnosis:
    """As a user does, with an effect whose visible part is about ``ratio`` times the camera's noise."""
    # nearly in proportion: two steps are enough
    factor = 1.0
    if name is not None:
        for _ in range(2):
            factor *= ratio / visible(name, seed, factor)
    run = planted(name, seed, factor).run("vessels", seconds=SECONDS, seed=seed)
    model = ToolModel(FlexibleTool(), run)
    return sk.diagnose(fitted(model))


@pytest.mark.parametrize("name", ["registration", *slow("tool_stiffness", "shaft_bend", "camera_delay")])
def test_effects_are_found_by_name(name: str) -> None:
    """Catches an effect that is computed with the wrong sign or not at all; visible part 1 × the noise, seed 1."""
    d = diagnosed(name, 1)
    assert name in named(d)
    assert d.steps[-1].error.rms / np.sqrt(d.error.axes) == pytest.approx(NOISE_MM, rel=0.06)


def test_a_force_that_lags_is_explained() -> None:
    """Catches a lag of which half is left: where the felt force stands still the true one goes on; seed 3."""
    d = diagnosed("force_hysteresis", 3)
    assert (d.verdict, d.effects) == ("explained", ("force_hysteresis",))


def test_the_holes_width_is_found() -> None:
    """Catches a hole whose width is that of its way to give, and one found where a needle bends a stopped tool."""
    for experiment, found in (("vessels", True), ("bends", False)):
        run = VirtualTool(FlexibleTool()).run(experiment, seconds=20.0, seed=1)
        hole = TipPlaces(FlexibleTool(), run, run.time_s[:1]).hole
        assert (hole is not None) == found
        if hole is not None:
            assert hole.clearance_mm == pytest.approx(2.2, abs=0.08)
            assert hole.gives_mm_mn == pytest.approx(1.0 / 150.0, abs=2e-3)


def test_a_short_run_without_a_force_is_soon_answered(monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches fits that smooth the whole run at each of their steps: a free motion of 2 s took minutes."""
    counted: list[int] = []
    calmed = tip_places.calmed

    def counting(time_s: NDArray[np.float64]) -> Any:
        counted.append(len(time_s))
        return calmed(time_s)

    monkeypatch.setattr(tip_places, "calmed", counting)
    run = VirtualTool(FlexibleTool()).free_motion(seconds=2.0, seed=1)
    model = ToolModel(FlexibleTool(), run)
    assert sk.diagnose(fitted(model)).verdict in ("adequate", "unexplained", "partly explained")
    assert len(counted) < 10


@pytest.mark.parametrize("seed", [2, *slow(3)])
def test_nothing_is_found_where_nothing_is(seed: int) -> None:
    """Catches an alarm without cause; level 1 % (of the seeds 0 to 23 seed 1 alone has p < 1 %)."""
    d = diagnosed(None, seed)
    assert (d.verdict, d.effects) == ("adequate", ())


@pytest.mark.parametrize("shows", [np.nan, *slow(0.0, 1531.03)])
def test_seconds_of_a_dead_grating_are_not_looked_at(shows: float) -> None:
    """Catches a fibre that is dead from the middle on, as physics that is missing: "12 mm are left, columns are not as
    they should be", where the filter names it and does without."""
    run = planted(None, 3).run("vessels", seconds=20.0, seed=3)
    waves = run.wavelengths_nm.copy()
    waves[len(waves) // 2 :, 0] = shows
    with pytest.warns(SherkitWarning, match=r"always the same: fbg1_nm in (49|50)% of the rows"):
        model = ToolModel(FlexibleTool(), replace(run, wavelengths_nm=waves))
    d = sk.diagnose(fitted(model))
    assert (d.verdict, d.effects) == ("adequate", ())


def test_wrong_pictures_are_listed() -> None:
    """Catches a diagnosis that a marker taken for another ends in a traceback, or that takes it for physics."""
    run = planted(None, 3).run("vessels", seconds=20.0, seed=3)
    wild = run.camera_mm.copy()
    wild[[50, 120, 200]] += [[3.0, 0.0, 0.0], [0.0, -5.0, 0.0], [1.0, 2.0, 20.0]]
    model = ToolModel(FlexibleTool(), replace(run, camera_mm=wild))
    d = sk.diagnose(fitted(model))
    first = int(np.argmax(model.pictures))
    assert d.outliers.tolist() == [50 - first, 120 - first, 200 - first]
    assert (d.verdict, d.effects) == ("adequate", ())
    assert len(d.to_json()["outliers"]) == 3


@pytest.mark.parametrize("name", [*slow("fbg_bias"), "fbg_temperature"])
def test_a_crept_grating_is_fitted(name: str) -> None:
    """Catches places of the tip that jump as a force falls under a threshold: no fit of them converges; 50 pm."""
    there = planted(name, 0, 5.0)
    model = ToolModel(there.tool, there.run("vessels", seconds=20.0, seed=0))
    fit = fitted(model, name)
    assert fit.converged
    assert np.sqrt(np.mean(fit.residuals**2)) == pytest.approx(NOISE_MM, rel=0.06)


def test_the_depth_of_a_run_is_as_good_as_the_filters() -> None:
    """Catches a depth without threshold that strays: against the truth, beside the filter's; seeds 0, 1."""
    for seed in range(2):
        run = VirtualTool(KNOWING).run("phantom", seconds=30.0, seed=seed)
        assert run.depth_mm is not None
        depth = TipPlaces(KNOWING, run, run.time_s[:1]).felt.depth_mm
        e = estimate(KNOWING, run)
        filtered = e.depth.value[:, 0]
        # what the bend takes between the length of shaft and the paper's depth
        depth = depth + e.together.value[:, 0] - e.arc_mm
        off, other = (float(np.sqrt(np.mean((d - run.depth_mm) ** 2))) for d in (depth, filtered))
        assert off < 1.35 * other + 0.01


def test_values_are_those_that_were_planted() -> None:
    """Catches an effect that is found with a wrong size: stiffness and delay, seed 2."""
    for name, parameter in (("tool_stiffness", "relative"), ("camera_delay", "delay")):
        there = planted(name, 2)
        truth = {
            "tool_stiffness": there.true.stiffness_mn_mm2 / there.tool.stiffness_mn_mm2 - 1,
            "camera_delay": there.true.camera_delay_s,
        }[name]
        model = ToolModel(there.tool, there.run("vessels", seconds=40.0, seed=2))
        fit = fitted(model, name)
        found = fit.by_name[f"{name}.{parameter}"]
        assert abs(found - truth) < max(5 * fit.std_from_readings[-1], 0.02 * abs(truth))


def test_a_run_without_pictures_is_refused() -> None:
    """Catches a diagnosis of nothing."""
    with pytest.raises(MeasurementError, match="holds no place of the camera"):
        ToolModel(TOOL, without_camera(VirtualTool(TOOL).run("vessels", seconds=3.0)))


@pytest.mark.parametrize(("name", "seed"), [("shaft_bend", 2), *slow(("camera_delay", 2))])
def test_what_takes_most_of_a_run_is_no_mistake_of_the_set_up(name: str, seed: int) -> None:
    """Catches a large effect that is taken for a wrong set-up where the tip hardly moves, or whose fit ends on the way
    and takes a minute: five times the noise."""
    d = diagnosed(name, seed, 5.0)
    assert d.verdict == "explained"
    assert name in named(d)


@pytest.mark.slow
def test_the_right_effect_is_named_in_98_of_100() -> None:
    """Catches any effect that shows on some draws only: ratios 1, 2, 5, 4 seeds each of 10 effects, 98 % lead or tie.

    More than 8 of 120 missed would come by chance once in 1,000 at 2 %; and no effect more than 3 of its 12.
    """
    missed = [
        (name, seed)
        for name in TOOL_CATALOGUE
        for seed in range(12)
        if name not in named(diagnosed(name, seed, (1.0, 2.0, 5.0)[seed % 3]))
    ]
    assert len(missed) <= 8, missed
    assert max(sum(m[0] == name for m in missed) for name in TOOL_CATALOGUE) <= 3, missed


@pytest.mark.slow
def test_a_verdict_hangs_on_no_seed() -> None:
    """Catches verdicts that hang on how rows are dealt to folds: each effect at twice the noise and none, 10 seeds of
    the diagnosis; verdict and names are the same in 97 %."""
    same = []
    for name in (*TOOL_CATALOGUE, None):
        factor = 1.0
        for _ in range(2 if name else 0):
            assert name is not None
            factor *= 2.0 / visible(name, 4, factor)
        run = planted(name, 4, factor).run("vessels", seconds=SECONDS, seed=4)
        model = ToolModel(FlexibleTool(), run)
        fit = fitted(model)
        told = [(d.verdict, d.effects) for d in (sk.diagnose(fit, seed=k) for k in range(10))]
        same += [one == max(told, key=told.count) for one in told]
    assert np.mean(same) >= 0.97


@pytest.mark.parametrize(
    "name",
    ["tool_stiffness", "fbg_gain", *slow("fbg_bias", "fbg_temperature"), "registration", "camera_delay",
     *slow("fibre_delay"), "shaft_bend"],
)  # fmt: skip
def test_what_was_named_is_written(name: str) -> None:
    """Catches a value that is written with the wrong sign or about another point: the next run leaves no more."""
    there = planted(name, 2)
    model = ToolModel(there.tool, there.run("vessels", seconds=12.0, seed=2))
    fit = fitted(model, name)
    told = applied(model, fit)
    left = fitted(ToolModel(told.tool, model.run))
    if name == "shaft_bend":
        assert (told.written, told.kept_out) == ((), ("shaft_bend",))
        return
    assert told.written == (name,)
    assert np.mean(left.residuals**2) == pytest.approx(np.mean(fit.residuals**2), rel=0.02)
    assert np.abs(left.values).max() < 0.03


def test_what_a_tie_leaves_open_is_doubted() -> None:
    """Catches a tip that was ground, which is written as a softer shaft that nobody doubts: the depth of the next run
    stayed 1 mm off at 0.2, and trusted; and "add it" beside the command that has added it."""
    there = VirtualTool(FlexibleTool(), camera_warp_mm=0.0).changed(length_mm=61.0, distances_mm=(41.0, 51.0))
    model = ToolModel(KNOWING, there.run("vessels", seconds=SECONDS, seed=1))
    d = sk.diagnose(fitted(model))
    assert any({"tool_length", "tool_stiffness"} <= {*tie} for tie in d.indistinguishable)
    told = mended(model, d).tool
    assert told.doubt.deeper_mm == pytest.approx(1.0, abs=0.3)
    e = estimate(told, there.run("vessels", seconds=SECONDS, seed=2))
    assert e.run.depth_mm is not None
    off = np.abs(e.depth.value[:, 0] - e.run.depth_mm)[1000:]
    assert np.mean(off < 1.96 * e.depth_std_mm[1000:]) > 0.95


@pytest.mark.slow
def test_what_is_written_need_not_be_added() -> None:
    """Catches the command that was just run as the next, and fibres of a needle that are called limbs."""
    model = ToolModel(FlexibleTool(), planted("fbg_bias", 2, 2.0).run("vessels", seconds=SECONDS, seed=2))
    d = sk.diagnose(fitted(model))
    assert d.effects == ("fbg_bias",)
    assert "-o with_it.toml" in d.finding("next").command
    assert d.added("sherkit estimate made.toml RUN").answer.to_do[-1].command == "sherkit estimate made.toml RUN"
    assert "limb" not in str(d)
    assert "limb" not in " ".join(str(one) for one in d.findings)
    assert mended(model, d).why[-1].startswith("reference_nm moved, but for what a section has in common: fbg1_nm ")


def test_what_gains_nothing_held_out_is_not_written() -> None:
    """Catches gains that a long run names for 0.058 instead of 0.057 mm: written, they put the depth 2.4 mm off."""
    there = planted("camera_delay", 2)
    model = ToolModel(there.tool, there.run("vessels", seconds=12.0, seed=2))
    fit = fitted(model, "camera_delay", "fbg_gain")
    found = sk.diagnose(fitted(model), seed=0)
    before, last = found.steps[0].error, found.error
    for share, written in ((0.99, ("camera_delay",)), (0.9, ("camera_delay", "fbg_gain"))):
        steps = (
            StepReport(None, before),
            StepReport("camera_delay", last),
            StepReport("fbg_gain", replace(last, rms=share * last.rms)),
        )
        asked: Any = SimpleNamespace(fit=fit, steps=steps, indistinguishable=(), candidates=())
        told = mended(model, asked)
        assert set(told.written) == set(written)
        assert (told.tool.gains == there.tool.gains) == ("fbg_gain" not in written)
        assert any(s.startswith("fbg_gain is not written") for s in told.why) == ("fbg_gain" not in written)
        assert told.tool.camera_delay_s != there.tool.camera_delay_s


@pytest.mark.parametrize("ms", [50, 100, 200])
def test_a_late_interrogator_that_does_not_say_so_is_found(ms: int) -> None:
    """Catches a delay with the wrong sign, or one that is named and not used: depth on the second simulator, seed 1."""
    world = CONDITIONS[f"unsaid_{ms}"]
    recorded = world.run("vessels", seconds=30.0, seed=1)
    tool, run = tool_of(world, 1), run_of(recorded)
    model = ToolModel(tool, run)
    fit = fitted(model, "fibre_delay")
    told = applied(model, fit)
    assert told.written == ("fibre_delay",)
    assert told.tool.fibre_delay_s == pytest.approx(1e-3 * ms, abs=5e-3)
    before, after = (honest(estimate(t, run), recorded)["depth"] for t in (tool, told.tool))
    assert after.mean_error_mm < 0.6 * before.mean_error_mm
    assert after.coverage >= max(0.9, before.coverage)


def test_a_tare_needs_an_untouched_tool() -> None:
    """Catches references that are taken while something presses, and a tare of a run without a free second."""
    there = planted("fbg_bias", 2)
    made = tare(FlexibleTool(), there.free_motion(seconds=5.0), untouched=True)
    shift = np.array(there.bias_nm).reshape(2, 3)
    np.testing.assert_allclose(made.shift_nm[:6].reshape(2, 3), shift - shift.mean(axis=1, keepdims=True), atol=2e-4)
    with pytest.raises(MeasurementError, match="something touched the tool"):
        tare(FlexibleTool(), there.run("vessels", seconds=10.0), untouched=True)
    pressed = there.run("vessels", seconds=10.0)
    never = replace(pressed, wavelengths_nm=pressed.wavelengths_nm + 0.05 * np.array([1, -1, 0, -1, 1, 0, 0, 0, 0]))
    assert tare(FlexibleTool(), never).tool == FlexibleTool()


def test_a_fibre_that_shows_nothing_leaves_its_section_untared() -> None:
    """Catches a warning of NumPy, or no number among the references, where one fibre of the witness is dead."""
    run = VirtualTool(FlexibleTool()).free_motion(seconds=5.0)
    run.wavelengths_nm[:, 7] = np.nan
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        made = tare(FlexibleTool(), run, untouched=True)
    assert (made.shift_nm[6:] == 0).all()
    assert (made.shift_nm[:6] != 0).all()
