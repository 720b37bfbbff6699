"""Gross errors: rows and poses that neither noise, nor any effect, nor a smooth shape explains.

Repeats that agree vouch for each other and not for their pose: a wrong index, or a cube that was knocked, is wrong in
all of them. So a row is judged together with the other readings of its pose, and by itself only where it stands apart
from them; and each is judged by what the inliers predict there, however many the others are.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import product

import numpy as np
import scipy

from ..base import linalg
from ..base.arguments import validate_arguments
from ..base.figures import number, spans
from ..base.types import Bools, Floats, Ints
from ..data import Measurements
from ..data.noise import MAD
from ..errors import FitError, SherkitError, SherkitWarning
from ..evidence.fitted_run import FittedRun
from ..evidence.run import in_time
from ..evidence.thresholds import HARDLY, LOUDER, NEVER, ROUNDS
from ..fit.error import of_residuals
from ..fit.identify import Fit
from ..fit.set_up import set_up_mistakes
from ..model.effect import Effect
from .outlier_fit import OutlierFit
from .robust_start import robust_start

#: A pause between two visits, in usual steps of time; and what part of a visit, of how many rows at least, are outliers
#: where it is taken for news.
_PAUSE = 20.0
_OUTLYING_VISIT = 0.5
_FEWEST_OF_A_VISIT = 4
#: Wrong rows that hold one value where that is what is wrong with them: so many at least, and that part of them.
_LASTS, _ONE_VALUE = 5, 0.4


def without_outliers(
    run: FittedRun, effects: Sequence[Effect], keep: Sequence[int] = (), judged: Ints | None = None
) -> tuple[FittedRun, Ints]:
    """The fit without gross errors, and their rows (k,), indices of the data; rows to ``keep`` are none, and where they
    are ``judged`` these are all.

    Every row is judged anew by each fit, those that an earlier one listed as well: what one gross error hid comes to
    light, and what was listed in its shadow comes back. Raises :class:`FitError` for too few rows.
    """
    rows = in_time(run, np.flatnonzero(run.whole))
    if run.is_exact:
        return run, rows[:0]
    if judged is not None:
        return run.without(judged) if len(judged) else run, judged
    first, run = run, robust_start(run, rows)
    outliers = np.flatnonzero(run.data.outlier & ~first.data.outlier)
    for _ in range(ROUNDS):
        again = np.setdiff1d(_outlying(run, effects, rows), keep)
        if np.array_equal(again, outliers):
            break
        outliers = again
        run = first.without(outliers) if len(outliers) else first
    return run, outliers


def outliers_beside(run: FittedRun, effects: Sequence[Effect], outliers: Ints, keep: Sequence[int]) -> Ints:
    """The gross errors (k,) beside what was found, which is in the model of a ``run`` without the ``outliers``."""
    rows = np.union1d(np.flatnonzero(run.whole), outliers)
    rows = rows[np.argsort(run.data.order[rows], kind="stable")]
    return np.setdiff1d(_outlying(run, effects, rows), keep)


@validate_arguments
@linalg.one_thread()
def gross_errors(fit: Fit, effects: Sequence[Effect] = (), *, keep: Sequence[int] = ()) -> Ints:
    """Rows (k,), by number from 0, that a diagnosis of this fit would leave out as gross errors, but those to ``keep``.

    ``effects`` are your own, tried beside the catalogue. None beside a mistake of the set-up, where every row may look
    wrong, and none where there are too few rows to tell.

        fit = sk.identify("demo/robot.toml", "demo/whole.csv")
        print(fit.data.line[sk.diagnosis.gross_errors(fit)])
    """
    return _seen_from(fit, effects, keep)[1]


def warn_of_outliers(fit: Fit, effects: Sequence[Effect]) -> Ints:
    """The :func:`gross_errors` of a fit, with a warning where they decide it."""
    run, outliers = _seen_from(fit, effects)
    if not len(outliers):
        return outliers
    left = [of_residuals(one.data, one.residuals, held_out=False).rms for one in (fit, run.fit)]
    if left[0] < LOUDER * left[1]:
        return outliers
    many, data = len(outliers) > 1, fit.data
    warnings.warn(
        f"{data.source}: {data.counted}{'s' if many else ''} {spans(data.line[outliers])} look{'' if many else 's'} "
        f"wrong and {'are' if many else 'is'} in this fit: it leaves {left[0]:.4g} {run.unit}, without "
        f"{'them' if many else 'it'} {left[1]:.4g}",
        SherkitWarning,
        stacklevel=4,
    )
    return outliers


def _seen_from(fit: Fit, effects: Sequence[Effect], keep: Sequence[int] = ()) -> tuple[FittedRun, Ints]:
    """As :func:`without_outliers`, from a fit."""
    run = FittedRun(fit)
    if run.is_exact or set_up_mistakes(fit.model, fit.data, fit.values):
        return run, np.zeros(0, dtype=np.int64)
    try:
        return without_outliers(run, (*run.catalogue, *effects), keep)
    except FitError:  # too few rows to tell
        return run, np.zeros(0, dtype=np.int64)


def _outlying(run: FittedRun, effects: Sequence[Effect], rows: Ints) -> Ints:
    """Those of these rows, sorted, that are gross errors as seen from this fit.

    All that is read after a pause is no accident, it is news: a visit to the machine that is off as a whole stays.
    """
    # what a fit to the others cannot compute at all is off by more than it could say
    computed = np.isfinite(run.fit.residuals[rows][:, list(run.axes)]).all(axis=1)
    if not computed.all():
        rows, beyond = rows[computed], rows[~computed]
        return np.union1d(beyond, _outlying(run, effects, rows) if len(rows) else rows)
    view = run.linearised(rows, effects, run.noise[0][list(run.axes)])
    outliers = OutlierFit(view, declared=run.noise[1] == "declared").outliers()
    outliers &= ~_visits(view.time, outliers)
    outliers[0] |= came_from_elsewhere(run, effects, rows)
    return np.sort(rows[outliers])


def came_from_elsewhere(run: FittedRun, effects: Sequence[Effect], rows: Ints) -> bool:
    """Whether the first of these rows, of which nobody told from which side its joints came, is off by what their sides
    make, and would not be had some come from the other."""
    data, first, axes = run.data, rows[:1], list(run.axes)
    by_side = [effect for effect in effects if "direction" in effect.needs and effect.function is None]
    if not by_side or data.tells_sides or not (data.direction[first] == 1.0).all():
        return False
    try:
        with_it = run.refit([(effect, None) for effect in by_side])
    except SherkitError:
        return False
    left = with_it.residuals[rows][:, axes]
    spread = np.maximum(MAD * np.median(np.abs(left), axis=0), run.digits[axes])
    sides = np.array(list(product((1.0, -1.0), repeat=data.joints.shape[1])))
    alike = replace(data.select(np.repeat(first, len(sides))), direction=sides)
    off = (alike.readings - with_it.model.predict(alike, with_it.fit.values))[:, axes]
    chance = scipy.special.chdtrc(len(axes), np.square(off / spread).sum(axis=1))
    return bool(chance[0] < NEVER and chance.max() > HARDLY)


def is_first_by_side(run: FittedRun, effects: Sequence[Effect], outliers: Ints) -> bool:
    """Whether the first of all rows is among those that a run is without (k,) since its joints came from elsewhere."""
    first = outliers[run.data.order[outliers] == run.data.order.min()]
    rows = in_time(run, np.flatnonzero(run.whole))
    return len(first) > 0 and came_from_elsewhere(run, effects, np.concatenate([first, rows]))


def sentences(fit: Fit, rows: Ints, *, side: bool = False, accidents: bool = True) -> tuple[str, ...]:
    """What is said of gross errors (indices of the rows of a ``fit`` without them): poses that are wrong in all their
    readings, and single rows apart; each by its line in the file, and how far it is off; of the first of all, that it
    is for the ``side`` that nobody told. Too many, or what lies together, are no ``accidents``."""
    if not len(rows):
        return ()
    data = fit.data
    outliers = np.zeros(len(data), dtype=bool)
    outliers[rows] = True
    counted = outliers | ~data.outlier
    group = data.groups
    size = np.bincount(group, counted)
    whole = (np.bincount(group, outliers) == size) & (size > 1) & _agreeing(fit, group, outliers)
    out = []
    poses = np.flatnonzero(outliers & whole[group])
    if len(poses) and data.pose is not None:
        numbers = np.unique(data.pose[poses])
        many = len(numbers) > 1
        where = f"(pose {spans(numbers)}; {data.counted}s {spans(data.line[poses])})"
        poses_are, their = f"{len(numbers)} poses are" if many else "one pose is", "their" if many else "its"
        if accidents:
            out.append(
                f"{poses_are} wrong in all {their} repeats {where}: no noise, no effect and no smooth shape explains "
                "it; all figures here are without them. "
                "Look for a wrong index, a target that was knocked, a stage that was bumped"
            )
        else:
            out.append(
                f"{poses_are} left out with all {their} repeats {where}: all figures here are without them. "
                "Accidents are fewer, or do not lie together: look for what the model lacks there"
            )
    single = np.flatnonzero(outliers & ~whole[group])
    if len(single):
        off = of_residuals(data.select(single).kept(), fit.residuals[single], held_out=False)
        many = len(single) > 1
        where = f"{data.counted}{'s' if many else ''} {spans(data.line[single])}"
        by = f"{'up to ' if many else ''}{_in_large(off.max, off.unit)}"
        out.append(
            f"{where} {'are' if many else 'is'} {by} off and left out: all figures here are without "
            f"{'them' if many else 'it'}"
        )
        if side:
            told = f"from which side its joints came is not told ({data.layout.directions[0]} …)"
            out.append(f"the first of all {data.counted}s is left out: {told}, and from the other it would not be off")
    return (*out, *_one_value(data, rows))


def _agreeing(fit: Fit, group: Ints, outliers: Bools) -> Bools:
    """Whether the outliers of each group (g,) are twice as near to one another as to what the others predict."""
    off = np.where(outliers[:, None] & fit.data.taken, fit.residuals, 0.0)
    count = np.maximum(np.bincount(group, outliers), 1.0)
    mean = np.stack([np.bincount(group, one) / count for one in off.T], axis=1)
    within = np.where(outliers[:, None], np.square(off - mean[group]), 0.0).sum(axis=1)
    return np.asarray(4.0 * np.bincount(group, within) < count * np.square(mean).sum(axis=1))


def _one_value(data: Measurements, rows: Ints) -> Iterator[str]:
    """Said of a reading that is one value in most of the rows that are wrong, and in hardly any other: it was lost."""
    for k, name in enumerate(data.layout.coordinates):
        values, count = np.unique(data.readings[rows[data.taken[rows, k]], k], return_counts=True)
        if not len(values) or count.max() < max(_LASTS, _ONE_VALUE * len(rows)):
            continue
        value = float(values[np.argmax(count)])
        there = int((data.taken[:, k] & (data.readings[:, k] == value)).sum())
        if there <= count.max() / _ONE_VALUE:
            yield (
                f"{name} is {value + 0.0:.8g} in {int(count.max())} of these {len(rows)} rows: lost readings, "
                "or an instrument at the end of its range, it seems; leave these cells empty"
            )


def _in_large(value: float, unit: str) -> str:
    """A size, in mm from a thousand µm on."""
    return f"{number(1e-3 * value)} mm" if unit == "µm" and value >= 1e3 else f"{number(value)} {unit}"


def _visits(time: Floats | None, outliers: Bools) -> Bools:
    """Rows of visits to the machine (stretches of time with a long pause on either side) that are off as a whole.

    When all that was read after a pause is off, that is no accident of single readings, it is news.
    """
    out = np.zeros(len(outliers), dtype=bool)
    if time is None or len(outliers) < 2:
        return out
    steps = np.diff(time)
    visit = np.concatenate([[0], np.cumsum(steps > _PAUSE * max(float(np.median(steps)), 1e-12))])
    count = np.bincount(visit)
    share = np.bincount(visit, outliers) / count
    return ((share >= _OUTLYING_VISIT) & (count >= _FEWEST_OF_A_VISIT))[visit]
