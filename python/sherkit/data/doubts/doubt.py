"""What a table says against itself, before any model is fitted to it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..rows import Measurements

#: Rows that are looked at first: what is true of the whole table is true of them.
LOOKED_AT = 2000
#: Fewer rows than this say nothing of a table.
FEWEST = 10


@dataclass(frozen=True)
class DataWarning:
    """One sentence: what stands in the table, what it looks like, what to do.

    Where ``poses`` is true nothing is wrong, but the rows cannot tell what a model would ask of them. Else the table is
    wrong, and no machine is to be blamed for what a model leaves of it; where ``columns`` is true no column can be
    compared with another, either.
    """

    sentence: str
    poses: bool = False
    columns: bool = False

    def __str__(self) -> str:
        return self.sentence


def some(data: Measurements) -> Measurements:
    """Rows spread over the table, as many as are looked at first."""
    if len(data) <= LOOKED_AT:
        return data
    return data.select(np.unique(np.linspace(0, len(data) - 1, LOOKED_AT).astype(np.int64)))
