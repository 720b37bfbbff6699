"""What a release promises: one version, the wheel's C library, help that can be typed, a doctor that tells what is."""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
import tomllib
from pathlib import Path
from types import SimpleNamespace

import click
import numpy as np
import pytest
from click.testing import CliRunner

import sherkit as sk
from running import parse, several
from second_simulator import NOMINAL_CONFIG, write_robot_toml
from sherkit import _core
from sherkit.cli import c_library, doctor
from sherkit.cli.groups import OpenGroup
from sherkit.cli.verbs import cli
from sherkit.errors import CalibrationError, SherkitError
from sherkit.robots.c_header import c_array, calibration_header, covariates_needed
from test_c_library import LIBRARY, ROOT, built_archive, make_robots, run, tool

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))


def test_the_version_stands_in_one_place():
    """Catches a release whose parts call themselves otherwise."""
    version = tomllib.loads((ROOT / "Cargo.toml").read_text(encoding="utf-8"))["workspace"]["package"]["version"]
    assert version == _core.__version__ == sk.__version__
    assert "version" in PROJECT["project"]["dynamic"]
    cited = re.search(r"^version: (.*)$", (ROOT / "CITATION.cff").read_text(encoding="utf-8"), re.MULTILINE)
    assert cited
    assert cited[1] == version
    for manifest in ROOT.glob("rust/*/Cargo.toml"):
        assert tomllib.loads(manifest.read_text(encoding="utf-8"))["package"]["version"] == {"workspace": True}


# -- help ----------------------------------------------------------------------------------------------------------


TOP = click.Context(cli, info_name="sherkit", **cli.context_settings)


@pytest.mark.parametrize("verb", cli.list_commands(TOP))
def test_help_ends_with_lines_that_can_be_typed(verb):
    """Catches an example in a help that names an option or a verb that is gone."""
    made = cli.get_command(TOP, verb)
    below = made.list_commands(TOP) if isinstance(made, OpenGroup) else ()
    of_verb = CliRunner().invoke(cli, [verb, "--help"])
    assert of_verb.exit_code == 0
    assert "Examples:" in of_verb.output
    shown = [of_verb, *(CliRunner().invoke(cli, [verb, word, "--help"]) for word in below)]
    lines = [line.strip() for one in shown for line in one.output.partition("Examples:")[2].splitlines()]
    for line in filter(None, lines):
        words = shlex.split(line)
        assert words[:2] == ["sherkit", verb]
        parse(words[1:])


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_is_printed_for_every_shell(shell):
    """Catches a script for the shell that runs the tests, whatever was asked for."""
    shown = CliRunner().invoke(cli, ["completion", shell])
    assert shown.exit_code == 0
    assert f"_SHERKIT_COMPLETE={shell}_complete" in shown.output
    told = CliRunner().invoke(cli, ["completion"], env={"SHELL": "/bin/tcsh"})
    assert isinstance(told.exception, SherkitError)


# -- doctor --------------------------------------------------------------------------------------------------------


def test_the_doctor_knows_every_extra(monkeypatch):
    """Catches an extra that nobody is told of, and one that is missing and called well."""
    users = set(PROJECT["project"]["optional-dependencies"]) - {"test", "dev", "bench", "arms", "docs"}
    assert set(doctor._PURPOSE) == users
    monkeypatch.setattr(doctor, "requires", lambda _: ["numpy>=1.26", 'pyserial>=3.5 ; extra == "lab"'])
    monkeypatch.setattr(doctor, "_version", lambda name: None if name == "pyserial" else "1.0")
    found = {one.what: one for one in doctor.findings()}
    assert found["core"].ok
    assert not found["extra lab"].ok
    assert found["extra lab"].fix == 'pip install "sherkit[lab]"'
    assert CliRunner().invoke(cli, ["doctor", "--json"], standalone_mode=False).return_value == 0
    monkeypatch.setattr(doctor, "_version", lambda name: None)
    shown = CliRunner().invoke(cli, ["doctor"], standalone_mode=False)
    assert shown.return_value == 1


#: Modules of Python's own library that are left out where a library lacked when it was built.
LEFT_OUT = (
    "_sqlite3", "_bz2", "_lzma", "_ssl", "_hashlib", "_curses", "readline", "_tkinter", "_uuid", "_dbm", "_ctypes_test",
)  # fmt: skip


@pytest.mark.slow
def test_a_python_that_lacks_libraries_does_all_that_needs_none_of_them(tmp_path):
    """Catches a module that nothing here needs, and is imported before anybody asked: SQLite, for reading a CSV."""
    robot = tmp_path / "robot.toml"
    write_robot_toml(robot, NOMINAL_CONFIG)
    do = [
        "simulate robot.toml -o run.csv --poses local --repeats 1 --noise-um 5",
        "diagnose robot.toml run.csv",
        "calibrate robot.toml run.csv -o calibrated.toml",
        "export c calibrated.toml -o robot.h",
    ]
    cannot = ["measure --help", "export run.sherkit -o run2.csv"]
    left_out = f"import sys\nsys.modules.update(dict.fromkeys({LEFT_OUT!r}))\n"
    *did, (_, doctors, _), no_measure, no_export = several(tmp_path, *do, "doctor", *cannot, before=left_out)
    for code, _, wrong in did:
        assert code == 0, wrong
    assert "this Python was built without it" in " ".join(doctors.replace("│", " ").split())
    for code, _, wrong in (no_measure, no_export):
        assert (code, "Traceback" in wrong) == (1, False)
        assert "without SQLite" in " ".join(wrong.split())


# -- C -------------------------------------------------------------------------------------------------------------


#: What a calibration says of its effects and of where the run ended.
WARM = SimpleNamespace(effects=("rail_lean", "thermal_growth", "backlash"), now=(600.0, 21.5, 0.0, 0.0, 0.0))


def test_a_calibration_becomes_a_header_that_compiles(tmp_path):
    """Catches an infinite corner that C has no word for, a number that is rounded, and a name that ends the comment."""
    row = np.array([3.0, 1.0, -np.inf, np.inf, 0.1, 1e-300])
    text = c_array("numbers", row)
    for compiler, language in (("cc", "c"), ("c++", "c++")):
        source = tmp_path / f"check.{language}"
        source.write_text(
            f"#include <math.h>\n#include <stdio.h>\n{text}\nint main(void) {{ for (int k = 0; k < 6; k++) "
            'printf("%.17g\\n", numbers[k]); }\n',
            encoding="utf-8",
        )
        run(tool(compiler), "-Wall", "-Wextra", "-Werror", source, "-o", tmp_path / "check")
        assert [float(word) for word in run(tmp_path / "check").split()] == row.tolist()

    class Made:
        robot = make_robots.EXAMPLE
        core = make_robots.delta()
        parts_made = (WARM,)

    header = calibration_header(Made(), "a*/b.toml")  # type: ignore[arg-type]
    assert "*/b" not in header
    assert "sherkit_delta_init" in header
    assert covariates_needed(Made()) == {"thermal_growth": ("temperature_c",), "backlash": ("direction",)}  # type: ignore[arg-type]
    assert "thermal_growth needs temperature_c.\n   backlash needs direction.\n   Where that is NaN, or" in header
    assert "sherkit_delta_covariates robot_now = {600.0, 21.5, {0.0, 0.0, 0.0}};" in header

    class Plain(Made):
        parts_made = (SimpleNamespace(effects=("rail_lean",), now=WARM.now),)

    assert "No effect in it needs covariates: they may be NULL." in calibration_header(Plain())  # type: ignore[arg-type]

    class Arm(Made):
        core = object()

    with pytest.raises(CalibrationError, match="runs in Python alone"):
        calibration_header(Arm(), "arm.toml")  # type: ignore[arg-type]


def test_what_stands_in_for_covariates_is_what_python_takes(tmp_path):
    """Catches a program that ends every call for want of a direction, and other covariates than Python's."""

    class Arm:
        robot = make_robots.KIND.example
        core = make_robots.serial()
        parts_made = (SimpleNamespace(effects=("backlash",), now=(600.0, 21.5, 1.0, -1.0, 1.0, 0.0, 1.0, -1.0)),)

    (tmp_path / "robot.h").write_text(calibration_header(Arm()), encoding="utf-8")  # type: ignore[arg-type]
    (tmp_path / "now.c").write_text(
        """
        #include <stdio.h>
        #include "robot.h"
        int main(void)
        {
            static sherkit_serial robot;
            const double joints[6] = {0.1, -0.9, 1.2, -0.4, 0.7, 0.3};
            double x[3];
            if (robot_init(&robot) != SHERKIT_OK)
                return 1;
            if (sherkit_serial_forward(&robot, joints, NULL, x, NULL) != SHERKIT_NOT_FINITE)
                return 2;
            if (sherkit_serial_forward(&robot, joints, &robot_now, x, NULL) != SHERKIT_OK)
                return 3;
            printf("%.17g %.17g %.17g\\n", x[0], x[1], x[2]);
        }
        """,
        encoding="utf-8",
    )
    flags = ["-std=c11", "-Wall", "-Wextra", "-Wpedantic", "-Werror", f"-I{LIBRARY / 'include'}", f"-I{tmp_path}"]
    run(tool("cc"), *flags, tmp_path / "now.c", built_archive(), "-lm", "-o", tmp_path / "now")
    place, _ = Arm.core.forward(np.array([0.1, -0.9, 1.2, -0.4, 0.7, 0.3]), [*Arm.parts_made[0].now, 0.0])
    assert [float(word) for word in run(tmp_path / "now").split()] == place.tolist()


def test_the_loop_of_the_wheel_runs(tmp_path):
    """Catches an example that a user cannot build, or that misses its targets."""

    class Made:
        robot = make_robots.EXAMPLE
        core = make_robots.delta()
        parts_made = (WARM,)

    (tmp_path / "robot.h").write_text(calibration_header(Made()), encoding="utf-8")  # type: ignore[arg-type]
    flags = [
        "-std=c11", "-O2", "-Wall", "-Wextra", "-Wpedantic", "-Werror", f"-I{LIBRARY / 'include'}", f"-I{tmp_path}",
    ]  # fmt: skip
    run(tool("cc"), *flags, LIBRARY / "examples/wheel/loop.c", built_archive(), "-lm", "-o", tmp_path / "loop")
    assert ", 0 targets out of reach" in run(tmp_path / "loop", "0.2")


def test_where_the_library_is_can_be_asked(tmp_path, monkeypatch):
    """Catches flags for a folder that is not there, and a source tree that pretends to have a library."""
    monkeypatch.setattr(c_library, "HOME", tmp_path / "c")
    told = CliRunner().invoke(cli, ["c", "--cflags"])
    assert isinstance(told.exception, SherkitError)
    (tmp_path / "c" / "lib").mkdir(parents=True)
    (tmp_path / "c" / "lib" / "libsherkit.a").touch()
    monkeypatch.setattr(c_library.sys, "platform", "linux")
    shown = CliRunner().invoke(cli, ["c", "--cflags", "--libs"])
    assert shlex.split(shown.output) == [f"-I{tmp_path}/c/include", "-lm", f"{tmp_path}/c/lib/libsherkit.a"]
    shared = shlex.split(CliRunner().invoke(cli, ["c", "--libs", "--shared"]).output)
    assert f"-Wl,-rpath,{tmp_path}/c/lib" in shared
    assert CliRunner().invoke(cli, ["c", "--cmake"]).output.strip() == f"{tmp_path}/c/lib/cmake/sherkit"


@pytest.mark.slow
def test_what_the_installed_wheel_ships_links(tmp_path):
    """Catches a wheel without its library, a CMake or pkg-config file that leads nowhere."""
    if not (c_library.HOME / "lib").is_dir():
        pytest.skip("this sherkit is a source tree: it ships no C library")
    runner = CliRunner()
    assert runner.invoke(cli, ["c", "--example", str(tmp_path)]).exit_code == 0

    class Made:
        robot = make_robots.EXAMPLE
        core = make_robots.delta()
        parts_made = (WARM,)

    (tmp_path / "robot.h").write_text(calibration_header(Made()), encoding="utf-8")  # type: ignore[arg-type]
    for more in ([], ["--shared"]):
        words = shlex.split(runner.invoke(cli, ["c", "--cflags", "--libs", *more]).output)
        run(tool("cc"), tmp_path / "loop.c", *words, "-o", tmp_path / "loop")
        run(tmp_path / "loop", "0.1")
    if shutil.which("cmake"):
        where = runner.invoke(cli, ["c", "--cmake"]).output.strip()
        run("cmake", "-S", tmp_path, "-B", tmp_path / "build", f"-Dsherkit_DIR={where}")
        run("cmake", "--build", tmp_path / "build")
        run(tmp_path / "build" / "loop", "0.1")
    if shutil.which("pkg-config"):
        where = runner.invoke(cli, ["c", "--pkgconfig"]).output.strip()
        flags = run("pkg-config", "--cflags", "--libs", "sherkit", env={"PKG_CONFIG_PATH": where, "PATH": "/usr/bin"})
        assert "-lsherkit" in flags


@pytest.mark.slow
def test_the_crate_packages_clean():
    """Catches a file that the crate needs and its package lacks, and a warning of cargo."""
    done = subprocess.run(
        [tool("cargo"), "package", "-p", "sherkit-core", "--allow-dirty", "--no-verify", "--offline"],
        cwd=ROOT, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "warning" not in done.stderr, done.stderr


def test_no_registry_is_named():
    """Catches the host of a package registry in what is released."""
    hosts = re.compile(r"pypi\.org|crates\.io|pythonhosted|npmjs|static\.rust-lang")
    files = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=False)
    if files.returncode != 0:
        pytest.skip("no git tree")
    for name in filter(None, files.stdout.split("\0")):
        path = ROOT / name
        if path.suffix in (".py", ".md", ".toml", ".yml", ".rs", ".cff") and path != Path(__file__):
            assert not hosts.search(path.read_text(encoding="utf-8")), name
