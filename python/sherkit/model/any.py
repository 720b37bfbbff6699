"""Any other machine: what its model must offer, and that model with effects.

A robot has a compiled chain, with links at which effects act. Here a machine is whatever has three methods; its
readings may be angles, lengths or both, as long as all columns of one table share a unit. Effects add to the readings.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol, runtime_checkable

import numpy as np

from ..base.types import Floats
from ..data import Measurements
from ..errors import EffectError, ShapeError
from .base import CandidateColumns, Derivatives, ModelWithEffects, column_slices
from .effect import Effect, Parameter
from .rows import EffectRows


@runtime_checkable
class Model(Protocol):
    """What a machine's model must offer to be fitted and diagnosed.

    It may also have ``candidates``: :class:`~sherkit.Effect` at the link ``sensor``, NumPy functions of the rows and
    their parameters that add to the readings (n, m). Diagnosis tries each.
    """

    @property
    def parameters(self) -> Sequence[Parameter]:
        """The parameters to fit, with units and plausible sizes; zero is the start."""
        ...

    def predict(self, data: Measurements, values: Floats) -> Floats:
        """Predicted readings (n, m), in the unit of the readings."""
        ...

    def derivatives(self, data: Measurements, values: Floats) -> Floats:
        """Derivatives (n, m, p) of the readings by the parameters."""
        ...

    def covariates(self, data: Measurements) -> dict[str, Floats]:
        """What the residuals may depend on besides the place, (n,) each: time, temperature, side."""
        ...


@dataclass(frozen=True, eq=False)
class Extended(ModelWithEffects):
    """A model with three methods, and the effects that were added to its readings."""

    plain: Model
    effects: tuple[Effect, ...] = ()

    robot = None

    @cached_property
    def bare(self) -> tuple[Parameter, ...]:
        """Those of the model."""
        return tuple(self.plain.parameters)

    @cached_property
    def known_effects(self) -> Mapping[str, Effect]:
        """The model's candidates."""
        return {e.name: e for e in getattr(self.plain, "candidates", ())}

    @cached_property
    def sensitivities(self) -> tuple[Floats, str]:
        """The one unit of all parameters; where there are several, plausible sizes."""
        units = {p.unit for p in self.parameters}
        if len(units) == 1:
            return np.ones(len(self.parameters)), units.pop()
        return np.array([1.0 / p.size for p in self.parameters]), "plausible sizes"

    def predict(self, data: Measurements, values: Floats) -> Floats:
        """Readings (n, m) with what the effects add. Raises :class:`ShapeError` for a wrong shape."""
        out = np.asarray(self.plain.predict(data, values[: len(self.bare)]), dtype=float)
        if out.shape != data.readings.shape:
            raise ShapeError(f"predict: expected an array of shape {data.readings.shape}, got {out.shape}")
        for effect in self.own:
            out = out + effect.evaluate(self.rows(data, values), values[self.owns(effect)], out.shape[1])
        return out

    def derivatives(self, data: Measurements, values: Floats) -> Floats:
        """Columns of the model, then of the effects. Raises :class:`ShapeError` for a wrong shape."""
        count, axes = len(self.bare), data.readings.shape[1]
        out = np.asarray(self.plain.derivatives(data, values[:count]), dtype=float)
        if out.shape != (len(data), axes, count):
            raise ShapeError(f"derivatives: expected an array of shape {(len(data), axes, count)}, got {out.shape}")
        rows = self.rows(data, values)
        return np.concatenate([out, *(e.columns(rows, values[self.owns(e)], axes) for e in self.own)], axis=2)

    def covariates(self, data: Measurements) -> dict[str, Floats]:
        """Those of the model."""
        return self.plain.covariates(data)

    def place(self, data: Measurements, predicted: Floats, values: Floats | None = None) -> dict[str, Floats]:
        """The inputs: what the readings say of the place is not known."""
        del predicted
        return {name: data.joints[:, k] for k, name in enumerate(data.layout.joints)}

    def axes_of(self, effect: Effect, data: Measurements) -> int:
        """One for each reading."""
        del effect
        return data.readings.shape[1]

    def rows(self, data: Measurements, values: Floats) -> EffectRows:
        """The rows, whose position is what the model predicts without effects."""
        return EffectRows(data, lambda: self.plain.predict(data, values[: len(self.bare)]))

    def linearised(self, data: Measurements, values: Floats) -> Derivatives:
        """By what is identified; the inputs are not known."""
        return Derivatives(self.derivatives(data, values), None)

    def tried(self, data: Measurements, values: Floats, effects: Sequence[Effect]) -> CandidateColumns:
        """Each effect by itself: what it adds does not pass through the model."""
        rows = self.rows(data, values)
        columns: list[tuple[Effect, Floats]] = []
        refused: dict[str, str] = {}
        for effect in effects:
            try:
                columns.append((effect, effect.columns_at_zero(rows, self.axes_of(effect, data))))
            except EffectError as error:
                refused[effect.name] = str(error)
        none = np.empty((*data.readings.shape, 0))
        beside = np.concatenate([none, *(one for _, one in columns)], axis=2)
        at = column_slices([(effect, one.shape[2]) for effect, one in columns])
        return CandidateColumns(beside.__getitem__, at, refused)
