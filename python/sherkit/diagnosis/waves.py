"""How large the waves of gears and encoders are, joint by joint, in words."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..base.figures import stated
from ..fit.identify import Fit

#: Deviations below which the waves of a joint are none.
_TOLD = 3.0


def waves_in_words(fit: Fit) -> Iterator[str]:
    """A sentence for each effect of waves that has a period for each joint, or a second wave in it: how large they
    are at the joints where they are told, the second wave of each period behind the first."""
    for effect in fit.model.effects:
        if not effect.is_periodic:
            continue
        names = [p.name for p in fit.parameters]
        seconds = {p.name for e in fit.model.effects if e.goes_with == effect.name for p in e.qualified()}
        if not (seconds or isinstance(fit.model.setting_of(effect), tuple)):
            continue
        said = []
        for sine, cosine in zip(effect.qualified()[::2], effect.qualified()[1::2], strict=True):
            joint = sine.name.partition(".sine_")[2]
            size, std = _amplitude(fit, [names.index(sine.name), names.index(cosine.name)])
            if size < _TOLD * std:
                continue
            both = stated(size, std, sine.unit)
            ends = (f".sine_{joint}", f".cosine_{joint}")
            if its := [names.index(name) for name in names if name in seconds and name.endswith(ends)]:
                both += f" and, twice as often, {stated(*_amplitude(fit, its), sine.unit)}"
            said.append(f"joint {joint} by {both}")
        if said:
            yield f"{effect.name}: {', '.join(said)}"


def _amplitude(fit: Fit, pair: list[int]) -> tuple[float, float]:
    """Of sine and cosine, with its deviation to first order."""
    both = fit.values[pair]
    size = float(np.hypot(*both))
    along = both / max(size, 1e-300)
    covariance = (fit.covariance + fit.unobserved_covariance)[np.ix_(pair, pair)]
    return size, float(np.sqrt(np.clip(along @ covariance @ along, 0.0, None)))
