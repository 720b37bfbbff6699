"""When it is known: the rule by which looks become a verdict, whatever the number of looks.

*Named* is what a diagnosis would name, where there is evidence of 100 in all, is 10,000 times as likely as every rival
and 1,000 times as likely as shapes, and leaves nothing. It is *explained* once its own Bayes factor has grown
twentyfold on twelve readings or more that were taken after it was named, in which nothing new happened. *Unexplained*
is what shapes tell far better than the effect that leads, or what that leaves, at two looks running. What is seen of
nothing is *adequate* only where it would have been seen.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
import scipy

from ..base.figures import listed
from ..evidence.thresholds import LEFT, LOUDER, NEARLY_ALWAYS, PLAUSIBLE, SCALES, SURE, TIED
from .look import FEWEST, ROUGH, ROUGH_WEIGHT, InterimAnalysis, agreement_of

# -- silence: which effects would have been seen by now, and from which size the others would -------------------------

_DIRECTIONS = 16


@dataclass(frozen=True)
class Unseen:
    """An effect that could hide in these rows: with what ``power`` it would be seen where it leaves as much as the
    noise, and from which root mean square of the readings on, in their unit, it would be seen (0.95); ``most_rms`` is
    what it leaves at most at sizes that are plausible."""

    name: str
    power: float
    from_rms: float
    in_time: bool
    #: Whether it leaves as much as the noise at sizes that are plausible at all.
    visible: bool
    most_rms: float = float("inf")


@lru_cache(maxsize=2)
def outlook(found: InterimAnalysis, level: float) -> tuple[Unseen, ...]:
    """For every effect of the catalogue that can be tried; an alarm is evidence of one over the ``level``."""
    # the noise of one reading, in its unit, as the best explanation leaves it
    noise = float(found.best_fit.scale)
    return (*(_outlook(found, name, noise, level) for name in found.known.effects), _outlook_rough(found, noise, level))


def _outlook(found: InterimAnalysis, name: str, noise: float, level: float) -> Unseen:
    reference, block, in_time = found.known.reference, found.by_effect.get(name), name in found.known.in_time
    if block is None:
        return Unseen(name, 0.0, float("inf"), in_time, True)
    sort = reference.sort_of(block)
    # three plausible sizes at most
    most = PLAUSIBLE / reference.scale[sort]
    columns = found.left(block)
    squares = columns.T @ columns
    rng = np.random.default_rng(0)
    u = rng.normal(size=(_DIRECTIONS, len(squares)))
    u = u / np.sqrt(np.einsum("di,ij,dj->d", u, reference.squares[sort], u).clip(1e-300))[:, None]
    shown = np.einsum("di,ij,dj->d", u, squares, u)
    grown = [float(np.linalg.slogdet(np.eye(len(squares)) + s**2 * squares)[1]) for s in SCALES]
    least = min(2.0 * (np.log(len(SCALES) / level) - reference.log_weight[sort]) + one for one in grown)
    sizes = np.geomspace(0.1, 1e3, 31)
    seen = 1.0 - scipy.special.chndtr(least, len(squares), np.square(sizes)[:, None] * shown.clip(1e-12))
    powers = seen.mean(axis=1)
    at_noise = float(np.interp(0.0, np.log(sizes), powers))
    enough = powers >= NEARLY_ALWAYS
    first = int(np.argmax(enough))
    about = slice(max(first - 1, 0), first + 1)
    times = float(np.exp(np.interp(NEARLY_ALWAYS, powers[about], np.log(sizes[about]))))
    return Unseen(name, at_noise, times * noise if enough.any() else float("inf"), in_time, most >= noise, most)


def _outlook_rough(found: InterimAnalysis, noise: float, level: float) -> Unseen:
    """From which size on an error would have been seen that is another one at each pose."""
    now, needed = agreement_of(found.base), -float(np.log(level)) - ROUGH_WEIGHT
    quantiles = scipy.special.chdtri(max(now.within_free, 1), (np.arange(40) + 0.5) / 40)

    def power(size: float) -> float:
        between = now.between_free * (1.0 + size**2 * now.times)
        return float(np.mean([replace(now, between=between, within=float(q)).log_bf >= needed for q in quantiles]))

    sizes = np.geomspace(0.5, 100.0, 24)
    first = next((size for size in sizes if power(float(size)) >= NEARLY_ALWAYS), float("inf"))
    return Unseen(ROUGH, power(1.0), float(first) * noise, False, False, 0.0)


def effects_excluded(seen: tuple[Unseen, ...]) -> bool:
    """Whether everything that places can show would have been seen at the size of the noise; where the noise is more
    than anything plausible would do, silence says nothing."""
    shown = [one.power >= NEARLY_ALWAYS for one in seen if one.visible and not one.in_time]
    return bool(shown) and all(shown)


def sentences(seen: tuple[Unseen, ...], unit: str, per_unit: float, untestable: Mapping[str, str]) -> list[str]:
    """What could not be seen, and from which size on it would have been."""
    unseen = [one for one in seen if one.power < NEARLY_ALWAYS]
    sizes = [f"{one.name} {one.from_rms * per_unit:.2g}" for one in unseen if np.isfinite(one.from_rms)]
    never = [one.name for one in unseen if not np.isfinite(one.from_rms)]
    out = [f"from this size on it would have been seen, {unit} RMS: {listed(sizes, 20)}"] if sizes else []
    out += [f"undetectable here: {listed(never, 20)}"] if never else []
    return [*out, *(f"not looked for: {name}, {why}" for name, why in untestable.items())]


# -- the rule ---------------------------------------------------------------------------------------------------------

#: Readings after naming that confirm.
AFTER = 12
#: Looks running at which much is left beside the leader, or is told far better by shapes: then it is unknown.
_LOOKS = 2


@dataclass(frozen=True)
class RuleState:
    """What is held after a look: ``named`` are the effects that stand alone, since ``at`` readings, when the logarithm
    of their Bayes factor was ``then``, ``confirmed`` once it has grown; ``unknown`` counts the looks running at which
    no effect would do; ``noise`` is that of a reading, and ``vouched`` whether its rows were sound, then."""

    verdict: str = "undecided"
    done: bool = False
    why: str = ""
    named: tuple[str, ...] = ()
    at: int = 0
    then: float = 0.0
    unknown: int = 0
    alarmed: bool = False
    confirmed: bool = False
    noise: float = 0.0
    vouched: bool = False


def after(state: RuleState, found: InterimAnalysis, *, spanned: bool, vouched: bool, level: float) -> RuleState:
    """The state once this look is taken; ``spanned`` whether the run is as long as it is to be judged over, ``vouched``
    whether nothing speaks against its rows as witnesses, one over the ``level`` the evidence that is an alarm."""
    lead, n, noise = found.lead, found.readings, float(found.best_fit.scale)
    now: dict[str, Any] = {"noise": noise, "vouched": vouched}
    new = 0.0 < LOUDER * state.noise < noise or (state.vouched and not vouched)
    alarm = found.log_evidence >= -np.log(level)
    if not alarm:
        quiet = found.log_evidence < min(LEFT, -np.log(level)) and n >= FEWEST and spanned and vouched and not new
        quiet = quiet and effects_excluded(outlook(found, level))
        why = "nothing is missing that these rows would have shown" if quiet else ""
        return RuleState("adequate" if quiet else "undecided", quiet, why, **now)
    unknown = state.unknown + 1 if n >= FEWEST and _is_unknown(found) else 0
    if unknown >= _LOOKS:
        return RuleState(
            "unexplained", True, "no effect of the catalogue explains what is left", unknown=unknown, alarmed=True
        )
    if lead is None or not _stands(found):
        return RuleState(unknown=unknown, alarmed=True, **now)
    if lead.names != state.named or new:
        return RuleState(named=lead.names, at=n, then=lead.log_bf, alarmed=True, **now)
    grown = lead.log_bf - state.then >= LEFT and n - state.at >= AFTER and n >= FEWEST
    # what else lives in time shows only when it has passed
    known = grown and spanned
    why = "named, and confirmed on readings that were taken after" if known else ""
    return RuleState(
        "explained" if known else "undecided", known, why, state.named, state.at, state.then,
        alarmed=True, confirmed=grown, noise=state.noise, vouched=state.vouched,
    )  # fmt: skip


def _stands(found: InterimAnalysis) -> bool:
    """Whether the leader explains all, far ahead of all else."""
    # two effects imitate more than one does
    margin = SURE if found.lead is not None and len(found.lead.blocks) == 1 else TIED
    return found.names.explains and len(found.ties) == 1 and found.rest < LEFT and found.ahead >= margin


def _is_unknown(found: InterimAnalysis) -> bool:
    """Whether shapes tell far more than the effect that leads, or that leaves much."""
    if found.lead is None:
        return found.names.alone.evidence > TIED
    return found.names.shapes_say_more or found.rest > TIED
