"""The compiled flexible tool: shapes, a second way to its numbers in NumPy, one step against a whole run, bad input."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from sherkit import _core
from sherkit.errors import FitError, NotFinite, RobotError, ShapeError

Floats = NDArray[np.float64]

GAINS = np.array([[[8.0, -4.0, -4.0], [0.5, 6.5, -7.0]], [[9.0, -4.4, -4.6], [-0.3, 7.0, -6.7]]]) * 1e3
DISTANCES = np.array([28.0, 34.0])
REFERENCE = np.linspace(1530.0, 1560.0, 9)
NOISE_NM = 2e-4
SENSOR = _core.ToolSensor(GAINS, DISTANCES, REFERENCE, NOISE_NM)
BEAM = _core.ToolBeam.ebrahimi_2020()
LENGTH, STIFFNESS = 60.0, 3.39e6 / 3.0
PROPAGATED = _core.FilterNoise.propagated((0.5, 2.0), (1e-3, 1e-4))
PAPER = _core.FilterNoise.ebrahimi_2020()
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
    """A run in which the force comes and goes, measurements drop out, come late, or are not finite."""
    rng = np.random.default_rng(seed)
    times = 0.005 * np.arange(1, n + 1)
    depths = 10.0 + 5.0 * np.sin(2.0 * times)
    forces = np.outer(120.0 * np.maximum(0.0, np.sin(3.0 * times)), [0.6, -0.8])
    w = wavelengths(forces, depths, 0.01 * np.sin(times)) + NOISE_NM * rng.normal(size=(n, 9))
    stamps = np.where(rng.random(n) < 0.02, times - 0.02, times)
    w[rng.random(n) < 0.02] = np.nan
    measurements, _, _, _, codes = SENSOR.measure_batch(stamps, w)
    turned = rotations(0.3 + 0.2 * np.sin(times))
    shifts = np.stack([np.sin(times), np.cos(times), depths], axis=1)
    velocities = rng.normal(size=(n, 3))
    velocities[rng.random(n) < 0.01] = np.inf
    return {
        "times": times,
        "velocities": velocities,
        "poses": np.ascontiguousarray(np.hstack([turned.reshape(n, 9), shifts])),
        "depths": np.stack([depths, np.full(n, 0.01)], axis=1),
        "measurements": measurements,
        "present": rng.random(n) > 0.1,
        "codes": codes,
    }


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
    np.testing.assert_allclose(SENSOR.depth_by_lengths_batch(w)[clear, 1], depths[clear], atol=1e-5)
    # the covariance from numerical derivatives of the very numbers
    i = int(np.argmax(np.linalg.norm(forces, axis=1)))
    step = 1e-6
    plus, minus = (SENSOR.measure_batch(np.zeros(9), w[i] + s * step * np.eye(9))[0] for s in (1, -1))
    by = ((plus - minus) / (2 * step))[:, [1, 2, 7]].T
    p = by @ by.T * NOISE_NM**2
    np.testing.assert_allclose(measured[i, 3:7].reshape(2, 2), p[:2, :2], rtol=1e-5)
    np.testing.assert_allclose(measured[i, 9:11], p[:2, 2], rtol=1e-4)
    assert p[2, 2] < measured[i, 8] < 1.1 * p[2, 2]
    np.testing.assert_array_equal(SENSOR.measure(times[i], w[i]), measured[i])


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
    with pytest.raises(NotFinite, match="component 5"):
        SENSOR.measure(0.0, w[2])


def test_the_beam_bends_as_the_second_integral_of_its_moment() -> None:
    """Catches Eq. 9 mistyped, a derivative of the wrong sign, x and y swapped."""
    depths = np.array([-1.0, 0.0, 7.5, 30.0, 59.0, 60.0, 61.0])
    # curvature F (a - s) / EI up to the contact, integrated twice to the tip
    for d in depths[1:6]:
        s = np.linspace(0, LENGTH, 200_001)
        curvature = np.maximum(0.0, (LENGTH - d) - s) / STIFFNESS
        lever = curvature * (LENGTH - s)
        expected = 0.5 * (lever[1:] + lever[:-1]).sum() * s[1]
        np.testing.assert_allclose(BEAM.compliance_batch(np.array([d]))[0, 0], expected, rtol=1e-7, atol=1e-15)
    forces = np.tile([60.0, -25.0], (7, 1))
    deflections, by = BEAM.deflection_batch(forces, depths)
    assert (deflections[:, 2] == 0).all()
    assert (deflections[0] == deflections[1]).all()
    assert (deflections[5:] == 0).all()

    def difference(plus: Floats, minus: Floats, step: float) -> Floats:
        return (plus - minus)[1:6, :2] / (2 * step)

    inside = slice(2, 5)
    for k, step in enumerate([1e-3, 1e-3]):
        move = step * np.eye(2)[k]
        pair = [BEAM.deflection_batch(forces + s * move, depths)[0] for s in (1, -1)]
        np.testing.assert_allclose(by[1:6, :, k], difference(*pair, step), atol=1e-9)
    pair = [BEAM.deflection_batch(forces, depths + s * 1e-4)[0] for s in (1, -1)]
    np.testing.assert_allclose(by[inside, :, 2], difference(*pair, 1e-4)[1:4], atol=1e-8)
    for column, steps in ((3, (1e-4, 0.0)), (4, (0.0, 1.0))):
        beams = [_core.ToolBeam(LENGTH + s * steps[0], STIFFNESS + s * steps[1]) for s in (1, -1)]
        pair = [b.deflection_batch(forces, depths)[0] for b in beams]
        np.testing.assert_allclose(by[inside, :, column], difference(*pair, max(steps))[1:4], atol=1e-8)
    np.testing.assert_allclose(
        BEAM.contact_compliance_batch(depths[1:6]), (LENGTH - depths[1:6]) ** 3 / (3 * STIFFNESS)
    )


def test_the_tip_and_its_covariance_follow_from_the_measurement() -> None:
    """Catches a pose read by columns, and a covariance that forgets how depth goes with force."""
    run = recorded(40)
    with_force = (run["codes"] == 0) & (run["measurements"][:, 8] < 1)
    m, poses = run["measurements"][with_force], run["poses"][with_force]
    forces, depths = np.ascontiguousarray(m[:, 1:3]), np.ascontiguousarray(m[:, 7])
    tips = BEAM.tip_batch(forces, depths, poses)
    deflections, by = BEAM.deflection_batch(forces, depths)
    turned = np.einsum("nij,nj->ni", poses[:, :9].reshape(-1, 3, 3), deflections)
    np.testing.assert_allclose(tips, turned + poses[:, 9:], atol=1e-12)
    for row, b, found in zip(m, by, BEAM.covariance_batch(m), strict=True):
        p = np.block([[row[3:7].reshape(2, 2), row[9:11, None]], [row[None, 9:11], row[8:9, None]]])
        np.testing.assert_allclose(found, b[:, :3] @ p @ b[:, :3].T, rtol=1e-9)


def filters(noise: _core.FilterNoise, run: dict[str, Any]) -> list[tuple[Any, tuple[Any, ...]]]:
    """Each filter at its start, with the columns that its run takes before the measurements."""
    pose = run["poses"][0]
    along = np.ascontiguousarray(run["velocities"][:, 2])
    return [
        (_core.DepthFilter(8.0, 4.0, 0.0, noise), (along,)),
        (_core.TipFilter(BEAM, pose, 1.0, 0.0, noise), (run["velocities"], run["poses"], run["depths"])),
    ]


@pytest.mark.parametrize("noise", [PAPER, PROPAGATED], ids=["paper", "propagated"])
def test_steps_and_a_whole_run_agree_to_the_last_bit(noise: _core.FilterNoise) -> None:
    """Catches a row that is read differently by the two, a status or a NIS of the wrong step, a lost measurement."""
    run = recorded(600)
    for filter_, columns in filters(noise, run):
        single = filter_.copy()
        n = len(run["times"])
        means, covariances, status, nis, degrees = filter_.filter(
            run["times"], *columns, run["measurements"], run["present"]
        )
        for i in range(n):
            measurement = run["measurements"][i] if run["present"][i] else None
            inputs = [tuple(c[i]) if c is run["depths"] else c[i] for c in columns]
            assert single.step(run["times"][i], *inputs, measurement) == status[i]
            last = single.statistics()
            assert (last["nis_last"], last["nis_last_degrees"]) == (nis[i], degrees[i])
            if isinstance(single, _core.DepthFilter):
                found, spread = np.array([single.depth_mm]), np.array([[single.variance]])
            else:
                found, spread = single.tip_mm, single.covariance
            np.testing.assert_array_equal(found, means[i])
            np.testing.assert_array_equal(spread, covariances[i])
        assert single.statistics() == filter_.statistics()
        assert single.time_s == filter_.time_s == run["times"][-1]
        flags = {name: getattr(_core, f"STATUS_{name.upper()}") for name in COUNTED}
        assert {name: int(((status & flag) != 0).sum()) for name, flag in flags.items()} == {
            name: filter_.statistics()[name] for name in COUNTED
        }
        assert all(filter_.statistics()[name] > 0 for name in COUNTED[:4])


def test_the_depth_filter_is_the_textbook_s() -> None:
    """Catches a process noise per step taken per second, a gain or a NIS that is not Eq. 8's."""
    run = recorded(400)
    run["velocities"][~np.isfinite(run["velocities"])] = 0.0
    filter_ = _core.DepthFilter(8.0, 4.0, 0.0, PAPER)
    v = np.ascontiguousarray(run["velocities"][:, 2])
    means, covariances, status, nis, _ = filter_.filter(run["times"], v, run["measurements"], run["present"])
    x, p, before = 8.0, 4.0, 0.0
    for i, t in enumerate(run["times"]):
        x, p, before = x + v[i] * (t - before), p + 0.0025, t
        if status[i] & _core.STATUS_UPDATED:
            m = run["measurements"][i]
            r = 1e6 if np.hypot(m[1], m[2]) < 50.0 else 0.005
            s = p + r
            np.testing.assert_allclose(nis[i], (m[7] - x) ** 2 / s, rtol=1e-7, atol=1e-12)
            x, p = x + p / s * (m[7] - x), p * r / s
        np.testing.assert_allclose([means[i, 0], covariances[i, 0, 0]], [x, p], rtol=1e-9)


def test_calibration_finds_what_made_the_rows() -> None:
    """Catches gains of another section, a stiffness for its triple, rows that are not finite taken for rows."""
    rng = np.random.default_rng(5)
    forces, depths = rng.normal(size=(200, 2)) * 100.0, rng.uniform(0, 25, 200)
    w = wavelengths(forces, depths, rng.normal(size=200)) - REFERENCE
    w[7, [1, 4]] = np.nan
    for section in range(2):
        shifts = np.ascontiguousarray(w[:, 3 * section : 3 * section + 3])
        found = _core.tool_fit_gain(DISTANCES[section], shifts, forces, depths)
        expected = GAINS[section] - GAINS[section].mean(axis=1, keepdims=True)
        np.testing.assert_allclose(found["gain"], expected, rtol=1e-6, atol=1e-3)
        assert found["used"].sum() == 199
        assert not found["used"][7]
    f, d = np.linspace(40, 150, 60), np.tile([0.0, 10.0, 20.0], 20)
    at_tip = np.arange(60) % 2 == 0
    contact = f * BEAM.contact_compliance_batch(d)
    value, deviation = _core.tool_fit_slope(LENGTH, f, d, contact)
    np.testing.assert_allclose(value, STIFFNESS, rtol=1e-9)
    assert deviation < 1e-5 * value
    bends = np.where(at_tip, f * BEAM.compliance_batch(d)[:, 0], contact)
    bends[3] = np.inf
    fit = _core.tool_fit_beam(f, d, bends, at_tip, _core.ToolBeam(55.0, 1e6))
    np.testing.assert_allclose([fit["length_mm"], fit["stiffness"]], [LENGTH, STIFFNESS], rtol=1e-8)
    assert fit["covariance"].shape == (2, 2)
    assert fit["used"].sum() == 59


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
    with pytest.raises(FitError, match="collinear"):
        _core.register_points(line, line)
    with pytest.raises(FitError, match="at least 3"):
        _core.register_points(line[:2], line[:2])
    with pytest.raises(ShapeError, match="'quaternion' or 'svd'"):
        _core.register_points(line, line, "best")
    with pytest.raises(ShapeError, match="target"):
        _core.register_points(line, line[:4])
    with pytest.raises(RobotError, match="positive"):
        _core.ToolBeam(0.0, 1e6)
    with pytest.raises(RobotError, match="section II above"):
        _core.ToolSensor(GAINS, DISTANCES[::-1].copy(), REFERENCE, NOISE_NM)
    with pytest.raises(ShapeError, match="gains"):
        _core.ToolSensor(GAINS.reshape(2, 3, 2), DISTANCES, REFERENCE, NOISE_NM)
    with pytest.raises(RobotError, match="zero or more"):
        _core.FilterNoise.propagated((-1.0, 0.0), (0.0, 0.0))
    with pytest.raises(RobotError, match="finite"):
        _core.DepthFilter(np.nan, 1.0, 0.0, PAPER)
    with pytest.raises(FitError, match="at least 3"):
        _core.tool_fit_gain(28.0, np.zeros((2, 3)), np.zeros((2, 2)), np.zeros(2))
    with pytest.raises(RobotError, match="above the section"):
        _core.tool_fit_gain(28.0, np.zeros((1, 3)), np.zeros((1, 2)), np.array([40.0]))
    run = recorded(10)
    filter_ = _core.DepthFilter(8.0, 1.0, 0.0, PAPER)
    before = filter_.statistics()
    with pytest.raises(ShapeError, match="measurement"):
        filter_.step(0.1, 0.0, np.zeros(10))
    with pytest.raises(ShapeError, match="present"):
        filter_.filter(run["times"], np.zeros(10), run["measurements"], np.ones(9, dtype=bool))
    with pytest.raises(ShapeError, match="velocities"):
        filter_.filter(run["times"], np.zeros(9), run["measurements"])
    assert filter_.statistics() == before


def test_a_run_of_no_steps_and_a_clock_that_stands_or_runs_back() -> None:
    """Catches a division by no steps, and a state that a wrong clock moves."""
    filter_ = _core.DepthFilter(8.0, 1.0, 0.0, PAPER)
    empty = filter_.filter(np.zeros(0), np.zeros(0), np.zeros((0, 11)))
    assert [a.shape for a in empty] == [(0, 1), (0, 1, 1), (0,), (0,), (0,)]
    times = np.array([0.1, 0.05, np.nan, 0.1])
    _, _, status, _, _ = filter_.filter(times, np.ones(4), np.full((4, 11), np.nan), np.zeros(4, dtype=bool))
    missing, clock = _core.STATUS_MISSING, _core.STATUS_CLOCK
    assert status.tolist() == [missing, clock, clock, missing]
    assert filter_.depth_mm == 8.1
    assert filter_.time_s == 0.1


def test_noise_by_name_says_its_numbers() -> None:
    """Catches numbers of the paper mistyped, and two noises that are one."""
    numbers = PAPER.numbers()
    assert numbers["below"] == (1e6, 10.0)
    assert numbers["above"] == (0.005, 0.002)
    assert (numbers["at_mn"], numbers["of_force"]) == (50.0, False)
    assert list(numbers["per_step"]) == [0.0025, 0.01]
    assert _core.FilterNoise.ebrahimi_2020_of_force().numbers()["of_force"]
    assert _core.FilterNoise.switched(50.0, (1e6, 10.0), (0.005, 0.002), (0.0025, 0.01)) == PAPER
    assert PROPAGATED != PAPER
