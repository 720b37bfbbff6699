"""The C library: the same bits as from Python, no path to a panic, and nothing that a sanitizer would say.

Needs a C compiler and cargo; without them the tests are skipped and say so.
"""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from numpy.typing import NDArray

import sherkit as sk
from running import slow
from sherkit import _core
from sherkit.cli.c_library import archive as shipped
from sherkit.cli.verbs import cli
from sherkit.errors import NotFinite, OutOfReach, SherkitError
from sherkit.robots.serial import KIND, VirtualSerial, postures
from sherkit.robots.tool.filters import estimate
from sherkit.robots.tool.tool import FlexibleTool, ToolDoubt
from sherkit.robots.tool.virtual import VirtualTool

Floats = NDArray[np.float64]

ROOT = Path(__file__).parent.parent
LIBRARY = ROOT / "rust" / "c"
TARGET = Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))
STRICT = ["-std=c11", "-Wall", "-Wextra", "-Wpedantic", "-Werror", f"-I{LIBRARY / 'include'}"]
SANITIZED = ["-O1", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-fno-omit-frame-pointer"]
CODES = {None: 0.0, NotFinite: 3.0, OutOfReach: 4.0}

sys.path.insert(0, str(ROOT / "docs"))
import make_robots  # noqa: E402  (it writes the header that the examples read)


def run(*command: str | Path, **more: Any) -> str:
    done = subprocess.run([str(c) for c in command], capture_output=True, text=True, check=False, **more)
    assert done.returncode == 0, f"{' '.join(map(str, command))}: {done.returncode}\n{done.stdout}{done.stderr}"
    return done.stdout


def tool(*names: str) -> str:
    """The first of these programs that is installed; skips where none is."""
    for name in names:
        if shutil.which(name):
            return name
    pytest.skip(f"none of {', '.join(names)} is installed, so the C library cannot be tested")


def built_archive() -> Path:
    """The static library: that of the wheel where one is installed, else built; skips where it cannot be."""
    tool("cc")
    with contextlib.suppress(SherkitError):
        return shipped()
    command = [tool("cargo"), "build", "--quiet", "--locked", "--profile", "control", "-p", "sherkit-c"]
    run(*command, "--target-dir", TARGET, cwd=ROOT)
    return TARGET / "control" / "libsherkit.a"


@pytest.fixture(scope="module")
def archive() -> Path:
    """The static library."""
    return built_archive()


def built(archive: Path, source: str, into: Path, *flags: str) -> Path:
    program = into / Path(source).stem
    run("cc", *STRICT, *flags, LIBRARY / source, archive, "-lm", "-o", program)
    return program


def seen(robot: Any, places: Floats) -> Floats:
    """Places (n, 3) of the base as the sensor of a calibrated robot sees them."""
    pose = robot.sensor()
    made: Floats = places @ pose[:9].reshape(3, 3).T + pose[9:]
    return made


def delta_rows() -> Floats:
    random = np.random.default_rng(1)
    joints = random.uniform(115, 150, (200, 3))
    joints[7], joints[8] = [130.0, 400.0, 130.0], [np.nan, 130.0, 130.0]
    covariates = np.tile([10.0, 21.0, 1.0, -1.0, 0.0], (200, 1))
    positions = random.uniform(-22, 22, (200, 3))
    positions[9] = [300.0, 0.0, 0.0]
    return np.hstack([joints, covariates, seen(make_robots.delta(), positions), positions])


def spherical_rows() -> Floats:
    random = np.random.default_rng(2)
    mean, half = random.uniform(0.9, 2.2, 200), random.uniform(0.4, 1.3, 200)
    joints = np.stack([mean + half, mean - half], axis=1)
    joints[5] = [1.5, -1.5]
    angles = np.stack([random.uniform(0.8, 2.2, 200), random.uniform(0.4, 1.2, 200)], axis=1)
    angles[6] = np.nan
    return np.hstack([joints, np.tile([10.0, 21.0, 1.0, -1.0], (200, 1)), angles])


def serial_rows() -> Floats:
    random = np.random.default_rng(4)
    low, high = KIND.example.ranges
    joints, start = random.uniform(low, high, (2, 200, 6))
    positions = KIND.example.forward_batch(random.uniform(low, high, (200, 6))).require()
    joints[7], positions[9], start[11] = np.nan, [5000.0, 0.0, 0.0], np.nan
    known = np.tile([10.0, 21.0, 1, -1, 0, 1, 1, -1, 2.5], (200, 1))
    known[13, -1] = np.nan
    return np.hstack([joints, known, positions, seen(make_robots.serial(), positions), start])


def single(function: Any, numbers: Floats, covariates: Floats, sizes: tuple[int, ...], *more: Floats) -> list[float]:
    """What the C program writes of a call: its code, and the numbers; zero where there are none."""
    try:
        found = function(np.ascontiguousarray(numbers), list(covariates), *map(np.ascontiguousarray, more))
    except (NotFinite, OutOfReach) as error:
        return [CODES[type(error)], *np.zeros(sum(sizes))]
    parts = found if isinstance(found, tuple) else (found,)
    return [0.0, *np.concatenate([p.ravel() for p in parts])]


def tool_rows(n: int = 3000) -> Floats:
    random = np.random.default_rng(3)
    times = 0.005 * np.arange(1, n + 1)
    stamps = np.where(random.random(n) < 0.02, times - 0.02, times)
    stamps[n // 2 :] = times[n // 2 :] - 0.1  # a slow interrogator
    bend = 0.04 * np.maximum(0.0, np.sin(3.0 * times))[:, None] * np.array([1.0, -0.4, -0.6, 1.3, -0.5, -0.8, 0, 0, 0])
    wavelengths = np.linspace(1530, 1560, 9) + bend + 2e-4 * random.normal(size=(n, 9))
    wavelengths[random.random(n) < 0.02] = np.nan
    # damaged: one grating lost, one stuck, two peaks swapped, a wild reading
    wavelengths[random.random((n, 9)) < 0.003] = np.nan
    wavelengths[400:600, 1] = wavelengths[400, 1]
    wavelengths[900:1100, [3, 4]] = wavelengths[900:1100, [4, 3]]
    wavelengths[np.arange(1200, 1300, 7), 5] += 0.5
    c, s = np.cos(0.3 * times), np.sin(0.3 * times)
    rotations = np.stack([c, -s, 0 * c, s, c, 0 * c, 0 * c, 0 * c, 0 * c + 1], axis=1)
    shifts = np.stack([np.sin(times), np.cos(times), 5 * np.sin(times)], axis=1)
    shifts[random.random(n) < 0.01] = np.inf
    shifts[0] = 0.0
    present = (random.random(n) > 0.1).astype(float)
    return np.column_stack([times, stamps, present, wavelengths, rotations, shifts])


GAINS = np.array([[[8.0, -4.0, -4.0], [0.5, 6.5, -7.0]], [[9.0, -4.4, -4.6], [-0.3, 7.0, -6.7]]]) * 1e3
DISTANCES = np.array([28.0, 34.0])
REFERENCE = np.linspace(1530, 1560, 9)
WARMTH = np.array([[0.01, 0.0, -0.01], [0.0, 0.0, 0.0]])
MEANS = np.array([[0.0, 2e-6], [-3e-6, 0.0]])


def from_python(rows: Floats, of_force: bool) -> Floats:
    """What the C program writes of the tool, from whole runs in Python."""
    times, stamps = np.ascontiguousarray(rows[:, 0]), np.ascontiguousarray(rows[:, 1])
    wavelengths, poses = (np.ascontiguousarray(p) for p in np.split(rows[:, 3:], [9], 1))
    present = rows[:, 2] != 0
    n = len(rows)
    small, exact = (
        _core.ToolSensor(GAINS, DISTANCES, REFERENCE, 2e-4, _core.ToolBeam(60.0, 3.39e6 / 3.0, exact))
        for exact in (False, True)
    )
    columns = [small.measure_batch(stamps, wavelengths)[0]]
    start = (8.0, 4.0, 0.0)
    axis = np.arange(3)
    of_depth = np.where(np.eye(3) > 0, 0.01 * (axis + 1), 0.001 * (axis[:, None] + axis))
    of_beam = np.array([[0.01, 20.0], [20.0, 1e6]])
    doubts = (0.1, 0.005, 0.01, 1e-4, 0.02, 0.02, 0.003, 0.02)
    paper = _core.PaperFilter(small, start, poses[0], of_force)
    whole = _core.ToolFilter(exact, MEANS, WARMTH, of_depth, of_beam, doubts, 0.05, 0.01, start, poses[0])
    last = []
    for one in (paper, whole):
        told = one.run(times, poses, stamps, wavelengths, present)
        columns += [told["state"], told["covariance"].reshape(n, -1), told["force_mn"]]
        columns += [told[k][:, None] for k in ("arc_mm", "force_variance", "misfit", "faulty", "status")]
        names = ("steps", "updated", "missing", "late", "not_finite", "no_force", "no_motion", "clock", "gated")
        counts = one.statistics()
        last += [counts[k] for k in (*names, "nis_count", "nis_degrees", "nis_sum")]
    # of the tool's filter, which alone knows late readings and faults
    assert all((told["status"] & flag).any() for flag in (1, 2, 4, 8, 16, 32))
    assert (told["faulty"] > 0).any()
    return np.concatenate([np.hstack(columns).ravel(), last])


@pytest.mark.parametrize("of_force", [False, True])
def test_c_and_python_agree_to_the_last_bit(archive: Path, tmp_path: Path, of_force: bool) -> None:
    """Catches rows read as columns, a calibration that loses a number, another rounding in the two builds, a robot that
    begins in another frame or answers in it."""
    delta, spherical, serial, rows = delta_rows(), spherical_rows(), serial_rows(), tool_rows()
    # as they are loaded, and in the other frame
    deltas = make_robots.delta(), make_robots.delta("base")
    arms = make_robots.serial(), make_robots.serial("sensor")
    pointing = make_robots.spherical()
    flats = [robot.flat() for robot in (deltas[0], pointing, arms[0])]
    runs = (delta, spherical, serial)
    head = [*(len(one) for pair in zip(flats, runs, strict=True) for one in pair), len(rows)]
    sensor = [*GAINS.ravel(), *DISTANCES, *REFERENCE, 2e-4, of_force]
    parts = [head, *(one for pair in zip(flats, runs, strict=True) for one in pair), sensor, rows]
    np.concatenate([np.ravel(np.asarray(p, dtype=float)) for p in parts]).tofile(tmp_path / "in")
    run(built(archive, "tests/replay.c", tmp_path, "-O2"), tmp_path / "in", tmp_path / "out")
    out = np.fromfile(tmp_path / "out")
    expected: list[float] = []
    for row in delta:
        for made, place in zip(deltas, (row[8:11], row[11:]), strict=True):
            expected += single(made.forward, row[:3], row[3:8], (3, 9))
            expected += single(made.inverse, place, row[3:8], (3,))
    for row in spherical:
        expected += single(pointing.forward, row[:2], row[2:6], (2, 4))
        expected += single(pointing.inverse, row[6:], row[2:6], (2,))
    for row in serial:
        for arm, place in zip(arms, (row[15:18], row[18:21]), strict=True):
            expected += single(arm.forward, row[:6], row[6:15], (3, 18))
            expected += single(arm.inverse, place, row[6:15], (6,), row[21:])
    kinematics = np.array(expected)
    assert (kinematics == 3.0).any()
    assert (kinematics == 4.0).any()
    np.testing.assert_array_equal(out[: len(kinematics)], kinematics)
    np.testing.assert_array_equal(out[len(kinematics) :], from_python(rows, of_force))


@pytest.mark.parametrize("kind", ["delta", "serial"])
def test_both_frames_tell_of_one_place(kind: str) -> None:
    """Catches a frame that is the other one, a pose of the sensor that is its inverse, and errors of the instrument
    that are lost, or in where the robot is: the bits of C are those of this."""
    based, sensed = (getattr(make_robots, kind)(frame) for frame in ("base", "sensor"))
    rows = {"delta": delta_rows, "serial": serial_rows}[kind]()
    count = 3 if kind == "delta" else 6
    joints, now = np.ascontiguousarray(rows[20:, :count]), list(rows[20, count : 2 * count + 2 + (kind == "serial")])
    place, there = based.forward_batch(joints, now)[0], sensed.forward_batch(joints, now)[0]
    straight = seen(based, place)
    if kind == "delta":
        leaning = straight @ (np.eye(3) + make_robots.BEAMS).T
        read = leaning + make_robots.BENDS_MM * (leaning / 20.0) ** 3
    else:
        read = straight * (1.0 + make_robots.SCALE) + make_robots.ARM_BENDS_MM * (straight / 1000.0) ** 3
    # where a delta's region ends two models are blended after they are read: beams and bends are all but straight
    np.testing.assert_allclose(there, read, atol=1e-8)
    assert np.linalg.norm(read - straight, axis=1).min() > 0.05
    assert np.linalg.norm(there - place, axis=1).min() > 1.0


def test_a_frame_that_is_none_is_refused(archive: Path, tmp_path: Path) -> None:
    """Catches a loop that goes on in a frame that it did not ask for."""
    source = tmp_path / "frames.c"
    source.write_text(
        """
        #include "robots.h"
        #include "sherkit.h"
        int main(void)
        {
            static sherkit_delta delta;
            static sherkit_serial arm;
            const double q[3] = {130.0, 131.0, 129.0};
            double x[3], again[3];
            if (sherkit_delta_use_frame(&delta, SHERKIT_FRAME_BASE) != SHERKIT_NOT_INITIALISED) return 1;
            if (sherkit_delta_use_frame(0, SHERKIT_FRAME_BASE) != SHERKIT_NULL) return 2;
            if (sherkit_delta_init(&delta, example_delta, sizeof example_delta / 8) != SHERKIT_OK) return 3;
            if (sherkit_delta_forward(&delta, q, 0, x, 0) != SHERKIT_OK) return 4;
            if (sherkit_delta_use_frame(&delta, 2) != SHERKIT_INVALID) return 5;
            if (sherkit_serial_use_frame((sherkit_serial *)&delta, 0) != SHERKIT_NOT_INITIALISED) return 6;
            if (sherkit_delta_forward(&delta, q, 0, again, 0) != SHERKIT_OK || again[0] != x[0]) return 7;
            if (sherkit_delta_use_frame(&delta, SHERKIT_FRAME_BASE) != SHERKIT_OK) return 8;
            if (sherkit_delta_forward(&delta, q, 0, again, 0) != SHERKIT_OK || again[0] == x[0]) return 9;
            if (sherkit_delta_use_frame(&delta, SHERKIT_FRAME_SENSOR) != SHERKIT_OK) return 13;
            if (sherkit_delta_forward(&delta, q, 0, again, 0) != SHERKIT_OK || again[0] != x[0]) return 14;
            if (sherkit_serial_init(&arm, example_serial, sizeof example_serial / 8) != SHERKIT_OK) return 10;
            if (sherkit_serial_use_frame(&arm, 7) != SHERKIT_INVALID) return 11;
            return example_spherical[0] > 0 ? 0 : 12;
        }
        """,
        encoding="utf-8",
    )
    run("cc", *STRICT, f"-I{LIBRARY / 'examples'}", source, archive, "-lm", "-o", tmp_path / "frames")
    run(tmp_path / "frames")


def test_nothing_in_the_library_can_panic(archive: Path) -> None:
    """Catches a bounds check, an unwrap or an overflow check that the compiler could not prove away."""
    symbols = subprocess.run([tool("nm"), str(archive)], capture_output=True, text=True, check=False).stdout
    assert len(re.findall(r" T sherkit_", symbols)) >= 20
    assert not re.findall(r".*(?:sherkit_has_a_path_to_a_panic|panicking|panic_fmt|unwind).*", symbols)
    # nor can it allocate, lock or wait
    assert not re.findall(r" U (?:malloc|calloc|free|pthread\w*|__rust_alloc\w*|futex)$", symbols, re.MULTILINE)


@pytest.mark.slow
@pytest.mark.parametrize("target", ["aarch64-unknown-linux-gnu", "thumbv7em-none-eabihf"])
def test_nothing_in_the_library_can_panic_on_another_processor(target: str, tmp_path: Path) -> None:
    """Catches a check that the compiler proves away for one processor alone: elsewhere the library would not link."""
    found = run(tool("rustc"), "--print", "target-libdir", "--target", target).strip()
    if not Path(found).is_dir():
        pytest.skip(f"the standard library of {target} is not installed: rustup target add {target}")
    command = [tool("cargo"), "rustc", "--quiet", "--locked", "--profile", "control", "-p", "sherkit-c", "--lib"]
    run(*command, "--crate-type", "staticlib", "--target", target, "--target-dir", tmp_path, cwd=ROOT)
    archive = tmp_path / target / "control" / "libsherkit.a"
    symbols = subprocess.run([tool("nm"), str(archive)], capture_output=True, text=True, check=False).stdout
    assert len(re.findall(r" T sherkit_", symbols)) >= 20
    assert not re.findall(r".*(?:sherkit_has_a_path_to_a_panic|panicking|panic_fmt).*", symbols)


def test_the_header_serves_c_and_cpp(tmp_path: Path) -> None:
    """Catches a header that one of the two compilers refuses."""
    source = tmp_path / "header.c"
    source.write_text('#include "sherkit.h"\nint main(void) { return SHERKIT_OK; }\n', encoding="utf-8")
    run(tool("cc"), *STRICT, "-fsyntax-only", source)
    run(tool("c++"), "-x", "c++", "-std=c++17", "-Wall", "-Wextra", "-Werror", STRICT[-1], "-fsyntax-only", source)


def test_the_examples_robots_are_what_flat_writes() -> None:
    """Catches a change of the layout after which the examples would not start."""
    assert make_robots.HEADER.read_text(encoding="utf-8") == make_robots.text()


@pytest.mark.parametrize("steps", [40_000, *slow(10_000_000)])
def test_random_missing_and_nan_input_under_sanitizers(archive: Path, tmp_path: Path, steps: int) -> None:
    """Catches an estimate that is not finite and does not say so, a read or write beside what was given."""
    program = built(archive, "tests/stress.c", tmp_path, *SANITIZED)
    assert run(program, str(steps), "7").startswith(f"{steps} steps")


@pytest.mark.slow
def test_the_loop_runs_and_logs(archive: Path, tmp_path: Path) -> None:
    """Catches an example that does not build, or whose estimate is no better than the unbent tip."""
    cmake, source = tool("cmake"), LIBRARY / "examples" / "loop"
    run(cmake, "-S", source, "-B", tmp_path, f"-DSHERKIT_TARGET_DIR={TARGET}")
    run(cmake, "--build", tmp_path)
    said = run(tmp_path / "loop", "--seconds", "2", "--log", tmp_path / "log.csv")
    depth, tip, paper_depth, paper_tip, unbent = (float(x) for x in re.findall(r"([\d.]+) mm", said))
    assert max(depth, paper_depth) < 1.0
    assert max(tip, paper_tip) < 0.1 * unbent
    lines = (tmp_path / "log.csv").read_text(encoding="utf-8").splitlines()
    assert len(lines) == 2001
    assert lines[0].startswith("time_s,force_mN,depth_true_mm,depth_mm")


def test_a_recorded_run_is_replayed(archive: Path, tmp_path: Path) -> None:
    """Catches a tool whose numbers are lost on the way to C, and an example that no longer does what Python does."""
    doubt = ToolDoubt(
        depth=((0.01, 1e-3, 0.0), (1e-3, 0.02, -1e-3), (0.0, -1e-3, 1 / 300)), deeper_mm=0.1, turn_rad=0.004,
        force=0.01, beam=((1e-3, 20.0), (20.0, 1e6)), reference_nm=2e-4, mean=0.03, unlike=0.02, warmth=0.01,
    )  # fmt: skip
    there = FlexibleTool(
        noise_nm=1.1e-3, means=((0.0, 1e-6), (-2e-6, 0.0)), warmth=((0.01, -0.02, 0.01), (0.0, 0.003, -0.003)),
        start_depth_mm=1 / 3, per_second_mm2=(0.004, 1.0), fibre_delay_s=0.02, doubt=doubt,
    )  # fmt: skip
    there.save(tmp_path / "tool.toml")
    recorded = VirtualTool(there, lost=0.05).run("vessels", seconds=5.0)
    recorded.save(tmp_path / "run.csv")
    arguments = ["export", "c", str(tmp_path / "tool.toml"), "-o", str(tmp_path / "tool.h")]
    assert CliRunner().invoke(cli, arguments).exit_code == 0
    program = built(archive, "examples/replay/replay.c", tmp_path, "-I", str(tmp_path))
    table = np.genfromtxt(run(program, tmp_path / "run.csv").splitlines(), delimiter=",", names=True)
    e = estimate(there, recorded)
    np.testing.assert_allclose(table["depth_mm"], e.depth.value[:, 0], atol=1e-9)
    np.testing.assert_allclose(table["depth_variance"], e.depth.covariance[:, 0, 0], rtol=1e-9)
    np.testing.assert_array_equal(table["status"], e.together.status)
    for k, axis in enumerate("xyz"):
        np.testing.assert_allclose(table[f"tip_{axis}_mm"], e.tip.value[:, k], atol=1e-9)


def test_the_bare_program_needs_nothing_else(archive: Path) -> None:
    """Catches a core that needs an operating system or the C library."""
    tool("make")
    if not (sys.platform == "linux" and os.uname().machine == "x86_64"):
        pytest.skip("the bare example begins and ends as a Linux program for x86-64")
    run("make", "-C", LIBRARY / "examples" / "bare", "run", f"TARGET={TARGET}")


def test_the_loop_of_the_page_on_arms_is_that_of_python(archive: Path, tmp_path: Path) -> None:
    """Catches a calibration that loses a number on its way to C, and a page that shows C which does not build."""
    page = (ROOT / "docs" / "arm.md").read_text(encoding="utf-8")
    (tmp_path / "loop.c").write_text(re.findall(r"```c\n(.*?)```", page, re.DOTALL)[0], encoding="utf-8")
    seen = VirtualSerial(KIND.example, noise_mm=0.05).measure(postures(KIND.example, 60, seed=1), seed=2)
    made = sk.calibrate(KIND.example, seen, effects=["joint_compliance"]).calibration
    made.save(tmp_path / "calibrated.toml")
    arguments = ["export", "c", str(tmp_path / "calibrated.toml"), "-o", str(tmp_path / "robot.h")]
    assert CliRunner().invoke(cli, arguments).exit_code == 0
    run("cc", *STRICT, "-I", tmp_path, tmp_path / "loop.c", archive, "-lm", "-o", tmp_path / "loop")
    joints = np.array([0.2, 0.4, -0.9, 0.1, 0.8, 0.0])
    place = made.forward(joints)
    for line in run(tmp_path / "loop").splitlines():
        place += [1.0, 0.0, 0.0]
        joints = made.inverse(place, start=joints)
        np.testing.assert_array_equal([float(one) for one in line.split(",")], joints)
