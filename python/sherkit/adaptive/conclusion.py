"""What a loop says of all that it was told: verdict, names, ties, what stayed unseen, how far off the robot may be,
at its end and while it goes on.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property, partial

import numpy as np

from ..base.figures import listed, number
from ..diagnosis import Diagnosis, diagnose
from ..diagnosis.next_poses import SEPARATION, next_poses
from ..diagnosis.result import Check
from ..errors import FitError
from ..evidence.thresholds import A_FEW, SURE, TIED
from ..fit.identify import identify
from ..model.base import asked_for
from . import rule, told
from .choice import are_beyond
from .gate import TIMES
from .held import BatchLooks, accuracy_um
from .look import FEWEST, InterimAnalysis
from .told import mistaken
from .vouching import louder_than_told, set_aside, structure_of, told_of

#: What a verdict is where more is left than noise.
_LOUDER = {"adequate": "unexplained", "explained": "partly explained"}
#: Part of the budget after which it is asked whether the rest would tell more.
_LATE = 0.6
#: Readings from which it is asked at all.
_EARLY = 48


@dataclass(frozen=True, eq=False)
class Conclusion:
    """What is known. ``evidence`` is that of the leading three, as natural logarithms of weight times Bayes factor."""

    verdict: str = "undecided"
    done: bool = False
    why: str = ""
    effects: tuple[str, ...] = ()
    indistinguishable: tuple[tuple[str, ...], ...] = ()
    notes: tuple[str, ...] = ()
    evidence: tuple[tuple[str, float], ...] = ()
    accuracy_um: float | None = None
    make: Callable[[], Diagnosis] | None = field(default=None, repr=False)

    @cached_property
    def diagnosis(self) -> Diagnosis:
        """The diagnosis of all rows, whose verdict is this. Raises :class:`~sherkit.errors.FitError` without rows."""
        if self.make is None:
            raise FitError("nothing was told yet: there are no rows to diagnose")
        return _agreeing(self.make(), self)


def conclude(loop: BatchLooks) -> Conclusion:
    """What follows from the rows of a loop."""
    found, state, robot, seed = loop.last, loop.state, loop.robot, loop.seed
    if loop.readings == 0:
        return Conclusion()
    # of the rows and not of the loop, which would then outlive who forgets it, and its lock with it
    rows = partial(told.in_order_of_time, loop.frame, robot, loop.model, loop.layout)

    def make() -> Diagnosis:
        data = rows()
        aside = found.aside if found else np.zeros(0, dtype=np.int64)
        # a handful of repeats is no noise to hold a verdict against, and poses are numbered as they were driven
        data = replace(data, pose=np.random.default_rng(seed).permutation(len(data)) + 1, repeat=None)
        return diagnose(identify(robot, data.mark_outliers(aside) if len(aside) else data), seed=seed)

    spent = _spent(loop)
    if found is None or loop.blind:
        said = (*loop.stuck, *loop.against, *([loop.blind] if loop.blind else []))
        return Conclusion(done=bool(spent), why="; ".join([spent, *said[:1]]) if spent else "", notes=said, make=make)
    verdict, done, why = state.verdict, state.done, state.why
    effects: tuple[str, ...] = state.named
    tied: tuple[tuple[str, ...], ...] = ()
    apart = told_of(found)
    first = [*([apart] if apart else []), *loop.stuck, *loop.against]
    notes: list[str] = []
    accuracy, hides = None, ""
    if not done and (spent or _is_beyond(loop, found, state)):
        verdict, effects, tied, why = _at_the_end(loop, found, spent)
        done = True
        if tied:
            notes = _would_tell(found)
    if done and verdict == "unexplained":
        why = f"{why}: what is left looks like {max(found.unknown, key=found.unknown.__getitem__)}"
        why = "; ".join((why, *loop.against))
    if done and verdict != "adequate" and (mistakes := mistaken(found.known.model, found.data, found.fit.values)):
        # what a wrong column leaves is no physics, and looks like much of it
        if verdict == "undecided":
            why = "; ".join((why, *mistakes))
        else:
            verdict, effects, tied, why = "unexplained", (), (), "; ".join(mistakes)
    if done and verdict in _LOUDER:
        apart = structure_of(found)
        if apart and not spent and set_aside(found).min() >= found.readings - rule.AFTER:
            # what has just begun is told by what is read next
            done = False
        elif louder := apart or "; ".join(loop.against) or louder_than_told(found, verdict):
            verdict, why = _LOUDER[verdict], louder
    if (verdict == "explained" and (done or state.done)) or (verdict == "adequate" and done):
        lead = found.lead if verdict == "explained" else None
        if lead is not None or verdict == "adequate":
            names, fit = (lead.names, found.best_fit) if lead else ((), found.fit)
            accuracy, hides = accuracy_um(loop, found, names, fit)
        needed = loop.required_um
        if needed is not None and accuracy is not None:
            times = accuracy / needed
            if state.done and not spent and times > 1.0:
                more = found.readings * times**2
                # of a robot of which nothing is known to be missing more readings tell more than that they are more
                if more <= loop.budget or verdict == "adequate":
                    done, why = False, ""
                else:
                    short = f"{needed:g} µm is not reached: {accuracy:.3g} µm, and the readings that the budget leaves"
                    notes.insert(0, f"{short} would not bring it{_told_the_side(loop, found)}")
            if done and verdict == "adequate" and times > TIMES:
                verdict = "undecided"
                why = (
                    f"nothing is seen to be missing, but calibrated it may be off by {number(accuracy)} µm where the "
                    f"target is {needed:g}{f': by {hides}, which these poses cannot show' if hides else ''}"
                )
    if done:
        # a verdict of silence rests on what would have been seen; beside a name it is only told
        layout = found.data.layout
        unseen = rule.outlook(found, loop.level)
        untestable = asked_for(found.known.untestable, found.data)
        notes += [*first, *rule.sentences(unseen, layout.unit, layout.per_unit, untestable)]
        notes += _unsure(found)
        late = told.incomplete(loop.frame, loop.layout)
        notes += [f"{name} is not in every row: nothing was made to depend on it" for name in late]
    return Conclusion(
        verdict, done, why if done else "", effects if done or state.named else (), tied,
        tuple(notes) if done else tuple(first), tuple(found.causes.items())[:3], accuracy, make,
    )  # fmt: skip


def _told_the_side(loop: BatchLooks, found: InterimAnalysis) -> str:
    """How far the robot is off where its controller is told from which side a pose is reached; empty where that is
    all the same."""
    lead = found.lead
    if lead is None or not any(block.effect and "direction" in block.effect.needs for block in lead.blocks):
        return ""
    told, _ = accuracy_um(loop, found, lead.names, found.best_fit, from_one_side=True)
    if told is None:
        return ""
    return (
        "; lost motion is in it, by half of it to either side: told from which side it comes "
        f"(inverse(…, direction=…)) it is within {told:.3g} µm"
    )


def _spent(loop: BatchLooks) -> str:
    if loop.readings >= loop.budget:
        return f"the budget of {loop.budget} readings is spent"
    data = loop.last.data if loop.last else None
    if loop.minutes and data is not None and data.time_s is not None and np.ptp(data.time_s) >= 60.0 * loop.minutes:
        return f"the budget of {loop.minutes:g} minutes is spent"
    return ""


def _is_beyond(loop: BatchLooks, found: InterimAnalysis, state: rule.RuleState) -> bool:
    """Whether late in the budget effects are tied that nothing more would tell apart."""
    if not state.alarmed or found.readings < _EARLY:
        return False
    # early only what is as good as the same everywhere
    margin = 1.0 if found.readings >= _LATE * loop.budget else 0.05
    # a moment that is late enough to tell what lives in time
    late_s = max(60.0 * (loop.minutes or 60.0), 120.0 * loop.span_min)
    return len(found.ties) > 1 and are_beyond(found, found.ties, loop.budget, late_s, margin)


def _at_the_end(
    loop: BatchLooks, found: InterimAnalysis, spent: str
) -> tuple[str, tuple[str, ...], tuple[tuple[str, ...], ...], str]:
    """Verdict, effects, ties and reason where nothing stands alone and no more is read."""
    why = spent or "no reachable pose, and no later moment, tells what is left apart"
    if found.log_evidence < -np.log(loop.level):
        if loop.against:
            return "undecided", (), (), f"{why}; {loop.against[0]}"
        if found.readings >= FEWEST and rule.effects_excluded(rule.outlook(found, loop.level)):
            return "adequate", (), (), f"{why}; nothing is missing that these rows would have shown"
        return "undecided", (), (), why
    lead = found.lead
    if lead is None or found.ahead < -SURE or found.rest > TIED:
        return ("partly explained" if found.names.named else "unexplained"), found.names.named, (), why
    settled = found.names.explains and found.ahead > SURE and found.rest < -np.log(loop.level)
    if not settled and len(lead.blocks) > 1:
        # two effects imitate much that is in no catalogue: named is what shapes do not say in its place
        everywhere = set(found.names.named).intersection(*(one.names for one in found.ties))
        certain = tuple(one.name for one in found.names.told if one.name in everywhere and one.needed > TIED)
        why = f"{why}; {' & '.join(lead.names)} would say much of it, and what is in no catalogue nearly as much"
        return ("partly explained" if certain else "undecided"), certain, (), why
    names = tuple(" & ".join(one.names) for one in found.ties)
    if len(names) > A_FEW:
        return "undecided", (), (), f"{why}; {len(names)} effects or pairs explain as well: {listed(names)}"
    return ("explained" if settled else "partly explained"), lead.names, (names,) if len(names) > 1 else (), why


def _would_tell(found: InterimAnalysis) -> list[str]:
    """What would tell the leader from those tied with it: poses, or readings that these instruments do not take."""
    first, *others = [one.run.of.fit for one in found.ties] or [found.fit]
    left = np.where(found.data.used, first.residuals, np.nan)[:, : found.data.coordinates]
    proposed = next_poses(first, others, np.sqrt(np.nanmean(np.square(left), axis=0)))
    out = [proposed.advice] if proposed.advice else []
    for pose in proposed.poses[-1:]:
        place = ", ".join(f"{name} {value:.4g}" for name, value in pose.items() if name != SEPARATION)
        by = f"by {pose[SEPARATION]:.2g} σ, read with those before it"
        out.append(f"of {len(proposed.poses)} poses that would tell most, the last: {place} ({by})")
    return out


def _unsure(found: InterimAnalysis) -> list[str]:
    if not len(found.aside) or found.aside[0] != 0 or not (found.data.direction[0] == 0.0).all():
        return []
    columns = f"{found.data.layout.directions[0]} …"
    return [f"the first reading is set aside: from which side it was approached is not told ({columns})"]


def _agreeing(d: Diagnosis, said: Conclusion) -> Diagnosis:
    """A diagnosis with the verdict of the loop, which counts every look; where both agree, as it is."""
    if d.verdict == said.verdict and set(d.effects) == set(said.effects):
        return replace(d, notes=(*d.notes, *said.notes))
    why = said.why or "it is not known yet"
    praise = said.verdict in ("adequate", "explained")
    check = Check(
        "evidence", "the evidence of all looks decides", f"{len(d.fit.data)} rows, each look counted",
        f"{said.verdict}: {why}", holds=praise, decisive=True, fails=why,
    )  # fmt: skip
    others = tuple(replace(one, decisive=False) if praise else one for one in d.checks)
    return replace(
        d, verdict=said.verdict, effects=said.effects, indistinguishable=said.indistinguishable,
        checks=(check, *others), notes=(*d.notes, *said.notes),
    )  # fmt: skip
