"""Study: every number of its history against an independent refit, its files, and users' own effects."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import polars as pl
import pytest
from numpy.typing import ArrayLike, NDArray

import sherkit as sk
from second_simulator import Robot, draw_geometric_errors, grid, make_plan, scaled_effect, simulate, truth
from sherkit.data.stream import joined
from sherkit.diagnosis import findings
from sherkit.diagnosis.result import Check, Finding
from sherkit.fit.folds import spatial_blocks
from sherkit.report.states import states_so_far
from strategies import EXAMPLE

Floats = NDArray[np.float64]

ROBOT = Robot.from_dict()
NOISE_MM = 0.005
POINTS = grid(18.0, 6, (-18.0, -6.0, 6.0, 18.0))


def planted(seed: int, *names: str) -> tuple[dict[str, float], dict[str, Any]]:
    """Geometric errors and effects that leave 15 µm each."""
    errors = draw_geometric_errors(np.random.default_rng(seed))
    plan = make_plan(ROBOT, POINTS, repeats=2, order="shuffled", seed=seed)
    effects: dict[str, Any] = {}
    for name in names:
        effects |= scaled_effect(ROBOT, plan, name, np.random.default_rng(seed), 0.015, errors=errors)
    return errors, effects


def run(
    seed: int,
    errors: dict[str, float],
    effects: dict[str, Any] | None = None,
    change: Callable[[dict[str, Any]], dict[str, ArrayLike]] | None = None,
    noise: float = NOISE_MM,
) -> sk.Measurements:
    """144 poses, twice each. ``change`` gives columns that replace the simulator's."""
    plan = make_plan(ROBOT, POINTS, repeats=2, order="shuffled", seed=seed)
    columns: dict[str, Any] = simulate(ROBOT, plan, errors, effects, noise=noise, seed=seed)
    return sk.from_frame(pl.DataFrame(columns | (change(columns) if change else {})))


@pytest.fixture(scope="module")
def leaning() -> sk.Measurements:
    """A run with leaning rails."""
    return run(0, *planted(0, "rail_lean"))


def held_out_um(model: sk.delta.DeltaModel, data: sk.Measurements, seed: int = 0) -> dict[str, float]:
    """Held-out RMS per axis by explicit refits: six folds, dealt five times."""
    whole = sk.identify(model, data)
    # blocks are cut in the base's own coordinates
    predicted = np.stack(list(model.place(data, whole.predicted, whole.values).values()), axis=1)
    left = np.full((5, len(data), 3), np.nan)
    for deal in range(5):
        block = spatial_blocks(data, predicted, 6, 5 * seed + deal)
        for fold in range(6):
            part, out = data.select(np.flatnonzero(block != fold)), data.select(np.flatnonzero(block == fold))
            fit = sk.identify(model, part)
            left[deal, block == fold] = (out.readings - model.predict(out, fit.values))[:, :3]
    left = left[:, ~data.outlier]
    return {f"{a}_mm": float(1e3 * np.sqrt(np.mean(left[..., k] ** 2))) for k, a in enumerate("xyz")}


def same(found: dict[str, float], expected: dict[str, float], rel: float = 1e-9) -> None:
    assert found == pytest.approx(expected, rel=rel, abs=1e-12)


@pytest.mark.slow
def test_every_step_is_an_independent_refit(leaning: sk.Measurements) -> None:
    """Catches history that carries a stale fit, a held-out error of another model or of other rows."""
    study = sk.Study(EXAMPLE, leaning)
    study.add("rail_lean")
    study.add("drift")
    study.remove("rail_lean")
    study.undo()
    study.mark_outliers([3, 40])
    more = run(5, *planted(0, "rail_lean"))
    later = more.to_frame().with_columns(pl.col("time_s") + 1e4)
    study.extend(later)
    lean, drift = sk.delta.CATALOGUE["rail_lean"], sk.delta.CATALOGUE["drift"]
    marked = leaning.mark_outliers(np.array([3, 40]))
    expected: list[tuple[tuple[sk.Effect, ...], sk.Measurements]] = [
        ((), leaning), ((lean,), leaning), ((lean, drift), leaning), ((drift,), leaning), ((lean, drift), leaning),
        ((lean, drift), marked), ((lean, drift), study.data),
    ]  # fmt: skip
    assert len(study.history) == len(expected)
    for step, (effects, data) in zip(study.history, expected, strict=True):
        model = sk.delta.DeltaModel(EXAMPLE, (), effects)
        fit = sk.identify(model, data)
        assert step.effects == tuple(e.name for e in effects)
        assert step.rows == len(data)
        same(step.fitted.by_reading, fit.rms())
        same(step.parameters, fit.by_name, 1e-7)
        same(step.error.by_reading, held_out_um(model, data), 1e-3)
        assert step.error.rms == pytest.approx(np.linalg.norm(list(step.error.by_reading.values())))
    assert study.history[1].error.rms < 1.1e3 * np.sqrt(3) * NOISE_MM < study.history[0].error.rms
    assert len(study.data) == 2 * len(leaning)
    assert study.data.outlier.sum() == 2
    assert len(np.unique(study.data.groups)) == 2 * len(np.unique(leaning.groups))


def test_each_run_that_is_joined_keeps_its_own_directions() -> None:
    """Catches a seam between two runs that is taken for a motion: backlash is found with its size in both."""
    errors = draw_geometric_errors(np.random.default_rng(2))
    effects = {"backlash": [0.05, 0.05, 0.05]}
    first, second = (run(seed, errors, effects) for seed in (2, 3))
    study = sk.Study(EXAMPLE, first)
    study.extend(sk.from_frame(second.to_frame().with_columns(pl.col("time_s") + 5e3)))
    np.testing.assert_array_equal(study.data.direction, np.concatenate([first.direction, second.direction]))
    study.add("backlash")
    for k in (1, 2, 3):
        assert abs(study.history[-1].parameters[f"backlash.width_{k}"] - 0.05) < 0.005


def test_poses_of_two_runs_are_others_without_numbers_too() -> None:
    """Catches equal joint readings of two days taken for repeats, though between the days more has changed."""
    first, second = (run(seed, {}).to_frame().drop("pose", "repeat") for seed in (2, 2))
    apart = sk.from_frame(first)
    both = joined(apart, sk.from_frame(second.with_columns(pl.col("time_s") + 5e3)))
    assert len(np.unique(both.groups)) == 2 * len(np.unique(apart.groups)) < len(both)
    numbered = run(2, {})
    both = joined(numbered, sk.from_frame(second.with_columns(pl.col("time_s") + 5e3)))
    assert len(np.unique(both.groups)) == 2 * len(np.unique(apart.groups))


def test_undo_goes_back_to_the_start(leaning: sk.Measurements) -> None:
    """Catches an undo that forgets a kind of change, or undoes an undo."""
    study = sk.Study(EXAMPLE, leaning)
    first = study.history[0]
    study.add("drift")
    study.mark_outliers([1])
    study.undo()
    assert not study.data.outlier.any()
    assert study.effects == ("drift",)
    step = study.undo()
    assert study.effects == ()
    same(step.parameters, first.parameters)
    same(step.error.by_reading, first.error.by_reading)
    with pytest.raises(sk.errors.EffectError, match="nothing to undo"):
        study.undo()


def test_redo_makes_again_what_was_undone(leaning: sk.Measurements) -> None:
    """Catches a redo of another change than the one undone last, one that survives a new change, a wrong name."""
    study = sk.Study(EXAMPLE, leaning)
    assert (study.undoes, study.redoes) == ("", "")
    study.add("drift")
    study.mark_outliers([1])
    study.undo()
    assert (study.undoes, study.redoes) == ("+ drift", "1 rows marked as outliers")
    study.undo()
    assert (study.undoes, study.redoes) == ("", "+ drift")
    study.redo()
    assert study.effects == ("drift",)
    step = study.redo()
    assert study.data.outlier.sum() == 1
    assert step.action == "redone: 1 rows marked as outliers"
    same(step.error.by_reading, held_out_um(study.model, study.data), 1e-3)
    with pytest.raises(sk.errors.EffectError, match="nothing to do again"):
        study.redo()
    study.undo()
    study.add("rail_lean")
    assert (study.undoes, study.redoes) == ("+ rail_lean", "")


def test_without_is_the_error_of_the_rest(leaning: sk.Measurements) -> None:
    """Catches a study that asking changes, and the error of another model."""
    study = sk.Study(EXAMPLE, leaning)
    plain = study.history[0].error.rms
    study.add("rail_lean")
    assert study.without("rail_lean").error.rms == pytest.approx(plain, rel=1e-9)
    assert (study.effects, len(study.history)) == (("rail_lean",), 2)
    with pytest.raises(sk.errors.EffectError, match="not in the model"):
        study.without("drift")


def test_a_run_whose_clock_began_anew_was_measured_later() -> None:
    """Catches a second run that is refused or woven into the first because it starts at zero, silence on that, and the
    same run joined twice."""
    first, second = run(2, {}), run(3, {})
    with pytest.warns(sk.errors.SherkitWarning, match="measured later and goes on at"):
        both = joined(first, second)
    assert both.time_s[len(first) :].min() > first.time_s.max()
    with pytest.raises(sk.errors.MeasurementError, match="rows are in"):
        joined(first, first)


def test_a_change_that_fails_changes_nothing(leaning: sk.Measurements) -> None:
    """Catches a study left between two states by an error: every row marked, so that nothing is left to fit."""
    study = sk.Study(EXAMPLE, leaning)
    before = (study.model, study.data, len(study.history))
    with pytest.raises(sk.errors.FitError):
        study.mark_outliers(range(len(leaning)))
    assert (study.model, study.data, len(study.history)) == before
    with pytest.raises(sk.errors.EffectError, match="nothing to undo"):
        study.undo()


def test_a_diagnosis_is_kept_until_something_changes(leaning: sk.Measurements) -> None:
    """Catches a stale diagnosis, and one that differs from that of the same fit without a study."""
    study = sk.Study(EXAMPLE, leaning)
    d = study.diagnose()
    assert study.diagnose() is d
    alone = sk.diagnose(sk.identify(EXAMPLE, leaning))
    assert d.effects == alone.effects == ("rail_lean",)
    assert d.to_json() == alone.to_json()
    study.add(d.effects[0])
    again = study.diagnose()
    assert again is not d
    assert again.verdict == "adequate"
    assert abs(study.history[-1].error.rms / d.steps[-1].error.rms - 1) < 0.05


def test_another_level_is_another_question(leaning: sk.Measurements) -> None:
    """Catches a kept diagnosis handed out for a level at which it was not made."""
    study = sk.Study(EXAMPLE, leaning)
    strict, again = study.diagnose(level=1e-9), study.diagnose(level=0.01)
    assert (strict.level, again.level) == (1e-9, 0.01)
    assert again.verdict == "explained"


def test_a_saved_study_comes_back_whole(tmp_path: Path) -> None:
    """Catches anything lost on the way to disk: rows, effects, settings, history, own effects, predictions."""
    data = run(1, *planted(1, "slip"))
    study = sk.Study(EXAMPLE, data, effects=[wave], seed=3)
    study.add("slip")
    study.add("encoder_cyclic", period_mm=2.5)
    study.add("wave")
    study.mark_outliers([7])
    study.save(tmp_path / "study")
    back = sk.Study.load(tmp_path / "study", effects=[wave])
    assert back.robot == study.robot
    assert back.effects == study.effects == ("slip", "encoder_cyclic", "wave")
    assert (back.model.period_mm, back.model.slip_time_s) == (2.5, study.model.slip_time_s)
    assert back.seed == 3
    for name in ("joints", "readings", "time_s", "pose", "repeat", "outlier", "direction"):
        np.testing.assert_array_equal(getattr(back.data, name), getattr(study.data, name))
    for name, values in study.data.covariates.items():
        np.testing.assert_array_equal(back.data.covariates[name], values)
    for a, b in zip(back.history, study.history, strict=True):
        for f in ("action", "effects", "fitted", "error", "parameters", "rows"):
            assert getattr(a, f) == getattr(b, f)
    np.testing.assert_allclose(back.fit.predicted, study.fit.predicted, atol=1e-9)
    assert repr(back) == repr(study)
    back.remove("wave")
    study.remove("wave")
    same(back.history[-1].error.by_reading, study.history[-1].error.by_reading)


def test_a_loaded_history_holds_the_fit_of_each_step(leaning: sk.Measurements, tmp_path: Path) -> None:
    """Catches steps of a loaded study that all show the last fit."""
    study = sk.Study(EXAMPLE, leaning)
    study.add("rail_lean")
    study.save(tmp_path)
    back = sk.Study.load(tmp_path)
    for step in back.history:
        same(step.fit.rms(), step.fitted.by_reading)


def test_a_folder_that_is_no_study_says_so(leaning: sk.Measurements, tmp_path: Path) -> None:
    """Catches a traceback where a sentence is owed, and code that would be needed and is not there."""
    with pytest.raises(sk.SherkitError, match="no study that can be read"):
        sk.Study.load(tmp_path)
    (tmp_path / "study.json").write_text('{"format": 99}')
    with pytest.raises(sk.SherkitError, match="of this version"):
        sk.Study.load(tmp_path)
    study = sk.Study(EXAMPLE, leaning, effects=[wave])
    study.add("wave")
    study.save(tmp_path)
    with pytest.raises(sk.errors.EffectError, match="wave"):
        sk.Study.load(tmp_path)
    with pytest.raises(sk.errors.NotWritten, match=r"study\.json: cannot be written: File exists"):
        study.save(tmp_path / "study.json")


@pytest.mark.parametrize("first", [-(10**30), 10**30, -1])
def test_a_line_that_no_table_has_is_said(leaning: sk.Measurements, tmp_path: Path, first: int) -> None:
    """Catches a number that no machine word holds, which ended in a traceback."""
    sk.Study(EXAMPLE, leaning).save(tmp_path)
    state = json.loads((tmp_path / "study.json").read_text())
    state["line"] = [[first, len(leaning)]]
    (tmp_path / "study.json").write_text(json.dumps(state))
    with pytest.raises(sk.SherkitError, match="line: expected"):
        sk.Study.load(tmp_path)


@pytest.mark.slow
def test_a_calibration_deploys_the_effects() -> None:
    """Catches an effect that is found and then left out where the robot is commanded: on the simulator's truth."""
    errors, effects = planted(4, "rail_lean", "joint_scale")
    study = sk.Study(EXAMPLE, run(4, errors, effects))
    bare = study.calibration()
    study.add("rail_lean")
    study.add("joint_scale")
    made = study.calibration()
    targets = np.random.default_rng(0).uniform(-15.0, 15.0, (200, 3))
    still = {"time_s": np.zeros(200), "temperature_c": np.full(200, 20.0), "humidity_pct": np.full(200, 45.0)}

    def misses(calibration: sk.delta.DeltaCalibration) -> Floats:
        joints = calibration.inverse_batch(targets).require()
        columns = still | {f"q{k + 1}_mm": joints[:, k] for k in range(3)}
        return np.linalg.norm(truth(ROBOT, columns, errors, effects) - targets, axis=1)

    assert misses(made).max() < 3 * NOISE_MM
    without = dataclasses.replace(bare, whole=dataclasses.replace(bare.whole, correction=None))
    assert misses(without).max() > 5 * NOISE_MM


@pytest.mark.slow
def test_a_clock_that_counts_from_1970_promises_the_same(tmp_path: Path) -> None:
    """Catches rows held out that are predicted with the drift of fifty years: 300 km were promised, and the file of it
    could not be read."""
    errors, effects = planted(11, "drift")
    promised = {}
    for begins_s in (0.0, 1.7e9):
        data = run(11, errors, effects, lambda c, begins_s=begins_s: {"time_s": np.asarray(c["time_s"]) + begins_s})
        study = sk.Study(EXAMPLE, data)
        study.add("drift")
        made = study.calibration()
        made.save(tmp_path / "calibrated.toml")
        promised[begins_s] = sk.load_calibration(tmp_path / "calibrated.toml").accuracy([3.0, -4.0, 5.0])
        assert promised[begins_s] == made.accuracy([3.0, -4.0, 5.0])
    # how far a step lies between two rows is known to the digits of the clock
    assert promised[1.7e9] == pytest.approx(promised[0.0], rel=1e-3)


def test_declared_noise_survives_a_run_that_declares_none() -> None:
    """Catches a join that silently forgets what one run knew of its noise or of its repeats."""
    errors = draw_geometric_errors(np.random.default_rng(6))
    first, second = run(6, errors), run(7, errors)
    assert second.time_s is not None
    second = replace(second, time_s=second.time_s + first.time_s.max() + 60.0)
    frame = first.to_frame().with_columns(pl.lit(0.005).alias(n) for n in ("sigma_x_mm", "sigma_y_mm", "sigma_z_mm"))
    study = sk.Study(EXAMPLE, sk.from_frame(frame))
    study.extend(second)
    n = len(first)
    np.testing.assert_allclose(study.data.sigma[:n, :3], 0.005)
    other = sk.Study(EXAMPLE, first)
    other.extend(sk.from_frame(second.to_frame().drop("pose", "repeat")))
    assert other.data.repeatability is not None


def test_a_loaded_study_whose_rows_were_taken_back_is_shown(tmp_path: Path) -> None:
    """Catches a page and a notebook without any state: of steps on other rows than the last no fit was kept, and the
    study came back to one of them."""
    errors = draw_geometric_errors(np.random.default_rng(6))
    study = sk.Study(EXAMPLE, run(6, errors))
    study.extend(sk.from_frame(run(7, errors).to_frame().with_columns(pl.col("time_s") + 5e3)))
    study.save(tmp_path)
    loaded = sk.Study.load(tmp_path)
    loaded.undo()
    assert loaded.history[0].fit is None
    ((number, state),) = states_so_far(loaded).items()
    assert (number, state.title, len(state.fit.data)) == (0, "geometry calibrated", len(loaded.data))


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("rail_leen", "did you mean 'rail_lean'"),
        ("sensor_pose", "in the model already"),
        ("humidity", "not a known effect"),
    ],
)
def test_effects_that_cannot_be_added_say_why(name: str, message: str, leaning: sk.Measurements) -> None:
    """Catches a misspelt or doubled effect that is taken, or refused without a hint."""
    study = sk.Study(EXAMPLE, leaning)
    with pytest.raises(sk.errors.EffectError, match=message):
        study.add(name)
    assert len(study.history) == 1


def test_adding_twice_removing_what_is_not_there_and_missing_columns(leaning: sk.Measurements) -> None:
    """Catches silent acceptance of each."""
    study = sk.Study(EXAMPLE, leaning)
    study.add("drift")
    with pytest.raises(sk.errors.EffectError, match="in the model already"):
        study.add("drift")
    with pytest.raises(sk.errors.EffectError, match="'slip' is not in the model"):
        study.remove("slip")
    bare = sk.from_frame(leaning.to_frame().drop("time_s", "temperature_c"))
    for name, column in (("drift", "time_s"), ("slip", "time_s"), ("thermal_growth", "temperature_c"),
                         ("backlash", "direction")):  # fmt: skip
        with pytest.raises(sk.errors.EffectError, match=column):
            sk.Study(EXAMPLE, bare).add(name)


# -- users' effects ------------------------------------------------------------------------------------------------


@sk.effect(at="sensor", parameters={"amplitude": "mm"})
def wave(rows: Any, p: Any) -> Floats:
    """The sensors follow the humidity."""
    return p.amplitude * np.outer((rows.humidity - 45.0) / 5.0, [1.0, 0.0, -1.0])


def lifted(rows: Any, p: Any) -> Floats:
    return np.full((len(rows), 3), 1.0)


def flat(rows: Any, p: Any) -> Floats:
    return np.full(len(rows), p.a)


def broken(rows: Any, p: Any) -> Floats:
    return np.full((len(rows), 3), np.nan) * p.a


def raising(rows: Any, p: Any) -> Floats:
    return p.b * np.zeros((len(rows), 3))


def unknown(rows: Any, p: Any) -> Floats:
    return p.a * np.outer(rows.humidty, [1, 1, 1])


def another(rows: Any, p: Any) -> Floats:
    return p.a * np.random.default_rng().normal(size=(len(rows), 3))


def rounded(rows: Any, p: Any) -> Floats:
    return np.round(p.a) * np.ones((len(rows), 3))


def idle(rows: Any, p: Any) -> Floats:
    return 0.0 * p.a * np.ones((len(rows), 3))


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (lifted, "'lifted' is not zero where its parameters are zero"),
        (flat, r"'flat': expected an array of shape \(288, 3\), got \(288,\)"),
        (broken, "'broken' is not finite at row 0"),
        (raising, "'raising' failed: AttributeError"),
        (unknown, "'unknown': these rows have no 'humidty'; did you mean 'humidity"),
        (another, "'another' gives another answer each time"),
    ],
)
def test_a_users_mistake_is_named(function: Any, message: str, leaning: sk.Measurements) -> None:
    """Catches a faulty function that reaches a fit, or fails there without its name."""
    made = sk.effect(at="body", parameters={"a": "mm"})(function)
    for use in (lambda: sk.Study(EXAMPLE, leaning, effects=[made]), lambda: sk.Study(EXAMPLE, leaning).add(made)):
        with pytest.raises(sk.errors.EffectError, match=message):
            use()


def test_an_effect_that_moves_nothing_is_told(leaning: sk.Measurements) -> None:
    """Catches one that vanishes from a diagnosis without a word."""
    own = [sk.effect(at="body", parameters={"a": "mm"})(one) for one in (rounded, idle)]
    found = sk.diagnose(EXAMPLE, leaning, effects=own)
    assert {found.untestable["rounded"], found.untestable["idle"]} == {"its parameters move nothing in these rows"}
    assert any("idle could not be tried" in one.answer for one in found.findings)


@pytest.mark.parametrize("size", [-1.0, 0.0])
def test_a_plausible_size_is_positive(size: float) -> None:
    """Catches a size that makes everything implausible, or of which a step is none."""
    with pytest.raises(sk.errors.EffectError, match=r"plausible size of 'a'.*give a positive number"):
        sk.effect(at="body", parameters={"a": ("mm", size)})(flat)


@pytest.mark.parametrize(
    ("made", "message"),
    [
        (sk.effect(at="body", parameters={"a": "mm"})(lifted), "not zero where its parameters are zero"),
        (sk.effect(at="body", parameters={"a": "mm"}, derivative=lambda r, p: p.no)(broken), "'broken'"),
        (dataclasses.replace(wave, name="drift"), "name of a built-in effect"),
    ],
    ids=["lifted", "derivative", "name"],
)
def test_diagnosis_without_a_study_checks_users_effects_too(
    made: sk.Effect, message: str, leaning: sk.Measurements
) -> None:
    """Catches an effect that acts at zero, breaks, or takes the place of a built-in one in ``sk.diagnose``: it must be
    refused or reported untestable with the reason."""
    try:
        d = sk.diagnose(sk.identify(EXAMPLE, leaning), effects=(made,))
    except sk.errors.EffectError as error:
        assert message in str(error)  # noqa: PT017
    else:
        assert message in d.untestable.get(made.name, "")


def test_a_wrong_declaration_is_named(leaning: sk.Measurements) -> None:
    """Catches a link that does not exist, an effect without parameters, a name that is taken."""
    with pytest.raises(sk.errors.EffectError, match="at='structure' is no link"):
        sk.effect(at="structure", parameters={"a": "mm"})
    with pytest.raises(sk.errors.EffectError, match="at least one parameter"):
        sk.effect(at="body", parameters={})
    taken = dataclasses.replace(wave, name="drift")
    with pytest.raises(sk.errors.EffectError, match="name of a built-in effect"):
        sk.Study(EXAMPLE, leaning, effects=[taken])


@sk.effect(at="joints", parameters={"sag_1": ("mm", 0.05), "sag_2": ("mm", 0.05), "sag_3": ("mm", 0.05)})
def guide(rows: Any, p: Any) -> Floats:
    """A guide that bends: each joint errs with the cube of its travel."""
    v = (rows.joints - 128.92304845413264) / 20.0
    return np.array([p.sag_1, p.sag_2, p.sag_3]) * v**3


@sk.effect(at="body", parameters={"x": ("mm", 0.05), "y": ("mm", 0.05), "z": ("mm", 0.05)})
def heave(rows: Any, p: Any) -> Floats:
    """The base heaves with a period of five minutes."""
    return np.outer(np.sin(2 * np.pi * rows.time / 300.0), [p.x, p.y, p.z])


@sk.effect(at="sensor", parameters={"gain": ("mm", 0.05), "rate": ("mm", 0.05)})
def damp(rows: Any, p: Any) -> Floats:
    """Sensors that follow the humidity, straight and squared."""
    h = (rows.humidity_pct - 45.0) / 5.0
    return np.stack([p.gain * h, p.rate * h**2, p.gain * h], axis=1)


def moved_by(effect: sk.Effect, values: Floats) -> Callable[[dict[str, Any]], dict[str, ArrayLike]]:
    """Columns with a user's effect in them, made without sherkit's chain: where joints err, the simulator runs at the
    erring joints and the file keeps the true ones; elsewhere the reading moves."""

    def change(c: dict[str, Any]) -> dict[str, ArrayLike]:
        q = np.stack([c[f"q{k}_mm"] for k in (1, 2, 3)], axis=1)
        if effect is guide:
            shift = values * ((q - 128.92304845413264) / 20.0) ** 3
            at = dict(c) | {f"q{k + 1}_mm": (q + shift)[:, k] for k in range(3)}
            moved = truth(ROBOT, at, ERRORS) - truth(ROBOT, c, ERRORS)
        elif effect is heave:
            moved = np.outer(np.sin(2 * np.pi * c["time_s"] / 300.0), values)
        else:
            h = (c["humidity_pct"] - 45.0) / 5.0
            moved = np.stack([values[0] * h, values[1] * h**2, values[0] * h], axis=1)
        return {f"{a}_mm": c[f"{a}_mm"] + moved[:, k] for k, a in enumerate("xyz")}

    return change


ERRORS = draw_geometric_errors(np.random.default_rng(8))
OWN = [(guide, [0.06, -0.04, 0.05]), (heave, [0.03, -0.02, 0.04]), (damp, [0.03, -0.05])]


@pytest.mark.parametrize(("effect", "values"), OWN, ids=lambda x: getattr(x, "name", ""))
def test_a_users_effect_at_each_link_is_recovered(effect: sk.Effect, values: list[float]) -> None:
    """Catches an effect carried to the readings by the wrong derivative, or not fitted: within 4 deviations of the
    truth (seed 8), to 1e-6 mm without noise, and found by diagnosis."""
    exact = run(8, ERRORS, change=moved_by(effect, np.array(values)), noise=0.0)
    # what turns all base angles is a turn of the sensor, where that is free, and takes the vector with it
    held = replace(EXAMPLE, sensor_pose=sk.SensorPose(turn_sd_deg=(0.0, 0.0, 0.0)))
    model = sk.delta.DeltaModel(held, (), (effect,))
    fit = sk.identify(model, exact)
    assert fit.converged
    np.testing.assert_allclose(fit.values[model.owns(effect)], values, atol=1e-6)
    study = sk.Study(EXAMPLE, run(8, ERRORS, change=moved_by(effect, np.array(values))), effects=[effect])
    d = study.diagnose()
    assert effect.name in set(d.effects).union(*d.indistinguishable)
    study.add(effect.name)
    place = study.model.owns(effect)
    assert (np.abs(study.fit.values[place] - values) < 4 * study.fit.std[place]).all()
    assert study.history[-1].error.rms < 1.1e3 * np.sqrt(3) * NOISE_MM
    assert study.diagnose().verdict == "adequate"


def d_damp(rows: Any, p: Any) -> Floats:
    h = (rows.humidity_pct - 45.0) / 5.0
    out = np.zeros((len(rows), 3, 2))
    out[:, 0, 0] = out[:, 2, 0] = h
    out[:, 1, 1] = h**2
    return out


def test_a_users_derivative_is_used_and_checked(leaning: sk.Measurements) -> None:
    """Catches a derivative that is ignored, taken unchecked, or disagrees with the difference it stands for."""
    given = dataclasses.replace(damp, derivative=d_damp)
    data = run(8, ERRORS, change=moved_by(damp, np.array([0.03, -0.05])))
    fits = [sk.identify(sk.delta.DeltaModel(EXAMPLE, (), (e,)), data) for e in (damp, given)]
    np.testing.assert_allclose(fits[0].values, fits[1].values, rtol=1e-6, atol=1e-9)
    columns = [f.model.derivatives(data, fits[0].values) for f in fits]
    np.testing.assert_allclose(columns[0][:, :3], columns[1][:, :3], atol=1e-9)
    wrong = dataclasses.replace(damp, derivative=lambda rows, p: 1.01 * d_damp(rows, p))
    with pytest.raises(sk.errors.EffectError, match="does not agree with a difference"):
        sk.Study(EXAMPLE, leaning, effects=[wrong])
    short = dataclasses.replace(damp, derivative=lambda rows, p: d_damp(rows, p)[:, :2])
    with pytest.raises(sk.errors.EffectError, match="shape"):
        sk.Study(EXAMPLE, leaning, effects=[short])
    raises = dataclasses.replace(damp, derivative=lambda rows, p: d_damp(rows, p) * p.nothing)
    with pytest.raises(sk.errors.EffectError, match="damp"):
        sk.Study(EXAMPLE, leaning, effects=[raises])


# -- what a diagnosis says -------------------------------------------------------------------------------------------


def test_how_sure_it_is_stands_with_what_it_is_of() -> None:
    """Catches a p of the effects that were found behind a sentence on what is left."""
    told = Finding("What is wrong?", "brings", "It falls to 5.5 µm. That is not all: more is left.", sure="p < 1e-16")
    assert str(told) == "It falls to 5.5 µm (p < 1e-16). That is not all: more is left."
    assert str(dataclasses.replace(told, answer="It falls to 5.5 µm.")) == "It falls to 5.5 µm (p < 1e-16)."


def test_what_is_left_is_said_of_what_was_tried() -> None:
    """Catches "no pattern that is known" where effects of the catalogue have not been ruled out."""
    left = Check("nothing_left", "nothing is left", "all rows", "", holds=False, fails="what is left has a structure")
    found: Any = SimpleNamespace(signature=None, checks=(left,))
    said = "what is left is more than noise, but no effect and no shape that was tried is clear in it by itself"
    assert findings._rest(found) == said
    assert "known" not in findings._rest(SimpleNamespace(signature=None, checks=()))  # type: ignore[arg-type]
