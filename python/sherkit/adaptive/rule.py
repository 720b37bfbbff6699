"""When it is known: the rule by which looks become a verdict, whatever the number of looks.

*Named* is what has evidence of 100 in all, is 10,000 times as likely as every rival and 1,000 times as likely as every
shape, and leaves nothing. It is *explained* once its own Bayes factor has grown twentyfold on twelve readings or more
that were taken after it was named. *Unexplained* is what shapes tell far better than all effects, or what every effect
that leads leaves, at two looks running. What is seen of nothing is *adequate* only where it would have been seen.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from .look import FAR, Fitted, Keys, Look
from .silence import Unseen, is_silent

#: By how much a leader must be likelier than shapes (than rivals by FAR), and what it may leave at most (evidence).
_SHAPES, _LEFT = np.log(1e3), np.log(20.0)
#: Readings before a verdict, readings after naming that confirm, and by how much the leader's Bayes factor must grow.
FEWEST, _AFTER, _GROWN = 24, 12, np.log(20.0)
#: What is left of every leader, or is told better by a shape, is unknown (evidence).
_UNKNOWN = np.log(1e4)
_LOOKS = 2
_QUIET = np.log(20.0)


@dataclass(frozen=True)
class State:
    """What is held after a look: ``named`` are the effects that stand alone, since ``at`` readings, when the logarithm
    of their Bayes factor was ``then``, ``confirmed`` once it has grown; ``unknown`` counts the looks running at which
    no effect would do."""

    verdict: str = "undecided"
    done: bool = False
    why: str = ""
    named: tuple[str, ...] = ()
    at: int = 0
    then: float = 0.0
    unknown: int = 0
    alarmed: bool = False
    confirmed: bool = False


def after(state: State, found: Look, seen: tuple[Unseen, ...], *, spanned: bool, level: float) -> State:
    """The state once this look is taken; ``spanned`` whether the run is as long as it is to be judged over, one over
    the ``level`` the evidence that is an alarm."""
    lead, n = found.lead, found.readings
    alarm = found.log_evidence >= -np.log(level)
    if not alarm:
        quiet = found.log_evidence < min(_QUIET, -np.log(level)) and n >= FEWEST and spanned and is_silent(seen)
        why = "nothing is missing that these rows would have shown" if quiet else ""
        return State("adequate" if quiet else "undecided", quiet, why)
    stands = lead is not None and _stands(found, lead)
    unknown = state.unknown + 1 if n >= FEWEST and _is_unknown(found) else 0
    if unknown >= _LOOKS:
        return State(
            "unexplained", True, "no effect of the catalogue explains what is left", unknown=unknown, alarmed=True
        )
    if lead is None or not stands:
        return State(unknown=unknown, alarmed=True)
    if lead.names != state.named:
        return State(named=lead.names, at=n, then=lead.log_bf, alarmed=True)
    grown = lead.log_bf - state.then >= _GROWN and n - state.at >= _AFTER and n >= FEWEST
    # what else lives in time shows only when it has passed
    known = grown and spanned
    why = "named, and confirmed on readings that were taken after" if known else ""
    return State(
        "explained" if known else "undecided", known, why, state.named, state.at, state.then,
        alarmed=True, confirmed=grown,
    )  # fmt: skip


def ties(found: Look) -> list[Keys]:
    """What cannot be told from the leader: sets of effects nearly as likely, itself first."""
    if found.lead is None:
        return []
    own = found.value(found.lead.keys)
    near = {keys: value for keys, value in found.effects if value > own - FAR}
    return fewest(found.lead.keys, near)


def fewest(lead: Keys, values: Mapping[Keys, float]) -> list[Keys]:
    """The likeliest of each set of names, the ``lead`` first; one cause before two: of what holds another nothing is
    said."""
    near = {frozenset(name for name, _ in keys): keys for keys in sorted(values, key=lambda keys: values[keys])}
    near[frozenset(name for name, _ in lead)] = lead
    alone = [keys for names, keys in near.items() if not any(other < names for other in near)]
    return sorted(alone, key=lambda keys: (keys != lead, -values.get(keys, np.inf)))


def _stands(found: Look, lead: Fitted) -> bool:
    """Whether the leader is far ahead of all else and leaves nothing."""
    own, mine = found.value(lead.keys), set(lead.names)
    # two effects imitate more than one does
    margin = _SHAPES if len(lead.keys) == 1 else FAR
    if lead.rest >= _LEFT or own - found.shape_beside([lead.keys])[1] < margin:
        return False
    return not any(own - value < FAR and not mine <= {name for name, _ in keys} for keys, value in found.effects)


def _is_unknown(found: Look) -> bool:
    """Whether a shape tells far more than every effect, or every effect that leads leaves much."""
    shape = found.shapes[0][1] if found.shapes else -np.inf
    effect = found.effects[0][1] if found.effects else -np.inf
    return bool(shape - effect > _UNKNOWN or (found.fitted and all(one.rest > _UNKNOWN for one in found.fitted)))
