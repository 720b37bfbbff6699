"""What an effect may look at: the rows of a run by name."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .errors import EffectError
from .measurements import Measurements
from .names import listed, nearest

Floats = NDArray[np.float64]


class Rows:
    """The rows of a run as a user's effect sees them.

    ``joints`` (n, k), mm or rad; ``time`` (n,) s; ``direction`` (n, k) sign of the last motion; ``position`` (n, m),
    the coordinates that the model gives; every covariate of the file under its column name, with or without its unit
    (``rows.humidity_pct`` or ``rows.humidity``).
    """

    def __init__(self, data: Measurements, position: Floats) -> None:
        self._data = data
        self.joints = data.joints
        self.direction = data.direction
        self.position = position

    def __len__(self) -> int:
        return len(self._data)

    @property
    def time(self) -> Floats:
        """Time of each row, s."""
        if self._data.time_s is None:
            raise EffectError("these rows have no column 'time_s'")
        return self._data.time_s

    @cached_property
    def _names(self) -> dict[str, str]:
        names = {name.rsplit("_", 1)[0]: name for name in self._data.covariates}
        return names | {name: name for name in self._data.covariates}

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        found = self._names.get(name)
        if found is None:
            known = ["joints", "time", "direction", "position", *self._data.covariates]
            raise EffectError(f"these rows have no '{name}'{nearest(name, known)}; they have {listed(known, 20)}")
        return self._data.covariates[found]
