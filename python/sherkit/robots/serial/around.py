"""What stands around an arm and what it carries: planes, and what is known of how far places are from one another."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np

from ...base.types import Floats
from ...data.toml import Table
from ...errors import ShapeError
from ...model.relations import Apart, Names
from .frames import Triple

#: How well a distance is known where its table does not say it, mm.
USUAL_SD_MM = 0.01


@dataclass(frozen=True)
class Plane:
    """A plane that stands fixed, base frame: a point of it, mm, and its normal, of any length, towards the side where
    distances are positive."""

    at_mm: Triple
    normal: Triple = (0.0, 0.0, 1.0)

    @property
    def numbers(self) -> tuple[float, ...]:
        """The point, and a normal of length one (6,)."""
        normal = np.array(self.normal) / np.linalg.norm(self.normal)
        return (*self.at_mm, *normal.tolist())

    @classmethod
    def from_table(cls, one: Table) -> Plane:
        """A table ``[[plane]]``."""
        at, normal = one.numbers("at_mm", 3), one.numbers("normal", 3, (0.0, 0.0, 1.0))
        if not np.linalg.norm(normal) > 0:
            raise one.fail("normal", "a direction, not only zeros")
        return cls((at[0], at[1], at[2]), (normal[0], normal[1], normal[2]))


@dataclass(frozen=True)
class Distance:
    """Two centres, or two targets, by their numbers from 1, are ``mm`` ± ``sd_mm`` (one sigma) from one another, as a
    gauge, a coordinate measuring machine or the drawing of a plate has it."""

    between: tuple[int, int]
    mm: float
    sd_mm: float = USUAL_SD_MM
    of: str = "centres"

    @classmethod
    def from_table(cls, one: Table) -> Distance:
        """A table ``[[distance]]``."""
        ends = one.wholes("between")
        if len(ends) != 2 or ends[0] == ends[1]:
            raise one.fail("between", "the numbers of two, such as [1, 2]")
        of = one.text("of", ("centres", "targets"), "centres")
        return cls(
            (ends[0], ends[1]), one.number("mm", positive=True), one.number("sd_mm", USUAL_SD_MM, positive=True), of
        )

    def to_table(self) -> dict[str, Any]:
        """What :meth:`from_table` reads."""
        return {"of": self.of, "between": list(self.between), "mm": self.mm, "sd_mm": self.sd_mm}

    def check(self, centres: int, targets: int) -> None:
        """Raises ``ShapeError`` where the arm has no such places."""
        count = targets if self.of == "targets" else centres
        if not all(1 <= k <= count for k in self.between):
            raise ShapeError(
                f"a distance between {self.of} {self.between[0]} and {self.between[1]}: there are {count} {self.of}"
            )


def points(table: Table, name: str) -> tuple[Triple, ...]:
    """The places of tables ``[[name]]``."""
    found = (one.numbers("at_mm", 3) for one in table.tables(name))
    return tuple((v[0], v[1], v[2]) for v in found)


def targets(table: Table) -> tuple[tuple[Triple, ...], tuple[str, ...]]:
    """The places of tables ``[[target]]``, and the group of each."""
    found = [(one.numbers("at_mm", 3), one.words("group", "", empty=True)) for one in table.tables("target")]
    return tuple((v[0], v[1], v[2]) for v, _ in found), tuple(group for _, group in found)


def of_groups(groups: Sequence[str], targets_mm: Sequence[Triple]) -> tuple[Distance, ...]:
    """Targets of one group are one rigid body: they are as far from one another as drawn."""
    pairs = combinations(range(len(groups)), 2)
    return tuple(
        Distance((i + 1, k + 1), float(np.linalg.norm(np.subtract(targets_mm[i], targets_mm[k]))), of="targets")
        for i, k in pairs
        if groups[i] and groups[i] == groups[k]
    )


def apart(one: Distance, centres_mm: Sequence[Triple], targets_mm: Floats) -> Apart:
    """The same of the parameters of a model, whose targets (t, 3) are seen in its last frame."""
    places = targets_mm if one.of == "targets" else np.array(centres_mm, dtype=float)
    i, k = one.between
    return Apart((_names(one.of, i), _names(one.of, k)), places[[i - 1, k - 1]], one.mm, one.sd_mm)


def _names(what: str, number: int) -> Names:
    first = "tool" if what == "targets" and number == 1 else f"{what.removesuffix('s')}_{number}"
    return (f"{first}_x", f"{first}_y", f"{first}_z")
