"""Diagnosis: is anything missing, where, which effect, what it cannot be told from, what to measure next."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

from ..base import linalg
from ..base.arguments import Level, Seed, validate_arguments
from ..data.reader import RunLike
from ..errors import EffectError, FitError
from ..evidence.thresholds import LEVEL
from ..fit.identify import Fit, identify
from ..model.any import Model
from ..model.effect import Effect
from ..model.robot_file import RobotLike
from .by_thermometer import by_nearest_thermometer
from .result import Diagnosis
from .way import diagnosed


@validate_arguments
@linalg.one_thread()
def diagnose(
    fit: Fit | RobotLike | Model,
    data: RunLike = None,
    *,
    effects: Sequence[Effect] = (),
    level: Level = LEVEL,
    keep: Sequence[int] = (),
    seed: Seed = 0,
    step: Callable[[str], None] = lambda _: None,
) -> Diagnosis:
    """Diagnoses what a fit leaves, or what that of a robot or model to ``data`` does, as :func:`identify` takes them.

    ``effects`` are the user's own, beside the catalogue or the model's candidates. Rows to ``keep`` (by number from 0)
    are never left out as gross errors. Raises
    :class:`~sherkit.errors.FitError` where there is too little to diagnose, and
    :class:`~sherkit.errors.EffectError` for a user's effect that is none.

        found = sk.diagnose("demo/robot.toml", "demo/whole.csv")
        print(found.headline)
    """
    if not isinstance(fit, Fit):
        fit = identify(fit, data)
    elif data is not None:
        raise FitError("diagnose: a fit has its rows already; give a robot and rows, or the fit alone")
    for effect in effects:
        if not isinstance(effect, Effect):
            raise EffectError(
                f"diagnose: {effect!r} is no effect of yours; those of the catalogue are tried anyway, and one that is "
                "to be in the model already belongs to identify or Study"
            )
    if fit.for_regions:
        # what an effect that is missing does to regions is not the drawing's to say
        fit = identify(fit.model, fit.data, loss=fit.loss, priors=False, noise=fit.noise)
    again = partial(diagnosed, effects=effects, level=level, keep=keep, seed=seed, step=step)
    return by_nearest_thermometer(again(fit), fit, effects, again)
