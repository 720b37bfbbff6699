"""What poses leave beyond their repeats (lack of fit), at a level that holds for heavy tails and unequal noise.

Residuals become normal scores of their signed ranks. The statistic is the sum over poses and axes of ``n · mean²``; its
null distribution is that of flipping the sign of every single reading, which is free under symmetric noise whatever
its variance. The cumulants of that distribution are known exactly, so that nothing needs to be drawn: p is the tail of
Pearson's type III distribution with the first three.

Sources: Hájek, Šidák, Sen, *Theory of Rank Tests*, 4.2 (signed ranks with normal scores); Draper and Smith, *Applied
Regression Analysis*, 2.1 (lack of fit against pure error). The cumulants are derived in :func:`_cumulants`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from ..base.types import Floats, Ints
from .fitted_run import FittedRun
from .tails import chi2_tail, pearson3_tail, ranks

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
