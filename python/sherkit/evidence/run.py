"""A fitted run as rows over their noise, in the order of time, with what carries over from row to row taken out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np

from ..base import linalg
from ..base.figures import listed
from ..base.types import Floats, Ints
from ..errors import FitError
from ..model.effect import Effect
from .fitted_run import FittedRun
from .linearised import Linearised
from .thresholds import PLAUSIBLE, UNEVEN
from .whitening import MOST_IN_COMMON, InCommon, Whitening, independent

#: Fewest rows of which anything can be said.
_FEWEST = 10


@dataclass(frozen=True, eq=False)
class Run:
    """Rows of a fit over noise, whitened.

    ``rows`` (n,) are those of the run that are looked at, in the order of time; ``sigma`` (columns,) is the noise of
    each reading in its unit; ``view`` has all to first order over that noise; ``white`` is the filter from row to row;
    what targets of one visit share makes noise in some direction ``shared`` times as large as in the mean of all.
    Vectors (N,) and columns (N, k) of rows are n·m long, the m axes of a row one after another.
    """

    #: A fitted run, or changes in the model of joined ones.
    of: Any
    rows: Ints
    sigma: Floats
    view: Linearised
    white: Whitening
    shared: float = 1.0
    #: What was made of these rows for any fit of them, by what it is for.
    kept: dict[object, Any] = field(default_factory=dict)

    @classmethod
    def plain(cls, fit: FittedRun, rows: Ints, effects: Sequence[Effect], sigma: Floats) -> Run:
        """The ``rows`` of a fit over the noise ``sigma`` (columns,), each by itself. Raises
        :class:`~sherkit.errors.FitError` for too few rows."""
        rows = in_time(fit, rows)
        view = fit.linearised(rows, effects, sigma[list(fit.axes)])
        return cls(fit, rows, sigma, view, Whitening.none(len(rows)))

    def __len__(self) -> int:
        return len(self.rows)

    @property
    def axes(self) -> int:
        """Readings a row, m."""
        return self.view.axes

    @cached_property
    def residual(self) -> Floats:
        """Measured minus predicted (N,), in noises."""
        return self.flat(self.view.residual)

    @cached_property
    def basis(self) -> Floats:
        """Orthonormal columns (N, rank) of all that is fitted, where the sensor stands among it.

        Where the drawing counts, what no plausible parameters move by a noise of all rows together is none of it: a
        squareness about an axis that nobody reads would take, at a thousand radians, what a screw does.
        """
        columns = self.flat(self.view.fitted(self.view.whole))
        if self._begins_anywhere:
            # from which side the machine came to its first row nobody knows
            first = np.zeros((len(self), self.axes, self.axes))
            first[0] = np.eye(self.axes)
            columns = np.concatenate([columns, self.flat(first)], axis=1)
        q = independent(columns)
        if not isinstance(self.of, FittedRun) or not self.of.fit.priors:
            return q
        sizes = [p.size for p in self.of.fit.parameters]
        by_size = (q.T @ columns) * np.array([*sizes, *[1e12] * (columns.shape[1] - len(sizes))])
        turn, moved, _ = linalg.svd(by_size, full_matrices=False)
        return q @ turn[:, moved * PLAUSIBLE > 1.0]

    @property
    def _begins_anywhere(self) -> bool:
        """Whether an effect of the model goes by the side from which joints came, which the order of the rows tells of
        all but the first."""
        if not isinstance(self.of, FittedRun) or self.of.data.tells_sides:
            return False
        return any("direction" in effect.needs for effect in self.of.model.effects)

    @cached_property
    def poses(self) -> Ints:
        """The pose (n,) at which each row was read."""
        return self.view.group

    @property
    def rounding(self) -> float:
        """Sum of squares that is no more than the digits of the readings."""
        axes = list(self.of.axes)
        return len(self) * float(np.square(self.of.digits[axes] / self.sigma[axes]).sum())

    def flat(self, columns: Floats) -> Floats:
        """Values (n, m) or columns (n, m, k) under the filter, as (N,) or (N, k)."""
        n, m = columns.shape[:2]
        return self.white(columns).reshape(n * m, *columns.shape[2:])

    def weighed(self, loud: Floats, effects: Sequence[Effect]) -> Run:
        """The same rows with axes that are louder (m,) than the others by much weighing less, fitted anew."""
        loud = np.clip(loud, 1e-6, 1e6)
        if (np.abs(np.log(loud / loud.mean())) < UNEVEN).all():
            return self
        sigma = self.sigma.copy()
        sigma[list(self.of.axes)] *= loud
        fit = self.of.on(np.arange(len(self.of.data)), sigma)
        view = fit.linearised(self.rows, effects, sigma[list(fit.axes)])
        return replace(self, of=fit, sigma=sigma, view=view, kept={})

    def seen_by(self, fit: FittedRun) -> Run:
        """The same rows with the same noise as another fit of them sees them."""
        view = fit.linearised(self.rows, (), self.sigma[list(fit.axes)])
        return Run(fit, self.rows, self.sigma, view, self.white, self.shared, self.kept)


def weighed_run(fit: FittedRun, rows: Ints, effects: Sequence[Effect], sigma: Floats) -> Run:
    """The ``rows`` of a fit over the noise ``sigma`` (columns,), with what gives columns of the ``effects``.

    Raises :class:`~sherkit.errors.FitError` for too few rows.
    """
    rows = in_time(fit, rows)
    view = fit.linearised(rows, effects, sigma[list(fit.axes)])
    lag, back = one_after_another(fit.data.order, fit.data.series, rows)
    axes = list(fit.axes)
    part = float(np.mean(np.square(fit.data.pose_sigma[rows][:, axes] / sigma[axes])))
    # where it is all the noise that is known, nothing is known of what repeats differ by
    in_common = InCommon.part(view.repeated, part) if 0.0 < part < MOST_IN_COMMON else None
    return Run(fit, rows, sigma, view, Whitening(0.0, lag, back, in_common))


def shared_by_targets(left: Floats, series: Ints) -> float:
    """How many times as much noise (n, m) there is in the direction in which targets of one visit err together, as in
    the mean of all: three witnesses may be one. ``series`` (n,) are their numbers, rows in the order of time."""
    numbers = np.unique(series)
    if len(numbers) == 1:
        return 1.0
    # a visit ends where a target comes again
    first = np.flatnonzero(series == series[0])
    visits = [np.arange(a, b) for a, b in pairwise([*first.tolist(), len(series)])]
    whole = [rows[np.argsort(series[rows])] for rows in visits if len(rows) == len(numbers)]
    whole = [rows for rows in whole if np.array_equal(series[rows], numbers)]
    if len(whole) < len(numbers) * left.shape[1]:
        return float(len(numbers))
    each = np.stack([left[rows].ravel() for rows in whole])
    return float(np.linalg.norm(each / np.sqrt(np.square(each).mean(axis=0)).clip(1e-300), 2) ** 2 / len(each))


def in_time(fit: FittedRun, rows: Ints) -> Ints:
    """Those of these rows that have all readings, in the order of time. Raises :class:`~sherkit.errors.FitError`."""
    rows = rows[fit.whole[rows]]
    if fit.data.time_s is not None:
        rows = rows[np.argsort(fit.data.time_s[rows], kind="stable")]
    if len(rows) < _FEWEST:
        names = [fit.names[a] for a in fit.axes]
        apart = fit.used[:, fit.axes].any(axis=1).sum() >= _FEWEST > len(rows) and len(names) > 1
        hint = (
            f": a diagnosis looks at rows that hold all of {listed(names)}. Where they were read one at a time at the "
            "same joints, put them into one row; else diagnose the rows of each axis by themselves"
        )
        raise FitError(
            f"{fit.data.source}: {len(rows)} rows with all readings are too few to diagnose; expected {_FEWEST} or "
            f"more{hint if apart else ''}"
        )
    return rows


def one_after_another(order: Ints, series: Ints, rows: Ints) -> tuple[Ints, Ints | None]:
    """Of rows in the order of time, how many rows of the run it is from the one before, and how far up that one stands
    here, 0 where there is none; None where it is always the next.

    ``order`` and ``series`` are those of all rows of the run: rows of one series follow one another.
    """
    if not series.any():
        return np.concatenate([[1], np.maximum(np.diff(order[rows]), 1)]), None
    lag, back = np.ones(len(rows), dtype=np.int64), np.zeros(len(rows), dtype=np.int64)
    for one in np.unique(series):
        place = np.zeros(len(series), dtype=np.int64)
        every = np.flatnonzero(series == one)
        place[every] = np.argsort(np.argsort(order[every]))
        here = np.flatnonzero(series[rows] == one)
        back[here[1:]] = np.diff(here)
        lag[here[1:]] = np.maximum(np.diff(place[rows[here]]), 1)
    return lag, back


def unit(values: Floats) -> Floats:
    """Values (n,) brought to -1 … 1."""
    return np.asarray(2.0 * (values - values.min()) / max(float(np.ptp(values)), 1e-300) - 1.0)
