"""The iteration of a fit whose rows come from Python: the core's solver asks, a model in NumPy answers."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from . import _core
from .errors import FitError

Floats = NDArray[np.float64]


def iterate(
    solver: _core.Solver,
    weights: Floats,
    left: Callable[[Floats], Floats],
    columns: Callable[[Floats], Floats],
    *,
    priors: bool = False,
) -> str:
    """Runs the solver to its end and says which: ``converged`` or ``exhausted``.

    ``left`` gives measured minus predicted (n, m), ``columns`` the derivatives (n, m, p), at the parameters asked for;
    ``weights`` (n, m) is zero where nothing was taken. A step that leaves what the model can compute
    (:class:`~sherkit.errors.FitError`) is damped; where the start does already, the error is raised.
    """
    first = True
    while True:
        solver.clear()
        try:
            values = solver.trial
            residuals = np.where(weights > 0, left(values), 0.0)
            derivatives = np.ascontiguousarray(columns(values))
        except FitError:
            if first:
                raise
            solver.fail()
        else:
            solver.push(derivatives, residuals, weights)
            if priors:
                solver.push_priors()
        first = False
        ended = solver.advance()
        if ended != "evaluate":
            return ended
