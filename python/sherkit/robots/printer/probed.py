"""The compiled chain of a delta, asked for the one number that a printer's row holds: a height, or a distance."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

import sherkit._core as _core

from ...base.types import Bools, Floats
from ...model.chain import Block

#: Among the four readings of a delta.
_HEIGHT, _DISTANCE, _READINGS = 2, 3, 4


@dataclass(frozen=True, eq=False)
class Probed:
    """The methods of the core that a model asks for, with readings (n, 1)."""

    core: _core.DeltaModel

    def predict(self, values: Floats, block: Block) -> tuple[Floats, Bools]:
        """Predicted readings (n, 1), and which rows have one."""
        out, reached = self.core.predict(values, block)
        return _picked(out, block), reached

    def derivatives(self, values: Floats, block: Block, free: list[int]) -> tuple[Floats, Floats, Floats, Bools]:
        """By parameters (n, 1, p), joints (n, 1, 3) and a displacement of the measured point (n, 1, 3)."""
        *found, reached = self.core.derivatives(values, block, free)
        by_parameters, by_joints, by_body = (_picked(one, block) for one in found)
        return by_parameters, by_joints, by_body, reached

    def solve(
        self,
        solver: Any,
        values: Floats,
        free: list[int],
        block: Block,
        readings: Floats,
        weights: Floats,
        priors: bool,
    ) -> tuple[str, list[int]]:
        """As the core's."""
        read, weigh = (_spread(one, block) for one in (readings, weights))
        return self.core.solve(solver, values, free, block, read, weigh, priors)

    def accumulate(
        self, solver: Any, values: Floats, free: list[int], block: Block, readings: Floats, weights: Floats
    ) -> list[int]:
        """As the core's."""
        read, weigh = (_spread(one, block) for one in (readings, weights))
        return self.core.accumulate(solver, values, free, block, read, weigh)


def places(block: Block) -> Floats:
    """Which of a delta's readings (n,) each row holds."""
    ends = block[1]
    if ends is None:
        return np.full(len(block[0]), _HEIGHT)
    return np.where(np.isfinite(ends).all(axis=1), _DISTANCE, _HEIGHT)


def _picked(values: Floats, block: Block) -> Floats:
    """Of values (n, 4, …) those of the reading that each row holds (n, 1, …)."""
    return np.ascontiguousarray(values[np.arange(len(values)), places(block)][:, None])


def _spread(values: Floats, block: Block) -> Floats:
    """Values (n, 1) at the place of each row's reading (n, 4), nothing elsewhere."""
    out = np.zeros((len(values), _READINGS))
    out[np.arange(len(values)), places(block)] = values[:, 0]
    return out
