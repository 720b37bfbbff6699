"""Speed of the flexible tool's filters, and of the control loop in C++."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from pathlib import Path

import filterpy_tool
import numpy as np
from timing import Bench, Timed

from sherkit import _core

ROOT = Path(__file__).parent.parent


def built(*command: str) -> str:
    """What a program of the workspace prints, built if need be."""
    return subprocess.run(command, check=True, capture_output=True, text=True, cwd=ROOT).stdout


def paper_filters(bench: Bench) -> None:
    """A recorded run through the paper's filters, from Python, and one step of them and of the tool's, in Rust."""
    run = filterpy_tool.recorded(100_000)
    gratings = filterpy_tool.GAINS, filterpy_tool.DISTANCES_MM, filterpy_tool.REFERENCE_NM, filterpy_tool.NOISE_NM
    sensor = _core.ToolSensor(*gratings, _core.ToolBeam(60.0, 3.39e6 / 3.0))
    there = np.ones(len(run.times_s), dtype=bool)
    start = filterpy_tool.START_MM, filterpy_tool.START_MM2, 0.0

    def ours() -> np.ndarray:
        both = _core.PaperFilter(sensor, start, run.poses[0])
        return both.run(run.times_s, run.poses, run.times_s, run.wavelengths_nm, there)["state"]

    def theirs() -> np.ndarray:
        return filterpy_tool.PaperFilters(run).whole()

    assert np.abs(theirs() - ours()).max() < 1e-6
    runs = {"sherkit": ours, "filterpy, step by step": theirs}
    bench.compare("the paper's filters over a recorded run of 100,000 steps, from Python", runs, 3, goal="100 ×")
    step_time = ("cargo", "run", "--quiet", "--release", "--locked", "-p", "sherkit-core", "--example", "step_time")
    for line in built(*step_time).splitlines():
        said = re.fullmatch(r"(.*\S)\s+([\d.]+) ns(.*)", line)
        assert said, line
        step = 1e-9 * float(said[2])
        goal = "200 ns" if said[1].startswith("tool") and not said[3] else ""
        bench.add(f"one step in Rust: {' '.join(said[1].split())}{said[3]}", {"sherkit": [Timed(step, step)]}, goal)


def control_loop(bench: Bench) -> None:
    """The C++ example at 1 kHz with every other core loaded: no speed, but how late a step may be."""
    if not shutil.which("cmake"):
        print("The 1 kHz loop is not timed: CMake is not installed (Debian: apt-get install cmake g++)")
        return
    target = os.environ.get("CARGO_TARGET_DIR", str(ROOT / "target"))
    folder = f"{target}/loop"
    built("cmake", "-S", "rust/c/examples/loop", "-B", folder, f"-DSHERKIT_TARGET_DIR={target}")
    built("cmake", "--build", folder)
    print("1 kHz loop in C++: fibres, the tool's filter, the paper's and inverse kinematics in every step")
    said = built(f"{folder}/loop", "--seconds", "30", "--load", str(max(1, (os.cpu_count() or 2) - 1)))
    print(said)
    for what, line in re.findall(r"^(a step takes|it begins late by) (.*)$", said, re.MULTILINE):
        for name, us in re.findall(r"(p50|p99\.99|max)\s+([\d.]+) us", line):
            late = 1e-6 * float(us)
            goal = "5 µs" if (what, name) == ("a step takes", "p50") else ""
            bench.add(f"1 kHz loop in C++, {what}, {name}", {"sherkit": [Timed(late, late)]}, goal)
