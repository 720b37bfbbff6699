"""Derivatives of a compiled chain for stretches of rows, those of NumPy effects carried on from their link."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..base.types import Bools, Floats
from ..data import Measurements
from .base import Derivatives
from .effect import Effect


@dataclass(frozen=True, eq=False)
class Stretches:
    """What gives derivatives for stretches of the rows of a run: the core of a ``model`` computes each."""

    model: Any
    data: Measurements
    values: Floats

    def of_core(self, some: slice, indices: Sequence[int]) -> tuple[Floats, Floats, Floats]:
        """By these parameters of the core (n, m, p), by the joints and by the body."""
        model, data = self.model, self.data
        part = tuple(None if one is None else one[some] for one in model.plain_block(data))
        columns, by_joints, by_body, _ = model.core_for(data).derivatives(model.full(self.values), part, indices)
        return columns, by_joints, by_body

    def carried(self, some: slice, effects: Sequence[tuple[Effect, Floats]], *by: Floats) -> list[Floats]:
        """What the user's effects give at their links, there for all rows, carried on to these."""
        data = self.data
        return [carry(e, inner[some], data.is_distance[some], data.coordinates, *by) for e, inner in effects]


@dataclass(frozen=True, eq=False)
class OfModel(Stretches):
    """By what is identified; ``own`` are the user's effects that are in the model."""

    own: Sequence[tuple[Effect, Floats]]

    def __call__(self, some: slice) -> Derivatives:
        columns, *by = self.of_core(some, self.model.indices)
        if self.own:
            columns = np.concatenate([columns, *self.carried(some, self.own, *by)], axis=2)
        return Derivatives(columns, by[0])


@dataclass(frozen=True, eq=False)
class OfEffects(Stretches):
    """By effects that are tried: built-in ones, which this model has beside its own, and the user's."""

    built_in: Sequence[Effect]
    tried: Sequence[tuple[Effect, Floats]]

    def __call__(self, some: slice) -> Floats:
        model = self.model
        asked = [k for effect in self.built_in for k in model.indices[model.owns(effect)]]
        columns, *by = self.of_core(some, asked)
        if self.tried:
            columns = np.concatenate([columns, *self.carried(some, self.tried, *by)], axis=2)
        return columns


def carry(
    effect: Effect, inner: Floats, is_distance: Bools, coordinates: int, by_joints: Floats, by_body: Floats
) -> Floats:
    """Derivatives (n, axes, p) of a NumPy effect at its link, carried on to the readings (n, m, p)."""
    if effect.link == "joints":
        return by_joints @ inner
    if effect.link == "body":
        return by_body @ inner
    out = np.zeros((len(inner), by_joints.shape[1], inner.shape[2]))
    out[~is_distance, :coordinates] = inner[~is_distance]
    return out
