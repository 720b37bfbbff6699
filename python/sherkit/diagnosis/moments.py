"""Settings in time, made finer than the grid on which they are tried: the moment of a step, the lag of what follows."""

from __future__ import annotations

from functools import partial

import numpy as np

from ..base import linalg
from ..base.types import Floats, Ints
from .scan import Block
from .stage import Candidate, Stage

#: A lag is known no better than by this factor where a stand is; and so many are looked at between two of the grid.
_FINER = 9
#: Part of the longest row of columns below which a direction of them is none.
_NOTHING = 1e-9


def at_the_row(stage: Stage, candidate: Candidate) -> Candidate:
    """A step at a searched time to the row: the cut that leaves least.

    A step at a link is compared with the same columns without a step, since what is fitted holds them, or nearly so:
    of what each reading is off by the mean, of what a joint is off by its zero.
    """
    view = stage.view
    if candidate.effect.search != "time_s" or candidate.setting is None or view.time is None:
        return candidate
    time, e = view.time, view.residual
    n = len(e)
    near = int(np.searchsorted(time, candidate.setting))
    reach = n // 20 + 2
    cuts = np.arange(max(near - reach, 2), min(near + reach, n - 2))
    place = next((at for effect, at in view.in_time if effect.name == candidate.name), None)
    if place is None:
        total, sums = e.sum(axis=0), np.cumsum(e, axis=0)
        before = sums[cuts - 1]
        gain = ((before - cuts[:, None] / n * total) ** 2).sum(axis=1) / (cuts * (n - cuts) / n)
    else:
        gain = _of_columns(np.concatenate([view.effects_in(rows)[:, :, place] for rows in view.blocks]), e, cuts)
    cut = int(cuts[np.argmax(gain)])
    # between the last reading before and the first after
    return Candidate(candidate.effect, candidate.columns, float(0.5 * (time[cut - 1] + time[cut])))


def _of_columns(columns: Floats, e: Floats, cuts: Ints) -> Floats:
    """Sum of squares (c,) of residuals (n, m) that columns (n, m, k) take from each cut on beside themselves."""
    first, last = int(cuts[0]), int(cuts[-1]) + 1
    whole = np.einsum("nmk,nml->kl", columns, columns)
    scale = np.sqrt(np.diag(whole))
    columns = (
        columns[:, :, scale > _NOTHING * scale.max(initial=0.0)] / scale[scale > _NOTHING * scale.max(initial=0.0)]
    )

    def since(rows: slice) -> tuple[Floats, Floats]:
        return np.einsum("nmk,nml->nkl", columns[rows], columns[rows]), np.einsum("nmk,nm->nk", columns[rows], e[rows])

    gram, along = (one.sum(axis=0) for one in since(slice(None)))
    before = [one.sum(axis=0) for one in since(slice(0, first))]
    grams, alongs = (b + np.cumsum(one, axis=0) for b, one in zip(before, since(slice(first, last)), strict=True))
    # the sums up to a cut hold the rows before it alone
    grams = np.concatenate([before[0][None], grams])[: len(cuts)]
    alongs = np.concatenate([before[1][None], alongs])[: len(cuts)]
    inverse = linalg.pinv(gram, hermitian=True)
    left = grams - grams @ inverse @ grams
    of = alongs - grams @ inverse @ along
    return np.einsum("ck,ckl,cl->c", of, linalg.pinv(left, rcond=1e-9, hermitian=True), of)


def best_lag(stage: Stage, best: Candidate, at_once: tuple[float, Candidate] | None) -> Candidate:
    """An effect at the lag that leaves least, between those of the grid; at that of the model where a lag is not worth
    its number."""
    behind = next((one for effect, one in stage.view.lagging if effect.name == best.name), None)
    if best.setting is None or behind is None:
        return best

    def columns(lag: float, rows: slice, block: Block) -> Floats:
        del block
        return stage.filtered.on(behind(lag), rows)

    lags = best.setting * 2.0 ** np.linspace(-1.0, 1.0, _FINER)
    image = stage.scan.image([partial(columns, lag) for lag in lags.tolist()])
    left = np.array([image.rss(k) for k in range(len(lags))])
    finest = int(np.argmin(left))
    if at_once is not None:
        total, n = stage.scan.sum_of_squares, stage.scan.n * stage.scan.m
        # Schwarz's price of one number more
        if n * np.log((total - at_once[0]) / max(left[finest], np.finfo(float).tiny)) < np.log(n):
            return at_once[1]
    return Candidate(best.effect, best.columns, float(lags[finest]))
