"""What is fixed before a run is read, so that it may be looked at as often as one likes.

Shapes are functions of variables brought to the range that these have in a reference: rows over all of where and when
the machine is to be judged. A coefficient of one leaves there, beside what the model fits, a root mean square of one
unit of the readings; its prior is normal, in noises of that size. Scales, settings and weights do not hang on the rows
read so far: the Bayes factor of a block is then the ratio of two densities of the same maximal invariant, its mean over
looks never rises, and by Ville's inequality a weighted mean of them exceeds 1/α at any look with a chance of α at most
(Grünwald, de Heide and Koolen, "Safe testing", J. R. Stat. Soc. B 2024; Pérez-Ortiz, Lardy, de Heide and Grünwald,
"E-statistics, group invariance and anytime-valid testing", Ann. Stat. 2024). No number of looks and no budget is in it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from ..base.types import Floats, Ints
from .blocks import Block
from .linearised import Linearised

#: All that blocks have in common which say the same: at one setting, or at any.
Sort = tuple[object, ...] | None


@dataclass(frozen=True, eq=False)
class ReferenceRows:
    """A ``view`` of rows over the whole region and span, with rows ``cuts`` (c,) from which on a step is tried.

    ``scale`` is that of each sort of block, ``log_weight`` the logarithm of the prior weight of each of its settings;
    ``squares`` (k, k) are mean squares of each sort's columns, so scaled, over the reference, beside what the model
    fits. What none of them has is in no family of a run.
    """

    view: Linearised
    cuts: Ints
    scale: Mapping[Sort, float] = field(default_factory=dict)
    log_weight: Mapping[Sort, float] = field(default_factory=dict)
    squares: Mapping[Sort, Floats] = field(default_factory=dict)

    @property
    def names(self) -> set[object]:
        """Those of its effects."""
        return {sort[0][0] for sort in self.scale if sort is not None and isinstance(sort[0], tuple)}

    def sort_of(self, block: Block) -> Sort:
        """Of what sort a block is: at its setting where that was tried in the reference, else at any; None for one that
        is not there."""
        return next((one for one in sorts_of(block) if one in self.scale), None)


def sorts_of(block: Block) -> tuple[Sort, Sort]:
    """A block at its setting, and at any."""
    any_ = (block.cause, block.axis, block.pattern, block.order, len(block.at))
    return (*any_, block.setting, block.period), any_


def sizes_of(block: Block) -> Floats:
    """By what its columns (k,) are multiplied to be of plausible sizes; a step of each reading has one for each."""
    parameters = () if block.effect is None else block.effect.parameters
    return np.array([p.size for p in parameters]) if len(parameters) == len(block.at) else np.ones(len(block.at))
