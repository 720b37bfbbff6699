"""The iteration of a fit whose rows come from Python: the core's solver asks, a model answers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import sherkit._core as _core

from ..base.types import Floats
from ..errors import FitError, RobotError

#: Part of the variance of the noise that is not worth a step: it would go by a tenth of a deviation.
_NOTHING = 1e-2
#: So many steps that leave what the model can compute say that it ends on the way to the minimum.
_EDGE = 12


def iterate(solver: _core.Solver, feed: Callable[[Floats], None]) -> str:
    """Runs the solver to its end and says which: ``converged`` or ``exhausted``.

    ``feed`` gives the solver every row at the parameters asked for. A step that leaves what the model can compute
    (:class:`~sherkit.errors.FitError`, or :class:`~sherkit.errors.RobotError` where it leaves no robot) is damped,
    until there were a dozen; where the start does already, the error is raised.
    """
    evaluations, outside, over = 0, 0, ""
    while True:
        solver.clear()
        if over:
            # the solver goes back to where it stands by finding no further step
            solver.fail()
        else:
            try:
                feed(solver.trial)
            except (FitError, RobotError):
                if not evaluations:
                    raise
                solver.fail()
                outside += 1
        evaluations += 1
        ended = solver.advance()
        if ended != "evaluate":
            return over or ended
        if outside >= _EDGE:
            over = "exhausted"


def reached(ended: str, result: Mapping[str, Any]) -> bool:
    """Whether a solver that ``ended`` so stands at the minimum, by its ``result``.

    Along a combination that the rows hardly tell, steps stay long however small their use, and the curvature of the
    rows makes them miss: there it is enough that next to nothing is left to gain.
    """
    variance = result["cost"] / max(result["rows"] - result["rank"], 1)
    return ended == "converged" or bool(result["to_gain"] <= _NOTHING * variance)
