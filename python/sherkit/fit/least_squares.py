"""A fit's rows as the solver takes them: by the core where the model is compiled throughout, else from NumPy."""

from __future__ import annotations

from typing import Any

import numpy as np

import sherkit._core as _core

from ..base.types import Floats
from ..data import Measurements
from ..model.base import ModelWithEffects
from ..model.chain import ChainModel
from .iterate import iterate


class LeastSquares:
    """A model and rows: what the solver is asked, by the core where the model is compiled throughout.

    ``sizes`` (p,) are the plausible sizes of the parameters, unless others are given.
    """

    def __init__(self, model: ModelWithEffects, data: Measurements, sizes: Floats | None = None) -> None:
        self.model = model
        self.data = data
        self.sizes = np.array([p.size for p in model.parameters]) if sizes is None else sizes
        self._last: tuple[Floats, Floats] | None = None

    def predicted(self, values: Floats) -> Floats:
        """Predicted readings (n, m); those asked for last are remembered."""
        if self._last is None or not np.array_equal(self._last[0], values):
            self._last = values.copy(), self.model.predict(self.data, values)
        return self._last[1]

    def residuals(self, values: Floats) -> Floats:
        """Measured minus predicted (n, m)."""
        return self.data.readings - self.predicted(values)

    def solve(
        self, weights: Floats, start: Floats, *, priors: bool = False, linear: bool = False, **settings: Any
    ) -> tuple[_core.Solver, str]:
        """The minimum from ``start``, and whether it was reached."""
        model, data = self.model, self.data
        solver = _core.Solver(start, self.sizes, single_step=linear, **settings)
        if isinstance(model, ChainModel) and not model.own:
            return solver, model.solve(solver, data, weights, priors=priors)

        def feed(values: Floats) -> None:
            push(solver, model, data, weights, values)
            if priors:
                solver.push_priors()

        return solver, iterate(solver, feed)

    def information(self, weights: Floats, values: Floats, *, priors: bool = False) -> dict[str, Any]:
        """What the readings say at ``values``; with ``priors`` the plausible sizes too."""
        return self.solve(weights, values, priors=priors, max_evaluations=1)[0].result()


def push(solver: _core.Solver, model: ModelWithEffects, data: Measurements, weights: Floats, values: Floats) -> None:
    """Gives the solver these rows as a model in NumPy has them. Raises as the model's ``predict``."""
    left = np.where(weights > 0, data.readings - model.predict(data, values), 0.0)
    solver.push(np.ascontiguousarray(model.derivatives(data, values)), left, weights)
