"""The error of a model: how far what was read lies from what the model says, pose by pose; and the radius that a
covariance stands for.

For what is read in one unit in space that is the distance in 3-D, for pixels and angles the length of the difference
of all that is read together: mean, root mean square, what 95 of 100 rows stay within, and the largest (ISO 9283:1998,
6.2, of single readings). It is held out wherever a model was fitted: each row is predicted by a fit that did not see
its block, in several ways to cut the run into blocks. All is linear around the full fit, so that a fit without a block
is a subtraction of Gram matrices.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
import scipy

from ..base import linalg
from ..base.figures import finite, number
from ..base.types import Bools, Floats, Ints
from ..data import Measurements
from ..data.noise import MIN_FREEDOM, ReadingNoise
from ..data.repeats import Repeatability, pure_error
from ..errors import FitError
from .folds import Folds, blocks, blocks_of

# -- Errors held out ---------------------------------------------------------------------------------------------------

#: Rows below which a fit without some of them is made anew: what it does not tell is then most of it.
_FEWEST = 10
#: Blocks that are held out in turn, and how often they are drawn anew so that nothing hangs on one draw.
_FOLDS = 6
_REPETITIONS = 5


@dataclass(frozen=True)
class ErrorSize:
    """Distances of ``rows`` rows from what a model says, in ``unit``: over ``axes`` readings of each together.

    ``held_out`` tells whether each was predicted by a fit that did not see it; ``by_reading`` are the root mean squares
    of single readings by the name of their column.
    """

    mean: float
    rms: float
    p95: float
    max: float
    unit: str
    held_out: bool
    axes: int = 1
    rows: int = 0
    by_reading: Mapping[str, float] = field(default_factory=dict)

    @classmethod
    def of(
        cls, squares: Floats, unit: str, *, held_out: bool, names: Sequence[str], together: Sequence[int]
    ) -> ErrorSize:
        """Of squared errors (n, m) in ``unit``, NaN where nothing was read, of readings ``names``; those ``together``
        make the distance. Rows that hold all of these count, else any with one."""
        own = squares[:, list(together)]
        whole = np.isfinite(own).all(axis=1)
        own = own[whole] if whole.any() else np.nan_to_num(own[np.isfinite(own).any(axis=1)])
        distance = np.sqrt(own.sum(axis=1))
        read = np.isfinite(squares)
        by_reading = {
            name: float(np.sqrt(np.mean(squares[read[:, k], k]))) for k, name in enumerate(names) if read[:, k].any()
        }
        if not len(distance):
            nan = float("nan")
            return cls(nan, nan, nan, nan, unit, held_out, len(together), 0, by_reading)
        return cls(
            float(distance.mean()), float(np.sqrt(np.mean(distance**2))), float(np.quantile(distance, 0.95)),
            float(distance.max()), unit, held_out, len(together), len(distance), by_reading,
        )  # fmt: skip

    @property
    def in_words(self) -> str:
        """What it is of."""
        if self.axes == 3:
            return "in 3-D"
        return f"of {self.axes} readings together" if self.axes > 1 else "of single readings"

    def __str__(self) -> str:
        how = ", held out" if self.held_out else ""
        return f"{number(self.rms)} {self.unit} RMS {self.in_words}, 95 % within {number(self.p95)}{how}"

    def to_json(self) -> dict[str, Any]:
        """For programs."""
        return {
            "rms": finite(self.rms), "p95": finite(self.p95), "max": finite(self.max), "mean": finite(self.mean),
            "unit": self.unit, "held_out": self.held_out, "rows": self.rows,
            "by_reading": {name: finite(value) for name, value in self.by_reading.items()},
        }  # fmt: skip


class FitLike(Protocol):
    """What is asked of a fit."""

    @property
    def model(self) -> Any:
        """The model."""

    @property
    def data(self) -> Measurements:
        """Its rows."""

    @property
    def values(self) -> Floats:
        """Its parameters (p,)."""

    @property
    def noise(self) -> ReadingNoise:
        """The noise of each reading."""

    @property
    def priors(self) -> float:
        """The part of the plausible sizes within which the drawing counts as known; 0 where it does not."""

    @property
    def sizes(self) -> Floats:
        """Plausible sizes (p,), of the drawing that part of them."""

    @property
    def predicted(self) -> Floats:
        """What it says (n, m)."""

    @property
    def residuals(self) -> Floats:
        """Measured minus that (n, m)."""


def axes_of(data: Measurements) -> tuple[int, ...]:
    """Columns of readings that make the error: coordinates that were taken; where none was, the distance."""
    return tuple(k for k in range(data.coordinates) if data.taken[:, k].any()) or (data.coordinates,)


def of_residuals(data: Measurements, residuals: Floats, *, held_out: bool) -> ErrorSize:
    """The error that residuals (n, m) are, of rows that are not marked as outliers."""
    squares = np.where(data.used, (data.layout.per_unit * residuals) ** 2, np.nan)
    return ErrorSize.of(
        squares, data.layout.unit, held_out=held_out, names=data.layout.readings, together=axes_of(data)
    )


def repeated_folds_of(fit: FitLike, seed: int) -> list[Ints]:
    """Folds (n,) of all rows of a fit, of each repetition."""
    data, place = fit.data, fit.model.place(fit.data, fit.predicted, fit.values)
    return [blocks_of(data, place, _FOLDS, _REPETITIONS * seed + k) for k in range(_REPETITIONS)]


@linalg.one_thread()
def held_out_error(
    fit: FitLike,
    seed: int = 0,
    *,
    refit: Callable[[Measurements], Floats] | None = None,
    sigma: Floats | None = None,
    repeated_folds: Sequence[Ints] | None = None,
    derivatives: Callable[[Ints], Callable[[slice], Any]] | None = None,
) -> ErrorSize:
    """The error of a fit on rows held out; of one pose alone, which cannot be, what the fit leaves.

    ``refit`` gives the parameters (p,) of some rows alone: very few rows are held out by it, and a ball in its sockets,
    of which lengths tell no step. ``sigma`` (columns,)
    weighs the readings, the noise of each where it is left out; ``repeated_folds`` are those of
    :func:`repeated_folds_of`; ``derivatives`` gives those of some rows, stretch by stretch, where they are known.
    """
    data = fit.data
    used = data.used & np.isfinite(fit.residuals)
    rows = np.flatnonzero(used.any(axis=1))
    if sigma is None:
        sigma = sigma_of(fit, used)
    if repeated_folds is None:
        repeated_folds = repeated_folds_of(fit, seed)
    fold = np.stack([np.unique(one[rows], return_inverse=True)[1].ravel() for one in repeated_folds])
    if not len(rows) or fold.max(axis=1).min() < 1:
        return of_residuals(data, fit.residuals, held_out=False)
    if refit is not None and (len(rows) < _FEWEST or fit.model.in_sockets(data)):
        return _refitted(fit, refit, rows, fold[0])
    there = used[rows]
    by_model = derivatives(rows) if derivatives else fit.model.linearised_by_blocks(data.select(rows), fit.values)
    # axes that nothing was read on count for nothing
    weight = np.where(there, 1.0 / sigma, 0.0)
    residual = np.where(there, fit.residuals[rows], 0.0) * weight

    # of a short run the stretch that is asked for twice is all of it
    last: list[tuple[slice, Floats]] = []

    def columns(some: slice) -> Floats:
        if not last or last[0][0] != some:
            last[:] = [(some, by_model(some).parameters * weight[some, :, None])]
        return last[0][1]

    folds = Folds.of(columns, residual, fold, known_deviations(fit))
    errors = [(folds.errors(columns(some), residual[some], some) ** 2).mean(axis=0) for some in blocks(len(rows))]
    squares = np.where(there, np.concatenate(errors) * (data.layout.per_unit * sigma) ** 2, np.nan)
    return ErrorSize.of(squares, data.layout.unit, held_out=True, names=data.layout.readings, together=axes_of(data))


def known_deviations(fit: FitLike) -> Floats | None:
    """What is known of how far the parameters are off their fitted values, as :class:`~.folds.Folds` has it; None where
    nothing is."""
    known = np.array(fit.model.known(drawn=fit.priors > 0.0))
    if not known.any():
        return None
    precision = np.where(known > 0, 1.0 / np.square(np.where(known > 0, known, 1.0) * fit.sizes), 0.0)
    return np.stack([precision, -precision * fit.values])


def _refitted(fit: FitLike, refit: Callable[[Measurements], Floats], rows: Ints, fold: Ints) -> ErrorSize:
    """By fits of their own without each block of these rows."""
    left = np.full(fit.residuals.shape, np.nan)
    for one in np.unique(fold):
        inside = rows[fold == one]
        try:
            values = refit(fit.data.select(rows[fold != one]))
            part = fit.data.select(inside)
            left[inside] = part.readings - fit.model.predict(part, values)
        except FitError:
            # what is left without the block fits nothing
            return of_residuals(fit.data, fit.residuals, held_out=False)
    return of_residuals(fit.data, left, held_out=True)


def sigma_of(fit: FitLike, used: Bools) -> Floats:
    """The noise (columns,) that weighs readings; where it is not known, what the fit leaves."""
    known = fit.noise.origin != "unknown"
    each = np.where(used, fit.noise.sigma if known else fit.residuals, np.nan)
    out = np.ones(each.shape[1])
    for k in np.flatnonzero(used.any(axis=0)):
        column = each[used[:, k], k]
        out[k] = max(float(np.sqrt(np.mean(column**2)) if known else np.std(column)), 1e-12)
    return out


# -- How far off something is in 95 of 100 cases, from a covariance ------------------------------------------------


def radius_95(covariances: Floats) -> Floats:
    """Radius (n,) that holds 95 of 100 draws of Gaussians with covariances (n, k, k), in their unit.

    By matching two moments of the squared length (Satterthwaite).
    """
    scale, freedom = _as_chi2(covariances)
    return np.asarray(np.sqrt(scale * scipy.special.chdtri(freedom, 0.05)))


def share_within(covariance: Floats, radius: float) -> float:
    """Part of the draws of a Gaussian with a covariance (k, k) within a ``radius``, by the same matching."""
    scale, freedom = _as_chi2(covariance[None])
    return float(1.0 - scipy.special.chdtrc(freedom, radius**2 / scale)[0]) if scale[0] > 0 else 1.0


def _as_chi2(covariances: Floats) -> tuple[Floats, Floats]:
    """Scale and freedom (n,) of the χ² that squared lengths nearly have."""
    axes = linalg.eigvalsh(covariances).clip(0.0)
    total, squares = axes.sum(axis=1), (axes**2).sum(axis=1)
    freedom = np.where(squares > 0, total**2 / np.where(squares > 0, squares, 1.0), 1.0)
    return total / freedom, freedom


# -- Noise by repeats --------------------------------------------------------------------------------------------------
# The noise as repeats of a pose show it beside a model: what an effect in the model moves between them is no noise.

#: A noise that differs by less than this part is the same.
_SAME = 0.02


def repeatability_of(fit: Any) -> Repeatability | None:
    """By how much repeats differ in what a :class:`~sherkit.fit.identify.Fit` leaves, pooled over poses; None where no
    pose was read twice. Source: Draper and Smith, *Applied Regression Analysis*, 1.5, of residuals."""
    data = fit.data
    return pure_error(data.layout.readings, fit.residuals, data.used, data.groups)


def noise_beside(fit: Any) -> ReadingNoise | None:
    """The noise of each reading where repeats tell it, with what the model explains of them taken off; None where that
    is the noise that the fit was weighed with."""
    found = repeatability_of(fit) if fit.noise.origin == "repeats" else None
    if found is None:
        return None
    before, now = fit.data.repeatability, np.ones(len(fit.data.layout.readings))
    for k, name in enumerate(fit.data.layout.readings):
        if before.degrees_of_freedom.get(name, 0) >= MIN_FREEDOM and before.sigma[name] > 0 and found.sigma[name] > 0:
            now[k] = found.sigma[name] / before.sigma[name]
    if np.abs(now - 1.0).max() < _SAME:
        return None
    declared = np.isfinite(fit.data.sigma)
    return ReadingNoise(np.where(declared, fit.noise.sigma, fit.noise.sigma * now), "repeats")
