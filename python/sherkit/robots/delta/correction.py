"""Bernstein correction: a smooth polynomial for what the physics of the model leaves.

Source: Eqs. 12 and 13 of Xiao et al., ISMR 2022. The coefficients are linear, so one QR solve replaces the paper's
Levenberg–Marquardt. Order and variables are chosen by blocked cross-validation; the paper's own
protocol (one plane, a random 70/20/10 split) stands in ``paper.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

import sherkit._core as _core

from ...base.notebook import Saved
from ...base.types import Floats
from ...data.toml import Table
from ...errors import FitError, ShapeError
from ...fit.folds import spatial_blocks
from ...fit.identify import Fit

Orders = tuple[int, int, int]

MAX_ORDER = 8
#: Heights that lie so far apart are two.
_APART_MM = 3.0
#: Fewer full positions than this carry no polynomial worth having.
_FEWEST = 20
#: Below this, some coefficients are not determined by the poses.
_DETERMINED = 1e-8
#: The correction fades to nothing over this part of the box's widest side.
_FADE = 0.25


@dataclass(frozen=True, eq=False)
class Correction(Saved):
    """A fitted correction in mm over the box ``low_mm`` to ``high_mm`` (x, y, z; infinite for no variable).

    ``orders`` gives the order in x, y, z; zero means that the correction does not depend on that coordinate.
    ``coefficients_mm`` (k, 3), row-major in (x, y, z). Outside the box the border value is held and fades to
    zero over ``fade_mm``.
    """

    orders: Orders
    low_mm: Floats
    high_mm: Floats
    fade_mm: float
    coefficients_mm: Floats

    def __post_init__(self) -> None:
        for name in ("low_mm", "high_mm", "coefficients_mm"):
            object.__setattr__(self, name, np.ascontiguousarray(getattr(self, name), dtype=float))
        if not np.isfinite(self.coefficients_mm).all():
            raise ShapeError("correction: a coefficient is not a finite number")
        if not (np.isfinite(self.fade_mm) and self.fade_mm > 0):
            raise ShapeError(f"correction: fade_mm must be a positive number, got {self.fade_mm}")
        for k, axis in enumerate("xyz"):
            low, high = self.low_mm.ravel()[k : k + 1], self.high_mm.ravel()[k : k + 1]
            bounded = bool(np.isfinite(low).all() and np.isfinite(high).all() and (low < high).all())
            endless = bool((low == -np.inf).all() and (high == np.inf).all())
            if not (bounded or (endless and self.orders[k] == 0)):
                raise ShapeError(f"correction: low_mm must be below high_mm in {axis}, got {low} and {high}")
        _ = self.core  # refuses numbers that do not fit together

    @cached_property
    def core(self) -> _core.Bernstein:
        """The compiled polynomial."""
        return _core.Bernstein(
            self.orders, self.low_mm, self.high_mm, self.fade_mm, np.ascontiguousarray(self.coefficients_mm)
        )

    def __call__(self, positions_mm: Floats) -> Floats:
        """Correction (n, 3) at positions (n, 3), mm."""
        return self.core.evaluate(np.ascontiguousarray(positions_mm, dtype=float))[0]

    def functions(self, positions_mm: Floats) -> Floats:
        """What each of the k coefficients is multiplied with at positions (n, 3): (n, k)."""
        positions = np.ascontiguousarray(positions_mm, dtype=float)
        count = len(self.coefficients_mm)
        out = np.empty((len(positions), count))
        # the axes do not know each other, so that three coefficients are asked for at a time
        for first in range(0, count, 3):
            ones = np.zeros((count, 3))
            here = min(3, count - first)
            ones[np.arange(first, first + here), np.arange(here)] = 1.0
            out[:, first : first + here] = replace(self, coefficients_mm=ones)(positions)[:, :here]
        return out

    def derivative(self, positions_mm: Floats) -> Floats:
        """Derivative (n, 3, 3) of the correction by position."""
        return self.core.evaluate(np.ascontiguousarray(positions_mm, dtype=float))[1]

    def share(self, position_mm: Floats) -> float:
        """How much of the correction is left at a position (3,): 1 inside its box, 0 beyond the fade."""
        return self.core.share(np.ascontiguousarray(position_mm, dtype=float))

    def to_table(self) -> dict[str, Any]:
        """For TOML, without loss."""
        return {
            "orders": list(self.orders),
            "low_mm": self.low_mm.tolist(),
            "high_mm": self.high_mm.tolist(),
            "fade_mm": self.fade_mm,
            "coefficients_mm": self.coefficients_mm.tolist(),
        }

    @classmethod
    def from_table(cls, table: Table) -> Correction:
        """Back from :meth:`to_table`. Raises what the table raises, naming file and key."""
        orders = [int(n) for n in table.numbers("orders", 3) if n in range(MAX_ORDER + 1)]
        if len(orders) != 3:
            raise table.fail("orders", f"three orders from 0 to {MAX_ORDER}")
        values: dict[str, Any] = {
            "low_mm": table.array("low_mm", 3, finite=False),
            "high_mm": table.array("high_mm", 3, finite=False),
            "fade_mm": table.number("fade_mm"),
            "coefficients_mm": table.array("coefficients_mm", int(np.prod([n + 1 for n in orders])), 3),
        }
        try:
            return cls((orders[0], orders[1], orders[2]), **values)
        except ShapeError as error:
            raise table.refuse(str(error)) from None


def fit_polynomial(positions_mm: Floats, errors_mm: Floats, orders: Orders, fade_mm: float | None = None) -> Correction:
    """Least-squares polynomial of the given orders through errors (n, 3) at positions (n, 3), mm.

    On a full grid the fit is done axis by axis. Raises :class:`FitError` where the poses do not determine the
    coefficients, naming coordinate and order.
    """
    x = np.ascontiguousarray(positions_mm, dtype=float)
    y = np.ascontiguousarray(errors_mm, dtype=float)
    if x.ndim != 2 or x.shape[1] != 3 or x.shape != y.shape:
        raise ShapeError(f"positions and errors: expected two arrays (n, 3), got {x.shape} and {y.shape}")
    if not (np.isfinite(x).all() and np.isfinite(y).all()):
        raise FitError("positions and errors: a number is not finite")
    if len(x) == 0:
        raise FitError("a polynomial needs at least one pose, got none")
    low, high = _box(x, orders)
    coefficients, weakest = _core.bernstein_fit(orders, low, high, x, y)
    if not weakest > _DETERMINED:
        counts = ", ".join(f"{n} {len(np.unique(x[:, k].round(3)))}" for k, n in enumerate("xyz"))
        raise FitError(
            f"{len(x)} poses do not determine a polynomial of order {orders} "
            f"({len(coefficients)} coefficients; distinct coordinates: {counts}); lower the order"
        )
    return _made(orders, low, high, fade_mm, coefficients)


def _box(positions_mm: Floats, orders: Orders) -> tuple[Floats, Floats]:
    """Corners of the box of positions (n, 3), endless where an order is zero. Raises :class:`FitError`."""
    low, high = positions_mm.min(axis=0), positions_mm.max(axis=0)
    for k, name in enumerate("xyz"):
        if not 0 <= orders[k] <= MAX_ORDER:
            raise FitError(f"order in {name}: expected 0 to {MAX_ORDER}, got {orders[k]}")
        if orders[k] == 0:
            low[k], high[k] = -np.inf, np.inf
        elif high[k] - low[k] <= 0:
            raise FitError(f"order {orders[k]} in {name} needs more than one {name}; all poses share {low[k]:g} mm")
    return low, high


def fit_grid(axes: Sequence[Floats], errors_mm: Floats, orders: Orders, fade_mm: float | None = None) -> Correction:
    """The same polynomial from errors (n_x, n_y, n_z, 3) on a full grid with the given axes, mm.

    Kronecker form: one small solve per axis, the same result as :func:`fit_polynomial` on all points. Raises
    :class:`FitError` where an axis has fewer points than coefficients or a number is not finite, ``ShapeError``.
    """
    values = np.ascontiguousarray(errors_mm, dtype=float)
    ticks = [np.ascontiguousarray(a, dtype=float) for a in axes]
    if len(ticks) != 3 or any(t.ndim != 1 or len(t) == 0 for t in ticks):
        raise ShapeError("axes: expected three lists of coordinates, one per axis")
    if values.shape != (*(len(t) for t in ticks), 3):
        raise ShapeError(f"errors: expected an array of shape {(*(len(t) for t in ticks), 3)}, got {values.shape}")
    if not all(np.isfinite(t).all() for t in (*ticks, values)):
        raise FitError("axes and errors: a number is not finite")
    for n, name, found in zip(orders, "xyz", (len(np.unique(t)) for t in ticks), strict=True):
        if 0 < n <= MAX_ORDER and found <= n:
            raise FitError(f"order {n} in {name} needs {n + 1} different {name}; the grid has {found}")
    low, high = _box(np.array([[t.min() for t in ticks], [t.max() for t in ticks]]), orders)
    # without a variable any place is as good
    x, y, z = ((t - a) / (b - a) if n else 0.0 * t for t, a, b, n in zip(ticks, low, high, orders, strict=True))
    return _made(orders, low, high, fade_mm, _core.bernstein_fit_grid(orders, (x, y, z), values))


def _made(orders: Orders, low: Floats, high: Floats, fade_mm: float | None, coefficients: Floats) -> Correction:
    """With a fade by the size of the box where none is given."""
    span = (high - low)[np.isfinite(high - low)]
    fade = fade_mm if fade_mm is not None else (_FADE * float(span.max()) if len(span) else 1.0)
    return Correction(orders, low, high, fade, coefficients)


# -- which poses and errors a fit leaves ---------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Leftover:
    """What a fit leaves at each row with a full position: where (identified position) and how much, mm, in the frame of
    the base."""

    positions_mm: Floats
    errors_mm: Floats
    rows: NDArray[np.int64]


def enough_rows(fit: Fit) -> bool:
    """Whether enough rows hold a full position to carry a polynomial."""
    return bool(fit.data.taken[:, :3].all(axis=1).sum() >= _FEWEST)


def leftover(fit: Fit) -> Leftover:
    """Rows with x, y and z, outliers of the user left out."""
    rows = np.flatnonzero(fit.data.taken[:, :3].all(axis=1) & ~fit.data.outlier)
    turn, origin_mm = fit.model.sensor_frame(fit.values)
    return Leftover((fit.predicted[rows, :3] - origin_mm) @ turn, fit.residuals[rows, :3] @ turn, rows)


# -- blocked cross-validation --------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Choice:
    """Orders tried, their held-out RMS (µm, x y z together), and the correction chosen; None where none helps."""

    tried: tuple[tuple[Orders | None, float, float], ...]
    correction: Correction | None
    held_out_mm: Floats = field(repr=False)


def choose_correction(
    fit: Fit,
    *,
    orders: Sequence[int] = (1, 2, 3, 4, 5, 6),
    heights: int = 4,
    keep_none: bool = True,
    folds: int = 6,
    seed: int = 0,
) -> Choice:
    """Orders by blocked cross-validation: the simplest within one standard error of the best.

    Tries each order in x and y with order 0 to ``heights`` - 1 in z, as far as the poses have heights: planes, or
    heights of all sorts. No
    correction at all is among the candidates unless ``keep_none`` is false. The geometric fit has seen every
    row, with a dozen parameters; the polynomials have not. Raises :class:`FitError` where nothing can be fitted.
    """
    left = leftover(fit)
    data = fit.data.select(left.rows)
    n_groups = len(np.unique(data.groups))
    # heights of all sorts are as many as would lie apart
    found = sum(1 + int(np.ptp(level) // _APART_MM) for level in _levels(left.positions_mm[:, 2]))
    block = spatial_blocks(data, left.positions_mm, folds, seed)
    blocks = np.unique(block)
    candidates: list[Orders | None] = [None] if keep_none else []
    for n in orders:
        for nz in range(min(heights, found)):
            if (n + 1) ** 2 * (nz + 1) <= n_groups // 2:
                candidates.append((n, n, nz))
    tried, every = [], {}
    for candidate in candidates:
        held = _held_out(left, block, candidate)
        if held is None:
            continue
        square = (held**2).sum(axis=1)
        per_block = np.array([square[block == b].mean() for b in blocks])
        every[candidate] = per_block, held
        rms, most = (1e3 * float(np.sqrt(v)) for v in (per_block.mean(), per_block.mean() + _error(per_block)))
        tried.append((candidate, rms, most - rms))
    if not every:
        raise FitError(f"{n_groups} poses do not determine a polynomial of order {min(orders)}")
    best = min((per_block for per_block, _ in every.values()), key=np.mean)
    # one-standard-error rule (Breiman et al. 1984): paired with the best, block by block
    simplest = sorted(every, key=lambda orders: 0 if orders is None else int(np.prod([n + 1 for n in orders])))
    chosen = next(one for one in simplest if (every[one][0] - best).mean() <= _error(every[one][0] - best))
    correction = None if chosen is None else fit_polynomial(left.positions_mm, left.errors_mm, chosen)
    return Choice(tuple(tried), correction, every[chosen][1])


def _error(values: Floats) -> float:
    """Standard error of a mean; zero for one value."""
    return float(values.std(ddof=1) / np.sqrt(len(values))) if len(values) > 1 else 0.0


def _held_out(left: Leftover, block: NDArray[np.int64], orders: Orders | None) -> Floats | None:
    """Errors left at every row by a polynomial that did not see its block; None where it cannot be fitted."""
    if orders is None:
        return left.errors_mm
    try:
        low, high = _box(left.positions_mm, orders)
    except FitError:
        return None
    positions, errors = np.ascontiguousarray(left.positions_mm), np.ascontiguousarray(left.errors_mm)
    held, weakest = _core.bernstein_held_out(orders, low, high, positions, errors, block)
    return held if weakest > _DETERMINED else None


def levels_of(heights: Floats) -> Floats:
    """Heights of the planes: means of runs of sorted heights without a gap."""
    return np.array([float(level.mean()) for level in _levels(heights)])


def _levels(heights: Floats) -> list[Floats]:
    ordered = np.sort(heights)
    return np.split(ordered, np.flatnonzero(np.diff(ordered) > _APART_MM) + 1)
