"""Diagnosis: is anything missing, where, which effect, what it cannot be told from, what to measure next."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy import special, stats

from ..data.given import RunLike
from ..errors import EffectError, FitError, SherkitError
from ..fit.identify import Fit, identify
from ..model.any import Model
from ..model.effect import Effect
from ..model.robot_file import RobotLike
from ..types import Floats, Ints
from .answers import CandidateReport, Diagnosis, StepReport
from .crossvalidation import HeldOutError, held_out
from .fitted_run import FittedRun
from .hiding import hides_in
from .next_poses import Proposal
from .power import smallest_found
from .search import Search, SearchResult, is_plausible, refit
from .shapes import Shape
from .slip import moment_of_step
from .stage import Candidate, Stage, columns_of, stage_of, suspected_outliers
from .where import neighbour_correlation, where

LEVEL = 0.01
#: Part of the data locked away before the search.
_LOCKED = 1.0 / 3.0
#: Fewer rows than this are not split.
_SPLIT_FROM = 90
_FOLDS = 6
_SMALLEST_P = 1e-300
#: Level at which an axis takes part in a signature.
_AXIS_LEVEL = 1e-3
#: An error of the poses' own is told from this part of the noise on.
_OWN = 0.5
#: One-sided level of the confirmation on the locked rows.
_CONFIRMED = 0.05


def diagnose(
    fit: Fit | RobotLike | Model,
    data: RunLike = None,
    *,
    effects: Sequence[Effect] = (),
    level: float = LEVEL,
    seed: int = 0,
    step: Callable[[str], None] = lambda _: None,
) -> Diagnosis:
    """Diagnoses what a fit leaves, or what that of a robot or model to ``data`` does, as :func:`identify` takes them.

    ``effects`` are the user's own, beside the catalogue or the model's candidates. Raises
    :class:`~sherkit.errors.FitError` where there is too little to diagnose, and
    :class:`~sherkit.errors.EffectError` for a user's effect that is none.
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
    run = FittedRun(fit)
    for effect in effects:
        run.model.check_effect(effect, run.data, fit.values)
    every = (*run.catalogue, *effects)
    axes = run.axes
    notes: list[str] = []

    step("noise and outliers")
    run, wild = _without_outliers(run, every)
    sigma, origin = run.noise
    rows = np.flatnonzero(run.whole)
    if len(wild):
        notes.append(f"{len(wild)} suspected outliers are listed and left out of the tests")
    if origin == "unknown":
        sigma = _residual_sigma(run)
        notes.append(
            "neither repeats nor a declared noise: how much of the rest is noise cannot be known, only whether "
            "it has structure; repeat some poses or add sigma columns"
        )
    block = run.blocks(_FOLDS, seed)
    split = len(rows) >= _SPLIT_FROM
    locked = np.isin(block[rows], np.arange(round(_FOLDS * _LOCKED))) if split else np.zeros(len(rows), dtype=bool)

    # on all rows: among those that are left after locking some away, neighbours are rare
    base_stage = stage_of(run, every, rows, sigma, thorough=False)
    search = Search(run, every, rows[~locked], sigma, level=level, rho=base_stage.rho, seed=seed, step=step)
    found = search.find()

    confirmed = _confirm(search, found, run, rows[locked]) if found.added and locked.any() else None
    if found.added and not found.explained and confirmed is not None and confirmed > _CONFIRMED:
        # effects that leave something and do not help on the locked rows have not earned their names
        found = search.without_effects(found)
        confirmed = None

    step("fitting all rows")
    found.added = [_at_its_moment(run, found.added, c) for c in found.added]
    final = refit(run, found.added) if found.added else run
    stage = stage_of(final, every, rows, sigma, rho=search.rho, thorough=False) if found.added else base_stage

    step("held-out errors")
    base_error, gains = held_out(base_stage, block[base_stage.rows])
    steps = [StepReport(None, base_error.rms)]
    partial = run
    for k, candidate in enumerate(found.added):
        last = k == len(found.added) - 1
        partial = final if last else refit(partial, (candidate,))
        here = stage if last else stage_of(partial, (), rows, sigma, rho=search.rho, thorough=False)
        steps.append(StepReport(candidate.name, held_out(here, block[here.rows])[0].rms))

    if origin != "declared":
        sigma = _noise_left(final, sigma)
    verdict = _verdict(found, level)
    own = _own_errors(final, sigma, level) if origin == "repeats" and not found.signature else None
    if own:
        notes.append(own)
    ties = _ties(found)
    reports = _candidate_reports(search, base_stage, gains, final, found)
    smallest: dict[str, tuple[float, float]] = {}
    if verdict == "adequate":
        threshold = float(np.quantile(found.stages[0].plain.null(199, seed), 1 - level))
        smallest = {c.name: smallest_found(stage, c, threshold) for c in search.strongest_settings(stage)}
    signature = _signature(found, found.stages[-1]) if found.signature else None
    proposal = _next(found, sigma) if ties else Proposal()
    return Diagnosis(
        verdict=verdict,
        unit=run.unit,
        noise={run.names[a]: run.per_unit * float(sigma[a]) for a in axes},
        noise_origin=origin,
        correlation_in_time=float(search.rho or 0.0),
        level=level,
        p_missing=found.p_first,
        effects=tuple(c.name for c in found.added),
        ties=ties,
        steps=tuple(steps),
        candidates=reports,
        untestable=dict(base_stage.untestable),
        smallest_found=smallest,
        where=where(base_stage),
        neighbour_correlation=neighbour_correlation(base_stage),
        confirmed=confirmed,
        signature=signature,
        hides_in=hides_in(base_stage),
        outliers=wild,
        next_poses=proposal.poses,
        advice=proposal.advice,
        notes=tuple(notes),
        fit=final.fit,
        base=run.fit,
        stage=stage,
    )


def _without_outliers(run: FittedRun, effects: Sequence[Effect]) -> tuple[FittedRun, Ints]:
    """The fit without the rows that are suspected to be outliers, and these rows."""
    wild = np.zeros(0, dtype=np.int64)
    while len(more := suspected_outliers(run, effects)):
        run, wild = run.without(more), np.sort(np.concatenate([wild, more]))
        if not run.data.layout.worst_first:
            break
    return run, wild


def _next(found: SearchResult, sigma: Floats) -> Proposal:
    """Poses that would tell the leading set from those tied with it."""
    return found.stages[-1].run.next_poses([other.stage.run for other in found.alternatives], sigma)


def _at_its_moment(run: FittedRun, added: Sequence[Candidate], candidate: Candidate) -> Candidate:
    """A slip at the moment that all rows give, with the other effects in the model."""
    if candidate.effect.search != "time_s":
        return candidate
    others = [c for c in added if c is not candidate]
    moment = moment_of_step(refit(run, others) if others else run, candidate.effect)
    return candidate if moment is None else replace(candidate, setting=moment)


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
    return out


def _own_errors(run: FittedRun, sigma: Floats, level: float) -> str | None:
    """What poses leave beyond their repeats without any pattern (lack of fit against pure error), as a sentence."""
    told = []
    parameters = len(run.fit.values) / len(run.axes)
    for a in run.axes:
        used = run.used[:, a]
        group = np.unique(run.data.groups[used], return_inverse=True)[1]
        count = np.bincount(group)
        between, within = len(count) - parameters, int((count - 1).sum())
        if between < 5 or within < 5 or not sigma[a] > 0:
            continue
        mean = np.bincount(group, run.residuals[used, a]) / count
        square = float((count * mean**2).sum() / between)
        own = np.sqrt(max(square - sigma[a] ** 2, 0.0) / count.mean())
        if stats.f.sf(square / sigma[a] ** 2, between, within) < level / len(run.axes) and own > _OWN * sigma[a]:
            told.append(f"{run.names[a]} {run.per_unit * own:.2g}")
    if not told:
        return None
    return (
        "repeats agree better than poses do: each pose is off by an error of its own "
        f"({', '.join(told)} {run.unit}) that no effect and no shape follows; "
        "look at what differs from pose to pose but not between repeats: how the marker "
        "is found, seating, a reading taken before it is still"
    )


def _residual_sigma(run: FittedRun) -> Floats:
    sigma = np.ones(len(run.names))
    for a in run.axes:
        sigma[a] = max(float(np.std(run.residuals[run.used[:, a], a])), 1e-12)
    return sigma


def _verdict(found: SearchResult, level: float) -> str:
    if not found.added and not found.signature:
        return "adequate" if found.p_left > level else "unexplained"
    if found.explained:
        return "explained"
    return "partly explained" if found.added else "unexplained"


def _ties(found: SearchResult) -> tuple[tuple[str, ...], ...]:
    """Groups of effects each of which could stand in for the first, everything else as it is."""
    lead = [c.name for c in found.added]
    groups: dict[str, list[str]] = {}
    for other in found.alternatives:
        names = set(other.names)
        shared = names & set(found.replaced)
        out = [n for n in found.replaced if n not in shared]
        new = [n for n in other.names if n not in shared]
        if out and new:
            groups.setdefault(out[0], [out[0]]).extend(n for n in new if n not in groups[out[0]])
    return tuple(tuple(g) for name, g in groups.items() if name in lead and len(g) > 1)


def _candidate_reports(
    search: Search, base: Stage, gains: list[HeldOutError], final: FittedRun, found: SearchResult
) -> tuple[CandidateReport, ...]:
    """Every effect that could be tried, the named ones first, then by held-out error."""
    z = base.deviates[base.n_shapes :]
    best: dict[str, tuple[float, HeldOutError, Candidate]] = {}
    for score, error, candidate in zip(z.tolist(), gains, base.candidates, strict=True):
        if candidate.name not in best or error.rms < best[candidate.name][1].rms:
            best[candidate.name] = (score, error, candidate)
    fits = {c.name: final for c in found.added}
    for alternative in found.alternatives:
        for candidate in alternative.candidates:
            fits.setdefault(candidate.name, alternative.stage.run)
    out = []
    for name, (score, error, candidate) in best.items():
        # kept above what a float can tell from zero: a p of zero would claim too much
        p = min(1.0, max(len(best) * float(special.ndtr(-score)), _SMALLEST_P)) if np.isfinite(score) else 1.0
        values, std, ok = _parameters(base, candidate, fits.get(name))
        parameters = tuple(
            {"name": q.name, "value": v, "std": s, "unit": q.unit}
            for q, v, s in zip(candidate.effect.parameters, values.tolist(), std.tolist(), strict=True)
        )
        out.append(CandidateReport(name, candidate.effect.link, error.rms, error.std, p, ok, parameters))
    named = [c.name for c in found.added]
    out.sort(key=lambda c: (named.index(c.effect) if c.effect in named else len(named), c.held_out_rms))
    return tuple(out)


def _parameters(base: Stage, candidate: Candidate, run: FittedRun | None) -> tuple[Floats, Floats, bool]:
    """Values, deviations and plausibility of a candidate: from its full fit, else in linear approximation."""
    effect = candidate.effect
    if run is not None:
        place = run.owns(effect)
        return run.fit.values[place], run.fit.std_from_readings[place], is_plausible(run, effect)
    scan = base.scan
    columns = scan.take(candidate.columns)
    columns = columns - scan.basis @ (scan.basis.T @ columns)
    gram = columns.T @ columns
    length = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    value, vector = np.linalg.eigh(gram / np.outer(length, length))
    keep = value > 1e-10
    inverse = (vector[:, keep] / value[keep]) @ vector[:, keep].T / np.outer(length, length)
    x = inverse @ (columns.T @ scan.residual)
    std = np.sqrt(np.maximum(np.diag(inverse), 0.0))
    if candidate.columns.functions:
        unit = base.sigma / np.sqrt(scan.n / 4.0)
        x, std = x * unit, std * unit
    size = np.array([p.size for p in effect.parameters])
    return x, std, bool((np.abs(x) - 2 * std <= 5 * size).all())


def _confirm(search: Search, found: SearchResult, run: FittedRun, locked: Ints) -> float:
    """One-sided p that the added effects help on the rows that were locked away, coefficients frozen.

    Paired differences of squared error, signs flipped over whole poses.
    """
    # what the search fitted last has just these effects
    before, after = search.base, found.stages[-1].run
    axes = run.axes
    sigma = search.sigma[list(axes)]

    def squares(one: FittedRun) -> Floats:
        return ((run.residuals_on(locked, one)[:, axes] / sigma) ** 2).sum(axis=1)

    try:
        gain = squares(before) - squares(after)
    except SherkitError:
        return 1.0
    per_pose = np.bincount(np.unique(run.data.groups[locked], return_inverse=True)[1], gain)
    signs = np.random.default_rng(search.seed).integers(0, 2, (1999, len(per_pose))) * 2.0 - 1.0
    return float((1 + (signs @ per_pose >= per_pose.sum()).sum()) / 2000)


def _signature(found: SearchResult, stage: Stage) -> dict[str, Any]:
    """The leading shape of what no effect explains, in words and numbers. ``stage`` has it among its shapes."""
    shape: Shape = stage.nuisance[0]
    before = stage
    plain = stage.scan.condition(np.zeros((stage.scan.n * stage.scan.m, 0)))
    given = stage.scan.condition(stage.scan.take(columns_of(shape)))
    gain = plain.sum_of_squares - given.sum_of_squares
    # what is left once every shape that was found is in the model stands for the noise
    excess = max(plain.sum_of_squares - stage.plain.sum_of_squares * plain.free / stage.plain.free, gain)
    axis = [before.run.names[before.axes[shape.axis]]] if shape.axis is not None else _axes_of(before, shape)
    return {
        "depends_on": list(shape.depends_on),
        "shape": shape.shape,
        "order": shape.order,
        "period": shape.period,
        "axis": axis,
        "share_explained": float(np.clip(gain / excess, 0.0, 1.0)),
        "at": shape.setting,
        "joint": shape.pattern,
        "ranges": {name: _range(before.view.variables[name]) for name in shape.depends_on},
    }


def _range(values: Floats) -> tuple[float, float]:
    """Middle and half width of a variable's values."""
    low, high = float(values.min()), float(values.max())
    return (0.5 * (low + high), 0.5 * (high - low) or 1.0)


def _axes_of(stage: Stage, shape: Shape) -> list[str]:
    """Axes on which a shape takes more than noise would."""
    columns = stage.scan.take(columns_of(shape))
    columns = columns - stage.scan.basis @ (stage.scan.basis.T @ columns)
    x = np.linalg.lstsq(columns, stage.scan.residual, rcond=1e-9)[0]
    by_axis = ((columns @ x).reshape(stage.scan.n, stage.scan.m) ** 2).sum(axis=0)
    noise = stage.plain.sum_of_squares / stage.plain.free
    count = max(len(shape.functions), len(shape.dense))
    enough = noise * float(special.chdtri(count, _AXIS_LEVEL))
    axes = [stage.run.names[stage.axes[k]] for k in range(stage.scan.m) if by_axis[k] > enough]
    return axes or [stage.run.names[stage.axes[int(np.argmax(by_axis))]]]
