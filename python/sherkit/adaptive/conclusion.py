"""What a loop says of all that it was told: verdict, names, ties, what stayed unseen, how far off the robot may be,
at its end and while it goes on.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property, partial

import numpy as np

from ..base import linalg
from ..base.names import listed
from ..calibration import calibrate
from ..data.noise import noise_of
from ..diagnosis import Diagnosis, diagnose
from ..diagnosis.answers import Check
from ..diagnosis.next_poses import SEPARATION, next_poses
from ..errors import FitError, SherkitError
from ..evidence.thresholds import SURE
from ..fit.identify import Fit, identify, residuals
from . import rule, told
from .choice import are_beyond
from .held import Held
from .known import PLACES
from .look import FAR, Look
from .rule import is_silent, outlook, sentences
from .unread import mistaken
from .vouching import structure_of, told_of

#: Sets that are still a tie; more are no answer.
_MOST_TIED = 6
#: What is left may be so many times the noise that is declared; and what a verdict is where it is more.
_QUIET_ENOUGH = 1.3
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


def conclude(loop: Held) -> Conclusion:
    """What follows from the rows of a loop."""
    found, state, robot, seed = loop.last, loop.state, loop.robot, loop.seed
    if loop.readings == 0:
        return Conclusion()
    # of the rows and not of the loop, which would then outlive who forgets it, and its lock with it
    rows = partial(told.in_time, loop.frame, robot, loop.model, loop.layout)

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
    accuracy = None
    if not done and (spent or _is_beyond(loop, found, state)):
        verdict, effects, tied, why = _at_the_end(loop, found, spent)
        done = True
        if tied:
            notes = _would_tell(found)
    if done and verdict == "unexplained":
        looks_like = [name for name, _ in found.shapes[0][0] if name not in found.known.effects]
        why = f"{why}: what is left looks like {' & '.join(looks_like)}" if looks_like else why
        why = "; ".join((why, *loop.against))
    if done and verdict != "adequate" and (mistakes := mistaken(found.known.model, found.data, found.fit.values)):
        # what a wrong column leaves is no physics, and looks like much of it
        if verdict == "undecided":
            why = "; ".join((why, *mistakes))
        else:
            verdict, effects, tied, why = "unexplained", (), (), "; ".join(mistakes)
    if (
        done
        and verdict in _LOUDER
        and (louder := structure_of(found, loop.seed) or "; ".join(loop.against) or _louder(found, verdict))
    ):
        verdict, why = _LOUDER[verdict], louder
    if verdict == "explained" and (done or state.done):
        lead = found.lead
        if lead is not None:
            accuracy = accuracy_um(loop, found, lead.names, lead.fit)
        needed = loop.required_um
        if state.done and not spent and needed is not None and accuracy is not None and accuracy > needed:
            more = found.readings * (accuracy / needed) ** 2
            if more <= loop.budget:
                done, why = False, ""
            else:
                short = f"{needed:g} µm is not reached: {accuracy:.3g} µm, and the readings that the budget leaves"
                notes.insert(0, f"{short} would not bring it")
    elif verdict == "adequate" and done:
        accuracy = accuracy_um(loop, found, (), found.fit)
    if done:
        # a verdict of silence rests on what would have been seen; beside a name it is only told
        layout = found.data.layout
        unseen = outlook(found, loop.level)
        notes += [*first, *sentences(unseen, layout.unit, layout.per_unit, found.known.untestable)]
        notes += _unsure(found)
        late = told.incomplete(loop.frame, loop.layout)
        notes += [f"{name} is not in every row: nothing was made to depend on it" for name in late]
    best = [(" & ".join(name for name, _ in keys), value) for keys, value in found.leading]
    return Conclusion(
        verdict, done, why if done else "", effects if done or state.named else (), tied,
        tuple(notes) if done else tuple(first), tuple(best), accuracy, make,
    )  # fmt: skip


def _louder(found: Look, verdict: str) -> str:
    """That more is left than the noise that the columns of the readings declare; empty where it is not."""
    declared = noise_of(found.data)
    if declared.origin != "declared":
        return ""
    axes = list(found.known.axes)
    each = declared.sigma[:, axes][found.data.used[:, axes]]
    said = float(np.exp(np.mean(np.log(each))))
    left = float((found.lead.fit if verdict == "explained" and found.lead else found.fit).scale)
    layout = found.data.layout
    if left <= _QUIET_ENOUGH * said:
        return ""
    return (
        f"{layout.per_unit * left:.3g} {layout.unit} are left of each reading where its column declares "
        f"{layout.per_unit * said:.3g}: more noise than is told, or physics without a pattern"
    )


def _spent(loop: Held) -> str:
    if loop.readings >= loop.budget:
        return f"the budget of {loop.budget} readings is spent"
    data = loop.last.data if loop.last else None
    if loop.minutes and data is not None and data.time_s is not None and np.ptp(data.time_s) >= 60.0 * loop.minutes:
        return f"the budget of {loop.minutes:g} minutes is spent"
    return ""


def _is_beyond(loop: Held, found: Look, state: rule.State) -> bool:
    """Whether late in the budget effects are tied that nothing more would tell apart."""
    if not state.alarmed or found.readings < _EARLY:
        return False
    ties = rule.ties(found)
    # early only what is as good as the same everywhere
    margin = 1.0 if found.readings >= _LATE * loop.budget else 0.05
    return len(ties) > 1 and are_beyond(found, ties, loop.budget, _longer(loop), margin)


def _longer(loop: Held) -> float:
    """Seconds to a moment that is late enough to tell what lives in time."""
    left = 3600.0 if not loop.minutes else 60.0 * loop.minutes
    return max(left, 120.0 * loop.span_min)


def _at_the_end(loop: Held, found: Look, spent: str) -> tuple[str, tuple[str, ...], tuple[tuple[str, ...], ...], str]:
    """Verdict, effects, ties and reason where nothing stands alone and no more is read."""
    why = spent or "no reachable pose, and no later moment, tells what is left apart"
    if found.log_evidence < -np.log(loop.level):
        if loop.against:
            return "undecided", (), (), f"{why}; {loop.against[0]}"
        if found.readings >= rule.FEWEST and is_silent(outlook(found, loop.level)):
            return "adequate", (), (), f"{why}; nothing is missing that these rows would have shown"
        return "undecided", (), (), why
    ties = rule.ties(found)
    shape = found.shape_beside(ties)[1]
    lead = found.lead
    if lead is None or not ties:
        return "unexplained", (), (), why
    if shape > found.value(lead.keys) + SURE or lead.rest > FAR:
        return "unexplained", (), (), why
    names = tuple(" & ".join(sorted(name for name, _ in keys)) for keys in ties)
    effects = tuple(sorted(name for name, _ in ties[0]))
    settled = shape < found.value(ties[0]) - SURE and lead.rest < -np.log(loop.level)
    if not settled and len(ties[0]) > 1:
        # two effects imitate much that is in no catalogue: named is what stands in everything that is likely
        likely = [keys for keys, value in found.sets if value > found.value(ties[0]) - FAR]
        certain = set(effects).intersection(*({name for name, _ in keys} for keys in likely))
        why = f"{why}; {' & '.join(effects)} would say much of it, and what is in no catalogue nearly as much"
        return ("partly explained" if certain else "undecided"), tuple(sorted(certain)), (), why
    if len(names) == 1:
        return ("explained" if settled else "partly explained"), effects, (), why
    if len(names) > _MOST_TIED:
        return "undecided", (), (), f"{why}; {len(names)} effects or pairs explain as well: {listed(names)}"
    return ("explained" if settled else "partly explained"), effects, (names,), why


def _would_tell(found: Look) -> list[str]:
    """What would tell the leader from those tied with it: poses, or readings that these instruments do not take."""
    fits = {one.names: one.fit for one in found.fitted}
    names = [tuple(sorted(name for name, _ in keys)) for keys in rule.ties(found)]
    first, *others = [fits[one] for one in names if one in fits] or [found.fit]
    left = np.where(found.data.used, first.residuals, np.nan)[:, : found.data.coordinates]
    proposed = next_poses(first, others, np.sqrt(np.nanmean(np.square(left), axis=0)))
    out = [proposed.advice] if proposed.advice else []
    for pose in proposed.poses[-1:]:
        place = ", ".join(f"{name} {value:.4g}" for name, value in pose.items() if name != SEPARATION)
        by = f"by {pose[SEPARATION]:.2g} σ, read with those before it"
        out.append(f"of {len(proposed.poses)} poses that would tell most, the last: {place} ({by})")
    return out


def _unsure(found: Look) -> list[str]:
    if not len(found.aside) or found.aside[0] != 0 or not (found.data.direction[0] == 0.0).all():
        return []
    columns = f"{found.data.layout.directions[0]} …"
    return [f"the first reading is set aside: from which side it was approached is not told ({columns})"]


@linalg.one_thread()
def accuracy_um(loop: Held, found: Look, effects: tuple[str, ...], fit: Fit) -> float | None:
    """How far off the calibrated robot may be anywhere in the region, in 95 of 100 cases, µm: the largest over places.

    As a calibration of these rows promises it (:class:`~sherkit.robots.accuracy.PredictedAccuracy`); of a
    kind without one, or an effect that a calibration cannot hold, by the covariance of the fit. None where that is in
    no length.
    """
    places = found.known.region.spread(PLACES, loop.seed + 1)
    try:
        made = calibrate(loop.robot, found.data, effects=effects, correction="none").calibration
        # the region is one of the drawing: where its poses are in the calibration's frame is the calibration's to say
        there = made.forward_batch(places.joints)
        promised = made.predicted_accuracies(there.values[there.reached]).radius_mm
        if np.isfinite(promised).any():
            return float(1e3 * np.nanmax(promised))
    except SherkitError:
        pass
    return found.known.accuracy_um(found.data, fit, loop.seed)


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


# -- while it goes on: how far off a model is at readings before it is fitted to them ---------------------------------

@dataclass(frozen=True)
class Progress:
    """Of the look at ``readings`` rows: root mean square of what the look before leaves at the rows since, by the
    geometry alone and by what leads, in the unit of people (µm, pixels …; not finite where nothing can be said), and
    how far off a robot calibrated by it may be anywhere in 95 of 100 cases, µm, as the covariance of the fit has it."""

    readings: int
    by_geometry: float
    by_lead: float
    accuracy_um: float | None


def progress(before: Look | None, now: Look, seed: int) -> Progress:
    """How far it is at a look, by what the one before it held."""
    fit = now.lead.fit if now.lead is not None else now.fit
    try:
        accuracy = now.known.accuracy_um(now.data, fit, seed)
    except SherkitError:  # a fit by which the robot reaches nothing
        accuracy = None
    if before is None:
        return Progress(now.readings, float("nan"), float("nan"), accuracy)
    geometry = _missed(before.fit, before, now)
    lead = geometry if before.lead is None else _missed(before.lead.fit, before, now)
    return Progress(now.readings, geometry, lead, accuracy)


def _missed(fit: Fit, before: Look, now: Look) -> float:
    """Root mean square of what a fit leaves at the rows that were read after it."""
    axes = list(now.known.axes)
    new = slice(before.readings, now.readings)
    try:
        left = residuals(fit.model, now.data, fit.values)[new][:, axes]
    except SherkitError:  # a fit by which the robot reaches less than it was seen to
        return float("nan")
    left = left[now.data.used[new][:, axes] & np.isfinite(left)]
    return float(now.data.layout.per_unit * np.sqrt(np.mean(np.square(left)))) if len(left) else float("nan")
