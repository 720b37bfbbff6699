"""Whether an effect of a model earns its place: the error on rows that neither fitted nor chose it, with and without.

Every row is held out in turn, in several folds of blocks. On the others all parameters are fitted, with the effect and
without it; where diagnosis chose the effect, the choice is made again without the rows held out, among all that could
stand in its place, and their gain counts only where it falls on the same effect. Paired differences of squared error,
averaged over them, are tested by flipping signs of whole poses. All is linear around the two full fits, each at
its own optimum, so that only Gram matrices are needed.

Sources: Stone, "Cross-validatory choice and assessment of statistical predictions", J. R. Stat. Soc. B 1974 (choice
inside each fold); the sign flips are those of :mod:`.scan`.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from .._core import walsh_hadamard
from ..base.types import Floats, Ints
from ..errors import SherkitError
from ..fit.folds import Beside, Folds, ranks_of, roots_of
from ..model.effect import Effect
from .fitted_run import FittedRun
from .held_out import Columns, folds_of, rms, squares_of
from .linearised import Linearised
from .scan import FLIPS, codes_of
from .sizes import displaces
from .stage import testable
from .waves import waves_of

#: Level of the test on rows held out.
LEVEL = 0.01
#: Rivals that are fitted in full.
_REFITTED = 2


@dataclass(frozen=True)
class HeldOutGain:
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


def held_out_gain(
    run: FittedRun,
    effect: Effect,
    *,
    sigma: Floats,
    repeated_folds: Sequence[Ints],
    rivals: Sequence[Effect] | None = None,
    periods: Sequence[float] = (),
    also: Collection[str] = (),
    beside: Columns | None = None,
    seed: int = 0,
) -> HeldOutGain:
    """What ``effect``, which is in the model of ``run``, brings given all others of the model but those of ``also``.

    ``repeated_folds`` are folds (n,) of all rows of the data; ``rivals`` what might have been chosen in its place, None
    where nobody chose, and ``periods`` others that might have been chosen for it; ``beside`` are columns that are
    fitted as well. An effect without which the rows cannot be fitted earns its place.
    """
    axes = list(run.axes)
    rows = testable(run, np.flatnonzero(run.whole))
    scale = sigma[axes]
    fold = np.stack([fold[rows] for fold in repeated_folds])
    try:
        full = run.without_effects(also) if also else run
        less = full.without_effects((effect.name,))
        more = full.linearised(rows, (), scale)
        plain = less.linearised(rows, tuple(rivals or ()), scale)
    except SherkitError:
        return HeldOutGain(effect.name, np.inf, 0.0, 1.0 / FLIPS, 1.0)
    with_it, of_more = squares_of(more, fold, beside)
    without, _ = squares_of(plain, fold, beside)
    chosen = np.ones(fold.shape, dtype=bool)
    if rivals or periods:
        others = [(rival, place) for rival, place in plain.effects if rival.name != effect.name]
        linear = _scores_beside(plain, [place for _, place in others], periods, fold)
        exact = [_scores(of_more)]
        # what comes nearest to first order is fitted in full: far from zero its derivatives there do not tell
        for k in np.argsort(linear[: len(others)].mean(axis=1))[:_REFITTED]:
            try:
                rival = less.refit([(others[int(k)][0], None)])
                view = rival.linearised(rows, (), scale)
            except SherkitError:
                continue
            # what fits only on another machine would not have been chosen
            if displaces(rival.fit, less.fit):
                continue
            exact.append(_scores(folds_of(view, fold)))
        best = np.concatenate([np.stack(exact), linear]).min(axis=0)
        chosen = (exact[0] <= best)[of_more.place]
    gain = (without.sum(axis=2) - with_it.sum(axis=2)) * chosen
    p = flipped(gain.mean(axis=0), more.group, seed)
    return HeldOutGain(
        effect.name,
        without=rms(without, scale) * run.per_row,
        with_it=rms(with_it, scale) * run.per_row,
        p=p,
        again=float(chosen.mean()),
    )


def flipped(gain: Floats, group: Ints, seed: int) -> float:
    """One-sided p of a positive sum of paired gains (n,), by flipping signs of whole groups (n,)."""
    pose = np.unique(group, return_inverse=True)[1].ravel()
    sums = np.bincount(codes_of(int(pose.max()) + 1, seed)[pose], gain, FLIPS).astype(np.float64)
    total = float(sums.sum())
    return float((1 + (walsh_hadamard(sums)[1:] >= total).sum()) / FLIPS)


def _scores(folds: Folds) -> Floats:
    """Schwarz's criterion (f,) of a fit to the rows outside each fold."""
    gram, right, squares, count = folds.outside
    root = roots_of(gram)
    fitted = (root.transpose(0, 2, 1) @ right[:, :, None])[:, :, 0]
    return _schwarz(squares - (fitted**2).sum(axis=1), ranks_of(root), count)


def _scores_beside(view: Linearised, effects: Sequence[slice], periods: Sequence[float], fold: Ints) -> Floats:
    """Schwarz's criterion (sets, f) of the fit to the rows outside each fold with each effect, or waves of each period,
    beside its own columns."""

    def columns(rows: slice) -> Floats:
        there = view.effects_in(rows)
        parts = [there[:, :, place] for place in effects]
        return np.concatenate([view.fitted(rows), *parts, *(waves_of(view, 1.0 / p, rows) for p in periods)], axis=2)

    counts = [*(place.stop - place.start for place in effects), *(2 * len(view.waving) for _ in periods)]
    folds = Folds.of(columns, view.residual, fold)
    beside = Beside(folds, len(folds.length) - sum(counts))
    count = folds.outside[3]
    sets = [slice(a, b) for a, b in pairwise(np.cumsum([0, *counts]).tolist())]
    return np.array([_schwarz(*beside.outside(one), count) for one in sets]).reshape(-1, len(folds))


def _schwarz(squares: Floats, rank: Ints, count: Floats) -> Floats:
    return np.asarray(count * np.log(np.maximum(squares, 1e-300)) + rank * np.log(count))
