"""Files that mean harm or nothing, and machines that lack something: each is told in a sentence, at once."""

from __future__ import annotations

import contextlib
import sqlite3
import sys
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import sherkit as sk
from laboratories import experiment, laboratory, spherical_laboratory
from mutations import at_most
from sherkit.cli.demo import EXAMPLE
from sherkit.errors import CalibrationError, ExperimentError, SherkitError
from sherkit.lab.experiment import RunFile, load_experiment
from sherkit.lab.laboratory import RunningLaboratory, load_laboratory
from sherkit.robots.delta.robot import grid
from sherkit.robots.delta.virtual import VirtualDelta
from test_commands_fuzz import run
from test_fuzz import toml

_ENDLESS = "WITH RECURSIVE n(k) AS (SELECT 1 UNION ALL SELECT k + 1 FROM n)"


@pytest.mark.parametrize("what", ["view", "trigger"])
def test_a_run_file_that_would_run_for_ever_is_refused(what: str, tmp_path: Path) -> None:
    """Catches a view in the place of a table, or a trigger, that somebody else's file brings along."""
    laboratory(tmp_path)
    chosen = load_experiment(experiment(tmp_path), offline=True)
    path = tmp_path / "run.sqlite"
    RunFile.create(path, chosen.plan, chosen.about()).close()
    with sqlite3.connect(path) as db:
        if what == "view":
            db.execute("DROP TABLE reading")
            db.execute(f"CREATE VIEW reading AS {_ENDLESS} SELECT k step, 1 place, 'x' name, k value FROM n")
        else:
            db.execute(f"CREATE TRIGGER t AFTER INSERT ON point BEGIN SELECT * FROM ({_ENDLESS} SELECT k FROM n); END")
    db.close()
    with at_most(5.0), pytest.raises(ExperimentError, match="holds no run of this version"):
        RunFile.open(path).frame()


@pytest.mark.parametrize("meaning", ["{", "[1]", '{"rails": 1}'])
def test_a_run_whose_meaning_is_damaged_is_not_gone_on_with(meaning: str, tmp_path: Path) -> None:
    """Catches a traceback where a run is resumed that does not say any more what its instruments' numbers mean."""
    laboratory(tmp_path)
    chosen = load_experiment(experiment(tmp_path), offline=True)
    path = tmp_path / "run.sqlite"
    RunFile.create(path, chosen.plan, chosen.about()).close()
    with contextlib.closing(sqlite3.connect(path)) as db, db:
        db.execute("UPDATE run SET value = ? WHERE key = 'meaning'", (meaning,))
    with pytest.raises(ExperimentError, match="is damaged and cannot be read"):
        RunFile.resume(path, chosen.plan, chosen.about())


def test_a_run_file_whose_schema_is_no_text_is_refused(tmp_path: Path) -> None:
    """Catches a traceback where SQLite quotes a damaged file in what it says of it."""
    laboratory(tmp_path)
    chosen = load_experiment(experiment(tmp_path), offline=True)
    path = tmp_path / "run.sqlite"
    RunFile.create(path, chosen.plan, chosen.about()).close()
    path.write_bytes(path.read_bytes().replace(b"CREATE TABLE diary", b"CREATE TABLE \xf0\xf0\xf0\xf0\xf0"))
    with pytest.raises(ExperimentError, match="cannot be opened as a run file"):
        RunFile.open(path)


def a_parameter(key: str, value: Any) -> Callable[[dict[str, Any]], None]:
    return lambda tables: tables["whole"]["parameters"][0].update({key: value})


def huge(tables: dict[str, Any]) -> None:
    tables["whole"]["covariance"][0][0] = 1e160


def large(tables: dict[str, Any]) -> None:
    tables["whole"]["covariance"][0][0] = 1e16
    tables["whole"]["parameters"][0]["std"] = 1e8


def residual(tables: dict[str, Any]) -> None:
    tables["whole"]["residual_covariance_mm2"] = [[1e60, 0.0, 0.0], [0.0, 1e60, 0.0], [0.0, 0.0, 1e60]]


def of_unshown(key: str, row: int, value: float) -> Callable[[dict[str, Any]], None]:
    """A number in what the poses could not show; of the moment and of what is shown the one on the diagonal."""
    return lambda tables: tables["whole"]["unobserved_effects"][0][key][row].__setitem__(row, value)


@pytest.fixture(scope="module")
def calibrated(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The file of a calibration that is sound."""
    virtual = VirtualDelta.draw(EXAMPLE, 6, noise_mm=0.005)
    data = virtual.measure(grid(20.0, 3, (-15.0, 15.0)), repeats=2, seed=1)
    path = tmp_path_factory.mktemp("calibrated") / "calibrated.toml"
    sk.Study(EXAMPLE, data).calibration().save(path)
    sk.load_calibration(path)
    return path.read_text()


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (huge, "covariance: expected"),
        (large, "no robot is so far off"),
        (residual, "residual_covariance"),
        (of_unshown("absorbed", 0, 1e30), "larger than any robot"),
        (of_unshown("absorbed", 1, -9223372036854775809), "larger than any robot"),
        (of_unshown("moment", 0, 1e12), "larger than any robot"),
        (of_unshown("shown", 0, 1e12), "larger than any robot"),
        (a_parameter("unit", "m"), "is in mm, found 'm'"),
        (a_parameter("value", 1e30), "expected a number, of a size from"),
        (a_parameter("std", 1e-9), "by the covariance it is"),
        (a_parameter("sigma", 1.0), "unknown key"),
        (lambda tables: tables.update(extra=1), "unknown key extra"),
        (lambda tables: tables["robot"].update(kind=["delta"]), "kind"),
    ],
)
def test_an_absurd_calibration_is_refused(
    change: Callable[[dict[str, Any]], None], says: str, calibrated: str, tmp_path: Path
) -> None:
    """Catches a file of somebody else's, or one in other units, that would be deployed to a control loop."""
    path = tmp_path / "calibrated.toml"
    tables = tomllib.loads(calibrated)
    change(tables)
    path.write_bytes(toml(tables))
    with pytest.raises(CalibrationError, match=says) as caught:
        sk.load_calibration(path)
    assert str(path) in str(caught.value)


def test_a_camera_is_not_emulated_without_opencv(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Catches a traceback where an extra is not installed."""
    chosen = load_laboratory(spherical_laboratory(tmp_path))
    monkeypatch.setitem(sys.modules, "cv2", None)
    with pytest.raises(ExperimentError, match=r"needs OpenCV: pip install \"sherkit\[vision\]\""):
        RunningLaboratory(chosen).__enter__()


def test_a_seed_below_zero_is_refused(tmp_path: Path) -> None:
    """Catches a seed that NumPy refuses where the numbers are drawn, far from where it was given."""
    laboratory(tmp_path, seed=-1)
    with pytest.raises(ExperimentError, match="seed: expected a whole number of at least 0, found -1"):
        load_laboratory(tmp_path / "lab.toml")
    with pytest.raises(ExperimentError, match=r"\[plan\] seed: expected a whole number of at least 0, found -1"):
        load_experiment(experiment(tmp_path, plan={"seed": -1}), offline=True)
    code, _, err = run(["simulate", str(tmp_path / "robot.toml"), "-o", str(tmp_path / "x.csv"), "--seed", "-1"])
    assert code == 2
    assert "-1 is not in the range x>=0" in err


@pytest.mark.parametrize("lacking", [["x_mm", "y_mm"], ["x_mm"]])
def test_a_run_in_time_that_lacks_an_axis_is_diagnosed(lacking: list[str], tmp_path: Path) -> None:
    """Catches heights alone, with times, that end in a traceback: the slip and the drift look at every axis."""
    virtual = VirtualDelta.draw(EXAMPLE, 6, rail_lean_rad=8e-3, noise_mm=0.005)
    data = virtual.measure(grid(20.0, 4, (-15.0, 0.0, 15.0)), repeats=2, seed=1).to_frame().drop(lacking)
    assert "time_s" in data.columns
    data.write_csv(tmp_path / "run.csv")
    sk.save_robot(EXAMPLE, tmp_path / "robot.toml")
    code, out, err = run(["diagnose", str(tmp_path / "robot.toml"), str(tmp_path / "run.csv")])
    assert (code, err) == (0, ""), err
    assert out


@pytest.mark.parametrize(
    ("name", "text", "says"),
    [
        ("run.csv", "q1_mm,x_mm\n1,2\n", "the robot stands before the run"),
        ("printer.cfg", "[printer]\nkinematics: delta\n", "for sherkit printer"),
        ("arm.urdf", "<robot/>", "sherkit import urdf"),
    ],
)
def test_a_file_in_the_place_of_another_is_told_where_it_belongs(
    name: str, text: str, says: str, tmp_path: Path
) -> None:
    """Catches 'is not valid TOML' for what is a good file of another command."""
    (tmp_path / name).write_text(text)
    with pytest.raises(SherkitError, match=says):
        sk.load_robot(tmp_path / name)


def test_recordings_in_the_place_of_a_run_are_told_who_reads_them(tmp_path: Path) -> None:
    """Catches a bag that is 'a folder', and bluesky's documents that are a table with a thousand columns."""
    (tmp_path / "bag").mkdir()
    (tmp_path / "bag" / "bag_0.db3").write_bytes(b"")
    (tmp_path / "documents.jsonl").write_text('["start", {"uid": "1"}]\n')
    for name, says in (("bag", "sk.from_rosbag"), ("documents.jsonl", "sk.from_bluesky")):
        with pytest.raises(SherkitError, match=says):
            sk.read_measurements(tmp_path / name)
