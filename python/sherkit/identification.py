"""Identification: the parameters that fit the readings, and how well each is known.

Source: Eqs. 9 to 11 of Xiao et al., ISMR 2022, solved column-scaled and rank-revealing and iterated to the
nonlinear minimum. The covariance is the usual ``s² (JᵀJ)⁻¹`` (Seber and Wild, *Nonlinear Regression*, 2.1); with a
robust loss, Huber's correction (Huber and Ronchetti, *Robust Statistics*, Eq. 7.81).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from . import _core
from .chain import ChainModel
from .directions import Direction, badly_observed, unobserved
from .errors import FitError
from .iteration import iterate
from .measurements import Measurements, MeasurementStream
from .models import model_of
from .noise import MAD, Noise, noise_of
from .notebook import Shown
from .parameters import Parameter
from .robots.file import Robot

Floats = NDArray[np.float64]

LOSSES = ("linear", "huber", "cauchy", "tukey")
_ROBUST_ROUNDS = 10
_MAD_EFFICIENCY = 0.37
#: Chance that a run without outliers has any row listed as one.
_OUTLIER_LEVEL = 0.01


@dataclass(frozen=True, eq=False)
class Fit(Shown):
    """An identified model.

    ``values`` (p,) are errors in the units of ``parameters``. ``covariance`` (p, p) is what the readings leave,
    ``unobserved_covariance`` what they do not tell at all, from the plausible sizes. ``residuals_mm`` (n, 4) is
    measured minus predicted, NaN where nothing was taken. ``scale`` is the ratio of the residuals to the
    assumed noise (to 1 mm where the noise is unknown).
    """

    model: ChainModel
    data: Measurements
    values: Floats
    covariance: Floats
    unobserved_covariance: Floats
    rank: int
    singular_values: Floats
    unobserved_basis: Floats
    scale: float
    noise: Noise
    loss: str
    priors: bool
    converged: bool
    evaluations: int

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The identified parameters."""
        return self.model.parameters

    @cached_property
    def std(self) -> Floats:
        """Standard deviation of each value: readings and plausible sizes together."""
        return np.sqrt(np.diag(self.covariance + self.unobserved_covariance).clip(0.0))

    @cached_property
    def std_from_readings(self) -> Floats:
        """Standard deviation of each value from the readings alone, unobserved directions held."""
        return np.sqrt(np.diag(self.covariance).clip(0.0))

    @cached_property
    def by_name(self) -> dict[str, float]:
        """Values by parameter name."""
        return dict(zip((p.name for p in self.parameters), self.values.tolist(), strict=True))

    @property
    def condition_number(self) -> float:
        """Largest over smallest observed singular value of the column-scaled system."""
        s = self.singular_values
        return float(s[0] / s[self.rank - 1]) if self.rank else float("inf")

    @cached_property
    def unobserved(self) -> tuple[Direction, ...]:
        """Combinations of parameters that change no reading here."""
        return unobserved(self.parameters, self.unobserved_basis)

    @cached_property
    def badly_observed(self) -> tuple[Direction, ...]:
        """Combinations of parameters that the readings fix worst."""
        return badly_observed(self.parameters, self.covariance)

    @cached_property
    def predicted(self) -> Floats:
        """Predicted readings (n, m)."""
        return self.model.predict(self.data, self.values)

    @cached_property
    def residuals(self) -> Floats:
        """Measured minus predicted (n, m); NaN where nothing was taken."""
        return residuals(self.model, self.data, self.values)

    @cached_property
    def nominal_residuals(self) -> Floats:
        """Measured minus the nominal robot's prediction (n, m) (delta: Eq. 14)."""
        return residuals(self.model, self.data, np.zeros(len(self.values)))

    @property
    def predicted_mm(self) -> Floats:
        """Predicted readings (n, 4) of a delta, mm."""
        return self.predicted

    @property
    def residuals_mm(self) -> Floats:
        """Measured minus predicted (n, 4) of a delta, mm; NaN where nothing was taken."""
        return self.residuals

    @property
    def nominal_residuals_mm(self) -> Floats:
        """Measured minus the nominal prediction (n, 4) of a delta, mm."""
        return self.nominal_residuals

    @cached_property
    def outliers(self) -> NDArray[np.int64]:
        """Rows with a residual that noise does not explain: suspected, listed, never dropped.

        The spread is taken robustly from the residuals themselves; the threshold is such that a run of pure
        noise has no suspect in 99 of 100 cases.
        """
        suspect = np.zeros(len(self.data), dtype=bool)
        count = int(self.data.taken.sum())
        for k in range(self.data.readings.shape[1]):
            rows = self.data.taken[:, k] & ~self.data.outlier
            if rows.sum() < 5:
                continue
            u = self.residuals[rows, k] / self.noise.sigma[rows, k]
            spread = MAD * float(np.median(np.abs(u - np.median(u))))
            # a median deviation of few residuals is itself uncertain, with about 0.37 of their number as freedom
            threshold = float(stats.t.isf(0.5 * _OUTLIER_LEVEL / count, max(_MAD_EFFICIENCY * len(u), 1.0)))
            if spread > 0:
                suspect[np.flatnonzero(rows)[np.abs(u - np.median(u)) > threshold * spread]] = True
        return np.flatnonzero(suspect)

    def rms(self, which: Floats | None = None) -> dict[str, float]:
        """RMS of residuals per reading, in the unit that people read; of :attr:`residuals` unless others are given."""
        return rms(self.data, self.residuals if which is None else which)

    def rms_um(self, which: Floats | None = None) -> dict[str, float]:
        """The same for a delta, µm."""
        return self.rms(which)

    def __repr__(self) -> str:
        each = ", ".join(f"{k.rsplit('_', 1)[0]} {v:.1f}" for k, v in self.rms().items())
        unit = self.data.layout.unit
        return f"Fit({len(self.values)} parameters, rank {self.rank}, RMS {each} {unit})"


@dataclass(frozen=True, eq=False)
class StreamFit:
    """An identified model from a stream: what :class:`Fit` says without anything that needs every row."""

    model: ChainModel
    values: Floats
    covariance: Floats
    unobserved_covariance: Floats
    rank: int
    singular_values: Floats
    scale: float
    rows: int
    converged: bool


def rms(data: Measurements, values: Floats) -> dict[str, float]:
    """RMS per reading, in the unit that people read, over rows that were taken and are not marked as outliers."""
    out = {}
    for k, name in enumerate(data.layout.readings):
        rows = data.taken[:, k] & ~data.outlier
        if rows.any():
            out[name] = float(data.layout.per_unit * np.sqrt(np.mean(values[rows, k] ** 2)))
    return out


def residuals(model: ChainModel, data: Measurements, values: Floats) -> Floats:
    """Measured minus predicted (n, m); NaN where nothing was taken."""
    return np.where(data.taken, data.readings - model.predict(data, values), np.nan)


def identify(
    robot: Robot | ChainModel,
    data: Measurements,
    *,
    free: Sequence[str] = (),
    loss: str = "linear",
    priors: bool = False,
    linear: bool = False,
    start: Sequence[float] | Floats | None = None,
    noise: Noise | None = None,
) -> Fit:
    """Fits the free parameters to the readings.

    ``free`` names them (default: twelve and the datum). ``loss`` is ``linear``, ``huber``, ``cauchy`` or ``tukey``.
    ``priors`` treats the plausible sizes as Gaussian knowledge. ``linear`` takes the paper's single step of
    Eq. 11. ``noise`` overrides what :func:`~sherkit.noise.noise_of` finds.

    Raises :class:`~sherkit.errors.FitError` for rows out of reach, an unknown loss, or too few readings.
    """
    model = model_of(robot, free)
    if loss not in LOSSES:
        raise FitError(f"loss: '{loss}' is not known; choose {', '.join(LOSSES)}")
    noise = noise or noise_of(data)
    used = data.taken & ~data.outlier[:, None]
    if not used.any():
        raise FitError(f"{data.source}: every row is marked as an outlier; nothing is left to fit")
    weights = np.where(used, 1.0 / noise.sigma, 0.0)
    values = model.starting_at(start)

    if priors and noise.origin == "unknown":
        # a prior is weighed against the noise, which only the residuals tell
        loose, _ = _solve(model, data, weights, values, priors=False, linear=linear)
        weights = weights / max(_scale(model, data, loose.trial, weights, loose.result()["rank"], loss), 1e-12)
    solver, ended = _solve(model, data, weights, values, priors=priors, linear=linear)
    values = solver.trial
    if loss != "linear":
        # residuals are judged by their own spread, taken anew until it settles
        for _ in range(_ROBUST_ROUNDS):
            robust = weights / _spread(model, data, values, weights)
            solver, ended = _solve(model, data, robust, values, priors=priors, linear=linear, loss=loss)
            moved = np.abs(solver.trial - values)
            values = solver.trial
            if (moved <= 1e-7 * np.array([p.size for p in model.parameters])).all():
                break
    result = solver.result()
    evaluations = result["evaluations"]
    if loss != "linear" or priors:
        result = _information(model, data, weights, values)
    scale = _scale(model, data, values, weights, result["rank"], loss)
    covariance = result["covariance"] * scale**2
    beyond = result["unobserved_covariance"]
    if priors:
        known = _information(model, data, weights / scale, values, priors=True)
        covariance, beyond = known["covariance"], known["unobserved_covariance"]
    return Fit(
        model=model,
        data=data,
        values=values,
        covariance=covariance,
        unobserved_covariance=beyond,
        rank=result["rank"],
        singular_values=result["singular_values"],
        unobserved_basis=result["unobserved"],
        scale=scale,
        noise=noise,
        loss=loss,
        priors=priors,
        converged=ended == "converged",
        evaluations=evaluations,
    )


def identify_stream(robot: Robot | ChainModel, stream: MeasurementStream, *, free: Sequence[str] = ()) -> StreamFit:
    """Fits a run of any length in constant memory, passing over it once per iteration.

    Readings weigh by their declared sigma, or all the same. Raises as :func:`identify`.
    """
    model = model_of(robot, free)
    solver = _new_solver(model, np.zeros(len(model.parameters)))
    rows = 0
    first = True
    while True:
        solver.clear()
        rows = 0
        for block in stream.blocks():
            noise = np.where(np.isfinite(block.sigma), block.sigma, 1.0)
            weights = np.where(block.taken & ~block.outlier[:, None], 1.0 / noise, 0.0)
            missing = model.core.accumulate(
                solver, np.zeros(len(model.core_parameters)), model.indices,
                model.block(block), block.readings, weights,
            )  # fmt: skip
            rows += len(block)
            if missing:
                if first:
                    model.require(block, np.array(missing, dtype=np.int64), solver.trial)
                solver.fail()
                break
        first = False
        if rows == 0:
            raise FitError(f"{stream.source}: the stream holds no row")
        ended = solver.advance()
        if ended != "evaluate":
            break
    result = solver.result()
    scale = float(np.sqrt(result["cost"] / max(result["rows"] - result["rank"], 1)))
    return StreamFit(
        model=model,
        values=result["values"],
        covariance=result["covariance"] * scale**2,
        unobserved_covariance=result["unobserved_covariance"],
        rank=result["rank"],
        singular_values=result["singular_values"],
        scale=scale,
        rows=rows,
        converged=ended == "converged",
    )


def _new_solver(model: ChainModel, start: Floats, **settings: Any) -> _core.Solver:
    sizes = np.array([p.size for p in model.parameters])
    return _core.Solver(start, sizes, **settings)


def _solve(
    model: ChainModel,
    data: Measurements,
    weights: Floats,
    start: Floats,
    *,
    priors: bool,
    linear: bool,
    loss: str = "linear",
) -> tuple[_core.Solver, str]:
    solver = _new_solver(model, start, loss=loss, single_step=linear)
    if model.own:
        return solver, _iterate(model, data, weights, solver, priors=priors)
    ended, missing = model.core.solve(
        solver, np.zeros(len(model.core_parameters)), model.indices,
        model.block(data), data.readings, weights, priors,
    )  # fmt: skip
    model.require(data, np.array(missing, dtype=np.int64), start)
    return solver, ended


def _iterate(model: ChainModel, data: Measurements, weights: Floats, solver: _core.Solver, *, priors: bool) -> str:
    """The same iteration for models with effects given in NumPy."""
    return iterate(
        solver,
        weights,
        lambda values: data.readings - model.predict(data, values),
        lambda values: model.derivatives(data, values),
        priors=priors,
    )


def _information(
    model: ChainModel, data: Measurements, weights: Floats, values: Floats, *, priors: bool = False
) -> dict[str, Any]:
    """What the readings say at ``values``, all with their full weight; with ``priors`` the plausible sizes too."""
    solver = _new_solver(model, values, max_evaluations=1)
    if model.own:
        _iterate(model, data, weights, solver, priors=priors)
    else:
        model.core.solve(
            solver, np.zeros(len(model.core_parameters)), model.indices,
            model.block(data), data.readings, weights, priors,
        )  # fmt: skip
    return solver.result()


def _spread(model: ChainModel, data: Measurements, values: Floats, weights: Floats) -> Floats:
    """Robust spread of the weighted residuals, one per reading column, (m,)."""
    u = (data.readings - model.predict(data, values)) * weights
    spread = np.ones(weights.shape[1])
    for k in range(weights.shape[1]):
        used = weights[:, k] > 0
        if used.any():
            mad = MAD * float(np.median(np.abs(u[used, k])))
            spread[k] = mad if mad > 0 else 1.0
    return spread


def _scale(model: ChainModel, data: Measurements, values: Floats, weights: Floats, rank: int, loss: str) -> float:
    """Ratio of the residuals to the assumed noise, by which the covariance grows."""
    u = ((data.readings - model.predict(data, values)) * weights)[weights > 0]
    free = len(u) - rank
    if free <= 0:
        return 1.0
    if loss == "linear":
        return float(np.sqrt((u**2).sum() / free))
    spread = np.broadcast_to(_spread(model, data, values, weights), weights.shape)[weights > 0]
    psi, slope = _influence(u / spread, loss)
    mean_slope = float(slope.mean())
    if mean_slope <= 0:
        return float(np.sqrt((u**2).sum() / free))
    correction = 1 + rank / len(u) * float(slope.var()) / mean_slope**2
    return float(correction * np.sqrt(((psi * spread) ** 2).sum() / free) / mean_slope)


def _influence(u: Floats, loss: str) -> tuple[Floats, Floats]:
    """ψ and ψ' of the losses, with the constants of the core."""
    if loss == "huber":
        inside = np.abs(u) <= 1.345
        return np.clip(u, -1.345, 1.345), inside.astype(float)
    if loss == "cauchy":
        t = (u / 2.385) ** 2
        return u / (1 + t), (1 - t) / (1 + t) ** 2
    t = np.minimum((u / 4.685) ** 2, 1.0)
    return u * (1 - t) ** 2, np.where(t < 1, (1 - t) * (1 - 5 * t), 0.0)
