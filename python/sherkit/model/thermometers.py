"""Further thermometers of a run: each may be what the instrument, the spindle or the frame follows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np

from ..base.types import Floats
from ..data import Measurements
from ..data.called import in_toml
from ..data.columns import TEMPERATURE
from ..data.in_time import DRAWN_C
from .base import ModelWithEffects
from .effect import Effect
from .rows import EffectRows

SHIFT = "thermal_shift"
#: Where the temperature stands that was ``temperature_c``, where another column takes its place.
OTHER = f"other_{TEMPERATURE}"


def grows(effect: Effect) -> bool:
    """Whether it is the robot itself, and not the instrument's stand, that goes with its temperature."""
    return effect.needs == (TEMPERATURE,) and not effect.name.startswith(SHIFT)


def further(data: Measurements) -> tuple[str, ...]:
    """Columns of °C beside ``temperature_c`` that are never constant."""
    return tuple(
        name for name, values in data.covariates.items()
        if name != TEMPERATURE and name.endswith("_c") and np.ptp(values) != 0
    )  # fmt: skip


def with_temperature_of(data: Measurements, column: str) -> Measurements:
    """The rows with this column as the temperature that the robot follows; what it was stays beside it."""
    now = dict(data.covariates)
    if (before := now.pop(TEMPERATURE, None)) is not None:
        now[OTHER] = before
    return replace(data, covariates=now | {TEMPERATURE: now.pop(column)})


def nearer_by(column: str, data: Measurements) -> str:
    """What to do where the robot follows another column than ``temperature_c``."""
    there = {TEMPERATURE: column} | ({OTHER: TEMPERATURE} if TEMPERATURE in data.covariates else {})
    return f"the robot follows {column}: write into its file that this is its temperature: {in_toml(there)}"


def thermometers_of(model: ModelWithEffects, data: Measurements) -> tuple[Effect, ...]:
    """``thermal_shift`` by each column of °C beside ``temperature_c`` that a run has, which are never constant: effects
    as those of a user's own, ``thermal_shift_bearing`` for ``bearing_c``. None where the model has no such effect."""
    shift = model.known_effects.get(SHIFT)
    axes = len(data.layout.coordinates)
    if shift is None or len(shift.parameters) != axes:
        return ()
    out = []
    for name in further(data):
        out.append(
            Effect(
                name=f"{SHIFT}_{name.removesuffix('_c')}",
                link="sensor",
                parameters=shift.parameters,
                needs=(name,),
                physics=f"What is read shifts with the temperature of {name.removesuffix('_c')}.",
                residuals=shift.residuals,
                remedy=shift.remedy,
                function=partial(_shift, name),
            )
        )
    return tuple(out)


def catalogue_for(model: ModelWithEffects, data: Measurements | None = None) -> dict[str, Effect]:
    """All that may be named of a run: what a model knows and what it holds, and what goes with a thermometer."""
    by_thermometer = () if data is None else thermometers_of(model, data)
    return {**{one.name: one for one in by_thermometer}, **model.known_effects, **model.held}


def with_thermometers(
    own: Mapping[str, Effect], model: ModelWithEffects, data: Measurements
) -> tuple[Effect, ...]:  # fmt: skip
    """A user's effects by name, and behind them those of :func:`thermometers_of` that have no name of these."""
    return (*own.values(), *(one for one in thermometers_of(model, data) if one.name not in own))


def _shift(column: str, rows: EffectRows, p: SimpleNamespace) -> Floats:
    return np.multiply.outer(rows[column] - DRAWN_C, np.array(list(vars(p).values())))
