"""Settings that are searched for besides parameters, between those of the blocks: moments, lags, periods."""

from __future__ import annotations

from dataclasses import replace
from math import tau

import numpy as np

from ..base.types import Floats
from ..model.effect import Effect, Setting
from .base import Base
from .blocks import Block
from .linearised import Linearised
from .made import MOMENTS
from .ripple import ripple_of
from .run import Run
from .shapes import stepped

#: Moments that are tried about one that was found; lags by factors of a quarter of two; waves over the range.
_MOMENTS, _LAGS, _WAVES = 90, 2.0 ** np.arange(-0.75, 0.76, 0.25), np.arange(-0.5, 0.51, 0.05)
#: The same of a shape.
_FINER = np.linspace(-0.5, 0.5, 33)
#: Fewest waves over the range of what waves.
_FEWEST = 0.2


def columns_at(run: Run, effect: Effect, setting: Setting | None) -> Floats:
    """Columns (n, m, k) of an effect that can be tried in the rows of a run, over the noise, by its parameters."""
    view = run.view
    if setting is None:
        at = next(at for one, at in view.effects if one.name == effect.name)
        return view.effects_in(view.whole)[:, :, at]
    if effect.is_periodic:
        names = view.waving(effect)
        each = setting if isinstance(setting, tuple) else [setting] * len(names)
        angles = {name: tau * view.stood[name] / one for name, one in zip(names, each, strict=True)}
        waves = [view.arriving(k, np.stack([np.sin(angles[k]), np.cos(angles[k])], axis=1)) for k in names]
        return np.concatenate(waves, axis=2)
    assert not isinstance(setting, tuple), "only waves have one for each joint"
    if effect.search == "time_s":
        assert view.time is not None, "a step has a moment"
        place = next(at for one, at in view.in_time if one.name == effect.name)
        n, m = view.residual.shape
        # a step of each reading, or of the columns of the effect
        of_readings = np.broadcast_to(np.diag(1.0 / run.sigma[list(run.of.axes)]), (n, m, m))
        whole = of_readings if place is None else view.effects_in(view.whole)[:, :, place]
        return stepped(whole, int(np.searchsorted(view.time, setting)))
    return next(of for one, of in view.lagging if one.name == effect.name)(setting)(view.whole)


def unit_columns(run: Run, effect: Effect, setting: Setting | None) -> Floats:
    """The same (N, k) under the filter of a run, each of unit length; without those that are zero."""
    columns = run.flat(columns_at(run, effect, setting))
    length = np.linalg.norm(columns, axis=0)
    return np.asarray(columns[:, length > 0] / length[length > 0])


def refined(base: Base, block: Block) -> Block:
    """A block of an effect at the setting, near its own, at which it takes most beside a base."""
    if block.effect is None or block.setting is None:
        return block
    if isinstance(block.setting, tuple):
        waves = ripple_of(base, block.effect)
        return block if waves is None else replace(block, setting=waves.likeliest, ways=waves.ways)
    effect, tried = block.effect, _near(base.family.run.view, block)

    def takes(k: int) -> float:
        return base.takes(unit_columns(base.family.run, effect, tried[k]))

    # every few of them first, then those about the best
    few = max(int(len(tried) ** 0.5), 1)
    found = {k: takes(k) for k in range(0, len(tried), few)}
    best = max(found, key=found.__getitem__)
    found |= {k: takes(k) for k in range(max(best - few + 1, 0), min(best + few, len(tried))) if k not in found}
    return replace(block, setting=tried[max(found, key=found.__getitem__)])


def finer(base: Base, block: Block) -> Block:
    """A shape that is a wave of a variable at the period, between those that are tried, at which it takes most."""
    run, view = base.family.run, base.family.run.view
    axes = range(run.axes) if block.axis is None else [block.axis]
    if block.period is None or (block.pattern is None and len(block.at) > 2 * len(axes)):
        return block
    values = view.variables[block.depends_on[0]] if block.pattern is None else view.stood[block.pattern]
    reach = float(np.ptp(values))

    def takes(count: float) -> float:
        angle = tau * (values - values.min()) * count / reach
        waves = np.stack([np.sin(angle), np.cos(angle)], axis=1)
        waves = waves - waves.mean(axis=0)
        if block.pattern is None:
            on = np.eye(run.axes)[:, list(axes)]
            made = (waves[:, None, :, None] * on[..., None, :]).reshape(*view.residual.shape, -1)
        else:
            made = view.arriving(block.pattern, waves)
        columns = run.flat(made)
        return base.takes(columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300))

    counts = reach / block.period + _FINER
    return replace(block, period=reach / max(counts[counts > _FEWEST].tolist(), key=takes))


def _near(view: Linearised, block: Block) -> list[float]:
    """Settings near that of a block."""
    effect, setting, n = block.effect, block.setting, len(view)
    assert effect is not None, "shapes are not searched"
    assert isinstance(setting, float), "it has one, of all joints"
    if effect.search == "time_s":
        assert view.time is not None, "a step has a moment"
        about = np.searchsorted(view.time, setting) + np.arange(-n // MOMENTS - 2, n // MOMENTS + 3)
        cuts = np.unique(np.clip(about, 2, n - 2))
        some = cuts[:: max(len(cuts) // _MOMENTS, 1)]
        return np.asarray(0.5 * (view.time[some - 1] + view.time[some])).tolist()
    if effect.is_lagging:
        return np.asarray(setting * _LAGS).tolist()
    reach = max(float(np.ptp(view.stood[name])) for name in view.waving(effect))
    return [reach / count for count in (reach / setting + _WAVES).tolist() if count > _FEWEST]
