"""Settings that are searched for besides parameters, between those of the blocks: moments, lags, periods."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from ..base.types import Floats
from .base import Base
from .blocks import Block
from .effects import stepped
from .made import MOMENTS

#: Moments that are tried about one that was found; lags by factors of a quarter of two; waves over the range.
_MOMENTS, _LAGS, _WAVES = 90, 2.0 ** np.arange(-0.75, 0.76, 0.25), np.arange(-0.5, 0.51, 0.05)
#: Fewest waves over the range of what waves.
_FEWEST = 0.2


def refined(base: Base, block: Block) -> Block:
    """A block of an effect at the setting, near its own, at which it takes most beside a base."""
    if block.effect is None or block.setting is None:
        return block
    tried = _near(base, block)

    def takes(k: int) -> float:
        columns = base.family.run.flat(tried[k][1]())
        length = np.linalg.norm(columns, axis=0)
        return base.takes(columns[:, length > 0] / length[length > 0])

    # every few of them first, then those about the best
    few = max(int(len(tried) ** 0.5), 1)
    found = {k: takes(k) for k in range(0, len(tried), few)}
    best = max(found, key=found.__getitem__)
    found |= {k: takes(k) for k in range(max(best - few + 1, 0), min(best + few, len(tried))) if k not in found}
    return replace(block, setting=tried[max(found, key=found.__getitem__)][0])


def _near(base: Base, block: Block) -> list[tuple[float, Callable[[], Floats]]]:
    """Settings near that of a block, each with what gives its columns (n, m, k)."""
    view, effect, setting = base.family.run.view, block.effect, block.setting
    assert effect is not None, "shapes are not searched"
    assert setting is not None, "it has one"
    n, m = view.residual.shape
    if effect.search == "time_s":
        assert view.time is not None, "a step has a moment"
        about = np.searchsorted(view.time, setting) + np.arange(-n // MOMENTS - 2, n // MOMENTS + 3)
        cuts = np.unique(np.clip(about, 2, n - 2))
        place = next(at for one, at in view.in_time if one.name == effect.name)
        whole = np.broadcast_to(np.eye(m), (n, m, m)) if place is None else view.effects_in(view.whole)[:, :, place]
        some = cuts[:: max(len(cuts) // _MOMENTS, 1)].tolist()
        return [(float(0.5 * (view.time[c - 1] + view.time[c])), partial(stepped, whole, c)) for c in some]
    if effect.is_lagging:
        behind = next(of for one, of in view.lagging if one.name == effect.name)
        return [(lag, partial(behind(lag), view.whole)) for lag in (setting * _LAGS).tolist()]
    reach = max(float(np.ptp(view.inputs[name])) for name in view.waving)
    waves = [count for count in (reach / setting + _WAVES).tolist() if count > _FEWEST]

    def waving(count: float) -> Floats:
        angle = {name: 2.0 * np.pi * view.inputs[name] * count / reach for name in view.waving}
        each = [view.patterns[k] * of(angle[k])[:, None] for k in view.waving for of in (np.sin, np.cos)]
        return np.stack(each, axis=2)

    return [(reach / count, partial(waving, count)) for count in waves]
