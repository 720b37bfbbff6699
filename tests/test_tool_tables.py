"""Tables of the flexible tool as a tired person writes them: refused, or warned of, with a sentence."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from second_tool import CONDITIONS
from sherkit.errors import FitError, MeasurementError, RobotError, SherkitWarning
from sherkit.robots.tool.alignment import align, align_run
from sherkit.robots.tool.calibration import calibrate_tool, read_loads
from sherkit.robots.tool.consistency import judge
from sherkit.robots.tool.filters import estimate
from sherkit.robots.tool.model import ToolModel, applied
from sherkit.robots.tool.runs import ToolRun, read_tool_run, tool_run_of
from sherkit.robots.tool.tables import table_at
from sherkit.robots.tool.tool import CAMERA, FIBRES, FORCE, POSITION, TURN, FlexibleTool, load_tool
from sherkit.robots.tool.verbs.check import wrong_with
from sherkit.robots.tool.virtual import VirtualTool
from test_tool import TOOL
from tool_honesty import fitted, run_of, tool_of

C = pl.col
Change = Callable[[pl.DataFrame], pl.DataFrame]


@pytest.fixture(scope="module")
def tables(tmp_path_factory: pytest.TempPathFactory) -> dict[str, pl.DataFrame]:
    """A bench, a free motion and a run."""
    folder = tmp_path_factory.mktemp("tables")
    there = VirtualTool(TOOL)
    there.bench().save(folder / "bench.csv")
    there.free_motion(seconds=6.0).save(folder / "free.csv")
    there.run("vessels", seconds=6.0).save(folder / "run.csv")
    return {name: pl.read_csv(folder / f"{name}.csv", infer_schema_length=None) for name in ("bench", "free", "run")}


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda f: f.filter(C("force_x_mn") != 0).head(1), "1 rows with a force; expected 12"),
        (lambda f: f.head(0), "0 rows with a force"),
        (lambda f: f.with_columns(depth_mm=pl.lit(5.0)), "all deflections are of loads at 5 mm from the tip"),
        (lambda f: f.with_columns(force_y_mn=pl.lit(0.0)), "all loads push along one line"),
        (lambda f: f.with_columns(C(*FORCE) / 1000), "are forces in mN?"),
        (lambda f: f.with_columns(C("deflection_mm") * 1000), "is deflection_mm in mm?"),
        (lambda f: f.with_columns(-C("deflection_mm")), "is deflection_mm in mm?"),
        (lambda f: f.with_columns((60 - C("depth_mm")).alias("depth_mm")), "is it measured from the clamp?"),
        (lambda f: f.with_columns(C(*FIBRES) * 1000), "seem to be in pm"),
        (lambda f: f.with_columns(C(*FIBRES) - 1545.0), "not their shifts"),
        (lambda f: f.with_columns(fbg2_nm=pl.lit(1531.2)), "'fbg2_nm' repeats one number"),
        (lambda f: f.with_columns(deflection_mm=pl.lit(float("inf"))), "row 1, column 'deflection_mm'"),
        (lambda f: f.with_columns(fbg2_nm=pl.lit("x")), "row 1, column 'fbg2_nm': 'x' is not a number"),
        (lambda f: f.rename({"depth_mm": "depht_mm"}), "is 'depht_mm' meant to be it?"),
        (lambda f: f.with_columns(depth_mm=None), "row 1, column 'depth_mm': expected a finite number"),
    ],
)
def test_loads_that_calibrate_nothing_are_refused(
    change: Change, says: str, tables: dict[str, pl.DataFrame], tmp_path: Path
) -> None:
    """Catches gains, a stiffness or a length that come of another unit, another end of the shaft, or one load."""
    path = tmp_path / "bench.csv"
    change(tables["bench"]).write_csv(path)
    with pytest.raises((FitError, MeasurementError)) as refused:
        calibrate_tool(TOOL, read_loads(path))
    assert str(refused.value).startswith(str(path))
    assert says in str(refused.value)


FOREIGN = {
    "time_s": ("t [ms]", 1e3), "robot_x_mm": ("X [m]", 1e-3), "robot_rz_rad": ("C (deg)", 180.0 / np.pi),
    "fbg4_nm": ("peak 4", 1.0), "force_x_mn": ("Fx [gf]", 1.0 / 9.80665), "deflection_mm": ("bend_um", 1e3),
}  # fmt: skip


def test_a_tool_file_says_what_columns_are_called(tables: dict[str, pl.DataFrame], tmp_path: Path) -> None:
    """Catches a needle's logger whose files must be written anew, units that are lost on the way, names that a tool
    loses where it is written, and a file in our own names that a tool with others cannot read."""
    foreign = {ours: theirs for ours, (theirs, _) in FOREIGN.items()}
    text = "\n".join(f'{ours} = "{theirs}"' for ours, theirs in foreign.items())
    TOOL.save(tmp_path / "drawn.toml")
    with (tmp_path / "drawn.toml").open("a") as file:
        file.write(f"\n[columns]\n{text}\n")
    load_tool(tmp_path / "drawn.toml").save(tmp_path / "tool.toml")
    tool = load_tool(tmp_path / "tool.toml")
    assert tool.columns == foreign
    for name, read in (("bench", read_loads), ("run", read_tool_run)):
        there = {ours: by for ours, (_, by) in FOREIGN.items() if ours in tables[name].columns}
        theirs = tables[name].with_columns(C(ours) * by for ours, by in there.items())
        theirs.rename({ours: foreign[ours] for ours in there}).write_csv(tmp_path / "theirs.csv")
        tables[name].write_csv(tmp_path / "ours.csv")
        with pytest.warns(SherkitWarning, match="converted from the units of the header"):
            one = read(tmp_path / "theirs.csv", tool.columns)
        other = read(tmp_path / "ours.csv", tool.columns)
        for field in fields(other):
            if isinstance(value := getattr(other, field.name), np.ndarray):
                np.testing.assert_allclose(getattr(one, field.name), value, rtol=1e-12)


@pytest.mark.parametrize(
    ("table", "change", "says"),
    [
        ("run", lambda f: f.rename({"robot_x_mm": "robot_x_m"}), "has 'robot_x_m': convert it to mm, or let [columns]"),
        ("run", lambda f: f.rename({"robot_rx_rad": "robot_rx_deg"}), "has 'robot_rx_deg': convert it to rad, or let"),
        ("run", lambda f: f.rename({one: f"robot_q{k}" for one, k in zip(TURN, "xyz", strict=True)}), "quaternions to"),
        ("run", lambda f: f.rename({"time_s": "time_ms"}), "has 'time_ms': convert it to s, or let [columns]"),
        ("run", lambda f: f.rename({"fbg1_nm": "FBG1_NM"}), "is 'FBG1_NM' meant to be it? Then [columns]"),
        ("bench", lambda f: f.rename({"force_x_mn": "force_x_gf"}), "has 'force_x_gf': convert it to mN, or let [col"),
        ("bench", lambda f: f.rename({"force_x_mn": "force_x_N"}), "has 'force_x_N': convert it to mN, or let [col"),
    ],
)  # fmt: skip
def test_a_column_in_another_unit_is_no_slip_of_the_finger(
    table: str, change: Change, says: str, tables: dict[str, pl.DataFrame], tmp_path: Path
) -> None:
    """Catches "is it meant?" of metres, degrees, gram-force and quaternions, which invites to rename what must be
    converted; and a bench in gram-force that `check` takes for a run."""
    path = tmp_path / "table.csv"
    change(tables[table]).write_csv(path)
    with pytest.raises(MeasurementError, match=re.escape(says)):
        read_loads(path) if table == "bench" else read_tool_run(path)
    assert any(says in one for one in wrong_with(TOOL, path, table_at(path)))


@pytest.mark.slow
def test_a_bench_without_unloaded_rows_says_what_stays(tables: dict[str, pl.DataFrame], tmp_path: Path) -> None:
    """Catches references of a tool file that are taken for those of the bench in silence."""
    tables["bench"].filter(C("force_x_mn") != 0).write_csv(tmp_path / "bench.csv")
    with pytest.warns(SherkitWarning, match="0 rows without a force"):
        found = calibrate_tool(TOOL, read_loads(tmp_path / "bench.csv"))
    assert found.tool.reference_nm == TOOL.reference_nm


def judged(run: ToolRun) -> None:
    judge(estimate(TOOL, run))


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda f: f.with_columns(C("time_s") * 1000), "is time_s in another unit?"),
        (
            lambda f: f.with_columns(time_s=C("time_s") + 1.7e9 * (C("time_s") > 3.0)),
            "leaps by 1.7e+09 s behind 3 s: is it that of another clock",
        ),
        (lambda f: f.with_columns(fbg_time_s=C("time_s") * 1000), "fbg_time_s lies 3e+03 s from time_s"),
        (lambda f: f.with_columns(fbg_time_s=C("time_s") + 1.7e9), "expected seconds by the robot's clock"),
        (lambda f: f.with_columns(C(*TURN) * 180 / np.pi), "are they degrees?"),
        (lambda f: f.with_columns(C(*POSITION) / 1000), "times those of the robot; expected both in mm"),
        (lambda f: f.with_columns(C(*CAMERA) / 1000), "times those of the robot; expected both in mm"),
        (lambda f: f.with_columns(C(*FIBRES) - 1540), "not their shifts"),
        (lambda f: f.with_columns(C(*FIBRES) + 14), "is it the file of this tool?"),
        (lambda f: f.with_columns(camera_x_mm=pl.lit(float("inf"))), "row 1, column 'camera_x_mm': expected a finite"),
        (lambda f: f.drop("fbg3_nm"), "column 'fbg3_nm' is missing"),
        (lambda f: f.rename({"robot_x_mm": "robot_x"}), "is 'robot_x' meant to be it?"),
        (lambda f: f.with_columns(pl.lit("x").alias("fbg1_nm")), "row 1, column 'fbg1_nm': 'x' is not a number"),
        (lambda f: f.with_columns(robot_y_mm=None), "row 1: a pose needs all of"),
        (lambda f: f.with_columns(camera_z_mm=None), "a place of the camera needs all of"),
        (lambda f: f.with_columns(time_s=pl.lit(0.0)), "row 2: the time of the robot does not grow"),
        (lambda f: f.with_columns(time_s=None), "row 1, column 'time_s': expected a time"),
        (lambda f: f.head(2), "holds 2 rows with a pose; expected 3 or more"),
        (
            lambda f: f.with_columns(fbg_time_s=pl.when(C("time_s") != 0.005).then(C("time_s"))),
            "row 2, column 'fbg_time_s': expected when its wavelengths were taken",
        ),
    ],
)
def test_runs_that_cannot_be_are_refused(change: Change, says: str, tables: dict[str, pl.DataFrame]) -> None:
    """Catches milliseconds, degrees, metres, shifts and another tool's wavelengths that give an estimate; a traceback,
    and NaN that travels on."""
    with pytest.raises(MeasurementError) as refused:
        judged(tool_run_of(change(tables["run"]), "run.csv"))
    assert str(refused.value).startswith("run.csv")
    assert says in str(refused.value)


def test_strange_truths_are_said(tables: dict[str, pl.DataFrame]) -> None:
    """Catches a depth in metres and a camera that was never registered, by which a filter is called overconfident."""
    with pytest.warns(SherkitWarning, match="never exceeds 0.019 mm: is it in m"):
        tool_run_of(tables["run"].with_columns(C("depth_mm") / 1000))
    run = tool_run_of(tables["run"])
    with pytest.warns(SherkitWarning, match="sherkit register finds it"):
        judge(estimate(FlexibleTool(), run))
    with pytest.raises(MeasurementError, match="seem to be in pm"):
        ToolModel(TOOL, replace(run, wavelengths_nm=1e3 * run.wavelengths_nm))


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda f: f.with_columns(C(*CAMERA) / 1000), "span 0.001 times"),
        (lambda f: f.with_columns(-C("camera_x_mm")), "mirrored"),
        (lambda f: f.with_columns(camera_x_mm=C("camera_y_mm"), camera_y_mm=C("camera_x_mm")), "mirrored"),
        (lambda f: f.with_columns(C(*CAMERA).reverse()), "do not follow the robot's"),
    ],
)
def test_a_camera_that_saw_something_else_is_not_registered(
    change: Change, says: str, tables: dict[str, pl.DataFrame]
) -> None:
    """Catches a frame from another unit, a mirrored picture or other seconds, and a sentence that blames a line."""
    run = tool_run_of(change(tables["free"]), "free.csv")
    with pytest.raises(FitError, match=says) as refused:
        align(run.time_s, run.position_mm, run.camera_time_s, run.camera_mm, source=run.source)
    assert str(refused.value).startswith("free.csv")


@pytest.mark.parametrize("seconds", [6.0, 20.0])
def test_places_of_the_flange_register_no_camera(seconds: float) -> None:
    """Catches a frame that is off by millimetres since the robot's places are those of the flange, and a refusal that
    blames the motion; and a sound camera that is refused."""
    free = VirtualTool(TOOL).free_motion(seconds=seconds)
    assert align_run(free, 0.5, TOOL.length_mm).registration.mean_error_mm < 0.5
    with pytest.raises(FitError, match="are those of the flange, and not of the unbent tip 60 mm further on"):
        align_run(free.further_on(-TOOL.length_mm), 0.5, TOOL.length_mm)
    with pytest.warns(SherkitWarning, match="did something touch the tool"):
        align_run(free.further_on(-20.0), 0.5, TOOL.length_mm)


def test_fibres_are_not_read_from_the_future(tmp_path: Path) -> None:
    """Catches a negative delay, which the loop takes for none, in a file, in a tool and by a diagnosis."""
    with pytest.raises(RobotError, match="readings from the future; expected 0 or more"):
        replace(TOOL, fibre_delay_s=-0.02)
    TOOL.save(tmp_path / "tool.toml")
    text = (tmp_path / "tool.toml").read_text()
    (tmp_path / "tool.toml").write_text(text.replace("delay_s = 0.0\n", "delay_s = -0.02\n"))
    with pytest.raises(RobotError, match=r"\[gratings\] delay_s: expected a number, at least 0"):
        load_tool(tmp_path / "tool.toml")
    world = CONDITIONS["matched"]
    recorded = run_of(world.run("vessels", seconds=12.0, seed=1))
    early = replace(recorded, wavelengths_nm=np.roll(recorded.wavelengths_nm, -8, axis=0))
    model = ToolModel(tool_of(world, 1), early)
    told = applied(model, fitted(model, "fibre_delay"))
    assert (told.written, told.kept_out) == ((), ("fibre_delay",))
    assert "put their time_s right" in told.why[0]


def test_decimal_commas_are_read(tables: dict[str, pl.DataFrame], tmp_path: Path) -> None:
    """Catches a table of the tool with commas for decimal points, as programs here write them, that is refused at its
    first cell, where runs of other robots are read."""
    run = tables["run"]
    written = run.select(pl.col(pl.Float64).cast(pl.String).str.replace(r"\.", ","))
    written.write_csv(tmp_path / "run.csv", separator=";", quote_style="never")
    (read, wanted) = (read_tool_run(tmp_path / "run.csv"), tool_run_of(run, "run"))
    np.testing.assert_array_equal(read.wavelengths_nm, wanted.wavelengths_nm)
    np.testing.assert_array_equal(read.position_mm, wanted.position_mm)


def test_before_the_hole_there_is_no_depth(tables: dict[str, pl.DataFrame]) -> None:
    """Catches a known depth below zero that the filter is judged by: it says none of a tip that has left the eye, and
    a sound tool was "overconfident" (9 of 9)."""
    run = tables["run"].with_columns(depth_mm=C("depth_mm") - 10.0)
    read = tool_run_of(run, "run").depth_mm
    assert read is not None
    assert np.nanmin(read) == 0.0
    assert np.nanmax(read) == pytest.approx(tables["run"]["depth_mm"].max() - 10.0)
