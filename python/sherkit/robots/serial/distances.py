"""What is known of how far two fixed places around an arm are from one another."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...data.toml import Table
from ...errors import ShapeError
from ...model.relations import Apart, Names
from .frames import Triple

#: How well a distance is known where its table does not say it, mm.
USUAL_SD_MM = 0.01


@dataclass(frozen=True)
class Distance:
    """Two centres, by their numbers from 1, are ``mm`` ± ``sd_mm`` (one sigma) from one another, as a gauge or a
    coordinate measuring machine has it."""

    between: tuple[int, int]
    mm: float
    sd_mm: float = USUAL_SD_MM

    @classmethod
    def from_table(cls, one: Table) -> Distance:
        """A table ``[[distance]]``."""
        ends = one.wholes("between")
        if len(ends) != 2 or ends[0] == ends[1]:
            raise one.fail("between", "the numbers of two centres, such as [1, 2]")
        return cls((ends[0], ends[1]), one.number("mm", positive=True), one.number("sd_mm", USUAL_SD_MM, positive=True))

    def to_table(self) -> dict[str, Any]:
        """What :meth:`from_table` reads."""
        return {"between": list(self.between), "mm": self.mm, "sd_mm": self.sd_mm}

    def check(self, centres: int) -> None:
        """Raises ``ShapeError`` where the arm has no such centres."""
        if not all(1 <= k <= centres for k in self.between):
            raise ShapeError(
                f"a distance between the centres {self.between[0]} and {self.between[1]}: there are {centres} centres"
            )

    def of(self, centres_mm: Sequence[Triple]) -> Apart:
        """The same of the parameters of a model."""
        i, k = self.between
        return Apart((_names(i), _names(k)), np.array([centres_mm[i - 1], centres_mm[k - 1]]), self.mm, self.sd_mm)


def _names(number: int) -> Names:
    return (f"centre_{number}_x", f"centre_{number}_y", f"centre_{number}_z")
