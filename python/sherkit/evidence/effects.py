"""Blocks of effects: those of the catalogue and the user's own, at every setting that is searched for."""

from __future__ import annotations

import numpy as np

from ..base.types import Floats
from .linearised import Linearised
from .made import Maker, Piece
from .waves import waves_along

#: Time constants that are tried, each half of the one before, and the fewest readings in one of them.
_LAGS, _READINGS_BEHIND = 8, 4.0


def blocks_of_effects(made: Maker) -> None:
    """Adds a block for each effect that can be tried, and for each setting of those that have one."""
    view = made.view
    every = view.effects_in(view.whole)
    for effect, at in view.effects:
        made.add("effect", (), [made.whole(every[:, :, at])], effect=effect)
    moments = made.moments
    after = np.stack([made.since(moment) for moment in moments], axis=1) if moments else np.zeros((len(view), 0))
    for effect, place in view.in_time:
        if not moments:
            continue
        # a step of each reading, or of the columns of the effect
        carriers = np.ones((len(view), 1)) if place is None else every[:, :, place]
        wide = view.axes if place is None else carriers.shape[-1]
        part = made.part(after, carriers)
        for k, moment in enumerate(moments):
            made.add("effect", (), [(part, k * wide + np.arange(wide))], effect=effect, setting=moment)
    for effect, behind in view.lagging:
        for lag in lags_of(made.like):
            made.add("effect", (), [made.whole(behind(lag)(view.whole))], effect=effect, setting=lag)
    # a period that the robot file declares may be wrong
    searched = [effect for effect, _ in view.periodic]
    if not searched:
        return
    names = view.waving
    reach = max(float(np.ptp(made.like.inputs[name])) for name in names)
    if not reach > 0:
        return
    counts = max((waves_along(made.like.inputs[name]) for name in names), key=len)
    parts = [
        made.waves(2.0 * np.pi * view.inputs[name] / reach, counts, view.patterns[name][:, :, None]) for name in names
    ]
    for effect in searched:
        for k, count in enumerate(counts.tolist()):
            pieces: list[Piece] = [(part, np.array([k, len(counts) + k])) for part in parts]
            made.add("effect", (), pieces, effect=effect, setting=reach / count)


def lags_of(view: Linearised) -> list[float]:
    """Time constants, s, that are tried, from the length of the run to a few readings: what is slower goes by what the
    temperature has summed up to; what is quicker has followed."""
    if view.time is None:
        return []
    length = float(np.ptp(view.time))
    least = max(_READINGS_BEHIND * length / len(view), length / 2.0**_LAGS)
    return [float(lag) for lag in length / 2.0 ** np.arange(_LAGS) if lag >= least]


def stepped(columns: Floats, cut: int) -> Floats:
    """Columns (n, m, k) from a row on."""
    return np.where((np.arange(len(columns)) >= cut)[:, None, None], columns, 0.0)
