"""Runs as other programs write them: their names and units by a mapping, their numbers as they are or not at all."""

from __future__ import annotations

import math
import tomllib
from pathlib import Path

import numpy as np
import polars as pl
import pytest

import sherkit as sk
from laboratories import ROBOT
from running import command
from sherkit.data import stream_measurements
from sherkit.errors import MeasurementError, RobotError, SherkitWarning
from test_fuzz import lines_run, toml

#: A run as a laboratory's own program names it.
FOREIGN = {
    "q1_mm": "Enc1 (mm)", "q2_mm": "Enc2 (mm)", "q3_mm": "Enc3 (mm)", "x_mm": "x [um]", "y_mm": "y [um]",
    "z_mm": "Height [m]",
}  # fmt: skip
PER_MM = {"x_mm": 1e3, "y_mm": 1e3, "z_mm": 1e-3}


@pytest.fixture(scope="module")
def ours() -> pl.DataFrame:
    return lines_run().to_frame().drop("time_s")


def foreign(frame: pl.DataFrame) -> pl.DataFrame:
    scaled = frame.with_columns(pl.col(name) * by for name, by in PER_MM.items())
    return scaled.rename(FOREIGN)


def test_a_mapping_reads_foreign_names_and_converts_stated_units(ours: pl.DataFrame, tmp_path: Path) -> None:
    """Catches micrometres taken for millimetres, a conversion that nobody is told of, and a column mixed up."""
    path = tmp_path / "run.csv"
    foreign(ours).write_csv(path)
    with pytest.warns(SherkitWarning, match=r"converted .* as x_mm, 'y \[um\]' as y_mm, 'Height \[m\]' as z"):
        data = sk.read_measurements(path, columns=FOREIGN)
    expected = sk.from_frame(ours)
    np.testing.assert_allclose(data.readings, expected.readings, rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal(data.joints, expected.joints)
    assert data.covariates == {}


def test_a_refusal_proposes_the_mapping(ours: pl.DataFrame) -> None:
    """Catches a refusal that leaves a person to find out how foreign names are given; what is proposed must work."""
    frame = foreign(ours).rename({"Height [m]": "Z (µm)"}).with_columns(pl.col("Z (µm)") * 1e6)
    with pytest.raises(MeasurementError) as caught:
        sk.from_frame(frame)
    said = str(caught.value)
    assert "column 'q1_mm' is missing" in said
    proposed = tomllib.loads("columns = " + said.partition("columns = ")[2])["columns"]
    assert proposed == FOREIGN | {"z_mm": "Z (µm)"}
    with pytest.warns(SherkitWarning, match="converted"):
        data = sk.from_frame(frame, columns=proposed)
    np.testing.assert_allclose(data.readings, sk.from_frame(ours).readings, rtol=1e-9, atol=1e-12)


def test_angles_are_proposed_and_converted() -> None:
    """Catches a proposal that knows one robot alone, and degrees taken for radians."""
    frame = {"Theta 1 [deg]": [30.0, 60.0], "Theta 2 [deg]": [0.0, 90.0], "u [px]": [1.0, 2.0], "v [px]": [3.0, 4.0]}
    with pytest.raises(MeasurementError, match=r'columns = \{ theta1_rad = "Theta 1 \[deg\]", theta2_rad ='):
        sk.from_frame(frame)
    columns = {"theta1_rad": "Theta 1 [deg]", "theta2_rad": "Theta 2 [deg]", "u_px": "u [px]", "v_px": "v [px]"}
    with pytest.warns(SherkitWarning, match="'Theta 1"):
        data = sk.from_frame(frame, columns=columns)
    np.testing.assert_allclose(data.joints[:, 0], [math.pi / 6, math.pi / 3])


def test_the_robot_file_names_the_columns_of_its_runs(ours: pl.DataFrame, tmp_path: Path) -> None:
    """Catches a table of columns that the robot's reader refuses, or that a study from files does not use."""
    (tmp_path / "robot.toml").write_bytes(toml(ROBOT | {"columns": FOREIGN}))
    foreign(ours).write_csv(tmp_path / "run.csv")
    with pytest.warns(SherkitWarning, match="converted"):
        study = sk.Study(tmp_path / "robot.toml", tmp_path / "run.csv")
    np.testing.assert_allclose(study.data.readings, sk.from_frame(ours).readings, rtol=1e-9, atol=1e-12)
    (tmp_path / "robot.toml").write_bytes(toml(ROBOT | {"columns": {"q1_mm": 3}}))
    with pytest.raises(RobotError, match=r"\[columns\] q1_mm: expected a text, found 3"):
        sk.load_robot(tmp_path / "robot.toml")


@pytest.mark.parametrize(
    ("columns", "says"),
    [
        ({"q1_mm": "Enc 1 (mm)"}, r"'Enc 1 \(mm\)' is missing, .* read as 'q1_mm'; is 'Enc1 \(mm\)' meant"),
        ({"q1_mm": "angle [deg]"}, r"'angle \[deg\]' is in deg; 'q1_mm' is in mm"),
        ({"pose": "Enc1 (mm)", "q1_mm": "Enc1 (mm)"}, "is to be read as two columns|has a column 'pose' itself"),
        ({"repeat": "x [um]"}, "has a column 'repeat' itself"),
    ],
)
def test_a_mapping_that_cannot_be_is_refused(columns: dict[str, str], says: str, ours: pl.DataFrame) -> None:
    """Catches a mapping that takes a column that is not there, twice, or in a unit of something else."""
    frame = foreign(ours).with_columns(pl.lit(1.0).alias("angle [deg]"))
    with pytest.raises(MeasurementError, match=says):
        sk.from_frame(frame, columns=columns)


def test_a_reading_with_a_unit_in_its_header_is_no_covariate(ours: pl.DataFrame) -> None:
    """Catches a reading lost among the covariates since its header states a unit."""
    with pytest.raises(MeasurementError, match=r"column 'y \[um\]' is not read as 'y_mm'; .* y_mm = \"y \[um\]\""):
        sk.from_frame(ours.rename({"y_mm": "y [um]"}))


def test_a_joint_of_one_machine_is_a_reading_of_another() -> None:
    """Catches a machine whose joints are called as the readings of others' runs that, once it is made, takes every run
    for its own."""
    stage = sk.Machine(
        lambda q, p: q * (1.0 + p.scale), joints=("x_mm", "y_mm"), readings=("u_mm", "v_mm"),
        parameters={"scale": ("1", 1e-3)}, name="stage_seen",
    )  # fmt: skip
    crank = sk.Machine(
        lambda q, p: (100.0 + p.length) * np.column_stack([np.cos(q), np.sin(q)]),
        joints=("q_rad",), readings=("x_mm", "y_mm"), parameters={"length": ("mm", 1.0)}, name="crank_seen",
    )  # fmt: skip
    place = np.linspace(1.0, 2.0, 12)
    assert sk.from_frame({"q_rad": place, "x_mm": place, "y_mm": place}).layout == crank.layout
    assert sk.from_frame({"x_mm": place, "y_mm": place, "u_mm": place, "v_mm": place}).layout == stage.layout
    names = ("q1_mm", "q2_mm", "q3_mm", "x_mm", "y_mm", "z_mm")
    assert sk.from_frame(dict.fromkeys(names, place)).layout.joints == names[:3]


# -- numbers -------------------------------------------------------------------------------------------------


def table(path: Path, cells: list[str], separator: str, others: str = "1.5") -> Path:
    """A run whose column ``payload`` holds these cells."""
    names = ["q1_mm", "q2_mm", "q3_mm", "x_mm", "payload"]
    rows = [[str(k), others, str(k), others, cell] for k, cell in enumerate(cells)]
    path.write_text("\n".join(separator.join(row) for row in [names, *rows]) + "\n")
    return path


@pytest.mark.parametrize("separator", ["\t", ";"])
@pytest.mark.parametrize(
    ("cells", "others", "says"),
    [
        (["990", "1,000"], "2", "line 3, column 'payload': '1,000': may be a thousand"),
        (["990", "1,000"], "2,5", "line 3, column 'payload': '1,000': may be a thousand"),
        (["1,000", "2,000"], "2", "line 2, column 'payload': '1,000': may be a thousand"),
        (["990", "1,000"], "2.5", r"'1,000': the decimal mark of this file is the point \('2.5'\)"),
        (["990", "1,5"], "2.5", r"'1,5': the decimal mark of this file is the point \('2.5'\)"),
        (["990", "1,000,000"], "2", "'1,000,000': commas between thousands are not read"),
        (["990", "1,000.5"], "2", "'1,000.5': commas between thousands are not read"),
    ],
)
def test_a_number_that_can_be_read_in_two_ways_is_refused(
    separator: str, cells: list[str], others: str, says: str, tmp_path: Path
) -> None:
    """Catches a thousand read as one."""
    with pytest.raises(MeasurementError, match=says):
        sk.read_measurements(table(tmp_path / "run.tsv", cells, separator, others))


@pytest.mark.parametrize("separator", ["\t", ";"])
@pytest.mark.parametrize(
    ("cells", "others", "values"),
    [
        (["1,000", "2,500"], "0,5", [1.0, 2.5]),
        (["1,000", "0,500", "3"], "2", [1.0, 0.5, 3.0]),
        (["1,5", ",25", "-1,5e2"], "2", [1.5, 0.25, -150.0]),
        (["1.5", "2"], "2", [1.5, 2.0]),
    ],
)
def test_decimal_commas_that_the_file_proves_are_read(
    separator: str, cells: list[str], others: str, values: list[float], tmp_path: Path
) -> None:
    """Catches a caution that refuses what can be read in one way alone."""
    data = sk.read_measurements(table(tmp_path / "run.tsv", cells, separator, others))
    np.testing.assert_allclose(data.covariates["payload"], values)


def test_a_point_after_blocks_of_decimal_commas_is_refused(tmp_path: Path) -> None:
    """Catches a stream whose later blocks may write 2.500 for what its first blocks write 2500."""
    stream = stream_measurements(table(tmp_path / "run.csv", ["1,5", "2,5", "2.500"], ";", "1"), block_rows=2)
    with pytest.raises(MeasurementError, match=r"line 4, column 'payload': '2\.500': .* is the comma \('1,5'\)"):
        list(stream.blocks())


# -- poses ---------------------------------------------------------------------------------------------------


def test_one_pose_number_for_all_rows_is_refused(ours: pl.DataFrame) -> None:
    """Catches the whole workspace taken for the noise of one pose: nothing would ever be missing."""
    frame = ours.with_columns(pose=pl.lit(1), repeat=pl.int_range(pl.len()))
    with pytest.raises(
        MeasurementError, match=r"pose 1 stands at places \d+\.\d mm apart; rows with the same pose number"
    ):
        sk.from_frame(frame)


def test_pose_numbers_that_start_again_are_refused(ours: pl.DataFrame) -> None:
    """Catches numbers that were counted for each plane anew: different places as repeats."""
    frame = ours.with_columns(pose=pl.col("pose") % 9).drop("repeat")
    with pytest.raises(MeasurementError, match=r"and \d more poses do so"):
        sk.from_frame(frame)


def test_a_wild_row_of_a_pose_is_said(ours: pl.DataFrame) -> None:
    """Catches a wrong pose number that nobody hears of, and one that keeps a run from being read."""
    number = pl.when(pl.int_range(pl.len()) == 3).then(1).otherwise(pl.col("pose"))
    frame = ours.with_columns(pose=number, repeat=pl.int_range(pl.len()))
    with pytest.warns(SherkitWarning, match=r"pose 1 stands at places .* mm apart; rows with"):
        assert len(sk.from_frame(frame)) == len(ours)


def test_repeats_of_real_instruments_are_silent(ours: pl.DataFrame) -> None:
    """Catches a caution that warns of joints as they were read, a little apart."""
    rng = np.random.default_rng(0)
    frame = ours.with_columns(pl.col(q) + 0.02 * rng.normal(size=len(ours)) for q in ("q1_mm", "q2_mm", "q3_mm"))
    assert len(sk.from_frame(frame)) == len(ours)


@pytest.mark.parametrize("names", [{"x": "x_m", "y": "y_m", "z": "z_m"}, {"x": "x_in", "y": "y_in", "z": "z_in"}])
def test_units_at_the_end_of_a_name_are_mended(
    names: dict[str, str], ours: pl.DataFrame, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Catches metres that are read in brackets and not behind a line: "cannot be used", with nothing to be mended."""
    per = {"x_m": 1e-3, "x_in": 1.0 / 25.4}[names["x"]]
    frame = ours.with_columns(pl.col(f"{a}_mm") * per for a in names)
    _mended(frame.rename({f"{a}_mm": theirs for a, theirs in names.items()}), ours, tmp_path, monkeypatch)


def test_capitals_are_mended(ours: pl.DataFrame, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches names all in capitals, units too, that are pointed at and not read."""
    _mended(ours.rename({name: name.upper() for name in ours.columns}), ours, tmp_path, monkeypatch)


def _mended(frame: pl.DataFrame, ours: pl.DataFrame, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    frame.write_csv("run.csv")
    Path("robot.toml").write_bytes(toml(ROBOT))
    code, _, wrong = command(folder, "check", "run.csv", "robot.toml", "--write", "clean.csv")
    assert code == 0, wrong
    read = sk.read_measurements("clean.csv")
    np.testing.assert_allclose(read.readings, sk.from_frame(ours).readings, rtol=1e-9, atol=1e-9)


def test_a_time_by_another_name_is_asked_for(ours: pl.DataFrame) -> None:
    """Catches seconds that pass for a covariate without a word: what lives in time is then not looked for."""
    frame = ours.with_columns(pl.int_range(pl.len()).cast(pl.Float64).alias("t [s]"))
    with pytest.warns(SherkitWarning, match=r"column 't \[s\]' .* meant to be 'time_s'"):
        sk.from_frame(frame)


def test_numbers_behind_one_letter_are_proposed() -> None:
    """Catches the axes of a controller without units for which nothing is proposed but a machine of one's own."""
    with pytest.raises(MeasurementError) as caught:
        sk.from_frame({name: [1.0, 2.0] for name in ("A1", "A2", "A3", "X", "Y", "Z")})
    table = tomllib.loads("columns = " + str(caught.value).partition("columns = ")[2])["columns"]
    joints = {f"q{k}_mm": f"A{k}" for k in (1, 2, 3)}
    assert table == {**joints, "x_mm": "X", "y_mm": "Y", "z_mm": "Z"}


def test_all_that_is_missing_is_proposed_at_once() -> None:
    """Catches a proposal of the joints alone, whose next refusal is of the readings, and a run in radians that is said
    to be millimetres once converted."""

    def refused(*names: str) -> str:
        with pytest.raises(MeasurementError) as caught:
            sk.from_frame({name: [1.0, 2.0] for name in names})
        return str(caught.value)

    said = refused("t", "Enc1 [mm]", "Enc2 [mm]", "Enc3 [mm]", "laser x", "laser y", "laser z", "hum")
    table = tomllib.loads("columns = " + said.partition("columns = ")[2])["columns"]
    joints = {f"q{k}_mm": f"Enc{k} [mm]" for k in (1, 2, 3)}
    assert table == {**joints, "x_mm": "laser x", "y_mm": "laser y", "z_mm": "laser z", "time_s": "t"}
    assert "those without a unit in ours" in said
    assert "is this the run of another robot?" in refused("q1_rad", "q2_rad", "q3_rad", "x_mm", "y_mm", "z_mm")
