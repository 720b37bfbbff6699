"""Blocks held out in turn, each by a fit of its own."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..base.arguments import Count, NotNegative, Seed, validate_arguments
from ..base.types import Floats, Ints
from ..data import Measurements
from ..model.any import Model
from ..model.base import ModelWithEffects
from ..model.kinds import Robot, model_of
from .folds import blocks_of
from .identify import identify, residuals


@dataclass(frozen=True, eq=False)
class HeldOut:
    """Residuals (n, m), each from a fit that did not see its block, and the block of each row."""

    residuals: Floats
    block: Ints


@validate_arguments
def hold_out(
    robot: Robot | Model | ModelWithEffects,
    data: Measurements,
    *,
    folds: Count = 5,
    seed: Seed = 0,
    loss: str = "linear",
    priors: bool | NotNegative | None = None,
    start: Floats | None = None,
) -> HeldOut:
    """Refits without each block in turn and predicts it. ``loss`` and ``priors`` are those of
    :func:`~sherkit.fit.identify.identify`, as is what is raised.

    ``start`` (p,), the fit of all rows where it is known, is so near that two looks at the rows are enough.
    """
    # the fits count time from the run's begin, so must what predicts by their values
    model = model_of(robot).for_run(data)
    drawn = model.start(data)
    block = blocks_of(data, model.place(data, model.predict(data, drawn), drawn), folds, seed)
    out = np.full(data.readings.shape, np.nan)
    for fold in np.unique(block):
        inside = block == fold
        if inside.all():
            # one pose alone cannot be held out: what is left is the fit's own residual
            out[inside] = residuals(model, data, identify(model, data, loss=loss, priors=priors, start=start).values)
            break
        fit = identify(model, data.select(~inside), loss=loss, priors=priors, start=start)
        out[inside] = residuals(model, data.select(inside), fit.values)
    return HeldOut(out, block)
