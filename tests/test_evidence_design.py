"""Before rows are read: power, what poses show, and how far rivals stay apart."""

from __future__ import annotations

import numpy as np
import pytest

from sherkit.evidence.design import Rival, exchanged, power, showing, squares_of, telling, times_found


def test_power_is_that_of_the_test() -> None:
    """Catches a square that is none, a level on the wrong side, degrees of freedom exchanged: against 20,000 draws,
    within four standard errors."""
    rng = np.random.default_rng(1)
    own = np.square(rng.normal(size=(20_000, 3)) + np.array([2.5, 0.0, 0.0])).sum(axis=1)
    noise = np.square(rng.normal(size=(20_000, 12))).sum(axis=1)
    for free, asked in ((np.inf, own), (12.0, own / noise * 12.0)):
        null = np.square(rng.normal(size=(200_000, 3))).sum(axis=1)
        null = null / (np.square(rng.normal(size=(200_000, 12))).sum(axis=1) / 12.0 if free < np.inf else 1.0)
        share = float((asked > np.quantile(null, 0.95)).mean())
        assert power(2.5**2, 3, 0.05, free) == pytest.approx(share, abs=0.02)
        times = times_found(0.8, np.array([2.5**2]), 3, 0.05, free)
        assert power((2.5 * times) ** 2, 3, 0.05, free) == pytest.approx(0.8)
        assert power(0.0, 3, 0.05, free) == pytest.approx(0.05)
    assert power(9.0, 0, 0.05) == power(9.0, 1, 0.05, 0) == 0.0
    assert times_found(0.8, np.array([2.5**2]), 0, 0.05) == np.inf


def test_directions_of_an_effect_have_its_size_and_are_spread() -> None:
    """Catches directions along the axes alone, a mean of squares that is another one, and a size that is found in 80 of
    100 for directions that the fit takes as well as for those that it leaves."""
    left = np.diag([4.0, 1.0, 0.0])
    squares = squares_of(left)
    assert squares.mean() == pytest.approx(5.0, rel=0.1)
    assert squares.min() < 0.3
    some = times_found(0.8, squares, 2, 0.01)
    assert some > 1.2 * times_found(0.8, squares.mean(keepdims=True), 2, 0.01)
    assert times_found(0.8, np.zeros(3), 2, 0.01) == np.inf
    assert squares_of(np.array([[7.0]])) == pytest.approx([7.0])


def test_an_exchange_ends_where_no_single_one_helps() -> None:
    """Catches an exchange that makes it worse, stops early, or takes a pose twice: against every single exchange."""
    rows = np.random.default_rng(2).normal(size=(14, 2, 4))

    def told(chosen: list[int]) -> float:
        return float(np.linalg.slogdet(np.einsum("nar,nas->rs", rows[chosen], rows[chosen]))[1])

    begun = showing(rows, 1e-6 * np.eye(4), (), 5)
    chosen = exchanged(rows, [0, 1, 2, 3, 4])
    assert len(set(begun)) == len(set(chosen)) == 5
    assert told(exchanged(rows, begun)) >= told(begun)
    for k in range(5):
        for other in set(range(14)) - set(chosen):
            assert told([*chosen[:k], other, *chosen[k + 1 :]]) <= told(chosen) + 1e-9


def test_a_rival_is_as_far_as_its_refit_is() -> None:
    """Catches a pose whose separation is not that of all rows fitted anew, and a direction that nothing observes which
    counts: against least squares over all rows, for each pose."""
    rng = np.random.default_rng(3)
    columns, apart = rng.normal(size=(30, 5)), rng.normal(size=30)
    columns[:, 4] = 0.0
    new, away = rng.normal(size=(6, 2, 5)), rng.normal(size=(6, 2))

    def left(chosen: list[int]) -> float:
        x = np.concatenate([columns, *new[chosen]])
        y = np.concatenate([apart, *away[chosen]])
        return float(np.square(y - x @ np.linalg.lstsq(x, y, rcond=None)[0]).sum())

    rival = Rival.of(columns, apart)
    np.testing.assert_allclose(rival.separations(new, away), [left([k]) for k in range(6)], rtol=1e-5)
    assert rival.joined(new[2], away[2]).separation == pytest.approx(left([2]) ** 0.5)
    poses, reached = telling([(rival, [(new, away)] * 4)], 4)
    assert len({k for k, _ in poses}) == 4
    assert poses[0][0] == int(np.argmax([left([k]) for k in range(6)]))
    assert reached[0] == poses[-1][1] == pytest.approx(left([k for k, _ in poses]) ** 0.5, rel=1e-5)
