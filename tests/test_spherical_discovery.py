"""Hidden physics of the spherical robot, found again in pixels: planted in a second simulator, named by the product."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from numpy.typing import ArrayLike, NDArray
from scipy import stats

import sherkit as sk
import worlds
from consistency import named
from running import slow
from second_simulator import room_temperature
from second_simulator.spherical import SPHERICAL_EFFECTS, SecondSpherical, sphere_grid, spherical_plan
from sherkit.diagnosis import template
from sherkit.fit.identify import ABSURD
from sherkit.model.effect import load_effects
from sherkit.model.sensor_pose import POSE
from sherkit.robots.spherical import CameraView, Spherical
from sherkit.robots.spherical.model import SphericalModel

Floats = NDArray[np.float64]

SIZE_PX = (1280, 640)
#: The marker of every robot that is drawn here fills the height of the picture on the whole plan.
FOCAL_PX = 710.0
VIEW = CameraView.facing(np.pi / 2, np.pi / 4, 446.2, size_px=SIZE_PX, focal_px=(FOCAL_PX, FOCAL_PX))
HOME_RAD = Spherical(45.0, 45.0, 200.0).inverse([np.pi / 2, np.pi / 4])
#: The actuated axis leans, so that the weight can be told from what goes with γ alone.
GRAVITY = (0.0, 0.6, -0.8)
HOME_DEG = (float(np.rad2deg(HOME_RAD[0])), float(np.rad2deg(HOME_RAD[1])))
ROBOT = Spherical(45.0, 45.0, 200.0, VIEW, gravity=GRAVITY, home_deg=HOME_DEG)
#: Table I of the paper, identified less nominal: α, β in rad, R in mm.
ERRORS = (-0.022, 0.018, 22.0)
NOISE_PX = 0.15
#: Where the camera stands belongs to the model: no effect, but one of the simulator's parameters in their order.
EFFECTS = tuple(name for name in SPHERICAL_EFFECTS if name != "sensor_pose")
ORDER = tuple(SPHERICAL_EFFECTS)


def patch(half_width_rad: float, gamma_rad: tuple[float, float], per_side: int) -> Floats:
    """Commanded joints (n, 2) over a patch of the sphere in front of the camera."""
    middle = np.pi / 2
    angles = sphere_grid((middle - half_width_rad, middle + half_width_rad), gamma_rad, per_side)
    return ROBOT.inverse_batch(angles).values


#: About as many poses as the delta's plans have: 576, 361 and, for false alarms, 64.
PLANS = {
    "whole": patch(1.0, (0.33, 1.25), 24),
    "local": patch(0.35, (0.55, 1.05), 19),
    "small": patch(0.5, (0.5, 1.1), 8),
}
RATIOS = (1, 2, 5)
LEVEL = 0.01
#: Chance with which a correct program fails one of the counts below.
RARE = 1e-3
#: Length, in noise, at which what a single effect leaves of a pair shows in 80 % of runs: one column of the 200 that
#: are tried together at the level, on the two thirds of the rows that are searched.
SEEN = float(stats.norm.isf(LEVEL / 200 / 2) + stats.norm.isf(0.2)) * np.sqrt(1.5)


@dataclass
class Run:
    """One simulated run and the robot it was taken on, with what was planted."""

    data: sk.Measurements
    robot: SecondSpherical
    plan: dict[str, NDArray[Any]]

    def diagnose(self) -> sk.diagnosis.Diagnosis:
        """As a user does."""
        return sk.diagnose(sk.identify(ROBOT, self.data))

    def enough_alone(self) -> set[str]:
        """Effects of which one, with α, β and R, explains all that was planted but for less than can be seen.

        By the second simulator, without noise and in linear approximation.
        """
        plain = self.robot.changed(effects=None)
        planted = (self.robot.truth(self.plan) - plain.truth(self.plan)).ravel()
        geometry = plain.fitted_directions(self.plan)
        out = set()
        for name in EFFECTS:
            basis, _ = np.linalg.qr(np.hstack([geometry, plain.fitted_directions(self.plan, (name,))]))
            if np.linalg.norm(planted - basis @ (basis.T @ planted)) < SEEN * NOISE_PX:
                out.add(name)
        return out


def real_robot(seed: int) -> SecondSpherical:
    """A robot whose arcs and radius are off as the paper's were, give or take a half; β stays above α."""
    alpha, beta, radius = np.array(ERRORS) * np.random.default_rng([seed, 1]).uniform(0.5, 1.5, 3)
    return SecondSpherical(
        np.pi / 4 + alpha, np.pi / 4 + beta, 200.0 + radius, VIEW.parameters, GRAVITY, HOME_RAD, seed
    )  # fmt: skip


def measured(
    where: str,
    seed: int,
    effects: Mapping[str, ArrayLike] | None = None,
    *,
    scaled: Mapping[str, float] | None = None,
    repeats: int = 3,
    any_room: bool = False,
) -> Run:
    """A run over a plan, filmed in motion in a random order. Of each ``scaled`` effect a fit of α, β, R and the
    camera's pose leaves the given RMS, in noise. In ``any_room`` mean and course of the temperature are drawn, and when
    the clock starts."""
    plan = spherical_plan(PLANS[where], repeats, "shuffled", seed)
    if any_room:
        plan["temperature_c"] = room_temperature(np.random.default_rng([seed, 5]), plan["time_s"])
    robot = real_robot(seed)
    planted: dict[str, Any] = dict(effects or {})
    for name, ratio in (scaled or {}).items():
        rng = np.random.default_rng([seed, 2, ORDER.index(name)])
        planted |= robot.at_ratio(name, ratio, NOISE_PX, plan, rng, fitted=("sensor_pose",))
    robot.effects = planted
    columns = robot.run(plan, noise_px=NOISE_PX, seed=1000 + seed)
    if any_room:
        columns["time_s"] = columns["time_s"] + np.random.default_rng([seed, 6]).uniform(-1e5, 1e5)
    return Run(sk.from_frame(pl.DataFrame(columns)), robot, plan)


def hidden(name: str, ratio: float, where: str, seed: int, *, any_room: bool = False) -> sk.diagnosis.Diagnosis:
    """The diagnosis of a run with one effect whose visible part is ``ratio`` times the noise."""
    return measured(where, seed, scaled={name: ratio}, any_room=any_room).diagnose()


def sizes_planted(run: Run, name: str) -> float:
    """How many plausible sizes an effect was planted with; a period or a moment, which come last, has none."""
    planted = np.ravel(run.robot.effects[name])
    sizes = [p.size for p in sk.spherical.SPHERICAL_CATALOGUE[name].parameters]
    return float(np.max(np.abs(planted[: len(sizes)]) / sizes))


def held_out_allowance(d: sk.diagnosis.Diagnosis) -> float:
    """3 % and four standard deviations of the RMS of as many Gaussian readings."""
    return 0.03 + 4.0 / np.sqrt(2 * 2 * len(d.base.data))


def silent(seed: int, repeats: int) -> sk.diagnosis.Diagnosis:
    """The diagnosis of a run with nothing hidden."""
    return measured("small", seed, repeats=repeats).diagnose()


def alarms(seeds: range, repeats: int) -> list[int]:
    """The seeds at which something is found where nothing is."""
    return [seed for seed in seeds if silent(seed, repeats).verdict != "adequate"]


# -- one of each ---------------------------------------------------------------------------------------------------


def test_the_plan_fills_the_picture() -> None:
    """Catches a plan that no camera could measure, or too small for what is claimed of it. Every seed used below.

    To the sides the sphere itself ends: there its limb would hide the marker.
    """
    low, high = np.full(2, np.inf), np.full(2, -np.inf)
    for seed in (*range(20), 100):
        pixels = real_robot(seed).pixels(PLANS["whole"])
        low, high = np.minimum(low, pixels.min(axis=0)), np.maximum(high, pixels.max(axis=0))
    assert (low >= 0).all()
    assert (high <= np.array(SIZE_PX) - 1).all()
    assert (high - low)[1] > 0.95 * SIZE_PX[1]
    assert (high - low)[0] > 0.6 * SIZE_PX[0]


#: One of each link and of each way to be found. That every effect is tried, and by the right columns, is asked where
#: nothing is hidden and in ``test_second_spherical.py``.
ASKED = ("camera_delay",)


@pytest.mark.parametrize(
    ("k", "name"),
    [
        pytest.param(k, name, marks=[pytest.mark.slow] * (name not in ASKED))
        for k, name in enumerate(ORDER)
        if name in EFFECTS
    ],
)
def test_each_effect_is_found_by_name(k: int, name: str) -> None:
    """Catches an effect that is never tried, tried with wrong columns, or outranked; and a wrong held-out error.

    Seed 100; ratio 1, 2 or 5 and the whole or local plan in turn, twice. At the 1 % level a second effect may join by
    chance.
    """
    d = measured(("whole", "local")[k % 2], 100, scaled={name: RATIOS[k % 3]}, repeats=2).diagnose()
    assert d.verdict == "explained"
    assert name in named(d)
    assert d.p_missing <= LEVEL
    assert d.unit == "px"
    # where the camera stands takes most of what joints and markers are off by, and is known to a degree of its own
    assert (
        d.steps[0].error.rms
        > (1.02 if name in ("joint_offset", "marker_offset", "axis_offset") else 1.2) * d.steps[-1].error.rms
    )
    assert abs(d.steps[-1].error.rms / np.sqrt(d.error.axes) / NOISE_PX - 1) < held_out_allowance(d)
    report = {c.effect: c for c in d.candidates}[name]
    assert report.p_value < LEVEL
    assert d.signature is None


@pytest.mark.parametrize("name", ["thermal_growth", pytest.param("drift", marks=pytest.mark.slow)])
def test_what_is_named_is_fitted_as_a_calibration_fits_it(name: str) -> None:
    """Catches a diagnosis that holds what it named to plausible sizes, since rows beside a model that lacked it could
    not do without the drawing: a growth of 1.7e-3 was told as 1.3e-4, four noises were said to be left, and a
    calibration of the same rows left none."""
    world = worlds.spherical_world(1, repeats=3, scaled={name: 4})
    run = sk.from_frame(pl.DataFrame(world.columns))
    d = sk.diagnose(sk.identify(world.robot, run))
    calibrated = sk.identify(d.fit.model, run)
    assert d.effects == (name,)
    assert d.fit.error.rms == pytest.approx(calibrated.error.rms, rel=0.02)
    assert d.fit.error.rms / np.sqrt(2.0) < 1.2 * world.noise


@pytest.mark.parametrize("repeats", [1, 3, *slow(5)])
def test_nothing_is_found_where_nothing_is(repeats: int) -> None:
    """Catches an alarm without cause, and an adequate model without a word on what would have been found.

    Level 1 %, seeds 0 and 1: a correct program fails one of these six with 6 %, these seeds are such that it does not.
    """
    for seed in range(2):
        d = silent(seed, repeats)
        assert d.verdict == "adequate"
        assert (d.effects, d.indistinguishable, d.signature, d.next_poses) == ((), (), None, ())
        assert d.p_missing > LEVEL
        assert set(d.smallest_found) == set(EFFECTS)
        assert all(rms > 0 for _, rms in d.smallest_found.values())
        assert d.noise_origin == ("unknown" if repeats == 1 else "repeats")


@pytest.mark.slow
def test_false_alarms_are_few() -> None:
    """Catches a level that is plainly not held: 16 runs, seeds 2000 to 2015, level 1 %, at most 1.5 %.

    More than 3 alarms would come by chance in one of 1,000 such counts at 1.5 %.
    """
    found = alarms(range(2000, 2016), 3)
    assert len(found) <= stats.binom.isf(RARE, 16, 0.015), found


@pytest.mark.parametrize("pair", [("backlash", "lens_distortion"), ("camera_delay", "gravity_flexure")])
@pytest.mark.slow
def test_two_effects_are_found_together(pair: tuple[str, str]) -> None:
    """Catches a search that stops after one effect, or takes one wrong one for two. Seed 7, ratio 2."""
    d = measured("whole", 7, scaled=dict.fromkeys(pair, 2)).diagnose()
    assert d.verdict == "explained"
    assert set(pair) <= named(d)
    assert [s.effect for s in d.steps] == [None, *d.effects]
    assert abs(d.steps[-1].error.rms / np.sqrt(d.error.axes) / NOISE_PX - 1) < held_out_allowance(d)


@pytest.mark.parametrize("seed", [0, *slow(1, 2)])
def test_where_the_camera_stands_is_no_effect(seed: int) -> None:
    """Catches a name for a camera that stands within what its calibration says, and a pose that is not found."""
    stands = np.random.default_rng([seed, 8]).normal(size=6) * ([np.deg2rad(0.1)] * 3 + [1.0] * 3)
    d = measured("whole", seed, {"sensor_pose": stands}).diagnose()
    assert (d.verdict, d.effects) == ("adequate", ())
    found, std = d.fit.by_name, dict(zip(d.fit.model.free, d.fit.std, strict=True))
    off = [(found[name] - true) / std[name] for name, true in zip(POSE, stands, strict=True)]
    # level 1e-4 for each number
    assert np.abs(off).max() < 4.0
    assert abs(d.steps[-1].error.rms / np.sqrt(d.error.axes) / NOISE_PX - 1) < held_out_allowance(d)


@pytest.mark.slow
def test_a_cause_of_many_parameters_is_found_beside_the_small_ones_that_imitate_it() -> None:
    """Catches a true cause that is never fitted, for want of tries, since simpler ones take nearly as much of the run.

    Seed 9 on the local plan at ratio 1: four parameters of a lens against a longer focal length.
    """
    d = hidden("lens_distortion", 1, "local", 9)
    assert d.verdict == "explained"
    assert "lens_distortion" in named(d)


@pytest.mark.slow
def test_chance_does_not_turn_two_effects_into_three_others() -> None:
    """Catches a search that falls back on the best single effect where noise alone has refused the right pair.

    Seed 1, whose noise has a ripple by chance where rows know neither time nor temperature: the pair is named, whether
    or not the ripple is described beside it.
    """
    frame = measured("whole", 1, scaled={"joint_scale": 2, "lens_distortion": 2}).data.to_frame()
    d = sk.diagnose(sk.identify(ROBOT, sk.from_frame(frame.drop("time_s", "temperature_c"))))
    assert d.verdict in ("explained", "partly explained")
    assert set(d.effects) == {"joint_scale", "lens_distortion"}
    assert d.signature is None or d.signature["shape"] == "periodic"


@pytest.mark.slow
def test_a_turn_that_both_joints_share_is_one_of_the_camera() -> None:
    """Catches a joint that is blamed for what a camera does that stands within what is known of it, and a camera that
    would have to stand ten times as far off and is a caveat, or not told of, or told without the joints. No picture
    tells one from the other; seed 0."""
    little, much = (measured("whole", 0, {"joint_offset": [by, by]}).diagnose() for by in (0.002, 0.02))
    assert (little.verdict, little.effects, much.effects) == ("adequate", (), ())
    assert next(check for check in little.checks if check.name == "stands_as_known").holds
    assert much.verdict == "unexplained"
    assert re.search(
        r"the camera stands \S+ mm and 1.1° from where the robot's file has it, known within", much.headline
    )
    assert re.search(r"with it there joint_offset\b.* would do as well", much.headline)
    said = much.findings[0]
    assert said.answer.startswith("The sensor is not where the robot's file has it: the camera stands")
    assert said.to_do.startswith("Measure again where it stands")


@pytest.mark.slow
def test_a_camera_that_slipped_early_leaves_no_row_out() -> None:
    """Catches rows before an early slip that are taken for gross errors, and the other readings of their poses with
    them, since one of three spoils the mean: seed 13, where it slips after 59 of 1,728 rows."""
    d = measured("whole", 13, scaled={"sensor_slip": 5}, any_room=True).diagnose()
    assert d.effects == ("sensor_slip",)
    assert not len(d.outliers)
    assert abs(d.error.rms / np.sqrt(d.error.axes) / NOISE_PX - 1) <= held_out_allowance(d)


def test_what_too_few_poses_cannot_confirm_is_said() -> None:
    """Catches "unexplained", with a shape for all that is left, of 10 poses whose one cause was found and is not named
    since poses are too few to judge it by; and times that are in milliseconds, since most rows between are not there:
    seed 1."""
    data = measured("whole", 1, scaled={"marker_offset": 3}).data
    few = np.isin(data.groups, np.unique(data.groups)[::57][:10])
    d = sk.diagnose(ROBOT, sk.from_frame(data.to_frame().filter(few)))
    assert d.verdict == "unexplained"
    assert re.search("which marker_offset.* would explain, .* measure more poses", d.headline)


def test_a_delay_needs_the_velocity_and_says_so() -> None:
    """Catches an effect that is silently skipped, or tried on columns that are not there."""
    frame = measured("small", 0).data.to_frame().drop("theta2_rad_per_s", "time_s")
    d = sk.diagnose(sk.identify(ROBOT, sk.from_frame(frame)))
    timed = {"backlash", "drift", "slip", "joint_slip", "sensor_slip", "sensor_drift"}
    assert set(d.untestable) == {"camera_delay", *timed}
    assert "theta2_rad_per_s" in d.untestable["camera_delay"]
    assert not set(d.untestable) & {c.effect for c in d.candidates}


# -- rates ---------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("where", ["whole", "local"])
@pytest.mark.parametrize("ratio", RATIOS)
def test_the_right_effect_is_named_in_98_of_100(ratio: float, where: str) -> None:
    """Catches any weakness of the search that shows on some draws only, and sizes that do not fit the cause.

    20 seeds of each effect: the true effect leads or is tied in 98 %, "explained" without it in 1 % at most,
    and no single effect in less than 98 %, each with a binomial allowance of 1 in 1,000; held-out errors are at the
    noise. Where the small patch takes nearly all of an effect, that of the given size would be absurd (the radius grows
    by a centimetre for each degree): such draws are of no machine, and are not named by design.
    """
    outcome: Counter[str] = Counter()
    missed: Counter[str] = Counter()
    off = []
    for name in EFFECTS:
        for seed in range(20):
            run = measured(where, seed, scaled={name: ratio}, any_room=True)
            if sizes_planted(run, name) > ABSURD:
                continue
            d = run.diagnose()
            kind = "right" if name in named(d) else "wrong" if d.verdict == "explained" else "missed"
            outcome[kind] += 1
            missed[name] += kind != "right"
            each = d.error.rms / np.sqrt(d.error.axes)
            if kind == "right" and abs(each / NOISE_PX - 1) > held_out_allowance(d):
                off.append((name, seed, each))
    count = outcome.total()
    assert count - outcome["right"] <= stats.binom.isf(RARE, count, 0.02), missed
    assert outcome["wrong"] <= stats.binom.isf(RARE, count, 0.01), missed
    assert max(missed.values()) <= stats.binom.isf(RARE, 20, 0.02), missed
    assert not off


@pytest.mark.slow
def test_pairs_are_named_in_95_of_100() -> None:
    """Catches pairs of which one effect hides the other. All pairs, three seeds of each, a ratio of 2.

    At least 95 % both named, of all and of those that can be known for two; for some, the second simulator says that
    one effect alone explains what both do but for less than can be seen (``enough_alone``): then that one or both are
    named in 98 %. Binomial allowances of 1 in 1,000.
    """
    both, right = {True: 0, False: 0}, 0
    runs: Counter[bool] = Counter()
    missed = []
    for k, pair in enumerate(combinations(EFFECTS, 2)):
        for seed in range(3 * k, 3 * k + 3):
            run = measured("whole", seed, scaled=dict.fromkeys(pair, 2), any_room=True)
            d = run.diagnose()
            alone = run.enough_alone()
            found = set(pair) <= named(d)
            runs[bool(alone)] += 1
            both[bool(alone)] += found
            right += bool(alone) and (found or bool(alone & named(d)))
            if not found:
                missed.append((pair, seed, d.verdict, d.effects, sorted(alone)))
    for count, named_both in ((runs.total(), sum(both.values())), (runs[False], both[False])):
        assert count - named_both <= stats.binom.isf(RARE, count, 0.05), missed
    assert runs[True] - right <= stats.binom.isf(RARE, runs[True], 0.02), missed


@pytest.mark.slow
@pytest.mark.parametrize("repeats", [1, 3, 5])
def test_false_alarms_stay_at_the_level(repeats: int) -> None:
    """Catches a test whose level depends on how often poses are repeated.

    1,000 runs of each, seeds 0 to 999, level 1 %. At most 1.5 %; more than 27 alarms would come by chance in one of
    1,000 such counts at 1.5 %.
    """
    found = alarms(range(1000), repeats)
    assert len(found) <= stats.binom.isf(RARE, 1000, 0.015), found


def test_a_template_of_an_unknown_shape_runs_on_pixels(tmp_path: Path) -> None:
    """Catches a template that knows the columns of a delta alone. Seed 4; the cause goes with the humidity, in u."""
    frame = measured("small", 4).data.to_frame()
    humidity = 40.0 + 10.0 * np.sin(np.arange(frame.height) / 7.0)
    moved = pl.Series("u_px", frame["u_px"].to_numpy() + 0.08 * (humidity - 40.0))
    data = sk.from_frame(frame.with_columns(moved, pl.Series("humidity_pct", humidity)))
    d = sk.diagnose(sk.identify(ROBOT, data))
    assert d.verdict == "unexplained"
    assert d.signature["depends_on"] == ["humidity_pct"]
    path = tmp_path / "my_effects.py"
    path.write_text(template(d.signature, data.layout, "unknown_effect", path.name), encoding="utf-8")
    assert "'px'" in path.read_text(encoding="utf-8")
    (effect,) = load_effects(path)
    again = sk.diagnose(sk.identify(ROBOT, data), effects=(effect,))
    assert again.verdict == "explained"
    assert again.effects == ("unknown_effect",)


@pytest.mark.parametrize("joint", [True, False])
def test_templates_of_every_shape_run_on_pixels(tmp_path: Path, joint: bool) -> None:
    """Catches a shape whose template names a joint, a coordinate or a unit of another robot."""
    data = measured("small", 4).data
    model = SphericalModel(ROBOT)
    shapes: list[dict[str, Any]] = [
        {"shape": "smooth", "order": 2, "depends_on": ["theta1_rad"]},
        {"shape": "periodic", "period": 0.3, "depends_on": ["v_px"]},
        {"shape": "step", "at": 100.0, "depends_on": ["time_s"]},
        {"shape": "kink", "at": 0.1, "depends_on": ["theta2_rad"]},
        {"shape": "bump", "at": 0.1, "width": 0.05, "depends_on": ["theta2_rad"]},
        {"shape": "hysteretic", "at": 0.02, "depends_on": ["theta2_rad"]},
        {"shape": "hysteretic", "order": 1, "depends_on": ["theta2_rad"]},
        {"shape": "hysteretic", "at": 0.0, "depends_on": ["theta2_rad"]},
        {"shape": "interaction", "depends_on": ["theta1_rad", "theta2_rad"]},
    ]
    for shape in shapes:
        signature = {
            "order": None, "period": None, "at": None, "share_explained": 0.5, "axis": ["u", "v"],
            "joint": "theta2_rad" if joint else None, "ranges": dict.fromkeys(shape["depends_on"], (0.5, 1.0)), **shape,
        }  # fmt: skip
        path = tmp_path / "my_effects.py"
        path.write_text(template(signature, data.layout), encoding="utf-8")
        (effect,) = load_effects(path)
        assert effect.link == ("joints" if joint else "sensor")
        assert {p.unit for p in effect.parameters} == {"rad" if joint else "px"}
        model.check_effect(effect, data, np.zeros(len(model.parameters)))
