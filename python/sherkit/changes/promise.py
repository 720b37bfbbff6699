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

from ..adaptive.evidence import Evidence
from ..base.types import Floats
from ..diagnosis.linearised import orthonormal

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


def broken(evidence: Evidence, stand: Floats, promised: float, level: float) -> Broken:
    """Tests a promise of a reading (root mean square, in its unit) with the candidates of ``evidence``, whose first
    rows are the readings; ``stand`` (n, s) are the columns of where the sensor stands."""
    columns, share = _ways(evidence, stand, promised)
    if not len(share) or evidence.free < 2 or not evidence.residual.any():
        return Broken(1.0, np.inf)
    rng, residual, free = np.random.default_rng(0), evidence.residual, evidence.free
    drawn = rng.normal(size=(len(residual), _DRAWS))
    drawn = drawn - evidence.basis @ (evidence.basis.T @ drawn)
    whole = float(residual @ residual)
    still = _ratio(columns, share, np.sqrt(whole / free) * drawn, free)
    # the draw that is seen counts too
    chance = float((still >= _ratio(columns, share, residual[:, None], free)[0]).sum() + 1) / (_DRAWS + 1)
    # what would have been found is asked of the noise alone
    told = float((np.square(columns.T @ residual) / np.square(columns).sum(axis=0)).max())
    drawn = np.sqrt(max(whole - told, 1e-12 * whole) / (free - 1)) * drawn
    limit = float(np.quantile(_ratio(columns, share, drawn, free), 1.0 - level))
    which = rng.choice(len(share), _DRAWS, p=share / share.sum())
    signs = rng.choice([-1.0, 1.0], _DRAWS)
    for size in _TOLD:
        moved = drawn + size * signs * columns[:, which]
        if float(np.mean(_ratio(columns, share, moved, free) > limit)) >= _FOUND:
            return Broken(chance, size)
    return Broken(chance, np.inf)


def _ways(evidence: Evidence, stand: Floats, promised: float) -> tuple[Floats, Floats]:
    """What is left (N, v) of every candidate, each way an error of one promise, and the share of each."""
    rng = np.random.default_rng(0)
    basis = orthonormal(stand)
    columns, share = [np.zeros((len(evidence.residual), 0))], []
    for name in evidence.place:
        raw = evidence.tried[name][:, 0]
        ways = np.ones((1, 1)) if raw.shape[1] == 1 else rng.normal(size=(raw.shape[1], _WAYS))
        whole = raw @ ways
        size = shows(whole[: len(stand)], basis)
        # what this stand or the calibration's own doubts take up is no error that could be seen
        known = size > _ROUNDING * np.sqrt(np.square(whole).mean(axis=0))
        unit = whole[:, known] * (promised / size[known])
        columns.append(unit - evidence.basis @ (evidence.basis.T @ unit))
        share += [1.0 / max(known.sum(), 1)] * int(known.sum())
    return np.concatenate(columns, axis=1), np.array(share)


def shows(columns: Floats, basis: Floats) -> Floats:
    """The root mean square (v,) that the stand of the sensor leaves of columns (n, v) of readings."""
    return np.asarray(np.sqrt(np.square(columns - basis @ (basis.T @ columns)).mean(axis=0)))


def _ratio(columns: Floats, share: Floats, residuals: Floats, free: int) -> Floats:
    """Logarithms (d,) of the mean likelihood ratio for each of the residuals (N, d), but for a constant."""
    answers = columns.T @ residuals
    squares = np.square(columns).sum(axis=0)[:, None]
    left = np.square(residuals).sum(axis=0)
    every = [
        np.log(share)[:, None] - 0.5 * free * np.log1p((size**2 * squares - 2.0 * sign * size * answers) / left)
        for size in _SIZES for sign in (-1.0, 1.0)
    ]  # fmt: skip
    found = np.concatenate(every)
    top = found.max(axis=0)
    return np.asarray(top + np.log(np.exp(found - top).sum(axis=0)))
