"""One model's error is one figure, wherever a person reads it: in space the distance in 3-D, in pixels their length,
on rows held out."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

import sherkit as sk
from changed_worlds import somewhere
from running import command, slow, thin
from second_simulator.geometry import NOMINAL_CONFIG, Robot, draw_geometric_errors
from second_simulator.plans import make_plan
from second_simulator.simulate import scaled_effect, truth
from sherkit.cli import main
from sherkit.fit.error import ErrorSize
from sherkit.model.kinds import known_kinds, robot_from_tables
from sherkit.report.residuals import residuals_of
from sherkit.report.states import states_so_far

#: Each robot with what is planted in its run, and where and how often it is read.
ROBOTS = {
    "delta": ("--rail-lean-mrad", "8", "--poses", "local", "--repeats", "2"),
    "spherical": ("--joint-offset-mrad", "20", "--poses", "local", "--repeats", "2"),
    "serial": ("--ring-mrad", "0.4", "--repeats", "3"),
}
Say = Callable[..., str]


@pytest.fixture(params=["delta", *slow("spherical", "serial")])
def say(request: pytest.FixtureRequest, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Say:
    """Runs a verb on ``robot.toml`` and ``run.csv`` of this robot, and gives what it prints."""
    planted = ROBOTS[request.param]
    sk.save_robot(known_kinds()[request.param].example, tmp_path / "robot.toml")

    def said(*given: str) -> str:
        with pytest.raises(SystemExit) as end:
            main([str(tmp_path / one) if re.search(r"\.(toml|csv|html)$", one) else one for one in given])
        assert end.value.code in (0, None)
        return capsys.readouterr().out

    said("simulate", "robot.toml", "-o", "run.csv", "--order", "shuffled", "--seed", "3", *planted)
    thin(tmp_path / "run.csv", 3)
    said.folder = tmp_path  # type: ignore[attr-defined]
    return said


def figure(text: str, pattern: str) -> float:
    """The number that a pattern finds in a text."""
    found = re.search(pattern, text)
    assert found is not None, f"{pattern} is not in\n{text}"
    return float(found[1])


def same(shown: float, value: float) -> None:
    """As near as figures on a screen are."""
    assert shown == pytest.approx(value, rel=6e-3, abs=6e-3)


def test_every_place_says_the_same_error(say: Say) -> None:
    """Catches an error per coordinate beside one in 3-D, fitted rows for rows held out, and a state of another model:
    study, fit, diagnosis, terminal, JSON, table over runs, report and calibration are asked, before and after."""
    folder: Path = say.folder  # type: ignore[attr-defined]
    robot, run = folder / "robot.toml", folder / "run.csv"
    study = sk.Study(robot, run)
    found = study.diagnose()
    before = study.history[0].error
    assert found.effects
    assert before.held_out
    same(found.steps[0].error.rms, before.rms)
    same(figure(str(study), r"geometry calibrated\s+([\d.]+)"), before.rms)
    same(figure(str(study.fit), r"error\s+([\d.]+)"), before.rms)
    same(figure(str(study.fit), r"95 % within ([\d.]+)"), before.p95)
    same(figure(str(found), r"geometry calibrated\s+([\d.]+)"), before.rms)
    same(figure(found.finding("brings").answer, r"falls from ([\d.]+)"), before.rms)
    row = found.row()
    same(next(float(str(row[key])) for key in row if key.startswith("before_")), before.rms)
    told = json.loads(say("diagnose", "robot.toml", "run.csv", "--json"))
    same(told["steps"][0]["error"]["rms"], before.rms)
    shown = " ".join(say("diagnose", "robot.toml", "run.csv", "--report", "report.html").split())
    same(figure(shown, r"│ geometry calibrated │ ([\d.]+)"), before.rms)
    same(figure(shown, r"falls from ([\d.]+)"), before.rms)
    report = (folder / "report.html").read_text(encoding="utf-8")
    same(figure(report, r'id="bar_before">([\d.]+)'), before.rms)
    plain = json.loads(say("calibrate", "robot.toml", "run.csv", "--correction", "none", "--json"))
    same(plain["whole"]["error"]["rms"], before.rms)

    for name in found.effects:
        study.add(name)
    after = study.history[-1].error
    same(found.error.rms, after.rms)
    same(told["error"]["rms"], after.rms)
    same(told["error"]["p95"], after.p95)
    same(figure(report, r'id="bar_after">([\d.]+)'), after.rms)
    same(figure(shown, r"falls from [\d.]+ to ([\d.]+)"), after.rms)
    same(figure(str(study), rf"\+ {study.effects[-1]}\s+([\d.]+)"), after.rms)
    added = [part for name in found.effects for part in ("--effect", name)]
    last = json.loads(say("calibrate", "robot.toml", "run.csv", "--correction", "none", "--json", *added))
    same(last["whole"]["error"]["rms"], after.rms)


def test_the_error_is_the_length_of_all_axes_on_rows_held_out() -> None:
    """Catches a length over axes that were not read, marked rows that count, and errors of rows that were fitted."""
    robot = known_kinds()["delta"].example
    run = sk.delta.VirtualDelta.draw(robot, 2, noise_mm=0.005).measure(
        np.random.default_rng(2).uniform(-18.0, 18.0, (60, 3)), repeats=2, seed=2
    )
    fit = sk.identify(robot, run.mark_outliers(np.array([5])))
    error = fit.error
    assert (error.axes, error.rows, error.unit, error.held_out) == (3, len(run) - 1, "µm", True)
    assert error.rms == pytest.approx(np.linalg.norm(list(error.by_reading.values())), rel=1e-9)
    assert error.mean < error.rms < error.p95 < error.max
    fitted = 1e3 * np.linalg.norm(fit.residuals[fit.data.used[:, :3].all(axis=1), :3], axis=1)
    assert error.rms > np.sqrt(np.mean(fitted**2))
    # a fit without each block, made anew, says nearly the same
    held = sk.fit.hold_out(fit.model, fit.data, folds=6).residuals
    again = 1e3 * np.linalg.norm(held[fit.data.used[:, :3].all(axis=1), :3], axis=1)
    assert error.rms == pytest.approx(np.sqrt(np.mean(again**2)), rel=0.05)


@pytest.mark.parametrize(
    ("squares", "rms", "rows"),
    [
        ([[9.0, 16.0], [0.0, 0.0]], np.sqrt(12.5), 2),
        ([[9.0, 16.0], [np.nan, 4.0]], 5.0, 1),
        ([[9.0, np.nan], [np.nan, 4.0]], np.sqrt(6.5), 2),
        ([[np.nan, np.nan]], np.nan, 0),
    ],
)
def test_rows_that_hold_a_part_count_where_none_holds_all(squares: Any, rms: float, rows: int) -> None:
    """Catches a missing reading taken for zero, and a length of NaN."""
    made = ErrorSize.of(np.array(squares), "px", held_out=False, names=("u", "v"), together=(0, 1))
    assert made.rows == rows
    assert made.rms == pytest.approx(rms, nan_ok=True)


@pytest.mark.parametrize("poses", [2, 3])
def test_poses_that_a_fit_goes_through_are_held_out_by_fits_of_their_own(poses: int) -> None:
    """Catches an error of nothing where a fit has more parameters than readings, and goes through all of them."""
    robot = known_kinds()["delta"].example
    places = np.random.default_rng(1).uniform(-18.0, 18.0, (poses, 3))
    run = sk.delta.VirtualDelta.draw(robot, 1, noise_mm=0.005).measure(places, repeats=1, seed=1)
    fit = sk.identify(robot, run, priors=False)
    assert fit.rms()["x_mm"] < 1.0
    assert fit.error.held_out
    assert fit.error.rms > 50.0


@pytest.mark.slow
def test_what_an_effect_moves_between_repeats_is_no_noise(tmp_path: Path) -> None:
    """Catches play that is counted as noise once it is in the model: the page, a report, a study, a calibration and its
    table have the noise that was put in, and the same figure; without the effect it is three times as large."""
    robot = robot_from_tables(deepcopy(NOMINAL_CONFIG), "nominal")
    real, rng = Robot.from_dict(NOMINAL_CONFIG), np.random.default_rng(4)
    plan, errors = make_plan(real, somewhere(rng, 80), 3, "shuffled", 4), draw_geometric_errors(rng)
    seen = truth(real, plan, errors, scaled_effect(real, plan, "backlash", rng, 0.01, errors=errors))
    read = seen + 0.004 * rng.normal(size=seen.shape)
    pl.DataFrame({**plan, **dict(zip(("x_mm", "y_mm", "z_mm"), read.T, strict=True))}).write_csv(tmp_path / "run.csv")
    sk.save_robot(robot, tmp_path / "robot.toml")
    study = sk.Study(tmp_path / "robot.toml", tmp_path / "run.csv")
    raw = residuals_of(study.fit).noise_size
    found = study.diagnose()
    assert found.effects == ("backlash",)
    study.add("backlash")
    noise = found.noise_size
    assert noise == pytest.approx(4.0 * np.sqrt(3), rel=0.06)
    assert raw > 2.0 * noise
    assert [len(known) for known in (states_so_far(study), states_so_far(study, found))] == [2, 2]
    for one in states_so_far(study, found).values():
        same(one.left.noise_size, noise)
    same(residuals_of(study.fit).noise_size, noise)
    assert study.fit.scale == pytest.approx(1.0, abs=0.1)
    _, out, _ = command(tmp_path, "diagnose", "robot.toml", "run.csv", "--report", "report.html")
    same(figure(" ".join(out.split()), r"the noise is ([\d.]+)"), noise)
    same(figure((tmp_path / "report.html").read_text(encoding="utf-8"), r'id="bar_noise">([\d.]+)'), noise)
    _, out, _ = command(tmp_path, "calibrate", "robot.toml", "run.csv", "--effect", "backlash", "--json")
    same(np.linalg.norm(list(json.loads(out)["whole"]["noise"]["repeatability_um"].values())), noise)
