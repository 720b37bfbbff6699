"""Work to be counted: ``python hot_paths.py NAME REPEATS`` prepares a hot path and walks it so often."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np

import sherkit as sk
from second_tool import CONDITIONS
from sherkit import _core
from sherkit.cli.demo import EXAMPLE
from tool_honesty import run_of, tool_of

sys.path.insert(0, str(Path(__file__).parents[1] / "docs"))
from make_robots import delta

#: What is walked once, and how often it is worth counting.
REPEATS = {"forward": 200, "inverse": 50, "identify": 100, "bernstein": 10, "tool": 100}


def path(name: str) -> Callable[[], object]:
    """The work of that name, ready to be done."""
    random = np.random.default_rng(0)
    if name == "forward":
        joints = random.uniform(118.0, 140.0, (40_000, 3))
        return lambda: EXAMPLE.kinematics().forward_batch(joints)
    if name == "inverse":
        robot, places = delta("base"), random.uniform(-15.0, 15.0, (1_000, 3))
        return lambda: robot.inverse_batch(places, [0.0, 20.0, 0.0, 0.0, 0.0])
    if name == "bernstein":
        x = random.uniform(-20.0, 20.0, (10_000, 3))
        corners = np.full(3, -20.0), np.full(3, 20.0)
        return lambda: _core.bernstein_fit((5, 5, 5), *corners, x, np.sin(x))
    if name == "tool":
        told = CONDITIONS["exact_rod_pivot"]
        tool, run = tool_of(told), run_of(told.run("phantom", seconds=10.0))
        there = np.isfinite(run.wavelengths_nm).any(axis=1)
        steps = run.time_s, run.poses, run.fibre_times_s, run.wavelengths_nm, there
        return lambda: tool.tracker(0.0, run.poses[0]).run(*steps)
    measured = sk.delta.VirtualDelta.draw(EXAMPLE, 1).measure(sk.delta.paper_whole(), repeats=1, seed=1)
    model = sk.delta.DeltaModel(EXAMPLE)
    return lambda: sk.identify(model, measured)


if __name__ == "__main__":
    walk = path(sys.argv[1])
    walk()
    for _ in range(int(sys.argv[2])):
        walk()
