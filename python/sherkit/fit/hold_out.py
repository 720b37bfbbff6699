"""Errors on measurements that were not fitted: blocks of poses held out in turn."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..base.arguments import Count, Seed, as_annotated
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


@as_annotated
def hold_out(
    robot: Robot | Model | ModelWithEffects,
    data: Measurements,
    *,
    folds: Count = 5,
    seed: Seed = 0,
    loss: str = "linear",
    start: Floats | None = None,
) -> HeldOut:
    """Refits without each block in turn and predicts it. Raises as :func:`~sherkit.fit.identify.identify`.

    ``start`` (p,), the fit of all rows where it is known, is so near that two looks at the rows are enough.
    """
    model = model_of(robot)
    nominal = model.predict(data, np.zeros(len(model.parameters)))
    block = blocks_of(data, model.place(data, nominal), folds, seed)
    out = np.full(data.readings.shape, np.nan)
    for fold in np.unique(block):
        inside = block == fold
        if inside.all():
            # one pose alone cannot be held out: what is left is the fit's own residual
            out[inside] = residuals(model, data, identify(model, data, loss=loss, start=start).values)
            break
        fit = identify(model, data.select(~inside), loss=loss, start=start)
        out[inside] = residuals(model, data.select(inside), fit.values)
    return HeldOut(out, block)
