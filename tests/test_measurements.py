"""Tables of measurements: every way in gives the same rows, every bad one is refused where it is bad."""

from __future__ import annotations

import csv
import io
import os
import re
import warnings
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any

import hypothesis.strategies as st
import numpy as np
import pandas as pd
import polars as pl
import pytest
from hypothesis import given

from bad_inputs import BAD, GOOD, NAME, Bad
from running import slow
from sherkit import Measurements, SherkitError, SherkitWarning, from_frame, read_measurements
from sherkit.data import from_arrays, stream_measurements
from sherkit.errors import MeasurementError
from sherkit.robots.delta.robot import DELTA
from trials import forked

NONE = float("nan")
#: Positions, one of them a height alone, and distances; a covariate and a label.
COLUMNS: dict[str, list[Any]] = {
    "time_s": [0.0, 3.0, 6.5, 9.0, 12.25],
    "pose": [1, 1, 2, 3, 4],
    "repeat": [1, 2, 1, 1, 1],
    "q1_mm": [128.923, 128.924, 141.655, 118.402, 128.923],
    "q2_mm": [128.923, 128.922, 130.071, 125.873, 128.923],
    "q3_mm": [128.923, 128.921, 126.512, 133.96, 1.28923e2],
    "to_q1_mm": [NONE, NONE, NONE, NONE, 141.655],
    "to_q2_mm": [NONE, NONE, NONE, NONE, 130.071],
    "to_q3_mm": [NONE, NONE, NONE, NONE, 126.512],
    "x_mm": [0.012, 0.013, -1.957, NONE, NONE],
    "y_mm": [-0.021, -0.019, 8.034, NONE, NONE],
    "z_mm": [0.004, 0.006, 4.991, -2.036, NONE],
    "distance_mm": [NONE, NONE, NONE, NONE, 9.652],
    "sigma_x_mm": [0.005, 0.005, 0.01, NONE, NONE],
    "outlier": [0, 1, 0, 0, 0],
    "temperature_c": [20.0, 20.125, 20.25, 20.375, -0.5],
    "operator": ["Ada", "Ada", "", "", "Émilie"],
}
Write = Callable[[list[list[str]]], bytes]


def cells(columns: dict[str, list[Any]] = COLUMNS) -> list[list[str]]:
    """Header and rows as text; what is missing is an empty cell."""
    rows = [["" if v != v else str(v) for v in row] for row in zip(*columns.values(), strict=True)]
    return [list(columns), *rows]


def joined(table: list[list[str]], separator: str = ",", end: str = "\n") -> str:
    """A table as lines."""
    return "".join(separator.join(row) + end for row in table)


def semicolons(table: list[list[str]]) -> list[list[str]]:
    """Decimal commas in the numbers."""
    return [table[0], *([re.sub(r"^(-?\d+)\.", r"\1,", v) for v in row] for row in table[1:])]


def quoted(table: list[list[str]]) -> str:
    """A table as Excel writes it where every cell is text."""
    file = io.StringIO()
    csv.writer(file, quoting=csv.QUOTE_ALL).writerows(table)
    return file.getvalue()


CSV: dict[str, Write] = {
    "comma": lambda t: joined(t).encode(),
    "semicolon": lambda t: joined(semicolons(t), ";").encode(),
    "semicolon, decimal point": lambda t: joined(t, ";").encode(),
    "tab": lambda t: joined(t, "\t").encode(),
    "tab, decimal comma": lambda t: joined(semicolons(t), "\t").encode(),
    "BOM": lambda t: joined(t).encode("utf-8-sig"),
    "CRLF": lambda t: joined(t, end="\r\n").encode(),
    "old Macintosh": lambda t: joined(t, end="\r").encode(),
    "no line end at the end": lambda t: joined(t).rstrip("\n").encode(),
    "notes": lambda t: ("# a, note; with\tall\n  # another\n" + joined(t, end="\n#\n")).encode(),
    "a note with a quotation mark": lambda t: ('# 5" probe\n' + joined(t)).encode(),
    "blank lines": lambda t: ("\n \n" + joined(t, end="\n\n")).encode(),
    "quoted": lambda t: quoted(t).encode(),
    "one row quoted": lambda t: (joined(t[:2]) + quoted(t[2:3]) + joined(t[3:])).encode(),
    "quoted with BOM": lambda t: quoted(t).encode("utf-8-sig"),
    "columns the other way round": lambda t: joined([row[::-1] for row in t]).encode(),
    "spaces around cells": lambda t: joined(
        [[*(f" {v} " if v else v for v in row[:-1]), row[-1]] for row in t]
    ).encode(),
    "a column without a name": lambda t: joined([[str(k) if k else "", *row] for k, row in enumerate(t)]).encode(),
}
FRAMES: dict[str, Callable[[dict[str, list[Any]]], Any]] = {
    "polars": lambda c: pl.DataFrame(c),
    "polars with nulls": lambda c: pl.DataFrame(c).with_columns(pl.col(pl.Float64).fill_nan(None)),
    "polars, not collected": lambda c: pl.DataFrame(c).lazy(),
    "polars with categories": lambda c: pl.DataFrame(c).with_columns(pl.col("operator").cast(pl.Categorical)),
    "pandas": lambda c: pd.DataFrame(c),
    "pandas with its own nulls": lambda c: pd.DataFrame(c).convert_dtypes(),
    "pandas with objects": lambda c: pd.DataFrame(c).astype(object),
    "pandas, another index": lambda c: pd.DataFrame(c, index=range(10, 15)),
    "pandas as read": lambda c: pd.read_csv(io.StringIO(joined(cells(c)))),
    "arrays": lambda c: {k: np.array(v) for k, v in c.items()},
    "lists": lambda c: c,
    "lists with None": lambda c: {k: [None if x != x else x for x in v] for k, v in c.items()},
}


def differences(a: Measurements, b: Measurements) -> list[str]:
    """Fields in which two runs differ, exactly; where they came from does not count."""
    out = [] if a.layout == b.layout else ["layout"]
    for name in (f.name for f in fields(Measurements)):
        if name in ("source", "line", "counted", "order", "layout"):
            continue
        one, two = getattr(a, name), getattr(b, name)
        pairs = [(one, two)]
        if name == "room" and one is not None and two is not None:
            pairs = list(zip(one, two, strict=True))
        if name in ("covariates", "labels"):
            if set(one) != set(two):
                out.append(name)
                continue
            pairs = [(one[k], two[k]) for k in one]
        for left, right in pairs:
            if (left is None) != (right is None):
                out.append(name)
            elif left is not None:
                exact = np.asarray(left).dtype.kind in "fiub"
                same = np.array_equal(left, right, equal_nan=True) if exact else left.tolist() == right.tolist()
                out += [] if same else [name]
    return out


def write(folder: Path, content: str | bytes, name: str = NAME) -> Path:
    """A file in ``folder``."""
    path = folder / name
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


@pytest.fixture
def plain() -> Measurements:
    """The rows, built without any reader."""
    arrays: dict[str, Any] = {k: np.array(v, dtype=float) for k, v in COLUMNS.items() if k != "operator"}
    return Measurements.from_columns({**arrays, "operator": np.array(COLUMNS["operator"], dtype=object)}, "plain")


# -- ways in -------------------------------------------------------------------------------------------------


def test_rows_are_what_the_table_says(plain: Measurements) -> None:
    """Catches swapped columns and a missing reading taken for zero."""
    assert plain.joints[2].tolist() == [141.655, 130.071, 126.512]
    assert plain.readings[2].tolist() == [-1.957, 8.034, 4.991, 0.0]
    assert plain.taken.astype(int).tolist() == [[1, 1, 1, 0], [1, 1, 1, 0], [1, 1, 1, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
    assert plain.to_joints[4].tolist() == [141.655, 130.071, 126.512]
    assert plain.is_distance.tolist() == [False, False, False, False, True]
    assert plain.sigma[2, 0] == 0.01
    assert np.isnan(plain.sigma[:, 1:]).all()
    assert plain.outlier.tolist() == [False, True, False, False, False]
    assert plain.groups.tolist() == [0, 0, 1, 2, 3]
    assert plain.covariates["temperature_c"].tolist() == COLUMNS["temperature_c"]
    assert plain.labels["operator"].tolist() == COLUMNS["operator"]


@pytest.mark.parametrize("kind", CSV)
def test_every_csv_gives_the_same_rows(kind: str, plain: Measurements, tmp_path: Path) -> None:
    """Catches a separator, decimal comma, line end, note or quoted cell that changes a number or loses a row."""
    content = CSV[kind](cells())
    found = read_measurements(write(tmp_path, content))
    assert differences(found, plain) == []
    text = re.split(r"\r\n|\r|\n", content.decode("utf-8-sig"))
    for n, temperature in zip(found.line, COLUMNS["temperature_c"], strict=True):
        assert str(temperature) in text[n - 1].replace(",", ".")


@pytest.mark.parametrize("kind", FRAMES)
def test_every_frame_gives_the_same_rows(kind: str, plain: Measurements) -> None:
    """Catches NaN, None and pandas' NA taken for readings, categories taken for numbers, an index that shifts rows."""
    assert differences(from_frame(FRAMES[kind](COLUMNS)), plain) == []


@pytest.mark.parametrize("ending", [".csv", ".parquet", ".pq"])
def test_what_is_saved_is_read_back(ending: str, plain: Measurements, tmp_path: Path) -> None:
    """Catches a column that ``save`` forgets or a file type that ``read_measurements`` does not know."""
    plain.save(tmp_path / f"run{ending}")
    assert differences(read_measurements(tmp_path / f"run{ending}"), plain) == []


def test_labels_keep_commas_quotes_and_line_ends(tmp_path: Path) -> None:
    """Catches decimal commas replaced inside labels, and rows counted by line where a cell has several lines."""
    text = 'q1_mm;q2_mm;q3_mm;z_mm;note\n1,5;2;3;4,25;"12,5 kg, ""heavy"""\n5;6;7;8;"two\n\n# lines"\n9;8;7;x;"a, b"\n'
    found = read_measurements(write(tmp_path, text.replace(";x;", ";6;")))
    assert found.labels["note"].tolist() == ['12,5 kg, "heavy"', "two\n\n# lines", "a, b"]
    assert found.joints[0, 0] == 1.5
    assert found.line.tolist() == [2, 3, 6]
    with pytest.raises(MeasurementError, match="line 6, column 'z_mm': 'x' is not a number"):
        read_measurements(write(tmp_path, text))


def test_a_few_words_among_empty_cells_are_labels(tmp_path: Path) -> None:
    """Catches a column of sparse remarks refused for not being numbers."""
    lines = GOOD.splitlines()
    lines[1:] = [lines[1] + ",remark", *(s + "," for s in lines[2:])]
    lines[3] += "retried"
    assert read_measurements(write(tmp_path, "\n".join(lines))).labels["remark"].tolist() == ["", "retried", "", ""]


# -- round trip ----------------------------------------------------------------------------------------------

NUMBERS = st.floats(-1e9, 1e9)
WORDS = st.text(st.characters(exclude_categories=["Cs"]), max_size=8).map(lambda s: "«" + s)


@st.composite
def runs(draw: st.DrawFn) -> Measurements:
    """Any run that can be: positions in part, distances, noise, covariates, labels."""
    n = draw(st.integers(1, 6))

    def column(values: st.SearchStrategy[Any]) -> Any:
        return np.array(draw(st.lists(values, min_size=n, max_size=n)))

    columns = {f"q{k}_mm": column(NUMBERS) for k in (1, 2, 3)}
    distance = column(st.booleans())
    some = column(st.sampled_from([(1, 1, 1), (1, 0, 1), (0, 0, 1), (0, 1, 0)])).astype(bool) & ~distance[:, None]
    for k in (1, 2, 3):
        columns[f"to_q{k}_mm"] = np.where(distance, column(NUMBERS), np.nan)
    for name, rows in zip(DELTA.readings, [*some.T, distance], strict=True):
        columns[name] = np.where(rows, column(NUMBERS), np.nan)
        if draw(st.booleans()):
            columns[f"sigma_{name}"] = column(st.floats(1e-9, 1e3) | st.just(np.nan))
    if draw(st.booleans()):
        columns["time_s"] = column(NUMBERS)
    if draw(st.booleans()):
        # one number stands for one place
        columns["pose"] = np.array(draw(st.lists(st.integers(-(2**53), 2**53), min_size=n, max_size=n, unique=True)))
        columns["repeat"] = np.arange(1, n + 1)
    if draw(st.booleans()):
        columns["outlier"] = column(st.booleans()).astype(float)
    if draw(st.booleans()):
        columns["humidity_pct"] = column(NUMBERS)
    labels = {"operator": column(WORDS).astype(object)} if draw(st.booleans()) else {}
    return Measurements.from_columns({**columns, **labels}, "drawn")


@pytest.mark.filterwarnings("ignore::sherkit.SherkitWarning")  # random numbers are in no unit
@pytest.mark.parametrize("ending", [".csv", ".parquet"])
def test_round_trip_is_exact(ending: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches a number rounded, a label changed, or a null lost on the way to a file and back."""
    path = tmp_path / f"run{ending}"

    @given(run=runs())
    def there_and_back(run: Measurements) -> None:
        run.save(path)
        assert differences(read_measurements(path), run) == []
        assert differences(from_frame(run.to_frame()), run) == []

    with forked(monkeypatch):
        there_and_back()


# -- what is refused -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("bad", BAD, ids=lambda bad: bad.wrong)
def test_bad_files_are_refused_where_they_are_bad(bad: Bad, tmp_path: Path) -> None:
    """Catches a file that is read in spite of its fault, or a message without file, line, column or remedy."""
    message = bad.message(bad.write(tmp_path))
    assert message.startswith(str(tmp_path / NAME))
    assert "\n" not in message
    for part in bad.says:
        assert part in message


def test_the_good_file_is_good(tmp_path: Path) -> None:
    """Catches bad files refused for something else than the one thing wrong in each."""
    assert len(read_measurements(write(tmp_path, GOOD))) == 4


@pytest.mark.parametrize("bad", [b for b in BAD if not b.warns], ids=lambda bad: bad.wrong)
def test_streams_refuse_the_same_files_with_the_same_words(bad: Bad, tmp_path: Path) -> None:
    """Catches errors that leave a stream unexplained, and lines counted anew in each block."""
    path = bad.write(tmp_path)
    with pytest.raises(MeasurementError) as refused:
        list(stream_measurements(path, block_rows=2).blocks())
    if bad.names_all:
        assert all(part in str(refused.value) for part in bad.says)
    else:
        assert str(refused.value) == bad.message(path)


@pytest.mark.parametrize(
    ("column", "values", "says"),
    [
        ("x_mm", [1.0, np.inf, 2.0], "row 1, column 'x_mm': inf is not a measurement"),
        ("q1_mm", [1.0, 2.0, np.nan], "row 2, column 'q1_mm': is empty"),
        ("q1_mm", [1.0, None, 3.0], "row 1, column 'q1_mm': is empty"),
        ("q1_mm", ["1", "2", "three"], "row 2, column 'q1_mm': 'three' is not a number"),
        ("x_mm", [1.0, "2", "bad"], "row 2, column 'x_mm': 'bad' is not a number"),
        ("pose", [1.0, 1.5, 2.0], "row 1, column 'pose': 1.5 is not a whole number"),
        ("pose", [1.0, 1e300, 2.0], "row 1, column 'pose': 1e+300 is not a"),
        ("pose", [1.0, 2.0**60, 2.0], "row 1, column 'pose': 1.152921504606847e+18 is not a whole number"),
        ("time_s", np.array(["2025-01-01"] * 3, dtype="datetime64[s]"), "column 'time_s'"),
        ("sigma_x_mm", [0.1, 0.0, 0.1], "row 1, column 'sigma_x_mm': 0.0 must be greater than zero"),
        ("temperature_c", [20.0, np.nan, 21.0], "row 1, column 'temperature_c': is empty"),
        ("x_mm", [1.0, 2.0], "different lengths"),
        ("x_mm", [[1.0], [2.0], [3.0]], "column 'x_mm' is no list of numbers"),
        ("x_mm", [[1.0], [2.0, 3.0], []], "column 'x_mm' is no list of numbers"),
        ("x_mm", 1.0, "column 'x_mm' is no list of numbers"),
    ],
)
def test_bad_frames_are_refused(column: str, values: Any, says: str) -> None:
    """Catches wrong cells in memory taken for numbers, and messages without row and column."""
    frame: dict[str, Any] = {"q1_mm": [1.0, 2.0, 3.0], "q2_mm": [1.0] * 3, "q3_mm": [1.0] * 3, "x_mm": [1.0, 1.5, 2.0]}
    with pytest.raises(MeasurementError, match=re.escape(says)):
        from_frame({**frame, column: values})


@pytest.mark.parametrize("table", [[1.0, 2.0], np.zeros((3, 3)), "run.csv", None])
def test_what_is_no_table_is_refused(table: Any) -> None:
    """Catches an AttributeError from inside where a user passes an array or a file name."""
    with pytest.raises(MeasurementError, match=f"polars or pandas frame.* got {type(table).__name__}"):
        from_frame(table)


def test_columns_given_twice_in_pandas_are_refused() -> None:
    """Catches one of two columns of the same name silently dropped."""
    frame = pd.DataFrame([[1.0, 2.0, 3.0, 4.0, 5.0]], columns=["q1_mm", "q2_mm", "q3_mm", "x_mm", "x_mm"])
    with pytest.raises(MeasurementError, match="'x_mm' appears more than once"):
        from_frame(frame)
    with pytest.raises(MeasurementError, match="'x_mm' appears more than once"):
        from_frame(pl.DataFrame({"q1_mm": [1.0], "q2_mm": [1.0], "q3_mm": [1.0], "x_mm": [1.0], "x_mm ": [2.0]}))


def test_parquet_is_checked_as_well(tmp_path: Path) -> None:
    """Catches a file that is no Parquet, or a bad cell in one, reported by polars instead of in words."""
    with pytest.raises(MeasurementError, match=r"run\.parquet: is not a Parquet file"):
        read_measurements(write(tmp_path, GOOD, "run.parquet"))
    with pytest.raises(MeasurementError, match=r"run\.parquet: is not a Parquet file"):
        list(stream_measurements(tmp_path / "run.parquet").blocks())
    frame = pl.DataFrame({**{f"q{k}_mm": [1.0, 2.0, 3.0, 4.0] for k in (1, 2, 3)}, "x_mm": [1.0, 2.0, 3.0, np.inf]})
    frame.write_parquet(tmp_path / "run.parquet")
    for found in (
        lambda path: read_measurements(path),
        lambda path: list(stream_measurements(path, block_rows=2).blocks()),
    ):
        with pytest.raises(MeasurementError, match=r"run\.parquet: row 3, column 'x_mm': inf"):
            found(tmp_path / "run.parquet")


def test_a_table_is_read_under_any_name(plain: Measurements, tmp_path: Path) -> None:
    """Catches a Parquet file called damaged for letters in its name that are no ASCII."""
    plain.save(tmp_path / "\U0001f916 'Läufe' {1}.parquet")
    assert len(read_measurements(tmp_path / "\U0001f916 'Läufe' {1}.parquet")) == len(plain)


@pytest.mark.skipif(not Path("/dev/fd").exists(), reason="this system has no names for pipes")
def test_a_table_is_read_from_a_pipe(tmp_path: Path) -> None:
    """Catches a look at the first bytes that takes them out of a pipe: ``sherkit calibrate <(zcat run.csv.gz)``."""
    whole = read_measurements(write(tmp_path, GOOD))
    out, into = os.pipe()
    os.write(into, GOOD.encode() if isinstance(GOOD, str) else GOOD)
    os.close(into)
    try:
        np.testing.assert_array_equal(read_measurements(f"/dev/fd/{out}").joints, whole.joints)
    finally:
        os.close(out)


@pytest.mark.parametrize(
    ("name", "meant"),
    [
        ("x_mmm", "x_mm"), ("sigma_y", "sigma_y_mm"), ("outliers", "outlier"), ("Repeat", "repeat"),
        ("time", "time_s"),
    ],
)  # fmt: skip
def test_a_covariate_that_looks_like_a_slip_is_warned_of(name: str, meant: str) -> None:
    """Catches a misspelt optional column used as a covariate without a word."""
    columns = {f"{n}_mm": [1.0, 2.0] for n in ("q1", "q2", "q3", "y")}
    with pytest.warns(SherkitWarning, match=f"column '{name}' is taken as a covariate; is it meant to be '{meant}'"):
        assert name in from_frame({**columns, name: [1.0, 1.0]}).covariates


def test_a_reading_in_capitals_is_no_covariate() -> None:
    """Catches a run of two coordinates of three, since the third is called otherwise."""
    columns = {f"{n}_mm": [1.0, 2.0] for n in ("q1", "q2", "q3", "y", "z", "X")}
    with pytest.raises(MeasurementError, match=r"'X_mm' is not read as 'x_mm'.* x_mm = \"X_mm\""):
        from_frame(columns)


def test_other_covariates_pass_without_a_word() -> None:
    """Catches a warning for covariates that people have: it would teach them to ignore warnings."""
    columns = {f"{n}_mm": [1.0, 2.0] for n in ("q1", "q2", "q3", "y")}
    names = ["temperature_c", "humidity_pct", "load_n", "pressure_pa", "probe", "speed_mm_s", "x_cmd_mm", "battery_v"]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert set(from_frame({**columns, **{n: [1.0, 1.0] for n in names}}).covariates) == set(names)


# -- streams -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("ending", [".csv", ".parquet"])
@pytest.mark.parametrize("rows", [1, 1000, *slow(7, 23)])
def test_streams_give_the_same_rows(ending: str, rows: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches rows lost or doubled at the border of blocks, and a second pass that starts where the first ended."""
    rng = np.random.default_rng(0)
    n = 23
    values = {f"{name}_mm": rng.normal(size=n) for name in ("q1", "q2", "q3", "x", "y", "z")}
    whole = from_frame({"pose": np.arange(n), **values, "humidity_pct": rng.normal(size=n), "part": ["“a”"] * n})
    path = tmp_path / f"run{ending}"
    whole.save(path)
    with forked(monkeypatch):
        read = read_measurements(path)
        stream = stream_measurements(path, block_rows=rows)
    for _ in range(2):
        blocks = list(stream.blocks())
        assert max(len(b) for b in blocks) <= rows
        assert np.concatenate([b.line for b in blocks]).tolist() == read.line.tolist()
        start = 0
        for block in blocks:
            assert differences(block, whole.select(np.arange(start, start + len(block)))) == []
            start += len(block)
        assert start == n


def test_directions_of_motion_survive(tmp_path: Path) -> None:
    """Catches a direction of motion that is another one once part of a run is saved and read back."""
    rng = np.random.default_rng(0)
    values = {f"{name}_mm": rng.normal(size=23) for name in ("q1", "q2", "q3", "x", "y", "z")}
    run = from_frame({"time_s": np.arange(23.0), **values}).select(np.arange(1, 23, 2))
    run.save(tmp_path / "run.csv")
    assert np.array_equal(read_measurements(tmp_path / "run.csv").direction, run.direction)


def test_streams_do_not_guess_directions(tmp_path: Path) -> None:
    """Catches blocks that take their first row for the start of the run."""
    rng = np.random.default_rng(0)
    values = {f"{name}_mm": rng.normal(size=23) for name in ("q1", "q2", "q3", "x", "y", "z")}
    from_frame({"time_s": np.arange(23.0), **values}).save(tmp_path / "run.csv")
    for block in stream_measurements(tmp_path / "run.csv", block_rows=7).blocks():
        assert np.isnan(block.direction).all()


def test_streams_read_every_csv(plain: Measurements, tmp_path: Path) -> None:
    """Catches a dialect that is read in memory and refused, or misread, from a stream."""
    for kind, made in CSV.items():
        blocks = list(stream_measurements(write(tmp_path, made(cells())), block_rows=2).blocks())
        assert {len(b) for b in blocks} <= {1, 2}, kind
        joints = np.concatenate([b.joints for b in blocks])
        assert np.array_equal(joints, plain.joints), kind


# -- using ---------------------------------------------------------------------------------------------------


def test_repeatability_is_the_pooled_spread_of_poses() -> None:
    """Catches a wrong number of degrees of freedom, outliers counted in, and gaps in one axis shifting another."""
    rng = np.random.default_rng(1)
    pose = rng.integers(0, 6, size=40)
    values = rng.normal(size=(40, 3)) * (0.01, 0.02, 0.03) + pose[:, None]
    values[rng.random(values.shape) < 0.2] = np.nan
    values[:, 2] = np.where(np.isnan(values).all(axis=1), 1.0, values[:, 2])
    outlier = rng.random(40) < 0.1
    frame = {f"q{k}_mm": pose.astype(float) for k in (1, 2, 3)} | {"pose": pose, "outlier": outlier}
    data = from_frame(frame | {f"{a}_mm": values[:, k] for k, a in enumerate("xyz")})
    squares = dict.fromkeys("xyz", 0.0)
    freedom = dict.fromkeys("xyz", 0)
    for k, axis in enumerate("xyz"):
        for p in range(6):
            v = values[(pose == p) & ~outlier, k]
            v = v[~np.isnan(v)]
            squares[axis] += float(((v - v.mean()) ** 2).sum()) if len(v) else 0.0
            freedom[axis] += max(len(v) - 1, 0)
    found = data.repeatability
    assert found.degrees_of_freedom == {f"{a}_mm": n for a, n in freedom.items()}
    for axis in "xyz":
        assert found.sigma[f"{axis}_mm"] == pytest.approx(np.sqrt(squares[axis] / freedom[axis]), rel=1e-12)


def test_repeatability_needs_repeats(plain: Measurements) -> None:
    """Catches a spread claimed from single readings; the one repeat here is marked as an outlier."""
    assert plain.repeatability is None
    assert from_frame({"q1_mm": [1.0, 2.0], "q2_mm": [1.0, 1.0], "q3_mm": [1.0, 1.0], "x_mm": [1.0, 1.0]}
                      ).repeatability is None  # fmt: skip


def test_equal_joint_readings_are_repeats() -> None:
    """Catches repeats that nobody numbered counted as poses of their own; rows taken for repeats that share a joint or
    two, or agree but for the last bit; and an approach or a payload that makes a new pose."""
    q1 = [0.0, 5.0, -0.0, 5.0, 5.0, np.nextafter(5.0, 6.0), 0.0]
    q2 = [1.0, 1.0, 1.0, 1.0, 2.0, 1.0, 1.0]
    columns = {"q1_mm": q1, "q2_mm": q2, "q3_mm": [3.0] * 7, "x_mm": [1.0, 2.0, 1.1, 2.2, 3.0, 4.0, 1.2]}
    others = {"time_s": np.arange(7.0), "direction_1": [1, -1, -1, 1, 1, 1, 1], "payload_g": [0, 0, 50, 50, 0, 0, 0]}
    for data in (from_frame(columns), from_frame(columns | others)):
        assert data.groups.tolist() == [0, 1, 0, 1, 2, 3, 0]
        assert data.repeatability.degrees_of_freedom == {"x_mm": 3}
        assert data.select(np.array([6, 4, 0])).groups.tolist() == [0, 1, 0]
    numbered = from_frame(columns | {"pose": [1, 2, 3, 2, 4, 5, 1]})
    assert numbered.groups.tolist() == [0, 1, 2, 1, 3, 4, 0]


def test_repeats_of_distances_agree_at_both_ends() -> None:
    """Catches distances from one place to several others taken for repeats of one."""
    one_end = {f"q{k}_mm": [1.0] * 4 for k in (1, 2, 3)}
    other = {f"to_q{k}_mm": [2.0, 2.0, 3.0, np.nan] for k in (1, 2, 3)}
    data = from_frame(one_end | other | {"distance_mm": [5.0, 5.1, 6.0, np.nan], "z_mm": [np.nan] * 3 + [7.0]})
    assert data.groups.tolist() == [0, 0, 1, 2]


def test_places_of_any_machine_are_no_repeats_unless_it_is_said() -> None:
    """Catches two sides of a pier taken for one pose, since the telescope looks at one star."""
    given = {"place": {"altitude": np.array([1.0, 1.0])}, "readings": np.ones((2, 1)), "names": ["x"], "unit": "arcsec"}
    assert from_arrays(**given).groups.tolist() == [0, 1]
    assert from_arrays(**given, pose=np.array([4, 4])).groups.tolist() == [0, 0]


def test_select_takes_masks_and_indices(plain: Measurements) -> None:
    """Catches a field that is not selected along with the others, and lines that no longer name their rows."""
    part = plain.select(np.array([4, 0]))
    assert part.joints.tolist() == plain.joints[[4, 0]].tolist()
    assert (part.line.tolist(), part.labels["operator"].tolist()) == ([4, 0], ["Émilie", "Ada"])
    assert part.covariates["temperature_c"].tolist() == [-0.5, 20.0]
    assert len(part.groups) == 2
    mask = np.array([True, False, False, False, True])
    assert differences(plain.select(mask), plain.select(np.array([0, 4]))) == []


def test_marking_outliers_adds_and_copies(plain: Measurements) -> None:
    """Catches marks that forget the earlier ones or that reach into the run they were made from."""
    assert plain.mark_outliers(np.array([3])).outlier.tolist() == [False, True, False, True, False]
    assert plain.outlier.tolist() == [False, True, False, False, False]


def test_a_wild_row_is_no_wrong_unit() -> None:
    """Catches a warning of units from one absurd reading among good ones."""
    rng = np.random.default_rng(2)
    values = {f"{name}_mm": rng.normal(size=50) for name in ("q1", "q2", "q3", "x", "y", "z")}
    values["x_mm"][7] = 1e6
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert len(from_frame(values)) == 50


# -- anything at all -----------------------------------------------------------------------------------------

TOKENS = st.sampled_from(
    [
        "1", "-2.5", "3,5", "", " ", "nan", "-inf", "1e400", "1e300", "1e-320", "-0", "1_0", "0x1", "１２", "−5", "abc",
        "é", "\x00", '"', '""', '"4"', "#", "=1+1", "\x1a", "\x85", "\u2028", "\ufeff", "1.234,5", "TRUE",
        "99999999999999999999999999999999999999",
    ]
)  # fmt: skip
NAMES = st.sampled_from([*COLUMNS, "x_um", "pose ", "", '"x_mm"', "#"])


@st.composite
def nearly_csv(draw: st.DrawFn) -> str:
    """A table with mostly right columns and mostly wrong cells."""
    names = ["q1_mm", "q2_mm", "q3_mm", "z_mm", *draw(st.lists(NAMES, max_size=3))]
    separator = draw(st.sampled_from([",", ";", "\t"]))
    good = st.sampled_from(["1", "-2.5", "12"])
    cell = good | good | good | TOKENS
    rows = draw(st.lists(st.lists(cell, min_size=len(names), max_size=len(names)), max_size=4))
    end = draw(st.sampled_from(["\n", "\r\n", "\n\n"]))
    return end.join(separator.join(row) for row in [names, *rows])


@pytest.mark.filterwarnings("ignore::sherkit.SherkitWarning")  # what is warned of elsewhere
@given(content=nearly_csv() | st.text(max_size=60) | st.binary(max_size=60))
def test_any_file_is_refused_in_words_or_read(content: str | bytes, tmp_path_factory: pytest.TempPathFactory) -> None:
    """Catches crashes on files that no one thought of, and NaN or infinity let through as a reading."""
    path = tmp_path_factory.getbasetemp() / NAME
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    refused = ""
    try:
        found = read_measurements(path)
    except SherkitError as error:
        refused = str(error)
    if refused:
        assert refused.startswith(str(path))
        return
    assert np.isfinite(found.joints).all()
    assert np.isfinite(found.readings).all()
    assert found.taken.any(axis=1).all()
    assert np.isfinite(found.to_joints[found.is_distance]).all()
    assert (np.isnan(found.sigma) | (found.sigma > 0)).all()
    assert all(np.isfinite(v).all() for v in found.covariates.values())
    streamed = list(stream_measurements(path, block_rows=1000).blocks())
    # a block does not see the row before it, so that a stream knows no directions
    assert set(differences(streamed[0], found)) <= {"direction"}
