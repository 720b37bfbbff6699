"""Held-out error of a fit and of each single addition, by blocks, in linear approximation around the fit.

Every fold needs only the Gram matrix of all columns over its rows; leaving a block out is a subtraction.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..types import Floats, Ints
from .scan import Columns
from .stage import Stage


@dataclass(frozen=True)
class HeldOutError:
    """Root mean square error of held-out readings and its standard error, from how much the blocks differ."""

    rms: float
    std: float


def held_out(stage: Stage, block: Ints) -> tuple[HeldOutError, list[HeldOutError]]:
    """Held-out error (in the unit of the run, axes together) of the fit itself and with each candidate.

    ``block`` (n,) is the fold of each row.
    """
    view = stage.view
    n, m = view.residual.shape
    physical: list[Floats] = []
    places: list[list[int]] = []
    p = view.fitted.shape[2]
    for candidate in stage.candidates:
        columns = _unwhitened(stage, candidate.columns)
        first = p + sum(c.shape[2] for c in physical)
        physical.append(columns)
        places.append(list(range(first, first + columns.shape[2])))
    z = np.concatenate([view.fitted, *physical, view.residual[:, :, None]], axis=2)
    z = z * stage.sigma[None, :, None]  # in the unit of the readings, so that axes count by their error
    scale = np.linalg.norm(z.reshape(n * m, -1), axis=0)
    scale[-1] = 1.0
    z = z / np.where(scale > 0, scale, 1.0)
    grams, counts = [], []
    for fold in np.unique(block):
        part = z[block == fold].reshape(-1, z.shape[2])
        grams.append(part.T @ part)
        counts.append(len(part))
    total = np.sum(grams, axis=0)
    fitted = list(range(p))
    unit = stage.run.per_unit
    base = _error(grams, counts, total, fitted, unit)
    return base, [_error(grams, counts, total, fitted + place, unit) for place in places]


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


def _error(
    grams: Sequence[Floats], counts: Sequence[int], total: Floats, columns: list[int], unit: float
) -> HeldOutError:
    """What blocks left out in turn show."""
    squares = []
    last = total.shape[0] - 1
    index = np.ix_(columns, columns)
    for gram in grams:
        rest = total - gram
        a = rest[index]
        value, vector = np.linalg.eigh(a)
        keep = value > 1e-11 * max(value[-1], 1e-300)
        x = vector[:, keep] @ ((vector[:, keep].T @ rest[columns, last]) / value[keep])
        squares.append(float(gram[last, last] - 2 * x @ gram[columns, last] + x @ gram[index] @ x))
    count = sum(counts)
    rms = float(np.sqrt(max(sum(squares), 0.0) / count))
    apart = np.array(squares) - rms**2 * np.array(counts)
    folds = len(squares)
    variance = float((apart**2).sum()) * folds / max(folds - 1, 1) / count**2
    # the error of a mean square is twice the root's size
    return HeldOutError(unit * rms, unit * np.sqrt(variance) / (2 * rms) if rms > 0 else 0.0)
