"""Bases of columns, the filter in time, and the play operator, one by one, against brute force."""

from __future__ import annotations

import numpy as np
import pytest

from running import slow
from sherkit.diagnosis import play_operator
from sherkit.evidence.run import one_after_another
from sherkit.evidence.whitening import Whitening, correlation_in_time, orthonormal, whiten


def test_an_orthonormal_basis_spans_its_columns() -> None:
    """Catches a rank taken wrong where columns repeat, differ in scale by powers of ten, or are zero."""
    rng = np.random.default_rng(0)
    columns = rng.normal(size=(80, 6)) * 10.0 ** np.arange(-6, 6, 2)
    columns[:, 3] = columns[:, 0] * 1e5 + columns[:, 5]
    columns[:, 2] = 0.0
    q = orthonormal(columns)
    assert q.shape == (80, 4)
    np.testing.assert_allclose(q.T @ q, np.eye(4), atol=1e-12)
    rest = columns - q @ (q.T @ columns)
    assert (np.linalg.norm(rest, axis=0) <= 1e-7 * np.linalg.norm(columns, axis=0).clip(1e-300)).all()


@pytest.mark.parametrize("rho", [0.0, -0.4, 0.9, *slow(0.3, 0.7)])
def test_the_correlation_in_time_is_recovered(rho: float) -> None:
    """Catches an estimate that the fit's own projection biases, or a correlation found in white noise.

    20 seeds each, 800 rows of 3 readings with 60 columns projected out: the mean within 4 standard errors and 0.01;
    zero for white noise in 18 of 20 (the threshold is three standard errors).
    """
    n, found = 800, []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        e = rng.normal(size=(n, 3))
        for k in range(1, n):
            e[k] = rho * e[k - 1] + np.sqrt(1 - rho * rho) * e[k]
        t = np.linspace(-1, 1, n)
        smooth = np.polynomial.legendre.legvander(t, 7)[:, 1:]
        columns = np.concatenate([rng.normal(size=(n, 3, 39)), np.zeros((n, 3, 21))], axis=2)
        for axis in range(3):
            columns[:, axis, 39 + 7 * axis : 46 + 7 * axis] = smooth
        q = orthonormal(columns)
        flat = e.ravel()
        found.append(correlation_in_time((flat - q @ (q.T @ flat)).reshape(n, 3), q))
    if rho == 0.0:
        assert sum(f == 0.0 for f in found) >= 18
    else:
        error = np.sqrt((1 - rho * rho) / (3 * n))
        assert abs(np.mean(found) - rho) < 4 * error / np.sqrt(20) + 0.01
        assert np.abs(np.array(found) - rho).max() < 6 * error


def test_the_filter_in_time_whitens() -> None:
    """Catches a filter that leaves a correlation or changes the variance, at the first row too."""
    rng = np.random.default_rng(4)
    rho = 0.7
    e = rng.normal(size=(3, 40_000))
    for k in range(1, 3):
        e[k] = rho * e[k - 1] + np.sqrt(1 - rho * rho) * e[k]
    covariance = np.cov(whiten(e, rho))
    np.testing.assert_allclose(covariance, np.eye(3), atol=0.03)
    assert whiten(e, 0.0) is e


def test_targets_that_are_read_in_turn_follow_their_own_in_time() -> None:
    """Catches a filter that takes a target for what follows another one of the same visit, in one block or in several,
    and a correlation within visits that is taken for one in time."""
    rng = np.random.default_rng(12)
    visits, rho = 400, 0.6
    e = rng.normal(size=(visits, 2))
    for k in range(1, visits):
        e[k] = rho * e[k - 1] + np.sqrt(1 - rho * rho) * e[k]
    e = np.stack([e, 2.0 * e + rng.normal(size=e.shape), rng.normal(size=e.shape)], axis=1)
    # the second target is not seen in the third visit
    seen = np.delete(np.arange(3 * visits), 7)
    rows, which = e.reshape(-1, 2)[seen], seen % 3
    lag, back = one_after_another(np.arange(3 * visits), np.arange(3 * visits) % 3, seen)
    assert back is not None
    filtered = Whitening(rho, lag, back)
    for target in range(3):
        own = which == target
        alone = Whitening(rho, lag[own])(rows[own])
        np.testing.assert_allclose(filtered(rows)[own], alone, atol=1e-14)
    shared = np.repeat(rng.normal(size=(visits, 2)), 3, axis=0) + 0.2 * rng.normal(size=(3 * visits, 2))
    _, back = one_after_another(np.arange(3 * visits), np.arange(3 * visits) % 3, np.arange(3 * visits))
    nothing = np.zeros((6 * visits, 0))
    assert correlation_in_time(shared, nothing) > 0.3
    assert correlation_in_time(shared, nothing, back) == 0.0


def test_play_follows_with_its_dead_zone() -> None:
    """Catches a play operator that forgets where it was, moves inside its zone, or lags by another width."""
    assert play_operator(np.array([0.0, 0.4, 1.0, 0.9, 0.3, -1.0, -0.8]), 1.0).tolist() == pytest.approx(
        [0.0, 0.0, 0.5, 0.5, 0.5, -0.5, -0.5]
    )
    q = np.cumsum(np.random.default_rng(0).normal(size=500))
    for width in (0.1, 2.0):
        out = play_operator(q, width)
        assert np.abs(out - q).max() <= 0.5 * width + 1e-12
        moved = np.diff(out) != 0
        assert (np.diff(out)[moved] * np.diff(q)[moved] > 0).all()
        np.testing.assert_allclose(np.abs(out - q)[1:][moved], 0.5 * width, atol=1e-12)
    np.testing.assert_array_equal(play_operator(q, 0.0), q)
