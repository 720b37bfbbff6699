"""The iteration of a fit whose rows come from Python: the core's solver asks, a model answers."""

from __future__ import annotations

from collections.abc import Callable

import sherkit._core as _core

from ..errors import FitError
from ..types import Floats


def iterate(solver: _core.Solver, feed: Callable[[Floats], None]) -> str:
    """Runs the solver to its end and says which: ``converged`` or ``exhausted``.

    ``feed`` gives the solver every row at the parameters asked for. A step that leaves what the model can compute
    (:class:`~sherkit.errors.FitError`) is damped; where the start does already, the error is raised.
    """
    first = True
    while True:
        solver.clear()
        try:
            feed(solver.trial)
        except FitError:
            if first:
                raise
            solver.fail()
        first = False
        ended = solver.advance()
        if ended != "evaluate":
            return ended
