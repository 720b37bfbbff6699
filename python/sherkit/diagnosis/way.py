"""The way of a diagnosis: mistakes and noise first, then what is missing, then which rows are wrong beside that."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ..base.types import Ints
from ..data.doubts import by_number, commanded, doubts
from ..evidence.fitted_run import FittedRun, enough_of
from ..fit.constant_columns import held, outside_limits, unread
from ..fit.error import repeated_folds_of
from ..fit.forms import known
from ..fit.identify import Fit
from ..fit.set_up import Mistake, set_up_mistakes
from ..model.effect import Effect
from ..model.thermometers import thermometers_of
from .answered import Looked, diagnosis_of
from .gathered import checks_of_outliers
from .outliers import is_first_by_side, outliers_beside, sentences, without_outliers
from .repeats import contradicted, in_repeats, noise_beside, steps_in
from .result import Diagnosis
from .selection import NamedEffects, searched
from .signature import waves_in_words


def diagnosed(
    fit: Fit,
    effects: Sequence[Effect],
    level: float,
    keep: Sequence[int],
    seed: int,
    step: Callable[[str], None],
    judged: Ints | None = None,
) -> Diagnosis:
    """As :func:`~.questions.diagnose`, of a fit; ``judged`` are its gross errors beside what was found before they were
    known."""
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
            return diagnosed(fit, effects, level, keep, seed, step, beside)
    final = found.final
    # a row that is as what was found says was wrong beside a model that lacked it
    wrong = checks_of_outliers(of_all, outliers, side=side)
    accidents = all(check.holds is not False for check in wrong)
    notes[of_outliers:of_outliers] = sentences(of_all.fit, outliers, side=side, accidents=accidents)
    notes += [*found.notes, *waves_in_words(final.fit)]
    notes += [f"{one.sentence}. {one.remedy}" for one in known(final.fit).values()]
    notes += [*outside_limits(final.model, final.data), *(doubt.sentence for doubt in by_number(final.data))]

    step("fitting all rows")
    looked = Looked(
        run, long, of_all, found, sigma, origin, outliers, wrong, mistakes, table, rounded, notes, look, level, seed,
        repeated_folds,
    )  # fmt: skip
    return diagnosis_of(looked)


def _of_all(found: NamedEffects, run: FittedRun, long: FittedRun) -> FittedRun:
    """All rows with what was found among those of ``run``."""
    return found.final if run is long else long if found.final is run else found.final.as_in(long)


def _still_contradicted(found: NamedEffects, run: FittedRun, long: FittedRun) -> bool:
    """Whether visits of a pose differ by more than what was declared, beside all that was found."""
    of_all = _of_all(found, run, long)
    repeats = in_repeats(found.base, found.left, of_all)
    return repeats is not None and bool(contradicted(of_all, repeats))
