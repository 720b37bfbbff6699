"""Speed of identification, of a study's steps, of polynomials and of the stream, against NumPy and SciPy."""

from __future__ import annotations

import sys
from functools import reduce
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import polars as pl
from numpy_delta import FREE, derivatives, designed, forward, gauss_newton, turned
from scipy.optimize import least_squares
from timing import Bench, part, process

import sherkit as sk
from sherkit.cli.demo import EXAMPLE as ROBOT

OFFSET = np.array(ROBOT.target_offset_mm)
STREAMED = (100_000, 1_000_000, 3_000_000)


def identification(bench: Bench) -> None:
    """588 poses to the nonlinear minimum, from Python."""
    data = sk.delta.VirtualDelta.draw(ROBOT, 1).measure(sk.delta.paper_whole(), repeats=1, seed=1)
    model = sk.delta.DeltaModel(ROBOT)
    measured = data.readings[:, :3]

    def residual(p: np.ndarray) -> np.ndarray:
        full = ROBOT.geometry.copy()
        full[FREE] += p[:12]
        return (measured - (forward(full, data.joints) + OFFSET) @ turned(p[12:15])[0].T - p[15:]).ravel()

    def jacobian(p: np.ndarray) -> np.ndarray:
        return -designed(ROBOT.geometry, data.joints, OFFSET, p)[1].reshape(-1, 18)

    runs = {
        "sherkit": lambda: sk.identify(model, data),
        "NumPy Gauss–Newton, derivatives by hand": lambda: gauss_newton(ROBOT.geometry, data.joints, measured, OFFSET),
        "scipy.optimize.least_squares, derivatives by hand": lambda: least_squares(
            residual, np.zeros(18), jacobian, method="lm"
        ),
        "the same with differences, as usually written": lambda: least_squares(residual, np.zeros(18), method="lm"),
    }
    ours = float(np.nansum(sk.identify(model, data).residuals ** 2))
    others = [gauss_newton(ROBOT.geometry, data.joints, measured, OFFSET)[1]]
    for by in ("2-point", jacobian):
        others.append(2.0 * float(least_squares(residual, np.zeros(18), by, method="lm").cost))
    assert all(abs(ours - other) < 1e-6 * ours for other in others), (ours, others)
    bench.compare("identification of 588 poses, 18 values, to the minimum", runs, goal="0.3 ms, 10 × Gauss–Newton")


def study(bench: Bench) -> None:
    """A step of a study, and back: 588 poses read five times."""
    data = sk.delta.VirtualDelta.draw(ROBOT, 1).measure(sk.delta.paper_whole(), repeats=5, seed=1)
    made = sk.Study(ROBOT, data)
    made.add("joint_scale")

    def again() -> None:
        made.undo()
        made.add("joint_scale")

    bench.compare("`Study.undo` and `Study.add`, 2,940 rows", {"sherkit": again}, 5, goal="11 ms")


def bernstein(bench: Bench) -> None:
    """A correction of degree 5 in three coordinates, from scattered poses and from a grid."""
    rng = np.random.default_rng(2)
    x = rng.uniform(-20, 20, (10_000, 3))
    x[:2] = [[-20, -20, -20], [20, 20, 20]]
    y = np.stack([np.sin(x[:, 0] / 9), np.cos(x[:, 1] / 7), x[:, 2] * x[:, 0] / 400], axis=1)
    y += 0.005 * rng.normal(size=y.shape)
    orders = (5, 5, 5)

    def basis(at: np.ndarray) -> np.ndarray:
        t = (at + 20) / 40
        return np.stack([c * t**k * (1 - t) ** (5 - k) for k, c in enumerate((1, 5, 10, 10, 5, 1))], axis=1)

    def design() -> np.ndarray:
        b = [basis(x[:, k]) for k in range(3)]
        return (b[0][:, :, None, None] * b[1][:, None, :, None] * b[2][:, None, None, :]).reshape(len(x), -1)

    def lstsq() -> np.ndarray:
        return np.linalg.lstsq(design(), y, rcond=None)[0]

    def normal() -> np.ndarray:
        made = design()
        return np.linalg.solve(made.T @ made, made.T @ y)

    ours = sk.delta.fit_polynomial(x, y, orders)
    assert np.abs(ours.coefficients_mm - lstsq()).max() < 1e-6
    runs = {
        "sherkit": lambda: sk.delta.fit_polynomial(x, y, orders),
        "numpy.linalg.lstsq": lstsq,
        "NumPy normal equations, half the digits": normal,
    }
    bench.compare("Bernstein 5³ over 10,000 scattered poses", runs, 7, goal="5 ms, 20 × lstsq")
    ticks = np.linspace(-20, 20, 22)
    axes = [ticks, ticks, np.linspace(-20, 20, 21)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    values = np.stack([np.sin(grid[..., 0] / 9), np.cos(grid[..., 1] / 7), grid[..., 2] ** 2 / 400], axis=-1)

    def kronecker() -> np.ndarray:
        inverses = [np.linalg.pinv(basis(axis)) for axis in axes]
        return reduce(lambda v, k: np.moveaxis(np.tensordot(inverses[k], v, (1, k)), 0, k), range(3), values)

    made = sk.delta.fit_grid(axes, values, orders).coefficients_mm.reshape(6, 6, 6, 3)
    assert np.abs(made - kronecker()).max() < 1e-9
    runs = {"sherkit": lambda: sk.delta.fit_grid(axes, values, orders), "NumPy, one axis after the other": kronecker}
    bench.compare("the same on a grid of 10,164 poses", runs)


def streaming(bench: Bench) -> None:
    """A Parquet file that is read block by block: time and memory of a process of its own, imports among them."""
    with TemporaryDirectory() as folder:
        whole = sk.delta.VirtualDelta.draw(ROBOT, 1).measure(sk.delta.paper_whole(), repeats=170, seed=1).to_frame()
        for rows in STREAMED:
            path = Path(folder) / f"{rows}.parquet"
            parts = [whole.with_columns(pl.col("pose") + 1000 * k) for k in range(rows // len(whole) + 1)]
            pl.concat(parts).head(rows).write_parquet(path)
            ours, theirs = [], []
            for _ in range(min(bench.most, 3 if rows <= STREAMED[1] else 1)):
                ours.append(process(part(__file__, "stream", path)))
                theirs.append(process(part(__file__, "stream_numpy", path)))
            samples = {"sherkit": ours, "NumPy Gauss–Newton over polars' blocks": theirs}
            bench.add(f"streaming solve of {rows:,} rows of Parquet", samples, "0.5 µs a row, 250 MB")


def stream(path: str) -> None:
    """Ours, in a process of its own."""
    fit = sk.fit.identify_stream(ROBOT, sk.data.stream_measurements(path))
    assert fit.converged


def stream_numpy(path: str) -> None:
    """The same with NumPy: normal equations block by block."""
    values = np.zeros(15)
    for _ in range(6):
        full = ROBOT.geometry.copy()
        full[FREE] += values[:12]
        gram, right = np.zeros((15, 15)), np.zeros(15)
        for frame in pl.scan_parquet(path).select(r"^(q\d|[xyz])_mm$").collect_batches(chunk_size=50_000):
            block = frame.select("q1_mm", "q2_mm", "q3_mm", "x_mm", "y_mm", "z_mm").to_numpy()
            x, by, _ = derivatives(full, np.ascontiguousarray(block[:, :3]))
            design = np.concatenate([by, np.broadcast_to(np.eye(3), (len(by), 3, 3))], axis=2).reshape(-1, 15)
            gram += design.T @ design
            right += design.T @ (block[:, 3:] - x - OFFSET - values[12:]).ravel()
        size = np.sqrt(np.diag(gram))
        step = np.linalg.lstsq(gram / np.outer(size, size), right / size, rcond=1e-12)[0] / size
        values += step
        if np.abs(step).max() < 1e-9:
            break


if __name__ == "__main__":
    {"stream": stream, "stream_numpy": stream_numpy}[sys.argv[1]](sys.argv[2])
