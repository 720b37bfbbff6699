"""What a user would do by hand to find a missing effect: refit the model with each candidate by SciPy.

Nine effects act on top of the closed-form NumPy kinematics. Unequal rods and sag have no such form and are left out:
who must write them first needs more than an afternoon.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from numpy_delta import forward, forward_plain
from scipy.optimize import least_squares

import sherkit as sk

Floats = NDArray[np.float64]
FREE = np.array([6 * limb + k for limb in range(3) for k in range(4)])


def candidates(robot: sk.delta.Delta, data: sk.Measurements) -> dict[str, tuple[int, Callable[[Floats], Floats]]]:
    """Each effect: how many parameters, and predicted readings (n, 3) for geometry, shifts and effect."""
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

    def leaning(p: Floats) -> Floats:
        full = robot.geometry.copy()
        full[FREE] += p[:12]
        return forward_plain(full, q, p[15:].reshape(3, 2) * (q - home)[:, :, None]) + offset + p[12:15]

    return {
        "joint_scale": (3, lambda p: point(p, q + p[15:] * (q - home)) + p[12:15]),
        "encoder_cyclic": (
            6,
            lambda p: point(p, q + p[15::2] * np.sin(wave * q) + p[16::2] * np.cos(wave * q)) + p[12:15],
        ),
        "backlash": (3, lambda p: point(p, q + p[15:] * half_way) + p[12:15]),
        "rail_lean": (6, leaning),
        "thermal_growth": (1, lambda p: point(p, q) * (1 + p[15] * warm) + p[12:15]),
        "drift": (3, lambda p: point(p, q) + p[15:] * hours + p[12:15]),
        "slip": (3, lambda p: point(p, q) + p[15:] * late + p[12:15]),
        "beam_alignment": (9, lambda p: point(p, q) @ (np.eye(3) + p[15:].reshape(3, 3)).T + p[12:15]),
        "sensor_linearity": (3, lambda p: (x := point(p, q) + p[12:15]) + p[15:] * (x / 20.0) ** 3),
    }


def refit_all(robot: sk.delta.Delta, data: sk.Measurements) -> dict[str, float]:
    """RMS (µm) that each candidate leaves after its own least-squares fit."""
    measured = data.readings[:, :3]
    out = {}
    for name, (count, predict) in candidates(robot, data).items():
        fit = least_squares(lambda p, f=predict: (measured - f(p)).ravel(), np.zeros(15 + count), method="lm")
        out[name] = float(1e3 * np.sqrt(np.mean(fit.fun**2)))
    return out
