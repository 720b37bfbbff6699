"""What is known of several parameters at once: how far two places are from one another."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..base.types import Floats

#: Names of the parameters that move a place along x, y and z.
Names = tuple[str, str, str]


@dataclass(frozen=True)
class Apart:
    """Two places (2, 3), mm, as drawn, each moved by three parameters, are ``mm`` ± ``sd_mm`` from one another."""

    names: tuple[Names, Names]
    places_mm: Floats
    mm: float
    sd_mm: float

    def row(self, names: list[str], values: Floats) -> tuple[Floats, float]:
        """Derivatives (p,) of the distance by parameters of these names, and how much it is longer than at these
        ``values`` (p,)."""
        moved, index = self.places_mm.copy(), {name: k for k, name in enumerate(names)}
        for k, own in enumerate(self.names):
            moved[k] += [values[index[name]] if name in index else 0.0 for name in own]
        between = moved[1] - moved[0]
        length = float(np.linalg.norm(between))
        along = between / length if length > 0 else np.array([1.0, 0.0, 0.0])
        out = np.zeros(len(names))
        for sign, own in zip((-1.0, 1.0), self.names, strict=True):
            for name, by in zip(own, along, strict=True):
                if name in index:
                    out[index[name]] = sign * by
        return out, self.mm - length
