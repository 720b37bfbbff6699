"""Points, planes and known distances of an arm's file that stand beside its joints."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...base.figures import brief, listed, nearest
from ...data.toml import Table
from ...errors import ShapeError
from ...model.tolerances import Apart, Names
from .frames import Triple

# -- Points ------------------------------------------------------------------------------------------------------------


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


def points(table: Table, name: str) -> tuple[Triple, ...]:
    """The places of tables ``[[name]]``."""
    found = (one.numbers("at_mm", 3) for one in table.tables(name))
    return tuple((v[0], v[1], v[2]) for v in found)


def grouped(table: Table, name: str) -> tuple[tuple[Triple, ...], tuple[str, ...]]:
    """The same, and of each the ``group`` that it belongs to, empty for none."""
    found = [(one.numbers("at_mm", 3), one.words("group", "")) for one in table.tables(name)]
    return tuple((v[0], v[1], v[2]) for v, _ in found), tuple(group for _, group in found)


def plane_of(one: Table) -> Plane:
    """A table ``[[plane]]``."""
    at, normal = one.numbers("at_mm", 3), one.numbers("normal", 3, (0.0, 0.0, 1.0))
    if not np.linalg.norm(normal) > 0:
        raise one.fail("normal", "a direction, not only zeros")
    return Plane((at[0], at[1], at[2]), (normal[0], normal[1], normal[2]))


#: Names of the parameters of every arm begin with these.
_TAKEN = ("sensor", "tool", "target", "centre", "plane", "offset", "shift", "tilt", "bar")


def check_groups(groups: Sequence[str]) -> None:
    """Refuses names that are none, or are taken, and groups of one. Raises :class:`~sherkit.errors.ShapeError`."""
    for name in dict.fromkeys(one for one in groups if one):
        if not re.fullmatch("[a-z][a-z0-9]*[a-z]|[a-z]", name) or name in _TAKEN:
            raise ShapeError(
                f"target group {brief(repr(name))}: expected small letters and digits, a letter last, and not one of "
                f"{listed(_TAKEN, 12)}"
            )
        if groups.count(name) == 1:
            others = [one for one in groups if one and one != name]
            raise ShapeError(
                f"target group '{name}': has one target alone, and two or more are a plate{nearest(name, others)}"
            )


# -- Known distances ---------------------------------------------------------------------------------------------------
# What is known of how far two fixed places around an arm are from one another.

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
