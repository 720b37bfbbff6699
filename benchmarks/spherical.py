"""Speed of the spherical robot and its camera, against NumPy and OpenCV. Part of ``make bench``."""

from __future__ import annotations

import cv2
import numpy as np
from numpy_spherical import forward, forward_of_cones, inverse
from timing import medians, show

import sherkit as sk

POSES = 1_000_000
ARC = np.pi / 4


def kinematics() -> None:
    """Forward and inverse, closed form and general mechanism."""
    robot = sk.spherical.Spherical(45.0, 45.0, 200.0)
    core = robot.kinematics()
    rng = np.random.default_rng(0)
    mean, half = rng.uniform(0.5, 2.5, POSES), rng.uniform(0.3, 1.2, POSES)
    q = np.ascontiguousarray(np.stack([mean + half, mean - half], axis=1))
    x = core.forward_batch(q)[0]
    assert np.abs(forward(ARC, ARC, q) - x).max() < 1e-9
    assert np.abs(forward_of_cones((ARC, ARC), (ARC, ARC), q) - x).max() < 1e-6
    assert np.abs(inverse(ARC, ARC, x) - q).max() < 1e-6
    times = medians(
        {
            "sherkit forward_batch (any two limbs)": lambda: core.forward_batch(q),
            "vectorised NumPy, two equal limbs (Eqs. 34, 35)": lambda: forward(ARC, ARC, q),
            "vectorised NumPy, any two limbs": lambda: forward_of_cones((ARC, ARC), (ARC, ARC), q),
        },
        9,
    )
    show(f"Spherical robot, forward kinematics of {POSES:,} poses", "≥ 30 × NumPy", next(iter(times)), times)
    times = medians(
        {
            "sherkit inverse_batch (any two limbs)": lambda: core.inverse_batch(x),
            "vectorised NumPy, two equal limbs": lambda: inverse(ARC, ARC, x),
        },
        9,
    )
    show(f"Spherical robot, inverse kinematics of {POSES:,} poses", "≥ 30 × NumPy", next(iter(times)), times)


def projection() -> None:
    """Points into pixels through a distorted lens."""
    view = sk.spherical.CameraView.facing(
        np.pi / 2, np.pi / 4, 446.2, size_px=(1280, 640), focal_px=(1027.0, 1027.0),
        distortion=(-0.12, 0.05, 0.001, -0.002, 0.005),
    )  # fmt: skip
    points = np.ascontiguousarray(np.random.default_rng(1).uniform(-150, 150, (POSES, 3)))
    (fx, fy), (cx, cy) = view.focal_px, view.centre_px
    matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])
    turn, shift, lens = (np.array(v) for v in (view.rotation_rad, view.translation_mm, view.distortion))

    def opencv() -> np.ndarray:
        return np.asarray(cv2.projectPoints(points, turn, shift, matrix, lens)[0][:, 0])

    assert np.abs(opencv() - view.core.project_batch(points)[0]).max() < 1e-8
    times = medians(
        {"sherkit project_batch": lambda: view.core.project_batch(points), "cv2.projectPoints": opencv}, 9
    )  # fmt: skip
    show(f"Projection of {POSES:,} points", "no slower than OpenCV", "sherkit project_batch", times)


if __name__ == "__main__":
    kinematics()
    projection()
