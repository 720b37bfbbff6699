"""The family of a run: every effect and every shape that may be missing, as blocks of columns, made once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from typing import Protocol

import numpy as np

from ..base.types import Bools, Floats, Ints
from ..model.effect import Effect
from .blocks import Block, Columns, ReferenceRows, Visits, apart, block_sizes
from .made import Maker
from .run import Run
from .shapes import blocks_of_effects, blocks_of_shapes
from .thresholds import HELD_EFFECT, HELD_SHAPE, TWIN
from .whitening import orthonormal

#: Prior part of all effects together; that of all shapes is the rest.
EFFECTS = 0.5


class Waves(Protocol):
    """Waves that were found before: with a period for each joint, of an ``effect``, or of a shape."""

    @property
    def effect(self) -> Effect | None:
        """None of a shape."""
        ...

    def add_to(self, made: Maker) -> None:
        """Adds their block."""
        ...

    def is_shape(self, block: Block) -> bool:
        """Whether a shape is one of them once more."""
        ...


class Family:
    """Blocks of a run.

    ``blocks`` (B,) are those that are something in these rows; ``columns`` are theirs, by number. ``log_weight`` (B,)
    is the logarithm of the prior weight of each: half of it is of effects, half of shapes, each cause has as much as
    any other, and its settings and axes share it. A weight of nothing (-inf) is that of a shape which an effect is.
    Effects are alone where no ``shapes`` are asked for. A ``reference`` fixes all of these, and the scale of the prior,
    before the rows are read.
    """

    def __init__(
        self,
        run: Run,
        reference: ReferenceRows | None = None,
        *,
        shapes: bool = True,
        made: tuple[Columns, Sequence[Block]] | None = None,
        waves: Sequence[Waves] = (),
    ) -> None:
        self.run, self.reference, self.waves = run, reference, waves
        self.columns, blocks = made or everything(run, reference, shapes=shapes)
        there = self.columns.length > 0
        if reference is None:
            every = [b if there[b.at].all() else replace(b, at=b.at[there[b.at]]) for b in blocks]
            self.blocks: tuple[Block, ...] = tuple(block for block in every if len(block.at))
        else:
            # as wide as in the reference: a column that is nothing yet tells nothing
            known = [(block, reference.sort_of(block)) for block in blocks]
            known = [one for one in known if one[1] is not None or not reference.scale]
            self.blocks = tuple(block for block, _ in known)
            self._scale = np.array([reference.scale.get(sort, 1.0) for _, sort in known])
        self.is_effect: Bools = np.array([block.effect is not None for block in self.blocks], dtype=bool)
        #: Part of a column's square below which what is in the model holds it.
        self.least: Floats = np.where(self.is_effect, HELD_EFFECT, HELD_SHAPE)
        self.log_weight: Floats = (
            log_weights(self.blocks, self.is_effect) if reference is None or not reference.scale
            else np.array([reference.log_weight[sort] for _, sort in known])
        )  # fmt: skip

    def having(self, waves: Sequence[Waves]) -> Family:
        """The same with a block for each of these waves, where there are any."""
        if not waves:
            return self
        made = Maker(self.run, self.columns.visits, self.reference)
        for one in waves:
            one.add_to(made)
        parts, blocks = made.done()
        columns = Columns(self.run, self.columns.visits, [*self.columns.parts, *parts])
        more = [replace(block, at=block.at + len(self.columns)) for block in blocks]
        return Family(self.run, self.reference, made=(columns, [*self.blocks, *more]), waves=waves)

    def __len__(self) -> int:
        return len(self.blocks)

    @cached_property
    def names(self) -> list[str]:
        """Names of the blocks, empty ones of shapes."""
        return [block.name for block in self.blocks]

    @cached_property
    def groups(self) -> tuple[tuple[Ints, Ints, Floats], ...]:
        """Blocks by how wide they are: which they are (b,), their columns (b, k), products within each (b, k, k)."""
        width = np.array([len(block.at) for block in self.blocks])
        out = []
        for k in np.unique(width):
            which = np.flatnonzero(width == k)
            at = np.stack([self.blocks[i].at for i in which])
            out.append((which, at, self.columns.grams(at)))
        return tuple(out)

    def prior(self, block: Block) -> Floats:
        """By what its columns (k,), of unit length, are multiplied so that a coefficient of one leaves a root mean
        square of one over the reference."""
        return np.asarray(self.columns.length[block.at] * block_sizes(block) * self.scale_of(block))

    def scale_of(self, block: Block) -> float:
        """The same of plausible sizes."""
        assert self.reference is not None, "of a run by itself the prior is that of unit information"
        return self.reference.scale.get(self.reference.sort_of(block), 1.0)

    @cached_property
    def priors(self) -> tuple[Floats, ...]:
        """The same of all blocks, as :attr:`groups` has them (b, k)."""
        out = []
        for which, at, _ in self.groups:
            prior = self.columns.length[at] * self._scale[which][:, None]
            for k in np.flatnonzero(self.is_effect[which]):
                prior[k] *= block_sizes(self.blocks[which[k]])
            out.append(prior)
        return tuple(out)

    @cached_property
    def log_missing(self) -> float:
        """Logarithm of the weight of what a reference has and these rows do not: they say nothing of it."""
        if self.reference is None:
            return -np.inf
        return float(np.log(max(1.0 - np.exp(self.log_weight).sum(), 1e-300)))

    def where(self, block: Block) -> int:
        """The number of the block that says the same at the nearest setting. Raises ``KeyError`` for none."""

        def off(i: int) -> tuple[bool, int, float]:
            mine, period = self.blocks[i], block.period or 0.0
            off = apart(mine.setting, block.setting)
            same = mine.since == block.since and not np.isinf(off)
            return not same, abs(len(mine.at) - len(block.at)), off + abs((mine.period or 0.0) - period)

        return min(self._alike[_sort_of(block)], key=off)

    @cached_property
    def _alike(self) -> dict[tuple[object, ...], list[int]]:
        out: dict[tuple[object, ...], list[int]] = {}
        for i, block in enumerate(self.blocks):
            out.setdefault(_sort_of(block), []).append(i)
        return out

    def without_twins(self, basis: Floats, left: Floats) -> None:
        """Takes the weight of shapes of which one effect holds nearly all, of the part ``left`` (B,) of their squares
        that what is fitted, with this ``basis`` (N, p), leaves: such a shape is that effect once more, no rival."""
        moments = any(e.search == "time_s" and place is None for e, place in self.run.view.in_time)
        twin = np.array([moments and block.shape == "step" for block in self.blocks], dtype=bool)
        twin |= [any(one.is_shape(block) for one in self.waves) for block in self.blocks]
        ones = []
        for block in self.blocks:
            if block.effect is None or block.setting is not None or block.pattern is not None:
                continue
            columns = self.columns.of(block.at)
            columns -= basis @ (basis.T @ columns)
            if np.linalg.norm(columns) >= HELD_EFFECT**0.5:
                ones.append(orthonormal(columns, HELD_EFFECT**0.5))
        if ones:
            held = np.square(self.columns.products(np.concatenate(ones, axis=1)))
            starts = np.cumsum([0, *(one.shape[1] for one in ones)])[:-1]
            by_effect = np.add.reduceat(held, starts, axis=1)
            for which, at, _ in self.groups:
                twin[which] |= (by_effect[at].sum(axis=1) > TWIN * left[which][:, None]).any(axis=1) & (left[which] > 0)
        self.log_weight[twin & ~self.is_effect] = -np.inf


def everything(
    run: Run, reference: ReferenceRows | None = None, *, shapes: bool = True
) -> tuple[Columns, Sequence[Block]]:
    """All effects and shapes of a run: their columns, and the blocks."""
    made = Maker(run, Visits.of(run), reference)
    blocks_of_effects(made)
    if shapes:
        blocks_of_shapes(made)
    parts, blocks = made.done()
    return Columns(run, made.visits, parts), blocks


def log_weights(blocks: Sequence[Block], is_effect: Bools) -> Floats:
    """Logarithms of prior weights (B,), as :class:`Family` has them."""
    out = np.zeros(len(blocks))
    for which, share in ((is_effect, EFFECTS), (~is_effect, 1.0 - EFFECTS)):
        some = np.flatnonzero(which).tolist()
        count: dict[tuple[object, ...], int] = {}
        for i in some:
            count[blocks[i].cause] = count.get(blocks[i].cause, 0) + 1
        for i in some:
            out[i] = np.log(share / (len(count) * count[blocks[i].cause])) - blocks[i].ways
    return out


def _sort_of(block: Block) -> tuple[object, ...]:
    return block.cause, block.axis, block.pattern, block.order
