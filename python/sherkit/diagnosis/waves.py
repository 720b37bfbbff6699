"""Waves along the inputs: at which frequencies they are looked for, and their columns.

Evenly spaced readings cannot tell a frequency from one that is a wave per spacing away; uneven ones can, as far as
their largest common spacing allows (Eyer and Bartholdi, "Variable stars: which Nyquist frequency?", A&A Suppl. 1999).
"""

from __future__ import annotations

import numpy as np

from ..types import Floats
from .linearised import Linearised

TURN = 2.0 * np.pi
#: Frequencies per width of a peak: halfway between two of them a wave still takes four fifths of what it would.
OVERSAMPLING = 2.0
#: Most waves over the range of a joint: each more makes a false alarm likelier, and the test dearer.
_MOST_WAVES = 150
#: Readings that are closer than this part of the range are one: no wave is so short that it would tell them apart.
_SAME = 1e-3


def frequencies(view: Linearised) -> Floats:
    """The frequencies (k,) at which waves of the inputs are looked for, waves per unit, the same for every input.

    From one wave over the range to as many as there are distinct readings: their mean distance is the shortest period,
    since further up there are more waves than readings to tell them by. Never more than 150. Where an effect has a
    period in rad, a joint has a ring: its error closes in a turn, so the periods are whole parts of one, from the half
    turn on, which two reading heads leave; once per turn is an effect of its own.
    """
    spans = [float(np.ptp(v)) for v in view.inputs.values()]
    if max(spans, default=0.0) <= 0.0:
        return np.zeros(0)
    span = max(spans)
    distinct = max(len(np.unique(np.round(v / (_SAME * span)))) for v in view.inputs.values())
    waves = min(distinct, _MOST_WAVES)
    if rings(view):
        step = max(TURN / (OVERSAMPLING * span), 1.0)
        return np.unique(np.round(np.arange(2.0, waves * TURN / span + 1.0, step))) / TURN
    return np.arange(OVERSAMPLING, OVERSAMPLING * waves + 1.0) / (OVERSAMPLING * span)


def rings(view: Linearised) -> bool:
    """Whether the inputs are angles whose encoders close in a turn."""
    return any(effect.search == "period_rad" for effect, _ in view.periodic)


def waves_of(view: Linearised, frequency: float) -> Floats:
    """Columns (n, m, 2 k) of sine and cosine of each of k inputs, for amplitudes in their unit, over the noise."""
    columns = []
    for name, pattern in view.patterns.items():
        angle = TURN * frequency * view.inputs[name]
        columns += [pattern * np.sin(angle)[:, None], pattern * np.cos(angle)[:, None]]
    return np.stack(columns, axis=2)
