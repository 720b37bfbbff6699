"""The moment at which something let go: a step of what is measured, at a time that is searched for."""

from __future__ import annotations

import numpy as np

from ..errors import EffectError
from ..fit.identify import Fit
from ..model.effect import Effect
from .fitted_run import FittedRun
from .search import Search


def moment_of_step(run: FittedRun, effect: Effect) -> float | None:
    """The moment at which a step takes most of what a run leaves; None where no moment can be searched for."""
    rows = np.flatnonzero(run.whole)
    search = Search(run, (effect,), rows, run.noise[0], level=0.01, rho=0.0)
    found = [c for c in search.strongest_settings(search.stage(search.base)) if c.effect.search == "time_s"]
    return found[0].setting if found else None


def slip_time(fit: Fit, effect: Effect) -> float:
    """The moment at which a step by this effect leaves least of a fit.

    Raises :class:`~sherkit.errors.EffectError` for rows in which no moment can be searched for.
    """
    moment = moment_of_step(FittedRun(fit), effect)
    if moment is None:
        raise EffectError(f"'{effect.name}': no moment can be searched for in these rows")
    return moment
