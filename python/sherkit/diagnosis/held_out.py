"""The held-out error that people are shown, wherever they see it: every row predicted by a fit that did not see its
block, in several ways to cut the run into blocks; and what of the model, or beside it, is worth its place by that.

All is linear around the full fit, so that a fit without a block is a subtraction of Gram matrices.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from ..base import linalg
from ..base.types import Floats, Ints
from ..errors import SherkitError
from ..evidence.fitted_run import FittedRun
from ..evidence.linearised import Linearised
from ..evidence.run import in_time
from ..fit.error import ErrorSize, held_out_error, known_of
from ..fit.folds import Folds, roots_of
from ..model.effect import Effect

#: Held-out error over noise up to which what is left is as small as the noise.
PRAISE = 1.25
#: Readings for each parameter from which on what noise does to the parameters is next to nothing in any block.
_ENOUGH = 200
#: Noises that are drawn to know what they leave on rows held out.
_DRAWS = 999


def error_of(run: FittedRun, sigma: Floats, repeated_folds: Sequence[Ints]) -> ErrorSize:
    """The error of a fit on rows held out. ``sigma`` (columns,) weighs the readings."""
    refit = run.fit.refitted if run.model.in_sockets(run.data) else None
    return held_out_error(run.fit, refit=refit, sigma=sigma, repeated_folds=repeated_folds, derivatives=run.derivatives)


def rms(squares: Floats, scale: Floats) -> float:
    """Of squared errors (…, m) over the noise ``scale`` (m,)."""
    return float(np.sqrt(np.mean(squares * scale**2)))


def folds_of(view: Linearised, fold: Ints, known: Floats | None = None) -> Folds:
    """What was fitted, by folds (repetitions, n)."""
    return Folds.of(view.fitted, view.residual, fold, known)


def squares_of(view: Linearised, fold: Ints, known: Floats | None = None) -> Floats:
    """Squared errors (repetitions, n, m) of rows that were held out in turn."""
    folds = folds_of(view, fold, known)
    parts = [folds.errors(view.fitted(rows), view.residual[rows], rows) for rows in view.blocks]
    return np.concatenate(parts, axis=1) ** 2


def noise_quantile(run: FittedRun, sigma: Floats, repeated_folds: Sequence[Ints], level: float, seed: int) -> float:
    """Root of the mean square, in noises, below which rows held out stay with a chance of 1 - ``level`` where the model
    lacks nothing.

    Few poses fix a model loosely, and a block that is held out lies beyond them: its error is noise and, of noise too,
    that of the parameters. ``sigma`` (columns,) is the noise; where repeats told it, it is itself uncertain. Of the
    noise all that counts are its products with the columns, normal with the Gram matrices as covariances: these are
    drawn.
    """
    rows = in_time(run, np.flatnonzero(run.whole))
    if len(rows) * len(run.axes) > _ENOUGH * run.fit.rank:
        return 1.0
    folds = folds_of(
        run.linearised(rows, (), sigma[list(run.axes)]),
        np.stack([fold[rows] for fold in repeated_folds]),
        known_of(run.fit),
    )
    rng = np.random.default_rng(seed)
    each = [_drawn(folds.repetition(k), rng) for k in range(len(repeated_folds))]
    told = run.data.repeatability if run.noise[1] == "repeats" else None
    if told is not None:
        free = max(sum(told.degrees_of_freedom.values()), 1)
        each = [one * free / rng.chisquare(free, size=_DRAWS) for one in each]
    return float(np.sqrt(np.mean(np.quantile(each, 1.0 - level, axis=1))))


def _drawn(folds: Folds, rng: np.random.Generator) -> Floats:
    """Mean squares (draws,) of unit noise on rows held out."""
    root = _square_root(folds.grams)
    z = rng.normal(size=(_DRAWS, *root.shape[:2]))
    right = np.einsum("fkl,dfl->dfk", root, z)
    outside = roots_of(folds.outside[0])
    x = np.einsum("fkl,fml,dfm->dfk", outside, outside, right.sum(axis=1, keepdims=True) - right, optimize=True)
    seen = (root != 0.0).any(axis=1)
    beside = np.maximum(folds.counts - seen.sum(axis=1), 0)
    squares = (z**2 * seen).sum(axis=2) + rng.chisquare(np.maximum(beside, 1), size=x.shape[:2]) * (beside > 0)
    squares += np.einsum("dfk,fkl,dfl->df", x, folds.grams, x, optimize=True) - 2.0 * (x * right).sum(axis=2)
    return np.asarray(squares.sum(axis=1) / folds.counts.sum())


def _square_root(grams: Floats) -> Floats:
    """Matrices (f, k, k) whose products with their transposes are these."""
    value, vector = linalg.eigh(grams)
    return vector * np.sqrt(np.where(value > 1e-12 * value[:, -1:], value, 0.0))[:, None, :]


# -- Whether an effect of a model earns its place -------------------------------------------------------------------

#: Level of the test on rows held out.
LEVEL = 0.01


@dataclass(frozen=True)
class HeldOutGain:
    """What an effect brings on rows held out: RMS ``without`` it and ``with_it`` in the unit of the run, and the
    one-sided ``p`` of that."""

    effect: str
    without: float
    with_it: float
    p: float

    @property
    def holds(self) -> bool:
        """Whether the effect lowers the error on rows held out, and not by chance."""
        return self.with_it < self.without and self.p <= LEVEL


def held_out_gain(
    run: FittedRun,
    effect: Effect,
    *,
    sigma: Floats,
    repeated_folds: Sequence[Ints],
    also: Collection[str] = (),
) -> HeldOutGain:
    """What ``effect``, which is in the model of ``run``, brings given all others of the model but those of ``also``.

    ``repeated_folds`` are folds (n,) of all rows of the data. An effect without which the rows cannot be fitted earns
    its place.
    """
    axes = list(run.axes)
    rows = in_time(run, np.flatnonzero(run.whole))
    scale = sigma[axes]
    fold = np.stack([fold[rows] for fold in repeated_folds])
    try:
        full = run.without_effects(also) if also else run
        less = full.without_effects((effect.name,))
        views = tuple(one.linearised(rows, (), scale) for one in (full, less))
    except SherkitError:
        return HeldOutGain(effect.name, np.inf, 0.0, 0.0)
    with_it, without = (squares_of(v, fold, known_of(one.fit)) for v, one in zip(views, (full, less), strict=True))
    gain = without.sum(axis=2) - with_it.sum(axis=2)
    return HeldOutGain(
        effect.name,
        without=rms(without, scale) * run.per_row,
        with_it=rms(with_it, scale) * run.per_row,
        p=_by_chance(gain.mean(axis=0), views[0].group),
    )


def _by_chance(gain: Floats, pose: Ints) -> float:
    """One-sided p of a positive sum of paired gains (n,), of which those of one pose are one witness: normal, with the
    variance that signs at random of whole poses would have."""
    sums = np.bincount(np.unique(pose, return_inverse=True)[1].ravel(), gain)
    spread = float(np.sqrt(np.square(sums).sum()))
    return float(scipy.special.ndtr(-sums.sum() / spread)) if spread > 0 else 1.0


# -- Which parameters are enough: on few poses most may bring next to nothing on rows held out ---------------------

#: A set is enough where rows held out are off by no more than this many times the least of all sets.
_AS_GOOD = 1.05
#: Part of the parameters above which that is not worth a word.
_WORTH = 0.7


@dataclass(frozen=True)
class Elimination:
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


def backward_elimination(run: FittedRun, sigma: Floats, repeated_folds: Sequence[Ints]) -> Elimination | None:
    """The fewest parameters that predict rows held out as well as any set, to first order; None where nearly all are
    needed. ``sigma`` (columns,) weighs the readings.

    Of all that are free the one that is told least beside its deviation is held at its drawing, again and again
    (backward elimination: Miller, *Subset Selection in Regression*, 2002, 3.3); rows held out say where that ends.
    """
    if run.is_exact:
        return None
    rows = in_time(run, np.flatnonzero(run.whole))
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
    error, few = next(step for step in reversed(steps) if step[0] <= _AS_GOOD * least)
    if len(few) > _WORTH * len(off):
        return None
    names = tuple(run.fit.parameters[k].name for k in few)
    return Elimination(names, len(off), error, steps[0][0], run.unit)


def _rms(folds: Folds, scale: Floats, run: FittedRun) -> float:
    squares = float(folds.held_out.sum() / folds.counts.sum())
    return float(np.sqrt(max(squares, 0.0) * np.mean(scale**2))) * run.per_row
