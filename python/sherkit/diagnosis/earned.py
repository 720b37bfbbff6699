"""Whether an effect of a model earns its place: the error on rows that neither fitted nor chose it, with and without.

Every row is held out in turn, in several deals of blocks. On the others all parameters are fitted, with the effect and
without it; where diagnosis chose the effect, the choice is made again without the rows held out, among all that could
stand in its place, and their gain counts only where it falls on the same effect. Paired differences of squared error,
averaged over the deals, are tested by flipping signs of whole poses. All is linear around the two full fits, each at
its own optimum, so that only Gram matrices are needed.

Sources: Stone, "Cross-validatory choice and assessment of statistical predictions", J. R. Stat. Soc. B 1974 (choice
inside each fold); the sign flips are those of :mod:`.scan`.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ..errors import SherkitError
from ..model.effect import Effect
from ..types import Floats, Ints
from .fitted_run import FittedRun
from .folds import Folds, root_of, solved, unit_length
from .stage import testable
from .waves import waves_of

#: Level of the test on rows held out.
LEVEL = 0.01
_FLIPS = 1999
#: Rivals that are fitted in full.
_REFITTED = 2
#: Part of a column's squared length that the fit must leave of it.
_LEFT = 1e-8


@dataclass(frozen=True)
class Earned:
    """What an effect brings on rows held out: RMS ``without`` it and ``with_it`` in the unit of the run, one-sided
    ``p``, and for what part of these rows it was chosen ``again`` without them."""

    effect: str
    without: float
    with_it: float
    p: float
    again: float

    @property
    def holds(self) -> bool:
        """Whether the effect lowers the error on rows held out, and not by chance."""
        return self.with_it < self.without and self.p <= LEVEL


@dataclass(frozen=True)
class _View:
    """A fit to first order: residuals (n, m) and columns (n, m, k) over the noise, and the same over one unit."""

    residual: Floats
    columns: Floats


def earned(
    run: FittedRun,
    effect: Effect,
    *,
    sigma: Floats,
    deals: Sequence[Ints],
    rivals: Sequence[Effect] | None = None,
    periods: Sequence[float] = (),
    also: Collection[str] = (),
    seed: int = 0,
) -> Earned:
    """What ``effect``, which is in the model of ``run``, brings given all others of the model but those of ``also``.

    ``deals`` are folds (n,) of all rows of the data; ``rivals`` what might have been chosen in its place, None where
    nobody chose, and ``periods`` others that might have been chosen for it. An effect without which the rows
    cannot be fitted earns its place.
    """
    axes = list(run.axes)
    rows = testable(run, np.flatnonzero(run.whole))
    scale = sigma[axes]
    fold = np.stack([deal[rows] for deal in deals])
    try:
        full = run.without_effects(also) if also else run
        less = full.without_effects((effect.name,))
        more = full.linearised(rows, (), scale)
        plain = less.linearised(rows, tuple(rivals or ()), scale)
    except SherkitError:
        return Earned(effect.name, np.inf, 0.0, 1.0 / (_FLIPS + 1), 1.0)
    with_it = _held_out(_View(more.residual, more.fitted), fold)
    without = _held_out(_View(plain.residual, plain.fitted), fold)
    chosen = np.ones(fold.shape, dtype=bool)
    if rivals or periods:
        others = [(rival, columns) for rival, columns in plain.effects if rival.name != effect.name]
        waves = [waves_of(plain, 1.0 / period) for period in periods]
        linear = _scores_of_sets(_View(plain.residual, plain.fitted), [*(by for _, by in others), *waves], fold)
        exact = [_scores(_View(more.residual, more.fitted), fold)]
        # what comes nearest to first order is fitted in full: far from zero its derivatives there do not tell
        for k in np.argsort(linear[: len(others)].mean(axis=(1, 2)))[:_REFITTED]:
            try:
                view = less.refit([(others[int(k)][0], None)]).linearised(rows, (), scale)
            except SherkitError:
                continue
            exact.append(_scores(_View(view.residual, view.fitted), fold))
        best = np.concatenate([np.stack(exact), linear]).min(axis=0)
        chosen = np.take_along_axis(exact[0] <= best, fold, axis=1)
    gain = ((without**2).sum(axis=2) - (with_it**2).sum(axis=2)) * chosen
    p = flipped(gain.mean(axis=0), more.group, seed)
    return Earned(
        effect.name,
        without=_rms(without, scale) * run.per_unit,
        with_it=_rms(with_it, scale) * run.per_unit,
        p=p,
        again=float(chosen.mean()),
    )


def flipped(gain: Floats, group: Ints, seed: int) -> float:
    """One-sided p of a positive sum of paired gains (n,), by flipping signs of whole groups (n,)."""
    per_pose = np.bincount(np.unique(group, return_inverse=True)[1], gain)
    signs = np.random.default_rng(seed).integers(0, 2, (_FLIPS, len(per_pose))) * 2.0 - 1.0
    return float((1 + (signs @ per_pose >= per_pose.sum()).sum()) / (_FLIPS + 1))


def held_out_rms(run: FittedRun, sigma: Floats, deals: Sequence[Ints]) -> float:
    """RMS of single readings held out, in the unit of the run, as :func:`earned` has it."""
    rows = testable(run, np.flatnonzero(run.whole))
    scale = sigma[list(run.axes)]
    view = run.linearised(rows, (), scale)
    fold = np.stack([deal[rows] for deal in deals])
    return _rms(_held_out(_View(view.residual, view.fitted), fold), scale) * run.per_unit


def _rms(values: Floats, scale: Floats) -> float:
    return float(np.sqrt(np.mean((values * scale) ** 2)))


def _held_out(view: _View, fold: Ints) -> Floats:
    """Errors (deals, n, m) of rows that were held out in turn."""
    n, m = view.residual.shape
    columns = unit_length(view.columns)
    out = np.empty((len(fold), n, m))
    for deal, of in enumerate(fold):
        folds = Folds.of(columns, view.residual, of)
        for k in np.unique(of):
            gram, right, _, _ = folds.outside(k)
            inside = of == k
            out[deal, inside] = view.residual[inside] - columns[inside] @ solved(gram, right)
    return out


def _scores(view: _View, fold: Ints) -> Floats:
    """Schwarz's criterion (deals, folds) of a fit to the rows outside each fold."""
    return _scores_of_sets(view, [np.zeros((*view.residual.shape, 0))], fold)[0]


def _scores_of_sets(view: _View, sets: Sequence[Floats], fold: Ints) -> Floats:
    """Schwarz's criterion (sets, deals, folds) of the fit with each set of columns (n, m, k) beside its own."""
    first = view.columns.shape[2]
    columns = np.concatenate([unit_length(view.columns), *(unit_length(one) for one in sets)], axis=2)
    ends = np.cumsum([0, *(one.shape[2] for one in sets)])
    out = np.empty((len(sets), len(fold), int(fold.max()) + 1))
    for deal, of in enumerate(fold):
        folds = Folds.of(columns, view.residual, of)
        for k in range(len(folds)):
            gram, b, total, count = folds.outside(k)
            base = root_of(gram[:first, :first])
            fitted = base.T @ b[:first]
            total -= float(fitted @ fitted)
            cross = base.T @ gram[:first, first:]
            gram, b = gram[first:, first:] - cross.T @ cross, b[first:] - cross.T @ fitted
            for j, (low, high) in enumerate(pairwise(ends)):
                root = root_of(gram[low:high, low:high], _LEFT)
                taken = root.T @ b[low:high]
                rank = base.shape[1] + root.shape[1]
                out[j, deal, k] = _schwarz(total - float(taken @ taken), rank, count)
    return out


def _schwarz(squares: float, rank: int, count: int) -> float:
    return float(count * np.log(max(squares, 1e-300)) + rank * np.log(count))
