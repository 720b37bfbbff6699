"""Which thermometer the robot follows, where a run has several: its own growth is asked by ``temperature_c`` first, and
by another where that explains what goes with none, or with the instrument's stand."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from ..base.figures import listed
from ..data.columns import TEMPERATURE
from ..fit.identify import Fit, identify
from ..model.effect import Effect
from ..model.thermometers import SHIFT, further, grows, nearer_by, with_temperature_of
from .result import ADD_IT, WRONG, Diagnosis, Finding


def by_nearest_thermometer(
    found: Diagnosis, fit: Fit, effects: Sequence[Effect], again: Callable[[Fit], Diagnosis]
) -> Diagnosis:
    """What was ``found``, or, where the robot's growth by another thermometer explains that as well or better, what is
    found ``again`` with its column as the robot's temperature."""
    others = (_by(column, found, fit, effects, again) for column in further(fit.data))
    return min((one for one in others if one is not None), key=lambda one: one.error.rms, default=found)


def _by(
    column: str, found: Diagnosis, fit: Fit, effects: Sequence[Effect], again: Callable[[Fit], Diagnosis]
) -> Diagnosis | None:
    instead = any(name.startswith(SHIFT) for name in found.effects)
    asked = instead or found.verdict in ("unexplained", "partly explained")
    if (
        not asked
        or not any(map(grows, fit.model.known_effects.values()))
        or any(check.name == "set_up" and check.holds is False for check in found.checks)
    ):
        return None
    if any(TEMPERATURE in effect.needs or column in effect.needs for effect in (*fit.model.effects, *effects)):
        return None
    other = again(identify(fit.model, with_temperature_of(fit.data, column), loss=fit.loss, priors=fit.priors or None))
    own = [effect.name for effect in other.fit.model.effects if effect.name in other.effects and grows(effect)]
    if not own or other.verdict != "explained":
        return None
    if found.verdict == "explained" and other.error.rms > found.error.rms:
        return None
    note = f"{listed(own)} goes with {column}, which is taken for {TEMPERATURE} in all of this"
    said = Finding(WRONG, "unread", f"{note}; {nearer_by(column, fit.data)}")
    again_first = "write that, and ask again"
    next_steps = (
        replace(one, answer=again_first, command="") if one.answer == ADD_IT else one for one in other.findings
    )
    return replace(other, notes=(note, *other.notes), findings=(*next_steps, said))
