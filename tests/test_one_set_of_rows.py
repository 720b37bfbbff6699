"""What is left out is one decision: every number, picture and file is of the same rows."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import polars as pl
import pytest

import sherkit as sk
from sherkit.cli import main
from strategies import EXAMPLE

LINE = 131  # of the file: its header is line 1


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of a delta of which one reading is 25 mm off, and the same run without that row's mistake."""
    folder = tmp_path_factory.mktemp("rows")
    robot = EXAMPLE
    sk.save_robot(robot, folder / "robot.toml")
    places = np.random.default_rng(4).uniform(-18.0, 18.0, (100, 3))
    run = sk.delta.VirtualDelta.draw(robot, 4, noise_mm=0.002).measure(places, repeats=2, seed=4)
    run.save(folder / "clean.csv")
    frame = pl.read_csv(folder / "clean.csv").with_row_index("row")
    off = pl.when(pl.col("row") == LINE - 2).then(pl.col("y_mm") + 25.0).otherwise(pl.col("y_mm"))
    frame.with_columns(off.alias("y_mm")).drop("row").write_csv(folder / "run.csv")
    return folder


def test_the_study_and_all_that_is_made_of_it_leave_the_row_out(lab: Path) -> None:
    """Catches the bad row in an error, a parameter, or a calibration while a diagnosis leaves it out."""
    study, clean = (sk.Study(lab / "robot.toml", lab / name) for name in ("run.csv", "clean.csv"))
    assert study.data.line[study.left_out].tolist() == [LINE]
    assert not len(clean.left_out)
    error = study.history[0].error
    assert error.rms == pytest.approx(clean.history[0].error.rms, rel=0.02)
    assert f"left out as gross errors: line {LINE}" in str(study)
    found = study.diagnose()
    assert found.outliers.tolist() == study.left_out.tolist()
    assert found.steps[0].error.rms == pytest.approx(error.rms, rel=1e-4)
    assert f"line {LINE} is 25.0 mm off and left out" in " ".join(found.notes)
    np.testing.assert_allclose(study.fit.values, clean.fit.values, atol=3 * clean.fit.std_from_readings.max())
    left = sk.calibrate(lab / "robot.toml", lab / "run.csv", correction="none").whole
    np.testing.assert_allclose(left.fit.values, study.fit.values, atol=1e-9)
    assert left.fit.error.rms == pytest.approx(error.rms, rel=1e-6)
    # and where a person wants it in, every number has it
    with pytest.warns(sk.SherkitWarning, match=f"line {LINE} looks wrong"):
        used = sk.calibrate(lab / "robot.toml", lab / "run.csv", correction="none", with_outliers=True).whole
    study.put_back()
    assert study.history[-1].error.rms == pytest.approx(used.fit.error.rms, rel=1e-6)
    assert study.diagnose().steps[0].error.rms == pytest.approx(study.history[-1].error.rms, rel=1e-3)
    assert study.history[-1].error.rms > 100 * error.rms


@pytest.mark.slow
def test_terminal_json_and_report_are_of_the_same_rows(lab: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches a report whose parameters, errors or axes have the row in that its verdict leaves out."""

    def said(*given: str) -> str:
        with pytest.raises(SystemExit):
            main([str(lab / one) if re.search(r"\.(toml|csv|html)$", one) else one for one in given])
        return capsys.readouterr().out

    error = sk.Study(lab / "robot.toml", lab / "run.csv").history[0].error
    told = json.loads(said("diagnose", "robot.toml", "run.csv", "--json"))
    assert told["outliers"] == [LINE]
    assert told["steps"][0]["error"]["rms"] == pytest.approx(error.rms, rel=1e-4)
    calibrated = json.loads(said("calibrate", "robot.toml", "run.csv", "--correction", "none", "--json"))["whole"]
    assert calibrated["outliers"] == [LINE]
    assert calibrated["error"]["rms"] == pytest.approx(error.rms, rel=1e-4)
    shown = said("calibrate", "robot.toml", "run.csv", "--correction", "none", "--report", "report.html")
    assert f"1 gross error, line {LINE}: left out; --with-outliers uses them" in " ".join(shown.split())
    report = (lab / "report.html").read_text(encoding="utf-8")
    assert f"lines {LINE}" in report
    found = re.search(r'id="bar_before">([\d.]+)', report)
    assert float(found[1]) == pytest.approx(error.rms, rel=6e-3)
