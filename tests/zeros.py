"""Runs of a delta whose measured point is counted from anywhere, within 50 mm, seen from anywhere, in any room: all
drawn."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import polars as pl

import sherkit as sk
from second_simulator import (
    Noise,
    Robot,
    draw_geometric_errors,
    draw_pose,
    draw_zeros,
    grid,
    make_plan,
    room_temperature,
    scaled_effect,
    simulate,
)
from strategies import EXAMPLE

NOISE_UM = 5.0
GRID = grid(20.0, 10, (-20.0, 0.0, 20.0))


def counted_from_anywhere(seed: int, scaled: Mapping[str, float]) -> tuple[sk.delta.Delta, sk.Measurements]:
    """The robot as its file has it, and a run: of each effect a geometric fit leaves that many times the noise."""
    real, points = draw_zeros(np.random.default_rng([seed, 4]), Robot.from_dict(), GRID)
    plan = make_plan(real, points, repeats=2, order="shuffled", seed=seed)
    # a part of which so much shows in a steady room would have grown out of reach
    plan["temperature_c"] = room_temperature(np.random.default_rng([seed, 5]), plan["time_s"], least_c=1.0)
    errors = draw_geometric_errors(np.random.default_rng([seed, 1]))
    stands = {"sensor_pose": draw_pose(np.random.default_rng([seed, 8]))}
    planted: dict[str, Any] = dict(stands)
    for k, (name, ratio) in enumerate(scaled.items()):
        rng = np.random.default_rng([seed, 2, k])
        planted |= scaled_effect(real, plan, name, rng, 1e-3 * NOISE_UM * ratio, errors=errors, beside=stands)
    columns = simulate(real, plan, errors, planted, noise=Noise(sigma_mm=1e-3 * NOISE_UM), seed=1000 + seed)
    # the workspace of the file is where the platform was, whatever hangs from it
    x, y, z = points.T
    robot = replace(
        EXAMPLE, target_offset_mm=tuple(real.target_offset.tolist()), region_half_width_mm=None,
        workspace_radius_mm=float(np.hypot(x, y).max()), workspace_z_mm=(float(z.min()), float(z.max())),
    )  # fmt: skip
    return robot, sk.from_frame(pl.DataFrame(columns))
