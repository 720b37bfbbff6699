"""Speed of the flexible tool's filters, and of the control loop in C++."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from pathlib import Path

import filterpy_tool
import numpy as np
from rich.console import Console
from rich.table import Table
from timing import medians, show

import sherkit as sk

ROOT = Path(__file__).parent.parent


def built(*command: str) -> str:
    """What a program of the workspace prints, built if need be."""
    return subprocess.run(command, check=True, capture_output=True, text=True, cwd=ROOT).stdout


def tip_filter() -> None:
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

    stepped = filterpy_tool.TipFilter(run)
    assert np.abs(filterpy_tool.TipFilter(run).whole() - ours()).max() < 1e-6
    whole = medians(
        {"sherkit filter(), from Python": ours, "filterpy, step by step": lambda: filterpy_tool.TipFilter(run).whole()},
        7,
    )
    show("Tip filter over a recorded run of 100,000 steps", "≥ 100 ×", "sherkit filter(), from Python", whole)

    def thousand() -> None:
        for i in range(1000):
            stepped.step(i)

    step_time = ("cargo", "run", "--quiet", "--release", "--locked", "-p", "sherkit-core", "--example", "step_time")
    printed = built(*step_time)
    ns = [float(x) for x in re.findall(r"tip +paper +([\d.]+) ns", printed)]
    other = 1e6 * medians({"f": thousand}, 15)["f"]
    table = Table(
        "", "median", "faster by", title="One step", title_justify="left", caption="≤ 150 ns, ≥ 100 × filterpy"
    )
    for line in printed.splitlines():
        name, time_ns = line.removesuffix(" ns").rsplit(maxsplit=1)
        table.add_row(
            f"Rust: {name}", f"{time_ns} ns", f"{other / ns[0]:.0f} ×" if re.match("tip +paper", name) else ""
        )
    table.add_row("filterpy: tip", f"{other:.0f} ns", "")
    Console(width=100).print(table)


def control_loop() -> None:
    """The C++ example at 1 kHz with the other core loaded."""
    if not shutil.which("cmake"):
        print("The 1 kHz loop is not timed: CMake is not installed (Debian: apt-get install cmake g++)")
        return
    target = os.environ.get("CARGO_TARGET_DIR", str(ROOT / "target"))
    folder = f"{target}/loop"
    built("cmake", "-S", "rust/c/examples/loop", "-B", folder, f"-DSHERKIT_TARGET_DIR={target}")
    built("cmake", "--build", folder)
    print("1 kHz loop in C++: fibres, depth, tip, joint filter and inverse kinematics in every step")
    print(built(f"{folder}/loop", "--seconds", "30", "--load", str(max(1, (os.cpu_count() or 2) - 1))))
