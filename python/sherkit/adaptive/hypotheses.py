"""What may be the case, one by one: names, weights, and what each may be set to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

from ..model.effect import Effect
from .shapes import Shape

#: Shares of the weight of one: causes one by one, shapes, pairs.
SINGLES, SHAPES, PAIRS = 0.45, 0.45, 0.1

#: A hypothesis by name, at what it is set to.
Key = tuple[str, float | None]


@dataclass(frozen=True)
class Hypothesis:
    """One thing that may be the case: an ``effect`` of the catalogue, a ``shape`` of what is in none, or neither: a
    parameter of the model that has changed.

    ``settings`` are what it may be set to, None alone where there is nothing to set; ``in_time`` tells whether a later
    moment shows more of it; ``weight`` is its share.
    """

    name: str
    effect: Effect | None
    shape: Shape | None
    settings: tuple[float | None, ...]
    in_time: bool
    weight: float = 0.0

    @property
    def is_shape(self) -> bool:
        """Whether it only describes."""
        return self.shape is not None


def weighted(hypotheses: Sequence[Hypothesis]) -> tuple[Hypothesis, ...]:
    """The same with their shares: causes have as much as shapes."""
    causes = max(sum(not h.is_shape for h in hypotheses), 1)
    share = {False: SINGLES / causes, True: SHAPES / max(len(hypotheses) - causes, 1)}
    return tuple(replace(h, weight=share[h.is_shape]) for h in hypotheses)


@dataclass(frozen=True, eq=False)
class Hypotheses:
    """All of them."""

    hypotheses: tuple[Hypothesis, ...]

    @cached_property
    def by_name(self) -> dict[str, Hypothesis]:
        """Hypotheses by name."""
        return {h.name: h for h in self.hypotheses}

    @cached_property
    def effects(self) -> tuple[Hypothesis, ...]:
        """Those that are causes."""
        return tuple(h for h in self.hypotheses if not h.is_shape)

    def weight(self, names: Sequence[str]) -> float:
        """The share of one hypothesis or of a pair; half of that of pairs is for two effects."""
        if len(names) == 1:
            return self.by_name[names[0]].weight
        count, every = len(self.effects), len(self.hypotheses)
        two = max(count * (count - 1) / 2, 1.0)
        if not any(self.by_name[name].is_shape for name in names):
            return 0.5 * PAIRS / two
        return 0.5 * PAIRS / max(every * (every - 1) / 2 - two, 1.0)
