"""Many poses at once, and the shapes in which they are given."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base.figures import listed
from ..base.types import Floats
from ..errors import NotFinite, OutOfReach, ShapeError, SherkitError


class Batch(NamedTuple):
    """Many poses at once. Rows out of reach are marked ``False`` in ``reached`` and NaN in ``values``.

    Take the numbers with :meth:`require` where every row must be in reach, else with ``values[reached]``.
    """

    values: Floats
    reached: NDArray[np.bool_]
    why: tuple[str, ...] = ()

    def require(self, what: str = "row") -> Floats:
        """The values; raises :class:`OutOfReach` or :class:`NotFinite` naming the rows that have none."""
        if not self.reached.all():
            rows = np.flatnonzero(~self.reached)
            reason = f" (first: {self.why[0]})" if self.why else ""
            message = f"{what}s {listed(rows)} (counted from 0) cannot be reached{reason}"
            raise OutOfReach(message, 0, float("nan"))
        return self.values


def vector(value: ArrayLike, what: str, size: int = 3) -> Floats:
    """``size`` finite numbers, contiguous. Raises :class:`~sherkit.errors.ShapeError`, :class:`NotFinite`."""
    v = np.ascontiguousarray(value, dtype=float)
    if v.shape != (size,):
        raise ShapeError(f"{what}: expected {size} numbers, got an array of shape {v.shape}")
    if not np.isfinite(v).all():
        raise NotFinite(f"{what}: {v.tolist()} holds a number that is not finite")
    return v


def matrix(value: ArrayLike, what: str, size: int = 3) -> Floats:
    """Rows of ``size`` numbers, contiguous. Raises :class:`~sherkit.errors.ShapeError`."""
    m = np.ascontiguousarray(value, dtype=float)
    if m.ndim != 2 or m.shape[1] != size:
        raise ShapeError(f"{what}: expected an array of shape (n, {size}), got {m.shape}")
    return m


def why(
    compute: Callable[[Floats], object], rows: Floats, reached: NDArray[np.bool_], most: int = 3
) -> tuple[str, ...]:
    """Why the first rows that cannot be reached cannot: what ``compute`` says of one alone."""
    reasons = []
    for row in np.flatnonzero(~reached)[:most]:
        try:
            compute(rows[row])
        except SherkitError as error:
            reasons.append(f"row {row}: {error}")
    return tuple(reasons)
