"""Hidden physics, found again: effects planted in an independent simulator, named through the public interface."""

from __future__ import annotations

import importlib.util
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import combinations, pairwise
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from numpy.typing import ArrayLike, NDArray
from scipy import stats
from scipy.spatial.transform import Rotation

import sherkit as sk
import worlds
from consistency import named
from running import slow
from second_simulator import (
    CATALOGUE,
    Noise,
    Robot,
    draw_geometric_errors,
    draw_pose,
    grid,
    local_grid,
    make_plan,
    scaled_effect,
    simulate,
    whole_grid,
)
from sherkit.diagnosis import template
from strategies import EXAMPLE

Floats = NDArray[np.float64]

ROBOT = Robot.from_dict()
DELTA = EXAMPLE
NOISE_UM = 5.0
EFFECTS = tuple(name for name in CATALOGUE if name not in ("datum", "sensor_pose"))
GRIDS = {"whole": whole_grid(), "local": local_grid(), "small": grid(20.0, 8, (-20.0, 0.0, 20.0))}
RATIOS = (1, 2, 5)
LEVEL = 0.01
#: Chance with which a correct program fails one of the counts below.
RARE = 1e-3
#: Largest ratio that each grid lets the simulator reach: the twelve parameters hide nearly all of these effects, so
#: that more of them left over would need sizes (centimetres of stretch or of difference) at which no pose exists.
CAPS = {("gravity_sag", "local"): 2.0, ("link_growth", "local"): 1.0, ("link_growth", "whole"): 1.0}


@dataclass
class Run:
    """One simulated run and what was planted in it, where the sensor stands among it."""

    data: sk.Measurements
    errors: dict[str, float]
    effects: dict[str, Any] = field(default_factory=dict)

    def diagnose(self, effects: tuple[sk.Effect, ...] = ()) -> sk.diagnosis.Diagnosis:
        """As a user does."""
        return sk.diagnose(sk.identify(DELTA, self.data), effects=effects)


def stands_at(seed: int) -> Floats:
    """Where the sensor of a run stands (6,), rad and mm: anywhere."""
    return draw_pose(np.random.default_rng([seed, 8]))


def measured(
    points: Floats,
    seed: int,
    effects: Mapping[str, ArrayLike] | None = None,
    *,
    scaled: Mapping[str, float] | None = None,
    repeats: int = 3,
    order: Any = "shuffled",
    noise: Noise | None = None,
    add: Mapping[str, Any] | None = None,
) -> Run:
    """A run over ``points``, read by a sensor that stands anywhere. ``scaled`` effects are drawn so that a geometric
    fit leaves the given RMS, µm; ``add`` maps a column to a function of the columns that is added to it."""
    stands: dict[str, Any] = {"sensor_pose": stands_at(seed)}
    plan = make_plan(ROBOT, points, repeats=repeats, order=order, seed=seed)
    errors = draw_geometric_errors(np.random.default_rng([seed, 1]))
    planted: dict[str, Any] = stands | dict(effects or {})
    for k, (name, rms_um) in enumerate((scaled or {}).items()):
        rng = np.random.default_rng([seed, 2, k])
        planted |= scaled_effect(ROBOT, plan, name, rng, 1e-3 * rms_um, errors=errors, beside=stands)
    noise = noise or Noise(sigma_mm=1e-3 * NOISE_UM)
    columns = simulate(ROBOT, plan, errors, planted, noise=noise, seed=1000 + seed)
    for name, function in (add or {}).items():
        columns[name] = columns[name] + function(columns)
    return Run(sk.from_frame(pl.DataFrame(columns)), errors, planted)


def ratio_of(name: str, where: str, ratio: float) -> float:
    return min(ratio, CAPS.get((name, where), np.inf))


def hidden(name: str, ratio: float, where: str, seed: int) -> sk.diagnosis.Diagnosis:
    """The diagnosis of a run with one effect whose visible part is ``ratio`` times the noise."""
    return measured(GRIDS[where], seed, scaled={name: ratio_of(name, where, ratio) * NOISE_UM}).diagnose()


@dataclass(frozen=True)
class Case:
    """A kind of noise under which nothing must be found."""

    repeats: int = 3
    order: str = "shuffled"
    noise: Noise = field(default_factory=lambda: Noise(sigma_mm=1e-3 * NOISE_UM))


SIGMA = 1e-3 * NOISE_UM
CASES = {
    "1 repeat": Case(1),
    "3 repeats": Case(3),
    "5 repeats": Case(5),
    "outliers": Case(noise=Noise(SIGMA, outlier_fraction=0.02)),
    "unequal": Case(noise=Noise((0.003, 0.005, 0.009), rim_factor=3.0)),
    "student": Case(noise=Noise(SIGMA, student=True)),
    "correlated 0.3": Case(noise=Noise(SIGMA, rho=0.3)),
    "correlated 0.7": Case(noise=Noise(SIGMA, rho=0.7)),
    "1 repeat, unequal": Case(1, noise=Noise((0.003, 0.005, 0.009), rim_factor=3.0)),
    "1 repeat, student": Case(1, noise=Noise(SIGMA, student=True)),
    "1 repeat, outliers": Case(1, noise=Noise(SIGMA, outlier_fraction=0.02)),
    "1 repeat in order, correlated 0.3": Case(1, "planes", Noise(SIGMA, rho=0.3)),
    "1 repeat in order, correlated 0.7": Case(1, "planes", Noise(SIGMA, rho=0.7)),
    "3 repeats in order, correlated 0.7": Case(3, "planes", Noise(SIGMA, rho=0.7)),
}


def silent(case: Case, seed: int) -> sk.diagnosis.Diagnosis:
    """The diagnosis of a run with nothing hidden."""
    return measured(GRIDS["small"], seed, repeats=case.repeats, order=case.order, noise=case.noise).diagnose()


# -- one of each ---------------------------------------------------------------------------------------------------


#: One of each link and of each way to be found. That every effect is tried, and by the right columns, is asked where
#: nothing is hidden and in ``test_effects.py``.
ASKED = ("rod_mismatch",)


@pytest.mark.parametrize(
    ("k", "name"), [pytest.param(*one, marks=[pytest.mark.slow] * (one[1] not in ASKED)) for one in enumerate(EFFECTS)]
)
def test_each_effect_is_found_by_name(k: int, name: str) -> None:
    """Catches an effect that is never tried, tried with wrong columns, or outranked; and a wrong held-out error.

    Seed 100; ratio 1, 2 or 5 and a third of the whole or local grid in turn, twice. At the 1 % level a second one may
    join by chance. What the local grid shows only at a thousand times its usual size, as rods that sag by 50 mm, is
    asked on the whole one: there forms of first order end, and another effect is nearer to them.
    """
    where = "whole" if (name, "local") in CAPS else ("whole", "local")[k % 2]
    scaled = {name: ratio_of(name, where, RATIOS[k % 3]) * NOISE_UM}
    d = measured(GRIDS[where][::3], 100, scaled=scaled, repeats=2).diagnose()
    assert d.verdict == "explained"
    assert name in named(d)
    assert d.p_missing <= LEVEL
    assert d.steps[0].error.rms / np.sqrt(d.error.axes) > 1.2 * NOISE_UM
    assert abs(d.steps[-1].error.rms / np.sqrt(d.error.axes) / NOISE_UM - 1) < held_out_allowance(d)
    report = {c.effect: c for c in d.candidates}[name]
    assert report.p_value < LEVEL
    assert d.signature is None


def held_out_allowance(d: sk.diagnosis.Diagnosis) -> float:
    """3 % and four standard deviations of the RMS of as many Gaussian readings."""
    return 0.03 + 4.0 / np.sqrt(2 * 3 * len(d.base.data))


@pytest.mark.parametrize("seed", [2, 3, *slow(4, 5, 6)])
def test_nothing_is_found_where_nothing_is(seed: int) -> None:
    """Catches an alarm without cause, and an adequate model without a word on what would have been found.

    Level 1 %, seeds 2 to 6: a correct program fails one of five with 5 %, these seeds are such that it does not.
    """
    d = silent(CASES["3 repeats"], seed)
    assert d.verdict == "adequate"
    assert (d.effects, d.indistinguishable, d.signature, d.next_poses) == ((), (), None, ())
    assert d.p_missing > LEVEL
    assert set(d.smallest_found) == set(EFFECTS)
    assert all(rms > 0 for _, rms in d.smallest_found.values())
    assert d.noise_origin == "repeats"


@pytest.mark.parametrize(
    ("name", "seed"),
    [pytest.param(name, seed, marks=pytest.mark.slow)
     for name in ("slip", "joint_slip") for seed in range(4)],
)  # fmt: skip
def test_the_moment_of_a_slip_is_found_to_the_row(name: str, seed: int) -> None:
    """Catches a moment found on some of the rows and kept for all. Seeds 0 to 3, a step of about nine times the noise:
    one row off would show by 15 standard deviations."""
    run = measured(GRIDS["small"], seed, scaled={name: 5 * NOISE_UM})
    study = sk.Study(DELTA, run.data)
    d = study.diagnose()
    study.add(name)
    assert run.data.time_s is not None
    after = run.data.time_s > run.effects[name][3]
    # what shifts the point leaves what a shift of the instrument leaves, which leads
    assert name in named(d)
    (lead,) = d.effects
    for model, slipped in ((study.model, name), (d.fit.model, lead)):
        np.testing.assert_array_equal(run.data.time_s > model.settings()[f"{slipped}_time_s"], after)


@pytest.mark.slow
@pytest.mark.parametrize("order", ["planes", "shuffled"])
def test_the_correlation_of_the_noise_is_that_of_the_run(order: str) -> None:
    """Catches rows that are locked away or marked and so make neighbours of readings that are none.

    576 rows, ρ = 0.7, seeds 0 to 7, and 0 to 3 where the planes are in order: the mean estimate within 0.03.
    """
    case = Case(3, order, Noise(SIGMA, rho=0.7))
    found = [silent(case, seed).correlation_in_time for seed in range(4 if order == "planes" else 8)]
    assert abs(np.mean(found) - 0.7) < 0.03


@pytest.mark.slow
@pytest.mark.parametrize("pair", [("rail_lean", "drift"), ("backlash", "sensor_linearity")])
def test_two_effects_are_found_together(pair: tuple[str, str]) -> None:
    """Catches a search that stops after one effect, or takes one wrong one for two. Seed 7, ratio 2."""
    d = measured(GRIDS["small"], 7, scaled=dict.fromkeys(pair, 2 * NOISE_UM)).diagnose()
    assert d.verdict == "explained"
    assert set(pair) <= named(d)
    assert [s.effect for s in d.steps] == [None, *d.effects]
    assert abs(d.steps[-1].error.rms / np.sqrt(d.error.axes) / NOISE_UM - 1) < held_out_allowance(d)


@pytest.mark.slow
def test_humidity_is_described_and_not_explained() -> None:
    """Catches an unknown cause pressed into the catalogue, and a description that misses its variable. Seed 3."""
    d = measured(GRIDS["small"], 3, scaled={"humidity": 2 * NOISE_UM}).diagnose()
    assert d.verdict == "unexplained"
    assert d.signature["depends_on"] == ["humidity_pct"]
    assert d.signature["shape"] == "smooth"
    assert d.signature["share_explained"] > 0.9
    assert {w.variable: w.p_value for w in d.where}["humidity_pct"] < 1e-10


@sk.effect(at="body", parameters={"amplitude": ("mm", 0.05)}, remedy="Measure on a floor at rest.")
def floor_heave(rows: Any, p: Any) -> Floats:
    """The floor heaves with a period of twenty minutes."""
    return p.amplitude * np.outer(np.sin(2 * np.pi * rows.time / 1200.0), [0.0, 0.5, 1.0])


def heaved(seed: int) -> Run:
    """A run on a heaving floor; what moves the point moves the reading along the axes of the sensor, which is straight
    and stands anywhere."""
    wave: Any = lambda c: 0.02 * np.sin(2 * np.pi * c["time_s"] / 1200.0)  # noqa: E731
    seen = Rotation.from_rotvec(stands_at(seed)[:3]).apply([0.0, 0.5, 1.0])
    return measured(
        GRIDS["small"],
        seed,
        add={f"{axis}_mm": lambda c, part=part: part * wave(c) for axis, part in zip("xyz", seen, strict=True)},
    )


@pytest.mark.slow
def test_a_users_effect_stands_beside_the_built_in_ones() -> None:
    """Catches a user's effect that is not tried, not tested or not fitted like one of the catalogue. Seed 11."""
    run = heaved(11)
    without = run.diagnose()
    assert without.verdict != "explained"
    d = run.diagnose((floor_heave,))
    assert d.verdict == "explained"
    assert d.effects == ("floor_heave",)
    first = d.candidates[0]
    assert (first.effect, first.link, first.plausible) == ("floor_heave", "body", True)
    (amplitude,) = first.parameters
    assert amplitude["unit"] == "mm"
    assert abs(amplitude["value"] - 0.02) < 4 * amplitude["std"]
    assert amplitude["std"] < 1e-3
    silent_run = measured(GRIDS["small"], 11)
    idle = silent_run.diagnose((floor_heave,))
    assert idle.verdict == "adequate"
    assert "floor_heave" in {c.effect for c in idle.candidates}
    assert "floor_heave" in idle.smallest_found


def test_candidates_are_known_as_a_fit_with_them_would_know_them() -> None:
    """Catches deviations in the table of effects that go by a noise which the readings contradict: a tenth of what a
    calibration says. Nothing is hidden; the noise is declared as a fifth of what it is, seed 2."""
    world = worlds.delta_world(2)
    said = {f"sigma_{axis}_mm": np.full(len(world.columns["x_mm"]), 2e-4 * world.noise) for axis in "xyz"}
    data = sk.from_frame(pl.DataFrame(world.columns | said))
    (scale,) = (c for c in sk.diagnose(world.robot, data).candidates if c.effect == "joint_scale")
    fit = sk.identify(world.robot, data, effects=["joint_scale"])
    for one in scale.parameters:
        at = [p.name for p in fit.parameters].index(f"joint_scale.{one['name']}")
        assert one["std"] == pytest.approx(fit.std[at], rel=0.2)


def test_an_effect_without_its_column_is_untestable_and_says_why() -> None:
    """Catches an effect that is silently skipped, or tried on columns that are not there."""
    run = measured(GRIDS["small"], 0)
    frame = run.data.to_frame().drop("temperature_c", "time_s", "humidity_pct")
    d = sk.diagnose(sk.identify(DELTA, sk.from_frame(frame)))
    warm = {"thermal_growth", "link_growth", "thermal_shift"}
    timed = {"drift", "slip", "joint_slip", "sensor_slip", "sensor_drift"}
    assert set(d.untestable) == warm | timed | {"backlash", "bar_zero"}
    assert "temperature_c" in d.untestable["thermal_growth"]
    assert not set(d.untestable) & {c.effect for c in d.candidates}


# -- ties ----------------------------------------------------------------------------------------------------------


def later(run: Run, poses: Floats, seed: int) -> sk.Measurements:
    """The poses measured on the same robot after the run, time going on."""
    plan = make_plan(ROBOT, poses, seed=seed)
    plan["time_s"] = plan["time_s"] + float(run.data.time_s.max()) + 600.0
    plan["temperature_c"] = np.full(len(poses), 21.0)
    columns = simulate(ROBOT, plan, run.errors, run.effects, noise=SIGMA, seed=5000 + seed)
    return sk.from_frame(pl.DataFrame(columns), "later")


def settled(run: Run, d: sk.diagnosis.Diagnosis, seed: int) -> sk.diagnosis.Diagnosis:
    """The diagnosis once the poses that the first one asked for were measured."""
    poses = np.array([[p["x_mm"], p["y_mm"], p["z_mm"]] for p in d.next_poses])
    study = sk.Study(DELTA, run.data)
    study.extend(later(run, poses, seed))
    return study.diagnose()


#: In order, once each: height and time go together, so drift and crossed beams tie on some draws.
#: (effect, grid, ratio, seed)
TIES = [
    ("drift", "small", 2, 0),
    *(pytest.param("drift", where, ratio, seed, marks=pytest.mark.slow)
      for where, ratio, seed in (("small", 2, 5), ("whole", 1, 6), ("whole", 1, 7))),
]  # fmt: skip


@pytest.mark.parametrize(("name", "where", "ratio", "seed"), TIES)
def test_a_tie_is_reported_and_the_next_poses_settle_it(name: str, where: str, ratio: float, seed: int) -> None:
    """Catches a cause named as if it were the only one that fits, poses that tell nothing apart or are not given,
    and a second run joined as if time had stood still."""
    run = measured(GRIDS[where], seed, scaled={name: ratio * NOISE_UM}, repeats=1, order="planes")
    d = run.diagnose()
    assert d.indistinguishable
    assert {name} < set(d.indistinguishable[0])
    assert 0 < len(d.next_poses) <= 12
    reached = [p["separation_sigma"] for p in d.next_poses]
    assert all(b >= a - 1e-6 for a, b in pairwise(reached))
    after = settled(run, d, seed)
    # what a person was asked to measure is no outlier
    assert (after.outliers < len(run.data)).all()
    assert after.effects == (name,)
    # what can never be told from it on any poses may come as near again; what was asked for is settled
    tie, kept = set(d.indistinguishable[0]), set(after.indistinguishable[0] if after.indistinguishable else ())
    assert kept & tie < tie


# -- outside the catalogue -----------------------------------------------------------------------------------------


def cloud(seed: int) -> Floats:
    """500 poses at random, so that every height is there: on three planes no period can be known."""
    return np.random.default_rng([seed, 3]).uniform(-18.0, 18.0, (500, 3))


def filled_in(d: sk.diagnosis.Diagnosis, folder: Path) -> sk.Effect:
    """The effect that a signature writes, loaded as a user's file is."""
    assert d.signature is not None
    path = folder / "my_effects.py"
    path.write_text(template(d.signature, d.fit.data.layout, "unknown_effect", path.name), encoding="utf-8")
    spec = importlib.util.spec_from_file_location("my_effects", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    effect = module.unknown_effect
    assert isinstance(effect, sk.Effect)
    return effect


def compensated_um(run: Run, d: sk.diagnosis.Diagnosis, folder: Path) -> float:
    """Held-out RMS of a coordinate, µm, once the template of the signature is part of the model."""
    study = sk.Study(DELTA, run.data)
    study.add(filled_in(d, folder))
    error = study.history[-1].error
    return error.rms / float(np.sqrt(error.axes))


@pytest.mark.slow
@pytest.mark.parametrize("ratio", RATIOS)
@pytest.mark.parametrize("where", ["whole", "local"])
def test_humidity_is_never_explained_and_its_template_mends_it(where: str, ratio: float, tmp_path: Path) -> None:
    """Catches a covariate of no effect pressed into the catalogue, and a template that does not run or does not help.

    Seeds 200 to 209 of each cell; all must be named.
    """
    for seed in range(200, 210):
        run = measured(GRIDS[where], seed, scaled={"humidity": ratio * NOISE_UM})
        d = run.diagnose()
        assert d.verdict != "explained"
        assert d.signature["depends_on"] == ["humidity_pct"]
        assert d.signature["shape"] == "smooth"
        assert compensated_um(run, d, tmp_path) < 1.1 * NOISE_UM


@pytest.mark.slow
@pytest.mark.parametrize("k", range(6))
def test_a_coupling_of_two_joints_is_described(k: int, tmp_path: Path) -> None:
    """Catches a coupling explained by catalogue effects, or described at the wrong joint. Seeds 200 to 204, 0.06 mm."""
    driven, driving = ((1, 2), (1, 3), (2, 1), (2, 3), (3, 1), (3, 2))[k]
    for seed in range(200, 205):
        run = measured(GRIDS["whole"], seed, {"joint_coupling": 0.06 * np.eye(6)[k]})
        d = run.diagnose()
        assert d.verdict != "explained"
        assert d.signature["joint"] == f"q{driven}_mm"
        assert set(d.signature["depends_on"]) == {f"q{driven}_mm", f"q{driving}_mm"}
        assert d.signature["shape"] == "interaction"
        assert compensated_um(run, d, tmp_path) < 1.1 * NOISE_UM


@pytest.mark.slow
@pytest.mark.parametrize("where", ["whole", "local"])
@pytest.mark.parametrize("name", ["joint_coupling", "periodic_z"])
def test_what_is_in_no_catalogue_is_never_explained(name: str, where: str) -> None:
    """Catches an unknown cause of several parts pressed into the catalogue, or a diagnosis that breaks on it.

    Seeds 200 to 204, ratio 2 and 5. On three planes the period of a ripple in z cannot be known, only that z matters;
    six couplings at once are mostly a function of height.
    """
    for ratio in (2, 5):
        for seed in range(200, 205):
            d = measured(GRIDS[where], seed, scaled={name: ratio * NOISE_UM}).diagnose()
            assert d.verdict != "explained"
            if name == "periodic_z":
                assert d.signature["depends_on"] == ["z_mm"]
            else:
                assert set(d.signature["depends_on"]) <= {"q1_mm", "q2_mm", "q3_mm", "x_mm", "y_mm", "z_mm"}


@pytest.mark.slow
@pytest.mark.parametrize("ratio", RATIOS)
def test_crosstalk_of_joints_is_at_least_predicted(ratio: float) -> None:
    """Catches an imitation called an explanation that does not hold on unseen poses.

    A linear mixing of joints is, to the noise, scale errors with beams or rods: measured, all of seeds 200 to 209 are
    "explained" by these at plausible sizes. No statistics of one run tells the difference, so only this is asked.
    """
    for seed in range(200, 210):
        d = measured(GRIDS["whole"], seed, scaled={"joint_crosstalk": ratio * NOISE_UM}).diagnose()
        assert d.verdict != "adequate"
        if d.verdict == "explained":
            assert abs(d.steps[-1].error.rms / np.sqrt(d.error.axes) / NOISE_UM - 1) < held_out_allowance(d)


@pytest.mark.slow
@pytest.mark.parametrize("ratio", RATIOS)
def test_a_ripple_in_height_is_described_with_its_period(ratio: float, tmp_path: Path) -> None:
    """Catches a period that is off by more than a template can bear. Seeds 200 to 209, 500 random poses."""
    for seed in range(200, 210):
        run = measured(cloud(seed), seed, scaled={"periodic_z": ratio * NOISE_UM})
        d = run.diagnose()
        assert d.verdict != "explained"
        assert (d.signature["depends_on"], d.signature["shape"]) == (["z_mm"], "periodic")
        assert abs(d.signature["period"] / 7.3 - 1) < 0.1
        assert compensated_um(run, d, tmp_path) < 1.1 * NOISE_UM


# -- rates ---------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("where", ["whole", "local"])
@pytest.mark.parametrize("ratio", RATIOS)
def test_the_right_effect_is_named_in_98_of_100(ratio: float, where: str) -> None:
    """Catches any weakness of the search that shows on some draws only, and sizes that do not fit the cause.

    20 seeds of each of 11 effects: the true effect leads or is tied in 98 %, "explained" without it in 1 % at most,
    each with a binomial allowance of 1 in 1,000; held-out errors are at the noise. Gravity's sag on the local grid is
    capped at a ratio of 2, beyond which it would have to stretch limbs by centimetres.
    """
    outcome: Counter[str] = Counter()
    off = []
    for name in EFFECTS:
        for seed in range(20):
            d = hidden(name, ratio, where, seed)
            kind = "right" if name in named(d) else "wrong" if d.verdict == "explained" else "missed"
            outcome[kind] += 1
            each = d.error.rms / np.sqrt(d.error.axes)
            if kind == "right" and abs(each / NOISE_UM - 1) > held_out_allowance(d):
                off.append((name, seed, each))
    count = outcome.total()
    assert count - outcome["right"] <= stats.binom.isf(RARE, count, 0.02), outcome
    assert outcome["wrong"] <= stats.binom.isf(RARE, count, 0.01), outcome
    assert not off


@pytest.mark.slow
def test_pairs_are_named_in_95_of_100() -> None:
    """Catches pairs of which one effect hides the other. All 55 pairs, seeds 0 to 2, each at a ratio of 2.

    At least 95 % both named, binomial allowance of 1 in 1,000.
    """
    missed = []
    count = 0
    for pair in combinations(EFFECTS, 2):
        for seed in range(3):
            count += 1
            d = measured(GRIDS["whole"], seed, scaled=dict.fromkeys(pair, 2 * NOISE_UM)).diagnose()
            if not set(pair) <= named(d):
                missed.append((pair, seed, d.effects))
    assert len(missed) <= stats.binom.isf(RARE, count, 0.05), missed


#: What the level does not hold for yet: noise that hardly forgets, planes in order, every pose read once. The filter
#: in time misses a tenth of such a correlation on 192 rows: 41 alarms in 1,000.
NOT_YET = "1 repeat in order, correlated 0.7"


@pytest.mark.slow
@pytest.mark.parametrize(
    "case",
    [pytest.param(c, marks=pytest.mark.xfail(reason="41 alarms in 1,000") if c == NOT_YET else ()) for c in CASES],
)
def test_false_alarms_stay_at_the_level(case: str) -> None:
    """Catches a test whose level depends on the shape, size or correlation of the noise.

    1,000 runs of each case, seeds 0 to 999, level 1 %. At most 1.5 %; more than 27 alarms would come by chance in one
    of 1,000 such counts at 1.5 %.
    """
    alarms = [seed for seed in range(1000) if silent(CASES[case], seed).verdict != "adequate"]
    assert len(alarms) <= stats.binom.isf(RARE, 1000, 0.015), alarms
