"""What a user would do by hand to find a missing effect: refit the model with each candidate by SciPy.

Eight effects act on top of the closed-form NumPy kinematics. Leaning rails, unequal rods and sag have no such form;
their model is the tests' second simulator, which solves the rods by Newton's method in NumPy.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from numpy_delta import forward
from scipy.optimize import least_squares

import sherkit as sk

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
import second_simulator as simulator

Floats = NDArray[np.float64]
FREE = np.array([6 * limb + k for limb in range(3) for k in range(4)])
NAMES = [f"{name}_{limb}" for limb in (1, 2, 3) for name in ("base_radius", "base_angle", "joint_offset", "rod_length")]


def candidates(robot: sk.delta.Delta, data: sk.Measurements) -> dict[str, tuple[int, Callable[[Floats], Floats]]]:
    """Each effect: how many parameters, and predicted readings (n, 3) for geometry, datum and effect."""
    q, offset = data.joints, np.array(robot.target_offset_mm)
    home = robot.inverse([0.0, 0.0, 0.0])
    time = np.asarray(data.time_s)
    hours = time[:, None] / 3600
    warm = data.covariates["temperature_c"][:, None] - 20.0
    half_way = 0.5 * data.direction
    late = (time >= np.median(time)).astype(float)[:, None]
    wave = 2 * np.pi / (robot.pole_pitch_mm or 2.0)

    def point(p: Floats, joints: Floats) -> Floats:
        full = robot.geometry.copy()
        full[FREE] += p[:12]
        return forward(full, joints) + offset

    robot_there = simulator.Robot.from_dict()
    columns = {"time_s": time, **data.covariates}
    columns |= {f"q{k + 1}_mm": q[:, k] for k in range(3)} | {"pose": data.groups, "repeat": np.ones(len(data))}

    def simulated(name: str) -> Callable[[Floats], Floats]:
        def predict(p: Floats) -> Floats:
            errors = dict(zip(NAMES, p[:12], strict=True))
            return simulator.truth(robot_there, columns, errors=errors, effects={name: p[15:]}) + p[12:15]

        return predict

    return {
        "joint_scale": (3, lambda p: point(p, q + p[15:] * (q - home)) + p[12:15]),
        "encoder_cyclic": (
            6,
            lambda p: point(p, q + p[15::2] * np.sin(wave * q) + p[16::2] * np.cos(wave * q)) + p[12:15],
        ),
        "backlash": (3, lambda p: point(p, q + p[15:] * half_way) + p[12:15]),
        "rail_lean": (6, simulated("rail_lean")),
        "rod_mismatch": (3, simulated("rod_mismatch")),
        "gravity_sag": (3, simulated("gravity_sag")),
        "thermal_growth": (1, lambda p: point(p, q) * (1 + p[15] * warm) + p[12:15]),
        "drift": (3, lambda p: point(p, q) + p[15:] * hours + p[12:15]),
        "slip": (3, lambda p: point(p, q) + p[15:] * late + p[12:15]),
        "beam_alignment": (9, lambda p: point(p, q) @ (np.eye(3) + p[15:].reshape(3, 3)).T + p[12:15]),
        "sensor_linearity": (3, lambda p: (x := point(p, q)) + p[15:] * (x / 20.0) ** 3 + p[12:15]),
    }


def refit_all(robot: sk.delta.Delta, data: sk.Measurements) -> dict[str, float]:
    """RMS (µm) that each candidate leaves after its own least-squares fit."""
    measured = data.readings[:, :3]
    out = {}
    for name, (count, predict) in candidates(robot, data).items():
        fit = least_squares(lambda p, f=predict: (measured - f(p)).ravel(), np.zeros(15 + count), method="lm")
        out[name] = float(1e3 * np.sqrt(np.mean(fit.fun**2)))
    return out
