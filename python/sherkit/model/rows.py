"""What an effect may look at: the rows of a run by name."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any

from ..base.figures import listed, nearest
from ..base.types import Floats
from ..data import Measurements
from ..errors import EffectError


class EffectRows:
    """The rows of a run as a user's effect sees them.

    ``joints`` (n, k), mm or rad; ``time`` (n,) s; ``direction`` (n, k) sign of the last motion; ``position`` (n, m),
    the coordinates that the model gives; every covariate of the file under its column name, with or without its unit
    (``rows.humidity_pct`` or ``rows.humidity``). Inputs and covariates are also found by ``rows["name"]``. ``position``
    is computed when it is asked for: an effect of the instrument has it as the instrument does, any other as seen from
    the base. Of a distance between two places an effect is asked at each end by itself:
    ``joints`` and ``position`` are those there, ``direction`` is zero, since nobody knows it.
    """

    def __init__(
        self, data: Measurements, position: Callable[[], Floats], at_base: Callable[[Floats], Floats] | None = None
    ) -> None:
        self._data = data
        self._position = position
        self._at_base = at_base
        self.joints = data.joints
        self.direction = data.came_from

    @cached_property
    def _from_base(self) -> EffectRows:
        """The same with places as seen from the base."""
        by = self._at_base
        return self if by is None else EffectRows(self._data, lambda: by(self.position))

    def __len__(self) -> int:
        return len(self._data)

    def __getitem__(self, name: str) -> Floats:
        return self._data[name]

    @cached_property
    def position(self) -> Floats:
        """Coordinates (n, m) that the model gives."""
        return self._position()

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


def seen_at(link: str, rows: EffectRows | Measurements) -> EffectRows | Measurements:
    """Rows as an effect at a link of the chain has them; a run that a model hands on stays as it is."""
    return rows if link == "sensor" or isinstance(rows, Measurements) else rows._from_base


def handed_on_run(rows: EffectRows | Measurements) -> Measurements:
    """The run itself, which a model may hand on as it is; as an attribute its name would hide a column of the file."""
    return rows if isinstance(rows, Measurements) else rows._data
