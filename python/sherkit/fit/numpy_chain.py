"""A chain in NumPy, asked by a fit as a compiled one is: it says readings and derivatives, the rest is shared."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence

import numpy as np

import sherkit._core as _core

from ..base.types import Bools, Floats
from ..errors import FitError
from ..model.chain import Block
from .least_squares import iterate


class NumpyChain(ABC):
    """What stands where a robot has its compiled chain."""

    @abstractmethod
    def predict(self, values: Floats, block: Block) -> tuple[Floats, Bools]:
        """Readings (n, m), and which rows could be computed."""

    @abstractmethod
    def derivatives(self, values: Floats, block: Block, free: Sequence[int]) -> tuple[Floats, Floats, Floats, Bools]:
        """By the parameters ``free``, the joints and a displacement of the point (n, m, ·), and which rows could be
        computed."""

    def accumulate(
        self, solver: _core.Solver, values: Floats, free: Sequence[int], block: Block, readings: Floats, weights: Floats
    ) -> list[int]:
        """Gives the solver rows at its trial; returns those that cannot be computed there."""
        values = values.copy()
        values[list(free)] = solver.trial
        predicted, reached = self.predict(values, block)
        used = np.asarray((weights > 0).any(axis=1))
        missing = [int(k) for k in np.flatnonzero(used & ~reached)]
        if missing:
            return missing
        columns = np.where(used[:, None, None], self.derivatives(values, block, free)[0], 0.0)
        left = np.where(weights > 0, readings - predicted, 0.0)
        solver.push(np.ascontiguousarray(columns), left, weights)
        return []

    def solve(
        self, solver: _core.Solver, values: Floats, free: Sequence[int], block: Block, readings: Floats,
        weights: Floats, priors: bool,
    ) -> tuple[str, list[int]]:  # fmt: skip
        """Iterates to the minimum; how it ended, and the rows that cannot be computed at the start."""
        missing: list[int] = []

        def feed(_: Floats) -> None:
            missing[:] = self.accumulate(solver, values, free, block, readings, weights)
            if missing:
                raise FitError("rows are out of reach")
            if priors:
                solver.push_priors()

        try:
            return iterate(solver, feed), []
        except FitError:
            if not missing:  # the function itself has said what is wrong
                raise
            return "exhausted", missing
