"""Interim checks: whether a calibration still holds, by a dozen poses (reverification, ISO 10360), and by which.

The calibration's parameters are known with its covariance; the sensor stands anew. What the deployed model then misses
is held against what was promised, and every change that a machine can have against what is seen.
"""

from __future__ import annotations

from os import PathLike
from typing import Any

import numpy as np
import scipy

from ..adaptive.gate import Silent, power_of, silence, still
from ..base import linalg
from ..base.arguments import Count, Seed, validate_arguments
from ..data.doubts import copied
from ..data.reader import RunLike
from ..errors import FitError
from ..evidence.names import judged_names
from ..evidence.thresholds import ACCIDENT, ALARM, NEARLY_ALWAYS, NEEDED
from ..evidence.whitening import InCommon, orthonormal
from ..fit.error import axes_of
from ..model.kinds import kind_of, required_um
from ..planning.region import CANDIDATES, Region, planned
from ..planning.to_measure import showing_first
from ..robots.calibrated import Calibration
from .check_rows import SINCE, CheckRows, Known, noise_of
from .courses import ChangeSets
from .pool import predicted, rows_of
from .runs import change_candidates, change_columns
from .verified import Verification, advice_of
from .vouching import (
    broken,
    error_of_lead,
    errors_at_work,
    mistaken,
    sights_of,
    smooth_fields,
    stand_columns,
    unable,
)

#: How often a valid calibration may be refused for what change is seen; for how much is, by accident
#: (benchmarks/changes.py).
_CHANGED = 0.015


@validate_arguments
@linalg.one_thread()
def verify(calibration: Calibration | str | PathLike[str], run: RunLike) -> Verification:
    """Whether a calibration still holds, by a run of a dozen poses or more. Raises
    :class:`~sherkit.errors.FitError` for a run that is too short to tell where the sensor stands.

        found = sk.verify("demo/calibrated.toml", "demo/local.csv")
        print(found.headline)
    """
    known = Known.of(calibration)
    made = known.calibration
    # as of a robot's file, its names are those of files
    called = made.columns if isinstance(run, str | PathLike) else {}
    data = rows_of(made.robot, known.model, run, called or None)
    data = data.select(np.argsort(data.order, kind="stable"))
    axes = axes_of(data)
    if not axes:
        raise FitError(f"{data.source}: verification needs coordinates; these rows are distances only")
    mute = silence(data, axes, 2 * len(axes), predicted(known.model, data, known.values)) or next(
        (Silent(one.sentence, "leave the copies out") for one in copied(data)), None
    )
    if data.digest in {part.digest for part in made.parts_made}:
        mute = Silent("these are the rows that it was calibrated from: nothing was measured since", "measure once more")
    if mute is not None:
        return Verification.unsaid(data, change_candidates(known.model, [data]), mute)
    wild = known.wild(data, axes)
    data = data.mark_outliers(wild) if len(wild) else data
    noise, noise_freedom, part = noise_of(known, data, axes)
    rows = CheckRows.of(known, data, axes, noise, part)
    model, used, stand = rows.model, rows.used, rows.stand
    in_common = InCommon.part(data.groups, part) if part else None
    both = np.concatenate([stand.columns, stand.residual[:, :, None]], axis=2)
    both = (both if in_common is None else in_common(np.where(used[:, :, None], both, 0.0)))[used]
    columns, residual = both[:, :-1], both[:, -1]
    basis = orthonormal(columns)
    freedom = int(used.sum()) - basis.shape[1]
    if freedom < 3:
        raise FitError(f"{data.source}: {len(data)} rows only tell where the sensor stands; expected a dozen poses")
    left = residual - basis @ (basis.T @ residual)
    per_row = float(np.sqrt(len(axes))) * data.layout.per_unit
    square = float(left @ left) / freedom
    seen = float(np.sqrt(max(square - noise**2, 0.0)))
    if (wrong := mistaken(model, data, axes, seen * per_row)) is not None:
        return Verification.unsaid(data, change_candidates(known.model, [data]), wrong)
    promised, lacked = known.promised(data, axes)
    base, unit = rows.base, rows.unit
    flat = stand.columns[rows.rows].reshape(-1, stand.columns.shape[2])
    off = max(1.0 if noise else 0.0, float(np.sqrt(base.rss / max(base.free, 1))))
    sights = sights_of(rows, base.family.run, SINCE, errors_at_work(rows, data), off)
    valid, least = None, np.inf
    if promised is not None:
        fields = [] if lacked else smooth_fields(model, data.select(rows.rows), rows.values, axes)
        chance, found_from = broken(base, flat, promised / unit, _CHANGED, fields)
        least = promised * found_from
        if chance <= _CHANGED:
            # repeats may have what has changed in them, and then pass it off as noise
            seen = max(seen, unit * error_of_lead(base, flat))
        allowed = (noise**2 + promised**2) * float(scipy.special.fdtri(freedom, noise_freedom, 1.0 - ACCIDENT))
        valid = bool(square <= allowed and (chance > _CHANGED or seen <= promised))
        if valid:
            power = power_of(sights, rows.required(promised), base.free, ALARM)
            if not power.speaks:
                mute = unable(power, (noise or off * unit) * per_row, data.layout.unit, data, axes)
            elif not np.isfinite(least):
                more = f"measure at more places than these {len(np.unique(data.groups))}, or read each more often"
                mute = Silent("its rows cannot tell an error of any size", more)
            valid = None if mute is not None else valid
    # what the model lacks looks like a change as long as it is no larger than it was
    evidence = 0.0 if valid and lacked else base.evidence
    judged = judged_names(ChangeSets(rows, SINCE[None], base)) if evidence >= ALARM else None
    # of too many things, or of none of these, nothing is named; two are, where each is needed as much as if there were
    # shapes to hold it against, which a dozen poses do not tell
    sure = judged is not None and (len(judged.told) < 2 or min(one.needed for one in judged.told) > NEEDED)
    told = judged if judged is not None and judged.explains and sure else None
    names, ties = (tuple(sorted(told.named)), told.tied) if told else ((), ())
    held = [name for name, same in zip(data.layout.joints, still(data.joints), strict=True) if same]
    # all of its numbers at their plausible sizes, with either sign
    size = {name: np.sqrt([np.trace(one.there)]) for name, one in sights.items()}
    shown = [name for name, one in sights.items() if one.chances(size[name], base.free, ALARM)[0] >= NEARLY_ALWAYS]
    return Verification(
        valid=valid,
        error={
            "seen": seen * per_row,
            "promised": None if promised is None else promised * per_row,
            "smallest_found": least * per_row if np.isfinite(least) else None,
        },
        unit=data.layout.unit,
        changed=names,
        indistinguishable=ties,
        parameters=told.lead.run.of.moved(names) if told and told.lead else (),
        evidence=evidence / float(np.log(10.0)),
        stand=stand.moved,
        would_show=tuple(shown),
        would_not=tuple(one.name for one in rows.candidates if one.name not in shown),
        advice=mute.measure if mute is not None else advice_of(valid, names, ties, evidence, held),
        silent="" if mute is None else f"{data.source}: {mute}",
        required_um=required_um(made.robot),
        set_aside=tuple(f"{data.counted} {data.line[row]}" for row in wild),
    )


@validate_arguments
@linalg.one_thread()
def verifying_poses(
    calibration: Calibration | str | PathLike[str], count: Count = 12, *, seed: Seed = 0
) -> list[dict[str, float]]:
    """The poses that would see most: chosen one after another so that all changes of plausible size show beside the
    stand of the sensor; in a random order. Raises :class:`~sherkit.errors.ExperimentError` for a robot whose file does
    not say how far it may go."""
    known = Known.of(calibration)
    made = known.calibration
    layout = kind_of(made.robot).layout
    region = Region.of(known.model, layout)
    places = region.spread(CANDIDATES, seed)
    rng = np.random.default_rng(seed)
    ways = {f"direction_{k + 1}": rng.choice([-1.0, 1.0], len(places)) for k in range(places.joints.shape[1])}
    rows = planned(places.joints, layout, ways)
    axes = axes_of(rows)
    candidates = change_candidates(known.model, [rows])
    columns = change_columns(known.model, known.values, rows, axes, candidates)
    stand = stand_columns(known.model, rows, known.values, axes)
    part: Any = made.parts_made[0]
    noise = float(np.sqrt(np.diag(part.residual_covariance + part.scatter).mean())) or 1.0
    sized = [columns[one.name] / noise for one in candidates]
    # of where the sensor stands next to nothing is known, of a change that it is of plausible size
    order = showing_first(stand, sized, int(count), stand.shape[2], rng)
    names = dict(zip(layout.joints, places.joints.T, strict=True))
    names |= dict(zip(region.targets, places.targets.T, strict=True))
    return [
        {"pose": k + 1, **{name: float(values[row]) for name, values in names.items()}} for k, row in enumerate(order)
    ]
