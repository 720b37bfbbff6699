"""What silence is worth: which effects would have been seen by now, and from which size the others would."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import scipy

from ..diagnosis.explanation import PLAUSIBLE
from .evidence import ROUGH, SIZES, Agreement
from .hypotheses import Hypothesis
from .look import Look

#: The power with which an effect must have been seen.
POWER = 0.95
_DIRECTIONS = 48


@dataclass(frozen=True)
class Unseen:
    """An effect that could hide in these rows: with what ``power`` it would be seen where it leaves as much as the
    noise, and from which root mean square of the readings on, in their unit, it would be seen (0.95)."""

    name: str
    power: float
    from_rms: float
    in_time: bool
    #: Whether it leaves as much as the noise at sizes that are plausible at all.
    visible: bool


def outlook(found: Look, level: float) -> tuple[Unseen, ...]:
    """For every effect of the catalogue that can be tried; an alarm is evidence of one over the ``level``."""
    noise = noise_of_look(found, level)
    return (*(_outlook(found, h, noise, level) for h in found.family.effects), _outlook_rough(found, noise, level))


def noise_of_look(found: Look, level: float) -> float:
    """The noise of one reading, in its unit, as the best explanation leaves it."""
    alarmed = found.lead is not None and found.log_evidence > -np.log(level)
    return float((found.lead.fit if alarmed and found.lead else found.fit).scale)


def _outlook(found: Look, h: Hypothesis, noise: float, level: float) -> Unseen:
    family, evidence = found.family, found.evidence
    key = (h.name, h.settings[len(h.settings) // 2])
    # three plausible sizes at most
    visible = PLAUSIBLE / family.scales[h.name] >= noise
    if h.name not in evidence.place:
        return Unseen(h.name, 0.0, float("inf"), h.in_time, visible)
    columns = evidence.left(key)
    squares = columns.T @ columns
    reference = family.reference[h.name]
    rng = np.random.default_rng(0)
    u = rng.normal(size=(_DIRECTIONS, len(squares)))
    u = u / np.sqrt(np.einsum("di,ij,dj->d", u, reference, u).clip(1e-300))[:, None]
    shown = np.einsum("di,ij,dj->d", u, squares, u)
    weight = h.weight / len(h.settings)
    grown = [float(np.linalg.slogdet(np.eye(len(squares)) + s**2 * squares)[1]) for s in SIZES]
    least = min(2.0 * np.log(len(SIZES) / (level * weight)) + one for one in grown)

    sizes = np.geomspace(0.1, 1e3, 41)
    powers = scipy.stats.ncx2.sf(least, len(squares), np.square(sizes)[:, None] * shown.clip(1e-12)).mean(axis=1)
    at_noise = float(np.interp(0.0, np.log(sizes), powers))
    enough = powers >= POWER
    first = int(np.argmax(enough))
    times = float(
        np.exp(np.interp(POWER, powers[max(first - 1, 0) : first + 1], np.log(sizes[max(first - 1, 0) : first + 1])))
    )
    return Unseen(h.name, at_noise, times * noise if enough.any() else float("inf"), h.in_time, visible)


def _outlook_rough(found: Look, noise: float, level: float) -> Unseen:
    """From which size on an error would have been seen that is another one at each pose."""
    evidence = found.evidence
    assert evidence.pose is not None, "a look numbers its poses"
    now = Agreement.of(evidence.residual, evidence.pose, evidence.free)
    needed = -float(np.log(level * found.family.by_name[ROUGH].weight))
    quantiles = scipy.stats.chi2.ppf((np.arange(40) + 0.5) / 40, max(now.within_free, 1))

    def power(size: float) -> float:
        between = now.between_free * (1.0 + size**2 * now.times)
        return float(np.mean([replace(now, between=between, within=float(q)).log_bf >= needed for q in quantiles]))

    sizes = np.geomspace(0.5, 100.0, 24)
    first = next((size for size in sizes if power(float(size)) >= POWER), float("inf"))
    return Unseen(ROUGH, power(1.0), float(first) * noise, False, False)


def is_silent(seen: tuple[Unseen, ...]) -> bool:
    """Whether everything that places can show would have been seen at the size of the noise; where the noise is more
    than anything plausible would do, silence says nothing."""
    shown = [one.power >= POWER for one in seen if one.visible and not one.in_time]
    return bool(shown) and all(shown)


def sentences(seen: tuple[Unseen, ...], unit: str, per_unit: float, untestable: Mapping[str, str]) -> list[str]:
    """What could not be seen, and from which size on it would have been."""
    out = []
    for one in seen:
        if one.power < POWER:
            size = (
                "at no size" if not np.isfinite(one.from_rms) else f"from {one.from_rms * per_unit:.2g} {unit} RMS on"
            )
            out.append(f"{one.name} would have been seen {size}")
    return [*out, *(f"{name} was not looked for: {why}" for name, why in untestable.items())]
