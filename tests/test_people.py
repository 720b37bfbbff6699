"""What people really have, tried as they would: inputs after public reports, made by the generators in ``people/``,
which share no code with sherkit.

A case is a folder there and a test here. ``case`` makes its files; each test runs verbs on them and asks for what a
right answer says.
"""

from __future__ import annotations

import contextlib
import io
import re
import runpy
import shlex
import shutil
import sys
import warnings
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from scipy.spatial.transform import Rotation

import sherkit as sk
from running import command, slow
from sherkit.base.figures import number, stated
from sherkit.cli.next_command import completed
from sherkit.data.tables import columns_called
from sherkit.errors import EffectError, MeasurementError, RobotError
from sherkit.model.effect import load_effects
from sherkit.robots.machine import load_machine

#: A command says its warnings; the generators are plain scripts, which leave it to Python to close a file.
pytestmark = [
    pytest.mark.filterwarnings("always::sherkit.errors.SherkitWarning"),
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
]
HERE = Path(__file__).parent / "people"


def case(name: str, folder: Path, *arguments: str) -> Path:
    """The files of a case in a folder of their own, made by its generator where it has one."""
    made = folder / name
    shutil.copytree(HERE / name, made)
    if (made / "make.py").exists():
        before = sys.argv
        sys.argv = ["make.py", *arguments]
        try:
            with contextlib.chdir(made), contextlib.redirect_stdout(io.StringIO()):
                runpy.run_path("make.py")
        finally:
            sys.argv = before
    return made


def ran(folder: Path, line: str, code: int = 0) -> str:
    """What a command says on both streams, on one line; that it ends so, and without a traceback."""
    ended, out, err = command(folder, *shlex.split(line))
    assert ended == code, (line, out, err)
    assert "Traceback" not in err
    return " ".join((out + err).split())


def proposed(said: str, verb: str) -> str:
    """The first command of a verb that an answer proposes, without the name of the program."""
    found = re.search(rf"sherkit ({verb} \S.*?)(?=  | sherkit | 1\. | Error on| \w+ it:|$)", said)
    assert found is not None, said
    return found[1]


# -- Files ---------------------------------------------------------------------------------------------------------


def test_cells_that_spaces_part_are_read(tmp_path: Path) -> None:
    """Catches a traceback at a table without commas, and a reader that knows spaces where another does not."""
    shutil.copy(HERE / "space.txt", tmp_path)
    assert "read as" in ran(tmp_path, "check space.txt", 1)
    (tmp_path / "run.txt").write_text(
        "q1_mm q2_mm  q3_mm\tx_mm y_mm z_mm\n1 2 3  4,5 5,25 6\n 2 3 4 4,75 5,5 7,5 \n".replace("\t", " ")
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        run = sk.read_measurements(tmp_path / "run.txt")
    np.testing.assert_allclose(run.readings[:, :3], [[4.5, 5.25, 6.0], [4.75, 5.5, 7.5]])
    table = "d_mm a_mm alpha_deg\n89 0 90\n0 -425 0\n"
    (tmp_path / "dh.txt").write_text(table)
    assert "2 joints" in ran(tmp_path, "import dh dh.txt -o arm.toml")


def test_a_table_without_names_is_told_its_columns(tmp_path: Path) -> None:
    """Catches a compensation table that can be read by nobody, a check that points to itself, and options that a
    proposed command loses."""
    made = case("screw", tmp_path)
    said = ran(made, "check comp.txt", 1)
    assert "--columns with 3 names" in said
    assert "lists all that is wrong" not in said
    names = "--columns axis_mm,laser_mm,back_mm"
    assert "nothing is wrong, 25 rows" in ran(made, f"check comp.txt screw.py {names}")
    said = ran(made, f"diagnose screw.py comp.txt {names}")
    assert "Verdict" in said
    if "sherkit diagnose" in said:
        assert names in said[said.index("sherkit diagnose") :]
    with pytest.raises(MeasurementError, match="a name of its own for each column"), columns_called(("a", "a")):
        pass


def test_numpy_writes_names_behind_a_number_sign(tmp_path: Path) -> None:
    """Catches ``numpy.savetxt(header=...)`` that is refused as a table without names."""
    rows = np.random.default_rng(0).uniform(1, 2, (5, 6))
    np.savetxt(tmp_path / "run.dat", rows, header="q1_mm q2_mm q3_mm x_mm y_mm z_mm")
    np.testing.assert_allclose(sk.read_measurements(tmp_path / "run.dat").joints, rows[:, :3])
    assert "5 rows" in ran(tmp_path, "check run.dat")


#: What the azimuth's encoder errs by, in the night's degrees and in radians.
SINE = "sine_az = 0.00227 ± 0.00019"


def test_a_night_as_tpoint_writes_it(tmp_path: Path) -> None:
    """Catches lines of words above and below the rows that end a reading where the columns are told."""
    made = case("tpoint", tmp_path)
    assert "--columns with 5 names" in ran(made, "check night.dat tel.py", 1)
    names = "--columns az_deg,el_deg,encaz_deg,encel_deg,rot_deg"
    said = ran(made, f"diagnose tel.py night.dat {names}")
    assert "The model lacks encoder_eccentricity" in said
    assert SINE in said
    mended = proposed(ran(made, f"check night.dat tel.py {names}", 1), "check").partition("rot_deg")
    assert "69 rows, none lost" in ran(made, "".join(mended[:2]))
    assert len(pl.read_csv(made / "clean.csv")) == 69


def test_degrees_are_as_good_as_radians(tmp_path: Path) -> None:
    """Catches an encoder whose errors are looked for in radians alone."""
    made = case("tpoint", tmp_path)
    said = ran(made, "diagnose telrad.py night_rad.csv")
    assert "The model lacks encoder_eccentricity" in said
    assert SINE in said


@pytest.mark.parametrize(("unit", "per_deg"), [("deg", 1.0), ("mrad", 1e3 * np.pi / 180), ("arcmin", 60.0)])
def test_an_encoder_off_its_centre_in_any_unit(unit: str, per_deg: float, tmp_path: Path) -> None:
    """Catches an eccentricity that is lost, or of another size, for a unit: 0.379° is in cosine."""
    made = case("encoder", tmp_path)
    count = pl.read_csv(made / "enc.csv")["count"].to_numpy()
    seen = np.rad2deg(np.unwrap(2 * np.pi * count / 16384)) - 360.0
    table = {f"motor_{unit}": per_deg * 1.8 * np.tile(np.arange(200), 2), f"seen_{unit}": per_deg * seen}
    turn = np.repeat([0.0, 360.0], 200)
    table[f"seen_{unit}"] = table[f"seen_{unit}"] - per_deg * turn
    pl.DataFrame(table).write_csv(made / "run.csv")
    text = (made / "enc.py").read_text()
    text = (
        text.replace("_deg", f"_{unit}")
        .replace('"deg", 10.0', f'"{unit}", {10 * per_deg}')
        .replace("360", f"{360 * per_deg}")
    )
    (made / "enc.py").write_text(text)
    found = sk.diagnose(sk.Study(machine_in(made / "enc.py"), made / "run.csv").fit)
    assert found.effects == ("encoder_eccentricity", "encoder_two_per_turn")
    values = dict(zip([p.name for p in found.fit.parameters], found.fit.values, strict=True))
    assert values["encoder_eccentricity.cosine_motor"] / per_deg == pytest.approx(0.379, abs=0.004)


def machine_in(path: Path) -> sk.Machine:
    """The machine of a Python file."""
    return load_machine(path)


@pytest.mark.parametrize("unit", ["V", "1/m", *slow("counts", "K", "nm", "steps")])
def test_a_reading_in_any_unit(unit: str, tmp_path: Path) -> None:
    """Catches a unit that is refused, and an accuracy that is called micrometres whatever is read."""
    (tmp_path / "lamp.py").write_text(
        "import sherkit as sk\n"
        "def forward(q, p):\n    return 3.0 + (0.001 + p.gain) * q[:, :1] + p.zero\n"
        f"machine = sk.Machine(forward, joints={{'knob_mm': (0, 100)}}, readings=('lamp_{unit}',),\n"
        f"    name='lamp_{unit[:1]}', parameters={{'zero': ('{unit}', 0.1), 'gain': ('{unit}/mm', 1e-3)}})\n"
    )
    rng = np.random.default_rng(3)
    q = rng.uniform(0, 100, 60).round(2)
    pl.DataFrame({"knob_mm": q, f"lamp_{unit}": 3.05 + 0.0013 * q + rng.normal(0, 1e-3, 60)}).write_csv(
        tmp_path / "run.csv"
    )
    said = ran(tmp_path, "calibrate lamp.py run.csv")
    assert f"accuracy, {unit}" in said
    assert f"lamp, {unit}" in said
    assert f"{unit} RMS" in ran(tmp_path, "diagnose lamp.py run.csv")


def test_a_unit_is_text_and_no_axis(tmp_path: Path) -> None:
    """Catches a reading whose owner forgot the unit, taken for one in the unit x."""
    with pytest.raises(RobotError, match="'laser_x' names no unit"):
        sk.Machine(lambda q, p: q[:, :1], joints=("a_mm",), readings=("laser_x",), parameters={})


def test_a_sheet_with_means_dates_and_names_of_its_own(tmp_path: Path) -> None:
    """Catches a row of means that is a mistake of every column, a date with marks between its thousands, and columns
    that are called SMR X (mm), Enc A (mm) or Target (mm) for which nothing is proposed."""
    rng = np.random.default_rng(1)
    numbers = np.column_stack([rng.uniform(-80, 80, (9, 3)), rng.uniform(100, 160, (9, 3))])
    rows = [f"{12 + k}.03.2024;" + ";".join(f"{v:.4f}".replace(".", ",") for v in row) for k, row in enumerate(numbers)]
    means = "Mittelwert;" + ";".join(f"{v:.4f}".replace(".", ",") for v in numbers.mean(axis=0))
    head = "Datum;SMR X (mm);SMR Y (mm);SMR Z (mm);Enc A (mm);Enc B (mm);Enc C (mm)"
    (tmp_path / "sheet.csv").write_text("\n".join([head, *rows, means]) + "\n")
    said = ran(tmp_path, "check sheet.csv --write clean.csv")
    assert "line 11: is no row but what was computed of them" in said
    assert "thousands" not in said
    clean = pl.read_csv(tmp_path / "clean.csv")
    np.testing.assert_allclose(
        clean.select("x_mm", "y_mm", "z_mm", "q1_mm", "q2_mm", "q3_mm").to_numpy(), numbers, atol=1e-3
    )
    made = case("screw", tmp_path)
    said = ran(made, "check laser.txt screw.py", 1)
    assert re.search(r"Target \(mm\) │ axis_mm", said)
    assert "'Error (um)' is called a difference" in said


def test_sentences_speak_of_the_robot_that_is_there(tmp_path: Path) -> None:
    """Catches 'column q1_mm is missing' that is said to the owner of an arm, and 'kind is missing' of a calibration."""
    made = case("euler", tmp_path)
    case("encoder", tmp_path)
    said = ran(tmp_path, "diagnose euler/arm.toml encoder/enc.csv", 1)
    assert "column 'joint_1_rad' is missing" in said
    (made / "calibrated.toml").write_text('[calibration]\nformat = 4\n[robot]\nkind = "delta"\n')
    assert "is a calibration" in ran(made, "diagnose calibrated.toml rotvec.csv", 1)
    assert "did you mean 'diagnose'?" in ran(made, "diagnos arm.toml rotvec.csv", 2)


def test_the_report_of_a_plain_g33(tmp_path: Path) -> None:
    """Catches 'R is missing' in the place of what is to be done; with the radius it is read."""
    made = case("g33", tmp_path)
    said = ran(made, "import marlin g33.txt -o printer", 1)
    assert "does not say how far from the middle it probed" in said
    assert "'G33 R100 V2'" in said
    text = (made / "g33.txt").read_text()
    (made / "g33.txt").write_text(text.replace("G33 P4 V2", "G33 P4 R80 V2"))
    assert "7 rows" in ran(made, "import marlin g33.txt -o printer")


# -- Turns -----------------------------------------------------------------------------------------------------------


def poses_in(form: str, q: np.ndarray, x: np.ndarray, turn: Rotation) -> dict[str, np.ndarray]:
    """Joints (n, 6), rad, places (n, 3), mm, and turns as a controller names and writes them."""
    ours = dict(zip((f"joint_{k}_rad" for k in range(1, 7)), q.T, strict=True))
    if form == "matrix":
        m = np.concatenate([turn.as_matrix(), x[:, :, None]], axis=2)
        return ours | {f"t{i + 1}{j + 1}": m[:, i, j] for i in range(3) for j in range(4)}
    if form == "ABB":
        real_first = np.roll(turn.as_quat(), 1, axis=1).T
        return ours | dict(zip("xyz", x.T, strict=True)) | dict(zip(("q1", "q2", "q3", "q4"), real_first, strict=True))
    letter, names, axes = {"KUKA": ("A", "ABC", "ZYX"), "FANUC": ("J", "WPR", "xyz")}[form]
    joints = dict(zip((f"{letter}{k}" for k in range(1, 7)), np.rad2deg(q).T, strict=True))
    angles = turn.as_euler(axes, degrees=True).T
    return joints | dict(zip("XYZ", x.T, strict=True)) | dict(zip(names, angles, strict=True))


def points(folder: Path) -> np.ndarray:
    return pl.read_csv(folder / "run.csv").select("x_mm", "y_mm", "z_mm").to_numpy()


def test_turns_that_are_no_rotation_vectors(tmp_path: Path) -> None:
    """Catches roll, pitch and yaw that are read as a rotation vector without a word."""
    made = case("euler", tmp_path)
    assert "turns otherwise" not in ran(made, "import poses arm.toml rotvec.csv -o right")
    said = ran(made, "import poses arm.toml euler.csv -o read")
    assert "read as angles about the fixed axes x, y, z" in said
    np.testing.assert_allclose(points(made / "read"), points(made / "right"), atol=1e-3)


@pytest.mark.parametrize("form", ["KUKA", "FANUC", "ABB", "matrix"])
def test_poses_as_controllers_write_them(form: str, tmp_path: Path) -> None:
    """Catches a convention of a controller that is mistaken for another."""
    made = case("euler", tmp_path)
    table = pl.read_csv(made / "rotvec.csv").to_numpy()
    turn = Rotation.from_rotvec(table[:, 9:], degrees=True)
    pl.DataFrame(poses_in(form, table[:, :6], table[:, 6:9], turn)).write_csv(made / "poses.csv")
    said = ran(made, "import poses arm.toml poses.csv -o read")
    assert "turns otherwise" not in said
    ran(made, "import poses arm.toml rotvec.csv -o right")
    np.testing.assert_allclose(points(made / "read"), points(made / "right"), atol=1e-3)


def test_turns_the_other_way_round(tmp_path: Path) -> None:
    """Catches turns from the instrument's axes to the tool's, one more of the kind, that are taken for the others."""
    made = case("euler", tmp_path)
    frame = pl.read_csv(made / "rotvec.csv")
    frame.with_columns(-pl.col("rx_deg", "ry_deg", "rz_deg")).write_csv(made / "back.csv")
    said = ran(made, "import poses arm.toml back.csv -o read")
    assert "from the instrument's axes to the tool's" in said
    ran(made, "import poses arm.toml rotvec.csv -o right")
    np.testing.assert_allclose(points(made / "read"), points(made / "right"), atol=1e-3)


# -- Nothing moves ---------------------------------------------------------------------------------------------------

SPINDLE = """
import numpy as np
import sherkit as sk

def forward(q, p):
    return np.tile([[1.0, 0.0, 0.0]], (len(q), 1)) * p.x + np.array([[0, 1, 0]]) * p.y + np.array([[0, 0, 1]]) * p.z

machine = sk.Machine(forward, joints=(), readings=("x_um", "y_um", "z_um"), name="spindle_alone",
                     parameters={k: ("um", 10.0) for k in "xyz"})
"""


@pytest.mark.parametrize("still", [False, *slow(True)], ids=["no joints", "a joint that stands"])
def test_a_spindle_follows_its_own_temperature(still: bool, tmp_path: Path) -> None:
    """Catches a drift in time that is a matter of poses, thermometers that are no candidates, and a warning of NumPy on
    the screen. Truth: z follows the spindle by 2.1 µm/K, y the column by 0.8."""
    made = case("thermal", tmp_path)
    if not still:
        (made / "spindle.py").write_text(SPINDLE)
    said = ran(made, "diagnose spindle.py run.csv")
    assert "The model lacks thermal_shift, thermal_shift_column" in said
    assert re.search(r"(shift_z =|along z by) 2\.09\d+ ± [\d.]+ um/°C", said)
    assert re.search(r"(shift_y =|along y by) 0\.79\d+ ± [\d.]+ um/°C", said)
    assert "RuntimeWarning" not in said
    assert "warning" not in said
    line = proposed(said, "calibrate")
    assert "--effect thermal_shift_column" in line
    assert "calibration written to calibrated.toml" in ran(
        made, line.partition(" calibrated.toml")[0] + " calibrated.toml"
    )


def test_two_thermometers_of_one_more_machine(tmp_path: Path) -> None:
    """Catches a mast that follows its second thermometer alone and is said to follow the first, or neither."""
    (tmp_path / "mast.py").write_text(
        "import numpy as np\nimport sherkit as sk\n"
        "def forward(q, p):\n    return np.zeros((len(q), 1)) + p.zero\n"
        "machine = sk.Machine(forward, joints=(), readings=('tip_mm',), name='mast',\n"
        "    parameters={'zero': ('mm', 1.0)})\n"
    )
    rng, t = np.random.default_rng(5), 300.0 * np.arange(200)
    air = 12 + 6 * np.sin(2 * np.pi * t / 43_200) + rng.normal(0, 0.1, 200)
    steel = 14 + 5 * np.sin(2 * np.pi * t / 43_200 - 1.1) + 1e-5 * t + rng.normal(0, 0.1, 200)
    tip = 0.02 * (steel - 20) + 0.3 + rng.normal(0, 0.004, 200)
    frame = pl.DataFrame({"time_s": t, "temperature_c": air, "steel_c": steel, "tip_mm": tip})
    frame.write_csv(tmp_path / "run.csv")
    said = ran(tmp_path, "diagnose mast.py run.csv")
    assert re.search(r"thermal_shift_steel.*shift_tip = 0\.0(19|20)", said)
    study = sk.Study(machine_in(tmp_path / "mast.py"), tmp_path / "run.csv")
    study.add("thermal_shift_steel")
    study.save(tmp_path / "study")
    assert sk.Study.load(tmp_path / "study").effects == ("thermal_shift_steel",)


# -- Numbers, and commands -------------------------------------------------------------------------------------------


def test_what_is_not_observed_has_no_digits() -> None:
    """Catches ± 57000000000000000540, and small errors that are all 0.00."""
    assert stated(0.0, 5.7e19, "mm") == "not observed by these readings"
    assert stated(0.0, 3700.0, "mm/mm", 1e-3) == "not observed by these readings"
    assert stated(2.0, 0.1, "mm", 0.05) == "2.00 ± 0.10 mm"
    assert [number(v) for v in (0.0213, 0.0009, 0.0, 0.37)] == ["0.021", "0.0009", "0.00", "0.37"]


OWN = """
import numpy as np
import sherkit as sk

@sk.effect(at="joints", parameters={"sine": ("mm", 0.01), "cosine": ("mm", 0.01)}, physics="The thread is not round.")
def thread(rows, p):
    turn = 2 * np.pi * rows.joints / 37.0
    return p.sine * np.sin(turn) + p.cosine * np.cos(turn)
"""


def test_proposed_commands_work_as_they_stand(tmp_path: Path) -> None:
    """Catches 'add it' without the file of an effect of one's own, a seed that is lost, runs that are placeholders, and
    a template that would be written over the effects that were given."""
    made = case("screw", tmp_path)
    rng = np.random.default_rng(8)
    for name in ("a", "b"):
        x = rng.uniform(0, 300, 60).round(3)
        y = x + 0.02 * np.sin(2 * np.pi * x / 37.0 + 0.3) + rng.normal(0, 5e-4, 60)
        pl.DataFrame({"axis_mm": x, "laser_mm": y}).write_csv(made / f"{name}.csv")
    (made / "my_effects.py").write_text(OWN)
    said = ran(made, "diagnose screw.py a.csv b.csv --effects my_effects.py --seed 3")
    assert "RUN" not in said
    line = proposed(said, "calibrate").partition(" 1. ")[0]
    assert line.startswith("calibrate screw.py a.csv b.csv --effect ")
    assert line.endswith("-o calibrated.toml --effects my_effects.py --seed 3")
    assert "calibration written" in ran(made, line)
    _, out, _ = command(made, *shlex.split("diagnose screw.py a.csv b.csv --effects my_effects.py --json"))
    assert "ROBOT RUN" not in out
    assert completed("sherkit diagnose ROBOT RUN --template my_effects.py", "a b") == (
        "sherkit diagnose a b --template my_effects.py"
    )


def test_a_study_with_effects_of_ones_own_says_how_it_is_read(tmp_path: Path) -> None:
    """Catches an unknown effect in a study that was saved with it, without a word on how to give it again."""
    made = case("screw", tmp_path)
    (made / "my_effects.py").write_text(OWN)
    own = load_effects(made / "my_effects.py")
    study = sk.Study(machine_in(made / "screw.py"), made / "run.csv", effects=own)
    study.add("thread")
    study.save(made / "study")
    with pytest.raises(EffectError, match=re.escape("Study.load(folder, effects=[...])")):
        sk.Study.load(made / "study")
    assert sk.Study.load(made / "study", effects=own).effects == ("thread",)


# -- Joints that do not move -----------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_joint_that_stands_still_is_no_candidate(tmp_path: Path) -> None:
    """Catches a column of zeros that ends a verb, and sizes of what was never moved."""
    made = case("stilljoint", tmp_path, "1")
    run = pl.read_csv(made / "run.csv").with_columns(payload_kg=pl.lit(0.0))
    run.write_csv(made / "pay.csv")
    a, noise = np.random.default_rng(1).uniform(-2, 2, 80), np.random.default_rng(2).normal(0, 0.01, (2, 80))
    off = a + 1e-3 * np.sin(a + 0.3)
    x, y = 250 * np.cos(off) + 200 * np.cos(off + 1.0), 250 * np.sin(off) + 200 * np.sin(off + 1.0)
    one = pl.DataFrame({"a_rad": a, "b_rad": np.ones(80), "x_mm": x + noise[0], "y_mm": y + noise[1]})
    one.write_csv(made / "m.csv")
    for line in ("diagnose arm.toml run.csv", "diagnose arm.toml pay.csv", "compare arm.toml run.csv run.csv"):
        said = ran(made, line)
        assert not re.search(r"\d{15}|e\+?\d{3}", said), said
    assert "The model lacks encoder_eccentricity" in ran(made, "diagnose m.py m.csv")
    assert "offset_6" in ran(made, "calibrate arm.toml run.csv --free offset_6")


@pytest.mark.slow
def test_joints_that_only_jitter_count_as_still(tmp_path: Path) -> None:
    """Catches a fit that runs away along what 0.2 mrad of jitter seem to tell."""
    made = case("twojoints", tmp_path)
    for robot in ("near.toml", "far.toml"):
        fit = sk.identify(made / robot, made / "run.csv")
        assert fit.converged
        found = ran(made, f"diagnose {robot} run.csv")
        assert "nothing with structure is missing" in found
        assert "converge" not in found


def test_joints_that_froze_are_said_first(tmp_path: Path) -> None:
    """Catches a topic that was never renewed taken for one pose."""
    made = case("frozen", tmp_path)
    shutil.copy(HERE / "stilljoint" / "arm.toml", made)
    assert "froze" in ran(made, "check frozen.csv", 1)
    said = ran(made, "diagnose arm.toml frozen.csv")
    assert said.index("froze") < said.index("1. Is anything missing?")
    # readings of one pose are no frozen joints
    still = pl.read_csv(made / "frozen.csv")
    rng = np.random.default_rng(1)
    still = still.with_columns(**{f"{axis}_mm": 100 + 0.01 * rng.normal(size=len(still)) for axis in "xyz"})
    still.write_csv(made / "still.csv")
    assert "froze" not in ran(made, "check still.csv")


# -- Set-ups that a drawing does not have ----------------------------------------------------------------------------


def test_a_target_far_from_the_drawing(tmp_path: Path) -> None:
    """Catches units blamed for a target that nobody wrote into the file, and an effect that ends in another basin."""
    made = case("far_target", tmp_path)
    for robot in ("near.toml", "far.toml"):
        said = ran(made, f"diagnose {robot} run.csv")
        assert "The model lacks encoder_eccentricity" in said
        assert "micrometres" not in said
        plain, more = (sk.identify(made / robot, made / "run.csv", effects=e) for e in ((), ["encoder_eccentricity"]))
        assert more.error.rms < 0.3 * plain.error.rms


def test_distances_that_are_constant_by_design(tmp_path: Path) -> None:
    """Catches a touch probe blamed on its cable, and an arm that shrinks until all distances are equal."""
    made = case("touch", tmp_path)
    said = ran(made, "diagnose arm.toml touch.csv")
    assert "its cable" not in said
    assert "up to one factor" in said
    fit = sk.identify(made / "arm.toml", made / "touch.csv")
    true = np.deg2rad({"offset_2": 0.25, "offset_3": -0.3, "offset_4": 0.2, "offset_5": 0.15}.__getitem__("offset_2"))
    assert abs(fit.by_name["offset_2"] - true) < np.deg2rad(0.01)
    assert abs(fit.by_name["shift_x_3"]) < 1.0
    said = ran(made, "diagnose arm.toml touch.csv --free offset_2,offset_3,offset_4,offset_5")
    assert "nothing with structure is missing" in said


@pytest.mark.slow
def test_runs_at_two_places_and_of_one_file(tmp_path: Path) -> None:
    """Catches what a model lacks taken for a change, because two runs stand at different places."""
    made = case("compare_regions", tmp_path)
    assert "unchanged" in ran(made, "compare arm.toml left.csv left.csv")
    said = ran(made, "compare arm.toml left.csv right.csv")
    assert "undecided" in said
    assert "other places" in said


def test_a_payload_that_differs_is_said_first() -> None:
    """Catches a load named as a change of the robot without a word on the load."""
    machine = load_machine(HERE / "stilljoint" / "m.py")
    rng = np.random.default_rng(2)

    def run(payload_kg: float, fall_mm: float) -> pl.DataFrame:
        a, b = rng.uniform(-1.5, 1.5, 60), rng.uniform(0.5, 2.0, 60)
        x, y = 250 * np.cos(a) + 200 * np.cos(a + b), 250 * np.sin(a) + 200 * np.sin(a + b)
        noise = rng.normal(0, 0.01, (2, 60))
        return pl.DataFrame({
            "a_rad": a, "b_rad": b, "x_mm": x + noise[0], "y_mm": y + noise[1] - fall_mm * x / 450,
            "payload_kg": payload_kg,
        })  # fmt: skip

    found = sk.compare(machine, [run(0.0, 0.0), run(2.5, 0.4)])
    assert found.verdict != "unchanged"
    assert found.advice.startswith("payload_kg is 0 in ")


@pytest.mark.slow
def test_a_zero_that_is_the_sensors_or_the_machines(tmp_path: Path) -> None:
    """Catches "nothing needs to be done" where a zero moved by 27 arcsec: the model's, or the instrument's."""
    made = case("tpoint", tmp_path)
    machine, before = load_machine(made / "tel.py"), pl.read_csv(made / "night.csv")
    noise = np.random.default_rng(5).normal(0, 2 / 3600, (2, len(before)))
    again = before.with_columns(encaz_deg=pl.col("encaz_deg") + noise[0], encel_deg=pl.col("encel_deg") + noise[1])
    assert "nothing needs to be done" in sk.compare(machine, [before, again]).advice
    moved = again.with_columns(encel_deg=pl.col("encel_deg") + 27 / 3600)
    told = sk.compare(machine, [before, moved]).advice
    assert "nothing needs to be done" not in told
    assert "IE" in told
    assert "0.0073" in told


# -- Effects beside a course, and in the order of rows ---------------------------------------------------------------


def test_backlash_beside_a_warm_up(tmp_path: Path) -> None:
    """Catches 14 µm of backlash that stay unnamed since the screw warms as well (ISO 230-2)."""
    made = case("screw", tmp_path)
    said = ran(made, "diagnose screw.py run.csv")
    assert "The model lacks backlash" in said
    assert re.search(r"width_axis = -0\.01[34]", said)


def test_every_other_row_differs(tmp_path: Path) -> None:
    """Catches two faces of an instrument, 25 µm apart over 5 µm of noise, called adequate."""
    made = case("stilljoint", tmp_path, "1")
    table = pl.read_csv(made / "run.csv")
    side = np.where(np.arange(len(table)) % 2, 0.06, -0.06)
    table.with_columns(x_mm=pl.col("x_mm") + side).write_csv(made / "faces.csv")
    said = ran(made, "diagnose arm.toml faces.csv")
    assert "every other row" in said
    assert "two faces" in said


def test_a_reading_that_is_late_where_no_velocity_is_recorded() -> None:
    """Catches a delay that nobody looks for, since velocities are in the times and not in a column."""
    machine = load_machine(HERE / "stilljoint" / "m.py")
    t = np.arange(0.0, 40.0, 0.1)

    def at(when: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return 0.9 * np.sin(0.7 * when), 1.2 + 0.6 * np.sin(0.43 * when + 1)

    (a, b), (a_then, b_then) = at(t), at(t - 0.037)
    noise = np.random.default_rng(3).normal(0, 0.05, (2, len(t)))
    run = pl.DataFrame({
        "time_s": t, "a_rad": a, "b_rad": b,
        "x_mm": 250 * np.cos(a_then) + 200 * np.cos(a_then + b_then) + noise[0],
        "y_mm": 250 * np.sin(a_then) + 200 * np.sin(a_then + b_then) + noise[1],
    })  # fmt: skip
    found = sk.diagnose(machine, run)
    assert "reading_delay" in found.effects
    assert abs(found.fit.by_name["reading_delay.delay"] - 0.037) < 0.002
