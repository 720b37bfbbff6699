"""How large fitted parameters are beside what is plausible."""

from __future__ import annotations

import warnings
from collections.abc import Sequence

import numpy as np

from ..base.figures import sized, stated
from ..base.types import Floats
from ..errors import FitError, SherkitWarning
from ..fit.identify import ABSURD, Fit
from ..model.effect import Effect, Parameter
from ..model.sensor_pose import slip_of
from ..model.set_ups import SETUP_PREFIX
from .fitted_run import FittedRun
from .thresholds import PLAUSIBLE, TOLD


def times_plausible(fit: Fit) -> Floats:
    """How many plausible sizes each parameter (p,) is at least, give or take two deviations; none of what is free of
    where the sensor stands, of where it was put since, and of where targets sit."""
    of_pose = fit.model.free_of_pose
    free = {*of_pose, *map(slip_of, of_pose), *fit.model.targets_anywhere}
    size = np.array([np.inf if p.name in free or _is_set_up(p) else p.size for p in fit.parameters])
    return np.maximum(np.abs(fit.values) - 2 * fit.std_from_readings, 0.0) / size


def _is_set_up(p: Parameter) -> bool:
    return p.name.startswith(SETUP_PREFIX) and not p.known


def displaces(fit: Fit, before: Fit) -> bool:
    """Whether what was added to a fit pushes a parameter that it had ``before`` beyond what is plausible.

    An effect that fits only where the machine stands as nobody would have built it is no cause: expansion about the
    origin of the base, say, does what warm rods do if the base lies a tenth of a metre elsewhere.
    """
    was = {p.name: size for p, size in zip(before.parameters, times_plausible(before), strict=True)}
    # a robot that is far from its drawing already is not the effect's doing
    return any(
        size > PLAUSIBLE + 2 * was[p.name]
        for p, size in zip(fit.parameters, times_plausible(fit), strict=True)
        if p.name in was
    )


def farthest_parameter(fit: Fit, k: int) -> str:
    """A parameter by its number, beside what is usual."""
    p = fit.parameters[k]
    # all that a person reads of a value has one deviation: that of readings and plausible sizes together
    value = stated(float(fit.values[k]), float(fit.std[k]), p.unit, p.size)
    return f"{p.name} = {value} where {sized(p.size, p.unit)} is usual"


def refuse_absurd(fit: Fit, names: Sequence[str]) -> None:
    """Refuses a fit in which one of the named effects is absurdly large, and warns where it is not plausible.

    Raises :class:`~sherkit.errors.FitError`.
    """
    told = implausible(fit, names, PLAUSIBLE)
    if told is None:
        return
    sizes = times_plausible(fit)
    if any(sizes[fit.model.owns(e)].max() > ABSURD for e in fit.model.effects if e.name in names):
        raise FitError(f"{fit.data.source}: {told}; nothing that such a fit says can be believed")
    warnings.warn(f"{fit.data.source}: {told}", SherkitWarning, stacklevel=3)


def implausible(fit: Fit, names: Sequence[str], most: float = TOLD) -> str | None:
    """The named effect whose size is beyond so many times what is plausible, as a sentence; None where none is."""
    sizes = times_plausible(fit)
    for effect in fit.model.effects:
        place = fit.model.owns(effect)
        if effect.name in names and sizes[place].max() > most:
            k = place.start + int(np.argmax(sizes[place]))
            return f"{farthest_parameter(fit, k)} ({sizes[k]:.2g} ×): look for another cause, or for why it is so large"
    return None


def is_plausible(run: FittedRun, effect: Effect, most: float = PLAUSIBLE) -> bool:
    """Whether no parameter of an effect is beyond so many times its plausible size."""
    return bool((times_plausible(run.fit)[run.owns(effect)] <= most).all())
