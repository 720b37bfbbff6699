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


def slip_time(fit: Fit) -> float:
    """The moment at which a step leaves least: that of the model's effect with a time to search for.

    Raises :class:`~sherkit.errors.EffectError` for a model without such an effect, or rows without time.
    """
    steps = [e for e in fit.model.known_effects.values() if e.search == "time_s"]
    moment = moment_of_step(FittedRun(fit), steps[0]) if steps else None
    if moment is None:
        raise EffectError(f"'{steps[0].name if steps else 'slip'}': no moment can be searched for in these rows")
    return moment
