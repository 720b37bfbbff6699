"""A fitted model to first order: residuals, derivatives, variables, steps in time. It knows nothing of robots.

Residuals are in units of their noise, one axis per reading. A correlation in time is taken out by the filter
``e_t - ρ e_{t-1}``, which every column passes as well.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, wraps
from typing import Any, Protocol, TypeVar

import numpy as np

from ..base import linalg
from ..base.types import Floats, Ints
from ..data.columns import unit_in
from ..fit.folds import blocks
from ..model.effect import Effect

T = TypeVar("T")


def last_asked(function: Callable[[Any, slice], T]) -> Callable[[Any, slice], T]:
    """A method of a stretch of rows that remembers the one asked for last: of a short run it is all of them."""
    name = f"_last_{function.__name__}"

    @wraps(function)
    def remembered(self: Any, rows: slice) -> T:
        last: tuple[slice, T] | None = vars(self).get(name)
        if last is None or last[0] != rows:
            last = vars(self)[name] = (rows, function(self, rows))
        return last[1]

    return remembered


class Derivatives(Protocol):
    """Derivatives of any stretch of rows, over the noise; every call computes them anew."""

    def fitted(self, rows: slice) -> tuple[Floats, Floats | None]:
        """By what is fitted (b, m, p) and by the inputs (b, m, k), None where these are not known."""
        ...

    def effects(self, rows: slice) -> Floats:
        """By the parameters of every effect that can be tried (b, m, e)."""
        ...


@dataclass(frozen=True, eq=False)
class Linearised:
    """Rows of a fit in the order of time, and all to first order.

    ``residual`` (n, m) measured minus predicted over the noise; ``variables`` name to values (n,), what a residual
    may depend on; ``derivatives`` gives those of any stretch of rows. ``pattern_of`` names the input of a variable
    which is one whose pattern is known; ``place`` names the variables that say where the machine is; ``group`` (n,)
    is equal where it stood the same, ``repeated`` (n,) where the same was read there again. ``effects`` pairs each
    effect that can be tried with its columns; ``in_time`` are the effects that step at a searched time, each with
    its columns after the step, or None where these are a step of each reading; ``periodic`` those that are a wave
    of each input at a searched period, each with the period that the model has for it, or None; ``lagging`` those
    among ``effects`` that follow with a searched time constant, each with what gives its columns at another one;
    ``untestable`` maps the others to the reason. ``inputs`` name to (n,), the readings of the inputs, be they constant
    or their patterns unknown.
    """

    residual: Floats
    variables: Mapping[str, Floats]
    group: Ints
    repeated: Ints
    derivatives: Derivatives
    pattern_of: Mapping[str, str] = field(default_factory=dict)
    place: tuple[str, ...] = ()
    inputs: Mapping[str, Floats] = field(default_factory=dict)
    time: Floats | None = None
    effects: Sequence[tuple[Effect, slice]] = ()
    in_time: Sequence[tuple[Effect, slice | None]] = ()
    periodic: Sequence[tuple[Effect, float | None]] = ()
    lagging: Sequence[tuple[Effect, Callable[[float], Callable[[slice], Floats]]]] = ()
    untestable: Mapping[str, str] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.residual)

    @property
    def axes(self) -> int:
        """Readings per row."""
        return self.residual.shape[1]

    def fitted(self, rows: slice) -> Floats:
        """Derivatives (b, m, p) of a stretch of rows by what is fitted."""
        return self._own(rows)[0]

    @last_asked
    def effects_in(self, rows: slice) -> Floats:
        """Derivatives (b, m, e) of a stretch of rows by the parameters of every effect that can be tried."""
        return self.derivatives.effects(rows)

    @last_asked
    def _own(self, rows: slice) -> tuple[Floats, Floats | None]:
        return self.derivatives.fitted(rows)

    @property
    def whole(self) -> slice:
        """All rows."""
        return slice(0, len(self))

    @cached_property
    def blocks(self) -> list[slice]:
        """Stretches of rows."""
        return blocks(len(self))

    @property
    def waving(self) -> tuple[str, ...]:
        """Inputs along which waves of one period are looked for: those in the unit of the period that an effect has,
        where some are in another."""
        units = {(effect.search or "").removeprefix("period_") for effect, _ in self.periodic}
        mine = tuple(name for name in self.inputs if unit_in(name) in units)
        return mine or tuple(self.inputs)

    @cached_property
    def patterns(self) -> dict[str, Floats]:
        """How the readings answer to an error at each input, name to (n, m); empty where that is not known."""
        parts = [self._own(rows)[1] for rows in self.blocks]
        if any(part is None for part in parts):
            return {}
        every = np.concatenate([part for part in parts if part is not None])
        return {name: np.ascontiguousarray(every[:, :, k]) for k, name in enumerate(self.inputs)}


@dataclass(frozen=True)
class FittedAnew:
    """Derivatives of a refit by what it has of its own, and by what was tried those of the fit before it."""

    own: Derivatives
    before: Linearised

    def fitted(self, rows: slice) -> tuple[Floats, Floats | None]:
        """As the fit has it."""
        return self.own.fitted(rows)

    def effects(self, rows: slice) -> Floats:
        """As before."""
        return self.before.effects_in(rows)


class Whitening:
    """The AR(1) filter along the first axis; every row keeps its variance.

    ``lag`` (n,) is how many rows of the run lie between a row and the one before it here (1 where it follows at once):
    across a gap the correlation is ``rho`` to that power. A row of the result is ``here`` times its own value and
    ``before`` times that of the row before it, (n,) each. ``back`` (n,) is how many rows further up that one stands, 0
    where there is none: those of several targets, read in turn, each follow their own. Left out, it is the next.
    """

    def __init__(self, rho: float, lag: Ints, back: Ints | None = None) -> None:
        self.rho, self.lag, self.back = rho, lag, back
        carried = np.sign(rho) ** lag * np.abs(rho) ** lag
        #: Rows that follow another, and those that they follow.
        self.late: slice | Ints = slice(1, None)
        self.early: slice | Ints = slice(None, -1)
        if back is None:
            carried[:1] = 0.0
        else:
            carried[back == 0] = 0.0
            self.late = np.flatnonzero(back)
            self.early = self.late - back[self.late]
        self.here = 1.0 / np.sqrt(1.0 - carried**2)
        self.before = -carried * self.here

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Whitening) or self.rho != other.rho or (self.back is None) != (other.back is None):
            return False
        same = self.back is None or np.array_equal(self.back, other.back)  # type: ignore[arg-type]
        return same and np.array_equal(self.lag, other.lag)

    __hash__ = None  # type: ignore[assignment]

    def __call__(self, values: Floats) -> Floats:
        """Values (n, …) filtered."""
        if self.rho == 0.0:
            return values
        shape = (-1,) + (1,) * (values.ndim - 1)
        out = values * self.here.reshape(shape)
        out[self.late] += values[self.early] * self.before[self.late].reshape(shape)
        return out

    def on(self, values: Callable[[slice], Floats], rows: slice) -> Floats:
        """These rows (b, …) of what ``values`` gives for a stretch of rows, filtered."""
        if self.rho == 0.0:
            return values(rows)
        late, early = self._within(rows)
        first = int(np.min(early, initial=rows.start)) if isinstance(early, np.ndarray) else max(rows.start - 1, 0)
        raw = values(slice(first, rows.stop))
        shape = (-1,) + (1,) * (raw.ndim - 1)
        out = raw[rows.start - first :] * self.here[rows].reshape(shape)
        led = raw[early - first] if isinstance(early, np.ndarray) else raw[: len(raw) - 1]
        out[late] += led * self.before[rows][late].reshape(shape)
        return out

    def parts(self, rows: slice) -> Iterator[tuple[slice | Ints, slice | Ints, Floats]]:
        """The rows of which these consist under the filter: themselves, and those before them where there are some.
        Each time which of these rows (counted from the first of them) consist of which of all, with what factors."""
        yield slice(None), rows, self.here[rows]
        if self.rho != 0.0:
            late, early = self._within(rows)
            yield late, early, self.before[rows][late]

    def _within(self, rows: slice) -> tuple[slice | Ints, slice | Ints]:
        """Which of these rows, counted from the first of them, follow another, and which of all they follow."""
        if self.back is None:
            first = max(rows.start, 1)
            return slice(first - rows.start, None), slice(first - 1, rows.stop - 1)
        late = np.flatnonzero(self.back[rows])
        return late, rows.start + late - self.back[rows][late]

    @property
    def diagonal(self) -> Floats:
        """Diagonal (n,) of the filter's transpose times the filter."""
        out = self.here**2
        out[self.early] += self.before[self.late] ** 2
        return out

    @property
    def beside(self) -> Floats:
        """Of the same, what stands in each row's place (n,) of the row before it."""
        return self.here * self.before


def whiten(values: Floats, rho: float, back: Ints | None = None) -> Floats:
    """Values (n, …) under :class:`Whitening`, each row following at once."""
    return Whitening(rho, np.ones(len(values), dtype=np.int64), back)(values)


def orthonormal(columns: Floats, tolerance: float = 1e-9) -> Floats:
    """An orthonormal basis (n·m, rank) of columns (n, m, p) or (N, p), scaled to unit length first."""
    flat = columns.reshape(math.prod(columns.shape[:-1]), columns.shape[-1])
    norm = np.linalg.norm(flat, axis=0)
    flat = flat[:, norm > 0] / norm[norm > 0]
    if flat.shape[1] == 0:
        return flat
    # the small Gram matrix decides on rank, a second pass restores orthogonality
    for _ in range(2):
        value, vector = linalg.eigh(flat.T @ flat)
        keep = value > max(tolerance**2, 1e-14) * value[-1]
        flat = flat @ (vector[:, keep] / np.sqrt(value[keep]))
    return flat


def correlation_in_time(residual: Floats, basis: Floats, back: Ints | None = None) -> float:
    """ρ of AR(1) noise, from residuals (n, m) in the order of time after an orthonormal ``basis`` (n·m, k) was
    projected out; ``back`` as :class:`Whitening` has it.

    The rows must be all of a run. What projection alone does to neighbours is taken out (restricted estimate), and the
    estimate is repeated on filtered rows. Zero where it is within two standard errors of it.
    """
    n, m = residual.shape
    order = Whitening(0.0, np.ones(n, dtype=np.int64), back)
    pairs = len(residual[order.late])
    if not pairs:
        return 0.0
    # what is read in turn at one place may err together: of several targets no more is known than of one
    in_turn = 1.0 if back is None else float(back[back > 0].mean())
    rho, least = 0.0, 2.0 * np.sqrt(in_turn / (n * m))
    for _ in range(4):
        e = whiten(residual, rho, back)
        q = basis if rho == 0.0 or not basis.shape[1] else orthonormal(whiten(basis.reshape(n, m, -1), rho, back))
        flat = e.reshape(-1)
        flat = flat - q @ (q.T @ flat)
        left = flat.reshape(n, m)
        free = n * m - q.shape[1]
        if free <= 10 or not left.any():
            return 0.0
        variance = float((left**2).sum()) / free
        # winsorised, so that single outliers do not decide
        limit = 4.0 * np.sqrt(variance)
        left = np.clip(left, -limit, limit)
        variance = float((left**2).sum()) / free
        qq = q.reshape(n, m, -1)
        bias = -float((qq[order.late] * qq[order.early]).sum())
        lagged = float((left[order.late] * left[order.early]).sum()) / variance - bias
        step = lagged / (pairs * m * max(free / (n * m), 0.05))
        # filters in a row: their first-order terms add
        first = rho == 0.0
        rho = float(np.clip(rho + step * (1 - rho * rho), -0.95, 0.95))
        # what is less than one standard error at first will not be two in the end
        if abs(step) < 1e-3 or (first and abs(rho) < least / 2):
            break
    return rho if abs(rho) > least else 0.0


# -- What a step in time takes of residuals, wherever it stands ----------------------------------------------------


def step_gains(left: Floats, inside: Floats | float, cuts: Ints, least: float) -> Floats:
    """Sum of squares (c,) that a step on all axes, from each cut on, takes of what orthonormal columns ``left`` (n, m);
    nothing where they leave less than the part ``least`` of it. They have ``inside`` (c, m) of its square."""
    n = len(left)
    free = (n - cuts)[:, None] - inside
    return np.where(free > least * n, _since(left, cuts) ** 2 / np.maximum(free, 1e-12), 0.0).sum(axis=1)


def within(columns: Iterable[Floats], cuts: Ints) -> Floats | float:
    """Of the square of a step from each cut on (c, m), what orthonormal ``columns``, each (n, m), have; nothing of
    none."""
    return sum((_since(column, cuts) ** 2 for column in columns), 0.0)


def _since(values: Floats, cuts: Ints) -> Floats:
    """Sums (c, m) of values (n, m) from each cut on."""
    return np.cumsum(values[::-1], axis=0)[::-1][cuts]
