"""A fitted model to first order: residuals, derivatives, variables. It knows nothing of robots.

Residuals are in units of their noise, one axis per reading. A correlation in time is taken out by the filter
``e_t - ρ e_{t-1}``, which every column passes as well.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from ..model.effect import Effect
from ..types import Floats, Ints


@dataclass(frozen=True, eq=False)
class Linearised:
    """Rows of a fit in the order of time, and all to first order.

    ``residual`` (n, m) measured minus predicted over the noise; ``fitted`` (n, m, p) derivatives by the fitted
    parameters, over the noise; ``variables`` name to values (n,), what a residual may depend on; ``patterns`` name to
    (n, m), how the readings answer to an error at one input (a joint), and ``pattern_of`` names that of a variable
    which is one; ``place`` names the variables that say where the machine is; ``group`` (n,) is equal for repeats of a
    pose. ``effects`` pairs each effect that can be tried with its derivatives (n, m, k) over the noise; ``in_time`` are
    the effects that step at a searched time, each with its derivatives (n, m, k) after the step, or None where these
    are a step of each reading; ``periodic`` those that are a wave of each input at a searched period, each with the
    period that the model has for it, or None; ``untestable`` maps the others to the reason. ``inputs`` name to
    (n,), the readings of the inputs, be they constant or their patterns unknown.
    """

    residual: Floats
    fitted: Floats
    variables: Mapping[str, Floats]
    patterns: Mapping[str, Floats]
    group: Ints
    pattern_of: Mapping[str, str] = field(default_factory=dict)
    place: tuple[str, ...] = ()
    inputs: Mapping[str, Floats] = field(default_factory=dict)
    time: Floats | None = None
    effects: Sequence[tuple[Effect, Floats]] = ()
    in_time: Sequence[tuple[Effect, Floats | None]] = ()
    periodic: Sequence[tuple[Effect, float | None]] = ()
    untestable: Mapping[str, str] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.residual)

    @property
    def axes(self) -> int:
        """Readings per row."""
        return self.residual.shape[1]


class Whitening:
    """The AR(1) filter along the first axis; every row keeps its variance.

    ``lag`` (n,) is how many rows of the run lie between a row and the one before it here (1 where it follows at once):
    across a gap the correlation is ``rho`` to that power. A row of the result is ``here`` times its own value and
    ``before`` times that of the row before it, (n,) each.
    """

    def __init__(self, rho: float, lag: Ints) -> None:
        self.rho, self.lag = rho, lag
        carried = np.sign(rho) ** lag * np.abs(rho) ** lag
        carried[:1] = 0.0
        self.here = 1.0 / np.sqrt(1.0 - carried**2)
        self.before = -carried * self.here

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Whitening) and self.rho == other.rho and np.array_equal(self.lag, other.lag)

    __hash__ = None  # type: ignore[assignment]

    def __call__(self, values: Floats) -> Floats:
        """Values (n, …) filtered."""
        if self.rho == 0.0:
            return values
        shape = (-1,) + (1,) * (values.ndim - 1)
        out = values * self.here.reshape(shape)
        out[1:] += values[:-1] * self.before[1:].reshape(shape)
        return out

    def transposed(self, values: Floats) -> Floats:
        """The filter's transpose of values (n, …)."""
        if self.rho == 0.0:
            return values
        shape = (-1,) + (1,) * (values.ndim - 1)
        out = values * self.here.reshape(shape)
        out[:-1] += values[1:] * self.before[1:].reshape(shape)
        return out

    @property
    def diagonal(self) -> Floats:
        """Diagonal (n,) of the filter's transpose times the filter."""
        out = self.here**2
        out[:-1] += self.before[1:] ** 2
        return out

    @property
    def beside(self) -> Floats:
        """Of the same, what stands in each row's place (n,) of the row before it."""
        return self.here * self.before


def whiten(values: Floats, rho: float, lag: Ints | None = None) -> Floats:
    """Values (n, …) under :class:`Whitening`, each row following at once where no ``lag`` is given."""
    return Whitening(rho, np.ones(len(values), dtype=np.int64) if lag is None else lag)(values)


def orthonormal(columns: Floats, tolerance: float = 1e-9) -> Floats:
    """An orthonormal basis (n·m, rank) of columns (n, m, p) or (N, p), scaled to unit length first."""
    flat = columns.reshape(-1, columns.shape[-1])
    norm = np.linalg.norm(flat, axis=0)
    flat = flat[:, norm > 0] / norm[norm > 0]
    if flat.shape[1] == 0:
        return flat
    # the small Gram matrix decides on rank, a second pass restores orthogonality
    for _ in range(2):
        value, vector = np.linalg.eigh(flat.T @ flat)
        keep = value > max(tolerance**2, 1e-14) * value[-1]
        flat = flat @ (vector[:, keep] / np.sqrt(value[keep]))
    return flat


def correlation_in_time(residual: Floats, basis: Floats) -> float:
    """ρ of AR(1) noise, from residuals (n, m) in the order of time after an orthonormal ``basis`` (n·m, k) was
    projected out.

    The rows must be all of a run. What projection alone does to neighbours is taken out (restricted estimate), and the
    estimate is repeated on filtered rows. Zero where it is within two standard errors of it.
    """
    n, m = residual.shape
    rho = 0.0
    for _ in range(4):
        e = whiten(residual, rho)
        q = basis if rho == 0.0 or not basis.shape[1] else orthonormal(whiten(basis.reshape(n, m, -1), rho))
        flat = e.reshape(-1)
        flat = flat - q @ (q.T @ flat)
        left = flat.reshape(n, m)
        free = n * m - q.shape[1]
        if free <= 10:
            return 0.0
        variance = float((left**2).sum()) / free
        # winsorised, so that single wild rows do not decide
        limit = 4.0 * np.sqrt(variance)
        left = np.clip(left, -limit, limit)
        variance = float((left**2).sum()) / free
        qq = q.reshape(n, m, -1)
        bias = -float((qq[1:] * qq[:-1]).sum())
        lagged = float((left[1:] * left[:-1]).sum()) / variance - bias
        step = lagged / ((n - 1) * m * max(free / (n * m), 0.05))
        # filters in a row: their first-order terms add
        rho = float(np.clip(rho + step * (1 - rho * rho), -0.95, 0.95))
        if abs(step) < 1e-3:
            break
    return rho if abs(rho) > 2.0 / np.sqrt(n * m) else 0.0
