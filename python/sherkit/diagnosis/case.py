"""A case: a fit on its rows, as diagnosis sees it. Only its implementations know which machine it is."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..effects import Effect
from .view import View

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Seen:
    """Some rows of a case, over the noise: the view, and what every effect that can be tried would add.

    ``columns`` pairs each effect with its derivatives (n, m, k); ``in_time`` are the effects whose columns are those of
    a step at a searched time; ``untestable`` maps the others to the reason.
    """

    view: View
    columns: Sequence[tuple[Effect, Floats]]
    in_time: Sequence[Effect]
    untestable: dict[str, str]


class Case(ABC):
    """A fit on its rows.

    ``fit`` has ``parameters``, ``values`` (p,) and ``std_from_readings`` (p,). ``names`` are those of the reading
    columns and ``axes`` the columns looked at. Reports are in ``unit``, of which one unit of a reading has
    ``per_unit``. ``used`` (n, columns) tells the readings that were taken and are not marked as outliers,
    ``residuals`` (n, columns) measured minus predicted; ``groups`` (n,) is equal for repeats of a pose,
    ``order`` (n,) the place of a row in the run it was taken from.
    """

    fit: Any
    names: tuple[str, ...]
    axes: tuple[int, ...]
    unit: str
    per_unit: float
    source: str
    time_s: Floats | None
    groups: Ints
    order: Ints
    used: Bools
    #: Effects tried without being asked for.
    catalogue: tuple[Effect, ...]
    #: Outliers are taken out worst first, those at least this part as far off as the farthest in one round; at zero
    #: all at once.
    worst_first: float = 0.0

    @property
    @abstractmethod
    def residuals(self) -> Floats:
        """Measured minus predicted (n, columns), in the unit of the readings."""

    @property
    def whole(self) -> Bools:
        """Rows (n,) that can be tested: all readings there, no outlier."""
        return np.logical_and.reduce(self.used[:, self.axes], axis=1)

    @abstractmethod
    def noise(self) -> tuple[Floats, str]:
        """Noise per reading column (columns,), and where it is known from: declared, repeats or unknown."""

    @abstractmethod
    def blocks(self, folds: int, seed: int) -> Ints:
        """A fold (n,) for every row; neighbours stay together."""

    @abstractmethod
    def see(self, rows: Ints, effects: Sequence[Effect], sigma: Floats) -> Seen:
        """These rows, in this order, over the noise ``sigma`` (m,) of the axes."""

    @abstractmethod
    def check(self, effect: Effect) -> None:
        """Refuses a user's effect that is none on these rows. Raises :class:`~sherkit.errors.EffectError`."""

    @abstractmethod
    def refit(self, added: Sequence[tuple[Effect, Mapping[str, float]]]) -> Case:
        """The full fit with more effects, each with its settings. Raises :class:`~sherkit.errors.SherkitError`."""

    @abstractmethod
    def on(self, rows: Ints, sigma: Floats) -> Case:
        """The full fit on these rows alone, with this noise (columns,)."""

    @abstractmethod
    def without(self, rows: Ints) -> Case:
        """The full fit with these rows marked as outliers."""

    @abstractmethod
    def left_on(self, rows: Ints, other: Case) -> Floats:
        """What the fit of ``other`` leaves on these rows (rows, columns). Raises as :meth:`refit`."""

    @abstractmethod
    def owns(self, effect: Effect) -> slice:
        """Where the parameters of an effect that is in the model stand among the fitted ones."""

    def next_poses(self, rivals: Sequence[Case], sigma: Floats) -> tuple[dict[str, float], ...]:
        """Poses that tell this case from its rivals best; none where it is not known what can be reached."""
        del rivals, sigma
        return ()
