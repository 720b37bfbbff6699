"""The held-out error that people are shown, wherever they see it: every row predicted by a fit that did not see its
block, in several ways to cut the run into blocks.

All is linear around the full fit, so that a fit without a block is a subtraction of Gram matrices.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ..base import linalg
from ..base.types import Floats, Ints
from ..fit.error import ErrorSize, held_out_error
from ..fit.folds import Folds, roots_of
from .fitted_run import FittedRun
from .linearised import Linearised
from .stage import testable

#: Columns (b, m, k) of a stretch of rows.
Columns = Callable[[slice], Floats]

#: Held-out error over noise up to which what is left is as small as the noise.
PRAISE = 1.25
#: Readings for each parameter from which on what noise does to the parameters is next to nothing in any block.
_ENOUGH = 200
#: Noises that are drawn to know what they leave on rows held out.
_DRAWS = 999


def error_of(run: FittedRun, sigma: Floats, repeated_folds: Sequence[Ints]) -> ErrorSize:
    """The error of a fit on rows held out. ``sigma`` (columns,) weighs the readings."""
    return held_out_error(run.fit, sigma=sigma, repeated_folds=repeated_folds)


def rms(squares: Floats, scale: Floats) -> float:
    """Of squared errors (…, m) over the noise ``scale`` (m,)."""
    return float(np.sqrt(np.mean(squares * scale**2)))


def folds_of(view: Linearised, fold: Ints, columns: Columns | None = None) -> Folds:
    """What was fitted, or these ``columns``, by folds (repetitions, n)."""
    return Folds.of(columns or view.fitted, view.residual, fold)


def squares_of(view: Linearised, fold: Ints, beside: Columns | None = None) -> tuple[Floats, Folds]:
    """Squared errors (repetitions, n, m) of rows that were held out in turn, and the folds. Columns ``beside`` are
    fitted as well, where they are given."""

    def fitted(rows: slice) -> Floats:
        return view.fitted(rows) if beside is None else np.concatenate([view.fitted(rows), beside(rows)], axis=2)

    folds = folds_of(view, fold, fitted)
    parts = [folds.errors(fitted(rows), view.residual[rows], rows) for rows in view.blocks]
    return np.concatenate(parts, axis=1) ** 2, folds


def by_noise_alone(run: FittedRun, sigma: Floats, repeated_folds: Sequence[Ints], level: float, seed: int) -> float:
    """Root of the mean square, in noises, below which rows held out stay with a chance of 1 - ``level`` where the model
    lacks nothing.

    Few poses fix a model loosely, and a block that is held out lies beyond them: its error is noise and, of noise too,
    that of the parameters. ``sigma`` (columns,) is the noise; where repeats told it, it is itself uncertain. Of the
    noise all that counts are its products with the columns, normal with the Gram matrices as covariances: these are
    drawn.
    """
    rows = testable(run, np.flatnonzero(run.whole))
    if len(rows) * len(run.axes) > _ENOUGH * run.fit.rank:
        return 1.0
    folds = folds_of(run.linearised(rows, (), sigma[list(run.axes)]), np.stack([fold[rows] for fold in repeated_folds]))
    rng = np.random.default_rng(seed)
    each = [_drawn(folds.repetition(k), rng) for k in range(len(repeated_folds))]
    told = run.data.repeatability if run.noise[1] == "repeats" else None
    if told is not None:
        free = max(sum(told.degrees_of_freedom.values()), 1)
        each = [one * free / rng.chisquare(free, size=_DRAWS) for one in each]
    return float(np.sqrt(np.mean(np.quantile(each, 1.0 - level, axis=1))))


def _drawn(folds: Folds, rng: np.random.Generator) -> Floats:
    """Mean squares (draws,) of unit noise on rows held out."""
    root = _square_root(folds.grams)
    z = rng.normal(size=(_DRAWS, *root.shape[:2]))
    right = np.einsum("fkl,dfl->dfk", root, z)
    outside = roots_of(folds.outside[0])
    x = np.einsum("fkl,fml,dfm->dfk", outside, outside, right.sum(axis=1, keepdims=True) - right, optimize=True)
    seen = (root != 0.0).any(axis=1)
    beside = np.maximum(folds.counts - seen.sum(axis=1), 0)
    squares = (z**2 * seen).sum(axis=2) + rng.chisquare(np.maximum(beside, 1), size=x.shape[:2]) * (beside > 0)
    squares += np.einsum("dfk,fkl,dfl->df", x, folds.grams, x, optimize=True) - 2.0 * (x * right).sum(axis=2)
    return np.asarray(squares.sum(axis=1) / folds.counts.sum())


def _square_root(grams: Floats) -> Floats:
    """Matrices (f, k, k) whose products with their transposes are these."""
    value, vector = linalg.eigh(grams)
    return vector * np.sqrt(np.where(value > 1e-12 * value[:, -1:], value, 0.0))[:, None, :]
