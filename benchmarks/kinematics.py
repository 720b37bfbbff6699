"""Speed of the robots' kinematics and of the camera, against NumPy, numba and OpenCV."""

from __future__ import annotations

import cv2
import numpy as np
import numpy_delta
import numpy_spherical
from timing import Bench

import sherkit as sk
from sherkit.cli.demo import EXAMPLE as ROBOT

try:
    import numba_peers
except ModuleNotFoundError:
    numba_peers = None  # type: ignore[assignment]
POSES = 1_000_000
ARC = np.pi / 4


def delta(bench: Bench) -> None:
    """Forward kinematics of the linear delta."""
    q = np.random.default_rng(0).uniform(118, 140, (POSES, 3))
    kin = ROBOT.kinematics()
    p, x = ROBOT.geometry, kin.forward_batch(q)[0]
    runs = {
        "sherkit": lambda: kin.forward_batch(q),
        "NumPy as usually written": lambda: numpy_delta.forward_plain(p, q),
        "NumPy, algebra by hand": lambda: numpy_delta.forward(p, q),
        "a copy of the numbers": lambda: q.copy(),
    }
    checked = [numpy_delta.forward_plain(p, q), numpy_delta.forward(p, q)]
    if numba_peers:
        runs["numba"] = lambda: numba_peers.delta_forward(p, q)
        checked.append(numba_peers.delta_forward(p, q))
    assert all(np.abs(other - x).max() < 1e-10 for other in checked)
    bench.compare(f"delta, forward, {POSES:,} poses", runs, goal="6 ms, 2 × numba")


def spherical(bench: Bench) -> None:
    """Forward and inverse kinematics of the spherical robot."""
    core = sk.spherical.Spherical(45.0, 45.0, 200.0).kinematics()
    rng = np.random.default_rng(0)
    mean, half = rng.uniform(0.5, 2.5, POSES), rng.uniform(0.3, 1.2, POSES)
    q = np.ascontiguousarray(np.stack([mean + half, mean - half], axis=1))
    x = core.forward_batch(q)[0]
    assert np.abs(numpy_spherical.forward(ARC, ARC, q) - x).max() < 1e-9
    assert np.abs(numpy_spherical.forward_of_cones((ARC, ARC), (ARC, ARC), q) - x).max() < 1e-6
    assert np.abs(numpy_spherical.inverse(ARC, ARC, x) - q).max() < 1e-6
    forward = {
        "sherkit": lambda: core.forward_batch(q),
        "NumPy, two equal limbs (Eqs. 34, 35)": lambda: numpy_spherical.forward(ARC, ARC, q),
        "NumPy, any two limbs": lambda: numpy_spherical.forward_of_cones((ARC, ARC), (ARC, ARC), q),
    }
    inverse = {
        "sherkit": lambda: core.inverse_batch(x),
        "NumPy, two equal limbs": lambda: numpy_spherical.inverse(ARC, ARC, x),
    }
    if numba_peers:
        assert np.abs(numba_peers.spherical_forward(ARC, ARC, q) - x).max() < 1e-9
        assert np.abs(numba_peers.spherical_inverse(ARC, ARC, x) - q).max() < 1e-6
        forward["numba, two equal limbs"] = lambda: numba_peers.spherical_forward(ARC, ARC, q)
        inverse["numba, two equal limbs"] = lambda: numba_peers.spherical_inverse(ARC, ARC, x)
    bench.compare(f"spherical robot, any two limbs, forward, {POSES:,} poses", forward)
    bench.compare("the same, inverse", inverse)


def projection(bench: Bench) -> None:
    """Points into pixels through a distorted lens. OpenCV's Python function cannot leave its derivatives out."""
    view = sk.spherical.CameraView.facing(
        np.pi / 2, np.pi / 4, 446.2, size_px=(1280, 640), focal_px=(1027.0, 1027.0),
        distortion=(-0.12, 0.05, 0.001, -0.002, 0.005),
    )  # fmt: skip
    points = np.ascontiguousarray(np.random.default_rng(1).uniform(-150, 150, (POSES, 3)))
    (fx, fy), (cx, cy) = view.focal_px, view.centre_px
    matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])
    turn, shift, lens = (np.array(v) for v in (view.rotation_rad, view.translation_mm, view.distortion))
    rotation = cv2.Rodrigues(turn)[0]

    def opencv() -> np.ndarray:
        return np.asarray(cv2.projectPoints(points, turn, shift, matrix, lens)[0][:, 0])

    def numpy() -> np.ndarray:
        seen = points @ rotation.T + shift
        x, y = seen[:, 0] / seen[:, 2], seen[:, 1] / seen[:, 2]
        r = x * x + y * y
        k1, k2, p1, p2, k3 = lens
        radial = 1 + r * (k1 + r * (k2 + r * k3))
        u = x * radial + 2 * p1 * x * y + p2 * (r + 2 * x * x)
        v = y * radial + p1 * (r + 2 * y * y) + 2 * p2 * x * y
        return np.stack([fx * u + cx, fy * v + cy], axis=1)

    runs = {
        "sherkit": lambda: view.core.project_batch(points),
        "NumPy": numpy,
        "cv2.projectPoints, which computes its derivatives too": opencv,
    }
    if numba_peers:
        runs["numba"] = lambda: numba_peers.project(points, rotation, shift, matrix, lens)
    pixels = view.core.project_batch(points)[0]
    for name, run in runs.items():
        assert name == "sherkit" or np.abs(run() - pixels).max() < 1e-8
    bench.compare(f"projection of {POSES:,} points", runs)
