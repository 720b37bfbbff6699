"""Held-out error with each single addition, by blocks, in linear approximation around the fit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..types import Floats, Ints
from .folds import Folds, solved, unit_length
from .scan import Columns
from .stage import Stage


@dataclass(frozen=True)
class HeldOutError:
    """Root mean square error of held-out readings and its standard error, from how much the blocks differ."""

    rms: float
    std: float


def held_out(stage: Stage, block: Ints) -> list[HeldOutError]:
    """Held-out error (in the unit of the run, axes together) with each candidate of a stage that is not thorough.

    ``block`` (n,) is the fold of each row.
    """
    view = stage.view
    added = [_unwhitened(stage, candidate.columns) for candidate in stage.candidates]
    # in the unit of the readings, so that axes count by their error
    columns = unit_length(np.concatenate([view.fitted, *added], axis=2) * stage.sigma[None, :, None])
    folds = Folds.of(columns, view.residual * stage.sigma, np.unique(block, return_inverse=True)[1].ravel())
    fitted = list(range(view.fitted.shape[2]))
    out, first = [], len(fitted)
    for one in added:
        out.append(_error(folds, fitted + list(range(first, first + one.shape[2])), stage.run.per_unit))
        first += one.shape[2]
    return out


def _unwhitened(stage: Stage, columns: Columns) -> Floats:
    """A candidate's columns before the filter in time."""
    n, m = stage.view.residual.shape
    if columns.functions:
        out = np.zeros((n, m, m * len(columns.functions)))
        for a in range(m):
            for j, k in enumerate(columns.functions):
                out[:, a, a * len(columns.functions) + j] = stage.family.functions[:, k]
        return out
    return stage.columns[:, :, list(columns.dense)]


def _error(folds: Folds, columns: list[int], unit: float) -> HeldOutError:
    """What blocks left out in turn show of a fit with these of the columns."""
    squares, index = np.empty(len(folds)), np.ix_(columns, columns)
    for k in range(len(folds)):
        gram, right, _, _ = folds.outside(k)
        x = solved(gram[index], right[columns])
        squares[k] = folds.squares[k] - 2 * x @ folds.right[k, columns] + x @ folds.grams[k][index] @ x
    count = int(folds.counts.sum())
    rms = float(np.sqrt(max(float(squares.sum()), 0.0) / count))
    apart = squares - rms**2 * folds.counts
    variance = float((apart**2).sum()) * len(folds) / max(len(folds) - 1, 1) / count**2
    # the error of a mean square is twice the root's size
    return HeldOutError(unit * rms, unit * np.sqrt(variance) / (2 * rms) if rms > 0 else 0.0)
