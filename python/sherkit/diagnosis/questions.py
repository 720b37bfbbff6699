"""Diagnosis: is anything missing, where, which effect, what it cannot be told from, what to measure next."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from ..base import linalg
from ..base.arguments import Level, Seed, validate_arguments
from ..base.types import Floats, Ints
from ..data.doubts import by_number, commanded, doubts
from ..data.reader import RunLike
from ..errors import EffectError, FitError
from ..evidence.base import chance_of
from ..evidence.fitted_run import FittedRun, enough_of
from ..evidence.plausible import implausible
from ..evidence.thresholds import LEVEL
from ..fit.constant_columns import held, unread
from ..fit.error import repeated_folds_of
from ..fit.forms import known
from ..fit.identify import Fit, identify
from ..fit.set_up import Mistake, set_up_mistakes
from ..model.any import Model
from ..model.effect import Effect
from ..model.robot_file import RobotLike
from ..model.thermometers import thermometers_of
from .by_thermometer import by_nearest_thermometer
from .checks import checks_of
from .findings import findings_of
from .gathered import checks_of_outliers
from .held_out import backward_elimination, candidates_of, noise_quantile, strongest, unnamed
from .next_poses import Proposal, next_poses
from .outliers import is_first_by_side, outliers_beside, sentences, without_outliers
from .repeats import contradicted, in_repeats, noise_beside, steps_in
from .result import Diagnosis, verdict_of
from .selection import NamedEffects, not_needed, searched
from .sensor_pose import taken_by_pose
from .signature import bends_in_words, signature_of, waves_in_words
from .where import confounded_with, neighbour_correlation, slow_drift_of, smallest_found, where


@validate_arguments
@linalg.one_thread()
def diagnose(
    fit: Fit | RobotLike | Model,
    data: RunLike = None,
    *,
    effects: Sequence[Effect] = (),
    level: Level = LEVEL,
    keep: Sequence[int] = (),
    seed: Seed = 0,
    step: Callable[[str], None] = lambda _: None,
) -> Diagnosis:
    """Diagnoses what a fit leaves, or what that of a robot or model to ``data`` does, as :func:`identify` takes them.

    ``effects`` are the user's own, beside the catalogue or the model's candidates. Rows to ``keep`` (by number from 0)
    are never left out as gross errors. Raises
    :class:`~sherkit.errors.FitError` where there is too little to diagnose, and
    :class:`~sherkit.errors.EffectError` for a user's effect that is none.

        found = sk.diagnose("demo/robot.toml", "demo/whole.csv")
        print(found.headline)
    """
    if not isinstance(fit, Fit):
        fit = identify(fit, data)
    elif data is not None:
        raise FitError("diagnose: a fit has its rows already; give a robot and rows, or the fit alone")
    for effect in effects:
        if not isinstance(effect, Effect):
            raise EffectError(
                f"diagnose: {effect!r} is no effect of yours; those of the catalogue are tried anyway, and one that is "
                "to be in the model already belongs to identify or Study"
            )
    if fit.for_regions:
        # what an effect that is missing does to regions is not the drawing's to say
        fit = identify(fit.model, fit.data, loss=fit.loss, priors=False, noise=fit.noise)
    again = partial(_diagnosed, effects=effects, level=level, keep=keep, seed=seed, step=step)
    return by_nearest_thermometer(again(fit), fit, effects, again)


def _diagnosed(
    fit: Fit,
    effects: Sequence[Effect],
    level: float,
    keep: Sequence[int],
    seed: int,
    step: Callable[[str], None],
    judged: Ints | None = None,
) -> Diagnosis:
    """As :func:`diagnose`; ``judged`` are its gross errors beside what was found before they were known."""
    step("mistakes of the set-up")
    run = FittedRun(fit)
    given = {one.name for one in (*effects, *run.model.effects)}
    effects = (*effects, *(one for one in thermometers_of(run.model, run.data) if one.name not in given))
    mistakes = () if run.is_exact else set_up_mistakes(fit.model, fit.data, fit.values)
    table = () if run.is_exact else tuple(doubt for doubt in doubts(fit.data) if doubt.poses)
    # what a mistake leaves says nothing on physics, nor do poses that cannot tell it
    look = not mistakes and not table
    for effect in effects:
        run.model.check_effect(effect, run.data, fit.values)
    every = (*run.catalogue, *effects)
    notes = [
        *(one.sentence for one in mistakes),
        *(one.sentence for one in table),
        *(() if run.model.relations else held(run.data)),
        *unread(run.data),
        *map(str, run.data.set_ups),
    ]

    step("noise and outliers")
    # beside a mistake of the set-up every row may look wrong
    outliers = np.zeros(0, dtype=np.int64)
    if look:
        run, outliers = without_outliers(run, every, keep, judged)
    sigma, origin = run.noise
    rows = np.flatnonzero(run.whole)
    side = is_first_by_side(run, every, outliers)
    of_outliers = len(notes)
    if run.is_exact:
        notes.append(
            f"every reading is what the model says, to the last digits: {run.data.source} was computed, it seems, not "
            "measured; give what an instrument read"
        )
    if origin == "unknown":
        sigma = run.scatter
        notes.append(
            "neither repeats nor a declared noise: how much of the rest is noise cannot be known, only whether "
            "it has structure; repeat some poses or add sigma columns"
        )
    long = run
    if len(enough := enough_of(run.data, rows)) < len(rows):
        run, rows = run.on(enough), np.arange(len(enough))
        notes.append(
            f"{len(enough)} of {int(long.whole.sum())} rows are searched, evenly of all poses and times: what only all "
            "of them would show is smaller than a twentieth of the noise; noise, outliers and the fit are of all rows"
        )
    repeated_folds = repeated_folds_of(run.fit, seed)
    steps = steps_in(run) if look and not run.is_exact else None
    if steps is not None and not steps.alone and steps.put_back is not None:
        # digits were cut off where no effect is missing once they are put back
        there = searched(steps.put_back, every, rows, sigma, repeated_folds, level=level, step=step, look=True)
        steps = None if there.names else steps
    look, rounded = look and steps is None, None if steps is None else steps.rounded
    found = searched(run, every, rows, sigma, repeated_folds, level=level, step=step, look=look)
    if origin == "repeats" and (quieter := noise_beside(found.lead, sigma)) is not None:
        # what stepped between visits of a pose passed for noise, and kept the fit at its drawing
        then = run.on(np.arange(len(run.data)), quieter)
        long = then if long is run else long.on(np.arange(len(long.data)), quieter)
        run, sigma = then, quieter
        found = searched(run, every, rows, sigma, repeated_folds, level=level, step=step, look=look)
    if look and (doubt := next(commanded(run.data), None)) and _still_contradicted(found, run, long):
        # nothing found says why visits of a pose differ so much: then it is that their joints were not read
        mistakes, look = (Mistake(doubt.sentence),), False
        notes.insert(0, doubt.sentence)
        found = searched(run, every, rows, sigma, repeated_folds, level=level, step=step, look=False)
    of_all = _of_all(found, run, long)
    if look and judged is None and found.names:
        # what is wrong beside a model that lacks an effect is right with it, and what hid in its shadow comes to light
        beside = outliers_beside(of_all, every, outliers, keep)
        if found.structure:
            # the extremes of what is left are none
            beside = np.intersect1d(beside, outliers)
        if not np.array_equal(beside, outliers):
            return _diagnosed(fit, effects, level, keep, seed, step, beside)
    final = found.final
    # a row that is as what was found says was wrong beside a model that lacked it
    wrong = checks_of_outliers(of_all, outliers, side=side)
    accidents = all(check.holds is not False for check in wrong)
    notes[of_outliers:of_outliers] = sentences(of_all.fit, outliers, side=side, accidents=accidents)
    notes += [*found.notes, *waves_in_words(final.fit)]
    notes += [f"{one.sentence}. {one.remedy}" for one in known(final.fit).values()]
    notes += [doubt.sentence for doubt in by_number(final.fit.data)]

    step("fitting all rows")
    # what is left of a mistake of the set-up tells nothing of noise
    repeats = None if mistakes or run.is_exact else in_repeats(found.base, found.left, of_all)
    # one axis may be declared where others are told by repeats
    declared = {} if repeats is None else contradicted(of_all, repeats)
    if origin != "declared" or declared:
        sigma = _spread(of_all) if repeats is None else repeats.noise
    if declared:
        origin, of_all = "repeats", of_all.on(np.arange(len(of_all.data)), sigma)
    own = [e for e in run.model.effects if e.name not in run.model.within]
    needed = not_needed(final, own, sigma, repeated_folds)
    slow_drift = slow_drift_of(of_all)
    checks = checks_of(
        final, found, sigma, origin, needed, level, wrong, mistakes, table, rounded, slow_drift,
        repeats, declared, lambda: noise_quantile(final, sigma, repeated_folds, level, seed),
        lambda: backward_elimination(final, sigma, repeated_folds),
    )  # fmt: skip
    verdict = verdict_of(checks, found.names)
    supposed = final.model.supposed(left=found.structure)
    bent = bends_in_words(found.names_judged, found.names, [found.final.names[a] for a in found.final.axes])
    caveats = [told for told in (implausible(final.fit, found.names), supposed, bent) if told]
    # where something else is left, that may be what changes with time
    if slow_drift is not None and slow_drift.counts and verdict in ("adequate", "explained"):
        caveats.append(
            f"{slow_drift.axis} wanders by {slow_drift.size:.3g} {run.unit} in the course of the run, beside "
            f"{slow_drift.beside:.3g} from row to row, and nothing in the file says with what: here that counts "
            "as noise; look for what changes slowly (temperature, humidity, a stand that gives way) and record it as a "
            "column"
        )
    indistinguishable = _ties(found)
    base, view = found.first, found.first.family.run.view
    fits = {name: tied.run.of for tied in reversed(found.ties) for name in tied.names}
    fits |= {block.name: final for block in found.added}
    alone = {one.effect: one.error.rms for one in found.steps[1:2]}
    tried = [block for block in found.added if block.effect is None or not block.effect.goes_with]
    reports = candidates_of(base, repeated_folds, tried, fits, alone)
    if look:
        silent = [*found.names, *(name for tied in found.ties for name in tied.names)]
        silent += [one.effect for one in reports if any(note.startswith(f"{one.effect} ") for note in notes)]
        notes += unnamed(reports, silent, found.steps[-1].error, level)
    smallest: dict[str, tuple[float, float]] = {}
    if verdict == "adequate" and not final.is_exact:
        smallest = {name: smallest_found(base, block, level) for name, block in strongest(base).items()}
    signature = None
    if found.structure and found.names_judged is not None:
        signature = signature_of(found.names_judged, tuple(found.names))
    proposal = _next(found, sigma)
    said = Diagnosis(
        verdict=verdict,
        unit=run.unit,
        noise={run.names[a]: run.per_unit * float(sigma[a]) for a in run.axes},
        noise_origin=origin,
        correlation_in_time=base.family.run.white.rho,
        level=level,
        p_missing=chance_of(base.evidence),
        effects=found.names,
        not_needed=tuple(one.effect for one in needed if not one.holds),
        checks=checks,
        caveat="; ".join(caveats) or None,
        indistinguishable=indistinguishable,
        steps=found.steps,
        candidates=reports,
        untestable=dict(view.untestable),
        smallest_found=smallest,
        where=where(base),
        neighbour_correlation=neighbour_correlation(view),
        confirmed=max((one.p for one in found.gains), default=None),
        signature=signature,
        confounded_with=confounded_with(base.family.run),
        taken_by_pose={} if run.is_exact else taken_by_pose(run.model, run.data, run.fit.values, run.catalogue),
        outliers=outliers,
        next_poses=proposal.poses,
        advice=proposal.advice,
        notes=tuple(notes),
        fit=of_all.fit,
        base=long.fit,
        elsewhere=None if run.is_exact or not look else final.fit.elsewhere,
    )
    return replace(said, findings=findings_of(said))


def _next(found: NamedEffects, sigma: Floats) -> Proposal:
    """Poses that would tell what is named from the sets tied with it."""
    rivals = [other.run.of.fit for other in found.ties]
    return next_poses(found.final.fit, rivals, sigma) if rivals else Proposal()


def _of_all(found: NamedEffects, run: FittedRun, long: FittedRun) -> FittedRun:
    """All rows with what was found among those of ``run``."""
    return found.final if run is long else long if found.final is run else found.final.as_in(long)


def _still_contradicted(found: NamedEffects, run: FittedRun, long: FittedRun) -> bool:
    """Whether visits of a pose differ by more than what was declared, beside all that was found."""
    of_all = _of_all(found, run, long)
    repeats = in_repeats(found.base, found.left, of_all)
    return repeats is not None and bool(contradicted(of_all, repeats))


def _spread(run: FittedRun) -> Floats:
    """What a fit leaves of each reading (columns,): no repeats tell what of it is noise."""
    return np.maximum(run.scatter, run.digits)


def _ties(found: NamedEffects) -> tuple[tuple[str, ...], ...]:
    """Groups of effects each of which could stand in for the first, everything else as it is."""
    groups: dict[str, list[str]] = {}
    for other in found.ties:
        out = [n for n in found.names if n not in other.names]
        new = [n for n in other.names if n not in found.names]
        if out and new:
            groups.setdefault(out[0], [out[0]]).extend(n for n in new if n not in groups[out[0]])
    return tuple(tuple(group) for group in groups.values())
