"""Set-ups of a run: an instrument that was moved between sessions, by the column ``setup``, as numbers or names."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import MeasurementError

#: No turn that anybody would speak of.
_NO_TURN_DEG = 1e-6

Triple = tuple[float, float, float]


@dataclass(frozen=True)
class JoinedSetUp:
    """A set-up whose readings were brought into the axes of the last one: ``turn`` (3, 3) and ``shift_mm`` (3,) took
    them there, ``middle_mm`` (3,) is the middle of where they are then."""

    name: str
    last: str
    turn: tuple[Triple, Triple, Triple]
    shift_mm: Triple
    middle_mm: Triple

    def __str__(self) -> str:
        angle = np.rad2deg(np.arccos(np.clip((np.trace(np.array(self.turn)) - 1.0) / 2.0, -1.0, 1.0)))
        far = float(np.linalg.norm(np.array(self.turn) @ self._seen + self.shift_mm - self._seen))
        turned = f" and {angle:.3g}°" if angle > _NO_TURN_DEG else ""
        return (
            f"setup '{self.name}': the instrument saw the robot {far:.4g} mm{turned} from where it sees it in the "
            f"last, '{self.last}'; its readings stand as the last would have shown them"
        )

    @property
    def _seen(self) -> NDArray[np.float64]:
        """The middle as it was read."""
        return np.array(self.turn).T @ (np.array(self.middle_mm) - self.shift_mm)


def set_up_names(values: NDArray[Any], place: str, line: NDArray[np.int64]) -> NDArray[Any]:
    """The column as names (n,): whole numbers without a point. Raises :class:`~sherkit.errors.MeasurementError` for a
    cell that is empty, or a number that is not whole."""
    out = []
    for k, value in zip(line.tolist(), values.tolist(), strict=True):
        number = _number(value)
        if number is not None and number != number // 1:
            raise MeasurementError(
                f"{place} {k}, column 'setup': {value} is not a whole number; number the set-ups 1, 2, 3, …, or name "
                "them"
            )
        name = str(value).strip() if number is None else f"{number:.0f}"
        if value is None or not name:
            raise MeasurementError(
                f"{place} {k}, column 'setup': is empty; expected the number or name of a set-up in every row, or no "
                "such column"
            )
        out.append(name)
    return np.array(out, dtype=object)


def _number(value: Any) -> float | None:
    """A number as one; None for anything else, and for what is not finite."""
    try:
        number = float(value)
    except (TypeError, ValueError):
        return None
    return number if np.isfinite(number) else None
