"""``sherkit check``: all that is wrong with a file at once, lines and cures, and the rows mended without a guess."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import sherkit as sk
from running import command
from second_machines import apart
from sherkit import save_robot
from sherkit.data.file_check import FileCheck, check_file
from sherkit.errors import MeasurementError
from sherkit.model.kinds import known_kinds
from strategies import EXAMPLE

OURS = ("q1_mm", "q2_mm", "q3_mm", "x_mm", "y_mm", "z_mm", "temperature_c")
GERMAN = ("Achse 1", "Achse 2", "Achse 3", "Pos X", "Pos Y", "Pos Z", "Temperatur")
UNITS = ("µm", "µm", "µm", "mm", "mm", "mm", "°C")


def run_of(rows: int, seed: int = 0) -> np.ndarray[Any, Any]:
    """Joints, place and temperature (rows, 7) as digits have them."""
    machine = sk.delta.VirtualDelta.draw(EXAMPLE, seed, noise_mm=0.005)
    place = np.random.default_rng(seed).uniform(-15.0, 15.0, (rows, 3))
    data = machine.measure(place, repeats=1, seed=seed)
    warm = 20.0 + 0.01 * np.arange(rows)
    return np.column_stack([data.joints, data.readings[:, :3], warm]).round(4)


def said(folder: Path, *arguments: str) -> tuple[int, str, str]:
    """Exit code, stdout and stderr of a command in a folder."""
    code, out, err = command(folder, *arguments)
    return code, " ".join(out.split()), err


def german(values: np.ndarray[Any, Any]) -> bytes:
    """The run as a spreadsheet of a German laboratory leaves it."""

    def number(v: float, digits: int = 4) -> str:
        return f"{v:.{digits}f}".replace(".", ",")

    names = ";".join((*GERMAN, "Datum", "Bemerkung", ""))
    lines = ["Messprotokoll Kreuztisch;;;;;;;;;", "Bearbeiter: Müller;;;;;;;;;", ";;;;;;;;;", names]
    lines.append(";".join([*(f"[{u}]" for u in UNITS), "", "", ""]))
    for k, row in enumerate(values):
        if k == 6:
            lines.append(names)
        cells = [number(1e3 * v, 1) for v in row[:3]] + [number(v) for v in row[3:]]
        if k == 2:
            cells[3] = "---"
        moment = f"24.11.2026 23:59:{30 + 5 * k:02d}" if k < 6 else f"25.11.2026 00:00:{5 * (k - 6):02d}"
        lines.append(";".join([*cells, moment, "geprüft" if k % 3 else "ok", ""]))
    return "\r\n".join([*lines, ";;;;;;;;;"]).encode("cp1252")


def test_a_german_file_takes_one_check(tmp_path: Path) -> None:
    """Catches a second refusal behind the first, a row that is lost, a unit that is not converted, a time that stands
    still over midnight, a comma that is taken for a thousand, and a first command that does not lead to a verdict."""
    values = run_of(12)
    (tmp_path / "run.csv").write_bytes(german(values))
    save_robot(EXAMPLE, tmp_path / "robot.toml")
    found = check_file(tmp_path / "run.csv")
    assert found.is_mended
    assert not found.is_good
    told = {one.lines: str(one) for one in found.wrong}
    assert "Windows-1252" in told[2,]
    assert "above the names" in told[1, 2, 3]
    assert "row of units" in told[5,]
    assert "names of the columns stand here again" in told[12,]
    assert "separators alone" in told[19,]
    assert "'---' is no number" in told[8,]
    assert any("dates with times" in str(one) for one in found.wrong)
    assert found.columns == dict(zip(OURS, [f"{n} [{u}]" for n, u in zip(GERMAN, UNITS, strict=True)], strict=True)) | {
        "time_s": "time_s"
    }
    assert found.unused == {"Bemerkung": ""}
    code, told_all, _ = said(tmp_path, "check", "run.csv", "robot.toml", "--write", "clean.csv")
    assert code == 0
    assert "sherkit diagnose robot.toml clean.csv" in told_all
    clean = sk.read_measurements(tmp_path / "clean.csv")
    np.testing.assert_allclose(clean.joints, values[:, :3], atol=1e-4)
    expected = values[:, 3:6].copy()
    expected[2, 0] = np.nan
    np.testing.assert_allclose(np.where(clean.taken, clean.readings, np.nan)[:, :3], expected, atol=1e-9)
    np.testing.assert_allclose(clean.covariates["temperature_c"], values[:, 6], atol=1e-9)
    assert clean.time_s is not None
    np.testing.assert_allclose(np.diff(clean.time_s), 5.0)
    assert said(tmp_path, "diagnose", "robot.toml", "clean.csv")[0] == 0
    assert said(tmp_path, "check", "clean.csv")[0] == 0


def test_a_refusal_points_to_it(tmp_path: Path) -> None:
    """Catches a reader that leaves a person alone with the first of seven mistakes."""
    (tmp_path / "run.csv").write_bytes(german(run_of(12)))
    save_robot(EXAMPLE, tmp_path / "robot.toml")
    code, _, err = said(tmp_path, "diagnose", "robot.toml", "run.csv")
    assert code == 1
    assert "sherkit check run.csv lists all" in err


@pytest.mark.filterwarnings("default::sherkit.errors.SherkitWarning")
def test_what_is_proposed_is_toml(tmp_path: Path) -> None:
    """Catches a mapping that no robot file can hold, and a file that is called good although its names are foreign:
    with the mapping in the robot file it is."""
    values = run_of(12)
    lines = [",".join(f'"{n} [{u}]"' for n, u in zip(GERMAN[:6], UNITS, strict=False))]
    lines += [",".join(f"{v:.7g}" for v in (*1e3 * row[:3], *row[3:6])) for row in values]
    (tmp_path / "run.csv").write_text("\n".join(lines), encoding="utf-8")
    save_robot(EXAMPLE, tmp_path / "robot.toml")
    code, _, _ = said(tmp_path, "check", "run.csv", "robot.toml")
    assert code == 1
    with pytest.raises(MeasurementError) as refused:
        sk.read_measurements(tmp_path / "run.csv")
    columns = str(refused.value)[str(refused.value).index("columns = ") :]
    robot = (tmp_path / "robot.toml").read_text(encoding="utf-8")
    assert tomllib.loads(columns)["columns"]["q1_mm"] == "Achse 1 [µm]"
    (tmp_path / "robot.toml").write_text(f"{columns}\n{robot}", encoding="utf-8")
    code, told, _ = said(tmp_path, "check", "run.csv", "robot.toml")
    assert code == 0, told
    assert said(tmp_path, "diagnose", "robot.toml", "run.csv")[0] == 0


@pytest.mark.parametrize(
    ("change", "said_of_it"),
    [
        (lambda rows: [*rows[:5], rows[5].rpartition(";")[0], *rows[6:]], "line 6: has 6 cells, the header has 7"),
        (lambda rows: [*rows[:5], rows[5].replace(";", ";12o4", 1), *rows[6:]], "is not a number"),
        (lambda rows: [rows[0].replace("q2_mm", "q1_mm"), *rows[1:]], "'q1_mm' is the name of two columns"),
        (lambda rows: [*rows[:3], rows[3].replace(".", ",", 1), *rows[4:]], "decimal commas and decimal points"),
        (lambda rows: [*rows[:4], ";" + rows[4].partition(";")[2], *rows[5:]], "is empty"),
        (lambda rows: rows[:1], "holds no row"),
    ],
)
def test_what_must_be_guessed_is_left_to_a_person(
    change: Callable[[list[str]], list[str]], said_of_it: str, tmp_path: Path
) -> None:
    """Catches a row that is left out in silence, and a file that is written although something in it is not known."""
    rows = [";".join(OURS), *(";".join(f"{v:.4f}" for v in row) for row in run_of(12))]
    (tmp_path / "run.csv").write_text("\n".join(change(rows)), encoding="utf-8")
    code, told, err = said(tmp_path, "check", "run.csv", "--write", "clean.csv")
    assert code == 1
    assert not (tmp_path / "clean.csv").exists()
    assert said_of_it in " ".join((told + err).replace("│", " ").split())


def test_thousands_are_told_from_decimals(tmp_path: Path) -> None:
    """Catches 1.234,5 read as 1.2345, and 1,000 taken for either."""
    head = "q1_mm;q2_mm;q3_mm;x_mm;y_mm;z_mm"
    grouped = [f"1.{100 + k},5;2.000,25;-1.{300 + 7 * k},125;{k},5;0,25;1,5" for k in range(6)]
    (tmp_path / "run.csv").write_text("\n".join([head, *grouped]), encoding="utf-8")
    found = check_file(tmp_path / "run.csv")
    np.testing.assert_allclose(found.data.joints[:, 0], 1100.5 + np.arange(6))
    np.testing.assert_allclose(found.data.joints[:, 2], -1300.125 - 7 * np.arange(6))
    assert any("between its thousands" in str(one) for one in found.wrong)
    both = [f"1,{100 + k};2,000;1,{300 + k};{k};0;1" for k in range(6)]
    (tmp_path / "run.csv").write_text("\n".join([head, *both]), encoding="utf-8")
    found = check_file(tmp_path / "run.csv")
    assert not found.is_mended
    assert any("may be a thousand" in str(one) for one in found.wrong)


@settings(max_examples=40, deadline=None)
@given(
    separator=st.sampled_from([";", "\t", ","]),
    comma=st.booleans(),
    encoding=st.sampled_from(["utf-8", "utf-8-sig", "cp1252", "utf-16"]),
    notes=st.integers(0, 3),
    padded=st.booleans(),
    units=st.booleans(),
    again=st.sets(st.integers(1, 10), max_size=2),
    nothing=st.sets(st.integers(0, 11), max_size=3),
    word=st.sampled_from(["---", "n/a", "NaN", "-", "#NV"]),
    blank=st.booleans(),
)
def test_every_row_comes_back(
    separator: str, comma: bool, encoding: str, notes: int, padded: bool, units: bool, again: set[int],
    nothing: set[int], word: str, blank: bool, tmp_path_factory: pytest.TempPathFactory,
) -> None:  # fmt: skip
    """Catches a row, a digit or a unit that is lost on the way, in any mixture of what laboratories do to a file: the
    numbers are those that were written, whatever stands around them."""
    comma = comma and separator != ","
    values = run_of(12, 3)[:, :6]
    values[:, :3] = values[:, :3].round(3)
    names = [f"Ächse {k}" for k in (1, 2, 3)] + ["Pos X", "Pos Y", "Pos Z"]
    head = separator.join(names if units else [f"{n} [mm]" for n in names])
    pad = separator * 5 if padded else ""
    lines = [f"Protokoll {k} ä{pad}" for k in range(notes)] + [head] + ([separator.join(["mm"] * 6)] if units else [])
    for k, row in enumerate(values):
        if k in again:
            lines.append(head)
        cells = [f"{v:.4f}".replace(".", "," if comma else ".") for v in row]
        if k in nothing:
            cells[4] = word
        lines.append(separator.join(cells))
    lines += [separator * 5] if blank else []
    path = tmp_path_factory.mktemp("lab") / "run.csv"
    path.write_bytes("\n".join(lines).encode(encoding))
    found = check_file(path)
    assert found.is_mended, [str(one) for one in found.wrong] + [found.refused]
    expected = values.copy()
    expected[sorted(nothing), 4] = np.nan
    np.testing.assert_allclose(found.data.joints, expected[:, :3], atol=1e-9)
    read = np.where(found.data.taken, found.data.readings, np.nan)
    np.testing.assert_allclose(read[:, :3], expected[:, 3:], atol=1e-9)
    assert len(found.data) == 12
    listed = " ".join(str(one) for one in found.wrong)
    assert ("above the names" in listed) == (notes > 0)
    assert ("row of units" in listed) == units
    assert ("stand here again" in listed) == bool(again)
    assert (f"'{word}' is no number" in listed) == bool(nothing)


def test_json_says_the_same(tmp_path: Path) -> None:
    """Catches a program that is told less than a person."""
    (tmp_path / "run.csv").write_bytes(german(run_of(12)))
    _, told, _ = said(tmp_path, "check", "run.csv", "--json")
    read = json.loads(told)
    found: FileCheck = check_file(tmp_path / "run.csv")
    assert [one["said"] for one in read["wrong"]] == [one.said for one in found.wrong]
    assert read["rows"] == 12
    assert read["unused"] == {"Bemerkung": ""}
    assert not read["good"]
    assert read["mended"]


def test_what_is_no_table_is_refused(tmp_path: Path) -> None:
    """Catches a traceback, and a picture that is read as a run."""
    for content in (b"", b"\x89PNG\0\0\0", b"# a note\n", b"1,2,3\n4,5,6\n"):
        (tmp_path / "run.csv").write_bytes(content)
        code, _, err = said(tmp_path, "check", "run.csv")
        assert code == 1
        assert err.startswith("error: run.csv")
    assert said(tmp_path, "check", "nowhere.csv")[0] == 1


def test_units_in_cells_and_kelvin(tmp_path: Path) -> None:
    """Catches rows that are taken for notes since every cell has its unit behind it, and 293 °C."""
    values = run_of(8)
    rows = ["Motor 1,Motor 2,Motor 3,X,Y,Z,Temp (K),Zeit"]
    rows += [
        ",".join([f"{v:.4f} mm" for v in row[:6]] + [f"{row[6] + 273.15:.2f}", f"{k % 12 + 1}:30 PM"])
        for k, row in enumerate(values)
    ]
    (tmp_path / "run.csv").write_text("\n".join(rows), encoding="utf-8")
    found = check_file(tmp_path / "run.csv")
    assert found.is_mended, found.refused
    np.testing.assert_allclose(found.data.joints, values[:, :3], atol=1e-9)
    np.testing.assert_allclose(found.data.covariates["temperature_c"], values[:, 6], atol=1e-2)
    assert found.data.time_s is not None
    np.testing.assert_allclose(np.diff(found.data.time_s), 3600.0)
    assert any("is in kelvin" in str(one) for one in found.wrong)
    assert sum("every cell ends in 'mm'" in str(one) for one in found.wrong) == 6


def test_a_sentence_repeats_a_cell_on_one_line(tmp_path: Path) -> None:
    """Catches a cell of a hundred lines, as a pasted note, that fills the screen in place of the sentence."""
    run = tmp_path / "run.csv"
    lines = ["q1_mm,q2_mm,q3_mm,x_mm,y_mm,z_mm", *(",".join(map(str, row[:6])) for row in run_of(8))]
    lines[3] = '"' + "see the\nbook " * 40 + '",' + lines[3].partition(",")[2]
    run.write_text("\n".join(lines))
    with pytest.raises(MeasurementError) as refused:
        sk.read_measurements(run)
    assert "\n" not in str(refused.value)
    assert len(str(refused.value)) < 300
    found = check_file(run)
    (wrong,) = found.wrong
    assert wrong.lines == (4,)
    assert "'see the book" in wrong.said
    assert len(wrong.said) < 120


def test_rows_that_are_short_alike_are_one_thing(tmp_path: Path) -> None:
    """Catches a list of two thousand lines that says one thing two thousand times."""
    run = tmp_path / "run.csv"
    lines = ["q1_mm,q2_mm,q3_mm,x_mm,y_mm,z_mm", *(",".join(map(str, row[:6])) for row in run_of(30))]
    lines[4:24] = [line.rpartition(",")[0] for line in lines[4:24]]
    run.write_text("\n".join(lines))
    (wrong,) = check_file(run).wrong
    assert str(wrong) == "lines 5-24: has 5 cells, the header has 6"


# -- the run of another robot ----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def robots(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A robot of each kind and a short run of each, but for the printer, whose run is its probing."""
    folder = tmp_path_factory.mktemp("robots")
    for name, kind in known_kinds().items():
        if name in ("delta", "spherical", "serial", "printer"):
            save_robot(kind.example, folder / f"{name}.toml")
    place = np.random.default_rng(0).uniform(-15.0, 15.0, (12, 3))
    sk.delta.VirtualDelta.draw(EXAMPLE, 0, noise_mm=0.005).measure(place, repeats=1, seed=0).save(folder / "delta.csv")
    for kind, runs in (("spherical", "theta1_rad,theta2_rad,u_px,v_px"), ("serial", "joint_1_rad,joint_2_rad,x_mm")):
        rows = np.random.default_rng(1).uniform(0.1, 0.9, (12, runs.count(",") + 1))
        (folder / f"{kind}.csv").write_text("\n".join([runs, *(",".join(map(str, row)) for row in rows)]) + "\n")
    return folder


@pytest.mark.parametrize(
    ("run", "robot", "lacks"),
    [
        ("delta", "spherical", "theta1_rad, theta2_rad and at least one of u_px, v_px, phi_rad, gamma_rad"),
        ("delta", "serial", "joint_1_rad, joint_2_rad, joint_3_rad"),
        ("delta", "printer", "lacks at least one of measured_mm"),
        ("spherical", "delta", "q1_mm, q2_mm, q3_mm and at least one of x_mm, y_mm, z_mm, distance_mm"),
        ("spherical", "printer", "q1_mm, q2_mm, q3_mm and at least one of measured_mm"),
        ("serial", "delta", "q1_mm, q2_mm, q3_mm; the file has joint_1_rad, joint_2_rad, x_mm"),
        ("serial", "serial", "lacks joint_3_rad, joint_4_rad, joint_5_rad, joint_6_rad;"),
    ],
)
def test_the_run_of_another_robot_is_refused(robots: Path, run: str, robot: str, lacks: str) -> None:
    """Catches "nothing is wrong", the exit code 0 and a next command that fails, for rows of another kind of robot; and
    a sentence that names neither file, nor which columns are missing."""
    code, out, _ = said(robots, "check", f"{run}.csv", f"{robot}.toml")
    assert code == 1
    assert f"{run}.csv: is no run of {robot}.toml ({robot}): lacks" in out
    assert lacks in out
    assert "nothing is wrong" not in out
    assert "sherkit diagnose" not in out


@pytest.mark.parametrize(
    ("column", "rows", "value", "words"),
    [
        ("z_mm", [7], 1e30, "z_mm is 1e+30, far from all others"),
        ("x_mm", [5, 6, 7], -9999.0, "lines 7, 8, 9: x_mm is -9999"),
        ("q2_mm", [11], 9999.0, "q2_mm is 9999"),
        ("y_mm", list(range(60)), 5.0, "y_mm is 5 in all 60 rows, while the joints move"),
    ],
)
def test_values_that_no_machine_gives_are_said(
    column: str, rows: list[int], value: float, words: str, tmp_path: Path
) -> None:
    """Catches "nothing is wrong" of readings that were lost or froze; and a pose that was really driven to, far from
    the others, taken for one."""
    values = run_of(60)
    values[30, :6] = [4000.0, 4000.0, 4000.0, 0.0, 0.0, 4000.0]
    head = ",".join(OURS)
    np.savetxt(tmp_path / "sound.csv", values, delimiter=",", header=head, comments="", fmt="%.6g")
    values[rows, OURS.index(column)] = value
    np.savetxt(tmp_path / "run.csv", values, delimiter=",", header=head, comments="", fmt="%.6g")
    sound, wrong = (check_file(tmp_path / name).wrong for name in ("sound.csv", "run.csv"))
    assert not sound
    assert len(wrong) == 1
    assert words in str(wrong[0].said)


def test_what_check_praises_diagnose_reads(robots: Path, tmp_path: Path) -> None:
    """Catches columns that the robot's file names and the run has not, and columns of two robots in one file, of which
    a diagnosis takes the other's: both were called good."""
    rows = (robots / "delta.csv").read_text().splitlines()
    both = [f"{row},{'measured_mm' if k == 0 else 0.01}" for k, row in enumerate(rows)]
    (tmp_path / "both.csv").write_text("\n".join(both))
    (tmp_path / "run.csv").write_text("\n".join(rows))
    toml = (robots / "delta.toml").read_text()
    (tmp_path / "named.toml").write_text(f'columns = {{ q1_mm = "Enc 1" }}\n{toml}')
    (tmp_path / "printer.toml").write_text((robots / "printer.toml").read_text())
    for run, robot, what in (
        ("run.csv", "named.toml", "1 thing is wrong"),
        ("both.csv", "printer.toml", "is no run of a printer robot"),
    ):
        code, out, _ = said(tmp_path, "check", run, robot)
        assert code == 1
        assert what in out
        assert said(tmp_path, "diagnose", robot, run)[0] == 1


def test_a_machine_of_ones_own_has_its_columns(tmp_path: Path) -> None:
    """Catches a machine whose good run is refused since another robot has its columns too, and one of another's."""
    (tmp_path / "xy.py").write_text(
        "import sherkit as sk\ndef forward(j, p):\n    return j * (1 + p.scale)\n"
        "machine = sk.Machine(forward, joints=('q1_mm', 'q2_mm'), readings=('x_mm', 'y_mm'), name='xy_checked', "
        "parameters={'scale': ('mm', 1e-3)})\n"
    )
    (tmp_path / "run.csv").write_text(
        "q1_mm,q2_mm,x_mm,y_mm\n" + "\n".join(f"{k},{k * k},{k},{k * k}" for k in range(9))
    )
    (tmp_path / "other.csv").write_text("a_rad,x_mm,y_mm\n" + "\n".join(f"0.{k},{k},{k * k}" for k in range(9)))
    with apart():
        good, other = (command(tmp_path, "check", f"{name}.csv", "xy.py") for name in ("run", "other"))
    assert good[0] == 0
    assert other[0] == 1
    assert "is no run of xy.py (xy_checked): lacks q1_mm, q2_mm" in " ".join(other[1].split())
