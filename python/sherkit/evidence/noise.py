"""Noise that carries over from row to row, and axes of more noise, told apart from what is missing.

A step in a short run makes neighbours alike, and a filter that takes this for noise hides the step and breeds waves.
So the correlation of the noise is chosen together with what is missing, by the likelihood of both.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..base.types import Floats
from ..model.effect import Effect
from .base import Base, log_bayes
from .blocks import Block
from .family import Family
from .quick_waves import quick_wave_of
from .ripple import ripple_of
from .run import Run, shared_by_targets
from .settings import refined, unit_columns
from .thresholds import A_FEW, ALARM
from .whitening import InCommon, Whitening, correlation_in_time, orthonormal


def base_of(run: Run, effects: Sequence[Effect]) -> Base:
    """What is in the model of a run, under the filter in time and the weights of axes that go best with what may be
    missing.

    Where an effect moves one axis, that axis is as loud as the effect until it is in the model.
    """
    base = _weighed(run, effects)
    if run.of.is_exact:
        return base
    # waves with a period for each joint are too many to try all: those that take most beside all other effects
    found = [*(ripple_of(base, effect, alone=False) for effect, _ in run.view.periodic), quick_wave_of(base)]
    waves = [one for one in found if one is not None]
    if not waves:
        return base
    own = base.family.run
    return Base.of(base.family.having(waves), own)


def _weighed(run: Run, effects: Sequence[Effect]) -> Base:
    family = Family(run)
    first = now = Base.of(family, run)
    if run.of.is_exact:
        return first
    found: list[Block] = []
    best = -np.inf, run.white, np.ones(run.axes), now
    while True:
        loud = loudness(now)
        rho = correlation_in_time(run.residual.reshape(len(run), run.axes), now.basis, run.white.back)
        for white in [run.white, *([run.white.with_rho(rho)] if rho else []), *_by_pose(now)]:
            best = max(best, (_score(first, now, found, white, loud), white, loud, now), key=lambda one: one[0])
        i = int(np.argmax(now.each))
        if len(found) == A_FEW or now.each[i] < 0:
            break
        found.append(refined(now, family.blocks[i]))
        now = _beside(now, found[-1])
    _, white, loud, now = best
    shared = shared_by_targets(now.residual.reshape(len(run), run.axes), run.of.data.series[run.rows])
    weighed = replace(run.weighed(loud, effects), shared=shared)
    if white is run.white and weighed.of is run.of:
        if shared == run.shared:
            return first
        family = Family(weighed, made=(family.columns, family.blocks))
    else:
        family = Family(replace(weighed, white=white))
    return Base.of(family, family.run)


def _beside(base: Base, block: Block) -> Base:
    """A base with a block at its own setting: between two moments that are tried a step leaves a few rows, which pass
    for noise that neighbours share."""
    if block.effect is None or block.setting is None:
        return base.beside(block)
    return base.with_columns(unit_columns(base.family.run, block.effect, block.setting))


def _by_pose(base: Base) -> list[Whitening]:
    """The filter that takes out errors which visits of a pose share, as large as they are beside a base; none where
    there are none, or they are declared."""
    run = base.family.run
    own = base.own_errors() if run.white.in_common is None else None
    if own is None or own.evidence < ALARM:
        return []
    return [run.white.with_common(InCommon.part(run.view.repeated, own.part**2 / (1.0 + own.part**2)))]


def loudness(base: Base) -> Floats:
    """Root mean square of what is left on each axis (m,), in noises."""
    m = base.family.run.axes
    held = np.square(base.basis).sum(axis=1).reshape(-1, m).mean(axis=0)
    left = np.square(base.residual).reshape(-1, m).mean(axis=0)
    return np.sqrt(left / np.maximum(1.0 - held, 0.05)).clip(1e-300)


def _score(first: Base, now: Base, found: Sequence[Block], white: Whitening, loud: Floats) -> float:
    """Logarithm of the likelihood of a run under a filter and loudness of axes (m,), with the prior weights of what was
    ``found``."""
    run = first.family.run
    loud = loud / np.exp(np.log(loud).mean())
    # what is declared to be in common is taken out already
    beyond = white if run.white.in_common is None else white.in_time

    def left(basis: Floats) -> float:
        flat = (beyond(run.residual.reshape(len(run), run.axes)) / loud).reshape(-1)
        q = orthonormal(beyond(basis.reshape(len(run), run.axes, -1)) / loud[:, None])
        return float(np.square(flat - q @ (q.T @ flat)).sum())

    alone = left(first.basis)
    # the filter's determinant, on each axis; that of weights is one
    out = run.axes * white.log_determinant
    out -= 0.5 * first.free * np.log(max(alone, 1e-300))
    if found:
        rank, count = np.array([now.basis.shape[1] - first.basis.shape[1]]), len(first.residual)
        out += float(log_bayes(np.array([1.0 - left(now.basis) / max(alone, 1e-300)]), rank, first.free, count)[0])
        out += sum(float(first.family.log_weight[first.family.where(block)]) for block in found)
    return out
