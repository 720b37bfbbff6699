"""What weighs in an identification: gross errors and robust losses, priors, noise that is declared or repeated.

Levels: as in test_identification.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import polars as pl
import pytest
from numpy.typing import NDArray
from scipy import stats
from scipy.optimize import least_squares, minimize_scalar

import worlds
from running import slow
from sherkit import Measurements, from_frame, identify
from sherkit.diagnosis import gross_errors
from sherkit.evidence.plausible import times_plausible
from sherkit.robots.delta import grid
from sherkit.robots.delta.model import DeltaModel
from strategies import EXAMPLE
from test_identification import (
    ALL,
    AXES,
    COUNT,
    JOINTS,
    POSES,
    ROBUST,
    SIGMA_MM,
    TWELVE,
    Floats,
    declared,
    exact,
    planted,
    run,
    sizes,
    table,
)

# -- outliers ------------------------------------------------------------------------------------------------


def spoilt(seed: int, share: float = 0.05) -> tuple[Floats, Measurements, NDArray[np.int64]]:
    """A run of which some rows are off by 20 to 100 times the noise: what was planted, the rows, which are off."""
    rng = np.random.default_rng(seed)
    values = planted(TWELVE, rng)
    data = run(TWELVE, values, rng)
    rows = np.sort(rng.choice(len(data), round(share * len(data)), replace=False))
    jump = rng.normal(size=(len(rows), 3))
    jump *= SIGMA_MM * rng.uniform(20.0, 100.0, (len(rows), 1)) / np.linalg.norm(jump, axis=1, keepdims=True)
    readings = data.readings[:, :3].copy()
    readings[rows] += jump
    return values, table(data.joints, readings), rows


@ROBUST
@pytest.mark.parametrize("seed", range(5))
def test_robust_losses_withstand_gross_outliers(loss: str, seed: int) -> None:
    """Catches a loss that does not hold outliers back: 5 % of the rows are far off. 60 values a loss: level 0.004 %."""
    values, data, _ = spoilt(seed)
    fit = identify(TWELVE, data, loss=loss)
    assert (np.abs(fit.values - values) < 5 * fit.std).all()
    # and the stated deviation is near that of a clean run, not blown up until anything fits
    clean = identify(TWELVE, run(TWELVE, values, np.random.default_rng(seed)))
    assert (fit.std < 2.0 * clean.std).all()
    # plain squares miss by much more than the noise allows
    plain = identify(TWELVE, data)
    z = np.linalg.solve(np.linalg.cholesky(clean.covariance), np.stack([plain.values, fit.values], 1) - values[:, None])
    assert np.linalg.norm(z[:, 0]) > 2 * np.linalg.norm(z[:, 1])
    assert np.abs(z[:, 0]).max() > 5


@pytest.mark.parametrize("seed", range(5))
def test_gross_errors_are_the_spoilt_rows(seed: int) -> None:
    """Catches rows missed, or good rows accused, in the list of gross errors."""
    _, data, rows = spoilt(seed)
    assert gross_errors(identify(TWELVE, data)).tolist() == rows.tolist()


@pytest.mark.parametrize("count", [40, *slow(200)])
def test_clean_runs_have_few_gross_errors(count: int) -> None:
    """Catches a threshold far from the 1 % of clean runs that it promises: of 200 runs at most 8. Level 0.1 %."""
    accused = 0
    for seed in range(count):
        rng = np.random.default_rng([seed, 2])
        data = run(TWELVE, planted(TWELVE, rng), rng, poses=POSES[::3])
        accused += len(gross_errors(identify(TWELVE, data))) > 0
    assert accused <= stats.binom.isf(1e-3, count, 0.01)


def test_marked_outliers_are_not_fitted_and_stay() -> None:
    """Catches a mark that is ignored: rows marked by the user change nothing, not even where out of reach."""
    _, data, rows = spoilt(7)
    kept = np.setdiff1d(np.arange(len(data)), rows)
    joints = data.joints.copy()
    joints[rows[0]] += np.array([500.0, 0.0, 0.0])
    fit = identify(TWELVE, table(joints, data.readings[:, :3]).mark_outliers(rows))
    without = identify(TWELVE, data.select(kept))
    np.testing.assert_allclose(fit.values, without.values, rtol=0, atol=1e-12)
    np.testing.assert_allclose(fit.covariance, without.covariance, rtol=1e-9)
    assert fit.rms() == pytest.approx(without.rms(), rel=1e-9)
    assert len(fit.data) == len(data)
    assert np.isfinite(fit.residuals[rows[1:], :3]).all()


def test_gross_errors_are_rows_of_the_whole_table() -> None:
    """Catches gross errors counted among fitted rows: some are marked, some hold no x, and rows keep their numbers."""
    values, data, rows = spoilt(6)
    marked = np.setdiff1d(np.arange(0, 30, 3), rows)
    x = data.readings[:, 0].copy()
    x[1:20:3] = np.nan
    columns = dict(zip(JOINTS, data.joints.T, strict=True)) | dict(zip(AXES, data.readings.T[:3], strict=True))
    fit = identify(TWELVE, from_frame(columns | {"x_mm": x}).mark_outliers(marked), loss="cauchy")
    assert gross_errors(fit).tolist() == rows.tolist()
    assert (np.abs(fit.values - values) < 5 * fit.std).all()


def test_mark_in_the_table_counts() -> None:
    """Catches a column 'outlier' that is read but not obeyed."""
    _, data, rows = spoilt(7)
    mark = np.zeros(len(data), dtype=int)
    mark[rows] = 1
    fit = identify(TWELVE, table(data.joints, data.readings[:, :3], outlier=mark))
    np.testing.assert_array_equal(fit.values, identify(TWELVE, data.mark_outliers(rows)).values)


# -- priors --------------------------------------------------------------------------------------------------


#: Where the instrument stands, of which no drawing says anything.
STAND = np.array([p.name.startswith("sensor_") for p in ALL.parameters])


def test_priors_decide_where_rows_are_few() -> None:
    """Catches a prior of wrong size or place: three poses against SciPy's minimum with the sizes as further rows, of
    where the instrument stands a thousand of them."""
    wide = sizes(ALL) * np.where(STAND, 1e3, 1.0)
    rng = np.random.default_rng(91)
    poses = POSES[[3, 60, 100]]
    data = run(ALL, planted(ALL, rng), rng, 0.05, poses, **declared(3, 0.05))
    fit = identify(ALL, data, priors=True)

    def miss(values: Floats) -> Floats:
        left = data.readings[:, :3] - exact(ALL, values, data.joints)
        return np.concatenate([left.ravel() / 0.05, values / wide])

    other = least_squares(miss, np.zeros(COUNT), jac="3-point", x_scale=sizes(ALL), xtol=1e-14, ftol=1e-14, gtol=1e-14)
    np.testing.assert_allclose(fit.values / sizes(ALL), other.x / sizes(ALL), rtol=0, atol=1e-5)
    expected = np.linalg.inv(other.jac.T @ other.jac)
    np.testing.assert_allclose(fit.covariance, expected, rtol=0, atol=1e-5 * np.abs(expected).max())
    assert (np.linalg.eigvalsh(fit.covariance) > 0).all()
    assert (fit.std < wide * (1 + 1e-9)).all()
    assert fit.unobserved_covariance.max() == 0.0


def test_priors_pull_towards_the_drawing() -> None:
    """Catches a prior that pushes: with more noise the estimate shrinks, and without readings' say it is zero."""
    rng = np.random.default_rng(92)
    values = planted(ALL, rng)
    q = EXAMPLE.inverse_batch(POSES[::30]).require()
    clean = exact(ALL, values, q)
    length = []
    for sigma in (0.01, 1.0, 10.0, 1e4):
        fit = identify(ALL, table(q, clean, **declared(len(q), sigma)), priors=True)
        length.append(float(np.linalg.norm((fit.values / sizes(ALL))[~STAND])))
    assert length == sorted(length, reverse=True)
    assert length[-1] < 1e-2 < 1.0 < length[0]


@pytest.mark.parametrize("priors", [True, None])
@pytest.mark.parametrize("shift_mm", [1e3, 3e3, 3e4])
def test_where_an_instrument_stands_drags_no_drawing(shift_mm: float, priors: bool | None) -> None:
    """Catches a tracker three metres away that bends a base by forty millimetres: the same run seen from elsewhere
    leaves every number of the drawing where it was."""
    rng = np.random.default_rng(95)
    data = run(ALL, planted(ALL, rng), rng, 0.01, POSES[::8], **declared(len(POSES[::8]), 0.01))
    by = shift_mm * np.array([0.6, -0.64, 0.48, 0.0])[: data.readings.shape[1]]
    there = np.where(data.taken, data.readings + by, 0.0)
    fit, far = (identify(ALL, one, priors=priors) for one in (data, replace(data, readings=there)))
    off = ((far.values - fit.values) / sizes(ALL))[~STAND]
    assert np.abs(off).max() < 0.02


def test_priors_leave_a_full_run_alone() -> None:
    """Catches a prior that outweighs declared noise of 5 µm on 147 poses."""
    rng = np.random.default_rng(93)
    data = run(TWELVE, planted(TWELVE, rng), rng, **declared(len(POSES), SIGMA_MM))
    plain, fit = identify(TWELVE, data), identify(TWELVE, data, priors=True)
    assert (np.abs(plain.values - fit.values) < 0.2 * plain.std).all()


@pytest.mark.parametrize("seed", [1, 2])
def test_what_a_model_lacks_does_not_outweigh_the_drawing(seed: int) -> None:
    """Catches a drawing that is weighed against the noise of repeats where the model is off by a thousand of them: a
    mirrored picture bent the camera by a hundred times what is plausible, and regions left out were off by 1e5 px."""
    world = worlds.spherical_world(seed, repeats=2)
    mirrored = world.columns | {"u_px": 1280.0 - world.columns["u_px"]}
    fit = identify(world.robot, from_frame(pl.DataFrame(mirrored)), priors=True)
    assert fit.scale > 1000.0
    assert times_plausible(fit).max() < 5.0


def test_an_effect_is_as_large_as_the_readings_say() -> None:
    """Catches an effect of five times the size that is usual, held to that size by the drawing beside it: a mean of
    7.0 in eight worlds, where χ² of two values is 2 ± 0.7 (seeds fixed; level 1e-4 for 4.9)."""
    planted, off = np.array([0.01, -0.008]), []
    for seed in range(8):
        world = worlds.spherical_world(seed, effects={"joint_scale": planted}, per_side=6, noise_px=0.3)
        fit = identify(world.robot, from_frame(pl.DataFrame(world.columns)), effects=["joint_scale"], priors=True)
        at = [k for k, p in enumerate(fit.parameters) if p.name.startswith("joint_scale.")]
        error = fit.values[at] - planted
        off.append(error @ np.linalg.solve((fit.covariance + fit.unobserved_covariance)[np.ix_(at, at)], error))
    assert np.mean(off) < 4.9


def test_priors_do_not_need_declared_noise() -> None:
    """Catches a prior weighed against the placeholder of 1 mm: 147 poses at 5 µm without repeats must still fit."""
    rng = np.random.default_rng(93)
    data = run(TWELVE, planted(TWELVE, rng), rng)
    assert max(identify(TWELVE, data, priors=True).rms().values()) < 1.2e3 * SIGMA_MM


def test_start_does_not_move_the_prior() -> None:
    """Catches a minimum that depends on where the search began."""
    rng = np.random.default_rng(94)
    data = run(ALL, planted(ALL, rng), rng, 0.05, POSES[[3, 60, 100]], **declared(3, 0.05))
    fit, other = (identify(ALL, data, priors=True, start=s) for s in (np.zeros(COUNT), 0.5 * sizes(ALL)))
    np.testing.assert_allclose(fit.values, other.values, rtol=0, atol=1e-6)


@ROBUST
def test_priors_hold_with_a_robust_loss(loss: str) -> None:
    """Catches a prior that is forgotten: one rod, nine poses, noise as large as the prior."""
    model = DeltaModel(EXAMPLE, ("rod_length_1",))
    rng = np.random.default_rng(5)
    data = run(model, np.array([2.0]), rng, 2.0, grid(20.0, 3, (0.0,)), **declared(9, 2.0))
    free, held = identify(model, data, loss=loss), identify(model, data, loss=loss, priors=True)
    spread = [1.482602218505602 * np.median(np.abs(held.residuals[:, k])) for k in range(3)]
    rho: dict[str, Callable[[Floats], Floats]] = {
        "huber": lambda u: np.where(np.abs(u) < 1.345, u**2, 1.345 * (2 * np.abs(u) - 1.345)),
        "cauchy": lambda u: 2.385**2 * np.log1p((u / 2.385) ** 2),
        "tukey": lambda u: 4.685**2 / 3 * (1 - (1 - np.minimum((u / 4.685) ** 2, 1)) ** 3),
    }

    def cost(value: float) -> float:
        left = data.readings[:, :3] - exact(model, np.array([value]), data.joints)
        return float(rho[loss](left / spread).sum() + (value / 2.0) ** 2)

    best = minimize_scalar(cost, bracket=(0.0, 4.0)).x
    assert abs(best - free.values[0]) > 0.05  # the prior has a say here
    assert held.values[0] == pytest.approx(best, abs=1e-3)


# -- noise ---------------------------------------------------------------------------------------------------


def uneven(seed: int) -> tuple[Floats, Measurements, Floats]:
    """A run whose noise differs by 20 from row to row and axis to axis, and says so."""
    rng = np.random.default_rng([seed, 101])
    values = planted(TWELVE, rng, 0.1)
    sigma = 0.002 * 20.0 ** rng.uniform(size=(len(POSES), 3))
    columns = {f"sigma_{a}": s for a, s in zip(AXES, sigma.T, strict=True)}
    return values, run(TWELVE, values, rng, sigma, **columns), sigma


def test_declared_noise_weighs_as_in_numpy() -> None:
    """Catches weights that are variances, or belong to another axis or row."""
    _, data, sigma = uneven(0)
    fit = identify(TWELVE, data, linear=True)
    jacobian = TWELVE.derivatives(data, np.zeros(12))[:, :3].reshape(-1, 12)
    left = fit.nominal_residuals[:, :3].ravel()
    weighted = np.linalg.lstsq(jacobian / sigma.reshape(-1, 1), left / sigma.ravel(), rcond=None)[0]
    np.testing.assert_allclose(fit.values, weighted, rtol=0, atol=1e-9)
    assert fit.noise.origin == "declared"


def test_declared_noise_gives_better_estimates() -> None:
    """Catches weights that do harm: 40 robots with noise from 2 to 40 µm, errors in the unit of the best possible.

    Weighted, they follow χ²; alike, they are twice as large. Level 0.1 %.
    """
    weighted, alike = [], []
    for seed in range(40):
        values, data, _ = uneven(seed)
        fit = identify(TWELVE, data)
        root = np.linalg.cholesky(fit.covariance / fit.scale**2)
        unweighted = identify(TWELVE, table(data.joints, data.readings[:, :3]))
        for found, into in ((fit, weighted), (unweighted, alike)):
            into.append(float((np.linalg.solve(root, found.values - values) ** 2).sum()))
    assert 5e-4 < stats.chi2(12 * 40).cdf(sum(weighted)) < 1 - 5e-4
    assert sum(alike) > 2 * sum(weighted)


def test_repeats_tell_the_noise_of_each_axis() -> None:
    """Catches axes that weigh alike although repeats say that one is ten times worse."""
    rng = np.random.default_rng(111)
    values = planted(TWELVE, rng, 0.1)
    poses = np.repeat(np.arange(len(POSES)), 3)
    sigma = np.array([0.002, 0.002, 0.02])
    data = run(TWELVE, values, rng, sigma, POSES[poses], pose=poses)
    fit = identify(TWELVE, data)
    assert fit.noise.origin == "repeats"
    # 294 degrees of freedom: 15 % is 3.6 deviations, level 0.1 % over three axes
    np.testing.assert_allclose(fit.noise.sigma[:, :3], np.broadcast_to(sigma, (len(data), 3)), rtol=0.15)
    assert fit.scale == pytest.approx(1.0, abs=0.15)
