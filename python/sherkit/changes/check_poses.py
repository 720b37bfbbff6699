"""Poses of an interim check: those that would see most of what may have changed."""

from __future__ import annotations

from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from ..base import linalg
from ..base.arguments import Count, Seed, validate_arguments
from ..fit.error import axes_of
from ..model.kinds import kind_of
from ..planning.region import CANDIDATES, Region, planned
from ..planning.to_measure import showing_first
from ..robots.calibrated import Calibration, load_calibration
from .check_rows import Known
from .runs import change_candidates, change_columns
from .vouching import stand_columns


@validate_arguments
@linalg.one_thread()
def verifying_poses(
    calibration: Calibration | str | PathLike[str], count: Count = 12, *, seed: Seed = 0
) -> list[dict[str, float]]:
    """The poses that would see most: chosen one after another so that all changes of plausible size show beside the
    stand of the sensor; in a random order. Raises :class:`~sherkit.errors.ExperimentError` for a robot whose file does
    not say how far it may go."""
    made = load_calibration(Path(calibration)) if isinstance(calibration, str | PathLike) else calibration
    known = Known.of(made)
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
