"""What poses leave beyond their repeats (lack of fit), at a level that holds for heavy tails and unequal noise.

Residuals become normal scores of their signed ranks. The statistic is the sum over poses and axes of ``n · mean²``; its
null distribution is that of flipping the sign of every single reading, which is free under symmetric noise whatever
its variance. The cumulants of that distribution are known exactly, so that nothing needs to be drawn: p is the tail of
Pearson's type III distribution with the first three.

Sources: Hájek, Šidák, Sen, *Theory of Rank Tests*, 4.2 (signed ranks with normal scores); Draper and Smith, *Applied
Regression Analysis*, 2.1 (lack of fit against pure error). The cumulants are derived in :func:`_cumulants`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from ..base.types import Floats, Ints
from ..evidence.fitted_run import FittedRun

# -- Tails of distributions and what goes with them, by SciPy's special functions -----------------------------------

#: Halvings of an interval: to the last bit of what lies in it.
_HALVINGS = 60


def chi2_tail(x: Any, freedom: Any) -> Any:
    """Chance that χ² with ``freedom`` is beyond ``x``."""
    return scipy.special.chdtrc(freedom, np.maximum(x, 0.0))


def chi2_log_tail(x: Any, freedom: Any) -> Any:
    """Its logarithm; -inf where the chance is no number any more."""
    with np.errstate(divide="ignore"):
        return np.log(chi2_tail(x, freedom))


def f_tail(x: Any, over: Any, under: Any) -> Any:
    """Chance that F with these degrees of freedom is beyond ``x``."""
    return scipy.special.fdtrc(over, under, np.maximum(x, 0.0))


def normal_beyond(p: float) -> float:
    """What a standard Gaussian passes with the chance ``p``."""
    return float(-scipy.special.ndtri(p))


def pearson3_tail(x: float, skew: float, mean: float, std: float) -> float:
    """Chance that Pearson's type III variable with these moments is beyond ``x``: a gamma variable, moved."""
    z = (x - mean) / std
    if abs(skew) < 1e-6:
        return float(scipy.special.ndtr(-z))
    shape = 4.0 / skew**2
    at = max(shape + 2.0 * z / skew, 0.0)
    return float(scipy.special.gammaincc(shape, at) if skew > 0 else scipy.special.gammainc(shape, at))


def ranks(values: Floats) -> Floats:
    """Ranks from 1, equal values at their mean rank."""
    _, place, count = np.unique(values, return_inverse=True, return_counts=True)
    return (np.cumsum(count) - 0.5 * (count - 1.0))[place]


def rising_root(function: Callable[[float], float], low: float, high: float) -> float:
    """Where a function that rises from below zero at ``low`` to above at ``high`` passes it, by halving."""
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if function(middle) > 0 else (middle, high)
    return 0.5 * (low + high)


def z_score(gain: Floats, rank: Ints | np.integer[Any], total: float | Floats, free: int) -> Floats:
    """Wilson and Hilferty's z score of an F ratio with (rank, free - rank) degrees of freedom."""
    k = np.maximum(rank, 1)
    left = np.maximum(free - k, 1)
    ratio = (gain / k) / np.maximum((total - gain) / left, 1e-300)
    cube = np.cbrt(np.maximum(ratio, 0.0))
    a, b = 2.0 / (9.0 * k), 2.0 / (9.0 * left)
    z = ((1.0 - b) * cube - (1.0 - a)) / np.sqrt(a + b * cube * cube)
    return np.where(rank > 0, z, -np.inf)


# -- The test --------------------------------------------------------------------------------------------------------

#: An error of the poses' own counts from this part of the noise on: below it the whole error grows by less than 5 %.
_COUNTS = 0.3
#: Repeated poses, and readings beyond one a pose, that are needed.
_FEWEST = 10


@dataclass(frozen=True)
class LackOfFit:
    """``p`` of the test over all axes; ``own`` the error that each pose has of its own beyond what was declared, by
    axis, in the unit of the run; ``poses`` how many were repeated; ``counts`` whether it is significant and not
    small."""

    p: float
    own: dict[str, float]
    poses: int
    counts: bool

    @property
    def size(self) -> float:
        """Length of :attr:`own`."""
        return float(np.linalg.norm(list(self.own.values())))


def lack_of_fit(run: FittedRun, level: float) -> LackOfFit | None:
    """Whether poses are farther from the fit than their repeats are from one another.

    An error that the run declares for its poses (``pose_sigma_…``) is allowed for. None where too few were repeated.
    """
    cumulants, statistic, freedom = np.zeros(3), 0.0, 0.0
    own: dict[str, float] = {}
    size = noise = 0.0
    poses = 0
    for a in run.axes:
        used = run.used[:, a]
        group = np.unique(run.data.groups[used], return_inverse=True)[1]
        count = np.bincount(group)
        repeated = (count > 1)[group]
        within = int((count - 1).sum())
        between = int((count > 1).sum()) - len(run.fit.values) / len(run.axes)
        if between < _FEWEST or within < _FEWEST:
            continue
        left = run.residuals[used, a][repeated]
        group = np.unique(group[repeated], return_inverse=True)[1]
        count = np.bincount(group)
        mean = np.bincount(group, left) / count
        pure = float(((left - mean[group]) ** 2).sum() / within)
        declared = float(np.mean(run.data.pose_sigma[used, a] ** 2))
        beyond = (float((count * mean**2).sum()) / between - pure) / float(count.mean()) - declared
        own[run.names[a]] = run.per_unit * float(np.sqrt(max(beyond, 0.0)))
        size, noise = size + beyond, noise + pure + declared
        poses = max(poses, len(count))
        if declared:
            statistic += float((mean**2 / (declared + pure / count)).sum())
            freedom += between
        else:
            score = _scores(left)
            statistic += float((np.bincount(group, score) ** 2 / count).sum())
            cumulants += _cumulants(score, group, count)
    if not own:
        return None
    p = float(chi2_tail(statistic, freedom)) if freedom else _tail(statistic, cumulants)
    return LackOfFit(p, own, poses, p <= level and size > _COUNTS**2 * noise)


def _scores(values: Floats) -> Floats:
    """Normal scores of signed ranks."""
    rank = ranks(np.abs(values))
    return np.sign(values) * scipy.special.ndtri(0.5 * (1.0 + rank / (len(values) + 1.0)))


def _cumulants(score: Floats, group: Ints, count: Ints) -> Floats:
    """Mean, variance and third central moment of ``Σ (Σ ±s)² / n`` over groups, the signs independent.

    Of a group it is ``Σ s²/n`` and a quadratic form with zero diagonal, ``b_ij = s_i s_j / n``, whose variance is
    ``2 Σ b_ij²`` and whose third moment is ``8 Σ b_ij b_jk b_ki`` over distinct indices.
    """
    squares, fourths, sixths = (np.bincount(group, score**power) for power in (2, 4, 6))
    mean = (squares / count).sum()
    variance = 2.0 * ((squares**2 - fourths) / count**2).sum()
    third = 8.0 * ((squares**3 - 3.0 * squares * fourths + 2.0 * sixths) / count**3).sum()
    return np.array([mean, variance, third])


def _tail(statistic: float, cumulants: Floats) -> float:
    """Upper tail of Pearson's type III distribution with these cumulants."""
    mean, variance, third = cumulants
    if variance <= 0:
        return 1.0
    return pearson3_tail(statistic, third / variance**1.5, mean, np.sqrt(variance))


# -- Patterns of signs ------------------------------------------------------------------------------------------------

#: Patterns of signs under which a family is seen.
FLIPS = 2048


def codes_of(poses: int, seed: int, flips: int = FLIPS) -> Ints:
    """A code for each pose (poses,): pattern t flips those whose code shares an odd number of bits with t. No two poses
    always flip together, as long as there are codes."""
    rng = np.random.default_rng(seed)
    return rng.permutation(flips)[:poses] if poses <= flips else rng.integers(0, flips, poses)
