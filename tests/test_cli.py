"""The installed ``sherkit`` command as a person or a script meets it: results, exit codes, and what it says."""

from __future__ import annotations

import contextlib
import dataclasses
import io
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import pytest

from bad_inputs import BAD, Bad
from running import slow, thin
from second_simulator import write_robot_toml
from sherkit import Measurements, calibrate, load_robot, read_measurements
from sherkit.calibration import Result, to_json
from sherkit.cli import main
from sherkit.robots.calibrated import Calibration
from sherkit.robots.delta import VirtualDelta, paper_whole
from sherkit.robots.delta.virtual import TABLE_II_SIZES

SHERKIT = str(Path(sys.executable).with_name("sherkit"))
# as the command's own process has it
pytestmark = pytest.mark.filterwarnings("always::sherkit.SherkitWarning")
COMMANDS = {
    "": ["calibrate", "demo", "import", "simulate"],
    "calibrate": [
        "--local", "--json", "--loss", "--free", "--priors", "--linear", "--correction", "--exclude", "--with-outliers",
    ],
    "demo": ["--seed", "--output", "--tables"],
    "simulate": ["--poses", "--repeats", "--noise-um", "--truth", "--output", "--order"],
    "import klipper": ["--output", "CONFIG"],
}  # fmt: skip


def sherkit(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Runs the command in ``folder``, in this process: starting one takes longer than most commands do."""
    out, err = io.StringIO(), io.StringIO()
    with (
        contextlib.chdir(folder),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
        pytest.raises(SystemExit) as end,
    ):
        main(list(arguments))
    return subprocess.CompletedProcess(arguments, end.value.code, out.getvalue(), err.getvalue())


def no_constant(name: str) -> NoReturn:
    """Refuses NaN and infinity, which JSON does not have."""
    raise AssertionError(name)


def told(done: subprocess.CompletedProcess[str]) -> Any:
    """The JSON of a run that went well."""
    assert (done.returncode, done.stderr) == (0, "")
    return json.loads(done.stdout, parse_constant=no_constant)


def one_sentence(done: subprocess.CompletedProcess[str], code: int = 1) -> str:
    """What a run that failed says: one line on stderr, nothing on stdout."""
    assert "Traceback" not in done.stderr
    assert (done.returncode, done.stdout) == (code, "")
    assert done.stderr.count("\n") == 1
    assert done.stderr.startswith("error: ")
    return done.stderr.removeprefix("error: ").strip()


@pytest.fixture(scope="module")
def work(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a robot and two runs of a virtual one, made by the command, and of each a sixth of the poses."""
    folder = tmp_path_factory.mktemp("work")
    write_robot_toml(folder / "robot.toml")
    for poses in ("whole", "local"):
        done = sherkit(
            folder, "simulate", "robot.toml", "-o", f"{poses}.csv", "--poses", poses, "--repeats", "1",
            "--seed", "1", "--rail-lean-mrad", "3", "--noise-um", "4", "--order", "shuffled",
            "--truth", f"{poses}.toml",
        )  # fmt: skip
        assert (done.returncode, done.stderr) == (0, "")
        shutil.copy(folder / f"{poses}.csv", folder / f"{poses}_all.csv")
        thin(folder / f"{poses}.csv", 6)
    return folder


@pytest.fixture(autouse=True)
def here(work: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Works in that folder, so that both sides name the same files."""
    monkeypatch.chdir(work)


@pytest.fixture(scope="module")
def whole(work: Path) -> Measurements:
    """The run over the whole workspace, as the command reads it."""
    old = Path.cwd()
    os.chdir(work)
    try:
        return read_measurements("whole.csv")
    finally:
        os.chdir(old)


@pytest.fixture(scope="module")
def plain(work: Path, whole: Measurements) -> Any:
    """What the library makes of that run without a correction, as the command would print it."""
    return as_told(calibrate(load_robot(work / "robot.toml"), whole, correction="none"))


def as_told(result: Result) -> Any:
    """What the command would print of a result."""
    return json.loads(json.dumps(to_json(result)))


# -- simulate ------------------------------------------------------------------------------------------------


def test_simulate_writes_what_the_library_makes(work: Path) -> None:
    """Catches options that do not reach the simulation, and a truth file of another robot."""
    virtual = VirtualDelta.draw(
        load_robot("robot.toml"), 1, sizes=TABLE_II_SIZES, rail_lean_rad=3e-3, beam=0.0, noise_mm=4e-3
    )
    data = virtual.measure(paper_whole(), repeats=1, order="shuffled", seed=2)
    found = read_measurements("whole_all.csv")
    assert np.array_equal(found.readings, data.readings)
    assert np.array_equal(found.joints, data.joints)
    assert tomllib.loads((work / "whole.toml").read_text())["errors"] == virtual.errors
    assert len(read_measurements("local_all.csv")) == 363


def test_simulate_sizes_and_parquet(work: Path) -> None:
    """Catches --errors 0 --noise-um 0 that still leaves a difference from the drawing, and --repeats ignored."""
    done = sherkit(
        work, "simulate", "robot.toml", "-o", "exact.parquet", "--poses", "local", "--repeats", "2",
        "--errors", "0", "--noise-um", "0",
    )  # fmt: skip
    assert done.returncode == 0
    assert "726 rows written to exact.parquet" in done.stdout
    data = read_measurements("exact.parquet")
    robot = load_robot("robot.toml")
    assert np.abs(robot.forward_batch(data.joints).require() - data.readings[:, :3]).max() < 1e-9


# -- calibrate -----------------------------------------------------------------------------------------------


def test_json_agrees_with_the_library(work: Path, whole: Measurements) -> None:
    """Catches numbers that are computed, rounded or labelled otherwise on the way out, NaN in JSON, a lossy file."""
    done = sherkit(
        work, "calibrate", "robot.toml", "whole.csv", "--local", "local.csv", "-o", "calibrated.toml", "--json"
    )
    said = told(done)
    result = calibrate(load_robot("robot.toml"), whole, read_measurements("local.csv"))
    assert said == as_told(result)
    assert said["converged"] is True
    assert said["whole"]["rms_um"]["before"]["x"] > 10 * said["whole"]["rms_um"]["held_out_corrected"]["x"]
    assert said["border_jump_um"] > 0
    loaded = Calibration.load("calibrated.toml")
    joints = whole.joints[::20]
    assert np.array_equal(loaded.forward_batch(joints).values, result.calibration.forward_batch(joints).values)
    assert loaded.accuracy([0.0, 0.0, 0.0]) == result.calibration.accuracy([0.0, 0.0, 0.0])


def test_tables_hold_the_same_numbers(work: Path, whole: Measurements) -> None:
    """Catches a table that shows a row or a parameter under another's name, or forgets the file it wrote."""
    done = sherkit(work, "calibrate", "robot.toml", "whole.csv", "-o", "told.toml")
    assert (done.returncode, done.stderr) == (0, "")
    assert Calibration.load("told.toml").whole.rows == len(whole)
    assert "calibration written to told.toml" in done.stdout
    for title in ("Table I:", "Table II:", "Table III:", "Predicted accuracy"):
        assert title in done.stdout
    fit = calibrate(load_robot("robot.toml"), whole).whole.fit
    rows: dict[str, list[str]] = {}
    for line in done.stdout.splitlines():
        if len(cells := line.strip("│").split("│")) > 2:
            rows.setdefault(cells[0].strip(), cells[1:])
    after = [float(cell.split("±")[0]) for cell in rows["the rows it was fitted to"][2:]]
    assert after == pytest.approx(list(fit.rms().values()), abs=0.051)
    for p, value in zip(fit.parameters, fit.values, strict=True):
        # as many digits as its deviation leaves it
        figure = rows[p.name][1].strip()
        unit = 1.0 if p.unit == "mm" else np.deg2rad(1.0)
        assert unit * float(figure) == pytest.approx(value, abs=0.51 * unit * 10.0 ** -len(figure.partition(".")[2]))
    assert f"rank {fit.rank} of {len(fit.values)}" in done.stdout
    for direction in fit.unobserved:
        assert str(direction) in re.sub(r"\s+", " ", done.stdout)


@pytest.mark.parametrize(
    ("arguments", "options"),
    [
        (["--loss", "huber", "--priors", "--seed", "5"], {"loss": "huber", "priors": True, "seed": 5}),
        *slow(
            (
                ["--linear", "--free", "rod_length_1, rod_length_2,sensor_shift_x"],
                {"linear": True, "free": ("rod_length_1", "rod_length_2", "sensor_shift_x")},
            ),
            (["--correction", "paper"], {"correction": "paper"}),
            (["--correction", "auto"], {}),
        ),
    ],
    ids=lambda v: " ".join(v) if isinstance(v, list) else "",
)
def test_options_reach_the_library(
    arguments: list[str], options: dict[str, Any], work: Path, whole: Measurements, plain: Any
) -> None:
    """Catches an option that is parsed and then dropped, or that changes nothing. Without a correction, which takes
    longest, where it is not what is asked for."""
    if "--correction" not in arguments:
        arguments, options = [*arguments, "--correction", "none"], options | {"correction": "none"}
    said = told(sherkit(work, "calibrate", "robot.toml", "whole.csv", "--json", *arguments))
    assert said == as_told(calibrate(load_robot("robot.toml"), whole, **options))
    assert said != plain


def spoilt() -> str:
    """A run with a note above it, whose line 13 is wrong."""
    lines = Path("whole.csv").read_text().splitlines()
    cells = lines[11].split(",")
    lines[11] = ",".join([*cells[:-1], str(float(cells[-1]) + 5.0)])
    return "# with a note above\n" + "\n".join(lines) + "\n"


def test_excluded_lines_are_named_and_not_fitted(work: Path, whole: Measurements) -> None:
    """Catches lines counted from the wrong end: line 12 of the file is its eleventh row."""
    Path("spoilt.csv").write_text(spoilt())
    done = sherkit(work, "calibrate", "robot.toml", "spoilt.csv", "--exclude", " 13, 20", "--correction", "none")
    assert done.returncode == 0
    assert "marked as outliers and not fitted: lines 13, 20" in done.stdout
    clean = whole.mark_outliers(np.array([10, 17]))
    after = calibrate(load_robot("robot.toml"), clean, correction="none").whole.fit.rms()
    assert " ± ".join([f"{after['x_mm']:.1f}"] * 2) in done.stdout


@pytest.mark.slow
@pytest.mark.parametrize(("given", "what"), [((), "left out"), (("--with-outliers",), "used all the same")])
def test_gross_errors_are_named_by_their_lines(given: tuple[str, ...], what: str, work: Path) -> None:
    """Catches the same of rows that nobody excluded."""
    Path("spoilt.csv").write_text(spoilt())
    said = sherkit(work, "calibrate", "robot.toml", "spoilt.csv", "--correction", "none", *given).stdout
    assert re.search(rf"gross errors?, lines? [^:]*\b13\b[^:]*: {what}", re.sub(r"\s+", " ", said))


# -- exit codes and errors -----------------------------------------------------------------------------------

SOME = ("a misspelt column", "NaN", "letters of an old encoding", "an empty file")


@pytest.mark.parametrize("bad", [b for b in BAD if b.wrong in SOME], ids=lambda b: b.wrong)
def test_bad_runs_end_in_one_sentence(bad: Bad, work: Path, tmp_path: Path) -> None:
    """Catches a traceback, a wrong exit code, or words that are not those of the library."""
    path = bad.write(tmp_path)
    said = one_sentence(sherkit(work, "calibrate", "robot.toml", str(path)))
    assert said == f"{bad.message(path)}; sherkit check {path} lists all that is wrong with it"


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["calibrate", "robot.toml", "none.csv"], "none.csv: there is no such file"),
        (["calibrate", "whole.csv", "whole.csv"], "whole.csv: expected a robot TOML file; the robot stands before"),
        (["calibrate", "robot.toml", "whole.csv", "--exclude", "1"], "--exclude: whole.csv has no row on line 1"),
        (["calibrate", "robot.toml", "whole.csv", "--free", "rod_lenght_1"], "did you mean 'rod_length_1'?"),
        (["calibrate", "robot.toml", "whole.csv", "--effect", "thermal_growth"], "needs the column temperature_c"),
        (["diagnose", "robot.toml", "whole.csv", "--effect", "thermal_growth"], "needs the column temperature_c"),
        (["calibrate", "robot.toml", "far.csv"], "far.csv: line 3: the model cannot reach these joint readings"),
        (["calibrate", "robot.toml", "whole.csv", "-o", "no/where.toml"], "no/where.toml: cannot be written"),
        (["simulate", "robot.toml", "-o", "no/where.csv"], "no/where.csv"),
        (["import", "klipper", "robot.toml", "-o", "out"], "has no 'kinematics' in a section [printer]"),
    ],
    ids=lambda v: " ".join(v) if isinstance(v, list) else "",
)
def test_other_mistakes_end_in_one_sentence(arguments: list[str], says: str, work: Path) -> None:
    """Catches a traceback or exit code 0 where a name, a line or a number is wrong."""
    lines = Path("whole.csv").read_text().splitlines()
    cells = lines[2].split(",")
    cells[lines[0].split(",").index("q2_mm")] = "900.0"
    Path("far.csv").write_text("\n".join([*lines[:2], ",".join(cells), *lines[3:]]) + "\n")
    assert says in one_sentence(sherkit(work, *arguments))


@pytest.mark.parametrize(
    "arguments",
    [["calibrate", "robot.toml"], ["calibrate", "robot.toml", "whole.csv", "--loss", "none"], ["calibrat"]],
    ids=" ".join,
)
def test_wrong_command_lines_end_with_two(arguments: list[str], work: Path) -> None:
    """Catches a slip in the command taken for bad data: scripts tell them apart by the exit code."""
    done = sherkit(work, *arguments)
    assert (done.returncode, done.stdout) == (2, "")
    assert "Usage: sherkit" in done.stderr
    assert "Traceback" not in done.stderr


def test_a_fit_that_does_not_converge_ends_with_three(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Catches a script that takes an unfinished fit for a calibration; the paper's single step is asked for."""

    def unfinished(*arguments: Any, **options: Any) -> Result:
        result = calibrate(*arguments, **options)
        fit = dataclasses.replace(result.whole.fit, converged=False)
        return dataclasses.replace(result, whole=dataclasses.replace(result.whole, fit=fit))

    monkeypatch.setattr("sherkit.cli.calibrate.run_calibration", unfinished)
    for option, code in ([], 3), (["--linear"], 0):
        with pytest.raises(SystemExit) as ended:
            main(["calibrate", "robot.toml", "whole.csv", "--correction", "none", "--json", *option])
        assert ended.value.code == code
        assert json.loads(capsys.readouterr().out)["converged"] is False


def test_warnings_are_sentences_beside_the_result(work: Path) -> None:
    """Catches a warning that shows Python code, spoils the JSON on stdout, or stops the work."""
    text = Path("whole.csv").read_text().replace("repeat", "repeats", 1)
    Path("slip.csv").write_text(text)
    done = sherkit(work, "calibrate", "robot.toml", "slip.csv", "--correction", "none", "--json")
    assert done.returncode == 0
    assert json.loads(done.stdout)["whole"]["rows"] == 98
    message = "warning: slip.csv: column 'repeats' is taken as a covariate; is it meant to be 'repeat'?\n"
    assert done.stderr == message


def test_a_reader_that_stops_listening_is_no_crash(work: Path) -> None:
    """Catches a traceback where the output is piped into ``head``."""
    with subprocess.Popen([SHERKIT, "effects"], cwd=work, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        process.stdout.close()
        assert process.stderr.read() == b""
    assert process.returncode == 1


def test_interrupting_ends_with_130(work: Path) -> None:
    """Catches a traceback, or a zero, where the user presses Ctrl-C; the machine's file says that the command is at
    work."""
    Path("slow.py").write_text("import time\nopen('at_work', 'w').close()\ntime.sleep(600)\n")
    # a test run in the background ignores the signal, and so would its children
    start = "import os, signal, sys; signal.signal(signal.SIGINT, signal.SIG_DFL); os.execv(sys.argv[1], sys.argv[1:])"
    with subprocess.Popen(
        [sys.executable, "-c", start, SHERKIT, "calibrate", "slow.py", "whole.csv"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    ) as process:  # fmt: skip
        try:
            _when(lambda: os.stat("at_work"))
            process.send_signal(signal.SIGINT)
            out, err = process.communicate(timeout=600)
        finally:
            process.kill()
            Path("slow.py").unlink()
            Path("at_work").unlink(missing_ok=True)
    assert (process.returncode, out) == (130, "")
    assert err.strip() == "error: interrupted"


def _when(ready: Callable[[], object], patience_s: float = 600.0) -> None:
    """Waits until ``ready`` is no error."""
    end = time.monotonic() + patience_s
    while True:
        try:
            ready()
            return
        except OSError:
            if time.monotonic() > end:
                raise
            time.sleep(0.02)


# -- known faults: each of these tests fails today, and says so when it no longer does ------------------------


def test_a_single_row_is_calibrated_or_refused(work: Path) -> None:
    """Catches a LinAlgError, or a calibration written that cannot be loaded."""
    lines = Path("whole.csv").read_text().splitlines()
    Path("one.csv").write_text("\n".join(lines[:2]) + "\n")
    done = sherkit(work, "calibrate", "robot.toml", "one.csv", "-o", "one.toml")
    assert "Traceback" not in done.stderr
    if Path("one.toml").exists():
        assert Calibration.load("one.toml").accuracy([0.0, 0.0, 0.0]) > 0


def test_json_of_a_fit_of_nothing(work: Path) -> None:
    """Catches a traceback where none of the freed parameters changes any reading: distances know no datum."""
    names = ["q1_mm", "q2_mm", "q3_mm", "to_q1_mm", "to_q2_mm", "to_q3_mm", "distance_mm"]
    rows = ["129,129,129,130,127,128,3", "129,128,129,131,127,128,4", "128,128,129,130,127,129,4"]
    Path("distances.csv").write_text("\n".join([",".join(names), *rows]) + "\n")
    done = sherkit(work, "calibrate", "robot.toml", "distances.csv", "--free", "sensor_shift_x", "--json")
    assert "Traceback" not in done.stderr
    assert json.loads(done.stdout)["whole"]["rank"] == 0


@pytest.mark.parametrize("name", ["[/red].toml", *slow("[red].toml")])
def test_brackets_in_file_names_are_letters(name: str, work: Path) -> None:
    """Catches a file name that loses its brackets on the screen, or that ends the command with a MarkupError."""
    (work / name).parent.mkdir(exist_ok=True)
    done = sherkit(work, "calibrate", "robot.toml", "whole.csv", "--correction", "none", "-o", name)
    assert "Traceback" not in done.stderr
    assert f"written to {name}" in done.stdout


# -- demo and help -------------------------------------------------------------------------------------------


def test_demo_shows_the_tables_of_the_paper(made: Path) -> None:
    """Catches a simulated figure that could pass for a measured one, a missing table, silence on what is not known."""
    said = (made / "said.txt").read_text(encoding="utf-8")
    assert said.startswith("SIMULATION.")
    titles = re.findall(r"^Table (I+) — simulation: .*, (whole workspace|local)\s*$", said, re.MULTILINE)
    assert titles == [(n, run) for run in ("whole workspace", "local") for n in ("I", "II", "III")]
    assert len(re.findall(r"^Table I+:", said, re.MULTILINE)) == 0
    assert said.count("3 of 15 directions change no reading") == 2
    assert "joint_offset" in said.split("3 of 15 directions")[1].split("worst observed")[0]
    assert "1388 ± 1390" in said
    assert Calibration.load(made / "demo" / "calibrated.toml").whole.effects == ("rail_lean",)


@pytest.mark.slow
def test_the_command_that_demo_proposes_says_what_its_tables_say(made: Path) -> None:
    """Catches a proposal that lacks an option or a file, and figures of another calibration."""
    said = (made / "said.txt").read_text(encoding="utf-8")
    again = re.search(r"^ +sherkit (calibrate .*)$", said, re.MULTILINE)
    result = told(sherkit(made, *again[1].split(), "--json"))
    after = result["whole"]["rms_um"]["after"]
    cells = re.search(r"the rows it was fitted to\s*│[^│]*│[^│]*│([^│]*)±[^│]*│([^│]*)±[^│]*│([^│]*)±", said)
    assert [float(c) for c in cells.groups()] == pytest.approx([after[a] for a in "xyz"], abs=0.051)


def test_demo_tells_its_story_on_one_screen(made: Path) -> None:
    """Catches a story that does not fit a screen of 80 columns, tells its parts in another order, or names one thing
    by two numbers."""
    said, tables, _ = (made / "said.txt").read_text(encoding="utf-8").partition("The paper's tables")
    assert tables
    lines = said.splitlines()[:-1]
    assert len(lines) <= 40
    assert max(map(len, lines)) <= 80
    heads = [line for line in lines if re.match(r"\d\. ", line)]
    assert [head.split()[0] for head in heads] == ["1.", "2.", "3.", "4.", "5."]
    left = re.search(r"(\S+) µm RMS in 3-D at\s+places it was not fitted to", said)
    falls = re.search(r"geometry calibrated +█+ (\S+) µm", said)
    assert left[1] == falls[1]
    assert "rail_lean" in said
    assert "sherkit app demo/robot.toml demo/whole.csv" in said


@pytest.mark.parametrize("command", COMMANDS)
def test_help_tells_of_everything(command: str, work: Path) -> None:
    """Catches a command or an option that cannot be found out about."""
    done = sherkit(work, *command.split(), "--help")
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith(f"Usage: {' '.join(['sherkit', *command.split()])} ")
    for name in COMMANDS[command]:
        assert name in done.stdout
