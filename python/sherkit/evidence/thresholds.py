"""Every number that decides in this room, with what it was counted on.

Evidence is in nats: the natural logarithm of by how much readings favour one statement over another.
"""

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

# -- Thresholds --------------------------------------------------------------------------------------------------------

#: Prior scales of what a hypothesis adds to a reading, in noises: a mean over four keeps the answer within a nat of the
#: best of them from 0.5 to 30 noises.
SCALES = np.array([0.7, 2.0, 6.0, 20.0])
#: From where on something is missing: 100 to 1. Of 41 runs with nothing hidden, on all robots, none came there.
ALARM = float(np.log(100.0))
#: By how much shapes must say more than effects before the effects are doubted: 1,000 to 1.
SURE = float(np.log(1e3))
#: Up to where two sets of effects are a tie, 10,000 to 1: refits move evidence by a few nats.
TIED = float(np.log(1e4))

#: By how much a name must beat the best shapes in its place (d), and what it must tell beside all of them (t). Of 57
#: spherical runs with physics of no catalogue d = 9 let 19 innocents through, these 8, and kept half of the true names.
NEEDED, TELLS = 30.0, 5.0
#: From where on a name that is needed so much need tell nothing beside shapes: true ones had 43 to 82, innocents less.
PLAINLY = 40.0

#: Part of a column's square below which the model holds it: of an effect, and of a shape, which is no more exact.
HELD_EFFECT, HELD_SHAPE = 1e-6, 4e-4
#: Part of its own square below which a column, as it was made, is rounding: a wave read in each of its zeros.
NOTHING = 1e-10
#: Part of a shape inside one effect from which on it is that effect once more, and no rival of it.
TWIN = 0.97
#: Part of poses to rows from which on a run is looked at row by row.
FEW_VISITS = 0.8

#: An error of the poses' own counts from this part of the noise on: below it the whole error grows by less than 5 %.
COUNTS = 0.3
#: Logarithm of how much louder one axis is than the mean, from which on axes are weighed anew.
UNEVEN = 0.3


# -- Plausible sizes ---------------------------------------------------------------------------------------------------
# How large fitted parameters are beside what is plausible.

#: Plausible sizes up to which people are told that a parameter is plausible; and up to which a search takes it for as
#: good as any.
TOLD, PLAUSIBLE = 3.0, 5.0


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
