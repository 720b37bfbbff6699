"""The diagnosis that a user could write in an afternoon: the fit linearised with derivatives by hand, each candidate
tested by what it explains beyond the fit, and the largest of them under 199 random signs of the poses."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from numpy_delta import FREE, derivatives, designed, gauss_newton

import sherkit as sk

Floats = NDArray[np.float64]
FLIPS = 199


def columns(robot: sk.delta.Delta, data: sk.Measurements) -> tuple[Floats, Floats, dict[str, Floats]]:
    """Residual (n, 3) of the plain fit, its derivatives (n, 3, 18), and those by each candidate."""
    q, offset = data.joints, np.array(robot.target_offset_mm)
    values = gauss_newton(robot.geometry, q, data.readings[:, :3], offset)[0]
    full = robot.geometry.copy()
    full[FREE] += values[:12]
    _, _, by_end = derivatives(full, q)
    point, plain = designed(robot.geometry, q, offset, values)
    n = len(q)
    eye = np.broadcast_to(np.eye(3), (n, 3, 3))
    by_joint, home = by_end[..., 2], robot.inverse([0.0, 0.0, 0.0])
    time, wave = np.asarray(data.time_s), 2 * np.pi * q / (robot.pole_pitch_mm or 2.0)
    warm = data.covariates["temperature_c"] - 20.0
    late = (time >= np.median(time)).astype(float)
    candidates = {
        "joint_scale": by_joint * (q - home)[:, None],
        "encoder_cyclic": np.concatenate([by_joint * np.sin(wave)[:, None], by_joint * np.cos(wave)[:, None]], axis=2),
        "backlash": by_joint * 0.5 * data.direction[:, None],
        "rail_lean": (by_end[..., :2] * (q - home)[:, None, :, None]).reshape(n, 3, 6),
        "thermal_growth": (point * warm[:, None])[:, :, None],
        "drift": eye * (time / 3600)[:, None, None],
        "slip": eye * late[:, None, None],
        "beam_alignment": (eye[:, :, :, None] * point[:, None, None, :]).reshape(n, 3, 9),
        "sensor_linearity": eye * ((data.readings[:, :3] / 20.0) ** 3)[:, None],
    }
    return data.readings[:, :3] - point, plain, candidates


def diagnose(robot: sk.delta.Delta, data: sk.Measurements) -> tuple[str, float]:
    """The candidate that explains most, and the share of the random signs under which some candidate does as well."""
    left, plain, candidates = columns(robot, data)
    size = 3 * len(data)
    design = plain.reshape(size, -1)
    u, s, _ = np.linalg.svd(design / np.linalg.norm(design, axis=0), full_matrices=False)
    fitted = u[:, s > 1e-10 * s[0]]
    r = left.ravel() - fitted @ (fitted.T @ left.ravel())
    pose = np.unique(data.groups, return_inverse=True)[1]
    signs = np.random.default_rng(0).choice([-1.0, 1.0], (int(pose.max()) + 1, FLIPS))
    flipped = np.column_stack([r, (r.reshape(-1, 3, 1) * signs[pose][:, None]).reshape(size, FLIPS)])
    gains = {}
    for name, by in candidates.items():
        beyond = by.reshape(size, -1)
        beyond = beyond - fitted @ (fitted.T @ beyond)
        basis, _ = np.linalg.qr(beyond / np.linalg.norm(beyond, axis=0))
        share = np.square(basis.T @ flipped).sum(axis=0) / np.square(flipped).sum(axis=0)
        # what is gained in the logarithm of the likelihood, less what as many numbers gain by chance
        gains[name] = -size * np.log1p(-share) - basis.shape[1] * np.log(size)
    best = max(gains, key=lambda name: gains[name][0])
    largest = np.max(np.stack(list(gains.values())), axis=0)
    return best, float((1 + (largest[1:] >= largest[0]).sum()) / (1 + FLIPS))
