"""A sensor of which it is known where it stands, and readings that agree with that, or contradict it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import ArrayLike
from scipy import stats

import sherkit as sk
from running import slow
from sherkit.fit.known_stand import KnownStand, known_stand
from sherkit.robots.delta import VirtualDelta, paper_whole
from strategies import EXAMPLE
from test_spherical_discovery import ROBOT, measured

#: What is known of where a camera stands: 0.1° and 1 mm.
KNOWN = np.array([np.deg2rad(0.1)] * 3 + [1.0] * 3)


def stand_of(where: str, seed: int, off: ArrayLike) -> KnownStand:
    """How far a camera, that is off by so many deviations (6,), is found from where it is known to stand."""
    run = measured(where, seed, {"sensor_pose": np.asarray(off) * KNOWN}, repeats=1)
    found = known_stand(sk.identify(ROBOT, run.data))
    assert found is not None
    return found


@pytest.mark.parametrize("where", [*slow("whole"), "small"])
def test_a_camera_that_stands_as_well_as_is_known_is_not_told_of(where: str) -> None:
    """Catches a p value that is too small, by directions that no picture tells counted as told or by the fit's pull to
    what is known: of 40 cameras drawn as is known it is uniform (level 1 in 1000), and none is at 1 in 10 000."""
    p = [stand_of(where, seed, np.random.default_rng([seed, 8]).normal(size=6)).p for seed in range(40)]
    assert min(p) > 1e-4
    assert stats.kstest(p, "uniform").pvalue > 1e-3
    assert min(stand_of(where, k, 3.0 * np.eye(6)[k]).p for k in range(6)) > 1e-2


def test_a_camera_that_stands_elsewhere_is_told_of() -> None:
    """Catches a prior that readings contradict and nobody hears of; along the view no picture tells a camera that is
    farther from a larger sphere."""
    for k in range(5):
        assert stand_of("whole", 0, 11.0 * np.eye(6)[k]).p < 1e-12
    assert stand_of("whole", 0, 11.0 * np.eye(6)[5]).p > 0.1
    assert "11 mm and 0.01° from where the robot's file has it, known within ± 1 mm and ± 0.1°" in str(
        stand_of("whole", 0, 11.0 * np.eye(6)[3])
    )


def test_only_what_is_known_of_a_pose_is_asked() -> None:
    """Catches a tracker that may stand anywhere, and is told that it stands elsewhere; and a shift of which nothing is
    known beside a turn that is. The readings are along the robot's own axes, its file says 1° off."""
    run = VirtualDelta.draw(EXAMPLE, 1, noise_mm=0.005).measure(paper_whole()[::4], repeats=2, seed=1)

    def asked(**sd: float) -> KnownStand | None:
        pose = sk.SensorPose(rpy_deg=(1.0, 0.0, 0.0), **sd)
        return known_stand(sk.identify(replace(EXAMPLE, sensor_pose=pose), run))

    assert asked() is None
    assert asked(turn_sd_deg=0.0) is None
    told = asked(turn_sd_deg=0.1)
    assert told is not None
    assert told.p < 1e-12
    assert str(told) == "1° from where the robot's file has it, known within ± 0.1°"
