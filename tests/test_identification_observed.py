"""What readings tell of a robot and what they leave open: ranks, and the directions that nothing fixes."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from sherkit import from_frame, identify
from sherkit.fit.identify import Fit
from sherkit.robots.delta import grid
from sherkit.robots.delta.model import DeltaModel
from strategies import EXAMPLE
from test_identification import (
    ALL,
    GEOMETRIC,
    JOINTS,
    POSES,
    SIGMA_MM,
    TWELVE,
    declared,
    distances,
    exact,
    planted,
    run,
    sizes,
    table,
    together,
)


def test_full_geometry_has_rank_twelve() -> None:
    """Catches platform and base taken for independent, which the reconstruction of Eq. 9 rules out."""
    rng = np.random.default_rng(61)
    fit = identify(EXAMPLE, run(TWELVE, planted(TWELVE, rng), rng), free=GEOMETRIC)
    assert fit.rank == 12
    assert len(fit.unobserved) == 6
    assert fit.rms()["x_mm"] == pytest.approx(1e3 * SIGMA_MM, rel=0.3)
    _check_unobserved(fit)


def test_where_the_sensor_stands_is_reported_as_unobserved() -> None:
    """Catches a pose of the sensor that is reported as known: shifting it is shifting the base, rising is all offsets,
    and its turn about the base's axis is one of all base angles; how far it is tilted is observed."""
    model = DeltaModel(EXAMPLE)
    fit = identify(model, run(TWELVE, np.zeros(12), np.random.default_rng(62)), priors=False)
    assert len(fit.unobserved) == 4
    for name in ("sensor_shift_x", "sensor_shift_y", "sensor_shift_z", "sensor_turn_z"):
        assert sum(name in d.change for d in fit.unobserved) == 1, name
    for name in ("sensor_turn_x", "sensor_turn_y"):
        assert not any(name in d.change for d in fit.unobserved), name
    (rise,) = (d for d in fit.unobserved if "sensor_shift_z" in d.change)
    assert set(rise.change) == {"sensor_shift_z", "joint_offset_1", "joint_offset_2", "joint_offset_3"}
    rises = [rise.change[f"joint_offset_{k}"] / rise.change["sensor_shift_z"] for k in (1, 2, 3)]
    assert rises == pytest.approx([-1.0] * 3, rel=1e-3)
    (about,) = (d for d in fit.unobserved if "sensor_turn_z" in d.change)
    assert {f"base_angle_{k}" for k in (1, 2, 3)} <= set(about.change)
    assert all(np.isinf(d.std) for d in fit.unobserved)
    _check_unobserved(fit)


@pytest.mark.parametrize("planes", [(0.0,), (-20.0, 0.0, 20.0)])
def test_heights_alone_give_rank_eleven(planes: tuple[float, ...]) -> None:
    """Catches an exception, or certainty, where only z is read: shifts in x and y of the base
    and of the sensor, a turn of either about z, and one height stay open."""
    rng = np.random.default_rng(71)
    full = run(ALL, planted(ALL, rng), rng, poses=grid(20.0, 7, planes))
    data = from_frame(full.to_frame().select(*JOINTS, "z_mm"))
    fit = identify(ALL, data)
    assert fit.rank == 11
    scaled = ALL.derivatives(data, fit.values)[:, 2] * sizes(ALL)
    assert np.linalg.matrix_rank(scaled, tol=1e-9 * np.linalg.norm(scaled, 2)) == 11
    assert len(fit.unobserved) == 7
    assert {"sensor_shift_x alone", "sensor_shift_y alone"} <= {str(d) for d in fit.unobserved}
    assert fit.rms().keys() == {"z_mm"}
    assert np.isfinite(fit.std).all()
    assert (fit.residuals[:, 2] ** 2).sum() < (fit.nominal_residuals[:, 2] ** 2).sum() / 1e4
    _check_unobserved(fit)


def test_distances_alone_give_rank_eight() -> None:
    """Catches a distance that is taken to know where the robot stands: shifts and the turn about z stay open."""
    rng = np.random.default_rng(81)
    values = planted(TWELVE, rng)
    fit = identify(TWELVE, distances(values, 200, rng))
    assert fit.rank == 8
    assert len(fit.unobserved) == 4
    assert fit.rms()["distance_mm"] == pytest.approx(1e3 * SIGMA_MM, rel=0.3)
    _check_unobserved(fit)


def test_distances_add_to_positions() -> None:
    """Catches distance rows that are dropped or weigh nothing: every parameter gets better known, and stays right."""
    rng = np.random.default_rng(82)
    values = planted(TWELVE, rng)
    few = run(TWELVE, values, rng, poses=POSES[::10])
    both = together(few, distances(values, 300, rng))
    alone, more = identify(TWELVE, few), identify(TWELVE, both)
    assert both.is_distance.sum() == 300
    assert (more.std / more.scale < 0.95 * alone.std / alone.scale).all()
    # level 0.1 %: what is found with both is what was planted
    e = more.values - values
    assert stats.chi2.sf(e @ np.linalg.solve(more.covariance, e), 12) > 1e-3


# -- helpers -------------------------------------------------------------------------------------------------


def _check_unobserved(fit: Fit) -> None:
    """The reported null space is orthonormal in plausible sizes and changes no reading to the first order."""
    size = sizes(fit.model)
    jacobian = fit.model.derivatives(fit.data, fit.values)[fit.data.taken] * size
    assert np.abs(jacobian @ fit.unobserved_basis.T).max() < 1e-6 * np.abs(jacobian).max()
    np.testing.assert_allclose(
        fit.unobserved_basis @ fit.unobserved_basis.T, np.eye(len(size) - fit.rank), rtol=0, atol=1e-9
    )


def test_what_a_model_lacks_is_said_beside_its_deviations() -> None:
    """Catches deviations of a fit that is many times the noise off, given as if they held; and the sentence where
    nothing is missing, or where no noise is known to compare with."""
    rng = np.random.default_rng(63)
    q = EXAMPLE.inverse_batch(POSES).require()
    clean = exact(TWELVE, planted(TWELVE, rng), q)
    read = clean + SIGMA_MM * rng.normal(size=clean.shape)
    bent = read + 0.05 * np.sin(q / 7.0)
    sigma = declared(len(q), SIGMA_MM)
    assert identify(TWELVE, table(q, read, **sigma)).lacking is None
    assert identify(TWELVE, table(q, bent)).lacking is None
    told = identify(TWELVE, table(q, bent, **sigma))
    assert "times the noise: the model lacks something" in (told.lacking or "")
    assert "lacking" in str(told)
