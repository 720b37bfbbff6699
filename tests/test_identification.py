"""Identification on virtual robots: what was planted comes back, and the stated uncertainty is the true one.

Levels: a statistical test here fails by chance with the probability in its docstring, over the choice of its seed;
the seed is fixed, so it does not fail at random.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import polars as pl
import pytest
from numpy.typing import NDArray
from scipy import stats
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

import sherkit._core as _core
from running import slow
from second_simulator import Robot, draw_geometric_errors, make_plan, simulate, whole_grid
from sherkit import Measurements, from_frame, identify, read_measurements
from sherkit.data import MeasurementStream
from sherkit.errors import FitError
from sherkit.fit import identify_stream
from sherkit.fit.hold_out import hold_out
from sherkit.fit.identify import Fit
from sherkit.model.sensor_pose import HELD, POSE, SHIFTS, TURNS, SensorPose
from sherkit.robots.delta import VirtualDelta, grid
from sherkit.robots.delta.model import DeltaModel
from strategies import EXAMPLE

Floats = NDArray[np.float64]

#: The twelve, and where the sensor stands: 18.
ALL = DeltaModel(EXAMPLE)
COUNT = len(ALL.free)
#: A shift of the sensor, and a turn of it about z, is one of the base.
OBSERVED = COUNT - 4
#: The twelve alone: every combination of them is observed.
TWELVE = DeltaModel(EXAMPLE, tuple(n for n in ALL.free if not n.startswith("sensor_")))
GEOMETRIC = tuple(EXAMPLE.parameter_names)
POSES = grid(20.0, 7, (-20.0, 0.0, 20.0))
SIGMA_MM = 0.005
JOINTS = ("q1_mm", "q2_mm", "q3_mm")
AXES = ("x_mm", "y_mm", "z_mm")
ROBUST = pytest.mark.parametrize("loss", ["huber", "cauchy", "tukey"])


def sizes(model: DeltaModel) -> Floats:
    return np.array([p.size for p in model.parameters])


def planted(model: DeltaModel, rng: np.random.Generator, scale: float = 1.0) -> Floats:
    """Errors (p,) drawn from the plausible sizes."""
    return scale * sizes(model) * rng.normal(size=len(model.free))


def exact(model: DeltaModel, values: Floats, joints_mm: Floats) -> Floats:
    """Readings (n, 3) of the robot with these errors, from Newton's method in NumPy and never from the core."""
    errors = dict(zip(model.free, values.tolist(), strict=True))
    turn = Rotation.from_rotvec([errors.pop(name, 0.0) for name in TURNS]).as_matrix()
    shift = np.array([errors.pop(name, 0.0) for name in SHIFTS])
    return VirtualDelta(model.robot, errors).true_reading(joints_mm) @ turn.T + shift


def table(joints_mm: Floats, readings_mm: Floats, **columns: Any) -> Measurements:
    named = dict(zip(JOINTS, joints_mm.T, strict=True)) | dict(zip(AXES, readings_mm.T, strict=True))
    return from_frame(named | columns)


def declared(count: int, sigma_mm: float) -> dict[str, Floats]:
    return {f"sigma_{a}": np.full(count, sigma_mm) for a in AXES}


def run(
    model: DeltaModel,
    values: Floats,
    rng: np.random.Generator,
    sigma_mm: float | Floats = SIGMA_MM,
    poses: Floats = POSES,
    **columns: Any,
) -> Measurements:
    q = EXAMPLE.inverse_batch(poses).require()
    clean = exact(model, values, q)
    return table(q, clean + sigma_mm * rng.normal(size=clean.shape), **columns)


def distances(values: Floats, count: int, rng: np.random.Generator, sigma_mm: float = SIGMA_MM) -> Measurements:
    """Distances between random pairs of poses, of a robot whose twelve have these errors."""
    q = EXAMPLE.inverse_batch(POSES).require()
    a = rng.integers(len(q), size=count)
    b = (a + rng.integers(1, len(q), size=count)) % len(q)
    d = np.linalg.norm(exact(TWELVE, values, q[a]) - exact(TWELVE, values, q[b]), axis=1)
    columns = dict(zip(JOINTS, q[a].T, strict=True)) | {f"to_{n}": c for n, c in zip(JOINTS, q[b].T, strict=True)}
    return from_frame(columns | {"distance_mm": d + sigma_mm * rng.normal(size=count)})


def together(*runs: Measurements) -> Measurements:
    """Rows of several runs one after the other."""
    return from_frame(pl.concat([r.to_frame() for r in runs], how="diagonal"))


# -- what was planted comes back -----------------------------------------------------------------------------


@cache
def fits(model: DeltaModel, sigma_mm: float, count: int) -> tuple[tuple[Floats, Fit], ...]:
    """Random robots: what was planted, and what least squares without priors found."""
    out = []
    for seed in range(count):
        rng = np.random.default_rng([seed, 1])
        values = planted(model, rng)
        out.append((values, identify(model, run(model, values, rng, sigma_mm), priors=False)))
    return tuple(out)


def test_planted_parameters_come_back_within_four_deviations() -> None:
    """Catches a wrong parameter, or a standard deviation that is too small. 40 robots × 12 values: level 3 %."""
    for values, fit in fits(TWELVE, SIGMA_MM, 200)[:40]:
        assert fit.converged
        assert (np.abs(fit.values - values) < 4.0 * fit.std).all()


def test_errors_of_the_twelve_follow_chi_squared() -> None:
    """Catches a covariance of wrong size or shape. Kolmogorov's test on 200 robots, level 0.1 %."""
    p = []
    for values, fit in fits(TWELVE, SIGMA_MM, 200):
        assert fit.rank == 12
        assert fit.unobserved_covariance.max() == 0.0
        e = fit.values - values
        p.append(stats.f.sf(e @ np.linalg.solve(fit.covariance, e) / 12, 12, 3 * len(POSES) - 12))
    assert stats.kstest(p, "uniform").pvalue > 1e-3


def test_errors_of_all_parameters_follow_chi_squared() -> None:
    """Catches an honest covariance spoilt by what no reading tells: the twelve and the pose, planted at their
    plausible sizes, wherever the sensor stands. Noise is coarse, because along directions that no reading fixes
    the model is curved. Level 0.1 %.
    """
    p = []
    for values, fit in fits(ALL, 0.5, 200):
        assert fit.rank == OBSERVED
        e = fit.values - values
        p.append(stats.chi2.sf(e @ np.linalg.solve(fit.covariance + fit.unobserved_covariance, e), COUNT))
    assert stats.kstest(p, "uniform").pvalue > 1e-3


def test_errors_in_the_observed_directions_follow_chi_squared() -> None:
    """Catches plausible sizes that leak into what the readings fix: rank 14 of the same fits. Level 0.1 %."""
    size, p = sizes(ALL), []
    for values, fit in fits(ALL, 0.5, 200):
        # in units of plausible size the unobserved directions are orthogonal to the observed ones
        variance, axes = np.linalg.eigh(fit.covariance / np.outer(size, size))
        lost = COUNT - OBSERVED
        assert variance[lost - 1] < 1e-9 * variance[-1] < variance[lost] * 1e3
        z = axes[:, lost:].T @ ((fit.values - values) / size) / np.sqrt(variance[lost:])
        p.append(stats.f.sf(z @ z / OBSERVED, OBSERVED, 3 * len(POSES) - OBSERVED))
    assert stats.kstest(p, "uniform").pvalue > 1e-3


@pytest.mark.slow
def test_fitted_readings_err_by_the_rank() -> None:
    """Catches a fit that is not the minimum: at 5 µm noise the fitted readings miss the true ones by χ² with fourteen
    degrees of freedom, wherever the sensor stands. Level 0.1 %.
    """
    p = []
    for values, fit in fits(ALL, SIGMA_MM, 200):
        missed = fit.predicted[:, :3] - exact(ALL, values, fit.data.joints)
        p.append(stats.chi2.sf((missed**2).sum() / SIGMA_MM**2, OBSERVED))
    assert stats.kstest(p, "uniform").pvalue > 1e-3


@pytest.mark.parametrize("count", [100, *slow(400)])
@pytest.mark.parametrize("loss", ["huber", *slow("linear", "cauchy", "tukey")])
def test_covariance_is_that_of_repeated_runs(loss: str, count: int) -> None:
    """Catches a covariance that is right on average over robots only, or not corrected for a robust loss: many runs
    of one robot, sum of squares (trace) and generalised variance (determinant). Level 0.1 % each.
    """
    p = 12
    values = planted(TWELVE, np.random.default_rng(11))
    found = [identify(TWELVE, run(TWELVE, values, np.random.default_rng([12, k])), loss=loss) for k in range(count)]
    predicted = np.mean([f.covariance for f in found], axis=0)
    deviation = np.array([f.values for f in found])
    z = np.linalg.solve(np.linalg.cholesky(predicted), (deviation - deviation.mean(axis=0)).T).T
    trace = stats.chi2((count - 1) * p).cdf((z**2).sum())
    assert 5e-4 < trace < 1 - 5e-4
    # log determinant of a Wishart matrix: a sum of log χ², nearly Gaussian
    logs = [stats.loggamma((count - k) / 2) for k in range(1, p + 1)]
    mean = sum(d.mean() + np.log(2) for d in logs)
    deviation_of_log = np.sqrt(sum(d.var() for d in logs))
    assert abs(np.linalg.slogdet(z.T @ z)[1] - mean) < stats.norm.isf(5e-4) * deviation_of_log


def test_scale_is_the_noise() -> None:
    """Catches degrees of freedom miscounted: scale² is the noise variance, χ² over 200 robots. Level 0.1 %."""
    freedom = 3 * len(POSES) - 12
    total = sum(fit.scale**2 * freedom / SIGMA_MM**2 for _, fit in fits(TWELVE, SIGMA_MM, 200))
    assert 5e-4 < stats.chi2(200 * freedom).cdf(total) < 1 - 5e-4


# -- the same numbers another way ----------------------------------------------------------------------------


def test_single_step_is_the_least_squares_solution_of_numpy() -> None:
    """Catches a step that is not that of Eq. 11, or one along unobserved directions: shortest in plausible sizes."""
    rng = np.random.default_rng(21)
    values = planted(ALL, rng, 0.1)
    data = run(ALL, values, rng)
    fit = identify(ALL, data, linear=True)
    start = ALL.start(data)
    jacobian = ALL.derivatives(data, start)[:, :3].reshape(-1, COUNT)
    left = (data.readings - ALL.predict(data, start))[:, :3].ravel()
    step = fit.values - start
    any_solution = np.linalg.lstsq(jacobian, left, rcond=1e-10)[0]
    np.testing.assert_allclose(jacobian @ step, jacobian @ any_solution, rtol=0, atol=1e-9)
    shortest = sizes(ALL) * np.linalg.lstsq(jacobian * sizes(ALL), left, rcond=1e-10)[0]
    np.testing.assert_allclose(step, shortest, rtol=0, atol=1e-9)
    assert fit.rank == OBSERVED


def test_single_step_is_not_silently_dropped() -> None:
    """Catches a linear fit that moves nothing and says nothing: errors so large that the step leaves the reach."""
    data, fit = _far_off(), identify(ALL, _far_off())
    assert max(fit.rms().values()) < 10.0  # the iterated fit gets there
    with pytest.raises(FitError, match="cannot reach"):
        identify(ALL, data, linear=True)


@pytest.mark.parametrize("rows", [7, 64, 100, 10_000])
def test_stream_equals_memory(rows: int) -> None:
    """Catches rows lost or counted twice between blocks, and blocks that weigh otherwise than rows in memory. The
    sensor's turns are held: where they are free, a stream starts from where its first block is seen, and what no
    reading tells stays near that."""
    rng = np.random.default_rng(31)
    held = DeltaModel(replace(EXAMPLE, sensor_pose=SensorPose(turn_sd_deg=HELD)))
    sigma = {f"sigma_{a}": rng.uniform(0.003, 0.02, len(POSES)) for a in AXES}
    data = run(held, planted(held, rng), rng, **sigma).mark_outliers(np.array([5, 70]))
    blocks = [data.select(np.arange(k, min(k + rows, len(data)))) for k in range(0, len(data), rows)]
    streamed = identify_stream(held, MeasurementStream(lambda: iter(blocks), "blocks"))
    fit = identify(held, data)
    assert streamed.converged
    assert (streamed.rows, streamed.rank) == (len(data), fit.rank)
    np.testing.assert_allclose(streamed.values, fit.values, rtol=0, atol=1e-9)
    np.testing.assert_allclose(streamed.scale, fit.scale, rtol=1e-9)
    for mine, theirs in (
        (streamed.covariance, fit.covariance),
        (streamed.unobserved_covariance, fit.unobserved_covariance),
    ):
        np.testing.assert_allclose(mine, theirs, rtol=0, atol=1e-7 * np.abs(theirs).max())
    np.testing.assert_allclose(streamed.singular_values[:12], fit.singular_values[:12], rtol=1e-7)


def test_stream_steps_back_where_memory_does() -> None:
    """Catches a stream that gives up where a trial, not the drawing, is out of reach."""
    data = _far_off()
    fit = identify(ALL, data)
    streamed = identify_stream(ALL, MeasurementStream(lambda: iter([data]), "blocks"))
    np.testing.assert_allclose(ALL.predict(data, streamed.values), fit.predicted, rtol=0, atol=1e-6)


def test_minimum_is_that_of_scipy_on_the_simulator() -> None:
    """Catches a wrong model or a minimum that is none: SciPy, differences, and Newton instead of the core."""
    rng = np.random.default_rng(41)
    data = run(ALL, planted(ALL, rng), rng, poses=grid(20.0, 4, (-15.0, 15.0)))
    fit = identify(ALL, data)

    def miss(values: Floats) -> Floats:
        return (data.readings[:, :3] - exact(ALL, values, data.joints)).ravel()

    other = least_squares(miss, np.zeros(COUNT), jac="3-point", x_scale=sizes(ALL), xtol=1e-14, ftol=1e-14, gtol=1e-14)
    assert (fit.residuals[:, :3] ** 2).sum() == pytest.approx(2 * other.cost, rel=1e-6)
    np.testing.assert_allclose(fit.residuals[:, :3].ravel(), miss(other.x), rtol=0, atol=1e-6)
    np.testing.assert_allclose(fit.residuals[:, :3].ravel(), miss(fit.values), rtol=0, atol=1e-9)


@pytest.mark.parametrize("kind", ["position", "distance"])
def test_derivatives_of_readings_against_differences(kind: str) -> None:
    """Catches a wrong column of any of the 24 parameters, and a pose of the sensor that changes a distance."""
    rng = np.random.default_rng(51)
    model = DeltaModel(EXAMPLE, (*GEOMETRIC, *POSE))
    at = 0.1 * planted(model, rng)
    data = distances(np.zeros(12), 20, rng) if kind == "distance" else run(TWELVE, np.zeros(12), rng, poses=POSES[::8])
    analytic = model.derivatives(data, at)
    for k, name in enumerate(model.free):
        h = (2e-4 if model.parameters[k].unit == "rad" else 0.02) * np.eye(24)[k]
        one, two, three = (model.predict(data, at + m * h) - model.predict(data, at - m * h) for m in (1, 2, 3))
        numeric = (45 * one - 9 * two + three) / (60 * h[k])
        scale = 1e-7 * np.abs(numeric).max() + 1e-9
        np.testing.assert_allclose(analytic[:, :, k], numeric, rtol=0, atol=scale, err_msg=name)


def test_order_of_names_does_not_matter() -> None:
    """Catches a column that goes by its place instead of its name."""
    rng = np.random.default_rng(55)
    data = run(ALL, planted(ALL, rng), rng)
    fit, other = identify(ALL, data), identify(EXAMPLE, data, free=ALL.free[::-1])
    for name, value in fit.by_name.items():
        assert other.by_name[name] == pytest.approx(value, abs=1e-7), name
    np.testing.assert_allclose(other.std[::-1], fit.std, rtol=1e-6)


def test_parameters_are_a_table() -> None:
    """Catches a table that says other than the fit or its print, and one that leaves out what is held."""
    rng = np.random.default_rng(56)
    fit = identify(EXAMPLE, run(TWELVE, planted(TWELVE, rng), rng), free=GEOMETRIC[:4])
    printed = str(fit).splitlines()
    rows = {row["name"]: row for row in fit.params.iter_rows(named=True)}
    assert list(rows) == [p.name for p in (*fit.parameters, *fit.model.fixed)]
    for k, p in enumerate(fit.parameters):
        row = rows[p.name]
        assert (row["value"], row["std"], row["std_from_readings"]) == (
            fit.values[k], fit.std[k], fit.std_from_readings[k],
        )  # fmt: skip
        assert (row["unit"], row["plausible"]) == (p.unit, p.size)
        assert any(line.startswith(f"{p.name} ") and line.endswith(f"  {row['state']}") for line in printed)
    assert [rows[p.name]["state"] for p in fit.model.fixed] == ["fixed"] * len(fit.model.fixed)


# -- what goes wrong -----------------------------------------------------------------------------------------


def test_row_out_of_reach_is_named(tmp_path: Any) -> None:
    """Catches a file that fails without saying where: line, limb and distance, comments and header counted."""
    q = EXAMPLE.inverse_batch(POSES[:5]).require()
    q[3, 1] += 400.0
    lines = ["# a note", ",".join((*JOINTS, *AXES))]
    lines += [",".join(map(str, [*row, *pose])) for row, pose in zip(q, POSES[:5], strict=True)]
    path = tmp_path / "run.csv"
    path.write_text("\n".join(lines))
    with pytest.raises(FitError, match=r"run\.csv: line 6: .*limb 2 is \d+\.\d+ mm too short.*outlier") as caught:
        identify(ALL, read_measurements(path))
    assert "lines" not in str(caught.value)


@pytest.mark.parametrize(
    ("name", "meant"),
    [("base_radius1", "base_radius_1"), ("rod_lenght_2", "rod_length_2"), ("sensor_shiftx", "sensor_shift_x")],
)
def test_misspelt_parameter_is_recognised(name: str, meant: str) -> None:
    """Catches an unknown name that is passed over, or refused without help."""
    with pytest.raises(FitError, match=f"'{name}' is not a parameter of this robot; did you mean '{meant}'"):
        identify(EXAMPLE, run(ALL, np.zeros(COUNT), np.random.default_rng(0)), free=[name])


def test_other_mistakes_are_refused_in_words() -> None:
    """Catches a wrong loss, a name given twice, or a run without a row left that ends in a traceback."""
    data = run(ALL, np.zeros(COUNT), np.random.default_rng(0))
    with pytest.raises(FitError, match="loss: 'hubert' is not known; choose linear, huber, cauchy, tukey"):
        identify(ALL, data, loss="hubert")
    with pytest.raises(FitError, match="freed twice"):
        identify(EXAMPLE, data, free=("sensor_shift_x", "sensor_shift_x"))
    with pytest.raises(FitError, match="every row is marked as an outlier"):
        identify(ALL, data.mark_outliers(np.arange(len(data))))


# -- held out ------------------------------------------------------------------------------------------------


def test_held_out_residuals_are_the_noise() -> None:
    """Catches a fit that errs by itself, and a hold-out that sees its block: 588 poses × 5 at 5 µm, from the second
    simulator. 2940 readings an axis: 3 % is 2.3 deviations, level 6 % over three axes.
    """
    robot = Robot.from_dict()
    columns = simulate(
        robot, make_plan(robot, whole_grid(), 5, seed=1), draw_geometric_errors(np.random.default_rng(1)), noise=0.005
    )
    data = from_frame({k: v for k, v in columns.items() if k not in ("temperature_c", "humidity_pct")})
    held = hold_out(ALL, data)
    rms = np.sqrt((held.residuals[:, :3] ** 2).mean(axis=0))
    np.testing.assert_allclose(rms, 0.005, rtol=0.03)
    # a block is never split within a pose, and none is the whole run
    assert all(len(np.unique(held.block[data.pose == p])) == 1 for p in (1, 17, 588))
    assert len(np.unique(held.block)) == 5


def test_held_out_residuals_come_from_fits_without_their_block() -> None:
    """Catches a block that its own fit has seen: every residual is that of a fit to the other blocks, here redone."""
    rng = np.random.default_rng(121)
    data = run(TWELVE, planted(TWELVE, rng), rng, poses=POSES[::3])
    held = hold_out(TWELVE, data, folds=4, seed=1)
    assert sorted(np.unique(held.block)) == [0, 1, 2, 3]
    for block in range(4):
        without = identify(TWELVE, data.select(held.block != block))
        inside = held.block == block
        left = data.readings[inside, :3] - exact(TWELVE, without.values, data.joints[inside])
        np.testing.assert_allclose(held.residuals[inside, :3], left, rtol=0, atol=1e-9)
    assert np.isnan(held.residuals[:, 3]).all()
    other = hold_out(TWELVE, data, folds=4, seed=2)
    assert (other.block != held.block).any()


def _far_off() -> Measurements:
    """Twelve poses of a robot with errors of six times their plausible sizes: the first step goes too far."""
    rng = np.random.default_rng(2843)
    values = 6.0 * planted(TWELVE, rng)
    return run(TWELVE, values, rng, poses=rng.uniform(-1.0, 1.0, (12, 3)) * np.array([40.0, 40.0, 20.0]))


@pytest.mark.parametrize(("weight", "at_the_end"), [(0.0003, True), (0.003, False), (0.01, False), (0.03, False)])
def test_a_curved_valley_that_hardly_gains_is_left(weight: float, at_the_end: bool) -> None:
    """Catches a fit that creeps to its last evaluation along a valley that bends, where all that it gains on the way is
    less than noise would give: with many rows that took minutes of a diagnosis. The rows: noise of variance one, a
    parabola that binds, and a wish to be far along it."""
    solver = _core.Solver(np.array([-1.0, 1.0]), np.ones(2))
    ended, n = "evaluate", 1002
    while ended == "evaluate":
        x, y = solver.trial
        derivatives, left = np.zeros((n, 1, 2)), np.ones((n, 1))
        derivatives[:2, 0] = [[-40.0 * x, 20.0], [weight, 0.0]]
        left[:2, 0] = [-20.0 * (y - x * x), weight * (50.0 - x)]
        solver.clear()
        solver.push(derivatives, left, np.ones((n, 1)))
        ended = solver.advance()
    result = solver.result()
    # where nothing is left to gain this is the minimum for all that counts; else it is said that it is none
    assert ended == ("converged" if at_the_end else "exhausted")
    assert result["evaluations"] <= 45
    np.testing.assert_array_equal(result["values"], solver.trial)
    assert result["cost"] <= 1000.0 + (51.0 * weight) ** 2
