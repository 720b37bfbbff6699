"""The flexible tool from the command line, on files alone, and the example that prints the paper's table."""

from __future__ import annotations

import json
import re
import runpy
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from click.testing import CliRunner

from second_tool import CONDITIONS, write_csv
from sherkit.cli.verbs import cli
from sherkit.cli.verbs import run as run_typed
from sherkit.robots.tool.effects import TOOL_CATALOGUE
from sherkit.robots.tool.tool import load_tool
from test_tool import TOOL


def sherkit(*arguments: str | Path) -> Any:
    return CliRunner().invoke(cli, [str(a) for a in arguments])


def test_story_from_the_command_line(tmp_path: Path) -> None:
    """Catches a verb that does not know the tool: simulate, register, estimate, diagnose, on files alone."""
    there = tmp_path / "tool.toml"
    TOOL.save(there)
    unregistered = tmp_path / "unregistered.toml"
    replace(TOOL, camera_rotation_rad=(0.0,) * 3, camera_translation_mm=(0.0,) * 3, camera_delay_s=0.0).save(
        unregistered
    )
    for name, experiment in (("free.csv", "free"), ("run.csv", "vessels")):
        made = sherkit("simulate", there, "-o", tmp_path / name, "--experiment", experiment, "--seconds", "30")
        assert made.exit_code == 0, made.output
    made = sherkit("register", unregistered, tmp_path / "free.csv", "-o", tmp_path / "registered.toml")
    assert made.exit_code == 0, made.output
    found = load_tool(tmp_path / "registered.toml")
    assert found.camera_delay_s == pytest.approx(TOOL.camera_delay_s, abs=2e-3)
    np.testing.assert_allclose(found.camera_rotation_rad, TOOL.camera_rotation_rad, atol=0.03)
    files = ("-o", tmp_path / "out.csv", "--report", tmp_path / "run.html")
    made = sherkit("estimate", tmp_path / "registered.toml", tmp_path / "run.csv", *files)
    assert made.exit_code == 0, made.output
    assert "Error of the depth" in made.output
    assert "95 % cover" in made.output
    assert "Verdict: the depth is" in made.output
    assert "NIS / expected" not in made.output
    out = pl.read_csv(tmp_path / "out.csv")
    assert len(out) == 6001
    assert out["depth_mm"].is_finite().all()
    assert (tmp_path / "run.html").stat().st_size > 10_000
    told = json.loads(sherkit("estimate", tmp_path / "registered.toml", tmp_path / "run.csv", "--json").stdout)
    tip = told["errors_mm"]["tip"]
    assert tip["filter"]["t0"] < 0.4 * tip["kinematics"]["t0"]
    late = tmp_path / "late.toml"
    replace(TOOL, camera_delay_s=TOOL.camera_delay_s + 0.05).save(late)
    short = ("--experiment", "vessels", "--seconds", "12")
    assert sherkit("simulate", there, "-o", tmp_path / "short.csv", *short).exit_code == 0
    diagnosis = json.loads(sherkit("diagnose", late, tmp_path / "short.csv", "--json").stdout)
    assert "camera_delay" in {*diagnosis["effects"], *(name for tie in diagnosis["indistinguishable"] for name in tie)}


@pytest.fixture(scope="module")
def bench_and_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a tool, its bench, its free motion and its run."""
    folder = tmp_path_factory.mktemp("tables")
    TOOL.save(folder / "tool.toml")
    for name, experiment in (("bench", "bench"), ("free", "free"), ("run", "phantom")):
        made = sherkit("simulate", folder / "tool.toml", "-o", folder / f"{name}.csv", "--experiment", experiment,
                       "--seconds", "12")  # fmt: skip
        assert made.exit_code == 0, made.output
    return folder


def test_tables_of_a_tool_are_checked(bench_and_run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches a refusal that advises a command which knows no tool, and one mistake that hides another."""
    tool, run, bench = (bench_and_run / name for name in ("tool.toml", "run.csv", "bench.csv"))
    for table in (run, bench):
        made = sherkit("check", table, tool)
        assert (made.exit_code, "nothing is wrong with it" in made.output) == (0, True), made.output
    turned = [f"robot_r{axis}_rad" for axis in "xyz"]
    wrong = bench_and_run / "wrong.csv"
    pl.read_csv(run).with_columns(pl.col("time_s") * 1000.0, *(pl.col(name) * 57.3 + 5.0 for name in turned)).write_csv(
        wrong
    )
    with pytest.raises(SystemExit):
        run_typed(["estimate", str(tool), str(wrong)])
    said = " ".join(capsys.readouterr().err.split())
    assert f"sherkit check {wrong} {tool} lists all that is wrong with it" in said
    told = sherkit("check", wrong, tool, "--json")
    assert told.exit_code == 1
    sentences = [one["said"] for one in json.loads(told.stdout)["wrong"]]
    assert any("is time_s in another unit?" in one for one in sentences)
    assert any("are they degrees?" in one for one in sentences)
    pl.read_csv(bench).rename({"fbg4_nm": "fbg_4"}).drop("force_y_mn").write_csv(wrong)
    sentences = [one["said"] for one in json.loads(sherkit("check", wrong, tool, "--json").stdout)["wrong"]]
    assert sentences[0] == "column 'force_y_mn' is missing"
    assert [one.split(" Then ")[0] for one in sentences[1:]] == [
        "column 'fbg4_nm' is missing; is 'fbg_4' meant to be it?"
    ]


def test_rows_that_are_doubled_or_out_of_order_are_mended(bench_and_run: Path) -> None:
    """Catches --write that is offered and refused, rows that are lost by it, and a dead fibre that passes `check`."""
    tool, wrong, clean = (bench_and_run / name for name in ("tool.toml", "wrong.csv", "clean.csv"))
    frame = pl.read_csv(bench_and_run / "run.csv", infer_schema_length=None)
    rows = np.arange(len(frame))
    rows[[40, 41, 90, 91]] = 41, 40, 91, 90
    frame[np.sort(np.append(np.arange(len(frame)), [7, 300]))][np.append(rows, [len(rows), len(rows) + 1])].write_csv(
        wrong
    )
    told = sherkit("check", wrong, tool)
    assert (told.exit_code, "--write clean.csv" in told.output) == (1, True)
    said = " ".join(told.output.split())
    assert "2 rows stand behind later ones" in said
    assert "2 rows are there twice" in said
    assert sherkit("check", wrong, tool, "--write", clean).exit_code == 0
    assert pl.read_csv(clean, infer_schema_length=None).equals(frame)
    frame.with_columns(
        fbg6_nm=pl.when(pl.col("time_s") < 3.0).then("fbg6_nm").otherwise(0.0 * pl.col("fbg6_nm"))
    ).write_csv(wrong)
    told = sherkit("check", wrong, tool, "--write", clean)
    assert (told.exit_code, "nothing was written" in told.output) == (1, True)
    assert "fbg6_nm: " in told.output


def test_calibrations_of_a_tool_are_told_to_programs(bench_and_run: Path) -> None:
    """Catches --json that is taken and left alone, and a file that is written without it only."""
    tool, made = bench_and_run / "tool.toml", bench_and_run / "made.toml"
    told = json.loads(sherkit("calibrate", tool, bench_and_run / "bench.csv", "-o", made, "--json").stdout)
    assert told["read_as"] == {"depth": "axis", "force": "across"}
    assert told["tool"] == load_tool(made).to_tables()
    told = json.loads(sherkit("register", tool, bench_and_run / "free.csv", "--json").stdout)
    assert told["delay_s"] == pytest.approx(TOOL.camera_delay_s, abs=5e-3)
    assert told["tool"]["kind"] == "flexible_tool"


def test_rows_that_are_missing_are_said(bench_and_run: Path) -> None:
    """Catches a hole of seconds in a run that shows as a lower rate alone."""
    tool, some = bench_and_run / "tool.toml", bench_and_run / "some.csv"
    pl.read_csv(bench_and_run / "run.csv").filter(~pl.col("time_s").is_between(4.0, 7.0)).write_csv(some)
    said = sherkit("estimate", tool, some).output
    assert "rows of the robot at 200 Hz" in said
    assert re.search(r"No row of the robot came from (3\.99|4\.00) to 7\.0[01] s", " ".join(said.split()))


@pytest.mark.slow
def test_a_story_says_what_does_not_hold(bench_and_run: Path) -> None:
    """Catches checks that fail on the page and are silent in the terminal."""
    wrong, made = bench_and_run / "swapped.csv", bench_and_run / "story.toml"
    names = {"robot_x_mm": "robot_y_mm", "robot_y_mm": "robot_x_mm"}
    pl.read_csv(bench_and_run / "run.csv").rename(names).write_csv(wrong)
    story = ("tool", bench_and_run / "bench.csv", bench_and_run / "free.csv", wrong, "-o", made)
    said = " ".join(sherkit(*story).output.split())
    told = json.loads(sherkit(*story, "--json").stdout)
    failed = [one["tested"] for one in told["diagnosis"]["checks"] if one["holds"] is False]
    assert failed
    assert all(f"{one}: no," in said for one in failed)
    assert told["trust"]["verdict"] != "trusted"
    assert all(" ".join(one.split()) in said for one in told["trust"]["noticed"])


@pytest.mark.slow
def test_three_tables_make_a_tool(tmp_path: Path) -> None:
    """Catches a step of the story that is left out: clock and creep that no file says; second simulator."""
    world = replace(CONDITIONS["exact_rod"], camera_delay_s=0.02)
    crept = world.gratings.rest_nm + np.array([0.008, -0.003, -0.005, *[0.0] * 6])
    later = replace(world, camera_delay_s=0.05, gratings=replace(world.gratings, rest_nm=crept))
    write_csv(world.bench(), tmp_path / "bench.csv")
    write_csv(later.run("vessels", seconds=20.0, seed=1).columns(), tmp_path / "run.csv")
    write_csv(replace(later, camera_delay_s=0.02).run("free", seconds=10.0).columns(), tmp_path / "free.csv")
    tables = [tmp_path / f"{name}.csv" for name in ("bench", "free", "run")]
    made = sherkit("tool", *tables, "-o", tmp_path / "made.toml", "--report", tmp_path / "made.html", "--json")
    assert made.exit_code == 0, made.output
    told = json.loads(made.stdout)
    assert told["written"] == ["camera_delay"]
    assert told["errors_mm"]["after"]["tip"]["filter"] < 0.8 * told["errors_mm"]["before"]["tip"]["filter"]
    assert told["errors_mm"]["after"]["depth"]["filter"] < 0.25
    tool = load_tool(tmp_path / "made.toml")
    assert tool.to_tables() == told["tool"]
    assert tool.camera_delay_s == pytest.approx(0.05, abs=2e-3)
    # what is common to three fibres is no force, and no tare
    off = (np.array(tool.reference_nm) - crept)[:6].reshape(2, 3)
    assert np.abs(off - off.mean(axis=1, keepdims=True)).max() < 2e-4
    assert "earns its place" in (tmp_path / "made.html").read_text()
    page = sherkit("app", tmp_path / "made.toml", tmp_path / "run.csv", "--no-open")
    assert page.exit_code == 0, page.output
    assert "NEES" in (tmp_path / "run.story.html").read_text()


def test_the_papers_experiments_are_printed(capsys: pytest.CaptureFixture[str]) -> None:
    """Catches an example that stops working, or whose figures fall behind the paper's; one seed."""
    told = runpy.run_path(str(Path(__file__).parents[1] / "examples" / "flexible_tool.py"))["main"](1)
    for name, sensor, least in (
        ("phantom", "gratings", 0.94),
        ("bends", "kinematics", 0.77),
        ("vessels", "kinematics", 0.77),
    ):
        raw, paper, ours = (told[name][signal] for signal in (sensor, "paper's noise", "noise by force"))
        assert 1 - paper[1] / raw[1] > least
        assert ours[1] < paper[1]
        assert ours[2] < paper[2] + 0.01
    assert "(simulation beside the paper)" in capsys.readouterr().out


def test_wrong_words_are_refused(tmp_path: Path) -> None:
    """Catches a tool that is taken for a robot, and a robot's option that is taken for a tool's."""
    TOOL.save(tmp_path / "tool.toml")
    (tmp_path / "robot.toml").write_text("")
    for arguments, says in (
        (
            ("simulate", tmp_path / "tool.toml", "-o", tmp_path / "x.csv", "--noise-px", "1"),
            "--noise-px is not for that kind",
        ),
        (("simulate", tmp_path / "tool.toml", "-o", tmp_path / "x.csv", "--seconds", "1"), "--seconds"),
        (("estimate", tmp_path / "none.toml", tmp_path / "x.csv"), "there is no such tool file"),
        (("estimate", tmp_path / "tool.toml", tmp_path / "x.csv"), "there is no such file"),
        (
            ("calibrate", tmp_path / "tool.toml", "a.csv", "--effect", "nonsense"),
            "--effect: is not for the known loads",
        ),
        (("calibrate", tmp_path / "tool.toml", "a.csv", "--report", "x.html"), "--report: is not for the known loads"),
        (("diagnose", tmp_path / "robot.toml", "a.csv", "-o", "x.toml"), "--output: is for a flexible tool"),
        (("app", tmp_path / "tool.toml", "a.csv", "--follow"), "is one file, beside RUN"),
        (("export", "d", tmp_path / "tool.toml", "-o", "x.h"), "there is no word and no run file 'd'"),
        (("tool", "bench.csv", "free.csv", "-o", "x.toml"), "Missing argument 'RUN'"),
        (("tool", tmp_path / "none.csv", "free.csv", "run.csv", "-o", "x.toml"), "there is no such file"),
        (("tool", "bench.csv", "free.csv", "run.csv", "-o", "x.toml", "--seed", "-1"), "-1 is not in the range"),
        (("diagnose", tmp_path / "tool.toml", "a.csv", "b.csv"), "one at a time"),
    ):
        refused = sherkit(*arguments)
        assert refused.exit_code != 0
        assert says in f"{refused.exception} {refused.output}"


def test_the_catalogue_tells_of_the_tool(tmp_path: Path) -> None:
    """Catches effects of the tool that nobody can look up, or that are said to be a robot's."""
    TOOL.save(tmp_path / "tool.toml")
    for arguments in ((), ("--robot", tmp_path / "tool.toml")):
        told = sherkit("effects", *arguments).output
        assert all(name in told for name in TOOL_CATALOGUE)
        assert ("rail_lean" in told) == (not arguments)
    assert "reference_nm" in sherkit("effects", "fbg_bias").output
    refused = sherkit("effects", "fbg_bias", "--picture", tmp_path / "x.svg")
    assert "another kind (flexible_tool)" in str(refused.exception)
