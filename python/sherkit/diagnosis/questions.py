"""Diagnosis: is anything missing, where, which effect, what it cannot be told from, what to measure next."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import scipy

from ..base import linalg
from ..base.arguments import Level, Seed, as_annotated
from ..base.types import Floats
from ..data.doubts import doubts
from ..data.reader import RunLike
from ..errors import EffectError, FitError
from ..evidence.fitted_run import FittedRun, enough_of
from ..evidence.sizes import TOLD, implausible, is_plausible
from ..fit.error import repeated_folds_of
from ..fit.forms import known
from ..fit.identify import Fit, identify
from ..fit.set_up import held, set_up_mistakes, unread
from ..model.any import Model
from ..model.effect import Effect
from ..model.robot_file import RobotLike
from .answers import CandidateReport, Diagnosis, verdict_of
from .checked import chance_of, checks_of
from .findings import findings_of
from .gathered import checks_of_outliers
from .held_out import HeldOutError, by_noise_alone, few_enough, held_out
from .lack_of_fit import lack_of_fit
from .named import Named, as_shown, not_needed, searched
from .next_poses import Proposal, next_poses
from .outliers import is_first_by_side, sentences, without_outliers
from .repeats import by_repeats, in_repeats, same_within_poses, with_the_way
from .rounded import steps_in
from .sensor_pose import taken_by_pose
from .signature import signature_of
from .stage import Candidate, Stage
from .where import confounded_with, neighbour_correlation, slow_drift_of, smallest_found, where

LEVEL = 0.01
#: Numbers up to which a single effect is taken by its name without asking what an unknown would look like.
_FEW = 6
_SMALLEST_P = 1e-300
#: Part of a column's square below which what is left of it is rounding.
_ROUNDING = 1e-14
#: Level at which an axis takes part in a signature.
_AXIS_LEVEL = 1e-3


@as_annotated
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
    step("mistakes of the set-up")
    run = FittedRun(fit)
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
        *held(run.data),
        *unread(run.data),
        *map(str, run.data.set_ups),
    ]

    step("noise and outliers")
    # beside a mistake of the set-up every row may look wrong
    run, outliers = (run, np.zeros(0, dtype=np.int64)) if not look else without_outliers(run, every, keep)
    sigma, origin = run.noise
    rows = np.flatnonzero(run.whole)
    side = is_first_by_side(run, every, outliers)
    notes += sentences(run.fit, outliers, side=side)
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
    step("what repeats hold")
    # what is left of a mistake of the set-up tells nothing of noise
    repeats = None if mistakes or run.is_exact else in_repeats(run, seed=seed)
    contradicted: dict[str, tuple[float, float]] = {}
    if repeats is not None:
        run = run.with_data(with_the_way(run.data, repeats.held, run))
        shown, contradicted = by_repeats(run, sigma, repeats, declared=origin == "declared")
        if not np.array_equal(shown, sigma):
            # axes were weighed by what repeats hold
            run, sigma = run.on(np.arange(len(run.data)), shown), shown
        origin = "repeats" if contradicted else origin
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
        there = searched(
            steps.put_back, every, rows, sigma, repeated_folds, level=level, seed=seed, step=step, look=True
        )
        steps = None if there.names else steps
    look, rounded = look and steps is None, None if steps is None else steps.rounded
    found = searched(run, every, rows, sigma, repeated_folds, level=level, seed=seed, step=step, look=look)
    final, rho = found.final, found.search.rho
    of_all = final if run is long else long if final is run else final.as_in(long)
    # a row that is as what was found says was wrong beside a model that lacked it
    wrong = checks_of_outliers(of_all, outliers, seed, side=side)
    notes += found.notes
    notes += [f"{one.sentence}. {one.remedy}" for one in known(final.fit).values()]

    step("fitting all rows")
    base_stage = as_shown(found)
    gains = held_out(base_stage, np.stack([repetition[rows][base_stage.rows] for repetition in repeated_folds]))

    left = repeats
    if repeats is not None and not same_within_poses(long, of_all):
        left = in_repeats(of_all, seed=seed)
    if origin != "declared":
        sigma = _noise_left(of_all, sigma) if left is None else left.noise
    own = [e for e in run.model.effects if e.name not in run.model.within]
    needed = not_needed(final, own, sigma, repeated_folds, seed)
    fitness = lack_of_fit(of_all, level)
    slow_drift = slow_drift_of(of_all)
    checks = checks_of(
        final, found, sigma, origin, fitness, needed, level, wrong, mistakes, table, rounded, slow_drift,
        left, contradicted, lambda: by_noise_alone(final, sigma, repeated_folds, level, seed),
        lambda: few_enough(final, sigma, repeated_folds),
    )  # fmt: skip
    verdict = verdict_of(checks, found.names)
    caveats = [told] if (told := implausible(final.fit, found.names)) else []
    # where something else is left, that may be what changes with time
    if slow_drift is not None and slow_drift.counts and verdict in ("adequate", "explained"):
        caveats.append(
            f"{slow_drift.axis} wanders by {slow_drift.size:.3g} {run.unit} in the course of the run, beside "
            f"{slow_drift.beside:.3g} from row to row, and nothing in the file says with what: here that counts "
            "as noise; look for what changes slowly (temperature, humidity, a stand that gives way) and record it as a "
            "column"
        )
    indistinguishable = _ties(found)
    reports = _candidate_reports(base_stage, gains, final, found)
    smallest: dict[str, tuple[float, float]] = {}
    if verdict == "adequate" and not final.is_exact:
        threshold = float(np.quantile(found.stage.scan.null(seed)[1:], 1 - level))
        smallest = {
            c.name: smallest_found(base_stage, c, threshold) for c in found.search.strongest_settings(base_stage)
        }
    signature = left.signature(of_all) if left is not None and left.held else None
    if found.structure and found.names_judged is not None:
        signature = signature_of(found.names_judged, tuple(found.names)) or signature
    proposal = _next(found, sigma)
    said = Diagnosis(
        verdict=verdict,
        unit=run.unit,
        noise={run.names[a]: run.per_unit * float(sigma[a]) for a in run.axes},
        noise_origin=origin,
        correlation_in_time=float(rho or 0.0),
        level=level,
        p_missing=chance_of(found.missing),
        effects=found.names,
        not_needed=tuple(one.effect for one in needed if not one.holds),
        checks=checks,
        caveat="; ".join(caveats) or None,
        indistinguishable=indistinguishable,
        steps=found.steps,
        candidates=reports,
        untestable=dict(base_stage.untestable),
        smallest_found=smallest,
        where=where(base_stage),
        neighbour_correlation=neighbour_correlation(base_stage),
        confirmed=max((one.p for one in found.gains), default=None),
        signature=signature,
        confounded_with=confounded_with(base_stage),
        taken_by_pose={} if run.is_exact else taken_by_pose(run.model, run.data, run.fit.values, run.catalogue),
        outliers=outliers,
        next_poses=proposal.poses,
        advice=proposal.advice,
        notes=tuple(notes),
        fit=of_all.fit,
        base=long.fit,
    )
    return replace(said, findings=findings_of(said))


def _next(found: Named, sigma: Floats) -> Proposal:
    """Poses that would tell what is named from the sets tied with it."""
    rivals = [other.run.of.fit for other in found.ties]
    return next_poses(found.final.fit, rivals, sigma) if rivals else Proposal()


def _noise_left(run: FittedRun, sigma: Floats) -> Floats:
    """Noise once what was found is in the model: repeats of a pose then differ by noise alone, whatever varied
    between them; without repeats, what is left."""
    out = sigma.copy()
    for a in run.axes:
        used = run.used[:, a]
        group = np.unique(run.data.groups[used], return_inverse=True)[1]
        count = np.bincount(group)
        free = int((count - 1).sum())
        left = run.residuals[used, a]
        if free >= 5:
            mean = np.bincount(group, left) / count
            out[a] = np.sqrt(((left - mean[group]) ** 2).sum() / free)
        else:
            out[a] = left.std()
    return np.maximum(out, run.digits)


def _ties(found: Named) -> tuple[tuple[str, ...], ...]:
    """Groups of effects each of which could stand in for the first, everything else as it is."""
    groups: dict[str, list[str]] = {}
    for other in found.ties:
        out = [n for n in found.names if n not in other.names]
        new = [n for n in other.names if n not in found.names]
        if out and new:
            groups.setdefault(out[0], [out[0]]).extend(n for n in new if n not in groups[out[0]])
    return tuple(tuple(group) for group in groups.values())


def _candidate_reports(
    base: Stage, gains: list[HeldOutError], final: FittedRun, found: Named
) -> tuple[CandidateReport, ...]:
    """Every effect that could be tried, the named ones first, then by held-out error: in linear approximation, but for
    the first one that is named, which has a fit of its own."""
    z = base.scan.z_scores[base.n_shapes :]
    best: dict[str, tuple[float, HeldOutError, Candidate]] = {}
    for score, error, candidate in zip(z.tolist(), gains, base.candidates, strict=True):
        if candidate.name not in best or error.rms < best[candidate.name][1].rms:
            best[candidate.name] = (score, error, candidate)
    fits = {c.name: final for c in found.added}
    for tied in found.ties:
        for name in tied.names:
            fits.setdefault(name, tied.run.of)
    fitted = {s.effect: s.error.rms for s in found.steps[1:2]}
    out = []
    for name, (score, error, candidate) in best.items():
        # kept above what a float can tell from zero: a p of zero would claim too much
        p = min(1.0, max(len(best) * float(scipy.special.ndtr(-score)), _SMALLEST_P)) if np.isfinite(score) else 1.0
        values, std, ok = _parameters(base, candidate, fits.get(name))
        parameters = tuple(
            {"name": q.name, "value": v, "std": s, "size": q.size, "unit": q.unit}
            for q, v, s in zip(candidate.effect.parameters, values.tolist(), std.tolist(), strict=True)
        )
        left = fitted.get(name, error.rms)
        out.append(CandidateReport(name, candidate.effect.link, left, error.std, p, ok, parameters))
    named = [c.name for c in found.added]
    out.sort(key=lambda c: (named.index(c.effect) if c.effect in named else len(named), c.held_out_rms))
    return tuple(out)


def _parameters(base: Stage, candidate: Candidate, run: FittedRun | None) -> tuple[Floats, Floats, bool]:
    """Values, deviations and plausibility of a candidate: from its full fit, else in linear approximation."""
    effect = candidate.effect
    if run is not None:
        place = run.owns(effect)
        return run.fit.values[place], run.fit.std[place], is_plausible(run, effect, TOLD)
    columns = base.scan.of(candidate.columns)
    gram = columns.gram
    # of a column that the fit holds rounding is left: whatever that says of its size, the deviation is larger
    squares = np.maximum(np.diag(gram), np.maximum(_ROUNDING * np.diag(columns.whole), 1e-300))
    np.fill_diagonal(gram, squares)
    length = np.sqrt(squares)
    value, vector = linalg.eigh(gram / np.outer(length, length))
    keep = value > 1e-10
    inverse = (vector[:, keep] / value[keep]) @ vector[:, keep].T / np.outer(length, length)
    x = inverse @ columns.by_residual
    std = np.sqrt(np.maximum(np.diag(inverse), 0.0))
    if candidate.columns.functions:
        unit = base.sigma / np.sqrt(base.scan.n / 4.0)
        x, std = x * unit, std * unit
    size = np.array([p.size for p in effect.parameters])
    return x, std, bool((np.abs(x) - 2 * std <= TOLD * size).all())
