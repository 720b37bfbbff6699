"""Which parameters are enough: on few poses most of them may bring next to nothing on rows held out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..base.types import Floats, Ints
from ..fit.folds import Folds, roots_of
from .fitted_run import FittedRun
from .stage import testable

#: A set is enough where rows held out are off by no more than this many times the least of all sets.
_ENOUGH = 1.05
#: Part of the parameters above which that is not worth a word.
_WORTH = 0.7


@dataclass(frozen=True)
class FewEnough:
    """``names`` of the parameters that are enough, of ``every`` many; what they leave on rows held out, ``error``, and
    what all of them leave, ``of_all``, in ``unit``."""

    names: tuple[str, ...]
    every: int
    error: float
    of_all: float
    unit: str

    def __str__(self) -> str:
        few = len(self.names)
        return (
            f"{few} of the {self.every} parameters are enough for these poses: with {', '.join(self.names)} alone "
            f"rows held out are off by {self.error:.3g} {self.unit}, with all of them by {self.of_all:.3g}"
        )


def few_enough(run: FittedRun, sigma: Floats, repeated_folds: Sequence[Ints]) -> FewEnough | None:
    """The fewest parameters that predict rows held out as well as any set, to first order; None where nearly all are
    needed. ``sigma`` (columns,) weighs the readings.

    Of all that are free the one that is told least beside its deviation is held at its drawing, again and again
    (backward elimination: Miller, *Subset Selection in Regression*, 2002, 3.3); rows held out say where that ends.
    """
    if run.is_exact:
        return None
    rows = testable(run, np.flatnonzero(run.whole))
    scale = sigma[list(run.axes)]
    view = run.linearised(rows, (), scale)
    off = run.fit.values - run.model.start(run.data)
    drawn = np.concatenate([view.residual[part] + view.fitted(part) @ off for part in view.blocks])
    folds = Folds.of(view.fitted, drawn, np.stack([fold[rows] for fold in repeated_folds]))
    one = len(folds) // len(repeated_folds)
    gram, right = folds.grams[:one].sum(axis=0), folds.right[:one].sum(axis=0)
    free = list(range(len(off)))
    steps: list[tuple[float, list[int]]] = []
    while free:
        steps.append((_rms(folds.some(free), scale, run), list(free)))
        root = roots_of(gram[np.ix_(free, free)])
        inverse = root @ root.T
        told = (inverse @ right[free]) ** 2 / np.maximum(np.diag(inverse), 1e-300)
        # what the rows do not tell at all goes first
        free.pop(int(np.argmin(np.where(np.diag(inverse) > 0, told, -1.0))))
    if not steps:
        return None
    least = min(error for error, _ in steps)
    error, few = next(step for step in reversed(steps) if step[0] <= _ENOUGH * least)
    if len(few) > _WORTH * len(off):
        return None
    names = tuple(run.fit.parameters[k].name for k in few)
    return FewEnough(names, len(off), error, steps[0][0], run.unit)


def _rms(folds: Folds, scale: Floats, run: FittedRun) -> float:
    squares = float(folds.held_out.sum() / folds.counts.sum())
    return float(np.sqrt(max(squares, 0.0) * np.mean(scale**2))) * run.per_row
