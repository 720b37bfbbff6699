"""Plain CSV is read in one go: the same rows as cell by cell, and the same sentences for what is wrong."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import sherkit as sk
from sherkit.data.reader import csv_blocks, read_plain

HEADER = "q1_mm,q2_mm,q3_mm,x_mm,y_mm,z_mm,pose,operator,temperature_c\n"
ROWS = ["1.25,2,3e0,0.1,-0.2,.3,1,ann,20", "1.5,2.5,3.5,0.25,,0.75,2,bob,21", "4,5,6,7.125,8,9,3,ann,22.5"]


def written(tmp_path: Path, text: str | bytes) -> Path:
    """A file with these bytes."""
    path = tmp_path / "run.csv"
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return path


@pytest.mark.parametrize("end", ["\n", "\r\n"])
@pytest.mark.parametrize("begin", ["", "\ufeff"])
@pytest.mark.parametrize("separator", [",", ";", "\t"])
@pytest.mark.parametrize("last", ["\n", ""])
def test_a_plain_file_is_read_at_once_to_the_same_bits(
    tmp_path: Path, end: str, begin: str, separator: str, last: str
) -> None:
    """Catches line ends, a byte-order mark, an empty cell or a word that send every file the slow way, or change it."""
    text = begin + (HEADER + "\n".join(ROWS) + last).replace(",", separator).replace("\n", end)
    path = written(tmp_path, text)
    plain = read_plain(path)
    assert plain is not None
    frame, line = plain
    slow, slow_line = next(csv_blocks(path))
    assert line.tolist() == slow_line.tolist() == [2, 3, 4]
    assert frame.columns == slow.columns
    for name in frame.columns:
        if name != "operator":
            expected = np.array([float(cell or "nan") for cell in slow[name]])
            np.testing.assert_array_equal(frame[name].cast(float).to_numpy(), expected)
    data = sk.read_measurements(path)
    assert data.labels["operator"].tolist() == ["ann", "bob", "ann"]
    assert data.taken[1].tolist()[:3] == [True, False, True]


def test_numbers_are_the_nearest_ones(tmp_path: Path) -> None:
    """Catches a reader of numbers that is off by one bit where digits are many."""
    rng = np.random.default_rng(4)
    digits = [[repr(float(v)) for v in row] for row in rng.normal(0, 10.0 ** rng.integers(-9, 3, (400, 6)))]
    path = written(tmp_path, "q1_mm,q2_mm,q3_mm,x_mm,y_mm,z_mm\n" + "\n".join(",".join(row) for row in digits))
    plain = read_plain(path)
    np.testing.assert_array_equal(plain[0].to_numpy(), np.array(digits, dtype=float))


@pytest.mark.parametrize(
    ("row", "said"),
    [
        ("1,2,3,x,5,6,4,ann,1", "line 5, column 'x_mm': 'x' is not a number"),
        ("1,2,3,4,5,6,4,ann", "line 5 has 8 cells, the header has 9"),
        ("1,2,3,4,5,6,4,ann,1,7", "line 5 has 10 cells, the header has 9"),
        ("1,2,3,nan,5,6,4,ann,1", "line 5, column 'x_mm': nan is not a measurement"),
        ("1,2,3,inf,5,6,4,ann,1", "line 5, column 'x_mm': inf is not a measurement"),
        ("1,2,3,1e400,5,6,4,ann,1", "line 5, column 'x_mm': inf is not a measurement"),
        (",2,3,4,5,6,4,ann,1", "line 5, column 'q1_mm': is empty"),
        ("1,2,3,4,5,6,4.5,ann,1", "line 5, column 'pose': 4.5 is not a whole number"),
        ('1,2,3,4,5,6,4,"ann,1', "line 5 is not CSV: a quotation mark is not closed"),
    ],
)
def test_what_is_wrong_is_said_as_before(tmp_path: Path, row: str, said: str) -> None:
    """Catches a fast reader that swallows a cell, a row too long beside one too short, or names another line."""
    path = written(tmp_path, HEADER + "\n".join([*ROWS, row]) + "\n")
    with pytest.raises(sk.errors.MeasurementError) as caught:
        sk.read_measurements(path)
    assert said in str(caught.value)


@pytest.mark.parametrize(
    "text",
    [
        HEADER + "\n".join([ROWS[0], "", ROWS[1], "  ", ROWS[2]]) + "\n\n",
        HEADER + "\n".join([ROWS[0], "# the lamp was changed, and more", ROWS[1], ROWS[2]]) + "\n",
        "# by ann\n" + HEADER + "\n".join(ROWS),
        HEADER + "\n".join([*ROWS[:2], ROWS[2].replace("ann", '"ann, the first"')]),
        HEADER + "\n".join([ROWS[0], ROWS[1].replace("bob", '"b\nob"'), ROWS[2]]),
        HEADER + "\n".join(ROWS).replace(",", ", "),
    ],
)
def test_what_is_not_plain_takes_the_other_way(tmp_path: Path, text: str) -> None:
    """Catches empty lines, notes, quotes and blanks that are lost, or moved to another line."""
    path = written(tmp_path, text)
    data = sk.read_measurements(path)
    assert len(data) == 3
    assert data.readings[2].tolist()[:3] == [7.125, 8.0, 9.0]
    assert data.line.tolist() == next(csv_blocks(path))[1].tolist()
