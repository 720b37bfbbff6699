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

import sherkit as sk

ROOT = Path(__file__).parent.parent


def built(*command: str) -> str:
    """What a program of the workspace prints, built if need be."""
    return subprocess.run(command, check=True, capture_output=True, text=True, cwd=ROOT).stdout


def tip_filter(bench: Bench) -> None:
    """A recorded run, from Python, and one step, in Rust."""
    run = filterpy_tool.recorded(100_000)
    n = len(run.times_s)
    beam, noise = sk._core.ToolBeam.ebrahimi_2020(), sk._core.FilterNoise.ebrahimi_2020()
    poses = np.hstack([run.rotations.reshape(n, 9), run.shifts_mm])
    depths = np.column_stack([run.depths_mm, np.zeros(n)])
    measured = np.zeros((n, 11))
    measured[:, 0], measured[:, 1:3], measured[:, 7] = run.times_s, run.forces_mN, run.depths_mm

    def ours() -> np.ndarray:
        tip = sk._core.TipFilter(beam, poses[0], 1.0, 0.0, noise)
        return tip.filter(run.times_s, run.velocities_mm_s, poses, depths, measured)[0]

    assert np.abs(filterpy_tool.TipFilter(run).whole() - ours()).max() < 1e-6
    runs = {"sherkit": ours, "filterpy, step by step": lambda: filterpy_tool.TipFilter(run).whole()}
    bench.compare("tip filter over a recorded run of 100,000 steps, from Python", runs, 3, goal="100 ×")
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
    print("1 kHz loop in C++: fibres, the tool's filter, the paper's two and inverse kinematics in every step")
    said = built(f"{folder}/loop", "--seconds", "30", "--load", str(max(1, (os.cpu_count() or 2) - 1)))
    print(said)
    for what, line in re.findall(r"^(a step takes|it begins late by) (.*)$", said, re.MULTILINE):
        for name, us in re.findall(r"(p50|p99\.99|max)\s+([\d.]+) us", line):
            late = 1e-6 * float(us)
            goal = "5 µs" if (what, name) == ("a step takes", "p50") else ""
            bench.add(f"1 kHz loop in C++, {what}, {name}", {"sherkit": [Timed(late, late)]}, goal)
