"""Measuring plans: which points, in which order, at which times and under which conditions."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from .effects import Columns
from .geometry import Array, Robot, inverse_kinematics

Order = Literal["planes", "repeats_together", "shuffled"]
COLUMN_NAMES = (
    "pose", "repeat", "time_s", "q1_mm", "q2_mm", "q3_mm",
    "x_mm", "y_mm", "z_mm", "temperature_c", "humidity_pct",
)  # fmt: skip


def grid(half_width_mm: float, per_side: int, planes_mm: tuple[float, ...]) -> Array:
    """Square grid points (n, 3), mm: plane after plane, rows in serpentine order."""
    side = np.linspace(-half_width_mm, half_width_mm, per_side)
    x = np.tile(side, (per_side, 1))
    x[1::2] = x[1::2, ::-1].copy()
    y = np.repeat(side, per_side)
    return np.concatenate([np.column_stack([x.ravel(), y, np.full(y.shape, z)]) for z in planes_mm])


def whole_grid() -> Array:
    """588 points over the whole workspace."""
    return grid(20.0, 14, (-20.0, 0.0, 20.0))


def local_grid() -> Array:
    """363 points over the region of interest."""
    return grid(10.0, 11, (-10.0, 0.0, 10.0))


def smooth_wander(rng: np.random.Generator, time_s: Array) -> Array:
    """Smooth random walk of about unit sd: random Fourier modes falling as 1/frequency.

    The longest period is twice the run, so the two ends need not agree.
    """
    modes = np.arange(1, 9)
    phase = np.pi * modes * time_s[:, None] / max(time_s[-1], 1.0)
    amplitude = rng.normal(size=(2, len(modes))) / modes / np.sqrt(np.sum(1.0 / modes**2))
    return np.cos(phase) @ amplitude[0] + np.sin(phase) @ amplitude[1]


def room_temperature(rng: np.random.Generator, time_s: Array, least_c: float = 0.15) -> Array:
    """The temperature of a room: anywhere from 15 to 28 °C, swinging by ``least_c`` to 2.5 °C either way in a few slow
    waves."""
    at = time_s / max(float(time_s.max()), 1.0)
    waves = np.asarray(sum(rng.normal() * np.sin(np.pi * k * at + rng.uniform(0, 6.28)) / k for k in range(1, 6)))
    unit = 2.0 * (waves - waves.min()) / max(float(np.ptp(waves)), 1e-300) - 1.0
    return np.asarray(rng.uniform(15, 28) + rng.uniform(least_c, 2.5) * unit)


def visit_order(rng: np.random.Generator, poses: int, repeats: int, order: Order) -> NDArray[np.int64]:
    """Pose index of each visit in time."""
    index = np.arange(poses)
    if order == "planes":
        return np.tile(index, repeats)
    if order == "repeats_together":
        return np.repeat(index, repeats)
    if order == "shuffled":
        return rng.permutation(np.repeat(index, repeats))
    raise ValueError(f"unknown order {order!r}")


def make_plan(
    robot: Robot,
    points: Array,
    repeats: int = 1,
    order: Order = "planes",
    seed: int = 0,
    dwell_s: float = 2.0,
    travel_s: float = 1.0,
) -> dict[str, NDArray[Any]]:
    """Columns of a run in time order, all but the measured x, y, z; poses count from 1.

    Commanded readings are the nominal inverse kinematics. Travel varies by a fifth about
    ``travel_s``. The room warms by 2 degC with a one-hour time constant and wanders by 0.2 degC;
    humidity wanders within 40 to 50 %.
    """
    rng = np.random.default_rng(seed)
    visited = visit_order(rng, len(points), repeats, order)
    n = len(visited)
    by_pose = np.argsort(visited, kind="stable")
    repeat = np.empty(n, int)
    repeat[by_pose] = np.tile(np.arange(1, repeats + 1), len(points))
    time_s = np.concatenate([[0.0], np.cumsum(dwell_s + travel_s * rng.uniform(0.8, 1.2, n - 1))])
    q = inverse_kinematics(robot, points)[visited]
    warming = 2.0 * (1.0 - np.exp(-time_s / 3600.0))
    return {
        "pose": visited + 1,
        "repeat": repeat,
        "time_s": time_s,
        **{f"q{i + 1}_mm": q[:, i] for i in range(3)},
        "temperature_c": 20.0 + warming + 0.2 * smooth_wander(rng, time_s),
        "humidity_pct": 45.0 + 5.0 * np.tanh(smooth_wander(rng, time_s)),
    }


def write_csv(columns: Columns, path: str | Path) -> None:
    """Write the measurement file; ten decimals keep rounding far below any effect."""
    formats = ["%d" if name in ("pose", "repeat") else "%.10f" for name in COLUMN_NAMES]
    table = np.column_stack([columns[name] for name in COLUMN_NAMES])
    np.savetxt(path, table, fmt=formats, delimiter=",", header=",".join(COLUMN_NAMES), comments="")
