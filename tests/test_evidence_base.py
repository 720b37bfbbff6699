"""What is asked of a base: gains, Bayes factors, errors of rows held out, power."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.integrate
from hypothesis import given
from hypothesis import strategies as st

import sherkit._core as _core
from sherkit.errors import SherkitError
from sherkit.evidence.base import Base, log_bayes
from sherkit.evidence.design import power
from sherkit.evidence.family import Family
from sherkit.evidence.thresholds import HELD_SHAPE
from sherkit.evidence.whitening import InCommon, Whitening, independent
from test_evidence_family import run_of_two_joints


def base_of(**about: object) -> Base:
    run = run_of_two_joints(**about)  # type: ignore[arg-type]
    return Base.of(Family(run), run)


@pytest.mark.parametrize("rho", [0.0, 0.5])
def test_a_gain_is_that_of_least_squares(rho: float) -> None:
    """Catches a downdate of the wrong block, a rank that counts what the model holds, and a base that forgets what was
    put in before."""
    base = base_of(rho=rho, visits=2)
    family = base.family
    first = next(b for b in family.blocks if b.shape == "interaction")
    for one in (base, base.beside(first), base.beside(first, family.blocks[5])):
        gain, rank = one.gains
        for i in range(0, len(family), 37):
            columns = family.columns.of(family.blocks[i].at)
            with_it = independent(np.concatenate([one.basis, columns], axis=1))
            y = base.family.run.residual
            expected = one.rss - float(np.square(y - with_it @ (with_it.T @ y)).sum())
            # the ridge of what counts as held takes a thousandth, and more of what is nearly held
            least = np.linalg.svd(columns - one.basis @ (one.basis.T @ columns), compute_uv=False).min()
            assert gain[i] == pytest.approx(expected, rel=0.02 + HELD_SHAPE / max(least, 1e-9) ** 2, abs=1e-3)
            assert rank[i] <= with_it.shape[1] - one.basis.shape[1] + 1e-9
        assert one.gains[1][family.blocks.index(first)] == (0 if one is not base else len(first.at))


def test_a_bayes_factor_is_the_integral_that_it_stands_for() -> None:
    """Catches a prior of another width or noise, against numerical integration over a coefficient and the noise."""
    rng = np.random.default_rng(4)
    n, scale = 30, 2.0
    x = rng.normal(size=n)
    x /= np.linalg.norm(x)
    y = 2.5 * x + rng.normal(size=n)
    fitted = float(x @ y)
    rss = float(y @ y)

    def likelihood(log_noise: float, with_it: bool) -> float:
        noise = np.exp(log_noise)
        if not with_it:
            return float(np.exp(-n * log_noise - 0.5 * rss / noise**2))
        prior = scale * noise * np.sqrt(n)
        sd = 1.0 / np.sqrt(1.0 / noise**2 + 1.0 / prior**2)
        mean = fitted * sd**2 / noise**2
        return float(sd / prior * np.exp(-n * log_noise - 0.5 * rss / noise**2 + 0.5 * (mean / sd) ** 2))

    both = [scipy.integrate.quad(likelihood, -3, 3, args=(k,), epsabs=0)[0] for k in (True, False)]
    told = log_bayes(np.array([fitted**2 / rss]), np.array([1.0]), n, n, np.array([scale]))
    assert float(told[0]) == pytest.approx(np.log(both[0] / both[1]), abs=1e-6)


def test_errors_of_rows_held_out_are_those_of_other_fits() -> None:
    """Catches a step for a fold that is wrong by the rows it leaves: every fold is fitted anew."""
    base = base_of(visits=2).beside()
    y = base.family.run.residual
    fold = base.family.run.poses % 4
    told = base.held_out([fold])[0]
    each = np.repeat(fold, 2)
    for k in range(4):
        inside, outside = each == k, each != k
        x = np.linalg.lstsq(base.basis[outside], y[outside], rcond=None)[0]
        assert told[inside] == pytest.approx(np.square(y[inside] - base.basis[inside] @ x))


def test_nothing_hidden_raises_no_alarm_and_a_wave_does() -> None:
    """Catches evidence without its weights: of noise alone many blocks would say something. Level: one in a hundred
    draws comes to 100 to 1; twelve seeds here, fixed."""
    run = run_of_two_joints(rows=120)
    family = Family(run)
    block = next(b for b in family.blocks if b.shape == "periodic" and b.pattern == "q1_mm" and b.period < 0.2)
    wave = family.columns.of(block.at)[:, 0]
    for seed in range(12):
        noise = np.random.default_rng(seed).normal(size=240)
        plain = Base.of(family, run)
        for size in (0.0, 12.0):
            y = noise + size * wave
            left = y - plain.basis @ (plain.basis.T @ y)
            base = Base(family, plain.basis, left, plain.left, family.columns.products(left[:, None])[:, 0])
            assert (base.evidence > np.log(100.0)) == (size > 0), (seed, size, base.evidence)
        assert family.blocks[int(np.argmax(base.each))].pattern == "q1_mm"


def test_an_error_of_its_own_at_each_pose() -> None:
    """Catches poses that vary by more than their visits do and are taken for noise, and noise for such an error."""
    run = run_of_two_joints(rows=120, visits=3)
    family, rng = Family(run), np.random.default_rng(5)
    plain = Base.of(family, run)
    own = rng.normal(size=(40, 2))[run.poses].ravel()
    noise = rng.normal(size=240)
    for size in (0.0, 1.0):
        y = noise + size * own
        left = y - plain.basis @ (plain.basis.T @ y)
        found = Base(family, plain.basis, left, plain.left, plain.right).own_errors()
        assert found is not None
        assert (found.evidence > np.log(100.0)) == (size > 0)
        assert found.part == pytest.approx(size, abs=0.3)


def test_power_is_that_of_a_test() -> None:
    """Catches a non-centrality that is no square, against draws. 4,000 of them: within four standard errors."""
    rng = np.random.default_rng(6)
    z = rng.normal(size=(4000, 2)) + np.array([3.0, 0.0])
    drawn = float((np.square(z).sum(axis=1) > -2.0 * np.log(0.01)).mean())
    assert power(9.0, 2.0, 0.01) == pytest.approx(drawn, abs=0.032)


def _in_numpy(grams: np.ndarray, right: np.ndarray, least: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A second way: each block by itself, without columns of which nothing is left, by singular values."""
    gain, rank = np.zeros(len(grams)), np.zeros(len(grams))
    for b, (gram, own) in enumerate(zip(grams, right, strict=True)):
        there = np.diag(gram) > least[b]
        inside = gram[np.ix_(there, there)] + least[b] * np.eye(int(there.sum()))
        gain[b], rank[b] = own[there] @ np.linalg.pinv(inside, hermitian=True) @ own[there], there.sum()
    return gain, rank


@given(st.integers(0, 2**32 - 1), st.integers(1, 7), st.integers(0, 4), st.booleans())
def test_the_core_asks_blocks_as_numpy_does(seed: int, width: int, new: int, copies: bool) -> None:
    """Catches rounding that counts as a column, a pivot of nearly equal columns that is negative, a right side of
    columns that are not there: random blocks, some of whose columns the model holds, or are copies of each other."""
    rng = np.random.default_rng(seed)
    columns = rng.normal(size=(40, 12))
    if copies:
        columns[:, 1] = columns[:, 0] + 1e-9 * columns[:, 1]
    q = np.linalg.qr(np.concatenate([columns[:, 3:4], rng.normal(size=(40, 4))], axis=1))[0][:, :new]
    columns /= np.linalg.norm(columns, axis=0)
    left = columns - q @ (q.T @ columns)
    at = np.stack([rng.permutation(12)[:width] for _ in range(5)])
    grams = np.stack([left[:, one].T @ left[:, one] for one in at])
    right, least = left.T @ rng.normal(size=40), np.array([1e-6, 4e-4, 1e-6, 0.1, 1e-3])
    # as parts of larger ones, which do not lie in one piece
    larger = np.pad(grams, ((0, 0), (0, 1), (1, 2)))[:, :-1, 1:-2]
    gain, rank = _core.blocks_taken(larger, right[at], least)
    expected = _in_numpy(grams, right[at], least)
    np.testing.assert_array_equal(rank, expected[1])
    np.testing.assert_allclose(gain, expected[0], rtol=1e-7, atol=1e-12)


def test_the_core_refuses_blocks_of_another_shape() -> None:
    """Catches a panic, or a traceback of another kind, for shapes that do not fit."""
    grams = np.ones((2, 3, 3))
    for inside, right, least in ((grams, (2, 2), 2), (grams, (2, 3), 3), (grams[:, :2], (2, 3), 2)):
        with pytest.raises(SherkitError):
            _core.blocks_taken(inside, np.ones(right), np.ones(least))


@pytest.mark.parametrize("rho", [0.0, 0.4])
def test_errors_that_rows_have_in_common_are_taken_out(rho: float) -> None:
    """Catches a filter whose noise is not white: the covariance of a part in common, by matrices, becomes one of equal
    rows, the filter's transpose is its own, and what it takes out can be put back."""
    pose = np.array([7, 3, 7, 7, 5, 3])
    own = InCommon.part(pose, 0.8)
    filtered = own(np.eye(6))
    covariance = 0.2 * np.eye(6) + 0.8 * (pose[:, None] == pose)
    np.testing.assert_allclose(filtered @ covariance @ filtered.T, np.eye(6), atol=1e-12)
    np.testing.assert_allclose(own.back(filtered), np.eye(6), atol=1e-12)
    white = Whitening(rho, np.ones(6, dtype=np.int64), None, own)
    np.testing.assert_allclose(white.transposed(np.eye(6)), white(np.eye(6)).T, atol=1e-12)
