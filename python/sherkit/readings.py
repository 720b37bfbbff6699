"""Any other machine: its rows of readings, what its model must offer, and the fit of that model.

A delta has :mod:`~sherkit.measurements`, :mod:`~sherkit.model` and :mod:`~sherkit.identification`, with units and
links of its own. Here a machine is whatever has three methods; its readings may be angles, lengths or both, as long as
all columns of one table share a unit.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from . import _core
from .effects import Effect
from .errors import EffectError, FitError, NotFinite, ShapeError
from .identification import LOSSES
from .iteration import iterate
from .names import listed, nearest
from .noise import MAD
from .notebook import Shown
from .parameters import Parameter

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]

_ROBUST_ROUNDS = 30
#: Fewer degrees of freedom than this from repeats say too little about the noise to weigh by.
_MIN_FREEDOM = 5


@dataclass(frozen=True, eq=False)
class Readings:
    """Rows of readings of a machine. Arrays have one row per reading and are not to be written to.

    ``place`` maps names to values (n,) that say where the machine was: its inputs, or the direction it looked in.
    ``readings`` (n, m) are in ``unit``, NaN where one was not taken; ``names`` names their columns. ``covariates``
    are further columns (n,); ``time_s`` (n,); ``pose`` (n,) is equal for repeats; ``sigma`` (n, m) is the noise, in
    ``unit``, where it is known; ``outlier`` (n,) marks rows that are kept and listed but not fitted; ``line`` (n,)
    is the number of the row in its file. ``block`` (n,) says which rows are held out together in validation; left
    out, neighbours in ``place`` are.

    Raises :class:`~sherkit.errors.ShapeError` or :class:`~sherkit.errors.NotFinite` naming the column.
    """

    place: Mapping[str, Floats]
    readings: Floats
    names: tuple[str, ...]
    unit: str
    covariates: Mapping[str, Floats] = field(default_factory=dict)
    time_s: Floats | None = None
    pose: Ints | None = None
    block: Ints | None = None
    sigma: Floats | None = None
    outlier: Bools = field(default_factory=lambda: np.zeros(0, dtype=bool))
    line: Ints = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    source: str = "readings"

    def __post_init__(self) -> None:
        if self.readings.ndim != 2 or self.readings.shape[1] != len(self.names) or not len(self.readings):
            raise ShapeError(
                f"{self.source}: readings: expected (n, {len(self.names)}) for {listed(self.names)}, "
                f"got {self.readings.shape}"
            )
        for name, column in zip(self.names, self.readings.T, strict=True):
            if not np.isfinite(column).any():
                raise NotFinite(f"{self.source}: readings: no number in '{name}'; leave the column out")
        n = len(self)
        # left out: no outliers, rows counted from 0
        if not self.outlier.size:
            object.__setattr__(self, "outlier", np.zeros(n, dtype=bool))
        if not self.line.size:
            object.__setattr__(self, "line", np.arange(n))
        others: dict[str, NDArray[Any] | None] = {**self.place, **self.covariates}
        others |= {name: getattr(self, name) for name in ("time_s", "pose", "block", "outlier", "line")}
        for name, other in others.items():
            if other is None:
                continue
            if other.shape != (n,):
                raise ShapeError(f"{self.source}: column '{name}': expected {n} rows, got {other.shape}")
            if not np.isfinite(other).all():
                row = int(self.line[np.argmin(np.isfinite(other))])
                raise NotFinite(f"{self.source}: row {row}: column '{name}' is not a finite number")
        if self.sigma is not None and (self.sigma.shape != self.readings.shape or not (self.sigma > 0).all()):
            raise ShapeError(f"{self.source}: sigma: expected positive numbers of shape {self.readings.shape}")

    def __len__(self) -> int:
        return len(self.readings)

    def __getitem__(self, name: str) -> Floats:
        for columns in (self.place, self.covariates):
            if name in columns:
                return columns[name]
        known = [*self.place, *self.covariates]
        raise EffectError(f"these rows have no '{name}'{nearest(name, known)}; they have {listed(known, 20)}")

    @property
    def used(self) -> Bools:
        """Readings (n, m) that were taken, in rows that are not marked as outliers."""
        return np.isfinite(self.readings) & ~self.outlier[:, None]

    @cached_property
    def groups(self) -> Ints:
        """A number per row, equal for repeats of the same pose; every row its own where no pose is given."""
        if self.pose is None:
            return np.arange(len(self), dtype=np.int64)
        return np.unique(self.pose, return_inverse=True)[1].ravel().astype(np.int64)

    def select(self, rows: NDArray[Any]) -> Readings:
        """The rows of a mask or of indices, in that order."""

        def pick(value: NDArray[Any] | None) -> Any:
            return None if value is None else value[rows]

        names = ("readings", "time_s", "pose", "block", "sigma", "outlier", "line")
        return replace(
            self,
            place={k: v[rows] for k, v in self.place.items()},
            covariates={k: v[rows] for k, v in self.covariates.items()},
            **{name: pick(getattr(self, name)) for name in names},
        )

    def mark_outliers(self, rows: NDArray[Any]) -> Readings:
        """The same rows with the given ones marked as outliers, on top of those marked before."""
        outlier = self.outlier.copy()
        outlier[rows] = True
        return replace(self, outlier=outlier)


class Model(Protocol):
    """What a machine's model must offer to be fitted and diagnosed.

    It may also have ``candidates``: :class:`~sherkit.Effect` at the link ``sensor``, NumPy functions of the rows and
    their parameters that add to the readings (n, m). Diagnosis tries each.
    """

    @property
    def parameters(self) -> Sequence[Parameter]:
        """The parameters to fit, with units and plausible sizes; zero is the start."""
        ...

    def predict(self, data: Readings, values: Floats) -> Floats:
        """Predicted readings (n, m), in the unit of the readings."""
        ...

    def derivatives(self, data: Readings, values: Floats) -> Floats:
        """Derivatives (n, m, p) of the readings by the parameters."""
        ...

    def covariates(self, data: Readings) -> dict[str, Floats]:
        """What the residuals may depend on besides the place, (n,) each: time, temperature, side."""
        ...


@dataclass(frozen=True, eq=False)
class Extended:
    """A model and the effects that were added to it; itself a :class:`Model`."""

    plain: Model
    effects: tuple[Effect, ...] = ()

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """Those of the model, then those of the effects."""
        return (*self.plain.parameters, *(p for e in self.effects for p in e.qualified()))

    def owns(self, effect: Effect) -> slice:
        """Where the parameters of an effect stand among all."""
        names = [p.name for p in self.parameters]
        first = names.index(effect.qualified()[0].name)
        return slice(first, first + len(effect.parameters))

    def predict(self, data: Readings, values: Floats) -> Floats:
        """Readings of the model and what the effects add. Raises :class:`ShapeError` for a wrong shape."""
        out = np.asarray(self.plain.predict(data, values[: len(self.plain.parameters)]), dtype=float)
        if out.shape != data.readings.shape:
            raise ShapeError(f"predict: expected an array of shape {data.readings.shape}, got {out.shape}")
        for effect in self.effects:
            out = out + effect.evaluate(data, values[self.owns(effect)], out.shape[1])
        return out

    def derivatives(self, data: Readings, values: Floats) -> Floats:
        """Columns of the model, then of the effects. Raises :class:`ShapeError` for a wrong shape."""
        count = len(self.plain.parameters)
        out = np.asarray(self.plain.derivatives(data, values[:count]), dtype=float)
        axes = data.readings.shape[1]
        if out.shape != (len(data), axes, count):
            raise ShapeError(f"derivatives: expected an array of shape {(len(data), axes, count)}, got {out.shape}")
        return np.concatenate([out, *(e.columns(data, values[self.owns(e)], axes) for e in self.effects)], axis=2)

    def covariates(self, data: Readings) -> dict[str, Floats]:
        """Those of the model."""
        return self.plain.covariates(data)


@dataclass(frozen=True, eq=False)
class ModelFit(Shown):
    """A fitted model of any machine.

    ``values`` (p,) in the units of ``parameters``; ``covariance`` (p, p); ``sigma`` (n, m) is the noise that the
    readings were weighed by, known from ``origin`` (``declared``, ``repeats`` or ``unknown``: one unit each).
    """

    model: Extended
    data: Readings
    values: Floats
    covariance: Floats
    rank: int
    sigma: Floats
    origin: str
    converged: bool

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The fitted parameters."""
        return self.model.parameters

    @cached_property
    def by_name(self) -> dict[str, float]:
        """Values by parameter name."""
        return dict(zip((p.name for p in self.parameters), self.values.tolist(), strict=True))

    @cached_property
    def std_from_readings(self) -> Floats:
        """Standard deviation of each value, unobserved directions held."""
        return np.sqrt(np.diag(self.covariance).clip(0.0))

    @cached_property
    def residuals(self) -> Floats:
        """Measured minus predicted (n, m), in the unit of the readings; NaN where nothing was taken."""
        return self.data.readings - self.model.predict(self.data, self.values)


def noise_of_readings(data: Readings) -> tuple[Floats, str]:
    """Noise (n, m) and its origin: declared, else from repeats of a pose, else unknown (one unit each)."""
    if data.sigma is not None:
        return data.sigma, "declared"
    sigma = np.ones(data.readings.shape)
    for k in range(len(data.names)):
        used = data.used[:, k]
        group = np.unique(data.groups[used], return_inverse=True)[1]
        count = np.bincount(group)
        free = int((count - 1).sum())
        values = data.readings[used, k]
        left = float(((values - (np.bincount(group, values) / count)[group]) ** 2).sum()) if free else 0.0
        if free < _MIN_FREEDOM or left == 0.0:
            return np.ones_like(sigma), "unknown"
        sigma[:, k] = np.sqrt(left / free)
    return sigma, "repeats"


def fit_model(
    model: Model,
    data: Readings,
    *,
    effects: Sequence[Effect] = (),
    loss: str = "linear",
    start: Floats | None = None,
    noise: tuple[Floats, str] | None = None,
) -> ModelFit:
    """Fits the parameters of a model, and of effects added to it, to the readings.

    ``loss`` is ``linear``, ``huber``, ``cauchy`` or ``tukey``. ``noise`` overrides what :func:`noise_of_readings`
    finds. Raises :class:`~sherkit.errors.FitError` where nothing can be fitted.
    """
    if loss not in LOSSES:
        raise FitError(f"loss: '{loss}' is not known; choose {', '.join(LOSSES)}")
    if isinstance(model, Extended):
        extended = Extended(model.plain, (*model.effects, *effects))
    else:
        extended = Extended(model, tuple(effects))
    sigma, origin = noise or noise_of_readings(data)
    if not data.used.any():
        raise FitError(f"{data.source}: every row is marked as an outlier; nothing is left to fit")
    weights = np.where(data.used, 1.0 / sigma, 0.0)
    values = np.zeros(len(extended.parameters)) if start is None else np.asarray(start, dtype=float)
    solver, ended = _solve(extended, data, weights, values)
    values = solver.trial
    if loss != "linear":
        # residuals are judged by their own spread, taken anew until it settles
        for _ in range(_ROBUST_ROUNDS):
            spread = _spread(extended, data, weights, values)
            solver, ended = _solve(extended, data, weights / spread, values, loss)
            moved, values = np.abs(solver.trial - values), solver.trial
            if (moved <= 1e-7 * np.array([p.size for p in extended.parameters])).all():
                break
        weights = weights / _spread(extended, data, weights, values)
    result = solver.result() if loss == "linear" else _solve(extended, data, weights, values, evaluations=1)[0].result()
    left = np.where(weights > 0, data.readings - extended.predict(data, values), 0.0) * weights
    free = max(int((weights > 0).sum()) - result["rank"], 1)
    scale = float((left**2).sum() / free) if loss == "linear" else 1.0
    return ModelFit(
        model=extended,
        data=data,
        values=values,
        covariance=result["covariance"] * scale,
        rank=result["rank"],
        sigma=sigma,
        origin=origin,
        converged=ended == "converged",
    )


def _solve(
    model: Extended, data: Readings, weights: Floats, start: Floats, loss: str = "linear", evaluations: int = 100
) -> tuple[_core.Solver, str]:
    sizes = np.array([p.size for p in model.parameters])
    solver = _core.Solver(start, sizes, loss=loss, max_evaluations=evaluations)
    ended = iterate(
        solver,
        weights,
        lambda values: data.readings - model.predict(data, values),
        lambda values: model.derivatives(data, values),
    )
    return solver, ended


def _spread(model: Extended, data: Readings, weights: Floats, values: Floats) -> Floats:
    """Robust spread of the weighted residuals of each column, (m,)."""
    u = (data.readings - model.predict(data, values)) * weights
    spread = np.ones(u.shape[1])
    for k, (column, weight) in enumerate(zip(u.T, weights.T, strict=True)):
        mad = MAD * float(np.median(np.abs(column[weight > 0]))) if (weight > 0).any() else 0.0
        spread[k] = mad if mad > 0 else 1.0
    return spread
