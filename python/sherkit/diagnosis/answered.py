"""The answer of a diagnosis, put together from what was found."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..base.figures import listed
from ..base.types import Floats, Ints
from ..data.doubts import DataWarning
from ..evidence.base import chance_of
from ..evidence.fitted_run import FittedRun
from ..evidence.plausible import implausible
from ..fit.set_up import Mistake
from .checks import checks_of
from .findings import findings_of
from .held_out import backward_elimination, candidates_of, noise_quantile, strongest, unnamed
from .next_poses import Proposal, next_poses
from .repeats import Rounded, contradicted, in_repeats
from .result import Check, Diagnosis, verdict_of
from .selection import NamedEffects, not_needed
from .sensor_pose import taken_by_pose
from .signature import bends_in_words, signature_of
from .where import confounded_with, neighbour_correlation, slow_drift_of, smallest_found, where


@dataclass(frozen=True, eq=False)
class Looked:
    """What a diagnosis has once all was looked for: the ``run`` that was searched, the ``long`` one of all rows, that
    ``of_all`` with what was ``found`` in its model; the noise ``sigma`` of a reading and its ``origin``; what is
    ``wrong`` with the ``outliers``; ``mistakes`` of the set-up, doubts of the ``table``, columns that are ``rounded``;
    ``notes``; whether there was anything to ``look`` for."""

    run: FittedRun
    long: FittedRun
    of_all: FittedRun
    found: NamedEffects
    sigma: Floats
    origin: str
    outliers: Ints
    wrong: Sequence[Check]
    mistakes: Sequence[Mistake]
    table: Sequence[DataWarning]
    rounded: Rounded | None
    notes: list[str]
    look: bool
    level: float
    seed: int
    repeated_folds: Sequence[Ints]


def diagnosis_of(looked: Looked) -> Diagnosis:
    """What is said of it."""
    run, found, of_all, sigma, origin, look = (
        looked.run, looked.found, looked.of_all, looked.sigma, looked.origin, looked.look,
    )  # fmt: skip
    level, seed, repeated_folds, mistakes = looked.level, looked.seed, looked.repeated_folds, looked.mistakes
    final, notes = found.final, list(looked.notes)
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
        final, found, sigma, origin, needed, level, looked.wrong, mistakes, looked.table, looked.rounded, slow_drift,
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
    # who added one of a tie chose it, and no reading did
    for effect in own if verdict == "adequate" and not run.is_exact else ():
        if others := () if effect.frees else found.first.in_place_of(effect):
            caveats.append(f"{effect.name}, which is in the model, is not told from {listed(others)} by these rows")
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
        outliers=looked.outliers,
        next_poses=proposal.poses,
        advice=proposal.advice,
        notes=tuple(notes),
        fit=of_all.fit,
        base=looked.long.fit,
        elsewhere=None if run.is_exact or not look else final.fit.elsewhere,
    )
    return replace(said, findings=findings_of(said))


def _next(found: NamedEffects, sigma: Floats) -> Proposal:
    """Poses that would tell what is named from the sets tied with it."""
    rivals = [other.run.of.fit for other in found.ties]
    return next_poses(found.final.fit, rivals, sigma) if rivals else Proposal()


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
