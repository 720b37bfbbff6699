"""Speed, side by side in one run: sherkit against what a user would pick instead. Run by ``make bench``.

Every pair is timed in turns, so that a noisy machine is noisy for both; medians and their ratio are printed.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Iterator

import numpy as np
from numpy_delta import forward, forward_plain
from rich.console import Console
from rich.table import Table
from scipy.optimize import least_squares
from scipy_candidates import refit_all, simulator
from spherical import kinematics as spherical_kinematics
from spherical import projection
from timing import medians, show
from tool import control_loop, tip_filter

import sherkit as sk
from sherkit.cli.demo import EXAMPLE as ROBOT


def kinematics() -> None:
    q = np.random.default_rng(0).uniform(118, 140, (1_000_000, 3))
    kin = ROBOT.kinematics()
    out = np.empty_like(q)
    for other in (forward, forward_plain):
        assert np.abs(other(ROBOT.geometry, q) - kin.forward_batch(q)[0]).max() < 1e-10
    times = medians(
        {
            "sherkit forward_batch": lambda: kin.forward_batch(q),
            "vectorised NumPy, as usually written": lambda: forward_plain(ROBOT.geometry, q),
            "vectorised NumPy, algebra by hand": lambda: forward(ROBOT.geometry, q),
            "memcpy of the same bytes into a new array": lambda: q.copy(),
            "memcpy of the same bytes into an old array": lambda: np.copyto(out, q),
        },
        15,
    )
    show("Forward kinematics of 1,000,000 poses", "≥ 30 × NumPy", "sherkit forward_batch", times)


def identification() -> None:
    virtual = sk.delta.VirtualDelta.draw(ROBOT, 1)
    data = virtual.measure(sk.delta.paper_whole(), repeats=1, seed=1)
    model = sk.delta.DeltaModel(ROBOT)
    free = np.array([6 * limb + k for limb in range(3) for k in range(4)])
    offset = np.array(ROBOT.target_offset_mm)
    measured = data.readings[:, :3]

    def residual(p: np.ndarray) -> np.ndarray:
        full = ROBOT.geometry.copy()
        full[free] += p[:12]
        return (measured - forward(full, data.joints) - offset - p[12:]).ravel()

    def scipy_fit() -> object:
        return least_squares(residual, np.zeros(15), method="lm", x_scale=np.maximum(1e-3, np.ones(15)))

    fit = sk.identify(model, data)
    cost = float((residual(scipy_fit().x) ** 2).sum())  # type: ignore[attr-defined]
    ours = float(np.nansum(fit.residuals**2))
    assert ours <= cost * (1 + 1e-6), (ours, cost)
    times = medians({"sherkit identify": lambda: sk.identify(model, data), "scipy least_squares lm": scipy_fit}, 15)
    show("Identification of 588 poses to the nonlinear minimum, from Python", "≥ 20 ×", "sherkit identify", times)


def streaming() -> None:
    """Peak memory in processes of their own, so that one run does not hide behind another."""
    table = Table("rows", "time", "peak memory", title="Streaming solve", title_justify="left", caption="goal: flat")
    for rows in (100_000, 1_000_000, 10_000_000):
        command = [sys.executable, __file__, "--stream", str(rows)]
        out = subprocess.run(command, check=True, capture_output=True, text=True).stdout.split()
        table.add_row(f"{rows:,}", f"{float(out[0]):.2f} s", f"{float(out[1]):.0f} MB")
    Console(width=100).print(table)


def stream(rows: int) -> None:
    import resource

    virtual = sk.delta.VirtualDelta.draw(ROBOT, 1)
    block = virtual.measure(sk.delta.paper_whole(), repeats=170, seed=1)

    def blocks() -> Iterator[sk.Measurements]:
        left = rows
        while left > 0:
            yield block if left >= len(block) else block.select(np.arange(left))
            left -= len(block)

    start = time.perf_counter()
    fit = sk.fit.identify_stream(ROBOT, sk.data.MeasurementStream(blocks, "bench"))
    assert fit.converged
    assert fit.rows == rows
    print(time.perf_counter() - start, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)


def bernstein() -> None:
    rng = np.random.default_rng(2)
    x = rng.uniform(-20, 20, (10_000, 3))
    x[:2] = [[-20, -20, -20], [20, 20, 20]]
    y = np.stack([np.sin(x[:, 0] / 9), np.cos(x[:, 1] / 7), x[:, 2] * x[:, 0] / 400], axis=1)
    y += 0.005 * rng.normal(size=y.shape)
    orders = (5, 5, 5)

    def lstsq() -> object:
        t = (x + 20) / 40
        b = [sk._core.bernstein_basis(5, np.ascontiguousarray(t[:, k])) for k in range(3)]
        design = (b[0][:, :, None, None] * b[1][:, None, :, None] * b[2][:, None, None, :]).reshape(len(x), -1)
        return np.linalg.lstsq(design, y, rcond=None)[0]

    ours = sk.delta.fit_polynomial(x, y, orders)
    assert np.abs(ours.coefficients_mm - lstsq()).max() < 1e-6
    ticks = np.linspace(-20, 20, 22)
    axes = [ticks, ticks, np.linspace(-20, 20, 21)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    values = np.stack([np.sin(grid[..., 0] / 9), np.cos(grid[..., 1] / 7), grid[..., 2] ** 2 / 400], axis=-1)
    times = medians(
        {
            "sherkit, scattered": lambda: sk.delta.fit_polynomial(x, y, orders),
            "numpy.linalg.lstsq, scattered": lstsq,
            "sherkit, grid form (10,164 poses)": lambda: sk.delta.fit_grid(axes, values, orders),
        },
        7,
    )
    show("Bernstein of degree 5³ over 10,000 poses", "no slower than lstsq", "sherkit, scattered", times)
    show("The same on a grid", "≥ 20 ×", "sherkit, grid form (10,164 poses)", times)


def diagnosis() -> None:
    """In a process of its own, in which the linear algebra below NumPy is held to one thread."""
    plan = simulator.make_plan(simulator.Robot.from_dict(), simulator.whole_grid(), repeats=5, order="shuffled", seed=1)
    rng = np.random.default_rng(5)
    there = simulator.Robot.from_dict()
    errors = simulator.draw_geometric_errors(rng)
    hidden = simulator.scaled_effect(there, plan, "rail_lean", rng, 0.02, errors=errors)
    data = sk.from_frame(simulator.simulate(there, plan, errors=errors, effects=hidden, noise=0.005, seed=3))
    fit = sk.identify(ROBOT, data)
    assert sk.diagnose(fit).effects == ("rail_lean",)
    start = time.perf_counter()
    left = refit_all(ROBOT, data)
    scipy_s = time.perf_counter() - start
    assert min(left, key=lambda name: left[name]) == "rail_lean"
    ours = medians({"d": lambda: sk.diagnose(fit)}, 5)["d"]
    times = {"sherkit: the full diagnosis": ours, "scipy: the eleven candidates refitted once": scipy_s}
    show(
        "Diagnosis of 588 × 5 rows, whole catalogue, one core",
        "≤ 500 ms and ≥ 50 ×",
        "sherkit: the full diagnosis",
        times,
    )


if __name__ == "__main__":
    if "--stream" in sys.argv:
        stream(int(sys.argv[-1]))
    elif "--diagnosis" in sys.argv:
        diagnosis()
    else:
        robots = (kinematics, spherical_kinematics, projection, identification, bernstein, streaming)
        for part in (*robots, tip_filter, control_loop):
            part()
        one_core = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")
        subprocess.run([sys.executable, __file__, "--diagnosis"], check=True, env=os.environ | one_core)
