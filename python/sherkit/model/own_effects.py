"""The user's effects in a compiled chain: what they add at their links, and derivatives carried on from there.

A distance between two places has two ends, at each of which an effect is asked by itself: it moves the joints there, or
the measured point. What is read is none of theirs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ..base.types import Floats
from ..data import Measurements
from .base import Derivatives
from .effect import Effect
from .rows import EffectRows


def added_to(model: Any, data: Measurements, values: Floats) -> tuple[Floats, Floats, Floats]:
    """What the user's effects add to the joints (n, k), to the measured point (n, 3) and to what is read (n, c)."""
    rows = model.rows(data, values)
    sums = {"joints": np.zeros_like(data.joints), "body": np.zeros((len(data), 3))}
    sums["sensor"] = np.zeros((len(data), data.coordinates))
    for effect in model.own:
        own = np.asarray(values)[model.owns(effect)]
        sums[effect.link] += effect.evaluate(rows, own, model.axes_of(effect, data))
    return sums["joints"], sums["body"], sums["sensor"]


@dataclass(frozen=True, eq=False)
class InnerColumns:
    """Derivatives of the user's effects at their links, in these rows of a ``model`` at these values."""

    model: Any
    data: Measurements
    values: Floats

    @cached_property
    def _ends(self) -> list[EffectRows]:
        data = self.data
        every = (data, data.from_other_end) if data.between_places.any() else (data,)
        return [self.model.rows(one, self.values) for one in every]

    def of(self, effect: Effect, values: Floats) -> Floats:
        """By the parameters of an effect at its values (n, axes, p): of joints at both ends of distances between places
        (n, 2 k, p), as :func:`by_ends`; of the body at the first end against the other; of what is read by places."""
        axes = self.model.axes_of(effect, self.data)
        here, *there = (effect.columns(rows, values, axes) for rows in self._ends)
        if effect.link == "sensor":
            return np.where(self.data.is_distance[:, None, None], 0.0, here)
        if not there:
            return here
        other = np.where(self.data.between_places[:, None, None], there[0], 0.0)
        return np.concatenate([here, other], axis=1) if effect.link == "joints" else here - other

    def of_model(self) -> list[tuple[Effect, Floats]]:
        """The same of each effect that is in the model."""
        return [(one, self.of(one, self.values[self.model.owns(one)])) for one in self.model.own]

    def at_zero(self, effect: Effect) -> Floats:
        """The same of one that is not in it. Raises :class:`~sherkit.errors.EffectError` where it moves nothing."""
        out = self.of(effect, np.zeros(len(effect.parameters)))
        effect.require_moving(out)
        return out


def by_ends(model: Any, data: Measurements, full: Floats, block: Any, indices: Sequence[int]) -> Any:
    """As the core's derivatives; where distances between places are among ``data``, of which the block may be a
    stretch, by the joints at the first ends and then by those at the others (n, m, 2 k)."""
    core = model.core_for(data)
    columns, by_joints, by_body, reached = core.derivatives(full, block, indices)
    joints, ends, known, push = block
    if not data.between_places.any() or ends is None:
        return columns, by_joints, by_body, reached
    far = np.isfinite(ends).all(axis=1)[:, None]
    exchanged = (np.where(far, ends, joints), np.where(far, joints, np.nan), known, None if push is None else -push)
    there = np.where(far[:, :, None], core.derivatives(full, exchanged, [])[1], 0.0)
    return columns, np.concatenate([by_joints, there], axis=2), by_body, reached


# -- Derivatives of a compiled chain for stretches of rows, those of NumPy effects carried on from their link ------


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
        columns, by_joints, by_body, _ = by_ends(model, data, model.full(self.values), part, indices)
        return columns, by_joints, by_body

    def carried(self, some: slice, effects: Sequence[tuple[Effect, Floats]], *by: Floats) -> list[Floats]:
        """What the user's effects give at their links, there for all rows, carried on to these."""
        data = self.data
        return [carry(e, inner[some], data.coordinates, *by) for e, inner in effects]


@dataclass(frozen=True, eq=False)
class ModelColumns(Stretches):
    """By what is identified; ``own`` are the user's effects that are in the model."""

    own: Sequence[tuple[Effect, Floats]]

    def __call__(self, some: slice) -> Derivatives:
        columns, *by = self.of_core(some, self.model.indices)
        if self.own:
            columns = np.concatenate([columns, *self.carried(some, self.own, *by)], axis=2)
        return Derivatives(columns, by[0])


@dataclass(frozen=True, eq=False)
class EffectColumns(Stretches):
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


def carry(effect: Effect, inner: Floats, coordinates: int, by_joints: Floats, by_body: Floats) -> Floats:
    """Derivatives (n, axes, p) of a NumPy effect at its link, carried on to the readings (n, m, p)."""
    if effect.link == "joints":
        return by_joints @ inner
    if effect.link == "body":
        return by_body @ inner
    out = np.zeros((len(inner), by_joints.shape[1], inner.shape[2]))
    out[:, :coordinates] = inner
    return out
