"""Noise that carries over from row to row, told apart from what is missing: the two look alike where rows are few.

A step in a short run makes neighbours alike, and a filter that takes this for noise hides the step and breeds waves.
So the correlation of the noise is chosen together with what is missing, by the likelihood of both.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..base.types import Floats
from .base import Base, log_bayes
from .blocks import Block
from .family import Family
from .run import Run
from .whitening import Whitening, correlation_in_time, orthonormal

#: Most blocks beside which the correlation is looked at.
_MOST = 4


def family_of(run: Run) -> Family:
    """The family of a run, under the filter in time that goes best with what may be missing."""
    if run.white.rho == 0.0:
        return Family(run)
    plain = replace(run, white=Whitening(0.0, run.white.lag, run.white.back))
    family = Family(plain)
    first = now = Base.of(family, plain)
    found: list[Block] = []
    best = _score(first, now, found, run.white), run.white
    while len(found) < _MOST:
        i = int(np.argmax(now.each))
        if now.each[i] < 0:
            break
        found.append(family.blocks[i])
        now = now.beside(found[-1])
        rho = correlation_in_time(plain.view.residual, now.basis, run.white.back)
        white = Whitening(rho, run.white.lag, run.white.back)
        best = max(best, (_score(first, now, found, white), white), key=lambda one: one[0])
    return family if best[1].rho == 0.0 else Family(replace(run, white=best[1]))


def _score(first: Base, now: Base, found: Sequence[Block], white: Whitening) -> float:
    """Logarithm of the likelihood of a run under a filter, with the prior weights of what was ``found``."""
    run = first.family.run

    def left(basis: Floats) -> float:
        flat = white(run.view.residual).reshape(-1)
        q = orthonormal(white(basis.reshape(len(run), run.axes, -1)))
        return float(np.square(flat - q @ (q.T @ flat)).sum())

    alone = left(first.basis)
    # the filter's determinant, on each axis
    out = run.axes * float(np.log(white.here).sum()) - 0.5 * first.free * np.log(max(alone, 1e-300))
    if found:
        rank, count = np.array([now.basis.shape[1] - first.basis.shape[1]]), len(first.residual)
        out += float(log_bayes(np.array([1.0 - left(now.basis) / max(alone, 1e-300)]), rank, first.free, count)[0])
        out += sum(float(first.family.log_weight[first.family.where(block)]) for block in found)
    return out
