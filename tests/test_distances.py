"""How far two centres are from one another is known: lengths are no longer open by one factor."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import sherkit as sk
from sherkit.model.kinds import robot_from_tables
from sherkit.robots.serial.imported import import_dh

Floats = NDArray[np.float64]

_A, _D = np.array([0.0, -425.0, -392.25, 0.0, 0.0, 0.0]), np.array([89.16, 0.0, 0.0, 109.15, 94.65, 202.3])
_ALPHA = np.deg2rad([90.0, 0.0, 0.0, 90.0, -90.0, 0.0])
_ZERO = np.deg2rad([0.0, 0.25, -0.3, 0.2, 0.15, 0.0])
#: The arm is built by so much larger than drawn.
_SCALE = 1.001


def at(q: Floats, point: Floats | tuple[float, ...] = (0.0, 0.0, 0.0)) -> Floats:
    """Where a point of the last frame is (3,), mm, of the arm as it was built."""
    pose = np.eye(4)
    for k in range(6):
        c, s, ca, sa = np.cos(q[k] + _ZERO[k]), np.sin(q[k] + _ZERO[k]), np.cos(_ALPHA[k]), np.sin(_ALPHA[k])
        a, d = _SCALE * _A[k], _SCALE * _D[k]
        pose = pose @ np.array([[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, d], [0, 0, 0, 1]])
    return np.asarray((pose @ [*point, 1.0])[:3])


def drawn(folder: Path, more: dict[str, Any]) -> Any:
    """The arm as drawn, with what stands around it."""
    lines = [f"{d:g},{a:g},{np.rad2deg(alpha):g}" for d, a, alpha in zip(_D, _A, _ALPHA, strict=True)]
    (folder / "dh.csv").write_text("d_mm,a_mm,alpha_deg\n" + "\n".join(lines) + "\n")
    return robot_from_tables(import_dh(folder / "dh.csv").to_tables() | more, "arm")


def into_sockets(centres: Floats, rng: np.random.Generator) -> dict[str, Any]:
    """Twenty postures with the tip in each socket, repeatable to 0.01 mrad."""
    rows: list[list[float]] = []
    for k, goal in enumerate(centres, start=1):
        while sum(row[-1] == k for row in rows) < 20:
            q = np.deg2rad([10.0, -70.0, 100.0, -120.0, -90.0, 0.0]) + rng.normal(0, [0.5, 0.4, 0.4, 0.6, 0.6, 0.8])
            for _ in range(60):
                slope = np.array([(at(q + h) - at(q - h)) / 2e-6 for h in 1e-6 * np.eye(6)]).T
                step = np.linalg.lstsq(slope, goal - at(q), rcond=None)[0]
                q = q + step * min(1.0, 0.5 / max(np.abs(step).max(), 1e-9))
                if np.abs(step).max() < 1e-9:
                    break
            if np.linalg.norm(goal - at(q)) < 1e-6 and np.abs(q).max() < 3.1:
                rows.append([*(q + rng.normal(0, 1e-5, 6)), k])
    table = np.array(rows)[rng.permutation(len(rows))]
    run: dict[str, Any] = {f"joint_{k + 1}_rad": table[:, k] for k in range(6)}
    return run | {"distance_mm": np.full(len(table), 1e-4), "centre": table[:, 6]}


@pytest.mark.slow
def test_a_known_distance_tells_the_size_of_an_arm(tmp_path: Path) -> None:
    """Catches a ``[[distance]]`` that is not used, sockets beyond the fourth, a sentence that lengths are open where
    they are not. Without it the arm is as large as drawn, 0.1 % too small."""
    rng = np.random.default_rng(7)
    centres = np.array([-450.0, -150.0, 150.0]) + rng.uniform(-1, 1, (6, 3)) * [120.0, 200.0, 120.0]
    run = into_sockets(centres, rng)
    there: dict[str, Any] = {"centre": [{"at_mm": (c + rng.normal(0, 2.0, 3)).tolist()} for c in centres]}
    mm = float(np.linalg.norm(centres[4] - centres[1]))
    postures = rng.uniform(-1.0, 1.0, (20, 6)) + np.deg2rad([10.0, -70.0, 100.0, -120.0, -90.0, 0.0])
    moved = np.linalg.norm(np.diff([at(q) for q in postures], axis=0), axis=1)

    known = drawn(tmp_path, there | {"distance": [{"between": [2, 5], "mm": mm, "sd_mm": 0.005}]})
    # a length of nothing has no slope: by it alone the fit went on for a hundred steps and ended nowhere
    fit = sk.identify(known, run)
    assert fit.converged
    assert fit.evaluations < 40
    shown = sk.calibrate(known, run, correction="none").calibration.forward_batch(postures).require()
    factors = np.linalg.norm(np.diff(shown, axis=0), axis=1) / moved
    assert np.median(factors) == pytest.approx(1.0, abs=1e-4)
    assert robot_from_tables(known.to_tables(), "again") == known
    assert not any("one factor" in note for note in sk.diagnose(known, run).notes)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"between": [1, 3], "mm": 5.0}, "there are 2 centres"),
        ({"between": [1, 1], "mm": 5.0}, r"the numbers of two centres, such as \[1, 2\]"),
        ({"between": [1, 2], "mm": -5.0}, "a positive number"),
        ({"between": [1, 2]}, "mm is missing"),
        ({"between": [1, 2], "mm": 5.0, "sd_m": 1.0}, "unknown key"),
    ],
)
def test_what_is_no_distance_is_refused(given: dict[str, Any], said: str, tmp_path: Path) -> None:
    """Catches a distance to a centre that is not there, to itself, of no length."""
    there = {"centre": [{"at_mm": [1.0, 2.0, 3.0]}, {"at_mm": [5.0, 6.0, 7.0]}], "distance": [given]}
    with pytest.raises(sk.SherkitError, match=said):
        drawn(tmp_path, there)
