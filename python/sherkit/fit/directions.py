"""Directions in parameter space that the rows observe badly or not at all, in parameter names."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..base import linalg
from ..base.types import Floats
from ..model.effect import Parameter

#: Parameters whose share of a direction is below this fraction of the largest are not named.
_NAMED = 0.3
#: How many badly observed directions are worth reading.
_MOST = 5


@dataclass(frozen=True)
class Direction:
    """A combination of parameters. ``change`` maps each named parameter to its part, in its own unit.

    ``std`` is how far the combination may move by one standard deviation, all its parts taken together in ``unit``
    (of a robot: millimetres); infinite where the readings do not change at all.
    """

    change: dict[str, float]
    std: float
    unit: str

    def __str__(self) -> str:
        names = list(self.change)
        if len(names) == 1:
            joined = f"{names[0]} alone"
        else:
            first = np.sign(self.change[names[0]])
            along = [n for n in names if np.sign(self.change[n]) == first]
            against = [n for n in names if n not in along]
            joined = _and(along) + (f" against {_and(against)}" if against else " together")
        return joined if np.isinf(self.std) else f"{joined}: {self.std:.2g} {self.unit}"


def badly_observed(
    parameters: Sequence[Parameter], covariance: Floats, sensitivities: tuple[Floats, str]
) -> tuple[Direction, ...]:
    """The principal axes of the covariance, worst first.

    Axes are listed down to a tenth of the worst. ``covariance`` (p, p) in the parameters' own units; ``sensitivities``
    turn each into one common unit, which they name.
    """
    lever, _ = sensitivities
    variance, axes = linalg.eigh(covariance * np.outer(lever, lever))
    out: list[Direction] = []
    for k in np.argsort(variance)[::-1][:_MOST]:
        std = float(np.sqrt(max(variance[k], 0.0)))
        if std <= 0 or (out and std < 0.1 * out[0].std):
            break
        out.append(_named(parameters, axes[:, k] * std, sensitivities, std))
    return tuple(out)


def unobserved(
    parameters: Sequence[Parameter], basis: Floats, sensitivities: tuple[Floats, str]
) -> tuple[Direction, ...]:
    """The null space in as few names as possible. ``basis`` (m, p) in units of plausible size.

    Any basis of the null space is as good as another; the one shown has been brought to echelon form from
    the last parameter on, so that each direction has a parameter that no other one has.
    """
    lever, _ = sensitivities
    size = np.array([p.size for p in parameters])
    rows = np.array(basis, dtype=float) * size * lever
    pivots: list[int] = []
    for k in range(len(rows)):
        scores = np.abs(rows[k:]).max(axis=0)
        scores[pivots] = 0.0
        # the last parameter with a fair share: the datum comes last and is the natural handle
        pivot = int(np.flatnonzero(scores >= _NAMED * scores.max())[-1])
        best = k + int(np.argmax(np.abs(rows[k:, pivot])))
        rows[[k, best]] = rows[[best, k]]
        rows[k] /= rows[k, pivot]
        for other in range(len(rows)):
            if other != k:
                rows[other] -= rows[other, pivot] * rows[k]
        pivots.append(pivot)
    return tuple(_named(parameters, row, sensitivities, float("inf")) for row in rows)


def _named(parameters: Sequence[Parameter], moved: Floats, sensitivities: tuple[Floats, str], std: float) -> Direction:
    lever, unit = sensitivities
    order = np.argsort(-np.abs(moved))
    named = [int(k) for k in order if abs(moved[k]) >= _NAMED * abs(moved[order[0]])]
    sign = np.sign(moved[named[0]])
    return Direction({parameters[k].name: float(sign * moved[k] / lever[k]) for k in named}, std, unit)


def _and(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else ", ".join(names[:-1]) + " and " + names[-1]
