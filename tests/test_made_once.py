"""What a diagnosis has made it does not make again, and what it leaves out changes no answer."""

from __future__ import annotations

import numpy as np
import pytest

import sherkit as sk
from sherkit.evidence.fitted_run import FittedRun
from sherkit.fit.folds import Beside
from strategies import EXAMPLE


@pytest.fixture(scope="module")
def data() -> sk.Measurements:
    """A leaning rail, each pose read twice."""
    virtual = sk.delta.VirtualDelta.draw(EXAMPLE, 3, rail_lean_rad=3e-3, noise_mm=0.005)
    return virtual.measure(sk.delta.paper_local(), repeats=2, order="shuffled", seed=4)


def test_an_effect_taken_out_again_leaves_what_it_was_added_to(data: sk.Measurements) -> None:
    """Catches a fit that is made twice, one that is not where the other way leads, and one of another noise or loss
    that is taken for it."""
    run = FittedRun(sk.identify(EXAMPLE, data))
    lean = run.model.known_effects["rail_lean"]
    more = run.refit([(lean, None)])
    assert run.refit([(lean, None)]) is more
    assert more.without_effects(["rail_lean"]) is run
    long_way = FittedRun(more.fit).without_effects(["rail_lean"])
    np.testing.assert_allclose(long_way.residuals, run.residuals, atol=1e-7)

    rows = np.arange(len(data))
    assert run.on(rows) is run
    assert run.on(rows[1:]) is not run
    assert run.on(rows, 2.0 * run.noise[0]) is not run
    robust = FittedRun(sk.identify(EXAMPLE, data, loss="huber"))
    assert robust.on(rows) is not robust
    assert robust.refit([(lean, None)]).without_effects(["rail_lean"]) is not robust


@pytest.mark.parametrize("counts", [(2, 1, 2), (3,), ()])
def test_sets_beside_fitted_columns_are_fitted_fold_by_fold(counts: tuple[int, ...]) -> None:
    """Catches a set whose products stand in the place of another's, and a fold that sees itself."""
    rng = np.random.default_rng(1)
    n, m, fitted = 60, 2, 3
    columns = rng.normal(size=(n, m, fitted + sum(counts)))
    residual = rng.normal(size=(n, m)) + columns[:, :, -1]
    fold = np.stack([rng.permutation(n) % 4 for _ in range(2)])
    beside = Beside(lambda rows: columns[rows], counts, residual, fold)
    assert beside.held_out.shape == (len(counts), 8)
    for k, first in enumerate(np.cumsum([fitted, *counts])[:-1].tolist()):
        with_set = np.concatenate([columns[:, :, :fitted], columns[:, :, first : first + counts[k]]], axis=2)
        for repetition in range(2):
            for one in range(4):
                inside = fold[repetition] == one
                a, b = (v.reshape(-1, with_set.shape[2]) for v in (with_set[~inside], with_set[inside]))
                x = np.linalg.lstsq(a, residual[~inside].ravel(), rcond=None)[0]
                f = 4 * repetition + one
                assert beside.held_out[k, f] == pytest.approx(((residual[inside].ravel() - b @ x) ** 2).sum())
