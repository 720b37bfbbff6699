"""Points, planes and known distances of an arm's file that stand beside its joints."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from ...base.figures import brief, listed, nearest
from ...data.declared import key, keys_from, keys_of
from ...data.toml import Table
from ...errors import ShapeError
from ...model.tolerances import Apart
from .frames import Triple

# -- Points ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Plane:
    """A plane that stands fixed, base frame: a point of it, mm, and its normal, of any length, towards the side where
    distances are positive."""

    at_mm: Triple
    normal: Triple = (0.0, 0.0, 1.0)

    KEYS: ClassVar = {"at_mm": key(Table.numbers, 3), "normal": key(Table.numbers, 3)}

    @classmethod
    def from_table(cls, table: Table) -> Plane:
        """A table ``[[plane]]``."""
        made = cls(**keys_from(table, cls.KEYS, cls))
        if not np.linalg.norm(made.normal) > 0:
            raise table.fail("normal", "a direction, not only zeros")
        return made

    def to_table(self) -> dict[str, Any]:
        """What :meth:`from_table` reads."""
        return keys_of(self, self.KEYS)

    @property
    def numbers(self) -> tuple[float, ...]:
        """The point, and a normal of length one (6,)."""
        normal = np.array(self.normal) / np.linalg.norm(self.normal)
        return (*self.at_mm, *normal.tolist())


def points(table: Table, name: str) -> tuple[tuple[Triple, ...], tuple[str, ...]]:
    """The places of tables ``[[name]]``, and of each target the ``group`` that it belongs to, empty for none."""
    found = [
        (one.numbers("at_mm", 3), one.words("group", "") if name == "target" else "") for one in table.tables(name)
    ]
    return tuple((v[0], v[1], v[2]) for v, _ in found), tuple(group for _, group in found)


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


@dataclass(frozen=True)
class Distance:
    """Two centres, by their numbers from 1, are ``mm`` ± ``sd_mm`` (one sigma) from one another, as a gauge or a
    coordinate measuring machine has it."""

    between: tuple[int, int]
    mm: float
    sd_mm: float = 0.01

    KEYS: ClassVar = {
        "between": key(Table.wholes),
        "mm": key(Table.number, positive=True),
        "sd_mm": key(Table.number, positive=True),
    }

    @classmethod
    def from_table(cls, table: Table) -> Distance:
        """A table ``[[distance]]``."""
        made = cls(**keys_from(table, cls.KEYS, cls))
        if len(set(made.between)) != 2 or len(made.between) != 2:
            raise table.fail("between", "the numbers of two centres, such as [1, 2]")
        return made

    def to_table(self) -> dict[str, Any]:
        """What :meth:`from_table` reads."""
        return keys_of(self, self.KEYS)

    def check(self, centres: int) -> None:
        """Raises ``ShapeError`` where the arm has no such centres."""
        if not all(1 <= k <= centres for k in self.between):
            raise ShapeError(
                f"a distance between the centres {self.between[0]} and {self.between[1]}: there are {centres} centres"
            )

    def of(self, centres_mm: Sequence[Triple]) -> Apart:
        """The same of the parameters of a model."""
        i, k = ((f"centre_{one}_x", f"centre_{one}_y", f"centre_{one}_z") for one in self.between)
        return Apart((i, k), np.array([centres_mm[one - 1] for one in self.between]), self.mm, self.sd_mm)
