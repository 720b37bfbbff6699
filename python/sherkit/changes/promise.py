"""Whether a promise is broken: a test of the changes that would break it.

Every candidate is taken in sizes that leave an error of so many times what was promised, both ways, and the likelihood
ratios of these against "nothing has changed" are averaged: of all tests of a level the one that finds most of them
(Neyman and Pearson, 1933). Noise is unknown (Jeffreys' prior); what the calibration does not know is free, as large as
it is unknown. The level is counted on draws of noise at the very poses of the run, so that no candidates and no
correlations between them are approximated.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from ..base import linalg
from ..base.types import Floats
from ..evidence.base import Base
from ..evidence.whitening import orthonormal

#: Sizes of the error, in promises, that are looked for.
_SIZES = (1.2, 1.5, 2.0, 3.0, 6.0)
#: Combinations of an effect's parameters, drawn at random, and draws of noise.
_WAYS, _DRAWS = 24, 800
#: A part of a column that is rounding.
_ROUNDING = 1e-5
#: Errors, in promises, of which it is told whether they would have been found, and how often they must be.
_TOLD, _FOUND = (1.25, 1.5, 1.75, 2.0, 2.5, 3.0, 4.0, 6.0, 10.0), 0.95


@dataclass(frozen=True)
class Broken:
    """The ``chance`` that noise alone looks as much like a broken promise as these readings, and the least error, in
    promises, that would have been found at a level (infinite where none would)."""

    chance: float
    least: float


def broken(base: Base, stand: Floats, promised: float, level: float) -> Broken:
    """Tests a promise of a reading (root mean square, in noises) with the blocks of ``base``, whose first rows are the
    readings; ``stand`` (n, s) are the columns of where the sensor stands."""
    columns, ways, share = _ways(base, stand, promised)
    residual, free = base.residual, base.free
    if not len(share) or free < 2 or not residual.any():
        return Broken(1.0, np.inf)
    # noise is drawn along the columns (normal) and by the square of the rest (χ²): no draw has as many numbers as rows
    value, vector = linalg.eigh(columns.T @ columns)
    kept = np.flatnonzero(value > _ROUNDING**2 * value.max())[-free:]
    along = ways.T @ (vector[:, kept] * np.sqrt(value[kept]))
    gram = along @ along.T
    rng = np.random.default_rng(0)
    drawn = rng.normal(size=(len(kept), _DRAWS))
    rest = rng.chisquare(free - len(kept), _DRAWS) if free > len(kept) else np.zeros(_DRAWS)
    answers, left = along @ drawn, np.square(drawn).sum(axis=0) + rest
    squares = np.diag(gram)[:, None]
    whole = float(residual @ residual)
    seen = ways.T @ (columns.T @ residual)
    scale = np.sqrt(whole / free)
    still = _ratio(squares, share, scale * answers, scale**2 * left, free)
    # the draw that is seen counts too
    told_by = _ratio(squares, share, seen[:, None], np.array([whole]), free)[0]
    chance = float((still >= told_by).sum() + 1) / (_DRAWS + 1)
    # what would have been found is asked of the noise alone, as large as these rows allow it to be: of checks whose
    # noise happens to look small, too many would claim to have found it
    told = float((np.square(seen) / squares[:, 0]).max())
    scale = np.sqrt(max(whole - told, 1e-12 * whole) / scipy.stats.chi2.ppf(1.0 - _FOUND, free - 1))
    answers, left = scale * answers, scale**2 * left
    limit = float(np.quantile(_ratio(squares, share, answers, left, free), 1.0 - level))
    which = rng.choice(len(share), _DRAWS, p=share / share.sum())
    signs = rng.choice([-1.0, 1.0], _DRAWS)
    own = answers[which, np.arange(_DRAWS)]
    for size in _TOLD:
        moved = left + 2.0 * size * signs * own + size**2 * squares[which, 0]
        found = _ratio(squares, share, answers + size * signs * gram[:, which], moved, free)
        if float(np.mean(found > limit)) >= _FOUND:
            return Broken(chance, size)
    return Broken(chance, np.inf)


def _ways(base: Base, stand: Floats, promised: float) -> tuple[Floats, Floats, Floats]:
    """All columns (N, k) beside the base, coefficients (k, v) of them, each way an error of one promise, and the share
    of each."""
    rng = np.random.default_rng(0)
    basis, count, family = orthonormal(stand), len(stand), base.family
    raws = [family.run.flat(family.columns.raw(block.at)) for block in family.blocks]
    every = np.concatenate([np.zeros((len(base.residual), 0)), *raws], axis=1)
    left = every - base.basis @ (base.basis.T @ every)
    ways, share, start = [np.zeros((every.shape[1], 0))], [], 0
    for raw in raws:
        at = slice(start, start := start + raw.shape[1])
        mine = np.ones((1, 1)) if raw.shape[1] == 1 else rng.normal(size=(raw.shape[1], _WAYS))
        size, whole = shows(raw[:count] @ mine, basis), np.sqrt(np.square(raw @ mine).mean(axis=0))
        # what this stand or the calibration's own doubts take up is no error that could be seen
        known = (size > _ROUNDING * whole) & (np.square(left[:, at] @ mine).sum(axis=0) > _ROUNDING**2 * whole**2)
        some = np.zeros((every.shape[1], int(known.sum())))
        some[at] = mine[:, known] * (promised / size[known])
        ways.append(some)
        share += [1.0 / max(known.sum(), 1)] * int(known.sum())
    return left, np.concatenate(ways, axis=1), np.array(share)


def shows(columns: Floats, basis: Floats) -> Floats:
    """The root mean square (v,) that the stand of the sensor leaves of columns (n, v) of readings."""
    return np.asarray(np.sqrt(np.square(columns - basis @ (basis.T @ columns)).mean(axis=0)))


def _ratio(squares: Floats, share: Floats, answers: Floats, left: Floats, free: int) -> Floats:
    """Logarithms (d,) of the mean likelihood ratio for each of d residuals, but for a constant: by the ``squares``
    (v, 1) of the ways, the ``answers`` (v, d) of the residuals to them, and their own square ``left`` (d,)."""
    every = [
        np.log(share)[:, None] - 0.5 * free * np.log1p((size**2 * squares - 2.0 * sign * size * answers) / left)
        for size in _SIZES for sign in (-1.0, 1.0)
    ]  # fmt: skip
    found = np.concatenate(every)
    top = found.max(axis=0)
    return np.asarray(top + np.log(np.exp(found - top).sum(axis=0)))
