"""A run taken through identification, holding out and correction: what a calibration is made from."""

from __future__ import annotations

import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from ..base import linalg
from ..base.figures import CALIBRATED, NOMINAL, listed
from ..base.types import Bools, Floats, Ints
from ..errors import SherkitWarning
from ..fit.error import ErrorSize, of_residuals, radius_95, share_within
from ..fit.folds import Folds, roots_of
from ..fit.identify import Fit
from ..model.effect import Effect

#: Lines below those of a model on rows held out.
_REGIONS = "  regions left out whole"
#: The part of all cases that a promise holds in (ISO 9283), and how often an interval is halved.
_CASES, _HALVINGS = 0.95, 60
_ROWS, _CORRECTED = "  the rows it was fitted to", "  with the correction"


@dataclass(frozen=True)
class Cells:
    """A table for people: titles of its columns but the first, and its lines, each with its name first."""

    columns: tuple[str, ...]
    lines: tuple[tuple[str, ...], ...]


class Corrected(ABC):
    """What a smooth correction takes of what a fit leaves; a kind of robot that has one says how."""

    @property
    @abstractmethod
    def rows(self) -> Ints:
        """Rows of the run (k,) that it was chosen on."""

    @property
    @abstractmethod
    def held_out(self) -> Floats:
        """Residuals (k, coordinates) of those rows, each by a correction that did not see its block."""

    @property
    @abstractmethod
    def chosen(self) -> bool:
        """Whether one helps, and is in the calibration."""

    @abstractmethod
    def __str__(self) -> str:
        """What was chosen, in words."""

    @abstractmethod
    def to_json(self) -> dict[str, Any]:
        """The same for programs."""

    def cells(self) -> Cells | None:
        """Its errors as a table; None where there is none to show."""
        return None


@dataclass(frozen=True, eq=False)
class CalibrationRun:
    """One run taken through identification, holding out and correction.

    ``held_out`` (n, m) are residuals of fits that did not see the row's block; blocks are dealt once, since a
    correction is judged on the same (a study and a diagnosis average five). ``correction`` is None where none was
    asked for or the robot has none; ``region`` (n,) are the rows in its region of interest, None where it has none;
    ``outliers`` (k,) are rows that a diagnosis lists as gross errors, left out or used;
    ``block`` (n,) is that of each row, where it is known.
    """

    fit: Fit
    held_out: Floats
    correction: Corrected | None = None
    region: Bools | None = None
    outliers: Ints = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    block: Ints | None = None

    @cached_property
    def corrected(self) -> Floats:
        """Held-out residuals after the correction, chosen and fitted without the row's block, (n, m); those before
        where there is no correction."""
        out = self.held_out.copy()
        if self.correction is not None and self.correction.chosen:
            out[self.correction.rows, : self.fit.data.coordinates] = self.correction.held_out
        return out

    def left(
        self, carry: Callable[[Floats], Floats], held_out: Floats, *, corrected: bool = False
    ) -> tuple[Floats, Floats]:
        """What the model leaves of poses held out beyond what their readings scatter and beyond what noise does to the
        parameters, and that scatter: covariances (d, d) each.

        ``carry`` takes residuals (n, m) as ``held_out`` to coordinates (k, d) of the rows that count, linearly. Of what
        is ``corrected`` what noise does to the correction is part of what it leaves. Where the noise is not known,
        nothing is parted from it: the scatter is zero. Poses that are wrong in all their readings count, as so many
        cases of a hundred (:meth:`_with_wrong_poses`).
        """
        held = _moment(carry(held_out))
        sigma = self.fit.noise.sigma
        if self.fit.noise.origin == "unknown":
            return self._with_wrong_poses(held, held, held_out), np.zeros_like(held)
        axes = np.flatnonzero(self.fit.data.taken.any(axis=0))
        scatter = sum(_moment(carry(np.where(np.arange(sigma.shape[1]) == k, sigma, 0.0))) for k in axes)
        known: Floats = np.asarray(scatter)
        if not corrected:
            moved = self._moved_by_noise()
            known = known + np.asarray(sum(_moment(carry(moved[:, :, k])) for k in range(moved.shape[2])))
        value, vector = linalg.eigh(held - known)
        # by chance some directions leave less than noise: what is left in all is no more for that
        positive = value.clip(0.0)
        positive *= max(float(value.sum()), 0.0) / max(float(positive.sum()), 1e-300)
        return self._with_wrong_poses((vector * positive) @ vector.T, held, held_out), np.asarray(scatter)

    def _with_wrong_poses(self, left: Floats, held: Floats, held_out: Floats) -> Floats:
        """A covariance (d, d) like ``left``, of which 95 of 100 draws are as small as of the cases of this run: poses
        as ``left``, and in their part those that were left out and were wrong in all their readings, as far off as they
        were read. ``held`` (d, d) is the moment of what is ``held_out`` (n, m). Which of them were accidents nobody
        knows: a person who does marks them."""
        missed, part = self._wrong_poses()
        counts = self.fit.data.used & np.isfinite(held_out)
        squares = np.where(counts, held_out, 0.0)[counts.any(axis=1)] ** 2
        if not len(missed) or not held.trace() > 0:
            return left
        missed = missed * np.sqrt(held.trace() / squares.sum(axis=1).mean())

        def held_within(radius: float) -> float:
            return (1.0 - part) * share_within(left, radius) + part * float(np.mean(missed <= radius))

        wanted = _last_below(lambda r: held_within(r) < _CASES, 2.0 * float(missed.max() + radius_95(left[None])[0]))
        more = _last_below(
            lambda s: radius_95((left + s * held)[None])[0] < wanted, 2.0 * wanted**2 / held.trace() + 1e-300
        )
        return np.asarray(left + more * held)

    def _wrong_poses(self) -> tuple[Floats, float]:
        """How far off those poses are (k,) that were left out in all their readings, by all that was read together, and
        which part of the poses they are. One that is off by more than all places that were read are apart is a reading
        that was lost, and none of the robot."""
        data = self.fit.data
        wrong = np.zeros(len(data), dtype=bool)
        wrong[self.outliers] = data.outlier[self.outliers]
        right = data.used.any(axis=1)
        every = np.unique(data.groups[wrong | right])
        poses = np.setdiff1d(data.groups[wrong], data.groups[right])
        residual = np.where(data.taken, self.fit.residuals, np.nan)
        off = [np.sqrt(np.nansum(np.square(residual[wrong & (data.groups == one)].mean(axis=0)))) for one in poses]
        read = np.flatnonzero(data.used.any(axis=0))
        apart = np.sqrt(sum(np.ptp(data.readings[data.used[:, k], k]) ** 2 for k in read))
        missed = np.array([one for one in off if 0.0 < one < apart])
        return missed, len(missed) / max(len(every), 1)

    def left_alike(self, read: Bools, held_out: Floats) -> tuple[Floats, Floats]:
        """:meth:`left` where readings say how far off something is and not where to, as distances and heights do: the
        same along every direction. ``read`` (n, m) are those that count."""
        left, scatter = self.left(lambda missed: missed[read][:, None], held_out)
        return left * np.eye(3), scatter * np.eye(3)

    def _moved_by_noise(self) -> Floats:
        """What noise does to predictions of rows held out (n, m, r), as the columns of a root of their covariance."""
        fit, used = self.fit, self.fit.data.used
        weight = np.where(used, 1.0 / fit.noise.sigma, 0.0)
        columns = fit.model.linearised(fit.data, fit.values).parameters
        block = np.zeros(len(used), dtype=np.int64) if self.block is None else self.block
        folds = Folds.of(lambda some: columns[some] * weight[some, :, None], np.zeros(weight.shape), block[None])
        seen = folds.outside[0] if block.any() else folds.grams
        roots = roots_of(seen) / folds.length[:, None]
        out = np.zeros((*weight.shape, roots.shape[2]))
        for k, root in enumerate(roots):
            out[block == k] = columns[block == k] @ root
        return out

    def rms(self, values: Floats, rows: Bools | None = None) -> dict[str, tuple[float, float]]:
        """RMS and standard deviation per reading, in the unit that people read, over rows not marked as outliers."""
        out = {}
        layout = self.fit.data.layout
        for k, name in enumerate(layout.readings):
            use = self.fit.data.taken[:, k] & ~self.fit.data.outlier & np.isfinite(values[:, k])
            if rows is not None:
                use = use & rows
            if use.any():
                v = values[use, k] * layout.per_unit
                out[name] = (float(np.sqrt(np.mean(v**2))), float(v.std()))
        return out

    def lines(self) -> list[tuple[str, str, ErrorSize, dict[str, tuple[float, float]]]]:
        """Table I: name of a line, that of the paper's ('' where it prints none), the error, and RMS and deviation of
        each reading."""
        region, fitted = self.region, " ".join([CALIBRATED, *(f"+ {e.name}" for e in self.fit.model.effects)])
        wanted: list[tuple[str, str, Floats, Bools | None]] = []
        parts = region is not None and region.any() and not region.all()
        for rows, where in ((None, ""), (region, ", region")) if parts else ((None, ""),):
            wanted += [
                (f"{NOMINAL}{where}", f"before{where}", self.fit.nominal_residuals, rows),
                (f"{fitted}{where}", "", self.held_out, rows),
                (_ROWS, f"after{where}", self.fit.residuals, rows),
            ]
            if self.correction is not None:
                wanted.append((_CORRECTED, "", self.corrected, rows))
        out = []
        for name, key, values, rows in wanted:
            data = self.fit.data if rows is None else self.fit.data.select(np.flatnonzero(rows))
            if values is self.held_out and rows is None:
                # seen in several ways to cut the run, as everywhere
                error = self.fit.error
            else:
                held_out = values is self.held_out or values is self.corrected
                error = of_residuals(data, values if rows is None else values[rows], held_out=held_out)
            out.append((name, key, error, self.rms(values, rows)))
            if values is self.held_out and rows is None and (away := self.fit.elsewhere) is not None:
                out.append((_REGIONS, "", away.error, {}))
        return out

    @property
    def own(self) -> list[Effect]:
        """The user's effects in the model."""
        return [effect for effect in self.fit.model.effects if effect.function is not None]

    def _left_out(self) -> Floats:
        """What the user's effects add to the prediction (n, m)."""
        fit = self.fit
        deployed = fit.model
        for effect in self.own:
            deployed = deployed.without_effect(effect.name)
        core = deployed.predict(fit.data, fit.values[: len(deployed.parameters)])
        return np.where(fit.data.taken, fit.predicted - core, 0.0)

    def deployed(self, residuals: Floats, why: str = "effects given in NumPy do not run in a control loop") -> Floats:
        """Residuals (n, m) as they are where a user's effects do not run: what those explain comes back."""
        own = self.own
        if not own:
            return residuals
        without, layout = self._left_out(), self.fit.data.layout
        worst = layout.per_unit * float(np.sqrt(np.mean(without[:, : self.fit.data.coordinates] ** 2)))
        warnings.warn(
            f"{listed(e.name for e in own)}: {why} and are left out of the calibration; that leaves {worst:.1f} "
            f"{layout.unit} RMS, which the predicted accuracy includes",
            SherkitWarning,
            stacklevel=3,
        )
        return residuals + without


def _last_below(small: Callable[[float], bool], most: float) -> float:
    """Up to where a growing quantity is ``small``, at ``most`` so far; zero where it never is."""
    low, high = 0.0, most
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if small(middle) else (low, middle)
    return low


def _moment(errors: Floats) -> Floats:
    """Second moment (d, d) of errors (k, d)."""
    return np.asarray(errors.T @ errors / max(len(errors), 1))
