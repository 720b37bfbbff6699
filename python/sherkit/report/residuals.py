"""What a fit leaves of a run, ready to be drawn: any machine, in the unit that people read; of a long run, the rows
that are drawn.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from weakref import WeakKeyDictionary

import numpy as np

from ..base.types import Bools, Floats, Ints
from ..data import Measurements
from ..data.noise import ReadingNoise
from ..diagnosis import Diagnosis
from ..evidence.fitted_run import FittedRun
from ..fit.identify import Fit
from .picture import spread_over


@dataclass(frozen=True, eq=False)
class Residuals:
    """Measured minus predicted, ``values`` (n, m) in ``unit``, NaN where nothing was taken.

    ``names`` are those of the m readings; ``noise`` (m,) their noise in ``unit`` and ``noise_origin`` how it is known;
    ``place`` up to three coordinates (n,) of where the machine was; ``variables`` (n,) everything the error may depend
    on; ``group`` (n,) is equal for repeats of a pose; ``row`` (n,) is the row of the run, ``line`` (n,) its number in
    the file, counted in ``counted``; ``outlier`` (n,) marks rows that were not fitted; ``turn`` (m, m) is that from the
    axes of ``place`` to those of the readings, where they are others.
    """

    names: tuple[str, ...]
    unit: str
    values: Floats
    noise: Floats
    noise_origin: str
    place: Mapping[str, Floats]
    variables: Mapping[str, Floats]
    group: Ints
    row: Ints
    line: Ints
    counted: str
    outlier: Bools
    turn: Floats | None = None

    @classmethod
    def at(cls, place: Mapping[str, Floats], values: Floats, names: Sequence[str], unit: str) -> Residuals:
        """Errors (n, m) at places that are no rows of a run; what is noise of them is not known."""
        every = np.arange(len(values))
        return cls(
            tuple(names), unit, values, np.zeros(len(names)), "unknown", place, place, every, every, every + 1, "pose",
            np.zeros(len(values), dtype=bool),
        )  # fmt: skip

    def __len__(self) -> int:
        return len(self.values)

    @property
    def noise_size(self) -> float:
        """The noise as the error is counted: of all that is read of a row together."""
        return float(np.linalg.norm(self.noise))

    def with_noise_of(self, found: Diagnosis | None) -> Residuals:
        """The same beside the noise that a diagnosis knows: what an effect moves between repeats of a pose is none."""
        noise = np.array([np.nan if found is None else found.noise.get(name, np.nan) for name in self.names])
        if found is None or found.noise_origin == "unknown" or not np.isfinite(noise).all():
            return self
        return self if np.allclose(noise, self.noise) else replace(self, noise=noise, noise_origin=found.noise_origin)

    @cached_property
    def rms(self) -> Floats:
        """Root mean square of each reading (m,) over rows that are not marked as outliers."""
        used = np.where(self.outlier[:, None], np.nan, self.values)
        count = np.isfinite(used).sum(axis=0)
        return np.sqrt(np.nansum(used**2, axis=0) / np.maximum(count, 1))


#: Part of the span of what counts at which rows that are left out stand beyond it.
_RIM = 0.06
#: Behind the number of a row that stands at the rim.
BEYOND = " (at the rim: farther off, and left out)"


def at_the_rim(left: Residuals, values: Floats) -> tuple[Floats, list[str]]:
    """``values`` (n, m) as they are drawn: rows that are left out stand at the rim of those that count, where they are
    farther off, and what is said behind the number of each row."""
    counted = np.where(left.outlier[:, None], np.nan, values)
    if not left.outlier.any() or not np.isfinite(counted).any():
        return values, [""] * len(values)
    low, high = (np.array([f(c[np.isfinite(c)], initial=0.0) for c in counted.T]) for f in (np.min, np.max))
    margin = _RIM * (high - low)
    drawn = np.where(left.outlier[:, None], np.clip(values, low - margin, high + margin), values)
    moved = (np.nan_to_num(drawn) != np.nan_to_num(values)).any(axis=1)
    return drawn, [BEYOND if one else "" for one in moved]


@dataclass(frozen=True, eq=False)
class ModelState:
    """A fit to look at, under its title, and what it leaves, beside the noise of the diagnosis where one is known."""

    title: str
    fit: Fit
    found: Diagnosis | None = None

    @cached_property
    def left(self) -> Residuals:
        """Measured minus predicted."""
        return residuals_of(self.fit).with_noise_of(self.found)


def residuals_of(fit: Fit) -> Residuals:
    """What a fit leaves, on every row of its run that has a reading; computed once for each fit."""
    if fit not in _KNOWN:
        _KNOWN[fit] = _residuals(fit)
    return _KNOWN[fit]


_KNOWN: WeakKeyDictionary[Fit, Residuals] = WeakKeyDictionary()


def _residuals(fit: Fit) -> Residuals:
    run, data = FittedRun(fit), fit.data
    axes = list(run.axes)
    residuals = run.per_unit * run.residuals[:, axes]
    rows = np.flatnonzero(np.isfinite(residuals).any(axis=1)).astype(np.int64)
    variables, place = run.variables(rows)
    sigma, origin = run.noise
    return Residuals(
        names=tuple(run.names[a] for a in axes),
        unit=run.unit,
        values=residuals[rows],
        noise=run.per_unit * sigma[axes],
        noise_origin=origin,
        place={name: variables[name] for name in place},
        variables=variables | _directions(data, rows),
        group=data.select(rows).groups,
        row=rows,
        line=data.line[rows],
        counted=data.counted,
        outlier=data.outlier[rows],
        turn=run.turn_of_readings,
    )


def in_place(left: Residuals) -> Residuals:
    """The same along the axes of its places: an arrow there points where the robot went."""
    if left.turn is None:
        return left
    return replace(left, values=left.values @ left.turn, noise=np.sqrt(left.noise**2 @ left.turn**2), turn=None)


def in_noise(left: Residuals) -> Residuals:
    """The same, counted in the noise of each reading: σ."""
    return replace(left, unit="σ", values=left.values / left.noise, noise=np.ones(len(left.names)))


def _directions(data: Measurements, rows: Ints) -> dict[str, Floats]:
    """Sign of the last motion of each joint, where it is known and both signs occur."""
    columns = {f"direction_{k + 1}": column[rows] for k, column in enumerate(data.direction.T)}
    return {name: v for name, v in columns.items() if np.isfinite(v).all() and np.ptp(v) > 0}


# -- The rows of a long run that are drawn: pictures cost what they show, not what was measured -----------------------

#: So many rows are drawn of a run, and its extremes.
MOST_ROWS = 6000


def drawn_rows(data: Measurements, most: int) -> Ints:
    """Which rows to draw: whole poses chosen at random (the same ones each time), so that repeats stay together, and
    with them the lowest and the highest of every column, and rows marked as outliers."""
    columns = [*data.joints.T, *data.readings.T, *data.covariates.values()]
    columns += [] if data.time_s is None else [data.time_s]
    extremes = [at for v in columns if np.isfinite(v).any() for at in (np.nanargmin(v), np.nanargmax(v))]
    marked = np.flatnonzero(data.outlier)
    keep = [*extremes, *spread_over(marked, most // 4)]
    _, pose, size = np.unique(data.groups, return_inverse=True, return_counts=True)
    random = np.random.default_rng(0)
    if size.max() > most // 4:  # few poses, read over and over: single readings of them
        chosen = random.permutation(len(data))[:most]
    else:
        order = random.permutation(len(size))
        enough = int(np.searchsorted(np.cumsum(size[order]), most))
        chosen = np.flatnonzero(np.isin(pose, order[:enough]))
    return np.union1d(chosen, np.array(keep, dtype=np.int64))


def drawn(fit: Fit, most: int = MOST_ROWS) -> Fit:
    """A fit with the same values on the rows of its run that are drawn; itself where these are all.

    The same rows for every fit of a run, since all are chosen by what was read.
    """
    if len(fit.data) <= most:
        return fit
    return on_rows(fit, drawn_rows(fit.data, most))


def on_rows(fit: Fit, rows: Ints) -> Fit:
    """A fit with the same values on some rows of its run."""
    return replace(fit, data=fit.data.select(rows), noise=ReadingNoise(fit.noise.sigma[rows], fit.noise.origin))


def said(count: int, of: int) -> str:
    """What the note under a picture says of it; nothing where every row is drawn."""
    if count == of:
        return ""
    return (
        f" Drawn are {count} of the {of} rows: whole poses chosen at random, the lowest and highest values, "
        "and marked outliers."
    )
