"""A fitted model to first order: residuals, derivatives, variables, steps in time. It knows nothing of robots.

Residuals are in units of their noise, one axis per reading. A correlation in time is taken out by the filter
``e_t - ρ e_{t-1}``, which every column passes as well.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, wraps
from typing import Any, Protocol, TypeVar

import numpy as np

from ..base.types import Floats, Ints
from ..fit.folds import blocks
from ..model.effect import Effect, Setting

T = TypeVar("T")


def last_asked(function: Callable[[Any, slice], T]) -> Callable[[Any, slice], T]:
    """A method of a stretch of rows that remembers the one asked for last: of a short run it is all of them."""
    name = f"_last_{function.__name__}"

    @wraps(function)
    def remembered(self: Any, rows: slice) -> T:
        last: tuple[slice, T] | None = vars(self).get(name)
        if last is None or last[0] != rows:
            last = vars(self)[name] = (rows, function(self, rows))
        return last[1]

    return remembered


class WhitenedDerivatives(Protocol):
    """Derivatives of any stretch of rows, over the noise; every call computes them anew."""

    def fitted(self, rows: slice) -> tuple[Floats, Floats | None]:
        """By what is fitted (b, m, p) and by the inputs (b, m, k), None where these are not known."""
        ...

    def effects(self, rows: slice) -> Floats:
        """By the parameters of every effect that can be tried (b, m, e)."""
        ...


@dataclass(frozen=True, eq=False)
class Linearised:
    """Rows of a fit in the order of time, and all to first order.

    ``residual`` (n, m) measured minus predicted over the noise; ``variables`` name to values (n,), what a residual
    may depend on; ``derivatives`` gives those of any stretch of rows. ``pattern_of`` names the input of a variable
    which is one whose pattern is known; ``place`` names the variables that say where the machine is; ``group`` (n,)
    is equal where it stood the same, ``repeated`` (n,) where the same was read there again. ``effects`` pairs each
    effect that can be tried with its columns; ``in_time`` are the effects that step at a searched time, each with
    its columns after the step, or None where these are a step of each reading; ``periodic`` those that are a wave
    of each input at a searched period, each with the period that the model has for it, or None; ``lagging`` those
    among ``effects`` that follow with a searched time constant, each with what gives its columns at another one;
    ``untestable`` maps the others to the reason. ``way`` names to (n,) how the machine came to these rows: inputs
    of the row before, and the direction in which the point moved. ``inputs`` name to (n,), the readings of the inputs,
    be they constant or their patterns unknown.

    A distance between two places has two ends, at each of which an error of an input does its own: ``others`` name to
    (n,), the inputs at the other ends, and derivatives by the inputs have twice as many columns. Values of ``ends`` of
    the rows (e n,) are those of the first ends, one after the other, and then those of the others; where every row has
    one, they are those of the rows.
    """

    residual: Floats
    variables: Mapping[str, Floats]
    group: Ints
    repeated: Ints
    derivatives: WhitenedDerivatives
    pattern_of: Mapping[str, str] = field(default_factory=dict)
    place: tuple[str, ...] = ()
    inputs: Mapping[str, Floats] = field(default_factory=dict)
    others: Mapping[str, Floats] = field(default_factory=dict)
    way: Mapping[str, Floats] = field(default_factory=dict)
    time: Floats | None = None
    effects: Sequence[tuple[Effect, slice]] = ()
    in_time: Sequence[tuple[Effect, slice | None]] = ()
    periodic: Sequence[tuple[Effect, Setting | None]] = ()
    lagging: Sequence[tuple[Effect, Callable[[float], Callable[[slice], Floats]]]] = ()
    untestable: Mapping[str, str] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.residual)

    @property
    def axes(self) -> int:
        """Readings per row."""
        return self.residual.shape[1]

    def fitted(self, rows: slice) -> Floats:
        """Derivatives (b, m, p) of a stretch of rows by what is fitted."""
        return self._own(rows)[0]

    @last_asked
    def effects_in(self, rows: slice) -> Floats:
        """Derivatives (b, m, e) of a stretch of rows by the parameters of every effect that can be tried."""
        return self.derivatives.effects(rows)

    @last_asked
    def _own(self, rows: slice) -> tuple[Floats, Floats | None]:
        return self.derivatives.fitted(rows)

    @property
    def whole(self) -> slice:
        """All rows."""
        return slice(0, len(self))

    @cached_property
    def blocks(self) -> list[slice]:
        """Stretches of rows."""
        return blocks(len(self))

    def waving(self, effect: Effect) -> tuple[str, ...]:
        """Inputs along which waves of one period are looked for: those in the unit of the period of an effect, where
        some are in another."""
        names = tuple(self.inputs)
        return tuple(names[k] for k in effect.waving(names)) or names

    @property
    def ends(self) -> int:
        """How many ends rows have."""
        return 2 if self.others else 1

    @cached_property
    def stood(self) -> Mapping[str, Floats]:
        """The inputs at the ends of the rows, name to (e n,)."""
        if not self.others:
            return self.inputs
        return {name: np.concatenate([here, self.others[name]]) for name, here in self.inputs.items()}

    @cached_property
    def patterns(self) -> dict[str, Floats]:
        """How the readings answer to an error at each input at the ends of the rows, name to (e n, m); empty where that
        is not known."""
        parts = [self._own(rows)[1] for rows in self.blocks]
        if any(part is None for part in parts):
            return {}
        every = np.concatenate([part for part in parts if part is not None])
        if self.others:
            every = np.concatenate([every[:, :, : len(self.inputs)], every[:, :, len(self.inputs) :]])
        return {name: np.ascontiguousarray(every[:, :, k]) for k, name in enumerate(self.inputs)}

    def arriving(self, name: str, error: Floats) -> Floats:
        """What errors of an input at the ends of the rows (e n, k) make of the readings (n, m, k)."""
        made = self.patterns[name][:, :, None] * error[:, None]
        return made if self.ends == 1 else made[: len(self)] + made[len(self) :]


# -- What a step in time takes of residuals, wherever it stands ----------------------------------------------------


def step_gains(left: Floats, inside: Floats | float, cuts: Ints, least: float) -> Floats:
    """Sum of squares (c,) that a step on all axes, from each cut on, takes of what orthonormal columns ``left`` (n, m);
    nothing where they leave less than the part ``least`` of it. They have ``inside`` (c, m) of its square."""
    n = len(left)
    free = (n - cuts)[:, None] - inside
    return np.where(free > least * n, _since(left, cuts) ** 2 / np.maximum(free, 1e-12), 0.0).sum(axis=1)


def within(columns: Iterable[Floats], cuts: Ints) -> Floats | float:
    """Of the square of a step from each cut on (c, m), what orthonormal ``columns``, each (n, m), have; nothing of
    none."""
    return sum((_since(column, cuts) ** 2 for column in columns), 0.0)


def _since(values: Floats, cuts: Ints) -> Floats:
    """Sums (c, m) of values (n, m) from each cut on."""
    return np.cumsum(values[::-1], axis=0)[::-1][cuts]
