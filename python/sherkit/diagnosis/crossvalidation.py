"""Held-out error with each single addition, by blocks, in linear approximation around the fit."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ..base.types import Floats, Ints
from ..fit.folds import Beside, Folds
from .stage import Stage


@dataclass(frozen=True)
class HeldOutError:
    """Root mean square error of held-out readings and its standard error, from how much the blocks differ."""

    rms: float
    std: float


def held_out(stage: Stage, fold: Ints) -> list[HeldOutError]:
    """Held-out error (in the unit of the run, axes together) with each candidate of a stage that is not thorough.

    ``fold`` (repetitions, n) is the fold of each row in each repetition.
    """
    view, sigma = stage.view, stage.sigma[None, :, None]

    def columns(rows: slice) -> Floats:
        parts = [view.fitted(rows), *(stage.raw(c.columns, rows) for c in stage.candidates)]
        # in the unit of the readings, so that axes count by their error
        return np.concatenate(parts, axis=2) * sigma

    folds = Folds.of(columns, view.residual * stage.sigma, fold)
    ends = np.cumsum([0, *(len(stage.scan.numbers(c.columns)) for c in stage.candidates)]).tolist()
    beside = Beside(folds, stage.scan.fitted)
    return [_error(folds, beside.held_out(slice(a, b)), stage.run.per_row) for a, b in pairwise(ends)]


def _error(folds: Folds, squares: Floats, unit: float) -> HeldOutError:
    """What blocks left out in turn show. Every repetition is of the same rows: it is known no better than from one."""
    repetitions, count = len(folds.place), int(folds.counts.sum())
    rms = float(np.sqrt(max(float(squares.sum()), 0.0) / count))
    apart = squares - rms**2 * folds.counts
    per_repetition = len(folds) / repetitions
    variance = float((apart**2).sum()) * per_repetition / max(per_repetition - 1, 1) * repetitions / count**2
    # the error of a mean square is twice the root's size
    return HeldOutError(unit * rms, unit * np.sqrt(variance) / (2 * rms) if rms > 0 else 0.0)
