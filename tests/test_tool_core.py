"""The compiled flexible tool: shapes, a second way to its numbers in NumPy, one step against a whole run, bad input."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from plain_tool import plain_filter
from sherkit import _core
from sherkit.errors import RobotError, ShapeError

Floats = NDArray[np.float64]

GAINS = np.array([[[8.0, -4.0, -4.0], [0.5, 6.5, -7.0]], [[9.0, -4.4, -4.6], [-0.3, 7.0, -6.7]]]) * 1e3
DISTANCES = np.array([28.0, 34.0])
REFERENCE = np.linspace(1530.0, 1560.0, 9)
NOISE_NM = 2e-4
LENGTH, STIFFNESS = 60.0, 3.39e6 / 3.0
BEAM = _core.ToolBeam(LENGTH, STIFFNESS)
SENSOR = _core.ToolSensor(GAINS, DISTANCES, REFERENCE, NOISE_NM, BEAM)
COUNTED = ("updated", "missing", "late", "not_finite", "no_force", "no_motion", "clock")


def wavelengths(forces: Floats, depths: Floats, common: float | Floats = 0.0) -> Floats:
    """What the fibres show of forces at depths: least wavelength differences that give the moments."""
    out = np.tile(REFERENCE, (len(forces), 1))
    for section in range(2):
        moments = forces * (DISTANCES[section] - depths)[:, None]
        out[:, 3 * section : 3 * section + 3] += moments @ np.linalg.pinv(GAINS[section]).T
    return out + np.reshape(common, (-1, 1))


def rotations(angles: Floats) -> Floats:
    c, s, zero, one = np.cos(angles), np.sin(angles), np.zeros_like(angles), np.ones_like(angles)
    about_x = np.stack([one, zero, zero, zero, c, -s, zero, s, c], axis=1).reshape(-1, 3, 3)
    about_z = np.stack([c, -s, zero, s, c, zero, zero, zero, one], axis=1).reshape(-1, 3, 3)
    return about_x @ about_z


def recorded(n: int, seed: int = 3) -> dict[str, Any]:
    """A run in which the force comes and goes, readings drop out, come late, or are not finite."""
    rng = np.random.default_rng(seed)
    times = 0.005 * np.arange(1, n + 1)
    depths = 10.0 + 5.0 * np.sin(2.0 * times)
    forces = np.outer(120.0 * np.maximum(0.0, np.sin(3.0 * times)), [0.6, -0.8])
    w = wavelengths(forces, depths, 0.01 * np.sin(times)) + NOISE_NM * rng.normal(size=(n, 9))
    stamps = np.where(rng.random(n) < 0.02, times - 0.02, times)
    w[rng.random(n) < 0.02] = np.nan
    turned = rotations(0.3 + 0.2 * np.sin(times))
    shifts = np.stack([np.sin(times), np.cos(times), depths], axis=1)
    shifts[rng.random(n) < 0.01] = np.inf
    return {
        "times": times, "poses": np.ascontiguousarray(np.hstack([turned.reshape(n, 9), shifts])), "stamps": stamps,
        "wavelengths": w, "present": rng.random(n) > 0.1,
    }  # fmt: skip


def filters(pose: Floats) -> dict[str, Any]:
    """Both filters at their start."""
    start = (8.0, 4.0, 0.0)
    doubts = (0.1, 0.005, 0.002, 1e-4, 0.003, 0.02, 0.02, 1.0)
    none = np.zeros((2, 2))
    return {
        "rod": _core.ToolFilter(
            SENSOR, none, np.zeros((2, 3)), 1e-3 * np.eye(3), none, doubts, 0.5, 0.004, start, pose,
        ),
        "paper": _core.PaperFilter(SENSOR, start, pose),
    }  # fmt: skip


def test_fibres_tell_force_and_depth_as_numpy_says() -> None:
    """Catches a section or fibre in the wrong place, a common mode that gets through, a covariance of wrong sign."""
    rng = np.random.default_rng(1)
    forces, depths = rng.normal(size=(50, 2)) * 80.0, rng.uniform(0, 20, 50)
    w = wavelengths(forces, depths, rng.normal(size=50) * 0.3)
    times = np.arange(50.0)
    measured, moments, misfit, common, codes = SENSOR.measure_batch(times, w)
    np.testing.assert_array_equal(measured[:, 0], times)
    np.testing.assert_allclose(measured[:, 1:3], forces, atol=1e-6)
    clear = codes == 0
    assert clear.sum() > 40
    np.testing.assert_allclose(measured[clear, 7], depths[clear], atol=1e-6)
    np.testing.assert_allclose(
        moments, forces[:, None, :] * (DISTANCES[:, None] - depths[:, None, None]).reshape(50, 2, 1)
    )
    np.testing.assert_allclose(common, (w - REFERENCE).reshape(50, 3, 3).mean(axis=2), atol=1e-12)
    assert misfit.max() < 1e-9
    # the covariance from numerical derivatives of the very numbers
    i = int(np.argmax(np.linalg.norm(forces, axis=1)))
    step = 1e-6
    plus, minus = (SENSOR.measure_batch(np.zeros(9), w[i] + s * step * np.eye(9))[0] for s in (1, -1))
    by = ((plus - minus) / (2 * step))[:, [1, 2, 7]].T
    p = by @ by.T * NOISE_NM**2
    np.testing.assert_allclose(measured[i, 3:7].reshape(2, 2), p[:2, :2], rtol=1e-5)
    np.testing.assert_allclose(measured[i, 9:11], p[:2, 2], rtol=1e-4)
    assert p[2, 2] < measured[i, 8] < 1.1 * p[2, 2]


def test_rows_without_force_and_rows_that_are_not_finite_are_marked() -> None:
    """Catches a wild depth that passes for one, and a NaN row that spoils its neighbours."""
    w = wavelengths(np.array([[100.0, 0.0], [0.0, 0.0], [0.0, 90.0], [50.0, 50.0]]), np.full(4, 5.0))
    w[2, 4] = np.nan
    w[3, 8] = np.nan  # section III, which tells nothing
    measured, moments, misfit, _, codes = SENSOR.measure_batch(np.arange(4.0), w)
    assert codes.tolist() == [0, 1, 2, 0]
    assert measured[1, 8] == np.inf
    assert measured[2, 0] == 2.0
    assert np.isnan(measured[2, 1:]).all()
    assert np.isnan(moments[2]).all()
    assert np.isnan(misfit[2])


def test_the_tip_is_that_of_the_bent_beam_in_the_base() -> None:
    """Catches x and y swapped, and a pose read by columns; Eq. 9 itself is tested in Rust."""
    run = recorded(40)
    poses = run["poses"][np.isfinite(run["poses"]).all(axis=1)]
    forces, depths = np.tile([60.0, -25.0], (len(poses), 1)), np.linspace(0.0, 30.0, len(poses))
    arc = LENGTH - depths
    bent = np.zeros((len(poses), 3))
    bent[:, :2] = forces * (arc**2 * (2 * arc + 3 * depths) / (6 * STIFFNESS))[:, None]
    turned = np.einsum("nij,nj->ni", poses[:, :9].reshape(-1, 3, 3), bent)
    np.testing.assert_allclose(BEAM.tip_batch(forces, depths, poses), turned + poses[:, 9:], atol=1e-12)


@pytest.mark.parametrize("name", ["rod", "paper"])
def test_steps_and_a_whole_run_agree_to_the_last_bit(name: str) -> None:
    """Catches a row that is read differently by the two, a status or a NIS of the wrong step, a lost reading."""
    run = recorded(600)
    filter_ = filters(run["poses"][0])[name]
    single = filter_.copy()
    told = filter_.run(run["times"], run["poses"], run["stamps"], run["wavelengths"], run["present"])
    for i, t in enumerate(run["times"]):
        reading = (run["stamps"][i], run["wavelengths"][i]) if run["present"][i] else ()
        assert single.step(t, run["poses"][i], *reading) == told["status"][i]
        last = single.statistics()
        assert (last["nis_last"], last["nis_last_degrees"]) == (told["nis"][i], told["degrees"][i])
        np.testing.assert_array_equal(
            [single.depth_mm, *single.tip_mm, single.arc_mm], [*told["state"][i], told["arc_mm"][i]]
        )
        np.testing.assert_array_equal(single.covariance, told["covariance"][i])
    assert single.statistics() == filter_.statistics()
    assert single.time_s == filter_.time_s == run["times"][-1]
    flags = {flag: getattr(_core, f"STATUS_{flag.upper()}") for flag in COUNTED}
    counted = {flag: int(((told["status"] & bit) != 0).sum()) for flag, bit in flags.items()}
    assert counted == {flag: filter_.statistics()[flag] for flag in COUNTED}
    assert all(counted[flag] > 0 for flag in ("updated", "missing", "no_motion"))
    assert counted["late"] > 0 or name == "paper"
    assert np.isfinite(told["state"]).all()
    assert np.isfinite(told["covariance"]).all()


def test_the_paper_s_filter_is_the_plain_one() -> None:
    """Catches a process noise per second taken per step, a gain that is not Eq. 7's, a tip whose exact line is lost."""
    run = recorded(800)
    poses = run["poses"]
    still = ~np.isfinite(poses).all(axis=1)
    poses[still] = poses[np.maximum.accumulate(np.where(still, 0, np.arange(800)))[still]]
    waves = np.where(run["present"][:, None], run["wavelengths"], np.nan)
    told = filters(poses[0])["paper"].run(run["times"], poses, run["times"], run["wavelengths"], run["present"])
    plain = plain_filter(
        GAINS, DISTANCES, LENGTH, STIFFNESS, REFERENCE, poses[:, :9].reshape(-1, 3, 3), poses[:, 9:], waves, 8.0, 4.0
    )
    np.testing.assert_allclose(told["state"][:, 0], plain.depth_mm, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(told["covariance"][:, 0, 0], plain.variance, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(told["state"][:, 1:], plain.tip_mm, rtol=1e-9, atol=1e-9)
    spread = np.einsum("nii->ni", told["covariance"])[:, 1:]
    np.testing.assert_allclose(spread, plain.tip_variance, rtol=1e-8, atol=1e-11)


@pytest.mark.parametrize("method", ["quaternion", "svd"])
def test_registration_is_the_orthogonal_procrustes(method: str) -> None:
    """Catches the inverse transform, a reflection, a covariance in another order than is said."""
    rng = np.random.default_rng(2)
    source = rng.normal(size=(40, 3)) * [10, 20, 30] + [100, 0, -50]
    rotation = rotations(np.array([0.7]))[0]
    target = source @ rotation.T + [1.0, -2.0, 3.0] + 0.05 * rng.normal(size=(40, 3))
    target[4] = np.nan
    found = _core.register_points(source, target, method)
    assert not found["used"][4]
    a, b = np.delete(source, 4, 0), np.delete(target, 4, 0)
    u, _, vt = np.linalg.svd((a - a.mean(0)).T @ (b - b.mean(0)))
    expected = vt.T @ np.diag([1, 1, np.linalg.det(vt.T @ u.T)]) @ u.T
    np.testing.assert_allclose(found["rotation"], expected, atol=1e-12)
    np.testing.assert_allclose(found["translation_mm"], b.mean(0) - expected @ a.mean(0), atol=1e-10)
    left = np.delete(found["residuals_mm"], 4, 0)
    np.testing.assert_allclose(found["residual_variance"], (left**2).sum() / (3 * 39 - 6), rtol=1e-6)
    # the normal matrix, from how points move with a small turn after the transform's own, and a shift
    moved = a @ expected.T
    zero = np.zeros(39)
    x, y, z = moved.T
    turn = np.stack([np.stack([zero, z, -y]), np.stack([-z, zero, x]), np.stack([y, -x, zero])]).transpose(2, 0, 1)
    design = np.concatenate([turn, np.broadcast_to(np.eye(3), (39, 3, 3))], axis=2).reshape(-1, 6)
    np.testing.assert_allclose(found["unit_covariance"], np.linalg.inv(design.T @ design), rtol=1e-6, atol=1e-12)


def test_what_makes_no_sense_is_refused_in_words() -> None:
    """Catches a panic, and an error of the wrong kind."""
    line = np.outer(np.arange(5.0), [1.0, 2.0, 3.0])
    with pytest.raises(ShapeError, match="'quaternion' or 'svd'"):
        _core.register_points(line, line, "best")
    with pytest.raises(ShapeError, match="target"):
        _core.register_points(line, line[:4])
    with pytest.raises(RobotError, match="positive"):
        _core.ToolBeam(0.0, 1e6)
    with pytest.raises(RobotError, match="section II above"):
        _core.ToolSensor(GAINS, DISTANCES[::-1].copy(), REFERENCE, NOISE_NM, BEAM)
    with pytest.raises(ShapeError, match="gains"):
        _core.ToolSensor(GAINS.reshape(2, 3, 2), DISTANCES, REFERENCE, NOISE_NM, BEAM)
    run = recorded(10)
    with pytest.raises(RobotError, match="finite"):
        _core.PaperFilter(SENSOR, (np.nan, 1.0, 0.0), run["poses"][0])
    for filter_ in filters(run["poses"][0]).values():
        before = filter_.statistics()
        with pytest.raises(ShapeError, match="wavelengths"):
            filter_.step(0.1, run["poses"][0], 0.1, np.zeros(10))
        with pytest.raises(ShapeError, match="present"):
            filter_.run(run["times"], run["poses"], run["stamps"], run["wavelengths"], np.ones(9, dtype=bool))
        with pytest.raises(ShapeError, match="poses"):
            filter_.run(run["times"], run["poses"][:9], run["stamps"], run["wavelengths"], run["present"])
        assert filter_.statistics() == before


def test_a_run_of_no_steps_and_a_clock_that_stands_or_runs_back() -> None:
    """Catches a division by no steps, and a state that a wrong clock moves."""
    poses = recorded(4)["poses"][[0, 0, 0, 0]]
    none = np.zeros(4, dtype=bool)
    for filter_ in filters(poses[0]).values():
        empty = filter_.run(np.zeros(0), np.zeros((0, 12)), np.zeros(0), np.zeros((0, 9)), none[:0])
        assert empty["state"].shape == (0, 4)
        assert empty["covariance"].shape == (0, 4, 4)
        times = np.array([0.1, 0.05, np.nan, 0.1])
        status = filter_.run(times, poses, times, np.full((4, 9), np.nan), none)["status"]
        missing, clock = _core.STATUS_MISSING, _core.STATUS_CLOCK
        assert status.tolist() == [missing, clock, clock, missing]
        assert filter_.depth_mm == pytest.approx(8.0)
        assert filter_.time_s == 0.1
