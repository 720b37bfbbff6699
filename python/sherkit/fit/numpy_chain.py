"""A chain in NumPy, asked by a fit as a compiled one is: it says readings and derivatives, the rest is shared."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

import sherkit._core as _core

from ..base.types import Bools, Floats
from ..errors import FitError
from ..model.chain import Block
from .least_squares import iterate

#: Small enough that its square is nothing, so that a derivative has no error but rounding.
_STEP = 1e-30


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
        weights: Floats,
    ) -> tuple[str, list[int]]:  # fmt: skip
        """Iterates to the minimum; how it ended, and the rows that cannot be computed at the start."""
        missing: list[int] = []

        def feed(_: Floats) -> None:
            missing[:] = self.accumulate(solver, values, free, block, readings, weights)
            if missing:
                raise FitError("rows are out of reach")
            solver.push_priors()

        try:
            return iterate(solver, feed), []
        except FitError:
            if not missing:  # the function itself has said what is wrong
                raise
            return "exhausted", missing


class ComplexChain(NumpyChain):
    """A chain whose readings are one formula that complex numbers pass: its derivatives are complex steps, exact to
    rounding (Squire and Trapp, "Using complex variables to estimate derivatives of real functions", SIAM Rev. 1998).

    ``joints`` and ``read`` count the readings of joints and those of instruments.
    """

    joints: ClassVar[int]
    read: ClassVar[int]

    @abstractmethod
    def _readings(self, values: NDArray[Any], joints: NDArray[Any], known: Floats, push: NDArray[Any]) -> NDArray[Any]:
        """Readings (n, m) for values of the parameters, readings of the joints (n, k), covariates (n, 2 k + 3), NaN
        where they are not known, and displacements (n, 3) of the point."""

    def _inputs(self, block: Block) -> tuple[Floats, Floats, Floats]:
        joints, to, known, push = block
        if to is not None:
            raise FitError("this chain reads no distances")
        n, covariates = len(joints), 2 * self.joints + 3
        empty = np.full((n, covariates), np.nan)
        return joints, empty if known is None else known, np.zeros((n, 3)) if push is None else push

    def predict(self, values: Floats, block: Block) -> tuple[Floats, Bools]:
        """Readings (n, m), and which rows could be computed."""
        out = self._readings(values, *self._inputs(block))
        return out, np.isfinite(out).all(axis=1)

    def derivatives(self, values: Floats, block: Block, free: Sequence[int]) -> tuple[Floats, Floats, Floats, Bools]:
        """By the parameters ``free``, the joints and a displacement (n, m, ·), and which rows could be computed."""
        joints, known, push = self._inputs(block)

        def along(size: int, which: Sequence[int], number: int) -> Floats:
            columns = []
            for k in which:
                inputs = [values.astype(complex), joints.astype(complex), push.astype(complex)]
                inputs[number] = inputs[number] + 1j * _STEP * np.eye(size)[k]
                columns.append(self._readings(inputs[0], inputs[1], known, inputs[2]).imag / _STEP)
            return np.stack(columns, axis=2) if columns else np.zeros((len(joints), self.read, 0))

        by_joints, by_body = along(self.joints, range(self.joints), 1), along(3, range(3), 2)
        return along(len(values), free, 0), by_joints, by_body, self.predict(values, block)[1]
